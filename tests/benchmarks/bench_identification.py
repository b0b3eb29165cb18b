"""Benchmark of the identification: fit, time and memory, beside the bound, the targets and peers.

    python tests/benchmarks/bench_identification.py

The records are those of 60 s PRBS experiments with eq. (15) of the paper, with white noise at the output.
The fit in per cent is that of a free-running simulation on a clean record with another PRBS; each record
has its own. Offset and initial state are estimated. Times are processor times of one core.

What "noise of 20 %" means decides what can be reached. The targets come from measurements whose records were
not kept. If the share is that of the *standard deviation* of the clean output, no unbiased estimator
reaches them: the Cramér-Rao bound lies below them. They agree best with a share of the *mean absolute
deviation* (0.8 standard deviations of this output): the bound then gives 99.56 % at 20 % noise for the
structure with which 99.57 % were measured, and a standard deviation of the zero of 34 %, as was measured. No
other definition that was tried does (without the transient, without a trend, root mean square, peak).
So both definitions are printed. Judged are

* the distance from the bound, whatever the definition: the root mean square of the error on clean data as a
  multiple of what the bound predicts for the same records, 1.00 for an efficient estimator;
* the targets, with noise as a share of the mean absolute deviation, where the bound allows them.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import resource
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1]))
os.environ["OPENBLAS_NUM_THREADS"] = "1"  # one core, for ours and for the peers; read as numpy is loaded

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from support.arm_bench import prbs

import design
from design.identification.estimators.fit import fit
from design.identification.models.difference_basis import differences
from design.identification.models.held_discretisation import hold
from design.identification.models.model import ContinuousModel, DiscreteModel
from design.identification.models.structures import ContinuousPoles, OutputError, Structure
from design.identification.records.experiment import Experiment

Array = NDArray[np.float64]

T = 0.0112
SAMPLES = 5357
"""One minute."""
SEEDS = 31
PEER_SEEDS = 3
"""Number of records for each peer; several need seconds for one."""
BOUND_DRAWS = 40
"""Number of models that are drawn for each record from the distribution of an efficient estimate."""
NOISES = (0.01, 0.05, 0.2)
"""Standard deviations of the noise, as shares of the spread of the output."""
TARGETS_PERCENT = (99.98, 99.89, 99.57)
"""Median fits to be reached at these noises, by the best of our structures."""
MAX_DISTANCE = 1.1
"""Largest distance from the bound. That of an efficient estimator has a standard deviation of 3 % here."""
TARGET_S = 0.1
"""Processor time to be reached for one estimate."""
LONG_SAMPLES = 1_000_000
TARGET_LONG_S, TARGET_LONG_BYTES = 5.0, 1e9
"""Wall time and peak memory to be reached for an estimate from the long record."""
PLANT = design.paper_plant()
NUM, DEN = np.array(PLANT.num) / PLANT.den[0], np.array(PLANT.den) / PLANT.den[0]
MODEL = hold(ContinuousModel(NUM, DEN), T)
OURS: dict[str, Structure] = {
    "OE(1,3,1)": OutputError(1, 3, 1),
    "OE(3,3,1)": OutputError(3, 3, 1),
    "continuous": ContinuousPoles(real=1, pairs=1, zeros=1),
}

MIN_ERROR_OF_A_PEER = 0.9
"""A peer counts as more accurate below this share of our error.

Peers that estimate no offset and no initial state gain a few per cent on these records, which have none.
"""
CONTAINING_THE_PLANT = ("OE(3,3,1)", "continuous")
"""Structures of ours that the plant belongs to. OE(1,3,1) has no zero, and is a little off at any noise."""


def standard_deviation(y: Array) -> float:
    """Return the standard deviation of a clean output (N,)."""
    return float(y.std())


def mean_absolute_deviation(y: Array) -> float:
    """Return the mean distance of a clean output (N,) from its mean."""
    return float(np.abs(y - y.mean()).mean())


Spread = Callable[[Array], float]
SPREADS: dict[str, Spread] = {
    "standard deviation": standard_deviation,
    "mean absolute deviation": mean_absolute_deviation,
}
"""What the shares of the noise are shares of."""
JUDGED_SPREAD = "mean absolute deviation"
"""Definition of the noise under which the targets are judged."""

Simulate = Callable[[Array], Array]
Estimator = Callable[[Array, Array], Simulate]


class Row(NamedTuple):
    """Results of an estimator at each noise."""

    fits: tuple[float, ...]
    """Median fits in per cent."""
    squared_errors: Array
    """Squared norm of the error on the clean record, (noises, seeds)."""
    seconds: float
    """Median processor time of an estimate."""


class Bound(NamedTuple):
    """What an efficient estimator reaches on the same records (Cramér-Rao)."""

    fits: tuple[float, ...]
    """Median fits in per cent at each noise."""
    squared_errors: Array
    """Expected squared norm of the error on the clean record, (noises, seeds)."""


def excitation(seed: int, samples: int = SAMPLES) -> Array:
    return 0.4 * prbs(samples, 12, seed)


def record(
    seed: int, noise: float, samples: int = SAMPLES, spread: Spread = standard_deviation
) -> tuple[Array, Array]:
    u = excitation(seed, samples)
    y = MODEL.simulate(u)
    random = np.random.default_rng([seed, round(1000.0 * noise)])
    return u, y + noise * spread(y) * random.standard_normal(samples)


def clean_record(seed: int) -> tuple[Array, Array]:
    """Return the clean record on which the model from the record ``seed`` is judged."""
    u = excitation(1000 + seed)
    return u, MODEL.simulate(u)


def fit_percent(error: float, y: Array) -> float:
    return float(100.0 * (1.0 - error / np.linalg.norm(y - y.mean())))


def measured(estimator: Estimator, seeds: int, spread: Spread) -> Row:
    fits, squares, spent = [], [], []
    for noise in NOISES:
        found, errors = [], []
        for seed in range(1, seeds + 1):
            u, y = record(seed, noise, spread=spread)
            began = time.process_time()
            simulate = estimator(u, y)
            spent.append(time.process_time() - began)
            v, clean = clean_record(seed)
            errors.append(float(np.linalg.norm(clean - simulate(v))))
            found.append(fit_percent(errors[-1], clean))
        fits.append(float(np.median(found)))
        squares.append(np.square(errors))
    return Row(tuple(fits), np.array(squares), float(np.median(spent)))


def _slopes(u: Array) -> Array:
    """Return the derivatives (5, N) of the output by gain, zero, pole, natural frequency and damping."""
    poles = np.roots(DEN)
    slow = -float(poles[np.isreal(poles)][0].real)
    square = DEN[-1] / slow
    theta = np.log([NUM[-1] / DEN[-1], NUM[-1] / NUM[0], slow, np.sqrt(square), DEN[1] - slow])

    def output(theta: Array) -> Array:
        gain, zero, pole, natural, damped = np.exp(theta)
        den = np.polymul([1.0, pole], [1.0, damped, natural**2])
        return hold(ContinuousModel(gain * den[-1] * np.array([1.0 / zero, 1.0]), den), T).simulate(u)

    step = 1e-4
    return np.array(
        [(output(theta + h) - output(theta - h)) / (2.0 * step) for h in step * np.eye(len(theta))]
    )


def bound(seeds: int, spread: Spread) -> Bound:
    """Return the bound for the continuous structure, with offset and initial state unknown as in a fit."""
    impulse = np.eye(1, SAMPLES)[0]
    free = lfilter([1.0], MODEL.f, impulse)
    unknown = np.concatenate([np.ones((1, SAMPLES)), differences(free, MODEL.order, 0)])
    orthogonal = np.linalg.qr(unknown.T)[0]
    expected, fits = [], []
    for seed in range(1, seeds + 1):
        u = excitation(seed)
        J = _slopes(u)
        J = J - (J @ orthogonal) @ orthogonal.T
        covariance = np.linalg.inv(J @ J.T) * spread(MODEL.simulate(u)) ** 2
        v, clean = clean_record(seed)
        D = _slopes(v)
        expected.append(float(np.trace(covariance @ (D @ D.T))))
        drawn = np.random.default_rng(seed).multivariate_normal(np.zeros(len(J)), covariance, BOUND_DRAWS)
        errors = np.linalg.norm(drawn @ D, axis=1)
        fits.append([[fit_percent(noise * error, clean) for error in errors] for noise in NOISES])
    medians = np.median(np.array(fits), axis=(0, 2))
    return Bound(tuple(map(float, medians)), np.outer(np.square(NOISES), expected))


def ours(structure: Structure) -> Estimator:
    return lambda u, y: fit([Experiment(u, y, T)], structure).discrete.simulate


def _simulation_of(b: Array, f: Array) -> Simulate:
    """Return the simulation of b/f, both in powers of z^-1, the delay as leading zeros of b."""
    return DiscreteModel(np.asarray(b, dtype=float), np.asarray(f, dtype=float), 0, T).simulate


def with_pysib(u: Array, y: Array) -> Simulate:
    pysib = importlib.import_module("pysib")
    polynomials = pysib.oe(u, y, 1, 3, 1)[1]
    return _simulation_of(np.ravel(polynomials["B"]), np.ravel(polynomials["F"]))


def with_sippy(u: Array, y: Array) -> Simulate:
    sippy = importlib.import_module("sippy_unipi")
    found = sippy.system_identification(y, u, "OE", OE_orders=[1, 3, 0], tsample=T)
    num, den = (np.ravel(part[0][0]) for part in (found.G.num, found.G.den))
    return _simulation_of(np.concatenate([np.zeros(len(den) - len(num)), num]) / den[0], den / den[0])


def with_ctrlsys(u: Array, y: Array) -> Simulate:
    ctrlsys = importlib.import_module("ctrlsys")
    rows, order = 15, 3
    inputs, outputs = np.asfortranarray(u[:, None]), np.asfortranarray((y - y.mean())[:, None])
    R = ctrlsys.ib01ad("M", "Q", "N", "O", "N", "N", rows, 1, 1, inputs, outputs, 0.0, 0.0)[1]
    A, C, B, D = ctrlsys.ib01bd("C", "A", "N", rows, order, 1, 1, len(u), R, 0.0)[:4]
    f = np.poly(A).real
    b = np.poly(A - B @ C).real + (D[0, 0] - 1.0) * f
    return _simulation_of(b, f)


def with_sysidentpy(u: Array, y: Array) -> Simulate:
    FROLS = importlib.import_module("sysidentpy.model_structure_selection").FROLS
    Polynomial = importlib.import_module("sysidentpy.basis_function").Polynomial
    model = FROLS(xlag=3, ylag=3, n_terms=6, order_selection=False, basis_function=Polynomial(degree=1))
    model.fit(X=u[:, None], y=y[:, None])
    return lambda v: np.ravel(model.predict(X=v[:, None], y=np.zeros((3, 1))))


PEERS: dict[str, tuple[str, str, Estimator]] = {
    "pysib OE(1,3,1)": ("pysib", "pip install pysib", with_pysib),
    "sippy-unipi OE": ("sippy_unipi", "pip install sippy-unipi", with_sippy),
    "ctrlsys IB01AD/BD": ("ctrlsys", "pip install ctrlsys", with_ctrlsys),
    "SysIdentPy FROLS": (
        "sysidentpy",
        "pip would replace numpy, since its version 0.9.0 needs one below 2.4",
        with_sysidentpy,
    ),
}
"""Module, how to install it, and estimator of each peer."""


@contextlib.contextmanager
def silence() -> Iterator[None]:
    """Discard what a peer writes to the standard output, from C as well."""
    sys.stdout.flush()
    kept = os.dup(1)
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        try:
            yield
        finally:
            sys.stdout.flush()
            os.dup2(kept, 1)
            os.close(kept)


def peer(module: str, installation: str, estimator: Estimator) -> Row | str:
    """Return a peer's row, or the reason why there is none."""
    try:
        importlib.import_module(module)
    except ImportError as reason:
        return f"not available: {reason} ({installation})"
    try:
        with warnings.catch_warnings(), silence():
            warnings.simplefilter("ignore")
            return measured(estimator, PEER_SEEDS, standard_deviation)
    except Exception as reason:  # a peer's failure is a result
        return f"failed: {type(reason).__name__}: {reason}"


def long_record() -> None:
    """Print wall seconds and the growth of the peak memory in bytes, of an estimate from the long record."""
    u, y = record(1, 0.05, LONG_SAMPLES)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.perf_counter()
    fit([Experiment(u, y, T)], OutputError(1, 3, 1))
    spent = time.perf_counter() - began
    print(spent, 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, 1024 * before)


def _judged(value: str, target: str, reached: bool) -> str:
    return f"{value} (to reach: {target}{'' if reached else '; NOT reached'})"


def _listed(fits: tuple[float, ...]) -> str:
    return ", ".join(f"{fit:.3f}" for fit in fits)


def ours_beside_the_bound(definition: str) -> list[str]:
    """Print our structures beside bound and targets, and return what was missed."""
    missed: list[str] = []
    spread = SPREADS[definition]
    print(f"60 s PRBS of eq. (15), output noise 1, 5, 20 % of the {definition} of the output:")
    print(f"  median fit on clean data, {SEEDS} seeds")
    print(f"  {'target':18} {', '.join(f'{target:.2f}' for target in TARGETS_PERCENT)} %")
    limit = bound(SEEDS, spread)
    print(f"  {'Cramér-Rao bound':18} {_listed(limit.fits)} %, of the continuous structure")
    rows = {name: measured(ours(structure), SEEDS, spread) for name, structure in OURS.items()}
    for name, row in rows.items():
        fast = row.seconds < TARGET_S
        print(f"  {name:18} {_listed(row.fits)} %; {_judged(f'{row.seconds:.3f} s', f'{TARGET_S} s', fast)}")
        missed += [] if fast else [f"time of {name}"]
        if name in CONTAINING_THE_PLANT:
            distance = float(np.sqrt(np.mean(row.squared_errors / limit.squared_errors)))
            # One parameter more than the bound's structure has: its own bound lies this much higher.
            distance /= np.sqrt(6.0 / 5.0) if name == "OE(3,3,1)" else 1.0
            near = distance <= MAX_DISTANCE
            print(f"  {'':18} error {_judged(f'{distance:.2f} times the bound', f'{MAX_DISTANCE:g}', near)}")
            missed += [] if near else [f"distance of {name} from the bound"]
    for i, (noise, target) in enumerate(zip(NOISES, TARGETS_PERCENT, strict=True)):
        best = round(max(row.fits[i] for row in rows.values()), 2)
        allowed = round(limit.fits[i], 2) >= target
        if best >= target or (allowed and definition == JUDGED_SPREAD):
            print(f"  at {noise:.0%}: {_judged(f'{best:.2f} %', f'{target} %', best >= target)}")
            missed += [] if best >= target else [f"fit at {noise:.0%}"]
        else:
            print(
                f"  at {noise:.0%}: {best:.2f} %; the target of {target} % lies above the bound of "
                f"{limit.fits[i]:.3f} % at this noise, and is not judged"
            )
    return missed


def ours_beside_peers() -> list[str]:
    """Print our OE(1,3,1) beside the peers on the same records, and return what was missed."""
    missed: list[str] = []
    print(f"peers on the same records, {PEER_SEEDS} seeds, noise as a share of the standard deviation:")
    own = measured(ours(OURS["OE(1,3,1)"]), PEER_SEEDS, standard_deviation)
    print(f"  {'our OE(1,3,1)':18} {_listed(own.fits)} %; {own.seconds:.3f} s")
    for name, (module, installation, estimator) in PEERS.items():
        found = peer(module, installation, estimator)
        if isinstance(found, str):
            print(f"  {name:18} {found}")
            continue
        ratio = found.seconds / own.seconds
        print(f"  {name:18} {_listed(found.fits)} %; {found.seconds:.3f} s, {ratio:.1f} times ours")
        pairs = zip(found.fits, own.fits, strict=True)
        if any(100.0 - theirs < MIN_ERROR_OF_A_PEER * (100.0 - mine) for theirs, mine in pairs):
            missed.append(f"{name} is more accurate")
    return missed


def ours_on_the_long_record() -> list[str]:
    """Print time and memory of an estimate from the long record, and return what was missed."""
    answer = subprocess.run(
        [sys.executable, __file__, "--long"], check=True, capture_output=True, text=True
    ).stdout
    spent, peak, before = map(float, answer.split())
    fast, small = spent < TARGET_LONG_S, peak < TARGET_LONG_BYTES
    print(f"{LONG_SAMPLES} samples: {_judged(f'{spent:.2f} s', f'{TARGET_LONG_S} s', fast)},")
    print(f"  peak {_judged(f'{peak / 1e6:.0f} MB', '1000 MB', small)}, {before / 1e6:.0f} MB before the fit")
    return [*([] if fast else ["time of the long record"]), *([] if small else ["memory of the long record"])]


def main() -> None:
    missed = [text for definition in SPREADS for text in ours_beside_the_bound(definition)]
    missed += ours_beside_peers()
    missed += ours_on_the_long_record()
    if missed:
        sys.exit(f"missed: {', '.join(missed)}")


if __name__ == "__main__":
    if sys.argv[1:] == ["--long"]:
        long_record()
    else:
        main()
