"""Check what the paper prints of model, weight, controllers and searches: eqs. (9) to (20), Figs 6, 8."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from design.closed_loop.specifications import Reading
from design.mathematics import polynomials as poly
from design.mathematics.polynomials import Array
from design.models.plant import Plant
from design.models.transfer_function import TransferFunction
from design.paper import printed
from design.paper.checked_claim import CheckedClaim, check_number, check_statement
from design.paper.evidence import Evidence
from design.paper.searches import Runs
from design.robustness import margins
from design.robustness.central_controller import optimal_margins
from design.robustness.loop_shaping import shaped
from design.synthesis import baselines
from design.synthesis.design_file import CONTROLLER_CHROMOSOMES

_MIN_SHARE_ABOVE_CHANCE = 0.75
"""Smallest share of pairs of runs for which one search counts as better than the other."""
_MIN_SHARE_OF_SEEDS = 0.75
"""Smallest share of seeds on which the genetic algorithm must reach the paper's margin."""
_EPS_TOLERANCE = 5e-6
_PRINTED_EPS_TOLERANCE = 5e-4
"""Tolerance of margins that the paper prints with three digits."""
_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def check_model(evidence: Evidence) -> Iterator[CheckedClaim]:
    """Check eq. (15), the identified plant, and its misprint in eq. (17)."""
    num = _output_error_numerator(evidence.plant)
    reading = "OE(1,3,1) with eq. (15)'s poles and static gain, zero-order hold inverted"
    yield check_number(
        "eq. (15)", "gain of the identified model", printed.PLANT_GAIN, float(num[1]), 1e-5, reading
    )
    yield check_number(
        "eq. (15)",
        "zero of the identified model",
        printed.PLANT_ZERO_RAD_S,
        float(num[2] / num[1]),
        0.005,
        f"{reading}; the paper leaves out a term {num[0]:.2g} s², an effect of sampling, not of physics",
        unit=" rad/s",
    )
    correct, misprinted = (
        _eps_opt(_plant_with_damping(damping)) for damping in (printed.DAMPING, printed.MISPRINTED_DAMPING)
    )
    yield check_number(
        "eq. (17)",
        f"ε_opt with the damping term {printed.MISPRINTED_DAMPING} of eq. (17)",
        printed.EPS_OPT,
        misprinted,
        _EPS_TOLERANCE,
        f"{printed.MISPRINTED_DAMPING} is a misprint of {printed.DAMPING} in eq. (15), which gives "
        f"{correct:.6f}",
        must_agree=False,
    )


def check_weight(evidence: Evidence) -> Iterator[CheckedClaim]:
    """Check the weight of eq. (16), the specifications of eq. (9), and the search of Fig. 6."""
    G = evidence.plant.transfer_function()
    yield check_number(
        "Sec. IV", "ε_opt of W1 (16), Appendix A", printed.EPS_OPT, _eps_opt(G), _EPS_TOLERANCE
    )
    yield check_number(
        "Sec. IV",
        "crossover of the shaped plant",
        4.0,
        float(margins.crossover(shaped(G, printed.W1))[0]),
        0.1,
        unit=" rad/s",
    )
    met = sum(reading.met for reading in evidence.weight_readings)
    yield check_statement(
        "eq. (9)",
        "W1 (16) meets the specifications",
        f"{met} of {len(evidence.weight_readings)} met",
        met == len(evidence.weight_readings),
        "gain and crossover are read off Gs, times off the closed loop with K = W1 K∞: "
        + "; ".join(map(_short_text, evidence.weight_readings)),
    )
    best = evidence.best_weight
    at = ", ".join(f"{name} {value:.5g}" for name, value in best.parameters.items())
    shortfall_percent = 100.0 * (1.0 - printed.EPS_OPT / best.eps_opt)
    yield check_number(
        "Fig. 6",
        "largest ε_opt that meets them",
        printed.EPS_OPT,
        best.eps_opt,
        _EPS_TOLERANCE,
        f"eq. (16) is {shortfall_percent:.1f} % below the optimum of eq. (8), which lies at {at}",
        must_agree=False,
    )
    genetic, random = evidence.searches.genetic_weights, evidence.searches.random_weights
    yield _weight_search(genetic, random)
    yield _better_than_chance("Fig. 6", genetic, random)


def check_loop_shaping(evidence: Evidence) -> Iterator[CheckedClaim]:
    """Check the conventional controller of eq. (18)."""
    G = evidence.plant.transfer_function()
    yield check_number(
        "Sec. IV",
        "ε of the conventional controller",
        printed.HLS_EPS,
        _eps_opt(G) / 1.1,
        _EPS_TOLERANCE,
        "γ = 1.1 γ_opt",
    )
    K = baselines.loop_shaping_controller(G, printed.W1, 1.1)
    num, den = (np.ravel(p) / np.ravel(K.den)[0] for p in (K.num, K.den))
    num = np.trim_zeros(np.where(np.abs(num) < 1e-9 * np.abs(num).max(), 0.0, num), "f")
    yield check_statement(
        "eq. (18)",
        "order of the controller is five",
        f"order {len(den) - 1}",
        len(den) == len(printed.HLS.den),
    )
    # The leading coefficient of the denominator is 1 by normalisation: there is nothing to compare.
    yield from _coefficients("numerator", num, printed.HLS.num)
    yield from _coefficients("denominator", den[1:], printed.HLS.den[1:])
    achieved = evidence.measures["HLS (18)"].eps_continuous
    yield check_statement(
        "eq. (6)",
        "its margin is at least the ε that it was designed for",
        f"ε {achieved:.4f}",
        achieved >= printed.HLS_EPS - _EPS_TOLERANCE,
    )


def check_synthesis(evidence: Evidence) -> Iterator[CheckedClaim]:
    """Check the proposed controller of eq. (20) and the search of Fig. 8."""
    ppid = evidence.measures["PPID (20)"].eps_continuous
    yield check_number("Fig. 8", "ε of PPID (20), eq. (13)", printed.PPID_EPS, ppid, _PRINTED_EPS_TOLERANCE)
    optimum = evidence.optimum
    at = ", ".join(f"{name} {value:.5g}" for name, value in optimum.parameters.items())
    yield check_number(
        "eq. (20)",
        "largest ε of a PID in the paper's search range",
        printed.PPID_EPS,
        optimum.eps,
        _PRINTED_EPS_TOLERANCE,
        f"eq. (20) is not the optimum: {optimum.search.searcher} finds {at}",
        must_agree=False,
    )
    genetic, random = evidence.searches.genetic_controllers, evidence.searches.random_controllers
    last = genetic.after(-1)
    median = float(np.median(last))
    stopped_short = "; the paper's run ended below what its search typically reaches"
    yield check_number(
        "Fig. 8",
        "ε that the paper's search typically finds",
        printed.PPID_EPS,
        median,
        0.01 * printed.PPID_EPS,
        f"median of {len(genetic)} seeds, which reach {last.min():.4f} to {last.max():.4f}"
        + (stopped_short if median > printed.PPID_EPS else ""),
        must_agree=False,
    )
    target = printed.PPID_EPS - _PRINTED_EPS_TOLERANCE
    reached = genetic.number_reaching(target)
    size = f"{printed.CONTROLLER_GENERATIONS} generations of {CONTROLLER_CHROMOSOMES} chromosomes"
    yield check_statement(
        "Fig. 8",
        "the paper's search reaches the margin of PPID (20)",
        f"on {reached} of {len(genetic)} seeds",
        reached >= _MIN_SHARE_OF_SEEDS * len(genetic),
        f"{printed.PPID_EPS} or more after {size}, on at least three of four seeds; random search of the "
        f"same size reaches it on {random.number_reaching(target)}",
    )
    yield _better_than_chance("Fig. 8", genetic, random)


def _weight_search(genetic: Runs, random: Runs) -> CheckedClaim:
    target, generation, seeds = 0.99 * printed.EPS_OPT, printed.CONVERGED_AT_GENERATION, len(genetic)
    is_rare = genetic.number_reaching(target) < seeds / 2
    return check_number(
        "Fig. 6",
        f"ε_opt that the paper's search has found by the {generation}th generation",
        printed.EPS_OPT,
        float(np.median(genetic.after(generation))),
        0.01 * printed.EPS_OPT,
        f"median of {seeds} seeds. Within 1 % of the printed figure or above: "
        f"{genetic.number_reaching(target, generation)} seeds by then, {genetic.number_reaching(target)} at "
        f"the end; no weight at all: {seeds - genetic.number_reaching(1e-9)} seeds. Random search of the "
        f"same size: {random.number_reaching(target, generation)}, {random.number_reaching(target)} and "
        f"{seeds - random.number_reaching(1e-9)} seeds"
        + ("; the paper shows a lucky run" if is_rare else ""),
        must_agree=False,
    )


def _better_than_chance(where: str, genetic: Runs, random: Runs) -> CheckedClaim:
    share = genetic.share_above(random)
    return CheckedClaim(
        where,
        "the paper's search is better than chance",
        "implied",
        f"in {100.0 * share:.0f} % of pairs of runs",
        share >= _MIN_SHARE_ABOVE_CHANCE,
        False,
        "compared with random search of the same size; better means in "
        f"{100.0 * _MIN_SHARE_ABOVE_CHANCE:.0f} % of pairs or more; medians "
        f"{np.median(genetic.after(-1)):.4f} and {np.median(random.after(-1)):.4f}",
    )


def _coefficients(name: str, computed: Array, expected: Array) -> Iterator[CheckedClaim]:
    """Check coefficients in falling powers of s, beginning with the lowest power."""
    for power, (here, paper) in enumerate(zip(computed[::-1], expected[::-1], strict=True)):
        yield check_number(
            "eq. (18)",
            f"{name}, s{str(power).translate(_SUPERSCRIPTS)}",
            float(paper),
            float(here),
            5e-4 * abs(float(paper)),
        )


def _output_error_numerator(plant: Plant) -> Array:
    """Return the numerator (3,) of the continuous model whose zero-order hold is b z²/(z³ + …).

    Computed from the residues of the sampled model, scaled to the plant's static gain.
    """
    G = plant.transfer_function()
    poles = poly.roots(G.den)
    z = np.exp(poles * printed.PERIOD_S)
    others = [np.delete(np.arange(3), i) for i in range(3)]
    residues = np.array(
        [poles[i] / (z[i] - 1.0) * z[i] ** 2 / np.prod(z[i] - z[others[i]]) for i in range(3)]
    )
    num = sum(residue * np.poly(poles[rest]) for residue, rest in zip(residues, others, strict=True)).real
    return np.asarray(num * (G.num[-1] / num[-1]))


def _plant_with_damping(damping: float) -> TransferFunction:
    num = printed.PLANT_GAIN * np.array([1.0, printed.PLANT_ZERO_RAD_S])
    quadratic = np.array([1.0, damping, printed.PLANT_STIFFNESS])
    return TransferFunction(num, poly.multiply(np.array([1.0, printed.PLANT_SLOW_POLE_RAD_S]), quadratic))


def _eps_opt(G: TransferFunction) -> float:
    return float(optimal_margins(shaped(G, printed.W1))[0])


def _short_text(reading: Reading) -> str:
    return f"{reading.quantity} {reading.value:.4g}"
