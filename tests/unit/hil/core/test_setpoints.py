"""Setpoints: each form at its boundaries and at the instants that the core uses, and each error."""

from __future__ import annotations

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.constants import PERIOD_NS

from hil.core.errors import SetpointError
from hil.core.setpoints import FORMS, check_speed, check_within, csv_file, parse_setpoint


def at(text: str, t: float, csv_text: str = "") -> float:
    return parse_setpoint(text, csv_text).at(t)


def below(t: float) -> float:
    return math.nextafter(t, -math.inf)


def core_instants(periods: int, period_ns: int = PERIOD_NS) -> list[float]:
    """Return t of successive periods as the core computes it, from whole nanoseconds."""
    return [k * period_ns / 1e9 for k in range(periods)]


class TestForms:
    @pytest.mark.parametrize(
        ("text", "t", "r"),
        [
            ("step:0.1@1", 0.0, 0.0),
            ("step:0.1@1", below(1.0), 0.0),
            ("step:0.1@1", 1.0, 0.1),
            ("step:0.1@1", 1e6, 0.1),
            ("step:-0.1@0", 0.0, -0.1),
            ("step:+.5@1e-3", 0.001, 0.5),
            ("step:1e-2@2.", 2.0, 0.01),
            ("ladder:0.1,-0.05,0.02@1/2", below(1.0), 0.0),
            ("ladder:0.1,-0.05,0.02@1/2", 1.0, 0.1),
            ("ladder:0.1,-0.05,0.02@1/2", 2.999, 0.1),
            ("ladder:0.1,-0.05,0.02@1/2", 3.0, -0.05),
            ("ladder:0.1,-0.05,0.02@1/2", 5.0, 0.02),
            ("ladder:0.1,-0.05,0.02@1/2", 1e9, 0.02),
            ("ladder:0.1@0/0.001", 0.0, 0.1),
            ("ramp:0.1@1/2", 1.0, 0.0),
            ("ramp:0.1@1/2", 1.5, 0.025),
            ("ramp:0.1@1/2", 3.0, 0.1),
            ("ramp:0.1@1/2", 99.0, 0.1),
            ("minimum-jerk:0.1@1/2", 0.5, 0.0),
            ("minimum-jerk:0.1@1/2", 1.5, 0.1 * (10 / 64 - 15 / 256 + 6 / 1024)),
            ("minimum-jerk:0.1@1/2", 2.0, 0.05),
            ("minimum-jerk:0.1@1/2", 3.0, 0.1),
            ("minimum-jerk:0.1@1/2", 4.0, 0.1),
            ("sine:0.1@1/4", below(1.0), 0.0),
            ("sine:0.1@1/4", 1.0, 0.0),
            ("sine:0.1@1/4", 2.0, 0.1),
            ("sine:0.1@1/4", 4.0, -0.1),
            ("sine:-0.1@1/4", 2.0, -0.1),
            ("0.05", 0.0, 0.05),
            ("-.05", 1e6, -0.05),
            ("+5e-2", 1.0, 0.05),
        ],
    )
    def test_values_of_each_form(self, text: str, t: float, r: float) -> None:
        assert at(text, t) == pytest.approx(r, abs=1e-15)

    def test_minimum_jerk_starts_and_ends_at_rest(self) -> None:
        r = parse_setpoint("minimum-jerk:1@1/2").at
        for t in (1.0, 3.0):
            assert (r(t + 1e-3) - r(t - 1e-3)) / 2e-3 == pytest.approx(0.0, abs=1e-5)
        assert (r(2.001) - r(1.999)) / 2e-3 == pytest.approx(
            1.875 / 2, rel=1e-5
        )  # Flash and Hogan: 15/8 of the mean

    def test_the_text_is_kept(self) -> None:
        assert parse_setpoint("step:0.1@1").text == "step:0.1@1"


class TestAtTheCoresInstants:
    """A time that the text gives in decimals takes effect in the sample at exactly this time."""

    @given(st.integers(0, 100_000))
    @example(100)  # 1.12 s
    def test_a_step_begins_in_its_own_sample(self, k: int) -> None:
        t = f"{k * PERIOD_NS // 100_000}e-4"  # decimals, as a person writes them
        before, on = ((k - 1) * PERIOD_NS / 1e9, k * PERIOD_NS / 1e9)
        r = parse_setpoint(f"step:0.1@{t}").at
        assert (r(before), r(on)) == (0.0, 0.1)

    @pytest.mark.parametrize("period_ns", [11_200_000, 10_000_000, 1_000_000])
    @pytest.mark.parametrize("hold", [1, 5, 7, 10, 25, 30])
    @pytest.mark.parametrize("start", [0, 3, 10, 29])
    def test_every_level_of_a_ladder_begins_in_its_own_sample(
        self, period_ns: int, hold: int, start: int
    ) -> None:
        tenth_ms = period_ns // 100_000
        levels = [round(0.001 * (i + 1), 3) for i in range(40)]
        text = f"ladder:{','.join(map(str, levels))}@{start * tenth_ms}e-4/{hold * tenth_ms}e-4"
        r = parse_setpoint(text).at
        for k, t in enumerate(core_instants(start + 45 * hold, period_ns)):
            expected = 0.0 if k < start else levels[min((k - start) // hold, 39)]
            assert r(t) == expected, (text, k)

    def test_a_ramp_has_its_size_in_the_last_sample(self) -> None:
        assert at("ramp:0.1@0.112/0.224", 30 * PERIOD_NS / 1e9) == pytest.approx(0.1, abs=1e-15)


class TestRange:
    @pytest.mark.parametrize(
        ("text", "min_r", "max_r"),
        [
            ("step:0.1@1", 0.0, 0.1),
            ("step:-0.1@1", -0.1, 0.0),
            ("ladder:0.1,-0.2@0/1", -0.2, 0.1),
            ("ladder:0.1,0.2@0/1", 0.0, 0.2),
            ("ramp:-0.3@0/1", -0.3, 0.0),
            ("minimum-jerk:0.3@0/1", 0.0, 0.3),
            ("sine:0.1@0/1", -0.1, 0.1),
            ("sine:-0.1@0/1", -0.1, 0.1),
            ("0.1", 0.1, 0.1),
        ],
    )
    def test_the_range_of_a_setpoint(self, text: str, min_r: float, max_r: float) -> None:
        setpoint = parse_setpoint(text)
        assert (setpoint.min_r, setpoint.max_r) == (min_r, max_r)

    @given(
        st.sampled_from(
            ["step:{}@1", "ladder:{},{}@0.5/1", "ramp:{}@1/3", "minimum-jerk:{}@1/3", "sine:{}@1/3"]
        ),
        st.floats(-1, 1),
        st.floats(-1, 1),
        st.floats(0, 10),
    )
    def test_a_setpoint_never_leaves_its_range(
        self, form: str, first: float, second: float, t: float
    ) -> None:
        setpoint = parse_setpoint(form.format(f"{first:.6f}", f"{second:.6f}"))
        assert setpoint.min_r - 1e-12 <= setpoint.at(t) <= setpoint.max_r + 1e-12

    def test_the_limits_themselves_are_allowed(self) -> None:
        check_within(parse_setpoint("ladder:-0.15,0.15@0/1"), "vertical", -0.15, 0.15, "m")

    @pytest.mark.parametrize(
        ("text", "said"),
        [
            (
                "step:0.1501@1",
                "vertical: setpoint 'step:0.1501@1' reaches 0.1501 m, beyond 0.15 m "
                "(rig: axes.vertical.max_y)",
            ),
            (
                "step:-0.1501@1",
                "vertical: setpoint 'step:-0.1501@1' reaches -0.1501 m, beyond -0.15 m "
                "(rig: axes.vertical.min_y)",
            ),
            ("sine:0.16@0/1", "reaches -0.16 m, beyond -0.15 m (rig: axes.vertical.min_y)"),
            ("ladder:0.1,1e300@0/1", "reaches 1e+300 m"),
        ],
    )
    def test_a_setpoint_beyond_the_limits_is_refused(self, text: str, said: str) -> None:
        with pytest.raises(SetpointError) as caught:
            check_within(parse_setpoint(text), "vertical", -0.15, 0.15, "m")
        assert said in str(caught.value)

    def test_an_axis_whose_range_lacks_0_refuses_a_setpoint_that_begins_at_0(self) -> None:
        with pytest.raises(SetpointError, match=r"reaches 0 m, beyond 0\.05 m \(rig: axes\.z\.min_y\)"):
            check_within(parse_setpoint("step:0.1@1"), "z", 0.05, 0.15, "m")


class TestSpeed:
    @pytest.mark.parametrize(
        ("text", "speed"),
        [
            ("step:0.1@1", 0.0),
            ("ladder:0.1,-0.1@1/0.001", 0.0),
            ("hold", 0.0),
            ("ramp:-0.1@1/0.5", 0.2),
            ("minimum-jerk:0.1@1/0.5", 0.375),
            ("sine:-0.1@0/2", 0.1 * math.pi),
        ],
    )
    def test_the_largest_speed_between_jumps(self, text: str, speed: float) -> None:
        assert parse_setpoint(text).max_speed == pytest.approx(speed)

    @given(st.sampled_from(["ramp", "minimum-jerk", "sine"]), st.floats(-1, 1), st.floats(0, 6))
    def test_no_form_is_faster_than_it_says(self, kind: str, size: float, t: float) -> None:
        setpoint, dt = parse_setpoint(f"{kind}:{size:.6f}@1/3"), 1e-4
        way = abs(setpoint.at(t + dt) - setpoint.at(t))
        crosses_the_start = t < 1.0 < t + dt
        assert crosses_the_start or way <= setpoint.max_speed * dt + 1e-12

    def test_rows_of_a_table_with_the_same_time_are_a_jump(self) -> None:
        rows = "0,0\n1,0.1\n1,-0.1\n3,0.3\n"
        assert parse_setpoint("csv:r.csv", rows).max_speed == pytest.approx(0.2)

    def test_a_speed_at_the_limit_is_accepted(self) -> None:
        check_speed(parse_setpoint("ramp:0.5@1/0.5"), "vertical", 1.0, "m")

    @pytest.mark.parametrize("text", ["ramp:0.5@1/0.499", "sine:0.1@0/0.001", "csv:r.csv"])
    def test_a_faster_setpoint_is_refused(self, text: str) -> None:
        setpoint = parse_setpoint(text, "0,0\n1e-300,1e-3\n")
        with pytest.raises(SetpointError) as caught:
            check_speed(setpoint, "vertical", 1.0, "m")
        assert str(caught.value) == (
            f"vertical: setpoint {text!r} moves at up to {setpoint.max_speed:.4g} m/s, limit 1 m/s "
            "(rig: axes.vertical.envelope.max_speed); give it more time, or use steps"
        )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "",
            f"setpoint '' is neither a number, such as 0.05, nor one of {', '.join(FORMS.values())}",
        ),
        ("5cm", "setpoint '5cm' is neither a number, such as 0.05, nor one of step:SIZE@TIME"),
        ("nan", "setpoint 'nan' is neither a number, such as 0.05, nor one of step:SIZE@TIME"),
        ("1e400", "setpoint '1e400': 1e400 is not finite"),
        ("step", "setpoint 'step' is not written as step:SIZE@TIME; an example is step:0.1@1"),
        (
            "step:0.1",
            "setpoint 'step:0.1' is not written as step:SIZE@TIME; an example is step:0.1@1; a position that "
            "stays is a number alone, such as 0.1",
        ),
        ("step:@1", "is not written as step:SIZE@TIME"),
        ("minimum-jerk:0.1", "is not written as minimum-jerk:SIZE@TIME/DURATION"),
        ("stp:0.1@1", "hold; did you mean step?"),
        ("minimumjerk:0.1@1/2", "hold; did you mean minimum-jerk?"),
        ("step:nan@1", "setpoint 'step:nan@1': nan is not finite"),
        ("ladder:0.1,1e400@0/1", "1e400 is not finite"),
        ("ramp:0.1@1/nan", "nan is not finite"),
        ("step:-inf@1", "-inf is not finite"),
        ("jump:0.1@1", "nor one of"),
        ("step:0.1@1 ", "is not written as step:SIZE@TIME"),
        ("step:0,1@1", "setpoint 'step:0,1@1': step takes one size, not 2"),
        ("ramp:0.1,0.2@1/1", "ramp takes one size, not 2"),
        ("sine:0.1,0.2@1/1", "sine takes one size, not 2"),
        ("step:0.1@1/2", "step takes no /SECONDS; write step:SIZE@TIME"),
        ("ladder:0.1@1", "ladder lacks its /SECONDS; write ladder:LEVEL,LEVEL,...@TIME/HOLD"),
        ("ramp:0.1@1", "ramp lacks its /SECONDS"),
        ("minimum-jerk:0.1@1", "minimum-jerk lacks its /SECONDS"),
        ("sine:0.1@1", "sine lacks its /SECONDS"),
        ("step:0.1@-1", "setpoint 'step:0.1@-1': TIME is -1 s, but must be 0 s or more"),
        ("step:0.1@1e999", "1e999 is not finite"),
        ("ramp:0.1@1/0", "setpoint 'ramp:0.1@1/0': /0 s must be 0.001 s or more"),
        ("ramp:0.1@1/-2", "/-2 s must be 0.001 s or more"),
        ("ladder:0.1,0.2@1/1e-320", "must be 0.001 s or more"),
        ("sine:0.1@1/1e999", "1e999 is not finite"),
        ("sine:0.1@1/0.00099", "/0.00099 s must be 0.001 s or more"),
    ],
)
def test_an_unreadable_setpoint_is_refused(text: str, said: str) -> None:
    with pytest.raises(SetpointError) as caught:
        parse_setpoint(text)
    assert said in str(caught.value)


numbers = st.floats(allow_nan=False).map(repr) | st.sampled_from(["1e999", "1e-320", "0", "0.001", "-1"])


@given(
    st.sampled_from(["step", "ladder", "ramp", "minimum-jerk", "sine"]),
    st.lists(numbers, min_size=1, max_size=3),
    numbers,
    numbers | st.none(),
    st.integers(0, 2**62),
)
def test_any_text_is_refused_or_gives_finite_numbers_at_all_times(
    kind: str, values: list[str], start: str, span: str | None, t_ns: int
) -> None:
    text = f"{kind}:{','.join(values)}@{start}" + (f"/{span}" if span else "")
    try:
        setpoint = parse_setpoint(text)
        check_within(setpoint, "x", -10.0, 10.0, "m")
    except SetpointError as error:
        assert text in str(error)
    else:
        assert math.isfinite(setpoint.at(t_ns / 1e9))


class TestCsv:
    TABLE = "time_s,setpoint\n1,0.1\n2,0.2\n2,-0.1\n4,0.3\n"

    @pytest.mark.parametrize(
        ("t", "r"),
        [
            (0.0, 0.1),  # the first value is kept before it
            (1.0, 0.1),
            (1.5, 0.15),
            (below(2.0), 0.2),
            (2.0, -0.1),  # a step: two rows at one time
            (3.0, 0.1),
            (4.0, 0.3),
            (100.0, 0.3),
        ],
    )
    def test_straight_lines_between_rows(self, t: float, r: float) -> None:
        assert at("csv:r.csv", t, self.TABLE) == pytest.approx(r, abs=1e-12)

    def test_the_range_is_that_of_the_rows(self) -> None:
        setpoint = parse_setpoint("csv:r.csv", self.TABLE)
        assert (setpoint.min_r, setpoint.max_r) == (-0.1, 0.3)

    @pytest.mark.parametrize(
        "table",
        [
            "1,0.1\n2,0.2\n2,-0.1\n4,0.3",
            "# from the lab\ntime_s,setpoint\n1,0.1\n\n2,0.2\n # a step\n2,-0.1\n4,0.3\n",
            "time_s, setpoint\r\n1,0.1\r\n2,0.2\r\n2,-0.1\r\n4,0.3\r\n",
            "1,0.1\r2,0.2\r2,-0.1\r4,0.3\r",
            ' 1 , 0.1 \n2,"0.2"\n2,-1e-1\n4,.3\n',
        ],
    )
    def test_other_ways_to_write_the_same_table(self, table: str) -> None:
        setpoint, expected = parse_setpoint("csv:r.csv", table), parse_setpoint("csv:r.csv", self.TABLE)
        for t in core_instants(500):
            assert setpoint.at(t) == expected.at(t)

    @pytest.mark.parametrize(
        ("table", "said"),
        [
            ("", "r.csv: no rows of time_s,setpoint"),
            ("time_s,setpoint\n", "r.csv: no rows of time_s,setpoint"),
            ("0;0.1\n", "r.csv: row 1: the header is '0;0.1', but the columns must be time_s,setpoint"),
            (
                "# lab\nsetpoint,time_s\n0,1\n",
                "r.csv: row 2: the header is 'setpoint,time_s', but the columns",
            ),
            ("time_s,setpoint,unit\n0,0\n", "r.csv: row 1: the header is 'time_s,setpoint,unit', but"),
            ("O,0.1\n1,0.2\n", "r.csv: row 1: 'O,0.1' is not time_s,setpoint"),
            ("0,0.1,2\n", "r.csv: row 1: '0,0.1,2' is not time_s,setpoint"),
            ("0,0.1\nx,y\n", "r.csv: row 2: 'x,y' is not time_s,setpoint"),
            ("0,0.1\n1\n", "r.csv: row 2: '1' is not time_s,setpoint"),
            ("0,nan\n", "r.csv: row 1: '0,nan' is not finite"),
            ("0,0\ninf,1\n", "r.csv: row 2: 'inf,1' is not finite"),
            ("1,0\n0.5,0\n", "r.csv: row 2: time 0.5 s goes back from 1.0 s"),
            ('0,"' + "1" * 200_000, "r.csv: not a CSV file: field larger than"),
        ],
    )
    def test_an_unreadable_row_is_refused_with_its_number(self, table: str, said: str) -> None:
        with pytest.raises(SetpointError) as caught:
            parse_setpoint("csv:r.csv", table)
        assert str(caught.value).startswith(said)

    @given(st.text(alphabet='0123456789.,-e\n\r"# x\0', max_size=60))
    def test_any_text_is_refused_or_gives_numbers(self, table: str) -> None:
        try:
            setpoint = parse_setpoint("csv:r.csv", table)
        except SetpointError:
            return
        for t in (0.0, 0.5, 1.0, 9.0, 1e9):
            assert setpoint.min_r - 1e-9 <= setpoint.at(t) or not math.isfinite(
                setpoint.max_r - setpoint.min_r
            )

    def test_the_file_name_of_a_csv_setpoint(self) -> None:
        assert csv_file("csv:a/b.csv") == "a/b.csv"
        assert csv_file("step:0.1@1") is None
