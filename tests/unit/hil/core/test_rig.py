"""The rig file: the shipped example, every cross-check, and texts that nobody would write."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.gateway_bench import EXAMPLE_RIG, rig_text

from hil.core.errors import DocumentError
from hil.core.rig import HIGHEST_WIRE_V, VOLTS_PER_COUNT, Potentiometer, Rig, read_rig

EXAMPLE = rig_text()


def refusal(text: str) -> str:
    with pytest.raises(DocumentError) as caught:
        read_rig(text, "my.toml")
    return str(caught.value)


class TestTheExample:
    def test_it_loads_with_the_papers_loop_and_three_axes(self) -> None:
        rig = read_rig(EXAMPLE_RIG, "rig.toml")
        assert rig.loop.period_ns == 11_200_000
        assert [(name, axis.unit) for name, axis in rig.axes.items()] == [
            ("vertical", "m"),
            ("horizontal", "m"),
            ("rotation", "rad"),
        ]
        assert rig.bus.channel == "sim"
        assert rig.dac.apply == "at sync"

    def test_the_bus_may_be_left_out(self) -> None:
        text = re.sub(r"\[bus\]\n.*\n", "", EXAMPLE)
        assert "[bus]" not in text
        assert read_rig(text, "rig.toml").bus.channel == "sim"

    def test_axes_keep_the_files_order(self) -> None:
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
        "dac.watchdog_periods": "2",
        "gateway.heartbeat_periods": "1",
        "adc.heartbeat_timeout_periods": "10",
        "dac.heartbeat_timeout_periods": "10",
    }
    assert read_rig(rig_text(changes), "r").loop.period_ns == period_ns


@pytest.mark.parametrize(
    ("key", "longest", "limit_s"),
    [
        ("adc.stale_after_periods", 178, 2),
        ("dac.watchdog_periods", 178, 2),
        ("adc.heartbeat_timeout_periods", 892, 10),
        ("dac.heartbeat_timeout_periods", 892, 10),
    ],
)
def test_no_time_out_is_longer_than_an_arm_may_be_left_alone(key: str, longest: int, limit_s: int) -> None:
    more = {"dac.watchdog_periods": "1000"} if key == "adc.stale_after_periods" else {}
    enough = {"dac.watchdog_periods": "178"} if key == "adc.stale_after_periods" else {}
    read_rig(rig_text(enough | {key: str(longest - 1)}), "r")
    assert refusal(rig_text(more | {key: str(longest + 1)})) == (
        f"my.toml: {key}: {longest + 1} periods of 0.0112 s are {(longest + 1) * 0.0112:g} s, "
        f"more than {limit_s} s"
    )


@pytest.mark.parametrize(("stale", "is_refused"), [(4, False), (5, True), (6, True)])
def test_the_board_waits_for_longer_than_the_gateway(stale: int, is_refused: bool) -> None:
    """Else it centres the valves while the gateway takes them to hold."""
    text = rig_text({"adc.stale_after_periods": str(stale), "dac.watchdog_periods": "5"})
    if is_refused:
        assert refusal(text) == (
            f"my.toml: dac.watchdog_periods: 5 does not exceed adc.stale_after_periods {stale}: the board "
            "would centre its valves behind the gateway's back"
        )
    else:
        read_rig(text, "r")


POT, VALVE = "axes.vertical.potentiometer", "axes.vertical.valve"


@pytest.mark.parametrize(
    ("key", "literal", "text"),
    [
        ("loop.period_s", "0.0009", "loop.period_s: 0.0009: expected `float` >= 0.001"),
        ("loop.period_s", "1.1", "loop.period_s: 1.1: expected `float` <= 1.0"),
        ("loop.period_s", "nan", "loop.period_s: nan is not a finite number"),
        ("loop.period_s", '"11.2 ms"', "loop.period_s: '11.2 ms': expected `float`, got `str`"),
        ("bus.channel", "0", "bus.channel: 0: expected `str`, got `int`"),
        ("gateway.heartbeat_periods", "0", "gateway.heartbeat_periods: 0: expected `int` >= 1"),
        ("adc.stale_after_periods", "0", "adc.stale_after_periods: 0: expected `int` >= 1"),
        ("adc.stale_after_periods", "2.5", "adc.stale_after_periods: 2.5: expected `int`, got `float`"),
        ("adc.protected", "1", "adc.protected: 1: expected `bool`, got `int`"),
        ("dac.watchdog_periods", "1001", "dac.watchdog_periods: 1001: expected `int` <= 1000"),
        ("dac.apply", '"later"', "dac.apply: 'later': must be 'at once' or 'at sync'"),
        ("axes.vertical.unit", '"mm"', "axes.vertical.unit: 'mm': must be 'm' or 'rad'"),
        ("axes.rotation.unit", '"deg"', "axes.rotation.unit: 'deg': must be 'm' or 'rad'"),
        (f"{POT}.channel", "4", f"{POT}.channel: 4: expected `int` <= 3"),
        (f"{VALVE}.channel", "0", f"{VALVE}.channel: 0: expected `int` >= 1"),
        (f"{POT}.max_v", "10.1", f"{POT}.max_v: 10.1: expected `float` <= 10.0"),
        (f"{VALVE}.min_v", "-0.1", f"{VALVE}.min_v: -0.1: expected `float` >= 0.0"),
        (f"{VALVE}.max_rate_v_s", "0", f"{VALVE}.max_rate_v_s: 0: expected `float` > 0.0"),
        (f"{VALVE}.max_rate_v_s", "inf", f"{VALVE}.max_rate_v_s: inf is not a finite number"),
        (f"{POT}.y_at_10v", "nan", f"{POT}.y_at_10v: nan is not a finite number"),
        # Cross-checks.
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
            f"{VALVE}.max_v: 10.0 V exceeds 9.99969 V, the most that a frame can carry (arm.dbc)",
        ),
        (
            f"{POT}.max_v",
            "10.0",
            f"{POT}.max_v: 10.0 V exceeds 9.99969 V, the most that a frame can carry (arm.dbc)",
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
            "gateway.heartbeat_periods",
            "27",
            "dac.heartbeat_timeout_periods: 27 does not exceed gateway.heartbeat_periods 27: "
            "the board would miss every heartbeat",
        ),
    ],
)
def test_what_does_not_fit_is_refused_with_path_value_and_limit(key: str, literal: str, text: str) -> None:
    assert refusal(rig_text({key: literal})) == f"my.toml: {text}"


@pytest.mark.parametrize(
    ("line", "instead", "text"),
    [
        ("[loop]", "[loop]\nperiod = 1", "loop: object contains unknown field `period`"),
        ("[loop]", "[lop]\n[loop]", "object contains unknown field `lop`"),
        ("centre_v = ", "center_v = ", "axes.vertical.valve: object contains unknown field `center_v`"),
        ("min_y = ", "# min_y = ", "axes.vertical: object missing required field `min_y`"),
        ("heartbeat_periods = ", "# ", "gateway: object missing required field `heartbeat_periods`"),
    ],
)
def test_unknown_and_missing_keys_are_refused(line: str, instead: str, text: str) -> None:
    assert line in EXAMPLE
    assert refusal(EXAMPLE.replace(line, instead, 1)) == f"my.toml: {text}"


@pytest.mark.parametrize("part", ["potentiometer", "valve"])
def test_two_axes_on_one_channel_are_refused(part: str) -> None:
    text = EXAMPLE.replace(f"[axes.horizontal.{part}]\nchannel = 2", f"[axes.horizontal.{part}]\nchannel = 1")
    assert refusal(text) == f"my.toml: axes.horizontal.{part}.channel: channel 1 is taken by axes.vertical"


@pytest.mark.parametrize(
    ("key", "literal"),
    [
        ("loop.period_s", "0.001"),
        ("gateway.heartbeat_periods", "26"),
        (f"{VALVE}.max_v", repr(HIGHEST_WIRE_V)),
        (f"{POT}.max_v", repr(HIGHEST_WIRE_V)),
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


def test_a_rig_cannot_be_changed() -> None:
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
def test_the_centre_is_a_whole_count_from_either_limit(key: str) -> None:
    almost = 5.0 - 0.999 * VOLTS_PER_COUNT if key.endswith("min_v") else 5.0 + 0.999 * VOLTS_PER_COUNT
    assert f"{VALVE}.centre_v" in refusal(rig_text({key: repr(almost)}))


def test_one_to_three_axes() -> None:
    head = EXAMPLE[: EXAMPLE.index("[axes.vertical]")]
    assert refusal(head) == "my.toml: object missing required field `axes`"
    assert refusal(head + "[axes]\n").startswith("my.toml: axes: expected `object` of length >= 1")
    fourth = EXAMPLE[EXAMPLE.index("[axes.rotation]") :].replace("rotation", "gripper")
    assert refusal(EXAMPLE + fourth) == (
        "my.toml: axes: vertical, horizontal, rotation, gripper: the boards have channels for 3 axes, not 4"
    )


def test_a_table_of_an_axis_whose_name_is_misspelt_is_named() -> None:
    """Its other tables, of the right name, make an axis too."""
    text = EXAMPLE.replace("[axes.rotation]", "[axes.rotatoin]")
    assert re.fullmatch(
        r"my\.toml: axes\.(rotatoin: object missing required field `potentiometer`"
        r"|rotation: object missing required field `unit`)",
        refusal(text),
    )


@pytest.mark.parametrize("name", ["", "../etc", "a b", "é", "1st", "a.b", "a=b", "a\\n"])
def test_an_axis_name_that_cannot_name_files_and_topics_is_refused(name: str) -> None:
    text = EXAMPLE.replace("axes.horizontal", f'axes."{name}"')
    assert "is no name for an axis" in refusal(text)


@pytest.mark.parametrize("name", ["z", "Axis_2"])
def test_plain_axis_names_are_taken(name: str) -> None:
    assert name in read_rig(EXAMPLE.replace("horizontal", name), "r").axes


class TestPotentiometer:
    POT = Potentiometer(channel=1, y_at_0v=-0.165, y_at_10v=0.165, min_v=0.1, max_v=9.9)
    FALLING = Potentiometer(channel=1, y_at_0v=1.65, y_at_10v=-1.65, min_v=0.1, max_v=9.9)

    @pytest.mark.parametrize(("volts", "position"), [(0.0, -0.165), (5.0, 0.0), (10.0, 0.165), (7.5, 0.0825)])
    def test_position_is_linear_in_the_voltage(self, volts: float, position: float) -> None:
        assert self.POT.position(volts) == pytest.approx(position, abs=1e-15)
        assert self.FALLING.position(volts) == pytest.approx(-10 * position, abs=1e-14)

    @given(st.floats(0.0, 10.0))
    def test_voltage_is_its_inverse(self, volts: float) -> None:
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
    | st.sampled_from([f"{HIGHEST_WIRE_V!r}", "10.0", "9.9997", "5.0", "0.1", "3", "1", "2"])
    | st.text(max_size=8).map(lambda text: f'"{text}"')
)
other_values = st.tuples(st.sampled_from(KEYS), literals).map(
    lambda chosen: (chosen[0], f"{LINES[chosen[0]].split('=')[0]}= {chosen[1]}")
)
other_lines = st.tuples(st.integers(0, len(LINES) - 1), st.sampled_from([*LINES, ""]) | st.text(max_size=20))


def is_sound(rig: Rig) -> bool:
    """What the core relies on."""
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
def test_a_changed_file_is_a_sound_rig_or_refused(changes: list[tuple[int, str]]) -> None:
    lines = list(LINES)
    for number, line in changes:
        lines[number] = line
    try:
        rig = read_rig("\n".join(lines), "rig.toml")
    except DocumentError as error:
        assert str(error).startswith("rig.toml: ")
    else:
        assert is_sound(rig)
