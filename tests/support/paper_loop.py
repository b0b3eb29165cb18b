"""The plant, weight and controllers of the paper."""

import numpy as np

from design.models.controller import Controller
from design.models.plant import paper_plant
from design.models.transfer_function import TransferFunction
from design.synthesis.structures import STRUCTURES
from support.constants import PERIOD_S as PERIOD_S

G0 = paper_plant().transfer_function()
W1 = TransferFunction(np.array([15.535, 6.83]), np.array([1.0, 0.001]))
"""The weight of eq. (16)."""
HLS = TransferFunction(
    np.array([372.3, 6714.0, 67960.0, 55790.0, 11950.0]),
    np.array([1.0, 40.0, 701.3, 6310.0, 2648.0, 2.641]),
)
"""The loop-shaping controller of eq. (18)."""
PPID = (11.013, 5.6444, 38.639, 74.162)
"""kp, ki, kd and tau_d of the PPID, eq. (20)."""
BEST_PID = (11.3616, 5.0530, 0.27015, 0.026717)
"""kp, ki, kd and tau_d of the PID with the largest ε within the paper's search bounds."""
BEST_PI = (10.763, 4.7136)
"""kp and ki of the PI with the largest ε."""


def pid(*values: float) -> Controller:
    """Return the PID of eq. (19) with kp, ki, kd and tau_d."""
    return STRUCTURES["pid"].controller(np.array([values]))


def pi(*values: float) -> Controller:
    """Return the PI with kp and ki."""
    return STRUCTURES["pi"].controller(np.array([values]))
