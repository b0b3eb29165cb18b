"""Margins of one sampled loop, from a plant and a controller file, for programs of one's own."""

from __future__ import annotations

import math
from dataclasses import dataclass

from design.mathematics import polynomials as poly
from design.models.controller import controller_of_law
from design.models.plant import Plant
from design.models.sampling import Sampling
from design.models.transfer_function import TransferFunction
from design.robustness import margins
from hil.core.controller_file import ControllerFile


@dataclass(frozen=True)
class LoopMargins:
    """Margins of a sampled loop with negative feedback. All are exact, not read from a frequency grid."""

    stable: bool
    """True if all closed-loop poles lie inside the unit circle."""
    stability_margin: float
    """Normalised coprime margin of plant and controller, 0 if unstable (``ncfmargin``).

    This is not the eps that ``hil design`` prints: that one is the margin of the shaped plant W1 G with the
    controller K/W1. The two are equal for W1 = 1 only. This one depends on the units of plant and controller.
    """
    gain_margin: float
    """Smallest factor over 1 on the loop gain that makes the loop unstable; infinite if there is none.

    ``hil design`` prints it in dB: 20 log10 of this factor.
    """
    phase_margin_rad: float
    """Smallest phase lag in rad that makes the loop unstable. ``hil design`` prints it in degrees."""
    crossover_rad_s: float
    """Frequency in rad/s at which the loop gain falls through 1."""

    def __str__(self) -> str:
        if not self.stable:
            return "unstable"
        gain_db = 20.0 * math.log10(self.gain_margin) if self.gain_margin > 0.0 else -math.inf
        return (
            f"stable; stability margin {self.stability_margin:.3f} (W1 = 1, not the eps of hil design); gain "
            f"margin {self.gain_margin:.3g}, that is {gain_db:.3g} dB; phase margin "
            f"{math.degrees(self.phase_margin_rad):.3g}°; crossover {self.crossover_rad_s:.3g} rad/s"
        )


def loop_margins(plant: Plant, controller: ControllerFile, *, delay_samples: int = 1) -> LoopMargins:
    """Return the margins of ``plant`` under ``controller``, at the controller's sample time.

    The loop has the controller as the gateway realises it, a zero-order hold, and ``delay_samples`` periods
    from a sample to its effect on the valve, besides the delays that the plant model has. Raises DesignError
    if the loop cannot be represented.

    >>> import design, hil
    >>> found = loop_margins(design.paper_plant(), hil.load_controller("ppid"))
    >>> found.stable, round(found.gain_margin, 2), round(found.crossover_rad_s, 2)
    (True, 5.1, 3.02)
    """
    sampling = Sampling(controller.sample_time_s, delay_samples)
    G = plant.transfer_function(sampling)
    K = controller_of_law(controller.law, controller.sample_time_s).feedback
    L = TransferFunction(poly.multiply(K.num, G.num), poly.multiply(K.den, G.den))
    margin = float(margins.stability_margin(G, K)[0])
    _, above = margins.gain_margins(L)
    return LoopMargins(
        stable=margin > 0.0,
        stability_margin=margin,
        gain_margin=float(above[0]),
        phase_margin_rad=float(margins.phase_margin(L)[0]),
        crossover_rad_s=float(sampling.unwarp(margins.crossover(L))[0]),
    )
