"""Benchmark of the design: speed and exactness against peers in the same run, and the optimum on every seed.

    python tests/benchmarks/bench_design.py

Times are processor times of one process, the least of several rounds. The peers are the same two objectives
written in two ways with python-control and slycot, and the optimisers of pymoo and pygad on the batched
objective of this package. Of the former, a few dozen candidates are timed, checked against the values of this
package, and scaled to the paper's 2000 + 6000 candidates.
"""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1]))
os.environ["OPENBLAS_NUM_THREADS"] = "1"  # one core, for ours and for the peers; read as numpy is loaded

import control
import numpy as np
import pygad
from hypothesis import HealthCheck, given, seed, settings
from pymoo.algorithms.soo.nonconvex.de import DE
from pymoo.algorithms.soo.nonconvex.ga import GA
from pymoo.core.problem import Problem
from pymoo.optimize import minimize
from support.paper_loop import G0, W1
from support.random_systems import System, margin_at, slycot_margins, systems

from design.closed_loop.loops import ClosedLoops
from design.mathematics import polynomials as poly
from design.models.controller import one_degree_of_freedom
from design.models.plant import paper_plant
from design.robustness import margins
from design.robustness.central_controller import central_controllers, optimal_margins
from design.robustness.loop_shaping import shaped
from design.robustness.margins import characteristic, margin_and_frequency, stability_margin
from design.search.bounds import SearchBounds
from design.synthesis.fixed_structure import synthesise
from design.synthesis.structures import STRUCTURES, IntegralWeight
from design.synthesis.weight_selection import select_weight

WEIGHTS, CONTROLLERS = 2000, 6000
SEEDS = 40
TARGET_RATIO = 200
"""Speed to be reached, relative to the same search with python-control and slycot.

It is not reached. It would mean 5 us for each candidate, with the searcher. Batches of 40 to 60 candidates
take 15 us for each controller and 90 us for each weight in numpy; more speed takes compiled code.
"""
REQUIRED_RATIO = 20
"""Relative speed below which this benchmark fails, so that the present speed is not lost."""
PLANT, PID = paper_plant(), STRUCTURES["pid"]
BOUNDS = SearchBounds(PID.parameters)


def seconds_of(work: Callable[[], object], rounds: int = 1) -> float:
    """Return the least processor time of several rounds."""
    spent = []
    for _ in range(rounds):
        began = time.process_time()
        work()
        spent.append(time.process_time() - began)
    return min(spent)


def our_budget() -> tuple[float, float]:
    """Return the seconds that the paper's weight search and controller search take, with their searchers."""
    weights = seconds_of(lambda: select_weight(PLANT, evaluations=WEIGHTS), rounds=5)
    return weights, seconds_of(lambda: synthesise(PLANT, W1, PID, evaluations=CONTROLLERS), rounds=5)


class WithPythonControl:
    """Both objectives as an expert in python-control and slycot would write them, in state space.

    Constant parts are computed once, and norms and Riccati equations are slycot's. No system is realised
    twice, since a copy of an integrator in T_zw would have infinite gain.
    """

    def __init__(self) -> None:
        self.G = control.ss(control.tf(G0.num, G0.den))
        self.W_inverse = control.ss(control.tf(W1.den, W1.num))
        Gs = self.G * control.ss(control.tf(W1.num, W1.den))
        n = Gs.nstates
        # From (w1, w2, u) to (y, u, y) with y = Gs (u + w2) + w1: eq. (13) closes it by -K/W1.
        self.P = control.ss(
            Gs.A,
            np.hstack([np.zeros((n, 1)), Gs.B, Gs.B]),
            np.vstack([Gs.C, np.zeros((1, n)), Gs.C]),
            [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
        )
        self.time_s = np.linspace(0.0, 6.0, 512)
        self.low_s = 1j * np.linspace(0.01, 0.4, 20)

    def controller(self, kp: float, ki: float, kd: float, tau_d: float) -> float:
        """Return ε of eq. (13)."""
        A, C = [[0.0, 0.0], [0.0, -1.0 / tau_d]], [[ki, -kd / tau_d**2]]
        K = control.ss(A, [[1.0], [1.0]], C, [[kp + kd / tau_d]])
        T_zw = self.P.lft(-(self.W_inverse * K))
        if T_zw.poles().real.max() >= 0.0:
            return 0.0
        return float(1.0 / control.linfnorm(T_zw)[0])

    def weight(self, kw: float, a: float) -> tuple[float, float, float, float, float]:
        """Return ε_opt of Appendix A; overshoot, settling time, crossover and smallest gain of eq. (9)."""
        W = control.ss([[-0.001]], [[1.0]], [[kw * (a - 0.001)]], [[kw]])
        Gs = self.G * W
        X = control.care(Gs.A, Gs.B, Gs.C.T @ Gs.C)[0]
        Z = control.care(Gs.A.T, Gs.C.T, Gs.B @ Gs.B.T)[0]
        gamma_squared = 1.0 + np.linalg.eigvals(X @ Z).real.max()
        eps_opt = 1.0 / np.sqrt(gamma_squared)
        gamma_squared *= 1.1**2
        L = (1.0 - gamma_squared) * np.eye(len(X)) + X @ Z
        gain = gamma_squared * np.linalg.solve(L.T, Z @ Gs.C.T)
        K_inf = control.ss(Gs.A - Gs.B @ Gs.B.T @ X + gain @ Gs.C, gain, -Gs.B.T @ X, 0.0)
        closed = control.feedback(self.G * (W * K_inf), 1)
        y = control.step_response(closed, self.time_s).outputs / closed.dcgain()
        settled = self.time_s[np.flatnonzero(np.abs(y - 1.0) > 0.02)[-1]]
        return eps_opt, y.max() - 1.0, settled, control.margin(Gs)[3], np.abs(Gs(self.low_s)).min()


def as_transfer_functions(kp: float, ki: float, kd: float, tau_d: float) -> float:
    """Return ε as a direct transcription of eq. (13): in transfer functions, with cancellations."""
    G, W = control.tf(G0.num, G0.den), control.tf(W1.num, W1.den)
    K = control.tf([kp], [1.0]) + control.tf([ki], [1.0, 0.0]) + control.tf([kd, 0.0], [tau_d, 1.0])
    cancelled = partial(control.minreal, verbose=False)
    S = cancelled(control.feedback(1, G * K))
    if S.poles().real.max() >= 0.0:
        return 0.0
    T_zw = [[S, cancelled(S * G * W)], [cancelled(K / W * S), cancelled(K * G * S)]]
    return float(1.0 / control.linfnorm(control.ss(control.combine_tf(T_zw)))[0])


def with_python_control(weights: int, controllers: int) -> tuple[float, float, float]:
    """Return the seconds for a weight, a controller, and a controller as transfer functions.

    All results are checked against those of this package.
    """
    random, peer = np.random.default_rng(1), WithPythonControl()
    weight = IntegralWeight()
    drawn_weights = SearchBounds(weight.parameters).decode(random.random((weights, 2)))
    drawn = BOUNDS.decode(random.random((controllers, 4)))
    peer.weight(*drawn_weights[0])
    as_transfer_functions(*drawn[0])
    found: dict[str, list[object]] = {"weight": [], "controller": [], "transfer functions": []}
    spent = (
        seconds_of(lambda: found["weight"].extend(peer.weight(*row) for row in drawn_weights)),
        seconds_of(lambda: found["controller"].extend(peer.controller(*row) for row in drawn)),
        seconds_of(lambda: found["transfer functions"].extend(as_transfer_functions(*row) for row in drawn)),
    )
    eps = stability_margin(G0, PID.controller(drawn).feedback, W1)
    np.testing.assert_allclose(found["controller"], eps, rtol=1e-8)
    np.testing.assert_allclose(found["transfer functions"], eps, rtol=1e-5)
    eps_opt, overshoot, settling_s, crossover, _ = np.array(found["weight"]).T
    W = weight.controller(drawn_weights).feedback
    Gs = shaped(G0, W)
    K_inf, ours = central_controllers(Gs)
    np.testing.assert_allclose(eps_opt, ours, rtol=1e-8)
    K = one_degree_of_freedom(poly.multiply(W.num, K_inf.num), poly.multiply(W.den, K_inf.den))
    loops = ClosedLoops(G0, K, W=W, desired=Gs)
    falls = np.isfinite(crossover)
    np.testing.assert_allclose(crossover[falls], margins.crossover(Gs)[falls], rtol=1e-6)
    # The peer simulates 6 s, and does not see what has not settled by then.
    has_settled = (loops.settling_s < 3.0) & (np.abs(loops.overshoot - overshoot) < 0.5)
    assert has_settled.sum() > weights / 4
    np.testing.assert_allclose(settling_s[has_settled], loops.settling_s[has_settled], atol=0.02)
    np.testing.assert_allclose(
        np.maximum(overshoot[has_settled], 0.0), loops.overshoot[has_settled], atol=0.01
    )
    return spent[0] / weights, spent[1] / controllers, spent[2] / controllers


def our_objective(points: np.ndarray) -> np.ndarray:
    return stability_margin(G0, PID.controller(BOUNDS.decode(points)).feedback, W1)


class ForPymoo(Problem):
    def __init__(self) -> None:
        super().__init__(n_var=4, n_obj=1, xl=0.0, xu=1.0)

    def _evaluate(self, x: np.ndarray, out: dict[str, np.ndarray], *_: object, **__: object) -> None:
        out["F"] = -our_objective(x)[:, None]


def with_pymoo(algorithm: object, run: int) -> float:
    return -float(minimize(ForPymoo(), algorithm, ("n_eval", CONTROLLERS), seed=run, verbose=False).F[0])


def with_pygad(run: int) -> float:
    ga = pygad.GA(
        num_generations=29,
        sol_per_pop=200,
        num_parents_mating=100,
        num_genes=4,
        init_range_low=0.0,
        init_range_high=1.0,
        gene_space={"low": 0.0, "high": 1.0},
        fitness_func=lambda _, points, __: our_objective(np.asarray(points, dtype=float)).tolist(),
        fitness_batch_size=200,
        random_seed=run,
        suppress_warnings=True,
    )
    ga.run()
    return float(ga.best_solution()[1])


OPTIMISERS: dict[str, Callable[[int], float]] = {
    "pymoo DE": lambda run: with_pymoo(DE(pop_size=60), run),
    "pymoo GA": lambda run: with_pymoo(GA(pop_size=200), run),
    "pygad": with_pygad,
}


class Exactness(NamedTuple):
    """Largest relative errors of ε over random stable loops."""

    loops: int
    attained: float
    """Difference from the value that the loop takes at the frequency of the peak."""
    agreed: float
    """Difference from the nearest of four runs of ab13dd, where it finds the highest peak."""
    missed_by_slycot: int
    """Number of loops where all four runs stop at a peak that is not the highest."""


def exactness(examples: int) -> Exactness:
    attained: list[float] = []
    agreed: list[float] = []
    lower: list[float] = []

    @seed(1)
    @settings(max_examples=examples, database=None, deadline=None, suppress_health_check=list(HealthCheck))
    @given(systems(), systems(min_order=0, max_order=4))
    def compare(G: System, K: System) -> None:
        roots = poly.roots(np.atleast_2d(characteristic(G.polynomials, K.polynomials)))[0]
        if np.any(np.abs(roots.real) < 1e-6 * np.maximum(np.abs(roots), 1.0)):
            return
        margin, omega = (value[0] for value in margin_and_frequency(G.polynomials, K.polynomials))
        if margin > 0.0:
            attained.append(abs(margin / margin_at(G, K, omega) - 1.0))
            off = np.array(slycot_margins(G, K)) / margin - 1.0
            nearest = off[np.abs(off).argmin()]
            (lower if nearest > 1e-6 else agreed).append(abs(nearest))

    compare()
    return Exactness(len(attained), max(attained), max(agreed), len(lower))


def main() -> None:
    missed = []
    weight_s, controller_s = our_budget()
    ours = weight_s + controller_s
    print(f"the paper's budget, {WEIGHTS} weights and {CONTROLLERS} controllers:")
    print(f"  {weight_s:.3f} s and {controller_s:.3f} s, together {ours:.3f} s (to reach: 0.5 s)")
    print(f"  a candidate: {1e6 * weight_s / WEIGHTS:.0f} and {1e6 * controller_s / CONTROLLERS:.1f} us")
    missed += ["budget"] if ours > 0.5 else []

    weight_each, controller_each, formula_each = with_python_control(weights=48, controllers=96)
    peer = WEIGHTS * weight_each + CONTROLLERS * controller_each
    naive = WEIGHTS * weight_each + CONTROLLERS * formula_each
    print("python-control with slycot, the same margins on the same candidates:")
    print(
        f"  in state space {1e6 * weight_each:.0f} us a weight, {1e6 * controller_each:.0f} us a controller: "
    )
    print(f"    {peer:.1f} s in all; ours is {peer / ours:.0f} times faster ({_judged(peer / ours)})")
    print(f"  as transfer functions {1e6 * formula_each:.0f} us a controller: {naive:.1f} s in all,")
    print(f"    ours is {naive / ours:.0f} times faster ({_judged(naive / ours)})")
    missed += ["python-control"] if peer < REQUIRED_RATIO * ours else []

    in_one_batch()

    print(f"optimisers on our objective, {CONTROLLERS} evaluations, 3 seeds:")
    for name, search in OPTIMISERS.items():
        eps: list[float] = []
        spent = min(seconds_of(partial(_append, eps, search, run)) for run in range(3))
        print(f"  {name:8} {spent:.3f} s, eps {min(eps):.5f} to {max(eps):.5f}")
        missed += [name] if spent < controller_s else []

    eps = [synthesise(PLANT, W1, PID, seed=run).eps for run in range(SEEDS)]
    eps_opt = [select_weight(PLANT, seed=run).eps_opt for run in range(SEEDS)]
    print(f"{SEEDS} seeds: (13) {min(eps):.6f} at worst (to reach: 0.5861 of 0.586156)")
    print(f"          (8) {min(eps_opt):.6f} at worst (to reach: 0.6035 of 0.60358)")
    missed += ["seeds"] if min(eps) < 0.5861 or min(eps_opt) < 0.6035 else []

    exact = exactness(500)
    print(
        f"{exact.loops} random stable loops: eps within {exact.attained:.0e} of a value that the loop takes,"
    )
    print(f"  and within {exact.agreed:.0e} of slycot's (to reach: 1e-8)")
    print(f"  but for {exact.missed_by_slycot} where ab13dd stops at a peak lower than that value")
    missed += ["exactness"] if max(exact.attained, exact.agreed) > 1e-8 else []
    missed += ["slycot"] if exact.missed_by_slycot > 0.05 * exact.loops else []

    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", "import sys; from hil.cli import main; sys.exit(main())"]
        spent = []
        for _ in range(3):
            began = time.perf_counter()
            subprocess.run([*command, "design", "--out", folder], check=True, capture_output=True)
            spent.append(time.perf_counter() - began)
    print(f"hil design, from the command line to the report: {min(spent):.2f} s (to reach: 3 s)")
    missed += ["hil design"] if min(spent) > 3.0 else []
    if missed:
        sys.exit(f"missed: {', '.join(missed)}")


def _judged(ratio: float) -> str:
    """Return the ratio in words, beside the target and the required ratio."""
    verdict = "reached" if ratio >= TARGET_RATIO else f"NOT reached: {ratio / TARGET_RATIO:.0%} of it"
    return f"to reach: {TARGET_RATIO}; {verdict}; held: at least {REQUIRED_RATIO}"


def in_one_batch() -> None:
    """Print the time for one candidate in a large batch."""
    random = np.random.default_rng(1)
    values = BOUNDS.decode(random.random((CONTROLLERS, 4)))
    exact = seconds_of(lambda: stability_margin(G0, PID.controller(values).feedback, W1), rounds=3)
    weight = IntegralWeight()
    W = weight.controller(SearchBounds(weight.parameters).decode(random.random((WEIGHTS, 2)))).feedback
    optima = seconds_of(lambda: optimal_margins(shaped(G0, W)), rounds=3)
    print("in one large batch, a candidate:")
    print(f"  eps {1e6 * exact / CONTROLLERS:.1f} us, eps_opt {1e6 * optima / WEIGHTS:.1f} us")


def _append(found: list[float], search: Callable[[int], float], run: int) -> None:
    found.append(search(run))


if __name__ == "__main__":
    with warnings.catch_warnings(), contextlib.redirect_stderr(io.StringIO()):
        warnings.simplefilter("ignore")
        main()
