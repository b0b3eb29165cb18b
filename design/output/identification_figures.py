"""Draw the figures of the identification report as SVG text."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from design.errors import DesignError
from design.identification.analysis.comparison import Comparison
from design.identification.analysis.frequency_response import FrequencyResponse
from design.identification.analysis.residuals import Correlation
from design.identification.analysis.uncertainty import Properties, ResponseBand, Root, response_band
from design.identification.checks.dynamics_checks import NOTED_LOST_PERCENT, share_from_input
from design.identification.findings import Kind
from design.identification.identify import Identification
from design.identification.models.structures import ContinuousPoles, OutputError
from design.mathematics.polynomials import Array, Flags
from design.output.charts import (
    PANEL_WIDTH,
    Area,
    Curve,
    Limit,
    Marks,
    Panel,
    Shape,
    Style,
    area_between,
    draw,
)
from design.output.figures import Figure
from design.output.scales import Axis

MAX_POINTS = 3000
"""Largest number of points of a curve; a longer record is drawn by the extremes of its parts."""
MAX_RECORDS = 4
"""Largest number of validation records that are drawn."""
_SIGMAS = 1.959964
"""Half the width of a 95 % interval, in standard deviations."""
_MAX_DOTS = 70
"""Largest number of points of the response measured without a model, so that the model can be seen."""
_MAX_DEPTH_DB = 100.0
"""Height of the magnitude panel at most."""
_MIN_COHERENCE = 0.5
"""Points with a smaller coherence are drawn pale."""
_MAX_POLE_RATIO = 3.0
"""The pole-zero map reaches at most so many times as far as the fastest pole."""

# Okabe and Ito's colours, which colour-blind readers can distinguish.
_MODEL, _OTHER = "#0072b2", "#d55e00"
_MEASURED = Style("#9aa3ad", "", 3.2)
_SIMULATED = Style(_MODEL, "", 1.3)
_INPUT = Style("#1b1f23", "", 0.9)
_ESTIMATE, _PALE_ESTIMATE = Style(_OTHER, "", 2.0), Style("#e0a07a", "", 1.4)
_BAND, _BOUND = Style(_MODEL, "", 0.5), Style("#7d8790", "", 0.6)
_BAND_LABEL = "95 % of the model"
_TIME, _FREQUENCY = "time, s", "frequency, rad/s"


def output_figures(validation: Sequence[Comparison], unit: str) -> list[Figure]:
    """Draw measured and simulated output of each validation record, with the input below."""
    shown = validation[:MAX_RECORDS]
    figures = []
    for number, comparison in enumerate(shown):
        several = f" {number + 1}" if len(validation) > 1 else ""
        figures.append(_output_figure(comparison, unit, f"validation{several}"))
    return figures


def _output_figure(comparison: Comparison, unit: str, key: str) -> Figure:
    experiment = comparison.experiment
    time_s = experiment.time_s
    measured = np.where(experiment.observed, experiment.y, np.nan)
    x = Axis(_TIME, low=0.0, high=float(time_s[-1]))
    output = Panel(
        x,
        Axis(f"output, {unit}"),
        (
            Curve("measured", *_thinned(time_s, measured), _MEASURED),
            Curve("simulated", *_thinned(time_s, comparison.simulated), _SIMULATED),
        ),
        height=260,
    )
    drive = Panel(
        x,
        Axis(f"input, {experiment.names.u_unit}"),
        (Curve("", *_thinned(time_s, experiment.u), _INPUT, holds=True),),
        height=90,
    )
    left_out = int(np.count_nonzero(~experiment.observed))
    gaps = f" {left_out} of {len(experiment)} samples do not count, and are left out." if left_out else ""
    return Figure(
        key.replace(" ", "-"),
        f"Measured and simulated output: {experiment.name}",
        "Data that were not fitted. The simulation knows the measured input alone, besides an initial state "
        f"and an offset that are fitted to the record. Fit: {_percent(comparison.fit_percent)}.{gaps}",
        draw([output, drive], key),
    )


@dataclass(frozen=True)
class _Points:
    """The response measured without a model, thinned, as it is drawn; arrays (k,)."""

    omega_rad_s: Array
    magnitude_db: Array
    phase_deg: Array
    """Phase within 180° of the model's."""
    is_good: Flags
    """True where the coherence is at least _MIN_COHERENCE."""


def bode_figure(identification: Identification, unit: str) -> Figure:
    """Draw the model with its 95 % band over the response that was measured without a model."""
    measured: FrequencyResponse | None = None
    try:
        measured = identification.frequency_response()
    except DesignError as reason:
        note = f" No response could be measured without a model: {reason}."
    else:
        note = (
            f" Points: the response measured without a model ({measured.method}); pale where less than half "
            "of the output comes from the input, so that the point means little."
        )
    nyquist_rad_s = float(np.pi / identification.discrete.sample_time_s)
    lowest = min(_lowest_frequency(identification, measured), 0.1 * nyquist_rad_s)
    omega = np.geomspace(lowest, 0.98 * nyquist_rad_s, 300)
    x = Axis(_FREQUENCY, logarithmic=True, low=lowest, high=nyquist_rad_s)
    band = response_band(identification.estimate, omega)
    points = None if measured is None else _points(measured, band)
    panels = [_magnitude_panel(x, band, points, unit), _phase_panel(x, band, points)]
    if measured is not None:
        coherence = Curve("coherence", measured.omega_rad_s, measured.coherence, Style("#3d4450", "4 2", 1.2))
        panels.append(Panel(x, Axis("coherence", low=0.0, high=1.05), (coherence,), height=80))
    return Figure(
        "bode",
        "Bode diagram from the held input to the sampled output",
        "Line: the model, with the interval that contains the plant with a probability of 95 % at each "
        "frequency if the structure is right. Where the interval cannot be seen, it is narrower than the "
        f"line.{note}",
        draw(panels, "bode"),
    )


def _magnitude_panel(x: Axis, band: ResponseBand, points: _Points | None, unit: str) -> Panel:
    magnitude_db, reach = _db(np.abs(band.response)), _SIGMAS * band.magnitude_std
    low_db, high_db = magnitude_db + _db(np.maximum(1.0 - reach, 1e-3)), magnitude_db + _db(1.0 + reach)
    seen = [magnitude_db] if points is None else [magnitude_db, points.magnitude_db[points.is_good]]
    low, high = (float(end(np.concatenate(seen))) for end in (np.min, np.max))
    y = Axis(
        f"magnitude, dB ({unit}/V)", low=max(low, high - _MAX_DEPTH_DB) - 8.0, high=high + 8.0, tick=20.0
    )
    return Panel(
        x,
        y,
        (Curve("model", band.omega_rad_s, magnitude_db, _SIMULATED),),
        marks=_marks(points, lambda p: p.magnitude_db),
        areas=(area_between(_BAND_LABEL, band.omega_rad_s, low_db, high_db, _BAND),),
        height=210,
    )


def _phase_panel(x: Axis, band: ResponseBand, points: _Points | None) -> Panel:
    phase_deg = np.degrees(np.unwrap(np.angle(band.response)))
    reach = np.degrees(np.minimum(_SIGMAS * band.phase_std_rad, np.pi))
    seen = [phase_deg] if points is None else [phase_deg, points.phase_deg[points.is_good]]
    low, high = (float(end(np.concatenate(seen))) for end in (np.min, np.max))
    return Panel(
        x,
        Axis("phase, °", low=min(-180.0, low) - 20.0, high=max(0.0, high) + 20.0, tick=90.0),
        (Curve("model", band.omega_rad_s, phase_deg, _SIMULATED),),
        marks=_marks(points, lambda p: p.phase_deg),
        areas=(area_between(_BAND_LABEL, band.omega_rad_s, phase_deg - reach, phase_deg + reach, _BAND),),
        height=150,
    )


def residual_figure(identification: Identification) -> Figure:
    """Draw the correlation of the residuals with themselves and with the input, with their bounds."""
    residuals = identification.residuals
    own, before, after = residuals.whiteness, residuals.to_input, residuals.from_input
    past_lags = np.concatenate([-own.lags[::-1], own.lags])
    past, bounds = (np.concatenate([side[::-1], side]) for side in (own.values, own.bounds))
    lags, cross, cross_bounds = (
        np.concatenate([getattr(before, key)[:0:-1], getattr(after, key)])
        for key in ("lags", "values", "bounds")
    )
    reach = float(np.abs(lags).max()) + 0.6
    x = Axis("lag, samples", low=-reach, high=reach)
    panels = [
        _correlation_panel(x, "with themselves", own.level, past_lags, past, bounds),
        _correlation_panel(x, "with the input", after.level, lags, cross, cross_bounds),
    ]
    noise_is_modelled = len(identification.discrete.c) + len(identification.discrete.d) > 2
    return Figure(
        "residuals",
        "Residuals: correlation with themselves and with the input",
        f"Above: {_whiteness_text(own, noise_is_modelled)} Below: {_dynamics_text(identification)} "
        f"{_feedback_text(before)} At positive lags the input comes first. Shaded: the interval in which "
        f"{100.0 * own.level:g} % of the values lie if there is no correlation.",
        draw(panels, "residuals"),
    )


def pole_zero_figure(known: Properties) -> Figure:
    """Draw poles and zeros in the s plane with their 95 % regions, at one scale on both axes."""
    zeros = known.zeros or ()
    reach = 1.25 * max([abs(pole.value) for pole in known.poles] or [1.0]) or 1.0
    farthest = _MAX_POLE_RATIO * reach
    inside = [zero for zero in zeros if abs(zero.value) <= farthest]
    outside = [zero for zero in zeros if abs(zero.value) > farthest]
    points = np.array([root.value for root in (*known.poles, *inside)] or [0j])
    x_low, x_high = min(float(points.real.min()), 0.0), max(float(points.real.max()), 0.0)
    y_high = max(float(np.abs(points.imag).max()), 0.25 * (x_high - x_low), 1e-6)
    x_low, x_high = x_low - 0.15 * max(x_high - x_low, y_high), x_high + 0.15 * max(x_high - x_low, y_high)
    y_high *= 1.2
    height = int(np.clip(2.0 * y_high / (x_high - x_low) * PANEL_WIDTH, 200, 420))
    # One scale on both axes: the shorter side is widened.
    wanted = 2.0 * y_high * PANEL_WIDTH / height
    spare = max(0.0, wanted - (x_high - x_low))
    x_low, x_high = x_low - 0.5 * spare, x_high + 0.5 * spare
    y_high = max(y_high, 0.5 * (x_high - x_low) * height / PANEL_WIDTH)
    regions = [
        *((root, "95 % region of a pole", Style(_MODEL, "", 1.4)) for root in known.poles),
        *((root, "95 % region of a zero", Style(_OTHER, "", 1.4)) for root in inside),
    ]
    areas = tuple(_region(root, label, style) for root, label, style in regions)
    panel = Panel(
        Axis("real part, rad/s", low=x_low, high=x_high),
        Axis("imaginary part, rad/s", low=-y_high, high=y_high),
        (),
        (Limit(0.0, "", of_x=True), Limit(0.0, "")),
        height=height,
        marks=(
            _root_marks("pole", known.poles, _MODEL, Shape.CROSS),
            *([_root_marks("zero", inside, _OTHER, Shape.CIRCLE)] if inside else []),
        ),
        areas=areas,
    )
    far = ", ".join(_root_text(zero.value) for zero in outside)
    note = f" Outside the figure: the zeros {far} rad/s." if outside else ""
    if known.zeros is None:
        note = " The sampled model has no continuous counterpart, so the zeros in s are not known."
    return Figure(
        "pole-zero-map",
        "Poles and zeros of the continuous model, with 95 % confidence regions",
        "The region of a real root is a line. If a region reaches the imaginary axis, the record does not "
        f"prove that the plant is stable.{note}",
        draw([panel], "pole-zero map"),
    )


def _region(root: Root, label: str, style: Style) -> Area:
    ellipse = root.ellipse()
    return Area(label, ellipse.real.copy(), ellipse.imag.copy(), style)


def _root_marks(label: str, roots: Sequence[Root], colour: str, shape: Shape) -> Marks:
    values = np.array([root.value for root in roots], dtype=np.complex128)
    return Marks(label, values.real.copy(), values.imag.copy(), Style(colour, "", 2.0), shape)


def _root_text(value: complex) -> str:
    imaginary = "" if abs(value.imag) < 1e-9 * max(abs(value), 1e-300) else f" {value.imag:+.3g}j"
    return f"{value.real:.3g}{imaginary}".replace("-", "−")


def _correlation_panel(x: Axis, what: str, level: float, lags: Array, values: Array, bounds: Array) -> Panel:
    high = 1.15 * float(np.nanmax(np.abs(np.concatenate([values, bounds])), initial=0.05))
    return Panel(
        x,
        Axis(what, low=-high, high=high),
        (),
        (Limit(0.0, ""),),
        marks=(Marks("", lags, values, Style(_MODEL, "", 1.3), Shape.STEM),),
        areas=(area_between(f"{100.0 * level:g} % bounds", lags, -bounds, bounds, _BOUND),),
        height=200,
    )


def _whiteness_text(correlation: Correlation, noise_is_modelled: bool) -> str:
    if correlation.passed:
        return "the residuals are white."
    if noise_is_modelled:
        return "the residuals are not white, so the model of the noise is incomplete."
    return (
        "the residuals are not white. This structure does not describe the noise, so that alone does not "
        "speak against the plant."
    )


def _dynamics_text(identification: Identification) -> str:
    """Return what the correlation with earlier inputs means, in agreement with the findings."""
    correlation = identification.residuals.from_input
    if correlation.passed:
        return "no correlation with earlier inputs, so the dynamics are complete."
    if {finding.kind for finding in identification.findings} & {Kind.NOT_EXPLAINED, Kind.DEAD_TIME}:
        return (
            "a correlation with earlier inputs, so the model lacks dynamics that the record shows; see the "
            "finding."
        )
    share = 100.0 * share_from_input(identification.residuals)
    small = (
        "a correlation with earlier inputs, so the model lacks dynamics that the record shows. It is no "
        f"finding: at no single lag does the input explain more than {share:.2g} % of the residuals' variance"
    )
    were_delays_tried = isinstance(identification.structure, OutputError | ContinuousPoles)
    if were_delays_tried and identification.discrete.stable:
        return (
            f"{small}, and no other delay of the model would raise the fit by more than "
            f"{NOTED_LOST_PERCENT:g} %."
        )
    return f"{small}. Other delays were not tried for this model."


def _feedback_text(correlation: Correlation) -> str:
    if correlation.passed:
        return "There is none with later inputs, so there is no sign of feedback."
    return (
        "There is one with later inputs too. It means feedback only if a finding says so: missing dynamics "
        "and an input that changes slowly have the same effect."
    )


def _thinned(x: Array, y: Array) -> tuple[Array, Array]:
    """Return a curve with at most MAX_POINTS points that keeps the extremes of each part and its gaps."""
    if len(x) <= MAX_POINTS:
        return x, y
    size = -(-2 * len(x) // MAX_POINTS)
    parts = len(x) // size
    blocks = y[: parts * size].reshape(parts, size)
    known = np.isfinite(blocks)
    ends = [
        np.argmin(np.where(known, blocks, np.inf), axis=1),
        np.argmax(np.where(known, blocks, -np.inf), axis=1),
    ]
    places = (np.sort(np.stack(ends, axis=1), axis=1) + size * np.arange(parts)[:, None]).ravel()
    return x[places], y[places]


def _lowest_frequency(identification: Identification, measured: FrequencyResponse | None) -> float:
    if measured is not None:
        return float(measured.omega_rad_s[0])
    samples = max(map(len, identification.estimate.experiments))
    return float(2.0 * np.pi / (samples * identification.discrete.sample_time_s))


def _points(measured: FrequencyResponse, band: ResponseBand) -> _Points:
    every = -(-len(measured.omega_rad_s) // _MAX_DOTS)
    omega, response = measured.omega_rad_s[::every], measured.response[::every]
    # The model's phase is continuous; a measured one is known up to full turns.
    phase = np.interp(np.log(omega), np.log(band.omega_rad_s), np.unwrap(np.angle(band.response)))
    phase = phase + np.angle(response * np.exp(-1j * phase))
    is_good = measured.coherence[::every] >= _MIN_COHERENCE
    return _Points(omega, _db(np.abs(response)), np.degrees(phase), is_good)


def _marks(points: _Points | None, values: Callable[[_Points], Array]) -> tuple[Marks, ...]:
    """Return the points measured without a model, the doubtful ones apart."""
    if points is None:
        return ()
    y = values(points)
    sides = (
        (~points.is_good, "measured, coherence under 0.5", _PALE_ESTIMATE),
        (points.is_good, "measured without a model", _ESTIMATE),
    )
    return tuple(
        Marks(label, points.omega_rad_s[side], y[side], style) for side, label, style in sides if side.any()
    )


def _db(magnitude: Array) -> Array:
    with np.errstate(divide="ignore"):
        return np.asarray(20.0 * np.log10(magnitude))


def _percent(value: float) -> str:
    return f"{value:.2f} %" if np.isfinite(value) else "none, the model is unstable"
