"""One case of a campaign: a run in simulated time and its result."""

from __future__ import annotations

import functools
import json
import tomllib
from pathlib import Path
from random import Random
from typing import Any, Final, NamedTuple

import msgspec

from firmware_sim.arm.arm import Arm
from firmware_sim.arm.arm_file import check_arm, shipped_arm, shipped_arm_text
from firmware_sim.arm.parameters import ArmParameters
from firmware_sim.arm.wiring import wiring
from firmware_sim.boards.codec import DAC_NODE, RPDO1_ID, VOLTS_PER_COUNT
from firmware_sim.faults.fault_text import fault_text, parse_fault
from firmware_sim.faults.frame_faults import counts_of
from hil.campaigns.campaign_file import Campaign, Case, case_at
from hil.campaigns.prepared import PreparedCampaign, build_setup
from hil.core.documents import from_plain
from hil.core.errors import DocumentError, HilError
from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState
from hil.core.rig import Rig
from hil.lockstep_rig import LockstepRig
from hil.views.summary import StepResponse, axis_summary

PASSED: Final = "pass"
FAILED: Final = "fail"
_DRAWN: Final = "arm.toml with drawn parameters"


class CaseResult(msgspec.Struct, frozen=True):
    """Result of one case. All values are plain, so that any table can hold them."""

    number: int
    """Number of the case, from 0."""
    draw: int
    setup: int
    fault: str
    """Fault with its time; empty without a fault."""
    verdict: str
    """``pass`` or ``fail``."""
    problem: str
    """Reasons of a failure, separated by semicolons."""
    state: str
    """State of the gateway at the end."""
    reason: str
    """Source and reason of the gateway's fault; empty without one."""
    begun_s: float | None
    """Instant of simulated time at which the fault began; None if it did not begin."""
    centred_after_periods: int | None
    """Periods from the fault until the valves stayed centred; None if they did not."""
    limits_held: bool
    """True if all valve commands kept the magnitude and rate limits of the rig file."""
    max_error: float
    """Largest control error of any axis as a fraction of its range of setpoints, while running."""
    overshoot: float | None
    """Overshoot of the first axis with criteria, as a fraction of the step; None without a step."""
    settling_s: float | None
    """Settling time of that axis in seconds; None if it does not settle."""
    arm: str
    """Drawn parameters of the arm, as JSON."""


class _Motion(NamedTuple):
    """When the valves moved, in periods of control."""

    begun: int | None
    """Period in which the fault began."""
    last_moved: int
    """Last period at whose end a valve was not at its centre; -1 if there was none."""
    periods: int


def run_case(prepared: PreparedCampaign, number: int, record: Path | None = None) -> CaseResult:
    """Run a case. ``record`` is a file for its recording. The same case gives the same result and bytes.

    Raises DocumentError if a fault or a drawn parameter does not fit the rig or the arm, and HilError if the
    rig cannot be started.
    """
    campaign = prepared.campaign
    case = case_at(campaign, number)
    random = Random(f"campaign {campaign.seed}, case {number}")
    drawn = {key: distribution.draw(random) for key, distribution in campaign.arm.items()}
    rig = _build(prepared, case, drawn, random.getrandbits(31))
    motion = _run(rig, campaign.duration_s, case)
    if record is not None:
        rig.save_recording(record)
    return _result(campaign, case, rig, motion, drawn)


def _build(prepared: PreparedCampaign, case: Case, drawn: dict[str, float], seed: int) -> LockstepRig:
    setup = build_setup(prepared.setups[case.setup])
    plant = Arm(_arm(tuple(drawn.items())), seed=seed, wiring=wiring(setup.rig))
    chosen = prepared.campaign.setups[case.setup]
    faults = [*chosen.conditions, *([case.fault_text] if case.fault_text else [])]
    return LockstepRig(setup, plant=plant, faults=faults, seed=seed, bit_rate=chosen.bit_rate)


@functools.lru_cache(maxsize=1)
def _arm(drawn: tuple[tuple[str, float], ...]) -> ArmParameters:
    """Return the shipped arm with drawn parameters. Raises DocumentError for a key that it does not have."""
    if not drawn:
        return shipped_arm()
    plain = tomllib.loads(shipped_arm_text())
    for key, value in drawn:
        *tables, last = key.split(".")
        table: Any = plain
        for name in tables:
            table = table.get(name) if isinstance(table, dict) else None
        if not isinstance(table, dict) or not isinstance(table.get(last), float):
            raise DocumentError(f"campaign: arm.{key}: the arm file has no number under this key")
        table[last] = value
    return check_arm(from_plain(plain, ArmParameters, _DRAWN), _DRAWN)


def _run(rig: LockstepRig, duration_s: float, case: Case) -> _Motion:
    """Bring the rig to state running, and run. Faults may end the bring-up early."""
    expected = fault_text(parse_fault(case.fault_text)) if case.fault_text else ""
    try:
        rig.bring_up()
        rig.arm()
        rig.start()
    except HilError:
        if rig.state is not LifeCycleState.FAULT:
            raise
    centred = _centre(rig.rig)
    begun, last_moved = None, -1
    periods = round(duration_s / rig.rig.loop.period_s)
    for period in range(periods):
        rig.step()
        if begun is None and any(text == expected for _, text in rig.faults_begun):
            begun = period
        if rig.boards.dac.valve_v != centred:
            last_moved = period
    return _Motion(begun, last_moved, periods)


def _centre(rig: Rig) -> tuple[float, ...]:
    centre_v = [5.0, 5.0, 5.0]
    for axis in rig.axes.values():
        centre_v[axis.valve.channel - 1] = axis.valve.centre_v
    return tuple(centre_v)


def _result(
    campaign: Campaign, case: Case, rig: LockstepRig, motion: _Motion, drawn: dict[str, float]
) -> CaseResult:
    expected = fault_text(parse_fault(case.fault_text)) if case.fault_text else ""
    begun_ns = next((at_ns for at_ns, text in rig.faults_begun if text == expected), None)
    centred = None
    if motion.begun is not None and motion.last_moved < motion.periods - 1:
        centred = max(motion.last_moved + 1 - motion.begun, 0)
    readings = _readings(campaign, rig)
    limits_held = commands_keep_limits(rig.rig, rig.sent)
    problems = list(_problems(campaign, case, rig, centred, readings))
    if expected and begun_ns is None:
        problems.append("the fault did not begin: its condition was not met in time")
    if not limits_held:
        problems.append("a valve command exceeded a limit of the rig file")
    first = next(iter(readings.values()), None)
    return CaseResult(
        number=case.number,
        draw=case.draw,
        setup=case.setup,
        fault=expected,
        verdict=FAILED if problems else PASSED,
        problem="; ".join(problems),
        state=rig.state.name,
        reason=rig.gateway.fault_reason or "",
        begun_s=None if begun_ns is None else begun_ns * 1e-9,
        centred_after_periods=centred,
        limits_held=limits_held,
        max_error=_max_error(rig),
        overshoot=None if first is None else first.overshoot_percent / 100.0,
        settling_s=None if first is None else first.settling_s,
        arm=json.dumps(drawn),
    )


def _problems(
    campaign: Campaign,
    case: Case,
    rig: LockstepRig,
    centred: int | None,
    readings: dict[str, StepResponse],
) -> list[str]:
    """Return what differs from the expected reaction, in words."""
    fault = case.fault
    problems = []
    if fault.expect == "fault":
        if rig.state is not LifeCycleState.FAULT:
            problems.append(f"expected a fault of the gateway, but it is {rig.state.name}")
        if fault.max_periods is not None and (centred is None or centred > fault.max_periods):
            after = "not" if centred is None else f"after {centred} periods"
            problems.append(f"the valves were centred {after}, limit {fault.max_periods} periods")
    if fault.expect == "running":
        if rig.state is not LifeCycleState.RUNNING:
            problems.append(f"expected the gateway to keep running: {rig.gateway.fault_reason}")
        for criteria in campaign.criteria:
            found = readings.get(criteria.axis)
            if found is None:
                problems.append(f"{criteria.axis}: made no step from rest")
                continue
            for name, value, limit in (
                ("overshoot", found.overshoot_percent / 100.0, criteria.overshoot),
                ("settling time in s", found.settling_s, criteria.settling_s),
                ("steady-state error", abs(found.steady_state_error), criteria.steady_state_error),
            ):
                if limit is not None and (value is None or value > limit):
                    shown = "endless" if value is None else f"{value:.4g}"
                    problems.append(f"{criteria.axis}: {name} {shown}, limit {limit:g}")
    return problems


def _readings(campaign: Campaign, rig: LockstepRig) -> dict[str, StepResponse]:
    readings = {}
    for criteria in campaign.criteria:
        found = axis_summary(rig.axis(criteria.axis))
        if isinstance(found, StepResponse):
            readings[criteria.axis] = found
    return readings


def _max_error(rig: LockstepRig) -> float:
    ranges = [axis.max_y - axis.min_y for axis in rig.rig.axes.values()]
    return max(
        (
            abs(signals.error) / span
            for cycle in rig.cycles
            if cycle.state is LifeCycleState.RUNNING
            for signals, span in zip(cycle.axes, ranges, strict=True)
        ),
        default=0.0,
    )


def commands_keep_limits(rig: Rig, sent: list[Frame]) -> bool:
    """Return whether all valve commands keep the limits of a rig file.

    The voltages must lie within each valve's range, and differ from the command before by no more than its
    rate limit allows in one period. A command that centres a valve may differ by more. The frames are decoded
    by the boards' code, and the limits are checked by this function alone.
    """
    commands = [counts_of(frame) for frame in sent if frame.id == RPDO1_ID + DAC_NODE]
    for axis in rig.axes.values():
        valve = axis.valve
        channel = valve.channel - 1
        max_step_v = valve.max_rate_v_s * rig.loop.period_s + VOLTS_PER_COUNT
        before_v = valve.centre_v
        for counts in commands:
            volts = counts[channel] * VOLTS_PER_COUNT
            is_centre = abs(volts - valve.centre_v) <= VOLTS_PER_COUNT
            if not valve.min_v <= volts <= valve.max_v + VOLTS_PER_COUNT:
                return False
            if not is_centre and abs(volts - before_v) > max_step_v:
                return False
            before_v = volts
    return True
