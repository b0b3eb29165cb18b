"""Bad records: each is refused, or its model carries a warning with signal, figure, limit and remedy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from support.arm_bench import excite
from support.identification_data import PAPER, PAPER_DEN, PERIOD_S, SAMPLES, paper_record, prbs

from design.identification.checks.causality import later_input_share
from design.identification.checks.expectations import Expectations
from design.identification.checks.feedback import feedback
from design.identification.checks.stalls import find_stalls, quantum, sensor_noise
from design.identification.findings import (
    Finding,
    Kind,
    RecordRefusedError,
    Severity,
    most_severe_first,
    refuse_if_needed,
)
from design.identification.identify import Identification, identify
from design.identification.models.model import ContinuousModel
from design.identification.records.experiment import Experiment
from firmware_sim import shipped_arm

Array = NDArray[np.float64]
GOOD = paper_record(1)
U, Y = np.array(GOOD.u), np.array(GOOD.y)


def random() -> np.random.Generator:
    return np.random.default_rng(7)


def outcome(u: Array, y: Array, **arguments: object) -> Identification | tuple[Finding, ...]:
    """The model, or why there is none."""
    try:
        return identify(u, y, PERIOD_S, **arguments)  # type: ignore[arg-type]
    except RecordRefusedError as refusal:
        assert str(refusal)
        return refusal.findings


def findings(u: Array, y: Array, **arguments: object) -> dict[Kind, Finding]:
    """The first finding of each kind."""
    found = outcome(u, y, **arguments)
    listed = found.findings if isinstance(found, Identification) else found
    return {finding.kind: finding for finding in reversed(listed)}


def test_many_places_without_a_known_input_are_noted_with_the_option_that_helps() -> None:
    lost = random().random(SAMPLES) < 0.03
    u = np.where(lost, np.nan, U)
    note = findings(u, Y)[Kind.GAPS]
    assert (note.severity, note.signal) == (Severity.NOTE, "u")
    assert note.figure > note.limit == 1.0
    assert "--input-held" in note.remedy
    assert Kind.GAPS not in findings(U, np.where(lost, np.nan, Y))


def test_swapped_columns_of_the_validation_record_are_found() -> None:
    other = paper_record(2)
    swapped = Experiment(other.y, other.u, PERIOD_S, name="other.csv")
    refused = findings(U, Y, validation=[swapped])[Kind.SWAPPED]
    assert (refused.severity, refused.record) == (Severity.REFUSE, "other.csv")
    assert refused.remedy == "exchange the two columns of other.csv"


def test_nothing_is_said_against_a_good_record() -> None:
    found = identify(U, Y, PERIOD_S, expected=Expectations(PERIOD_S, (-5.0, 5.0), (-0.15, 0.15), None))
    assert found.findings == ()
    assert not found.doubtful
    assert found.fit_percent > 99.0


def noise(std: float) -> Array:
    return std * random().standard_normal(SAMPLES)


def with_nan(signal: Array, share: float) -> Array:
    return np.where(random().random(SAMPLES) < share, np.nan, signal)


REFUSED: dict[str, tuple[Callable[[], tuple[Array, Array]], Kind]] = {
    "constant input": (lambda: (np.full(SAMPLES, 0.3), Y), Kind.CONSTANT_INPUT),
    "input of 0": (lambda: (0.0 * U, Y), Kind.CONSTANT_INPUT),
    "output of 0": (lambda: (U, 0.0 * Y), Kind.CONSTANT_OUTPUT),
    "output without a number": (lambda: (U, np.nan * Y), Kind.TOO_FEW_SAMPLES),
    "input without a number": (lambda: (np.nan * U, Y), Kind.GAPS),
    "one sample": (lambda: (U[:1], Y[:1]), Kind.TOO_FEW_SAMPLES),
    "no sample": (lambda: (U[:0], Y[:0]), Kind.TOO_FEW_SAMPLES),
    "twenty samples": (lambda: (U[:20], Y[:20]), Kind.TOO_FEW_SAMPLES),
    "gaps everywhere": (lambda: (with_nan(U, 0.4), with_nan(Y, 0.4)), Kind.GAPS),
    "nine tenths missing": (lambda: (U, with_nan(Y, 0.9)), Kind.GAPS),
    "channels swapped": (lambda: (Y, U), Kind.SWAPPED),
    "one sine": (lambda: (np.sin(0.03 * np.arange(SAMPLES)), Y), Kind.EXCITATION),
    "a ramp": (lambda: (np.linspace(0.0, 1.0, SAMPLES), Y), Kind.EXCITATION),
    "output of noise": (lambda: (U, noise(1.0)), Kind.POOR_FIT),
    "output of another axis": (lambda: (prbs(SAMPLES, 12, random()), Y), Kind.POOR_FIT),
    "output that wanders": (lambda: (U, np.cumsum(noise(1.0))), Kind.UNCERTAIN),
    "noise ten times the signal": (lambda: (U, Y + noise(10.0 * Y.std())), Kind.POOR_FIT),
    "held by friction": (lambda: (U, np.round(Y / 0.03) * 0.03 + noise(1e-4)), Kind.FRICTION),
    "step in the fitted part only": (
        lambda: (np.where(np.arange(SAMPLES) < 500, 0.0, 0.3), Y),
        Kind.CONSTANT_INPUT,
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name: str) -> None:
    make, kind = REFUSED[name]
    found = outcome(*make())
    assert not isinstance(found, Identification)
    assert found[0].severity is Severity.REFUSE
    assert kind in {finding.kind for finding in found if finding.severity is Severity.REFUSE}
    for finding in found:
        assert finding.text
        assert finding.remedy
        assert finding.signal
        assert np.isfinite(finding.limit)


def delayed(samples: int) -> Array:
    return np.concatenate([np.zeros(samples), Y[: SAMPLES - samples]])


DOUBTFUL: dict[str, tuple[Callable[[], tuple[Array, Array]], Kind]] = {
    "a third missing": (lambda: (U, with_nan(Y, 0.3)), Kind.GAPS),
    "drift": (lambda: (U, Y + np.linspace(0.0, 0.1, SAMPLES)), Kind.DRIFT),
    "clipped": (lambda: (U, np.clip(Y, -0.04, 0.04)), Kind.END_STOPS),
    "coarse": (lambda: (U, np.round(Y / 0.03) * 0.03), Kind.RESOLUTION),
    "noise as large as the signal": (lambda: (U, Y + noise(Y.std())), Kind.POOR_FIT),
    "eight samples of dead time": (lambda: (U, delayed(8)), Kind.DEAD_TIME),
    "output five samples early": (lambda: (U[:-5], Y[5:]), Kind.TIME_SHIFT),
    "short and noisy": (lambda: (U[:300], (Y + noise(0.3 * Y.std()))[:300]), Kind.UNCERTAIN),
}


@pytest.mark.parametrize("name", DOUBTFUL)
def test_doubtful(name: str) -> None:
    make, kind = DOUBTFUL[name]
    found = outcome(*make())
    assert isinstance(found, Identification)
    assert found.doubtful
    (finding, *_) = [finding for finding in found.findings if finding.kind is kind]
    assert finding.severity is Severity.WARN
    assert str(finding) in found.warnings
    assert finding.record.startswith("record")


def test_what_is_known_of_the_rig_shows_wrong_units_and_sample_times() -> None:
    known = Expectations(PERIOD_S, (-5.0, 5.0), (-0.15, 0.15))
    millimetres = findings(U, 1000.0 * Y, expected=known)[Kind.UNITS]
    assert millimetres.severity is Severity.REFUSE
    assert "but the travel is -0.15 to 0.15 m: in thousandths of the unit?" in millimetres.text
    millivolts = findings(20_000.0 * U, Y, expected=known)[Kind.UNITS]
    assert millivolts.signal == "u"
    with pytest.raises(RecordRefusedError, match=r"11\.2 s, but the rig's period is 0\.0112 s"):
        identify(U, Y, 11.2, expected=known)
    saturated = findings(np.clip(20.0 * U, -5.0, 5.0), Y, expected=known)[Kind.SATURATION]
    assert saturated.figure == pytest.approx(100.0)


def test_a_known_plant_shows_wrong_units_and_sample_times() -> None:
    plant = ContinuousModel(np.array([43.5167]), PAPER_DEN)
    known = Expectations(plant=plant)
    assert "thousandths" in findings(U, 1000.0 * Y, expected=known)[Kind.UNITS].remedy
    assert "other way round" in findings(U, -Y, expected=known)[Kind.UNITS].remedy
    with_period = identify(U, Y, 2.0 * PERIOD_S, expected=known).findings
    assert [finding.kind for finding in with_period] == [Kind.SAMPLE_TIME]
    assert with_period[0].figure == pytest.approx(0.5, rel=0.05)
    assert identify(U, Y, PERIOD_S, expected=known).findings == ()


def test_samples_at_the_end_stops_are_left_out() -> None:
    u, y = excite(shipped_arm(), 0, 0.8, seed=2)
    known = identify(u, y, PERIOD_S, expected=Expectations(travel=(-0.15, 0.15)))
    unknown = identify(u, y, PERIOD_S)
    assert known.fit_percent > 96.0 > unknown.fit_percent
    assert Kind.END_STOPS in {finding.kind for finding in known.findings}
    assert Kind.END_STOPS in {finding.kind for finding in unknown.findings}
    assert known.properties.velocity_gain is not None
    assert known.properties.velocity_gain.value == pytest.approx(0.259, rel=0.1)
    u, y = excite(shipped_arm(), 0, 1.5, seed=2)
    refusal = findings(u, y, expected=Expectations(travel=(-0.15, 0.15)))[Kind.END_STOPS]
    assert refusal.severity is Severity.REFUSE


@pytest.mark.parametrize(("amplitude_v", "sticks"), [(0.02, True), (0.05, True), (0.2, False), (0.4, False)])
def test_friction_of_the_arm_shows_at_small_amplitudes(amplitude_v: float, sticks: bool) -> None:
    u, y = excite(shipped_arm(), 0, amplitude_v, seed=1)
    assert (Kind.FRICTION in findings(u, y)) is sticks


def controlled(kp: float, *, integral: float = 0.0, seed: int = 1) -> Experiment:
    """The paper's plant under a PI controller, with steps of the setpoint."""
    generator = np.random.default_rng(seed)
    r = prbs(SAMPLES, 60, generator, 0.05)
    sensor = 2e-4 * generator.standard_normal(SAMPLES)
    b, f = PAPER.b, PAPER.f
    w, u, y = np.zeros((3, SAMPLES))
    total = 0.0
    for k in range(SAMPLES):
        past_u = u[max(0, k - 3) : k][::-1]
        past_w = w[max(0, k - 3) : k][::-1]
        w[k] = b[: len(past_u)] @ past_u - f[1 : 1 + len(past_w)] @ past_w
        y[k] = w[k] + sensor[k]
        total += r[k] - y[k]
        u[k] = kp * (r[k] - y[k]) + integral * total
    return Experiment(u, y, PERIOD_S)


@pytest.mark.parametrize(("kp", "integral"), [(2.0, 0.0), (10.0, 0.0), (8.0, 0.05)])
def test_a_closed_loop_is_found_from_the_record_alone(kp: float, integral: float) -> None:
    record = controlled(kp, integral=integral)
    found = feedback(record)
    assert found is not None
    assert found.with_output < 0.05
    listed = findings(np.array(record.u), np.array(record.y))
    assert "a controller computed it from y" in listed[Kind.FEEDBACK].text
    assert Kind.FEEDBACK not in findings(np.array(record.u), np.array(record.y), structure="BJ(1,1,1,3,1)")


def test_a_closed_loop_that_is_stated_is_not_doubted() -> None:
    stated = findings(U, Y, expected=Expectations(closed_loop=True))
    assert "as stated" in stated[Kind.FEEDBACK].text
    record = controlled(10.0)
    denied = findings(np.array(record.u), np.array(record.y), expected=Expectations(closed_loop=False))
    assert Kind.FEEDBACK not in denied


def inputs() -> dict[str, Array]:
    """Inputs of open loops."""
    t = np.arange(SAMPLES)
    generator = random()
    phases = generator.uniform(0.0, 2.0 * np.pi, 99)
    lines = 2.0 * np.pi * np.outer(t / 1785.0, np.arange(1, 100)) + phases
    return {
        "PRBS": prbs(SAMPLES, 12, generator),
        "PRBS of one sample": prbs(SAMPLES, 1, generator),
        "multisine": 0.05 * np.cos(lines).sum(axis=1),
        "chirp": 0.4 * np.sin(0.001 * t + 0.00001 * t * t),
        "steps": np.repeat(generator.uniform(-0.4, 0.4, 12), 450)[:SAMPLES],
        "noise": generator.standard_normal(SAMPLES),
    }


@pytest.mark.parametrize("name", inputs())
def test_open_loops_are_not_taken_for_closed_ones_nor_for_shifted_or_stuck_ones(name: str) -> None:
    u = inputs()[name]
    y = PAPER.simulate(u)
    for share in (1e-3, 0.1):
        record = Experiment(u, y + share * y.std() * random().standard_normal(SAMPLES), PERIOD_S)
        found = feedback(record)
        assert found is not None
        assert found.with_output > 0.5
        assert later_input_share(record, 1) < 0.05
        kinds = findings(np.array(record.u), np.array(record.y)).keys()
        assert not kinds & {Kind.FEEDBACK, Kind.TIME_SHIFT, Kind.FRICTION, Kind.END_STOPS, Kind.SWAPPED}


def test_an_unstable_plant_in_a_closed_loop() -> None:
    generator = random()
    d = prbs(4000, 8, generator, 0.3)
    u, y = np.zeros((2, 4000))
    x = 0.0
    for k in range(4000):
        y[k] = x + 0.02 * generator.standard_normal()
        u[k] = d[k] - y[k]
        x = 1.03 * x + 0.1 * u[k]
    wrong = outcome(u, y)
    assert not isinstance(wrong, Identification) or wrong.doubtful
    found = identify(u, y, PERIOD_S, structure="ARMAX(1,1,1,1)")
    assert found.discrete.poles_z[0].real == pytest.approx(1.03, abs=0.005)
    assert [finding.kind for finding in found.findings] == [Kind.UNSTABLE]
    assert np.isnan(found.fit_percent)


def test_noise_and_steps_of_a_converter() -> None:
    record = paper_record(1, 0.0)
    step = 1e-3
    coarse = Experiment(record.u, np.round(record.y / step) * step, PERIOD_S)
    assert quantum(coarse.y) == pytest.approx(step)
    assert sensor_noise(coarse) >= 0.999 * step / np.sqrt(12.0)
    noisy = paper_record(1, 0.05)
    assert sensor_noise(noisy) == pytest.approx(0.05 * np.std(PAPER.simulate(noisy.u)), rel=0.1)
    assert quantum(np.ones(5)) == 0.0


def test_a_record_too_short_for_stalls() -> None:
    found = identify(U, Y, PERIOD_S).validation[0]
    assert find_stalls(found).between == 0.0


def finding(kind: Kind, severity: Severity, signal: str = "y") -> Finding:
    return Finding(kind, severity, "a.csv", signal, 2.0, 1.0, "V", "it is 2 V (limit 1 V)", "lower it")


def test_findings_are_listed_once_the_worst_first() -> None:
    note, warning, refusal = (
        finding(Kind.DRIFT, Severity.NOTE),
        finding(Kind.DRIFT, Severity.WARN),
        finding(Kind.UNITS, Severity.REFUSE),
    )
    assert most_severe_first([note, warning, warning, refusal]) == (refusal, warning, note)
    refuse_if_needed([note, warning])
    with pytest.raises(RecordRefusedError, match=r"^a\.csv: y: it is 2 V \(limit 1 V\); lower it$") as error:
        refuse_if_needed([note, refusal])
    assert error.value.findings == (refusal, note)
