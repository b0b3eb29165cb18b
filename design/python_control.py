"""To and from python-control: plants, and a controller file's law as the daemon runs it.

For those who know python-control: bring a model from there, or check a finished controller with its tools.
Signals are named r, y and u, so that ``control.interconnect`` closes the loop by itself. python-control is
imported when a function is called, and by nothing else in this package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from design.errors import DesignError
from design.mathematics.polynomials import Array
from design.models.plant import Plant, Sampling, read_plant
from design.models.realisation import StateSpace, realise, sampled, transfer_function
from hil.core import control_law as laws
from hil.core.controller_file import ControllerFile
from hil.core.documents import to_json

if TYPE_CHECKING:
    import control


def plant_to_control(
    plant: Plant, sampling: Sampling | None = None
) -> control.TransferFunction | control.StateSpace:
    """G(s) as a transfer function; with ``sampling`` hold, plant and delay as a sampled state space."""
    import control

    names = {"name": plant.name, "inputs": "u", "outputs": "y"}
    continuous = plant.transfer_function()
    if sampling is None:
        return control.tf(*continuous, **names)
    A, B, C, D = sampled(realise(plant.transfer_function(sampling)), sampling.period_s)
    if sampling.delay_samples or len(continuous.num) < len(continuous.den):
        # Exactly: a remainder of rounding would make an algebraic loop of every feedback.
        D = np.zeros_like(D)
    return control.ss(A, B, C, D, sampling.period_s, **names)


def controller_to_control(controller: ControllerFile) -> control.StateSpace:
    """The law as the daemon realises it, in its linear range: from r and y to u, at its sample time."""
    import control

    A, B, C, D = laws.realise(controller.law, controller.sample_time_s)
    return control.ss(
        A, B, C, D, controller.sample_time_s, name=controller.name, inputs=["r", "y"], outputs="u"
    )


def plant_from_control(
    system: control.TransferFunction | control.StateSpace, *, name: str, output_unit: Literal["m", "rad"]
) -> Plant:
    """A plant document from a model with one input in V and one output; ``to_json`` of it is a plant file.

    A sampled model is taken to stand behind a zero-order hold, which is inverted; whole samples of delay are
    left to the design file. Raises DesignError or DocumentError where the model is no plant.
    """
    import control

    if system.ninputs != 1 or system.noutputs != 1:
        raise DesignError(
            f"{name}: {system.ninputs} inputs and {system.noutputs} outputs: a plant has one of each"
        )
    if system.dt is True:
        raise DesignError(f"{name}: sampled, but its sample time is not given: set dt, in seconds")
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
        origin={"from": "python-control"},
    )
    return read_plant(to_json(plant), name)


def _without_hold(H: StateSpace, period_s: float, name: str) -> StateSpace:
    """The continuous system of which ``H`` is the sampled one: the logarithm of its step matrix."""
    from scipy.linalg import logm

    A, B, C, D = H
    for z in np.linalg.eigvals(A):
        if z.real <= 0.0 and abs(z.imag) <= 1e-9 * max(abs(z), 1e-9):
            raise DesignError(
                f"{name}: a pole at z = {z.real:.4g}: "
                + (
                    "whole samples of delay belong into loop.delay_samples of the design file"
                    if abs(z) < 1e-9
                    else "no continuous system behind a zero-order hold has one on the negative axis"
                )
            )
    n = len(A)
    step = np.block([[A, B], [np.zeros((1, n)), np.ones((1, 1))]])
    rates = np.real(logm(step)) / period_s
    return StateSpace(rates[:n, :n], rates[:n, n:], C, D)


def _trimmed(num: Array) -> list[float]:
    """Without leading coefficients that are rounding."""
    small = np.abs(num) < 1e-14 * np.abs(num).max(initial=0.0)
    return list(map(float, np.trim_zeros(np.where(small, 0.0, num), "f")))
