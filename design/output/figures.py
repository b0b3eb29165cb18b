"""The paper's Figs 5 to 11, drawn for a design as SVG text. Each function names the figure that it draws.

What is drawn comes from ``comparison`` and the searches; how, from ``charts``. No computing beyond that.
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

# Okabe and Ito's colours, told apart also by those who do not see them all; dashes tell them apart in print.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#c0589a", "#b8860b", "#3d4450")
_DASHES = ("", "7 3", "2 2", "9 3 2 3", "5 2", "3 2")
_NOMINAL, _SHAPED, _LIMIT = (
    Style("#7d8790", "", 1.4),
    Style("#1b1f23", "5 3", 1.4),
    Style("#1b1f23", "5 3", 1.2),
)
_HORIZON_S = 3.0
"""Of steps that never settle."""
_SECONDS, _OMEGA = "time, s", "frequency, rad/s"


@dataclass(frozen=True)
class Figure:
    """One figure: its file's stem, its heading, what there is to see in it, and the drawing."""

    key: str
    title: str
    caption: str
    svg: str


def styles(candidates: Sequence[Candidate]) -> dict[str, Style]:
    """One style for each candidate, the same in every figure; the first stands out."""
    return {
        candidate.name: Style(_COLOURS[i % len(_COLOURS)], _DASHES[i % len(_DASHES)], 2.2 if i == 0 else 1.5)
        for i, candidate in enumerate(candidates)
    }


def identification(measured: ModelFit, unit: str) -> Figure:
    """Fig. 5: the record's measured output, and the model's output for the record's input."""
    t = measured.time_s
    output = Panel(
        Axis(_SECONDS),
        Axis(f"output, {unit}"),
        (
            Curve("measured", t, measured.measured, Style("#b3bcc5", "", 3.5)),
            Curve("model", t, measured.model, Style(_COLOURS[0], "", 1.2)),
        ),
    )
    drive = Panel(
        Axis(_SECONDS),
        Axis("input, V"),
        (Curve("", t, measured.input_v, Style("#1b1f23", "", 1.0), True),),
        height=90,
    )
    return Figure(
        "fig5-identification",
        "Fig. 5. Measured output and output of the model",
        f"The model follows {measured.source} to {measured.fit_percent:.2f} % (100 % less the relative root "
        "mean square of the difference), its initial state and the record's offset fitted.",
        draw([output, drive], "Fig 5"),
    )


def convergence(
    search: SearchResult, key: str, title: str, quantity: str, best_known: float | None
) -> Figure:
    """Figs 6 and 8: best fitness so far against the generation; where it is below 0 nothing met all yet."""
    generation = np.array([p.generation for p in search.convergence], dtype=float)
    fitness = np.array([p.best_fitness for p in search.convergence])
    feasible = np.where(fitness > 0.0, fitness, np.nan)
    limits = () if best_known is None else (Limit(best_known, f"ε_opt {best_known:.4f}"),)
    found = int(np.argmax(fitness > 0.0))
    reached = int(np.argmax(fitness >= 0.999 * search.best_fitness))
    first = f"{search.convergence[found].evaluations} candidates until one met everything, " if found else ""
    panel = Panel(
        Axis("generation", low=0.0),
        Axis(quantity),
        (Curve(search.searcher, generation, feasible, Style(_COLOURS[0], "", 1.8), holds=True),),
        limits,
        height=320,
    )
    return Figure(
        key,
        title,
        f"{search.searcher.capitalize()}, seed {search.seed}: {first}"
        f"{search.convergence[reached].evaluations} until 99.9 % of the best, {search.best_fitness:.5f}, "
        f"{search.evaluations} in all.",
        draw([panel], key),
    )


def open_loops(problem: Problem, candidates: Sequence[Candidate], all_styles: dict[str, Style]) -> Figure:
    """Fig. 7: Bode diagram of the nominal plant G, the shaped plant Gs, and the loops GK."""
    omega = problem.frequencies()
    G = problem.loop_plant
    responses = [
        ("plant G", problem.response(G, omega), _NOMINAL),
        ("shaped plant Gs", problem.response(shaped(G, problem.weight), omega), _SHAPED),
    ]
    responses += [
        (f"G·{c.name}", problem.response(shaped(G, c.controller.feedback), omega), all_styles[c.name])
        for c in candidates
    ]
    x = Axis(_OMEGA, logarithmic=True, low=float(omega[0]), high=float(omega[-1]))
    magnitude = tuple(
        Curve(name, omega, 20.0 * np.log10(np.abs(value)), style) for name, value, style in responses
    )
    phase = tuple(
        Curve(name, omega, np.degrees(np.unwrap(np.angle(value))), style) for name, value, style in responses
    )
    # Far below the crossover of every loop there is nothing left to see.
    low = max(-80.0, min(float(curve.y.min()) for curve in magnitude))
    lowest_phase = max(-360.0, min(float(curve.y.min()) for curve in phase))
    panels = [
        Panel(x, Axis("magnitude, dB", low=low, tick=20.0), magnitude, (Limit(0.0, ""),), height=210),
        Panel(x, Axis("phase, °", low=lowest_phase, tick=45.0), phase, (Limit(-180.0, ""),), height=150),
    ]
    return Figure(
        "fig7-bode",
        "Fig. 7. Open loops: plant, shaped plant, with each controller",
        "A loop that follows the shaped plant Gs keeps what the weight was chosen for.",
        draw(panels, "Fig 7"),
    )


def steps(
    key: str,
    title: str,
    caption: str,
    problem: Problem,
    chosen: Sequence[tuple[Candidate, Measures]],
    all_styles: dict[str, Style],
    specifications: Sequence[Specification],
) -> Figure:
    """Figs 9 and 10: unit step responses y of stable loops, the limits of eq. (9), and u."""
    settling = [m.settling_s for _, m in chosen if np.isfinite(m.settling_s)] or [_HORIZON_S]
    limits = {s.quantity: s.limit for s in specifications}
    # One loop that is much slower than the others does not squeeze them.
    shown = min(max(settling), 4.0 * min(settling))
    limit_s = limits.get("settling_s", 0.0)
    # Nor does a limit that all are far within.
    wanted_s = limit_s if limit_s <= 4.0 * shown else 0.0
    horizon_s = 2.0 * max(shown, wanted_s, 20.0 * problem.rig_sampling.period_s)
    responses = [(c.name, problem.step(c, horizon_s), all_styles[c.name]) for c, _ in chosen]
    sampled = problem.sampling is not None
    x = Axis(_SECONDS, low=0.0, high=horizon_s)
    y = tuple(Curve(name, r.time_s, r.y[0], style) for name, r, style in responses)
    u = tuple(Curve(name, r.time_s, r.u[0], style, holds=sampled) for name, r, style in responses)
    marks = []
    if "overshoot" in limits:
        marks.append(Limit(1.0 + limits["overshoot"], f"overshoot limit {100.0 * limits['overshoot']:g} %"))
    if 0.0 < limit_s < horizon_s:
        marks.append(Limit(limit_s, f"settled by {limit_s:g} s", of_x=True))
    top = max([1.02, 1.0 + limits.get("overshoot", 0.0), *(float(c.y.max()) for c in y)])
    panels = [
        Panel(
            x,
            Axis("y, unit step", low=min([0.0, *(float(c.y.min()) for c in y)]), high=top + 0.12),
            y,
            tuple(marks),
            (Band(0.98, 1.02, "± 2 %"),),
        ),
        Panel(x, Axis("u, V per unit"), u, (Limit(0.0, ""),), height=110),
    ]
    return Figure(key, title, caption, draw(panels, key))


def robustness(
    problem: Problem, stable: Sequence[Candidate], all_styles: dict[str, Style]
) -> tuple[Figure, Figure, Figure]:
    """Fig. 11 of stable loops: (a) 1/|GK/(1 + GK)|, (b) 1/|K/(1 + GK)|, (c) |G/(1 + GK)|, as in Table 1."""
    omega = problem.frequencies()
    unit = problem.plant.output_unit
    x = Axis(_OMEGA, logarithmic=True, low=float(omega[0]), high=float(omega[-1]))
    found = {candidate.name: problem.gains(candidate, omega) for candidate in stable}

    def figure(key: str, title: str, caption: str, label: str, values: Sequence[Array]) -> Figure:
        curves = tuple(
            Curve(name, omega, value, all_styles[name]) for name, value in zip(found, values, strict=True)
        )
        panel = Panel(x, Axis(label, logarithmic=True), curves, height=270)
        return Figure(key, title, caption, draw([panel], key))

    return (
        figure(
            "fig11a-multiplicative",
            "Fig. 11 (a). Largest multiplicative plant perturbation",
            "1/σ̄(GK(I + GK)⁻¹): so much relative error of the plant at its output, at this frequency, the "
            "loop is sure to bear; 1 is 100 % of the plant.",
            "1/|T|",
            [1.0 / gains.complementary for gains in found.values()],
        ),
        figure(
            "fig11b-additive",
            "Fig. 11 (b). Largest additive plant perturbation",
            "1/σ̄(K(I + GK)⁻¹): so much absolute error of the plant the loop is sure to bear; its inverse is "
            "the gain from output disturbance (and sensor noise) to the valve.",
            f"1/|K/(1 + GK)|, {unit}/V",
            [1.0 / gains.effort for gains in found.values()],
        ),
        figure(
            "fig11c-disturbance",
            "Fig. 11 (c). Gain from input disturbance to plant output",
            "σ̄((I + GK)⁻¹G): the lower, the better a disturbance at the valve is rejected.",
            f"|G/(1 + GK)|, {unit}/V",
            [gains.disturbance for gains in found.values()],
        ),
    )
