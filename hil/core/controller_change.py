"""Read and check a controller for an axis of a gateway that runs.

This takes some milliseconds for a law of high order. Therefore :func:`prepare_controller` may run in another
process. It returns plain values, which the gateway uses only if their digest says that they belong to the
text of the request. The text alone is recorded: a replay prepares the controller again.
"""

from __future__ import annotations

import hashlib
from typing import NamedTuple

from hil.core.closed_loop_poles import check_closed_loop
from hil.core.control_law import LawNumbers, check_law_runs, law_numbers
from hil.core.controller_file import check_controller_fits, read_controller
from hil.core.errors import DocumentError
from hil.core.requests import ControllerRequest
from hil.core.rig import Rig

MAX_DOCUMENT_CHARACTERS = 128 * 1024
"""Largest controller file of a request. A law of the highest order needs 60,000 characters."""


class PreparedController(NamedTuple):
    """A controller that was read and checked, or the reason why it is refused."""

    digest: str
    """SHA-256 of what the request asks for, and of what of the rig it was checked against."""
    refusal: str
    """Reason why the controller is refused; empty if it is not."""
    numbers: LawNumbers | None
    """Numbers of the law; None if it is refused."""
    is_loop_checked: bool
    """True if the closed loop with the plant of the file is known to be stable."""


def delay_periods(rig: Rig) -> int:
    """Return the periods from a command to its effect: the rig's own transport delay."""
    return 1 if rig.dac.apply == "at sync" else 0


def digest_of(request: ControllerRequest, rig: Rig) -> str:
    """Return the digest of a request and of what of ``rig`` its controller is checked against."""
    unit = rig.axes[request.axis].unit
    parts = (request.axis, request.name, request.document, unit, repr(rig.loop.period_s), rig.dac.apply)
    return hashlib.sha256("\0".join(parts).encode("utf-8", "replace")).hexdigest()


def prepare_controller(request: ControllerRequest, rig: Rig) -> PreparedController:
    """Read and check the controller of a request for an axis that ``rig`` has."""
    digest = digest_of(request, rig)
    axis = rig.axes[request.axis]
    if len(request.document) > MAX_DOCUMENT_CHARACTERS:
        refusal = (
            f"{request.name}: the controller file has {len(request.document)} characters, limit "
            f"{MAX_DOCUMENT_CHARACTERS}"
        )
        return PreparedController(digest, refusal, None, False)
    try:
        controller = read_controller(request.document, request.name)
        check_controller_fits(controller, request.name, rig.loop.period_s, axis.unit)
        check_law_runs(controller.law, controller.sample_time_s, request.name)
        is_checked = check_closed_loop(controller, request.name, delay_periods(rig))
    except DocumentError as error:
        return PreparedController(digest, str(error), None, False)
    numbers = law_numbers(controller.law, controller.sample_time_s)
    return PreparedController(digest, "", numbers, is_checked)
