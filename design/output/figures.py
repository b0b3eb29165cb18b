"""Draw the figures of a design as SVG text.

The data comes from ``comparison`` and from the searches; ``charts`` draws it. ``figure_set`` decides which
figures a design gets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from design.closed_loop.comparison import Candidate, Measures, Problem
from design.closed_loop.specifications import Specification
from design.mathematics.polynomials import Array
from design.models.measured_record import ModelFit
from design.output.charts import Band, Curve, Limit, Panel, Style, draw
from design.output.scales import Axis
from design.robustness.loop_shaping import shaped
from design.search.searcher import SearchResult

# Okabe and Ito's colours, which colour-blind readers can distinguish; the dashes distinguish curves in print.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#c0589a", "#b8860b", "#3d4450")
_DASHES = ("", "7 3", "2 2", "9 3 2 3", "5 2", "3 2")
_PLANT = Style("#7d8790", "", 1.4)
_SHAPED_PLANT = Style("#1b1f23", "5 3", 1.4)
_MEASURED = Style("#b3bcc5", "", 3.5)
_INPUT = Style("#1b1f23", "", 1.0)
_HORIZON_S = 3.0
"""Settling time that is assumed for the time axis if no loop settles."""
_MAX_TIME_RATIO = 4.0
"""Largest ratio of the time axis to the fastest loop. A slower loop, or a later limit, is cut off."""
_MIN_PERIODS = 20.0
"""Smallest number of sampling periods on half the time axis."""
_MIN_GAIN_DB, _MIN_PHASE_DEG = -80.0, -360.0
"""Lower ends of the Bode diagram; no loop has its crossover below them."""
_TIME, _FREQUENCY = "time, s", "frequency, rad/s"

Styles = dict[str, Style]
"""Styles of the candidates by name."""


@dataclass(frozen=True)
class Figure:
    """One figure: stem of its file name, title, a caption that says what it shows, and the SVG text."""

    key: str
    title: str
    caption: str
    svg: str


def candidate_styles(candidates: Sequence[Candidate]) -> Styles:
    """Return one style for each candidate, to be used in every figure; the first is the thickest."""
    return {
        candidate.name: Style(_COLOURS[i % len(_COLOURS)], _DASHES[i % len(_DASHES)], 2.2 if i == 0 else 1.5)
        for i, candidate in enumerate(candidates)
    }


def identification(measured: ModelFit, unit: str) -> Figure:
    """Draw a measured record's output, and the model's output for the same input."""
    t = measured.time_s
    output = Panel(
        Axis(_TIME),
        Axis(f"output, {unit}"),
        (
            Curve("measured", t, measured.measured, _MEASURED),
            Curve("model", t, measured.model, Style(_COLOURS[0], "", 1.2)),
        ),
    )
    drive = Panel(
        Axis(_TIME), Axis("input, V"), (Curve("", t, measured.input_v, _INPUT, holds=True),), height=90
    )
    return Figure(
        "identification",
        "Measured output and output of the model",
        f"The model follows {measured.source} to {measured.fit_percent:.2f} % (100 % minus the relative root "
        "mean square of the difference). Initial state and offset are fitted to the record.",
        draw([output, drive], "identification"),
    )


def convergence(
    search: SearchResult, key: str, title: str, quantity: str, upper_bound: float | None
) -> Figure:
    """Draw the best fitness so far over the generations, from the first candidate that meets everything."""
    generation = np.array([p.generation for p in search.convergence], dtype=float)
    fitness = np.array([p.best_fitness for p in search.convergence])
    feasible = np.where(fitness > 0.0, fitness, np.nan)
    limits = () if upper_bound is None else (Limit(upper_bound, f"ε_opt {upper_bound:.4f}"),)
    panel = Panel(
        Axis("generation", low=0.0),
        Axis(quantity),
        (Curve(search.searcher, generation, feasible, Style(_COLOURS[0], "", 1.8), holds=True),),
        limits,
        height=320,
    )
    first = int(np.argmax(fitness > 0.0))
    nearly_best = int(np.argmax(fitness >= 0.999 * search.best_fitness))
    evaluations = [p.evaluations for p in search.convergence]
    start = f"{evaluations[first]} candidates until one met all specifications, " if first else ""
    return Figure(
        key,
        title,
        f"{search.searcher.capitalize()}, seed {search.seed}: {start}{evaluations[nearly_best]} until 99.9 % "
        f"of the best value, {search.best_fitness:.5f}; {search.evaluations} candidates in all.",
        draw([panel], key),
    )


def open_loops(problem: Problem, candidates: Sequence[Candidate], styles: Styles) -> Figure:
    """Draw the Bode diagram of the plant G, the shaped plant Gs, and the loops GK."""
    omega = problem.frequencies()
    G = problem.loop_plant
    responses = [
        ("plant G", problem.response(G, omega), _PLANT),
        ("shaped plant Gs", problem.response(shaped(G, problem.weight), omega), _SHAPED_PLANT),
    ]
    responses += [
        (f"G·{c.name}", problem.response(shaped(G, c.controller.feedback), omega), styles[c.name])
        for c in candidates
    ]
    x = _frequency_axis(omega)
    magnitude = tuple(
        Curve(name, omega, 20.0 * np.log10(np.abs(value)), style) for name, value, style in responses
    )
    phase = tuple(
        Curve(name, omega, np.degrees(np.unwrap(np.angle(value))), style) for name, value, style in responses
    )
    lowest_gain = max(_MIN_GAIN_DB, min(float(curve.y.min()) for curve in magnitude))
    lowest_phase = max(_MIN_PHASE_DEG, min(float(curve.y.min()) for curve in phase))
    panels = [
        Panel(x, Axis("magnitude, dB", low=lowest_gain, tick=20.0), magnitude, (Limit(0.0, ""),), height=210),
        Panel(x, Axis("phase, °", low=lowest_phase, tick=45.0), phase, (Limit(-180.0, ""),), height=150),
    ]
    return Figure(
        "open-loops",
        "Open loops: plant, shaped plant, and the loop with each controller",
        "A loop GK that follows the shaped plant Gs keeps the properties for which the weight was selected.",
        draw(panels, "open loops"),
    )


def step_responses(
    key: str,
    title: str,
    caption: str,
    problem: Problem,
    chosen: Sequence[tuple[Candidate, Measures]],
    styles: Styles,
    specifications: Sequence[Specification],
) -> Figure:
    """Draw unit step responses y and u of stable loops, with the limits on overshoot and settling time."""
    limits = {s.quantity: s.limit for s in specifications}
    settling_limit_s = limits.get("settling_s", 0.0)
    horizon_s = _horizon_s(problem, [measures for _, measures in chosen], settling_limit_s)
    responses = [(c.name, problem.step(c, horizon_s), styles[c.name]) for c, _ in chosen]
    is_sampled = problem.sampling is not None
    x = Axis(_TIME, low=0.0, high=horizon_s)
    y = tuple(Curve(name, r.time_s, r.y[0], style) for name, r, style in responses)
    u = tuple(Curve(name, r.time_s, r.u[0], style, holds=is_sampled) for name, r, style in responses)
    marks = []
    if "overshoot" in limits:
        marks.append(Limit(1.0 + limits["overshoot"], f"overshoot limit {100.0 * limits['overshoot']:g} %"))
    if 0.0 < settling_limit_s < horizon_s:
        marks.append(Limit(settling_limit_s, f"settled by {settling_limit_s:g} s", of_x=True))
    low = min([0.0, *(float(c.y.min()) for c in y)])
    high = max([1.02, 1.0 + limits.get("overshoot", 0.0), *(float(c.y.max()) for c in y)]) + 0.12
    panels = [
        Panel(x, Axis("y, unit step", low=low, high=high), y, tuple(marks), (Band(0.98, 1.02, "± 2 %"),)),
        Panel(x, Axis("u, V per unit"), u, (Limit(0.0, ""),), height=110),
    ]
    return Figure(key, title, caption, draw(panels, key))


def robustness(
    problem: Problem, stable: Sequence[Candidate], styles: Styles
) -> tuple[Figure, Figure, Figure]:
    """Draw the three gains of the paper's Table 1 for stable loops: 1/|T|, 1/|K/(1 + GK)|, |G/(1 + GK)|."""
    omega = problem.frequencies()
    unit = problem.plant.output_unit
    gains = {candidate.name: problem.gains(candidate, omega) for candidate in stable}

    def figure(key: str, title: str, caption: str, label: str, values: Sequence[Array]) -> Figure:
        curves = tuple(
            Curve(name, omega, value, styles[name]) for name, value in zip(gains, values, strict=True)
        )
        panel = Panel(_frequency_axis(omega), Axis(label, logarithmic=True), curves, height=270)
        return Figure(key, title, caption, draw([panel], key))

    return (
        figure(
            "multiplicative-perturbation",
            "Largest multiplicative plant perturbation",
            "1/σ̄(GK(I + GK)⁻¹): the loop is certain to survive a relative error of the plant of this size "
            "at this frequency; 1 is 100 % of the plant.",
            "1/|T|",
            [1.0 / gain.complementary for gain in gains.values()],
        ),
        figure(
            "additive-perturbation",
            "Largest additive plant perturbation",
            "1/σ̄(K(I + GK)⁻¹): the loop is certain to survive an absolute error of the plant of this size. "
            "The inverse is the gain from output disturbance and sensor noise to the valve.",
            f"1/|K/(1 + GK)|, {unit}/V",
            [1.0 / gain.effort for gain in gains.values()],
        ),
        figure(
            "disturbance-gain",
            "Gain from input disturbance to plant output",
            "σ̄((I + GK)⁻¹G): the smaller the gain, the better the loop rejects a disturbance at the valve.",
            f"|G/(1 + GK)|, {unit}/V",
            [gain.disturbance for gain in gains.values()],
        ),
    )


def _horizon_s(problem: Problem, chosen: Sequence[Measures], settling_limit_s: float) -> float:
    """Return the end of the time axis in s: twice the slowest settling time or twice the limit, if later.

    A loop that is much slower than the fastest one is cut off, so that it does not compress the others; so is
    a limit far beyond all loops.
    """
    settling_s = [m.settling_s for m in chosen if np.isfinite(m.settling_s)] or [_HORIZON_S]
    slowest_s = min(max(settling_s), _MAX_TIME_RATIO * min(settling_s))
    limit_s = settling_limit_s if settling_limit_s <= _MAX_TIME_RATIO * slowest_s else 0.0
    return 2.0 * max(slowest_s, limit_s, _MIN_PERIODS * problem.rig_sampling.period_s)


def _frequency_axis(omega: Array) -> Axis:
    return Axis(_FREQUENCY, logarithmic=True, low=float(omega[0]), high=float(omega[-1]))
