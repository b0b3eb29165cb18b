"""Constants of the shipped rig that tests of every package use."""

PERIOD_NS = 11_200_000
"""Period of the loop in nanoseconds."""
PERIOD_S = 0.0112
"""Period of the loop in seconds."""
COUNT_V = 10.0 / 32768
"""Resolution of an analogue channel in volts: left-adjusted INTEGER16 of CiA 401, 10 V = 2^15."""
CENTRED = (5.0, 5.0, 5.0)
"""Voltages of three centred valves, in volts."""
