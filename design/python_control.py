"""Conversions to and from python-control: plants, identified models, and laws as the daemon runs them.

They serve to bring a model from python-control, and to check a finished controller with its tools. Signals
are named r, y and u, so that ``control.interconnect`` connects the loop. python-control is imported when a
function is called.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from design.errors import DesignError
from design.identification.models.model import ContinuousModel, DiscreteModel
from design.mathematics.polynomials import Array
from design.models.plant import Plant, read_plant
from design.models.realisation import StateSpace, realise, transfer_function, tustin
from design.models.sampling import Sampling
from hil.core import control_law as laws
from hil.core.controller_file import ControllerFile
from hil.core.documents import to_json

if TYPE_CHECKING:
    import control


def plant_to_control(
    plant: Plant, sampling: Sampling | None = None
) -> control.TransferFunction | control.StateSpace:
    """Return the plant as python-control's transfer function or state space, from u in V to y.

    Without ``sampling`` it is G(s). With ``sampling`` it is the exact state space, in discrete time, of hold,
    plant, and all delays of the loop, including a dead time that is no multiple of the period. Raises
    DesignError for G(s) of a plant with a dead time: python-control has no exact continuous model of one.
    Give a sampling then, or convert a copy of the plant without dead time and add ``control.pade``.
    """
    import control

    names = {"name": plant.name, "inputs": "u", "outputs": "y"}
    if sampling is None:
        return control.tf(*plant.transfer_function(), **names)
    A, B, C, D = tustin(realise(plant.transfer_function(sampling)), sampling.period_s)
    num, den = plant.rational_part
    if plant.loop_delay_s(sampling) > 0.0 or len(num) < len(den):
        # A direct path of 1e-19, from rounding, would turn every feedback into an algebraic loop.
        D = np.zeros_like(D)
    return control.ss(A, B, C, D, sampling.period_s, **names)


def model_to_control(model: DiscreteModel | ContinuousModel, name: str = "model") -> control.TransferFunction:
    """Return an identified model as python-control's transfer function, from u to y.

    A sampled model contains its hold and its delay. Raises DesignError for a continuous model with a dead
    time, of which python-control has no exact model; take the sampled one then.
    """
    import control

    names = {"name": name, "inputs": "u", "outputs": "y"}
    if isinstance(model, ContinuousModel):
        if model.dead_time_s:
            raise DesignError(
                f"{name}: its dead time of {model.dead_time_s:g} s has no exact continuous model in "
                "python-control; convert the sampled model"
            )
        return control.tf(model.num, model.den, **names)
    num, den = model.in_z
    return control.tf(num, den, model.sample_time_s, **names)


def controller_to_control(controller: ControllerFile) -> control.StateSpace:
    """Return the law as the daemon realises it, in its linear range, from r and y to u at its sample time."""
    import control

    A, B, C, D = laws.realise(controller.law, controller.sample_time_s)
    return control.ss(
        A, B, C, D, controller.sample_time_s, name=controller.name, inputs=["r", "y"], outputs="u"
    )


def plant_from_control(
    system: control.TransferFunction | control.StateSpace,
    *,
    name: str,
    output_unit: Literal["m", "rad"],
    dead_time_s: float = 0.0,
    contains_delay_samples: int = 0,
) -> Plant:
    """Return a plant document of a model with one input in V and one output; ``to_json`` makes its file text.

    A discrete-time model is taken as the model of a zero-order hold and a plant, and the hold is inverted. It
    must not contain whole samples of delay; give them as ``dead_time_s``. See :mod:`design.models.plant` for
    the meaning of both delays. Raises DesignError or DocumentError if the model is no plant.
    """
    import control

    if system.ninputs != 1 or system.noutputs != 1:
        raise DesignError(
            f"{name}: {system.ninputs} inputs and {system.noutputs} outputs, but a plant has one of each; "
            "take one entry of the system"
        )
    if system.dt is True:
        raise DesignError(f"{name}: discrete-time, but its sample time is not given; set dt in seconds")
    period_s = float(system.dt or 0.0)
    if isinstance(system, control.TransferFunction) and not period_s:
        num, den = np.ravel(system.num[0][0]), np.ravel(system.den[0][0])
    else:
        states = control.ss(system)
        H = StateSpace(*(np.asarray(part, dtype=float) for part in (states.A, states.B, states.C, states.D)))
        num, den = transfer_function(_without_hold(H, period_s, name) if period_s else H)
    plant = Plant(
        format="hil-plant",
        version=1,
        name=name,
        input_unit="V",
        output_unit=output_unit,
        sample_time_s=period_s or None,
        num=_trimmed(num),
        den=den.tolist(),
        dead_time_s=dead_time_s,
        contains_delay_samples=contains_delay_samples,
        origin={"from": "python-control"},
    )
    return read_plant(to_json(plant), name)


def _without_hold(H: StateSpace, period_s: float, name: str) -> StateSpace:
    """Return the continuous system that is ``H`` behind a zero-order hold: the logarithm of a step matrix."""
    from scipy.linalg import logm

    A, B, C, D = H
    for z in np.linalg.eigvals(A):
        if z.real <= 0.0 and abs(z.imag) <= 1e-9 * max(abs(z), 1e-9):
            raise DesignError(
                f"{name}: a pole at z = {z.real:.4g}: "
                + (
                    "remove whole samples of delay from the model, and give them as dead_time_s"
                    if abs(z) < 1e-9
                    else "no continuous system behind a zero-order hold has a pole on the negative real axis"
                )
            )
    n = len(A)
    step = np.block([[A, B], [np.zeros((1, n)), np.ones((1, 1))]])
    rates = np.real(logm(step)) / period_s
    return StateSpace(rates[:n, :n], rates[:n, n:], C, D)


def _trimmed(num: Array) -> list[float]:
    """Return the coefficients without leading ones that are rounding."""
    small = np.abs(num) < 1e-14 * np.abs(num).max(initial=0.0)
    return list(map(float, np.trim_zeros(np.where(small, 0.0, num), "f")))
