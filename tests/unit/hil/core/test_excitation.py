"""Excitation signals: their statistics are those that identification counts on."""

import math

import numpy as np
import pytest

from hil.core.errors import DocumentError
from hil.core.excitation import (
    Chirp,
    Multisine,
    Prbs,
    Signal,
    Steps,
    Table,
    band_power,
    m_sequence,
    read_table,
    samples,
    summarise_spectrum,
)

TS = 0.0112


class TestMaximumLengthSequences:
    @pytest.mark.parametrize(("base", "degree"), [(2, 2), (2, 7), (2, 10), (3, 4), (5, 3), (7, 2)])
    def test_every_register_content_but_zero_occurs_once_in_a_period(self, base: int, degree: int) -> None:
        period = base**degree - 1
        digits = m_sequence(base, period, seed=3)
        windows = {tuple((digits * 2)[k : k + degree]) for k in range(period)}
        assert len(windows) == period

    def test_its_autocorrelation_is_that_of_white_noise(self) -> None:
        signs = 2.0 * np.array(m_sequence(2, 511, seed=1)) - 1.0
        correlation = [float(np.dot(signs, np.roll(signs, lag))) for lag in range(1, 511)]
        assert correlation == [-1.0] * 510

    def test_the_seed_chooses_the_start_of_the_same_sequence(self) -> None:
        one, other = (m_sequence(2, 511, seed) for seed in (1, 2))
        assert one != other
        assert "".join(map(str, other)) in "".join(map(str, one)) * 2

    def test_a_long_sequence_does_not_repeat(self) -> None:
        digits = m_sequence(2, 5000, seed=1)
        assert all(digits[:2500] != digits[lag : lag + 2500] for lag in range(1, 2500))


class TestPrbs:
    def test_it_keeps_its_value_for_a_clock_and_has_two_levels(self) -> None:
        values = samples(Prbs(amplitude=0.4, duration_s=60.0, clock_periods=12), TS)
        assert len(values) == round(60.0 / TS)
        assert set(values) == {-0.4, 0.4}
        assert set(np.flatnonzero(np.diff(values)) % 12) == {11}

    @pytest.mark.parametrize("levels", [3, 5, 7])
    def test_levels_are_equally_spaced_and_all_used(self, levels: int) -> None:
        values = samples(Prbs(amplitude=0.3, duration_s=60.0, levels=levels), TS)
        assert sorted(set(values)) == pytest.approx(np.linspace(-0.3, 0.3, levels))

    def test_its_crest_factor_is_one(self) -> None:
        values = samples(Prbs(amplitude=0.4, duration_s=60.0), TS)
        assert summarise_spectrum(values, TS).crest_factor == pytest.approx(1.0, abs=0.02)

    def test_a_slower_clock_excites_lower_frequencies(self) -> None:
        bands = [
            summarise_spectrum(
                samples(Prbs(amplitude=0.4, duration_s=60.0, clock_periods=clock), TS), TS
            ).high_rad_s
            for clock in (6, 12, 24)
        ]
        assert bands[0] > 1.5 * bands[1] > 2.25 * bands[2]


class TestMultisine:
    SIGNAL = Multisine(amplitude=0.4, duration_s=40.0, low_rad_s=0.5, high_rad_s=30.0, repetitions=4)

    @pytest.mark.parametrize("phases", ["random", "schroeder"])
    def test_only_lines_of_the_band_have_power_and_all_the_same(self, phases: str) -> None:
        signal = Multisine(
            amplitude=0.4, duration_s=40.0, low_rad_s=0.5, high_rad_s=30.0, phases=phases, repetitions=4
        )
        values = samples(signal, TS)
        once = len(values) // 4
        assert np.array_equal(values[:once], values[once : 2 * once])
        power = np.abs(np.fft.rfft(values[:once])) ** 2
        omega = 2 * np.pi * np.fft.rfftfreq(once, TS)
        inside = (omega >= 0.5) & (omega <= 30.0)
        assert power[~inside].max() < 1e-12 * power.max()
        assert power[inside].min() == pytest.approx(power.max(), rel=1e-6)

    def test_its_peak_is_the_amplitude_and_schroeder_phases_keep_the_crest_factor_low(self) -> None:
        found = summarise_spectrum(samples(self.SIGNAL, TS), TS)
        assert found.peak == pytest.approx(0.4)
        assert found.crest_factor < 1.8

    def test_random_phases_follow_the_seed(self) -> None:
        one, same, other = (
            samples(Multisine(amplitude=1.0, duration_s=10.0, phases="random", seed=seed), TS)
            for seed in (1, 1, 2)
        )
        assert np.array_equal(one, same)
        assert not np.array_equal(one, other)

    def test_a_band_without_a_line_is_refused(self) -> None:
        signal = Multisine(amplitude=1.0, duration_s=2.0, low_rad_s=3.2, high_rad_s=3.3, repetitions=1)
        with pytest.raises(DocumentError, match=r"no line between 3.2 and 3.3 rad/s: lines are 3.1"):
            samples(signal, TS)


class TestChirp:
    @pytest.mark.parametrize("sweep", ["linear", "logarithmic"])
    def test_the_frequency_moves_from_low_to_high(self, sweep: str) -> None:
        values = samples(
            Chirp(amplitude=0.4, duration_s=60.0, low_rad_s=1.0, high_rad_s=30.0, sweep=sweep), TS
        )
        crossings = np.flatnonzero(np.diff(np.signbit(values))) * TS
        frequency = np.pi / np.diff(crossings)
        at = 0.5 * (crossings[:-1] + crossings[1:])
        expected = 1.0 + 29.0 * at / 60.0 if sweep == "linear" else 30.0 ** (at / 60.0)
        assert frequency == pytest.approx(expected, rel=0.15)
        assert expected[-1] > 29.0

    @pytest.mark.parametrize(
        ("low", "high", "complaint"),
        [
            (5.0, 5.0, r"band 5 to 5 rad/s is empty"),
            (1.0, 281.0, r"281 rad/s is not under the Nyquist frequency 280.5 rad/s"),
        ],
    )
    def test_an_impossible_band_is_refused(self, low: float, high: float, complaint: str) -> None:
        with pytest.raises(DocumentError, match=complaint):
            samples(Chirp(amplitude=0.4, duration_s=60.0, low_rad_s=low, high_rad_s=high), TS)


def test_steps_go_up_and_down_about_zero() -> None:
    values = samples(Steps(amplitude=0.2, duration_s=8.0, hold_s=2.0), TS)
    assert [values[round(t / TS)] for t in (0.0, 1.9, 2.1, 4.1, 6.1)] == [0.2, 0.2, 0.0, -0.2, 0.0]


class TestTable:
    def test_each_value_is_held_until_the_next_row(self) -> None:
        table = read_table("time_s,value\n0,0.1\n0.0224,0.2\n0.056,0\n", "u.csv")
        assert samples(table, TS).tolist() == [0.1, 0.1, 0.2, 0.2, 0.2]

    @pytest.mark.parametrize(
        ("text", "complaint"),
        [
            ("", r"u.csv: 0 rows of time_s,value; at least 2 are needed"),
            ("0,1\n1,x\n", r"u.csv: row 2: '1,x' is not time_s,value: two numbers"),
            ("0,1\n1\n", r"u.csv: row 2: '1' is not"),
            ("0,1\n1,nan\n", r"u.csv: row 2: '1,nan' is not finite"),
            ("0,1\n0,2\n", r"u.csv: row 2: time 0 s does not come after 0 s; sort the rows"),
            ("1,1\n2,2\n", r"u.csv: the first row is at 1 s; the times must start at 0"),
        ],
    )
    def test_an_unusable_table_is_refused(self, text: str, complaint: str) -> None:
        with pytest.raises(DocumentError, match=complaint):
            read_table(text, "u.csv")

    @pytest.mark.parametrize(
        ("times", "complaint"),
        [
            ([0.0], "same length"),
            ([0.0, -1.0], "must increase"),
            ([0.0, 0.0], "must increase"),
            ([0.0, math.inf], "finite"),
        ],
    )
    def test_a_table_from_elsewhere_is_checked_too(self, times: list[float], complaint: str) -> None:
        with pytest.raises(DocumentError, match=complaint):
            samples(Table(file="x", time_s=times, value=[0.0, 1.0]), TS)


@pytest.mark.parametrize(
    "signal",
    [
        Prbs(amplitude=0.4, duration_s=1e9),
        Steps(amplitude=0.4, duration_s=0.001),
        Chirp(amplitude=0.4, duration_s=0.01),
    ],
)
def test_a_duration_that_is_no_experiment_is_refused(signal: Signal) -> None:
    with pytest.raises(DocumentError, match=r"excitation: duration .* s is \d+ periods"):
        samples(signal, TS)


def test_band_power_adds_up_to_one() -> None:
    values = samples(Prbs(amplitude=0.4, duration_s=60.0), TS)
    shares = band_power(values, TS, np.array([0.0, 1.0, 10.0, 300.0]))
    assert shares.sum() == pytest.approx(1.0)
    assert shares[1] > shares[0]
