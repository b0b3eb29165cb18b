"""Bad records through the public API: a right model, a clear refusal, or a model with a warning.

No record may hang the identification, and no wrong model may come without a warning.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from support.arm_bench import excite, prbs

import design
from design.identification.checks.expectations import NOTHING_KNOWN, Expectations
from design.identification.findings import Finding, Kind, Severity
from design.identification.models.held_discretisation import hold
from design.identification.models.model import ContinuousModel, DiscreteModel
from firmware_sim.arm.arm_file import shipped_arm

Array = NDArray[np.float64]

pytestmark = [pytest.mark.timeout(60), pytest.mark.filterwarnings("error")]

T = 0.0112
SAMPLES = 5357
"""One minute."""
STRUCTURES = (
    "OE(1,3,1)",
    "ARX(3,1,1)",
    "ARMAX(3,1,3,1)",
    "BJ(1,1,1,3,1)",
    "continuous(real=1, pairs=1, zeros=1)",
)


def _plant() -> ContinuousModel:
    paper = design.paper_plant()
    return ContinuousModel(np.array(paper.num) / paper.den[0], np.array(paper.den) / paper.den[0])


PLANT = _plant()
"""Eq. (15), whose sampled image is an OE(1,3,1) model."""


def clean(samples: int = SAMPLES, seed: int = 1, amplitude_v: float = 0.4) -> tuple[Array, Array]:
    """Input and output of the plant without noise."""
    u = amplitude_v * prbs(samples, 12, seed)
    return u, hold(PLANT, T).simulate(u)


def noisy(samples: int = SAMPLES, seed: int = 1, noise: float = 0.01) -> tuple[Array, Array]:
    """Input and output of the plant; the noise is a share of the output's standard deviation."""
    u, y = clean(samples, seed)
    return u, y + noise * y.std() * np.random.default_rng(seed).standard_normal(samples)


def closed_loop(
    plant: DiscreteModel, controller: Callable[[float], float], dither: Array, noise: float, seed: int
) -> tuple[Array, Array]:
    """Input and output of a loop with negative feedback; ``controller`` is called once in each period."""
    e = noise * np.random.default_rng(seed).standard_normal(len(dither))
    b = np.concatenate([np.zeros(plant.nk), plant.b])
    x, u = np.zeros(len(dither)), np.zeros(len(dither))
    for k in range(len(dither)):
        past_u = sum(b[i] * u[k - i] for i in range(1, len(b)) if i <= k)
        x[k] = past_u - sum(plant.f[i] * x[k - i] for i in range(1, len(plant.f)) if i <= k)
        u[k] = controller(-(x[k] + e[k])) + dither[k]
    return u, x + e


def proportional_derivative(kp: float, kd: float) -> Callable[[float], float]:
    slope, last = 0.0, 0.0

    def output(error: float) -> float:
        nonlocal slope, last
        slope, last = 0.7 * slope + 0.3 * (error - last) / T, error
        return kp * error + kd * slope

    return output


def refusal(u: object, y: object, kind: Kind, **arguments: object) -> Finding:
    """Return the finding of this kind for which the record is refused; it states figure and remedy."""
    with pytest.raises(design.RecordRefusedError) as refused:
        design.identify(u, y, **{"sample_time_s": T, "name": "run 7", **arguments})  # type: ignore[arg-type]
    found = [f for f in refused.value.findings if f.kind is kind and f.severity is Severity.REFUSE]
    assert found, str(refused.value)
    assert str(found[0]) in str(refused.value)
    _check_words(found[0])
    return found[0]


def warning(model: design.Identification, kind: Kind) -> Finding:
    """Return the warning of this kind; it states figure and remedy."""
    found = [f for f in model.findings if f.kind is kind and f.severity is Severity.WARN]
    assert found, model.findings
    assert str(found[0]) in model.warnings
    assert model.doubtful
    _check_words(found[0])
    return found[0]


def _check_words(finding: Finding) -> None:
    assert finding.record and finding.signal and finding.text and finding.remedy
    assert finding.record in str(finding) and finding.signal in str(finding)
    assert any(letter.isdigit() for letter in finding.text)
    assert np.isfinite([finding.figure, finding.limit]).all()


def assert_right(
    model: design.Identification, tolerance: float = 0.05, plant: ContinuousModel = PLANT
) -> None:
    """The identified response is that of the plant over the band that the input excites."""
    omega = np.geomspace(0.2, 25.0, 40)
    expected = hold(plant, T).at(omega)
    assert np.abs(model.discrete.at(omega) / expected - 1.0).max() < tolerance


# Signals that hold no information


@pytest.mark.parametrize("structure", STRUCTURES)
def test_constant_input_is_refused(structure: str) -> None:
    _, y = noisy()
    found = refusal(np.full(SAMPLES, 0.3), y, Kind.CONSTANT_INPUT, structure=structure)
    assert found.signal == "u"
    assert "0.3 V" in found.text


@pytest.mark.parametrize("level", [0.0, 0.2])
@pytest.mark.parametrize("structure", STRUCTURES)
def test_constant_output_is_refused(structure: str, level: float) -> None:
    u, _ = noisy()
    found = refusal(u, np.full(SAMPLES, level), Kind.CONSTANT_OUTPUT, structure=structure)
    assert found.signal == "y"
    assert f"{level:g} m" in found.text


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_signals_without_a_number_are_refused(bad: float) -> None:
    u, y = noisy()
    nothing = np.full(SAMPLES, bad)
    assert refusal(u, nothing, Kind.TOO_FEW_SAMPLES).figure == 0
    assert refusal(nothing, y, Kind.GAPS).figure == 100.0
    assert refusal(nothing, nothing, Kind.TOO_FEW_SAMPLES).figure == 0


@pytest.mark.parametrize("samples", [0, 1, 2, 49])
@pytest.mark.parametrize("structure", STRUCTURES)
def test_short_record_is_refused(structure: str, samples: int) -> None:
    u, y = noisy()
    found = refusal(u[:samples], y[:samples], Kind.TOO_FEW_SAMPLES, structure=structure)
    assert found.signal == "y"
    assert found.figure <= samples < found.limit


def test_noise_that_the_input_does_not_explain_is_refused() -> None:
    u, _ = noisy()
    random = np.random.default_rng(3)
    refusal(u, random.standard_normal(SAMPLES), Kind.POOR_FIT)
    refusal(u, np.cumsum(random.standard_normal(SAMPLES)), Kind.POOR_FIT)


def test_sine_cannot_determine_four_parameters() -> None:
    u = 0.4 * np.sin(5.0 * np.arange(SAMPLES) * T)
    assert refusal(u, hold(PLANT, T).simulate(u), Kind.EXCITATION).limit == 4


# Missing samples


@pytest.mark.parametrize("share", [0.03, 0.3, 0.6])
def test_missing_outputs_are_left_out(share: float) -> None:
    u, y = noisy()
    y[np.random.default_rng(5).random(SAMPLES) < share] = np.nan
    model = design.identify(u, y, T)
    assert_right(model)
    if share > 0.05:
        assert warning(model, Kind.GAPS).figure == pytest.approx(100.0 * share, rel=0.2)
    else:
        assert not model.doubtful


def test_bursts_of_lost_periods_are_left_out() -> None:
    u, y = noisy()
    lost = np.repeat(np.random.default_rng(5).random(SAMPLES // 100 + 1) < 0.3, 100)[:SAMPLES]
    model = design.identify(np.where(lost, np.nan, u), np.where(lost, np.nan, y), T)
    assert_right(model)
    warning(model, Kind.GAPS)


def test_values_in_place_of_a_missing_sample_do_not_matter() -> None:
    u, y = noisy()
    lost = np.random.default_rng(5).random(SAMPLES) < 0.04
    weights = np.where(lost, 0.0, 1.0)
    masked = design.identify(u, np.where(lost, 1e3, y), T, weights=weights)
    missing = design.identify(u, np.where(lost, np.nan, y), T)
    np.testing.assert_allclose(masked.discrete.f, missing.discrete.f, rtol=1e-9)


def test_gaps_everywhere_are_refused() -> None:
    u, y = noisy()
    lost = np.random.default_rng(5).random(SAMPLES) < 0.9
    assert refusal(u, np.where(lost, np.nan, y), Kind.GAPS).figure > 80.0
    alternating = np.where(np.arange(SAMPLES) % 2, np.nan, u)
    found = refusal(alternating, y, Kind.GAPS)
    assert found.signal == "u"
    assert "the longest has 1" in found.text


# Wrong columns, units and times


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.2])
@pytest.mark.parametrize("structure", ["OE(1,3,1)", "ARX(3,1,1)", "continuous(real=1, pairs=1)"])
def test_swapped_channels_are_refused(structure: str, noise: float) -> None:
    u, y = noisy(noise=noise)
    found = refusal(y, u, Kind.SWAPPED, structure=structure)
    assert found.signal == "u and y"
    assert found.remedy == "exchange the two columns"


@pytest.mark.parametrize("factor", [1000.0, 10.0, 2.0, 1.1, 0.5])
def test_sample_time_that_is_not_the_rigs_is_refused(factor: float) -> None:
    u, y = noisy()
    found = refusal(u, y, Kind.SAMPLE_TIME, sample_time_s=factor * T, expected=Expectations(sample_time_s=T))
    assert (found.signal, found.limit) == ("sample time", T)


@pytest.mark.parametrize("factor", [1000.0, 60.0, 10.0, 2.0, 0.5, 0.1])
def test_sample_time_that_makes_the_plant_too_slow_or_fast_is_reported(factor: float) -> None:
    u, y = noisy()
    model = design.identify(u, y, factor * T, expected=Expectations(plant=PLANT))
    assert warning(model, Kind.SAMPLE_TIME).figure == pytest.approx(1.0 / factor, rel=0.1)


@pytest.mark.parametrize("factor", [1000.0, 100.0, 180.0 / np.pi, 10.0, 0.001, -1.0, -1000.0])
def test_output_in_a_unit_that_the_earlier_plant_does_not_have_is_reported(factor: float) -> None:
    u, y = noisy()
    model = design.identify(u, factor * y, T, expected=Expectations(plant=PLANT))
    assert warning(model, Kind.UNITS).figure == pytest.approx(factor, rel=0.1)


@pytest.mark.parametrize("factor", [1000.0, 0.001, -1.0])
def test_input_in_a_unit_that_the_earlier_plant_does_not_have_is_reported(factor: float) -> None:
    u, y = noisy()
    model = design.identify(factor * u, y, T, expected=Expectations(plant=PLANT))
    assert warning(model, Kind.UNITS).figure == pytest.approx(1.0 / factor, rel=0.1)


@pytest.mark.parametrize("factor", [0.7, 1.0, 1.4])
def test_plant_that_changed_a_little_is_not_reported(factor: float) -> None:
    u, y = noisy()
    assert not design.identify(u, factor * y, T, expected=Expectations(plant=PLANT)).doubtful


def test_signals_beyond_actuator_and_travel_are_refused() -> None:
    u, y = noisy()
    assert refusal(1e3 * u, y, Kind.UNITS, expected=Expectations(input_range=(-5.0, 5.0))).signal == "u"
    assert refusal(u, 1e3 * y, Kind.UNITS, expected=Expectations(travel=(-0.15, 0.15))).signal == "y"


@pytest.mark.parametrize(
    ("u", "y", "sample_time_s", "words"),
    [
        ([0.0, 1.0], [0.0], T, "u has 2 samples and y has 1"),
        ([0.0, 1.0], ["a", "b"], T, "y must be an array of real numbers"),
        ([0.0, 1.0], [0.0, 1.0j], T, "y must be an array of real numbers"),
        (np.zeros((5, 2)), np.zeros((5, 2)), T, "u has shape"),
        (None, None, T, "u has shape"),
        ([0.0, 1e60], [0.0, 1.0], T, "u reaches 1e\\+60"),
        ([0.0], [0.0], 0.0, "sample time 0.0 s; it must be positive"),
        ([0.0], [0.0], -T, "sample time -0.0112 s; it must be positive"),
        ([0.0], [0.0], np.nan, "sample time nan s; it must be positive"),
        ([0.0], [0.0], np.inf, "sample time inf s; it must be positive"),
    ],
)
def test_arguments_that_are_no_record_are_refused(
    u: object, y: object, sample_time_s: float, words: str
) -> None:
    with pytest.raises(design.DesignError, match=f"run 7: {words}"):
        design.identify(u, y, sample_time_s, name="run 7")  # type: ignore[arg-type]


# Feedback


@pytest.mark.parametrize("noise", [1e-4, 1e-3])
def test_closed_loop_treated_as_open_loop_is_reported(noise: float) -> None:
    dither = 0.4 * prbs(SAMPLES, 12, 4)
    u, y = closed_loop(hold(PLANT, T), proportional_derivative(5.0, 0.2), dither, noise, seed=3)
    model = design.identify(u, y, T)
    found = warning(model, Kind.FEEDBACK)
    assert found.signal == "u"
    assert "ARMAX or BJ" in found.remedy
    assert_right(model)


def test_closed_loop_that_is_stated_is_reported() -> None:
    u, y = noisy()
    stated = Expectations(closed_loop=True)
    assert "as stated" in warning(design.identify(u, y, T, expected=stated), Kind.FEEDBACK).text
    assert not design.identify(u, y, T, structure="BJ(1,1,1,3,1)", expected=stated).doubtful


def test_closed_loop_without_an_excitation_is_refused() -> None:
    u, y = closed_loop(
        hold(PLANT, T), proportional_derivative(5.0, 0.2), np.zeros(SAMPLES), noise=0.01, seed=3
    )
    with pytest.raises(design.RecordRefusedError, match=r"excit|explain"):
        design.identify(u, y, T)


UNSTABLE = ContinuousModel(np.array([4.0]), np.convolve([1.0, -1.0], [1.0, 5.0]))


@pytest.mark.parametrize("noise", [1e-4, 1e-2])
@pytest.mark.parametrize(
    "structure",
    [
        "OE(2,2,1)",
        "OE(1,3,1)",
        "ARX(2,2,1)",
        "ARMAX(2,2,2,1)",
        "BJ(2,2,2,2,1)",
        "continuous(real=2, pairs=0)",
    ],
)
def test_unstable_plant_in_closed_loop_gives_no_model_without_a_warning(structure: str, noise: float) -> None:
    dither = prbs(SAMPLES, 12, 4)
    u, y = closed_loop(hold(UNSTABLE, T), proportional_derivative(10.0, 1.0), dither, noise, seed=3)
    try:
        model = design.identify(u, y, T, structure=structure)
    except design.RecordRefusedError as refused:
        assert "ARMAX" in str(refused)
        return
    assert model.doubtful
    if structure.startswith("ARMAX"):
        assert_right(model, 0.1, UNSTABLE)
        assert "frequency response" in warning(model, Kind.UNSTABLE).remedy


# Limits of the plant


@pytest.mark.parametrize("limit", [2.0, 1.5])
def test_samples_at_a_known_end_stop_are_left_out(limit: float) -> None:
    u, y = noisy()
    stop = limit * y.std()
    model = design.identify(u, np.clip(y, -stop, stop), T, expected=Expectations(travel=(-stop, stop)))
    assert_right(model)
    assert warning(model, Kind.END_STOPS).signal == "y"


@pytest.mark.parametrize("limit", [2.0, 1.5, 1.0, 0.5])
def test_end_stops_that_are_not_known_are_reported(limit: float) -> None:
    u, y = noisy()
    stop = limit * y.std()
    assert (
        "state the travel" in warning(design.identify(u, np.clip(y, -stop, stop), T), Kind.END_STOPS).remedy
    )


def test_record_that_lies_mostly_at_end_stops_is_refused() -> None:
    u, y = noisy()
    stop = y.std()
    found = refusal(u, np.clip(y, -stop, stop), Kind.END_STOPS, expected=Expectations(travel=(-stop, stop)))
    assert found.figure > 20.0


def multisine() -> Array:
    k = np.arange(SAMPLES)
    phases = np.random.default_rng(9).uniform(0.0, 2.0 * np.pi, 60)
    u = sum(np.cos(2.0 * np.pi * line * k / 2000.0 + phase) for line, phase in enumerate(phases, 1))
    return np.asarray(0.4 * u / np.std(u))


@pytest.mark.parametrize("limit_v", [0.4, 0.2])
def test_saturated_input_is_reported(limit_v: float) -> None:
    u = np.clip(multisine(), -limit_v, limit_v)
    y = hold(PLANT, T).simulate(u)
    y += 0.01 * y.std() * np.random.default_rng(2).standard_normal(SAMPLES)
    model = design.identify(u, y, T, expected=Expectations(input_range=(-limit_v, limit_v)))
    assert_right(model)
    assert warning(model, Kind.SATURATION).remedy == "lower the amplitude"


@pytest.mark.parametrize("limit_v", [0.4, 0.2, 0.08])
@pytest.mark.parametrize("known", [True, False])
def test_command_recorded_before_the_actuator_limits_it_is_no_good_record(
    limit_v: float, known: bool
) -> None:
    command = multisine()
    y = hold(PLANT, T).simulate(np.clip(command, -limit_v, limit_v))
    y += 0.01 * y.std() * np.random.default_rng(2).standard_normal(SAMPLES)
    if known:
        found = refusal(command, y, Kind.UNITS, expected=Expectations(input_range=(-limit_v, limit_v)))
        assert "limited" in found.remedy
    else:
        warning(design.identify(command, y, T), Kind.NOT_EXPLAINED)


# Disturbances of the plant


@pytest.mark.parametrize("share", [0.3, 1.0])
@pytest.mark.parametrize("seed", [2, 3])
def test_drift_is_reported_and_can_be_estimated(share: float, seed: int) -> None:
    u, y = noisy(seed=seed)
    drift = share * y.std()
    y += drift * np.linspace(-0.5, 0.5, SAMPLES)
    found = warning(design.identify(u, y, T), Kind.DRIFT)
    # Two thirds of the record are fitted.
    assert found.figure == pytest.approx(2.0 / 3.0 * drift, rel=0.25)
    estimated = design.identify(u, y, T, drift=True)
    assert not estimated.doubtful
    assert_right(estimated)


@pytest.mark.parametrize("share", [5.0, 50.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_drift_that_hides_the_plant_is_named(share: float, seed: int) -> None:
    u, y = noisy(seed=seed)
    y += share * y.std() * np.linspace(-0.5, 0.5, SAMPLES)
    try:
        warning(design.identify(u, y, T), Kind.DRIFT)
    except design.RecordRefusedError as refused:
        assert "estimate the drift" in str(refused)
    assert_right(design.identify(u, y, T, drift=True))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_jump_of_the_offset_is_refused_or_reported(seed: int) -> None:
    u, y = noisy(seed=seed)
    y[2000:] += 2.0 * y.std()
    try:
        model = design.identify(u, y, T)
    except design.RecordRefusedError as refused:
        assert "if y drifts" in str(refused) or "if the output drifts" in str(refused)
        return
    warning(model, Kind.POOR_FIT)


def test_outliers_are_refused() -> None:
    u, y = noisy()
    y[::97] = 30.0 * y.std()
    refusal(u, y, Kind.POOR_FIT)


def test_coarse_converter_is_reported() -> None:
    u, y = noisy()
    step = y.std()
    assert warning(design.identify(u, step * np.round(y / step), T), Kind.RESOLUTION).figure < 20


@pytest.mark.parametrize("amplitude_v", [0.02, 0.05])
@pytest.mark.parametrize("seed", [1, 2])
def test_amplitude_that_friction_dominates_is_reported(amplitude_v: float, seed: int) -> None:
    u, y = excite(shipped_arm(), 0, amplitude_v, seed=seed)
    assert warning(design.identify(u, y, T), Kind.FRICTION).remedy == "raise the amplitude"


def test_amplitude_of_the_paper_gives_a_model_without_a_warning() -> None:
    u, y = excite(shipped_arm(), 0, 0.4, seed=1)
    assert not design.identify(u, y, T).doubtful


@pytest.mark.parametrize("play", [0.5, 1.0, 2.0])
def test_output_behind_wide_play_is_refused(play: float) -> None:
    u, y = clean()
    behind, width = [0.0], play * y.std()
    for value in y:
        behind.append(min(max(behind[-1], value - width), value + width))
    moved = np.array(behind[1:]) + 1e-3 * y.std() * np.random.default_rng(1).standard_normal(SAMPLES)
    refusal(u, moved, Kind.FRICTION)


# Rules of the interface


@pytest.mark.parametrize("structure", STRUCTURES)
def test_arrays_of_the_caller_are_not_altered(structure: str) -> None:
    u, y = noisy(2000)
    y[100:110] = np.nan
    weights = np.ones(2000)
    copies = [array.copy() for array in (u, y, weights)]
    design.identify(u, y, T, structure=structure, weights=weights, expected=Expectations(travel=(-1.0, 1.0)))
    for array, copy in zip((u, y, weights), copies, strict=True):
        np.testing.assert_array_equal(array, copy)
        assert array.flags.writeable


def test_estimation_data_are_refused_as_validation_data() -> None:
    u, y = noisy()
    record = design.Experiment(u, y, T)
    copied = design.Experiment(u.copy(), y.copy(), T, name="copy")
    for other in (record, copied):
        with pytest.raises(design.DesignError, match="estimation and validation data are the same"):
            design.identify_experiments([record], validation=[other])
    with pytest.raises(design.DesignError, match="estimation and validation data are the same"):
        design.identify(u, y, T, validation=[record])


def test_bad_validation_record_is_refused() -> None:
    u, y = noisy()
    other_u, other_y = noisy(seed=2)
    for bad_u, bad_y, kind in (
        (0.0 * other_u, other_y, Kind.CONSTANT_INPUT),
        (other_u, 0.0 * other_y, Kind.CONSTANT_OUTPUT),
        (other_u, np.nan * other_y, Kind.TOO_FEW_SAMPLES),
        (other_u[:5], other_y[:5], Kind.TOO_FEW_SAMPLES),
        (-other_u, other_y, Kind.POOR_FIT),
    ):
        found = refusal(u, y, kind, validation=[design.Experiment(bad_u, bad_y, T, name="second run")])
        assert found.record == "second run"


def test_experiments_that_do_not_fit_together_are_refused() -> None:
    u, y = noisy(2000)
    first = design.Experiment(u, y, T)
    with pytest.raises(design.DesignError, match="no experiment"):
        design.identify_experiments([])
    with pytest.raises(design.DesignError, match="sample time"):
        design.identify_experiments([first, design.Experiment(u, 2.0 * y, 2.0 * T, name="other")])
    with pytest.raises(design.DesignError, match="transport delays of 0, 1 samples"):
        design.identify_experiments([first, design.Experiment(u, 2.0 * y, T, transport_delay_samples=1)])


def test_one_bad_experiment_among_several_is_named() -> None:
    u, y = noisy(2000)
    records = [design.Experiment(u, y, T, name="first"), design.Experiment(u, 0.0 * y, T, name="second")]
    with pytest.raises(design.RecordRefusedError, match=r"^second: y: it stays at 0 m"):
        design.identify_experiments(records)


def garbage() -> dict[str, tuple[Array, Array]]:
    """Pairs of columns that no plant gives."""
    random = np.random.default_rng(11)
    u, y = noisy(600)
    k = np.arange(600)
    one = np.where(k == 300, 1.0, 0.0)
    return {
        "huge values": (1e45 * u, 1e45 * y),
        "tiny values": (1e-40 * u, 1e-40 * y),
        "subnormal values": (5e-324 * np.sign(u), 5e-324 * np.sign(y)),
        "huge offset": (u, y + 1e12),
        "one huge sample": (u, np.where(k == 100, 1e40, y)),
        "one sample differs": (u, one),
        "impulse": (one, y),
        "step": (np.where(k < 20, 0.0, 1.0), y),
        "alternating": (np.where(k % 2, 1.0, -1.0), y),
        "ramps": (k * 1.0, k * 2.0),
        "exponential": (u, np.exp(0.5 * k)),
        "equal columns": (u, u),
        "output precedes input": (u, np.roll(u, -5)),
        "white": (random.standard_normal(600), random.standard_normal(600)),
        "heavy tails": (random.standard_cauchy(600), random.standard_cauchy(600)),
        "whole numbers": (np.sign(u).astype(np.int64), np.round(1e3 * y).astype(np.int64)),
        "truth values": (u > 0.0, y > 0.0),
        "negative zero": (-0.0 * k, -0.0 * k),
    }


@pytest.mark.parametrize("structure", STRUCTURES)
@pytest.mark.parametrize("label", garbage())
def test_garbage_gives_a_finite_model_or_a_refusal(label: str, structure: str) -> None:
    u, y = garbage()[label]
    try:
        model = design.identify(u, y, T, structure=structure)
    except design.DesignError as refused:
        assert len(str(refused)) > 20
        return
    assert np.isfinite(np.concatenate([model.discrete.b, model.discrete.f])).all()
    assert model.fit_percent > 10.0 or model.doubtful
    severities = [list(Severity).index(finding.severity) for finding in model.findings]
    assert all(first <= second for first, second in pairwise(severities))


def test_nothing_is_expected_by_default() -> None:
    assert Expectations() == NOTHING_KNOWN
