"""Figures that the paper prints, as printed.

S. Kaitwanidvilai and M. Parnichkun, "Design of Structured Controller Satisfying H∞ Loop Shaping using
Evolutionary Optimization: Application to a Pneumatic Robot Arm". Times in s, frequencies in rad/s, the plant
in m per V. Eq. (15), the plant, is the shipped plant file ``paper.json``; the limits of eq. (9) are
``design.closed_loop.specifications.PAPER``.
"""

from __future__ import annotations

import numpy as np

from design.models.plant import Plant, paper_plant
from design.models.transfer_function import TransferFunction

W1 = TransferFunction(np.array([15.535, 6.83]), np.array([1.0, 0.001]))
"""Weight W1 of eq. (16)."""
EPS_OPT = 0.60149
"""Optimal stability margin with the weight of eq. (16)."""
HLS_EPS = 0.54681
"""Stability margin for which the conventional controller HLS, eq. (18), was designed."""
HLS = TransferFunction(
    np.array([372.3, 6714.0, 67960.0, 55790.0, 11950.0]), np.array([1.0, 40.0, 701.3, 6310.0, 2648.0, 2.641])
)
"""Conventional loop-shaping controller of eq. (18)."""
PPID_EPS = 0.548
"""Stability margin of the proposed controller PPID, eq. (20)."""
PPID = (11.013, 5.6444, 38.639, 74.162)
"""Parameters of the proposed controller of eq. (20): kp, ki, kd, tau_d."""
PERIOD_S = 0.0112
"""Sampling period of the experiments."""

PLANT_GAIN = 0.47947
"""Leading coefficient of the numerator of eq. (15)."""
PLANT_ZERO_RAD_S = 90.76
"""Zero of eq. (15), which lies at s = -90.76."""
PLANT_SLOW_POLE_RAD_S = 0.4231
"""Slow pole of eq. (15), which lies at s = -0.4231."""
PLANT_STIFFNESS = 167.9
"""Constant term of the quadratic factor of eq. (15)."""
DAMPING = 16.97
"""Linear term of the quadratic factor of eq. (15)."""
MISPRINTED_DAMPING = 16.67
"""Linear term of the same factor in eq. (17)."""

WEIGHT_GENERATIONS, CONTROLLER_GENERATIONS = 20, 30
"""Generations of the genetic search for the weight and for the controller, Sec. IV."""
CONVERGED_AT_GENERATION = 12
"""Generation after which Fig. 6 shows the weight of eq. (16)."""


def is_paper_plant(plant: Plant) -> bool:
    """Return whether a plant is eq. (15), whatever its name."""
    paper = paper_plant()
    same = (plant.num, plant.den, plant.output_unit) == (paper.num, paper.den, paper.output_unit)
    return same and plant.is_rational
