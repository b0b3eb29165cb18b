"""A controller as polynomials, and the way from a controller file's law to them.

``hil.core.control_law`` turns a controller file's law into the state space that the daemon runs. Here that
state space is taken to the bilinear plane, so that margins and specifications are those of what runs.
"""

from __future__ import annotations

from typing import NamedTuple

from design.mathematics.polynomials import Array
from design.models.plant import TransferFunction
from design.models.realisation import StateSpace, transfer_function, unsampled
from hil.core.control_law import realise
from hil.core.controller_file import Law


class Controller(NamedTuple):
    """u = (num_r r - num y)/den, arrays (..., n + 1) in falling powers of s.

    num_r is num where there is one degree of freedom.
    """

    num: Array
    den: Array
    num_r: Array

    @property
    def feedback(self) -> TransferFunction:
        """From -y to u: all that stability and margins depend on."""
        return TransferFunction(self.num, self.den)


def one_degree_of_freedom(num: Array, den: Array) -> Controller:
    """A controller with one degree of freedom, u = num/den (r - y)."""
    return Controller(num, den, num)


def controller_of_law(law: Law, period_s: float) -> Controller:
    """The law as the daemon realises it: num, den, num_r (1, n + 1) in the bilinear plane.

    Raises DesignError where it has a pole at z = -1.
    """
    A, B, C, D = unsampled(StateSpace(*realise(law, period_s)), period_s)
    of_r, of_y = (transfer_function(StateSpace(A, B[:, i : i + 1], C, D[:, i : i + 1])) for i in range(2))
    return Controller(-of_y.num[None, :], of_y.den[None, :], of_r.num[None, :])
