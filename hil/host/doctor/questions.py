"""The questions that the doctor asks, in the order in which a reader wants the answers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import Final, NamedTuple

from hil.host.doctor.buses import serial_ports, simulated_rig, socketcan, virtual_can
from hil.host.doctor.check import Check
from hil.host.doctor.timing import clock, limits, processors, rights_and_wake_ups
from hil.host.doctor.versions import versions


class Question(NamedTuple):
    """A function that examines one part of this machine."""

    answer: Callable[[], Iterator[Check]]
    """Function that yields the findings."""
    activity: str = ""
    """What to show to a waiting user; empty if the answer comes within a second."""


QUESTIONS: Final = (
    Question(simulated_rig),
    Question(socketcan),
    Question(virtual_can, "trying hil vcan (user-mode Linux takes about 3 s to start)"),
    Question(serial_ports),
    Question(rights_and_wake_ups),
    Question(limits),
    Question(clock),
    Question(processors),
    Question(versions),
)


def doctor(show: Callable[[str], AbstractContextManager[object]] = nullcontext) -> list[Check]:
    """Answer every question and return the findings. This takes 1 to 5 s.

    ``show`` displays an activity to the user while its context is open.
    """
    checks: list[Check] = []
    for question in QUESTIONS:
        with show(question.activity) if question.activity else nullcontext():
            checks += question.answer()
    return checks
