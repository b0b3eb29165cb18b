"""Preflight checks of this machine: what it offers a control loop, and what to do about the rest.

The checks change nothing, with two exceptions. The real-time rights are taken for the half second in which
wake-ups are measured. If ``hil vcan`` would use user-mode Linux, it is started once and switched off again.
"""

from hil.host.doctor.check import Check, CheckVerdict
from hil.host.doctor.questions import doctor

__all__ = ["Check", "CheckVerdict", "doctor"]
