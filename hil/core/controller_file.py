"""The controller file: a versioned JSON document that `hil design` writes and the gateway runs.

The law is stored for one sample time; the gateway refuses every other. This module has the document and its
checks. ``control_law`` turns a law into what runs.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import msgspec

from hil.core.documents import Document, from_json
from hil.core.errors import DocumentError

MAX_STATES = 50
"""Highest order of a law that is run."""
MAX_COEFFICIENT = 1e12
"""Largest magnitude of a coefficient. Beyond it, double precision leaves no correct digits."""

Coefficient = Annotated[float, msgspec.Meta(ge=-MAX_COEFFICIENT, le=MAX_COEFFICIENT)]
NonNegative = Annotated[float, msgspec.Meta(ge=0.0, le=MAX_COEFFICIENT)]
Polynomial = Annotated[list[Coefficient], msgspec.Meta(max_length=MAX_STATES + 1)]
Row = Annotated[list[Coefficient], msgspec.Meta(max_length=MAX_STATES)]
Rows = Annotated[list[Row], msgspec.Meta(max_length=MAX_STATES)]


class PidLaw(Document, frozen=True, tag_field="kind", tag="pid"):
    """PID with filtered derivative, eq. (19), sampled by Tustin's rule at the file's sample time.

    u = kp (b r - y) + ki/s (r - y) + kd s/(tau_d s + 1) (c r - y). Gains are in output unit per input unit
    (ki per second, kd times second, tau_d in seconds). b = c = 1 is eq. (19) itself.
    """

    kp: Coefficient
    ki: Coefficient
    kd: Coefficient = 0.0
    tau_d: NonNegative = 0.0
    b: Coefficient = 1.0
    c: Coefficient = 1.0


class TransferFunctionLaw(Document, frozen=True, tag_field="kind", tag="transfer_function"):
    """u/e = num(z)/den(z), coefficients in falling powers of z. den has the same or a higher degree."""

    num: Polynomial
    den: Polynomial


class StateSpaceLaw(Document, frozen=True, tag_field="kind", tag="state_space"):
    """x[k+1] = A x[k] + B w[k], u[k] = C x[k] + D w[k] with w = [e] or w = [r, y].

    Shapes: A (n, n), B (n, m), C (1, n), D (1, m). m is 1 for ``inputs = "e"`` and 2 for ``"r, y"``.
    """

    A: Rows
    B: Rows
    C: Rows
    D: Rows
    inputs: Literal["e", "r, y"] = "e"


Law = PidLaw | TransferFunctionLaw | StateSpaceLaw


class ControllerFile(Document, frozen=True):
    """A controller of one axis. u is the offset of the valve voltage from its centre, in volts."""

    format: Literal["hil-controller"]
    version: Literal[1]
    name: str
    description: str
    sample_time_s: Annotated[float, msgspec.Meta(gt=0.0)]
    input_unit: Literal["m", "rad"]
    output_unit: Literal["V"]
    law: Law
    origin: dict[str, Any]
    """How the controller was made (method, plant, weights, margins, seeds, versions), for people."""


def read_controller(text: str, source: str) -> ControllerFile:
    """Read and check the text of a controller file. Raises DocumentError naming file, key and limit."""
    controller = from_json(text, ControllerFile, source)
    where = f"{source}: law"
    match controller.law:
        case PidLaw() as pid:
            if pid.kd != 0.0 and pid.tau_d == 0.0:
                raise DocumentError(
                    f"{where}.tau_d is 0 s with kd {pid.kd}: the derivative is not filtered; give tau_d > 0"
                )
        case TransferFunctionLaw(num=num, den=den):
            _check_polynomials(num, den, where)
        case StateSpaceLaw() as law:
            _check_shapes(law, where)
    return controller


def check_controller_fits(controller: ControllerFile, source: str, period_s: float, unit: str) -> None:
    """Refuse a controller for another sample time or unit than those of the axis. Raises DocumentError."""
    if not math.isclose(controller.sample_time_s, period_s, rel_tol=1e-9):
        raise DocumentError(
            f"{source}: sample_time_s: {controller.sample_time_s} s is not the loop's {period_s} s "
            "(rig: loop.period_s); design it again for this loop"
        )
    if controller.input_unit != unit:
        raise DocumentError(
            f"{source}: input_unit is {controller.input_unit}, but the axis is in {unit}; give a controller "
            f"that was designed for an axis in {unit}"
        )


def _check_polynomials(num: list[float], den: list[float], where: str) -> None:
    if not den or den[0] == 0.0:
        raise DocumentError(f"{where}.den: the leading coefficient must not be 0")
    if not num:
        raise DocumentError(f"{where}.num is empty; give at least one coefficient")
    if len(num) > len(den):
        raise DocumentError(
            f"{where}: num has degree {len(num) - 1}, den {len(den) - 1}: the law would need future errors"
        )


def _check_shapes(law: StateSpaceLaw, where: str) -> None:
    n, m = len(law.A), 1 if law.inputs == "e" else 2
    for name, rows, columns in (("A", n, n), ("B", n, m), ("C", 1, n), ("D", 1, m)):
        matrix: list[list[float]] = getattr(law, name)
        if len(matrix) != rows or any(len(row) != columns for row in matrix):
            raise DocumentError(f"{where}.{name} must have the shape ({rows}, {columns})")
