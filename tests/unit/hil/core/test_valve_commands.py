"""Limits of magnitude and rate, centring, channels, counter and CRC of every RPDO1_DAC frame."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.constants import PERIOD_S
from support.gateway_bench import commands_v, rig_text
from support.wire import frame_crc

import hil
from hil.core.errors import DocumentError
from hil.core.frames import Frame
from hil.core.rig import MAX_RATE_V_S, MAX_WIRE_V, VOLTS_PER_COUNT, Valve, read_rig
from hil.core.valve_commands import ValveCommands
from hil.core.wire import codec
from hil.core.wire.frame_crc import FrameCrc

TINY = 1e-9


CRC = FrameCrc(codec.RPDO1_DAC, 2)


def valve(
    channel: int = 1,
    centre_v: float = 5.0,
    min_v: float = 0.0,
    max_v: float = 9.9996,
    max_rate_v_s: float = 400.0,
) -> Valve:
    return Valve(channel=channel, centre_v=centre_v, min_v=min_v, max_v=max_v, max_rate_v_s=max_rate_v_s)


def one_valve(**limits: float) -> ValveCommands:
    return ValveCommands([valve(**limits)], PERIOD_S, CRC)  # type: ignore[arg-type]


def is_allowed(limits: Valve) -> bool:
    """Whether a rig file may have these limits: a frame can carry them, and the centre is a count inside."""
    lowest, highest = limits.min_v + VOLTS_PER_COUNT, limits.max_v - VOLTS_PER_COUNT
    return lowest <= limits.centre_v <= highest and limits.max_v <= MAX_WIRE_V


class TestMagnitude:
    def test_an_offset_inside_the_limits_is_unchanged(self) -> None:
        commands = one_valve()
        assert commands.command(0, 1.2345) == 1.2345
        assert commands.volts == [6.2345]
        assert commands_v(commands.frame())[0] == pytest.approx(6.2345, abs=VOLTS_PER_COUNT / 2)

    @pytest.mark.parametrize(
        ("offset", "allowed"),
        [(2.0, 2.0), (2.5, 2.5), (2.5001, 2.5), (1e300, 2.5), (-1.0, -1.0), (-1.5, -1.5), (-1e300, -1.5)],
    )
    def test_an_offset_beyond_the_limits_is_limited(self, offset: float, allowed: float) -> None:
        commands = one_valve(min_v=3.5, max_v=7.5, max_rate_v_s=1e9)
        assert commands.command(0, offset) == pytest.approx(allowed, abs=VOLTS_PER_COUNT)
        (volts, *_) = commands_v(commands.frame())
        assert 3.5 <= volts <= 7.5
        assert volts == pytest.approx(5.0 + allowed, abs=VOLTS_PER_COUNT)

    @pytest.mark.parametrize(
        ("min_v", "max_v", "lowest", "highest"),
        [(0.0, MAX_WIRE_V, 0, 32767), (1.0001, 8.9999, 3278, 29490), (2.5, 7.5, 8192, 24576)],
    )
    def test_rounding_to_counts_stays_inside_the_limits(
        self, min_v: float, max_v: float, lowest: int, highest: int
    ) -> None:
        commands = one_valve(min_v=min_v, max_v=max_v, max_rate_v_s=1e9)
        for offset, counts in ((-99.0, lowest), (99.0, highest)):
            commands.command(0, offset)
            (volts, *_) = commands_v(commands.frame())
            assert volts / VOLTS_PER_COUNT == counts
            assert min_v <= volts <= max_v


class TestRate:
    def test_a_step_is_spread_over_periods(self) -> None:
        commands = one_valve(max_rate_v_s=100.0)  # 1.12 V a period
        steps = [commands.command(0, 3.0) for _ in range(4)]
        assert steps == pytest.approx([1.12, 2.24, 3.0, 3.0])

    def test_the_rate_limit_acts_downwards_too(self) -> None:
        commands = one_valve(max_rate_v_s=100.0)
        assert [commands.command(0, -3.0) for _ in range(3)] == pytest.approx([-1.12, -2.24, -3.0])
        assert commands.command(0, 3.0) == pytest.approx(-1.88)

    def test_a_change_at_exactly_the_rate_is_unchanged(self) -> None:
        commands = one_valve(max_rate_v_s=100.0)
        assert commands.command(0, 100.0 * PERIOD_S) == 100.0 * PERIOD_S

    def test_the_rate_counts_from_the_limited_command(self) -> None:
        commands = one_valve(max_v=6.0, max_rate_v_s=100.0)
        for _ in range(10):
            commands.command(0, 50.0)
        assert commands.command(0, 0.0) == pytest.approx(0.0)

    def test_a_rate_below_a_count_per_period_still_moves_the_valve(self) -> None:
        commands = one_valve(max_rate_v_s=VOLTS_PER_COUNT / PERIOD_S / 4)
        moved = [commands_v((commands.command(0, 5.0), commands.frame())[1])[0] for _ in range(9)]
        assert moved[-1] == pytest.approx(5.0 + 2 * VOLTS_PER_COUNT)


class TestCentre:
    def test_centring_ignores_the_rate_limit(self) -> None:
        commands = one_valve(max_rate_v_s=1.0)
        for _ in range(500):
            commands.command(0, 4.0)
        assert commands_v(commands.frame())[0] > 8.9
        commands.centre()
        assert commands_v(commands.frame())[0] == 5.0

    def test_the_next_command_starts_at_the_centre(self) -> None:
        commands = one_valve(max_rate_v_s=100.0)
        commands.command(0, 1.0)
        commands.centre()
        assert commands.command(0, -5.0) == pytest.approx(-1.12)

    def test_before_any_command_every_valve_is_centred(self) -> None:
        commands = ValveCommands([valve(2, centre_v=4.5), valve(1, centre_v=5.5)], PERIOD_S, CRC)
        assert commands.volts == [4.5, 5.5]
        assert commands_v(commands.frame()) == pytest.approx((5.5, 4.5, 5.0), abs=VOLTS_PER_COUNT / 2)

    def test_a_command_moves_only_its_own_valve(self) -> None:
        commands = ValveCommands([valve(1), valve(2), valve(3)], PERIOD_S, CRC)
        commands.command(1, 2.0)
        assert commands_v(commands.frame()) == pytest.approx((5.0, 7.0, 5.0), abs=VOLTS_PER_COUNT / 2)
        assert commands.volts == [5.0, 7.0, 5.0]


class TestChangeTime:
    """100 V/s is 1.12 V in a period."""

    @pytest.mark.parametrize(
        ("elapsed_s", "allowed_v"),
        [(-1.0, 0.0), (0.0, 0.0), (PERIOD_S / 2, 0.56), (PERIOD_S, 1.12), (1.0, 1.12)],
    )
    def test_the_change_follows_the_elapsed_time_up_to_one_period(
        self, elapsed_s: float, allowed_v: float
    ) -> None:
        commands = one_valve(max_rate_v_s=100.0)
        commands.set_change_time(elapsed_s)
        assert commands.command(0, 3.0) == pytest.approx(allowed_v)


def voltages(frame: Frame) -> float:
    return commands_v(frame)[0]


class TestRefusal:
    """25 V/s is 0.28 V in a period."""

    @pytest.mark.parametrize("protected", [True, False])
    @pytest.mark.parametrize("refusals", [1, 4, 20])
    def test_the_rate_limit_starts_from_the_last_command_that_was_taken(
        self, refusals: int, protected: bool
    ) -> None:
        commands = ValveCommands([valve(max_rate_v_s=25.0)], PERIOD_S, CRC if protected else None)
        commands.command(0, 4.0)
        assert voltages(commands.frame()) == pytest.approx(5.28, abs=VOLTS_PER_COUNT)
        for _ in range(refusals):
            commands.command(0, 4.0)
            commands.refused(commands.frame())
        assert commands.command(0, 4.0) == pytest.approx(0.56)

    def test_if_no_command_was_ever_taken_the_rate_limit_starts_from_the_centre(self) -> None:
        commands = one_valve(max_rate_v_s=25.0)
        for _ in range(6):
            commands.command(0, 4.0)
            commands.refused(commands.frame())
        assert commands.command(0, 4.0) == pytest.approx(0.28)

    @pytest.mark.parametrize("protected", [True, False])
    @pytest.mark.parametrize(
        ("refused", "starts_from_v"), [((0,), 0.0), ((1,), 0.0), ((0, 1), 0.28), ((), 0.0)]
    )
    def test_two_centring_commands_in_one_output_are_refused_one_by_one(
        self, refused: Sequence[int], starts_from_v: float, protected: bool
    ) -> None:
        commands = ValveCommands([valve(max_rate_v_s=25.0)], PERIOD_S, CRC if protected else None)
        commands.command(0, 4.0)
        commands.frame()
        centring = []
        for _ in range(2):
            commands.centre()
            centring.append(commands.frame())
        for number in refused:
            commands.refused(centring[number])
        assert commands.command(0, 4.0) == pytest.approx(starts_from_v + 0.28)

    def test_if_the_first_of_two_commands_is_refused_the_second_counts(self) -> None:
        commands = one_valve(max_rate_v_s=25.0)
        commands.command(0, 4.0)
        first = commands.frame()
        commands.centre()
        commands.frame()
        commands.refused(first)
        assert commands.volts == [5.0]

    @given(st.lists(st.tuples(st.floats(-5.0, 5.0), st.booleans()), max_size=60), st.booleans())
    @settings(deadline=None)
    def test_the_bus_never_gets_a_larger_step_than_the_rate_allows(
        self, wanted: list[tuple[float, bool]], protected: bool
    ) -> None:
        commands = ValveCommands([valve(max_rate_v_s=25.0)], PERIOD_S, CRC if protected else None)
        on_bus_v = 5.0
        for offset_v, is_taken in wanted:
            commands.command(0, offset_v)
            frame = commands.frame()
            if not is_taken:
                commands.refused(frame)
                continue
            assert abs(voltages(frame) - on_bus_v) <= 0.28 + VOLTS_PER_COUNT + TINY
            on_bus_v = voltages(frame)


class TestFrame:
    @pytest.mark.parametrize("channels", [(1,), (2,), (3,), (3, 1), (2, 3)])
    def test_unused_channels_are_centred(self, channels: Sequence[int]) -> None:
        commands = ValveCommands([valve(channel) for channel in channels], PERIOD_S, CRC)
        for index in range(len(channels)):
            commands.command(index, 1.0 + index)
        volts = commands_v(commands.frame())
        for channel in (1, 2, 3):
            expected = 6.0 + channels.index(channel) if channel in channels else 5.0
            assert volts[channel - 1] == pytest.approx(expected, abs=VOLTS_PER_COUNT / 2)

    def test_counter_and_crc(self) -> None:
        commands = one_valve()
        for k in range(600):
            frame = commands.frame()
            assert (frame.id, len(frame.data)) == (codec.RPDO1_DAC, 8)
            assert frame.data[6] == k & 0xFF
            assert frame.data[7] == frame_crc(0x220, frame.data[:7])
            assert frame == Frame(codec.RPDO1_DAC, frame.data)  # neither extended nor remote

    def test_an_unprotected_frame_has_the_voltages_only(self) -> None:
        protected = ValveCommands([valve()], PERIOD_S, CRC)
        unprotected = ValveCommands([valve()], PERIOD_S, None)
        for commands in (protected, unprotected):
            commands.command(0, 1.0)
        assert unprotected.frame() == Frame(codec.RPDO1_DAC, protected.frame().data[:6])


def any_valves() -> st.SearchStrategy[Valve]:
    volts = st.floats(0.0, 10.0) | st.integers(0, 32768).map(lambda n: n * VOLTS_PER_COUNT)
    rates = st.floats(1e-3, 1e6) | st.sampled_from([VOLTS_PER_COUNT / PERIOD_S, 400.0, 5e-324, 1e308])
    return st.tuples(st.tuples(volts, volts, volts).map(sorted), st.integers(1, 3), rates).map(
        lambda drawn: valve(drawn[1], drawn[0][1], drawn[0][0], drawn[0][2], drawn[2])
    )


@given(any_valves())
@settings(max_examples=30)
def test_the_rig_file_accepts_exactly_the_allowed_limits(limits: Valve) -> None:
    keys = {f"axes.vertical.valve.{key}": repr(getattr(limits, key)) for key in Valve.__struct_fields__}
    text = rig_text(keys, axes=("vertical",))
    if is_allowed(limits) and limits.max_rate_v_s <= MAX_RATE_V_S:
        assert read_rig(text, "rig.toml").axes["vertical"].valve == limits
    else:
        with pytest.raises(DocumentError, match=r"axes\.vertical\.valve"):
            read_rig(text, "rig.toml")


offsets = (
    st.floats(allow_nan=False, allow_infinity=False)
    | st.floats(-10, 10)
    | st.sampled_from([0.0, 5.0, -5.0, 1e308, -1e308])
)


@given(any_valves().filter(is_allowed), st.lists(offsets | st.none(), min_size=1, max_size=30), st.booleans())
@settings(max_examples=300)
def test_no_sequence_of_offsets_leaves_the_limits(
    limits: Valve, asked: list[float | None], protected: bool
) -> None:
    """None stands for centring, which may be any step. Other commands keep the rate limit, to one count."""
    commands = ValveCommands([limits], PERIOD_S, CRC if protected else None)
    before = commands_v(commands.frame())[limits.channel - 1]
    for offset in asked:
        if offset is None:
            commands.centre()
            allowed = 0.0
        else:
            allowed = commands.command(0, offset)
        sent = commands_v(commands.frame())[limits.channel - 1]
        assert limits.min_v - TINY <= sent <= limits.max_v + TINY
        assert abs(sent - (limits.centre_v + allowed)) <= VOLTS_PER_COUNT / 2 + TINY
        if offset is not None:
            assert abs(sent - before) <= limits.max_rate_v_s * PERIOD_S + VOLTS_PER_COUNT + TINY
        before = sent


class TestNoOtherModuleMakesCommands:
    """Only hil/core/valve_commands.py encodes RPDO1_DAC or builds a frame with its identifier."""

    SOURCES = sorted(Path(hil.__file__).parent.rglob("*.py"))
    ALLOWED = ("valve_commands.py",)

    @staticmethod
    def offences(tree: ast.AST) -> list[str]:
        found = []
        for node in ast.walk(tree):
            name = getattr(node, "attr", getattr(node, "id", getattr(node, "name", "")))
            if isinstance(node, ast.Attribute | ast.Name | ast.alias) and name == "encode_rpdo1_dac":
                found.append(f"line {getattr(node, 'lineno', '?')}: uses encode_rpdo1_dac")
            if not isinstance(node, ast.Call):
                continue
            called = getattr(node.func, "attr", getattr(node.func, "id", ""))
            if called not in ("Frame", "_replace", "_make"):
                continue
            for argument in [*node.args, *(keyword.value for keyword in node.keywords)]:
                for part in ast.walk(argument):
                    is_named = getattr(part, "attr", getattr(part, "id", "")) == "RPDO1_DAC"
                    if is_named or (isinstance(part, ast.Constant) and part.value == codec.RPDO1_DAC):
                        found.append(f"line {node.lineno}: a frame with the identifier of RPDO1_DAC")
        return found

    def test_no_other_module_makes_a_command(self) -> None:
        assert len(self.SOURCES) > 20
        offenders = {
            str(path): offences
            for path in self.SOURCES
            if path.name not in self.ALLOWED and path.parent.name != "wire"
            if (offences := self.offences(ast.parse(path.read_text())))
        }
        assert offenders == {}

    def test_the_search_finds_valve_commands_itself(self) -> None:
        path = Path(hil.__file__).parent / "core" / "valve_commands.py"
        assert len(self.offences(ast.parse(path.read_text()))) == 3

    @pytest.mark.parametrize(
        "line",
        [
            "frame = Frame(codec.RPDO1_DAC, data)",
            "frame = Frame(id=RPDO1_DAC)",
            "frame = Frame(0x220, data)",
            "frame = frames.Frame(544)",
            "frame = other._replace(id=codec.RPDO1_DAC)",
            "data = codec.encode_rpdo1_dac(5.0, 5.0, 5.0, 0, 0)",
            "from hil.core.wire.codec import encode_rpdo1_dac as harmless",
            "encoders = [encode_rpdo1_dac]",
        ],
    )
    def test_the_search_finds_every_form(self, line: str) -> None:
        assert self.offences(ast.parse(line))
