"""What is verified is what runs: the daemon's own realisation of a law, back as polynomials.

``hil.laws`` turns a controller file's law into the state space that runs; here that state space is taken
to the bilinear plane, where margins and specifications are computed as for any controller.
"""

from __future__ import annotations

from design.realisation import StateSpace, transfer_function, unsampled
from design.structures import Controller
from hil.controller_file import Law
from hil.laws import realise


def controller_of_law(law: Law, period_s: float) -> Controller:
    """The law as the daemon realises it: num, den, num_r (1, n + 1) in the bilinear plane.

    Raises DesignError where it has a pole at z = -1.
    """
    A, B, C, D = unsampled(StateSpace(*realise(law, period_s)), period_s)
    of_r, of_y = (transfer_function(StateSpace(A, B[:, i : i + 1], C, D[:, i : i + 1])) for i in range(2))
    return Controller(-of_y.num[None, :], of_y.den[None, :], of_r.num[None, :])
