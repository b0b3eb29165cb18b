"""The controller file: what crosses from ``design`` to the daemon. JSON, versioned.

The law is stored sampled, for one sample time; the daemon refuses any other. Lives here: the document and
its checks. The run-time form of a law is in ``laws``.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import msgspec

from hil.core.documents import Document, from_json
from hil.core.errors import DocumentError

NonNegative = Annotated[float, msgspec.Meta(ge=0.0)]


class PidLaw(Document, frozen=True, tag_field="kind", tag="pid"):
    """PID with filtered derivative, eq. (19), sampled by Tustin's rule at the file's sample time.

    u = kp (b r - y) + ki/s (r - y) + kd s/(tau_d s + 1) (c r - y); gains in output unit per input unit
    (ki per second, kd times second, tau_d in seconds). b = c = 1 is eq. (19) itself.
    """

    kp: float
    ki: float
    kd: float = 0.0
    tau_d: NonNegative = 0.0
    b: float = 1.0
    c: float = 1.0


class TransferFunctionLaw(Document, frozen=True, tag_field="kind", tag="transfer_function"):
    """u/e = num(z)/den(z), coefficients in falling powers of z, den of the same or higher degree."""

    num: list[float]
    den: list[float]


class StateSpaceLaw(Document, frozen=True, tag_field="kind", tag="state_space"):
    """x[k+1] = A x[k] + B w[k], u[k] = C x[k] + D w[k] with w = [e] or w = [r, y].

    Shapes: A (n, n), B (n, m), C (1, n), D (1, m), m = 1 for ``inputs = "e"`` and 2 for ``"r, y"``.
    """

    A: list[list[float]]
    B: list[list[float]]
    C: list[list[float]]
    D: list[list[float]]
    inputs: Literal["e", "r, y"] = "e"


Law = PidLaw | TransferFunctionLaw | StateSpaceLaw


class ControllerFile(Document, frozen=True):
    """A controller for one axis. u is the valve voltage's offset from its centre, in volts."""

    format: Literal["hil-controller"]
    version: Literal[1]
    name: str
    description: str
    sample_time_s: Annotated[float, msgspec.Meta(gt=0.0)]
    input_unit: Literal["m", "rad"]
    output_unit: Literal["V"]
    law: Law
    origin: dict[str, Any]
    """Where it comes from: method, plant, weights, margins, seeds, versions. Read by people and reports."""


def read_controller(text: str, source: str) -> ControllerFile:
    """Read and check the text of a controller file. Raises DocumentError naming file, key and limit."""
    controller = from_json(text, ControllerFile, source)
    where = f"{source}: law"
    match controller.law:
        case PidLaw() as pid:
            if pid.kd != 0.0 and pid.tau_d == 0.0:
                raise DocumentError(f"{where}.tau_d: 0 s with kd {pid.kd} is an unfiltered derivative")
        case TransferFunctionLaw(num=num, den=den):
            _check_polynomials(num, den, where)
        case StateSpaceLaw() as law:
            _check_shapes(law, where)
    return controller


def check_controller_fits(controller: ControllerFile, source: str, period_s: float, unit: str) -> None:
    """Refuse a controller made for another sample time or unit than the axis' loop. Raises DocumentError."""
    if not math.isclose(controller.sample_time_s, period_s, rel_tol=1e-9):
        raise DocumentError(
            f"{source}: sample_time_s: {controller.sample_time_s} s is not the loop's {period_s} s "
            "(rig: loop.period_s); design it again for this loop"
        )
    if controller.input_unit != unit:
        raise DocumentError(f"{source}: input_unit: {controller.input_unit}, but the axis is in {unit}")


def _check_polynomials(num: list[float], den: list[float], where: str) -> None:
    if not den or den[0] == 0.0:
        raise DocumentError(f"{where}.den: the leading coefficient must not be 0")
    if not num:
        raise DocumentError(f"{where}.num: empty")
    if len(num) > len(den):
        raise DocumentError(
            f"{where}: num has degree {len(num) - 1}, den {len(den) - 1}: the law would need future errors"
        )


def _check_shapes(law: StateSpaceLaw, where: str) -> None:
    n, m = len(law.A), 1 if law.inputs == "e" else 2
    for name, rows, columns in (("A", n, n), ("B", n, m), ("C", 1, n), ("D", 1, m)):
        matrix: list[list[float]] = getattr(law, name)
        if len(matrix) != rows or any(len(row) != columns for row in matrix):
            raise DocumentError(f"{where}.{name}: not of shape ({rows}, {columns})")
