"""The simulated pneumatic arm with three axes.

- ``arm``: the arm as a plant, from valve voltages to potentiometer voltages.
- ``parameters``: the arm file (``arm.toml``) as typed documents, with its checks.
- ``dynamics.c``, ``native``: the equations of motion in C, and the binding to them.
- ``pins``, ``wiring``: valve input, potentiometer output, and the board channels that they use.
- ``events``, ``event_text``: what can happen to the arm during a run, and its form on a command line.
- ``linearisation``: the transfer function of one axis from its physical parameters, eq. (2) of the paper.
"""
