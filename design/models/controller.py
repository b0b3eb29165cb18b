"""A controller as polynomials, and the polynomials of a controller file's law.

``hil.core.control_law`` turns the law of a controller file into the state space that the daemon runs. Here
this state space is taken to the bilinear plane. So margins and specifications are verified for what really
runs.
"""

from __future__ import annotations

from typing import NamedTuple

from design.mathematics.polynomials import Array
from design.models.realisation import StateSpace, inverse_tustin, transfer_function
from design.models.transfer_function import TransferFunction
from hil.core.control_law import realise
from hil.core.controller_file import Law


class Controller(NamedTuple):
    """A controller u = (num_r r - num y)/den: arrays (..., n + 1) of coefficients in falling powers of s.

    num_r equals num for a controller with one degree of freedom.
    """

    num: Array
    den: Array
    num_r: Array

    @property
    def feedback(self) -> TransferFunction:
        """The controller from -y to u, on which stability and margins depend."""
        return TransferFunction(self.num, self.den)


def one_degree_of_freedom(num: Array, den: Array) -> Controller:
    """Return the controller u = num/den (r - y), which has one degree of freedom."""
    return Controller(num, den, num)


def controller_of_law(law: Law, period_s: float) -> Controller:
    """Return the law as the daemon realises it: polynomials (1, n + 1) in the bilinear plane.

    Raises DesignError if the law has a pole at z = -1.
    """
    A, B, C, D = inverse_tustin(StateSpace(*realise(law, period_s)), period_s)
    of_r, of_y = (transfer_function(StateSpace(A, B[:, i : i + 1], C, D[:, i : i + 1])) for i in range(2))
    return Controller(-of_y.num[None, :], of_y.den[None, :], of_r.num[None, :])
