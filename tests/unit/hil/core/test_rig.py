"""The rig file: the shipped example, every check between keys, and arbitrarily changed texts."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.gateway_bench import EXAMPLE_RIG, rig_text

from hil.core.errors import DocumentError
from hil.core.rig import MAX_WIRE_V, VOLTS_PER_COUNT, Potentiometer, Rig, nanoseconds, read_rig

EXAMPLE = rig_text()


def refusal(text: str) -> str:
    with pytest.raises(DocumentError) as caught:
        read_rig(text, "my.toml")
    return str(caught.value)


class TestTheExample:
    def test_the_example_has_the_loop_of_the_paper_and_three_axes(self) -> None:
        rig = read_rig(EXAMPLE_RIG, "rig.toml")
        assert rig.loop.period_ns == 11_200_000
        assert [(name, axis.unit) for name, axis in rig.axes.items()] == [
            ("vertical", "m"),
            ("horizontal", "m"),
            ("rotation", "rad"),
        ]
        assert rig.bus.channel == "sim"
        assert rig.dac.apply == "at sync"

    def test_the_table_bus_is_optional(self) -> None:
        text = re.sub(r"\[bus\]\n(.+\n)+", "", EXAMPLE)
        assert "[bus]" not in text
        assert read_rig(text, "rig.toml").bus.channel == "sim"

    def test_axes_keep_the_order_of_the_file(self) -> None:
        head, vertical, horizontal, rotation = re.split(r"(?m)^(?=\[axes\.\w+\]$)", EXAMPLE)
        rig = read_rig(head + rotation + vertical + horizontal, "rig.toml")
        assert list(rig.axes) == ["rotation", "vertical", "horizontal"]


@pytest.mark.parametrize(
    ("period_s", "period_ns"), [("0.001", 1_000_000), ("1.0", 10**9), ("0.07", 70_000_000)]
)
def test_the_period_in_nanoseconds_is_exact(period_s: str, period_ns: int) -> None:
    changes = {
        "loop.period_s": period_s,
        "adc.stale_after_periods": "1",
        "dac.watchdog_timeout_s": "2.0",
        "gateway.heartbeat_interval_s": "0.1",
        "dac.heartbeat_timeout_s": "10.0",
    }
    assert read_rig(rig_text(changes), "r").loop.period_ns == period_ns


@pytest.mark.parametrize(
    ("key", "longest", "too_long", "text"),
    [
        (
            "adc.stale_after_periods",
            "178",
            "179",
            "179 periods of 0.0112 s are 2.0048 s, more than the limit 2 s",
        ),
        ("dac.watchdog_timeout_s", "2.0", "2.001", "2.001 s is more than the limit 2 s"),
    ],
)
def test_the_valves_never_hold_a_command_for_more_than_two_seconds(
    key: str, longest: str, too_long: str, text: str
) -> None:
    watchdog = {"dac.watchdog_timeout_s": "2.0"}
    read_rig(rig_text(watchdog | {key: longest}), "r")
    assert refusal(rig_text(watchdog | {key: too_long})) == f"my.toml: {key}: {text}"


@pytest.mark.parametrize("board", ["adc", "dac"])
def test_a_board_without_heartbeat_counts_as_present_for_ten_seconds_at_most(board: str) -> None:
    key = f"{board}.heartbeat_timeout_s"
    read_rig(rig_text({key: "10.0"}), "r")
    assert refusal(rig_text({key: "10.1"})) == f"my.toml: {key} is 10.1, but must be at most 10.0"


@pytest.mark.parametrize(("stale", "is_refused"), [(4, False), (5, True), (6, True)])
def test_the_watchdog_of_the_board_waits_longer_than_the_gateway(stale: int, is_refused: bool) -> None:
    """Otherwise the board centres its valves while the gateway takes them to hold."""
    text = rig_text({"adc.stale_after_periods": str(stale), "dac.watchdog_timeout_s": "0.056"})
    if is_refused:
        assert refusal(text) == (
            f"my.toml: dac.watchdog_timeout_s: 0.056 s does not exceed the {stale * 0.0112:g} s of "
            f"adc.stale_after_periods ({stale} periods of 0.0112 s): the board would centre its valves while "
            "the gateway takes them to hold"
        )
    else:
        read_rig(text, "r")


class TestTimesInSeconds:
    """Times of boards and gateway do not depend on the period of the loop."""

    @pytest.mark.parametrize(
        ("period_s", "interval_s", "periods"),
        [
            ("0.0112", "0.1", 9),
            ("0.001", "0.1", 100),
            ("0.1", "0.1", 1),
            ("0.1", "0.001", 1),
            ("0.0112", "0.0951", 8),
            ("0.0112", "0.0953", 9),
        ],
    )
    def test_the_heartbeat_interval_is_rounded_to_whole_periods(
        self, period_s: str, interval_s: str, periods: int
    ) -> None:
        changes = {
            "loop.period_s": period_s,
            "gateway.heartbeat_interval_s": interval_s,
            "dac.watchdog_timeout_s": "1.0",
        }
        assert read_rig(rig_text(changes), "r").heartbeat_periods == periods

    @pytest.mark.parametrize(
        ("key", "seconds", "periods"),
        [
            ("adc.heartbeat_timeout_s", 0.3024, 27),
            ("dac.heartbeat_timeout_s", 0.3024, 27),
            ("dac.watchdog_timeout_s", 0.0896, 8),
        ],
    )
    def test_the_shipped_times_are_whole_periods_of_the_shipped_loop(
        self, key: str, seconds: float, periods: int
    ) -> None:
        """Version 0.1 counted them in periods; they are the same to the nanosecond."""
        rig = read_rig(EXAMPLE_RIG, "rig.toml")
        board, _, name = key.partition(".")
        assert getattr(getattr(rig, board), name) == seconds
        assert nanoseconds(seconds) == periods * rig.loop.period_ns

    def test_the_shipped_times_fit_a_loop_of_1_khz(self) -> None:
        text = EXAMPLE_RIG.replace("period_s = 0.0112", "period_s = 0.001")
        assert read_rig(text, "rig.toml").heartbeat_periods == 100

    def test_a_loop_slower_than_the_boards_time_out_is_refused(self) -> None:
        text = EXAMPLE_RIG.replace("period_s = 0.0112", "period_s = 0.35")
        assert refusal(text) == (
            "my.toml: dac.heartbeat_timeout_s: 0.3024 s does not exceed the 0.35 s between heartbeats of the "
            "gateway (gateway.heartbeat_interval_s in whole periods): the board would count the gateway as "
            "lost"
        )

    def test_keys_of_version_0_1_are_refused_with_the_line_to_write_instead(self) -> None:
        text = EXAMPLE_RIG
        for new, old in (
            ("heartbeat_interval_s = 0.1 ", "heartbeat_periods = 9"),
            ("heartbeat_timeout_s = 0.3024", "heartbeat_timeout_periods = 27"),
            ("watchdog_timeout_s = 0.0896", "watchdog_periods = 8"),
        ):
            assert new in text
            text = text.replace(new, old)
        ask = "this time is now given in seconds; write"
        assert refusal(text).splitlines() == [
            f"my.toml: gateway.heartbeat_periods: {ask} heartbeat_interval_s = 0.1008, "
            "which is 9 periods of 0.0112 s",
            f"my.toml: adc.heartbeat_timeout_periods: {ask} heartbeat_timeout_s = 0.3024, "
            "which is 27 periods of 0.0112 s",
            f"my.toml: dac.heartbeat_timeout_periods: {ask} heartbeat_timeout_s = 0.3024, "
            "which is 27 periods of 0.0112 s",
            f"my.toml: dac.watchdog_periods: {ask} watchdog_timeout_s = 0.0896, "
            "which is 8 periods of 0.0112 s",
        ]

    @pytest.mark.parametrize(
        ("period", "periods"), [('"slow"', "8"), ("0.0112", '"eight"'), ("0.0112", "true")]
    )
    def test_an_old_key_without_a_usable_value_names_the_new_key(self, period: str, periods: str) -> None:
        text = rig_text({"loop.period_s": period})
        text = re.sub(r"watchdog_timeout_s = .*", f"watchdog_periods = {periods}", text)
        assert refusal(text) == (
            "my.toml: dac.watchdog_periods: this time is now given in seconds; write watchdog_timeout_s"
        )


POT, VALVE = "axes.vertical.potentiometer", "axes.vertical.valve"


@pytest.mark.parametrize(
    ("key", "literal", "text"),
    [
        ("loop.period_s", "0.0009", "loop.period_s is 0.0009, but must be at least 0.001"),
        ("loop.period_s", "1.1", "loop.period_s is 1.1, but must be at most 1.0"),
        ("loop.period_s", "nan", "loop.period_s: nan is not a finite number"),
        ("loop.period_s", '"11.2 ms"', "loop.period_s is '11.2 ms', but must be a number"),
        ("bus.channel", "0", "bus.channel is 0, but must be a text"),
        (
            "gateway.heartbeat_interval_s",
            "0",
            "gateway.heartbeat_interval_s is 0, but must be at least 0.001",
        ),
        ("adc.stale_after_periods", "0", "adc.stale_after_periods is 0, but must be at least 1"),
        ("adc.stale_after_periods", "2.5", "adc.stale_after_periods is 2.5, but must be a whole number"),
        ("adc.protected", "1", "adc.protected is 1, but must be true or false"),
        ("adc.stale_after_periods", "1001", "adc.stale_after_periods is 1001, but must be at most 1000"),
        ("dac.watchdog_timeout_s", "0", "dac.watchdog_timeout_s is 0, but must be at least 0.001"),
        ("dac.apply", '"later"', "dac.apply is 'later', but must be 'at once' or 'at sync'"),
        ("axes.vertical.unit", '"mm"', "axes.vertical.unit is 'mm', but must be 'm' or 'rad'"),
        ("axes.rotation.unit", '"deg"', "axes.rotation.unit is 'deg', but must be 'm' or 'rad'"),
        (f"{POT}.channel", "4", f"{POT}.channel is 4, but must be at most 3"),
        (f"{VALVE}.channel", "0", f"{VALVE}.channel is 0, but must be at least 1"),
        (f"{POT}.max_v", "10.1", f"{POT}.max_v is 10.1, but must be at most 10.0"),
        (f"{VALVE}.min_v", "-0.1", f"{VALVE}.min_v is -0.1, but must be at least 0.0"),
        (f"{VALVE}.max_rate_v_s", "0", f"{VALVE}.max_rate_v_s is 0, but must be more than 0.0"),
        (f"{VALVE}.max_rate_v_s", "inf", f"{VALVE}.max_rate_v_s: inf is not a finite number"),
        (f"{POT}.y_at_10v", "nan", f"{POT}.y_at_10v: nan is not a finite number"),
        # Checks between keys.
        (
            f"{VALVE}.centre_v",
            "0.0",
            f"{VALVE}.centre_v: 0.0 V is not between min_v 0.0 V and max_v 9.9996 V",
        ),
        (
            f"{VALVE}.centre_v",
            "9.9996",
            f"{VALVE}.centre_v: 9.9996 V is not between min_v 0.0 V and max_v 9.9996 V",
        ),
        (f"{VALVE}.min_v", "5.5", f"{VALVE}.centre_v: 5.0 V is not between min_v 5.5 V and max_v 9.9996 V"),
        (
            f"{VALVE}.max_v",
            "10.0",
            f"{VALVE}.max_v: 10.0 V exceeds 9.99969 V, the largest voltage that a frame can carry (arm.dbc)",
        ),
        (
            f"{POT}.max_v",
            "10.0",
            f"{POT}.max_v: 10.0 V exceeds 9.99969 V, the largest voltage that a frame can carry (arm.dbc)",
        ),
        (f"{POT}.min_v", "9.9", f"{POT}: min_v 9.9 V is not under max_v 9.9 V"),
        (f"{POT}.y_at_0v", "0.165", f"{POT}: y_at_0v and y_at_10v are both 0.165"),
        ("axes.vertical.min_y", "0.15", "axes.vertical: min_y 0.15 is not under max_y 0.15"),
        (
            "axes.vertical.min_y",
            "-0.17",
            "axes.vertical.min_y: -0.17 m is -0.152 V at the potentiometer, outside its 0.1 to 9.9 V",
        ),
        (
            "axes.rotation.max_y",
            "1.6499",
            "axes.rotation.max_y: 1.6499 rad is 10.000 V at the potentiometer, outside its 0.1 to 9.9 V",
        ),
        (
            "gateway.heartbeat_interval_s",
            "0.3024",
            "dac.heartbeat_timeout_s: 0.3024 s does not exceed the 0.3024 s between heartbeats of the "
            "gateway (gateway.heartbeat_interval_s in whole periods): the board would count the gateway as "
            "lost",
        ),
    ],
)
def test_an_error_names_path_value_and_limit(key: str, literal: str, text: str) -> None:
    assert refusal(rig_text({key: literal})) == f"my.toml: {text}"


TABLES = "Valid keys: loop, gateway, adc, dac, axes, bus, calibration, emergency_stop, enable"


@pytest.mark.parametrize(
    ("line", "instead", "text"),
    [
        (
            "[loop]",
            "[loop]\nperiod = 1",
            "loop: unknown key period; did you mean period_s? Valid keys: period_s, poll_before_deadline_s, "
            "poll_for_sample_s, required_rights",
        ),
        (
            "# max_speed = ",
            "max_speed = ",
            "axes.vertical: unknown key max_speed; it belongs under [axes.vertical.envelope]: is the line "
            "[axes.vertical.envelope] still a comment?",
        ),
        (
            "# jog_max_v = ",
            "jog_max_v = ",
            "axes.vertical: unknown key jog_max_v; it belongs under [axes.vertical.operator]: is the line "
            "[axes.vertical.operator] still a comment?",
        ),
        ("[loop]", "[lop]\n[loop]", f"unknown key lop; did you mean loop? {TABLES}"),
        (
            "centre_v = ",
            "center_v = ",
            "axes.vertical.valve: unknown key center_v; did you mean centre_v? "
            "Valid keys: channel, centre_v, min_v, max_v, max_rate_v_s",
        ),
        ("min_y = ", "# min_y = ", "axes.vertical: missing key min_y"),
        ("heartbeat_interval_s = ", "# ", "gateway: missing key heartbeat_interval_s"),
        ("heartbeat_timeout_s = ", "# ", "adc: missing key heartbeat_timeout_s"),
    ],
)
def test_unknown_and_missing_keys_are_refused(line: str, instead: str, text: str) -> None:
    assert line in EXAMPLE
    assert refusal(EXAMPLE.replace(line, instead, 1)) == f"my.toml: {text}"


def test_a_key_that_is_given_twice_because_its_table_is_a_comment() -> None:
    text = EXAMPLE.replace("# min_y = -0.1617", "min_y = -0.1617", 1)
    assert refusal(text).endswith("; is the line [axes.vertical.envelope] above it still a comment?")
    twice = EXAMPLE.replace(
        "[axes.vertical.potentiometer]\n", "[axes.vertical.potentiometer]\nchannel = 2\n", 1
    )
    assert "given twice" in refusal(twice)
    assert "comment" not in refusal(twice)


@pytest.mark.parametrize("part", ["potentiometer", "valve"])
def test_two_axes_on_one_channel_are_refused(part: str) -> None:
    text = EXAMPLE.replace(f"[axes.horizontal.{part}]\nchannel = 2", f"[axes.horizontal.{part}]\nchannel = 1")
    assert refusal(text) == f"my.toml: axes.horizontal.{part}.channel: channel 1 is taken by axes.vertical"


@pytest.mark.parametrize(
    ("key", "literal"),
    [
        ("loop.period_s", "0.001"),
        ("gateway.heartbeat_interval_s", "0.2912"),
        (f"{VALVE}.max_v", repr(MAX_WIRE_V)),
        (f"{POT}.max_v", repr(MAX_WIRE_V)),
        (f"{VALVE}.centre_v", repr(VOLTS_PER_COUNT)),
        (f"{VALVE}.min_v", repr(5.0 - VOLTS_PER_COUNT)),
        (f"{VALVE}.max_v", repr(5.0 + VOLTS_PER_COUNT)),
        ("axes.vertical.min_y", "-0.1616"),
        (f"{VALVE}.max_rate_v_s", "1e-9"),
        ("dac.apply", '"at once"'),
    ],
)
def test_the_limits_themselves_are_allowed(key: str, literal: str) -> None:
    assert isinstance(read_rig(rig_text({key: literal}), "my.toml"), Rig)


def test_an_axis_may_reach_exactly_what_its_potentiometer_may() -> None:
    changes = {f"{POT}.y_at_0v": "0", f"{POT}.y_at_10v": "10", f"{POT}.min_v": "1", f"{POT}.max_v": "9"}
    axis = {"axes.vertical.min_y": "1", "axes.vertical.max_y": "9"}
    rig = read_rig(rig_text(changes | axis), "my.toml")
    assert (rig.axes["vertical"].min_y, rig.axes["vertical"].max_y) == (1.0, 9.0)


def test_a_rig_is_frozen() -> None:
    rig = read_rig(EXAMPLE, "my.toml")
    axis = rig.axes["vertical"]
    for table in (
        rig,
        rig.loop,
        rig.bus,
        rig.gateway,
        rig.adc,
        rig.dac,
        axis,
        axis.potentiometer,
        axis.valve,
    ):
        for field in table.__struct_fields__:
            with pytest.raises(AttributeError):
                setattr(table, field, getattr(table, field))


@pytest.mark.parametrize("key", [f"{VALVE}.min_v", f"{VALVE}.max_v"])
def test_the_centre_is_at_least_one_count_from_either_limit(key: str) -> None:
    almost = 5.0 - 0.999 * VOLTS_PER_COUNT if key.endswith("min_v") else 5.0 + 0.999 * VOLTS_PER_COUNT
    assert f"{VALVE}.centre_v" in refusal(rig_text({key: repr(almost)}))


def test_a_rig_has_one_to_three_axes() -> None:
    head = EXAMPLE[: EXAMPLE.index("[axes.vertical]")]
    assert refusal(head) == "my.toml: missing key axes"
    assert refusal(head + "[axes]\n") == "my.toml: axes has 0 keys, but must have at least 1"
    fourth = EXAMPLE[EXAMPLE.index("[axes.rotation]") :].replace("rotation", "gripper")
    assert refusal(EXAMPLE + fourth) == (
        "my.toml: axes: vertical, horizontal, rotation, gripper: the boards have channels for 3 axes, not 4"
    )


def test_a_misspelt_table_of_an_axis_is_reported_with_what_then_is_missing() -> None:
    """The other tables, whose name is right, make an axis too."""
    axis_keys = "unit, setpoint, controller, min_y, max_y"
    assert refusal(EXAMPLE.replace("[axes.rotation]", "[axis.rotation]")).splitlines() == [
        f"my.toml: unknown key axis; did you mean axes? {TABLES}",
        f"my.toml: axes.rotation: missing keys {axis_keys}",
    ]
    assert refusal(EXAMPLE.replace("[axes.rotation]", "[axes.rotatoin]")).splitlines() == [
        "my.toml: axes.rotatoin: missing keys potentiometer, valve",
        f"my.toml: axes.rotation: missing keys {axis_keys}",
    ]


@pytest.mark.parametrize("name", ["", "../etc", "a b", "é", "1st", "a.b", "a=b", "a\\n"])
def test_an_axis_name_that_cannot_name_files_and_topics_is_refused(name: str) -> None:
    text = EXAMPLE.replace("axes.horizontal", f'axes."{name}"')
    assert "cannot be the name of an axis" in refusal(text)


@pytest.mark.parametrize("name", ["z", "Axis_2"])
def test_plain_axis_names_are_accepted(name: str) -> None:
    assert name in read_rig(EXAMPLE.replace("horizontal", name), "r").axes


class TestPotentiometer:
    POT = Potentiometer(channel=1, y_at_0v=-0.165, y_at_10v=0.165, min_v=0.1, max_v=9.9)
    FALLING = Potentiometer(channel=1, y_at_0v=1.65, y_at_10v=-1.65, min_v=0.1, max_v=9.9)

    @pytest.mark.parametrize(("volts", "position"), [(0.0, -0.165), (5.0, 0.0), (10.0, 0.165), (7.5, 0.0825)])
    def test_position_is_linear_in_the_voltage(self, volts: float, position: float) -> None:
        assert self.POT.position(volts) == pytest.approx(position, abs=1e-15)
        assert self.FALLING.position(volts) == pytest.approx(-10 * position, abs=1e-14)

    @given(st.floats(0.0, 10.0))
    def test_volts_is_the_inverse_of_position(self, volts: float) -> None:
        for pot in (self.POT, self.FALLING):
            assert pot.volts(pot.position(volts)) == pytest.approx(volts, abs=1e-12)


LINES = EXAMPLE_RIG.splitlines()
KEYS = [number for number, line in enumerate(LINES) if "=" in line.split("#")[0]]
literals = (
    st.sampled_from(
        ["nan", "inf", "-inf", "true", '""', "[]", "{}", "1979-05-27", "07:32:00", "0x7f", "1e400", "-0.0"]
    )
    | st.integers().map(str)
    | st.floats(allow_nan=False, allow_infinity=False).map(repr)
    | st.floats(-11, 11).map(repr)
    | st.sampled_from([f"{MAX_WIRE_V!r}", "10.0", "9.9997", "5.0", "0.1", "3", "1", "2"])
    | st.text(max_size=8).map(lambda text: f'"{text}"')
)
other_values = st.tuples(st.sampled_from(KEYS), literals).map(
    lambda chosen: (chosen[0], f"{LINES[chosen[0]].split('=')[0]}= {chosen[1]}")
)
other_lines = st.tuples(st.integers(0, len(LINES) - 1), st.sampled_from([*LINES, ""]) | st.text(max_size=20))


def is_valid(rig: Rig) -> bool:
    """Return True if the rig has the properties that the core relies on."""
    for axis in rig.axes.values():
        valve, pot = axis.valve, axis.potentiometer
        if not 0.0 <= valve.min_v < valve.centre_v < valve.max_v < 10.0:
            return False
        if not (0.0 <= pot.min_v < pot.max_v < 10.0 and math.isfinite(valve.max_rate_v_s)):
            return False
        if not all(pot.min_v <= pot.volts(y) <= pot.max_v for y in (axis.min_y, axis.max_y)):
            return False
    channels = [axis.valve.channel for axis in rig.axes.values()]
    return len(set(channels)) == len(channels) and rig.loop.period_ns >= 1_000_000


@given(st.lists(other_values | other_lines, min_size=1, max_size=3))
@example([(KEYS[0], "period_s = " + "1" * 5000)])
@example([(KEYS[0], "period_s = 0x" + "f" * 5000)])
@example([(KEYS[0], "period_s" + ".a" * 300 + " = 1")])
def test_a_changed_file_is_a_valid_rig_or_refused(changes: list[tuple[int, str]]) -> None:
    lines = list(LINES)
    for number, line in changes:
        lines[number] = line
    try:
        rig = read_rig("\n".join(lines), "rig.toml")
    except DocumentError as error:
        assert str(error).startswith("rig.toml: ")
    else:
        assert is_valid(rig)
