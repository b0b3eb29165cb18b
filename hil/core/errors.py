"""All errors that a user can correct, in one tree. The command line prints them without a traceback.

A message has three parts: what is wrong (name, value, unit, limit), where it comes from (file, key or
option), and what to do.
"""

from __future__ import annotations


class HilError(Exception):
    """Base of all errors that a user can correct."""


class DocumentError(HilError):
    """A file or an option cannot be read, or has a value that is not allowed."""


class SetpointError(HilError):
    """A setpoint such as ``step:0.1@1`` cannot be read, or leaves the range of the axis."""


class LinkError(HilError):
    """A bus or a serial line cannot be opened, or failed while it was used."""


class RecordingError(HilError):
    """A recording cannot be written or read."""


class RecordingExistsError(RecordingError):
    """A recording would overwrite an existing file."""


class ReplayMismatchError(HilError):
    """A replay gave another answer than the recorded one."""


class EnvironmentLackError(HilError):
    """The machine lacks a kernel module, a right or a program that a command needs."""


class OperationError(HilError):
    """No daemon answers, or the connection to it failed."""


class NoDaemonError(OperationError):
    """No daemon listens at the socket's path."""


class ConnectionLostError(OperationError):
    """The daemon closed the connection without an answer."""


class RequestRefusedError(OperationError):
    """The daemon refused a request. The message is the daemon's reason."""


class SimulationError(HilError):
    """The state of a simulated plant has left the range in which its model is valid."""
