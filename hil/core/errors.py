"""Every error a user can meet, in one tree. The command line prints them without a traceback.

A message names the signal, the value, the limit, its unit and where the limit comes from.
"""

from __future__ import annotations


class HilError(Exception):
    """Something the user can put right; its text says what was wrong, where, and what to do."""


class DocumentError(HilError):
    """A TOML or JSON document (rig, controller, design, arm, scenario) is not what it should be."""


class SetpointError(HilError):
    """A setpoint text such as ``step:0.1@1`` cannot be read, or leaves the axis' range."""


class LinkError(HilError):
    """A bus or serial line cannot be opened, or failed in use."""


class RecordingError(HilError):
    """A recording cannot be written or read."""


class RecordingExistsError(RecordingError):
    """A recording would overwrite a file."""


class ReplayMismatchError(HilError):
    """A replayed core did not send the bytes that were recorded."""


class EnvironmentLackError(HilError):
    """The machine lacks something that a command needs (a kernel module, a right, a program)."""


class SimulationError(HilError):
    """A simulated plant has left what its model can stand for."""
