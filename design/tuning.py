"""The steps of ``hil tune``: collect, identify, design against all models, and verify on the rig.

Every experiment is a recording in the results folder. One that is complete is not repeated, so a tuning that
was interrupted goes on where it stopped. Experiments are run as commands (``hil collect``, ``hil run``), so
that they go through the gateway exactly as those of a user.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec
import numpy as np

from design.errors import InfeasibleError
from design.output.tuning_results import Condition as Condition
from design.output.tuning_results import Job as Job
from design.output.tuning_results import Model as Model
from design.output.tuning_results import Tuning as Tuning
from design.output.tuning_results import Verified as Verified
from design.output.tuning_results import failures
from design.tuning_experiments import (
    PARTIAL,
    collect_command,
    run_experiment,
    show,
    start_position,
    step_command,
    step_setpoint,
)
from design.tuning_experiments import (
    ExperimentError as ExperimentError,
)
from hil.core.documents import Document, from_json, from_toml, to_json
from hil.core.errors import DocumentError, HilError
from hil.core.excitation import Prbs
from hil.core.experiment import Experiment, Origins, check_experiment
from hil.host.text_file import read_text

if TYPE_CHECKING:
    from design.synthesis.design_file import DesignFile
    from design.synthesis.procedure import Design, OnProgress
    from hil.recording.tables import AxisTable
    from hil.views.summary import StepResponse, Tracking

ESTIMATION_SEED, VALIDATION_SEED = 1, 2
SETTLING_FACTOR = 1.5
"""Without a design file, an infeasible settling time is lengthened by this factor…"""
MAX_LENGTHENINGS = 4
"""… at most so many times. The report says which limit was used."""
MAX_VERIFICATIONS = 3
"""Controllers that are tried on the rig at most, each with a longer settling time than the one before."""
DEFAULT_SETTLING_S = 2.0
"""Settling time in s for which a step is recorded if the design file states none."""
DEFAULT_STEP = {"m": 0.1, "rad": 0.5}
"""Size of the step of a verification, by the axis' unit. It lies symmetrically about the centre."""

JOB_NAME = "tune.json"
"""Document of the job in a results folder."""
OPTIONS = {
    "axis": "--axis",
    "amplitude": "--amplitude",
    "duration_s": "--duration",
    "structure": "--structure",
    "conditions": "--conditions",
    "rig": "--rig",
    "bus": "--bus",
    "design": "--design",
    "step": "--step",
    "controller": "--controller",
}
"""Option of the command for each field of a job."""
_OTHER_FOLDER = "another --out, or remove the folder"

Say = Callable[[str], None]
Ask = Callable[[str], None]
"""Asks the user to confirm, and raises HilError without a yes."""


class Conditions(Document, frozen=True):
    """The file of ``hil tune --conditions``."""

    condition: Annotated[list[Condition], msgspec.Meta(min_length=2, max_length=8)]


SIMULATED_CONDITIONS = (
    Condition(name="nominal"),
    Condition(name="loaded", events=["payload:3@0", "supply-pressure:400@0"]),
)
"""The paper's load and supply pressure (Fig. 14)."""
REAL_CONDITIONS = (
    Condition(name="nominal"),
    Condition(
        name="repeat", instruction="Change nothing: this experiment shows how well the first one repeats."
    ),
)


def read_conditions(path: Path) -> list[Condition]:
    """Read a file of conditions. Raises DocumentError."""
    conditions = from_toml(read_text(path), Conditions, str(path)).condition
    names = [condition.name for condition in conditions]
    if len(set(names)) < len(names):
        raise DocumentError(f"{path}: condition: two conditions have the same name; each needs its own")
    return conditions


def check(job: Job) -> None:
    """Read everything that the tuning needs, and check it, before anything moves. Raises HilError."""
    from design.identification.models.structures import parse_structure
    from design.inputs import load_design
    from hil.shells.run_setup import load_controller, load_rig

    _check_values(job)
    parse_structure(job.structure)
    if job.design is not None:
        load_design(job.design)
    if job.controller is not None:
        load_controller(job.controller)
    rig = load_rig(job.rig)
    axis = rig.axes[job.axis]
    low, high = axis.fence_limits
    half = 0.5 * (job.step if job.step is not None else DEFAULT_STEP[axis.unit])
    for condition in job.conditions:
        check_experiment(
            _experiment(job, condition),
            rig,
            Origins("--axis", f"condition {condition.name}: centre", "--amplitude"),
        )
        centre = condition.centre
        if not low <= centre - abs(half) <= centre + abs(half) <= high:
            raise DocumentError(
                f"condition {condition.name}: a step of {2.0 * half:g} {axis.unit} about {centre:g} leaves "
                f"the travel fence, {low:g} to {high:g} {axis.unit}; change --step or centre"
            )
        if job.bus is not None and condition.events and not condition.instruction:
            raise DocumentError(
                f"condition {condition.name}: events happen to the simulated arm only; on {job.bus}, give an "
                "instruction that says what to do to the rig"
            )


def _check_values(job: Job) -> None:
    """Raise DocumentError for a value that no experiment can have, whatever the rig."""
    for option, value, unit in (("--amplitude", job.amplitude, "V"), ("--duration", job.duration_s, "s")):
        if not value > 0.0:
            raise DocumentError(f"{option}: {value:g} {unit} is not over 0 {unit}")
    if job.step == 0.0:
        raise DocumentError("--step: a step of 0 shows no response; give the size of a step, or omit --step")


def _experiment(job: Job, condition: Condition) -> Experiment:
    """Return the experiment that ``hil collect`` runs for :func:`collect_command`."""
    return Experiment(
        format="hil-experiment",
        version=1,
        axis=job.axis,
        mode="open loop",
        signal=Prbs(job.amplitude, job.duration_s),
        centre=condition.centre,
    )


def claim_folder(directory: Path, job: Job) -> bool:
    """Make the results folder, or find that it belongs to the same job. Return whether work is resumed.

    A folder without a complete experiment is taken over. Raises DocumentError where the folder belongs to
    another job, naming the options that differ, or holds other files.
    """
    note = directory / JOB_NAME
    if note.exists():
        found = _earlier_job(note)
        if any(not path.name.startswith(PARTIAL) for path in directory.glob("*.mcap")):
            _check_same_job(directory, found, job)
            return True
    elif directory.exists() and any(directory.iterdir()):
        raise DocumentError(f"{directory} is not empty and holds no tuning; give another --out")
    directory.mkdir(parents=True, exist_ok=True)
    note.write_text(to_json(job), encoding="utf-8")
    return False


def _earlier_job(note: Path) -> Job:
    """Read the job of a results folder. Raises DocumentError."""
    try:
        return from_json(read_text(note), Job, str(note))
    except DocumentError as error:
        raise DocumentError(
            f"{note.parent} holds the results of another tuning, whose options cannot be read: {error}; "
            f"give {_OTHER_FOLDER}"
        ) from None


def _check_same_job(directory: Path, found: Job, job: Job) -> None:
    """Raise DocumentError where a results folder belongs to another job, and say what differs."""
    different = [
        _difference(field, getattr(found, field), getattr(job, field))
        for field in OPTIONS
        if getattr(found, field) != getattr(job, field)
    ]
    different += [
        f"{name} has other content now"
        for name in found.digests.keys() & job.digests.keys()
        if found.digests[name] != job.digests[name]
    ]
    if different:
        raise DocumentError(
            f"{directory} holds the results of another tuning: {'; '.join(different)}. Give the same "
            f"options, or {_OTHER_FOLDER}"
        )


def _difference(field: str, before: object, now: object) -> str:
    """Return how an option differs from that of an earlier call."""
    if field == "conditions":
        return "--conditions names other conditions"
    before, now = ("not given" if value is None else value for value in (before, now))
    return f"{OPTIONS[field]} was {before}, and is {now} now"


def collect(job: Job, directory: Path, say: Say, ask: Ask) -> list[tuple[Condition, Path, Path]]:
    """Run the experiments that are missing: for each condition, a record to fit and one to validate with."""
    found = []
    for condition in job.conditions:
        paths = [directory / f"{condition.name}-{seed}.mcap" for seed in (ESTIMATION_SEED, VALIDATION_SEED)]
        for path, seed in zip(paths, (ESTIMATION_SEED, VALIDATION_SEED), strict=True):
            if path.exists():
                say(f"{condition.name}: {path.name} is there already")
                continue
            command = collect_command(job, condition, seed)
            if job.bus is not None:
                show([*command, "--dry-run"])
                ask(_question(job, condition, f"will be excited for {job.duration_s:g} s, as predicted"))
            say(f"{condition.name}: exciting {job.axis}, {job.duration_s:g} s, seed {seed}")
            run_experiment(path, command)
        found.append((condition, paths[0], paths[1]))
    return found


def _question(job: Job, condition: Condition, motion: str) -> str:
    """Return the question before a motion of the axis. ``motion`` says what it will do."""
    parts = (f"Condition {condition.name}.", condition.instruction, f"{job.axis} on {job.bus} {motion}.")
    return " ".join((*filter(None, parts), "Is its range free of people?"))


def identify(
    job: Job, records: Sequence[tuple[Condition, Path, Path]], directory: Path, say: Say
) -> list[Model]:
    """Identify the model of every condition, and write its plant file."""
    from design.identification.identify import identify_experiments
    from design.identified_plant import identified_plant
    from design.records import read_record

    models = []
    for condition, to_fit, to_validate in records:
        fitted, validation = read_record(to_fit, axis=job.axis), read_record(to_validate, axis=job.axis)
        identification = identify_experiments(
            [fitted.experiment],
            structure=job.structure,
            validation=[validation.experiment],
            expected=fitted.expected,
        )
        unit: Literal["m", "rad"] = "rad" if fitted.unit == "rad" else "m"
        plant = identified_plant(
            identification,
            name=f"{job.axis}-{condition.name}",
            output_unit=unit,
            description=f"axis {job.axis}, condition {condition.name}",
            conditions={**fitted.conditions, "condition": condition.name, **_instruction(condition)},
            recording=fitted.sha256,
        )
        path = directory / f"{condition.name}.plant.json"
        path.write_text(to_json(plant), encoding="utf-8")
        say(f"{condition.name}: {job.structure}, fit {identification.fit_percent:.2f} % on the other record")
        models.append(Model(condition, plant, identification, path))
    return models


def _instruction(condition: Condition) -> dict[str, str]:
    return {"instruction": condition.instruction} if condition.instruction else {}


def design(
    job: Job,
    models: Sequence[Model],
    say: Say,
    on_progress: OnProgress | None = None,
    settling_s: float | None = None,
) -> tuple[Design, DesignFile]:
    """Design against all models. Without a design file, a settling time that cannot be met is lengthened.

    ``settling_s`` replaces the limit on the settling time to begin with. Raises DesignError where no
    controller meets the specifications on all models.
    """
    from design.inputs import load_design
    from design.synthesis.design_file import FurtherPlants
    from design.synthesis.procedure import design_controller

    requirements = load_design(job.design) if job.design else default_design()
    requirements = msgspec.structs.replace(requirements, further_plants=FurtherPlants(worst_case=True))
    if settling_s is not None:
        requirements = _with_settling(requirements, settling_s)
    nominal, *others = [model.plant for model in models]
    for _ in range(MAX_LENGTHENINGS):
        settling = requirements.specifications.settling_s
        try:
            found = design_controller(requirements, nominal, others, on_progress)
            candidate = Tuning(job, tuple(models), requirements, None, found, Path(), ())
            if job.design is not None or settling is None or not candidate.missed_predictions:
                return found, requirements
        except InfeasibleError:
            if job.design is not None or settling is None:
                raise
        longer_s = longer_settling(requirements)
        say(f"no controller found settles within {settling:g} s on all models; trying {longer_s:g} s")
        requirements = _with_settling(requirements, longer_s)
    return design_controller(requirements, nominal, others, on_progress), requirements


def longer_settling(requirements: DesignFile) -> float:
    """Return the next limit on the settling time in s, after one that could not be met."""
    return round(SETTLING_FACTOR * (requirements.specifications.settling_s or 1.0), 3)


def _with_settling(requirements: DesignFile, settling_s: float) -> DesignFile:
    limits = msgspec.structs.replace(requirements.specifications, settling_s=settling_s)
    return msgspec.structs.replace(requirements, specifications=limits)


def verify(
    job: Job,
    models: Sequence[Model],
    requirements: DesignFile,
    controller: Path,
    directory: Path,
    say: Say,
    ask: Ask,
) -> list[Verified]:
    """Step the axis with the new controller under every condition, and compare with the specifications."""
    from hil.recording import open_recording
    from hil.views.summary import StepResponse, min_steps

    found = []
    for model in models:
        condition = model.condition
        # Named after the controller, so that a step with an earlier one is not taken for it.
        path = directory / f"{condition.name}-step-{_digest(controller)}.mcap"
        if not path.exists():
            unit = model.plant.output_unit
            half = 0.5 * (job.step if job.step is not None else DEFAULT_STEP[unit])
            low, high = condition.centre - half, condition.centre + half
            if job.bus is not None:
                path_text = f"from where it is to {low:g} {unit}, and will then step to {high:g} {unit}"
                ask(_question(job, condition, f"will move with the new controller {path_text}"))
            say(f"{condition.name}: stepping {job.axis} with the new controller")
            start = start_position(job, condition, controller, directory)
            settling_s = requirements.specifications.settling_s or DEFAULT_SETTLING_S
            setpoint = directory / f"{condition.name}-step.csv"
            setpoint.write_text(step_setpoint(start, low, high, settling_s), encoding="utf-8")
            run_experiment(path, step_command(job, condition, controller, setpoint, settling_s))
        recording = open_recording(path)
        smallest = min_steps(recording.documents.get("rig.toml", ""))
        measured = last_step(recording.axis(job.axis), smallest.get(job.axis, 0.0))
        if not isinstance(measured, StepResponse):
            raise HilError(f"{path}: no step response of {job.axis} can be read from it")
        found.append(Verified(condition, path, measured, failures(measured, requirements)))
    return found


def last_step(table: AxisTable, min_step: float = 0.0) -> StepResponse | Tracking | None:
    """Return the readings of the last change of the setpoint, without the path that leads to it.

    ``min_step``: smallest change that is a step, in the axis' unit.
    """
    from hil.views.summary import axis_summary

    controlled = table[table.running]
    changes = np.flatnonzero(np.diff(controlled.setpoint)) + 1
    begins = int(changes[-2]) if len(changes) > 1 else 0
    return axis_summary(controlled[begins:], min_step)


def default_design() -> DesignFile:
    """Return the requirements of a tuning without a design file: those of the paper."""
    from design.synthesis.design_file import DesignFile

    return DesignFile()


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:8]
