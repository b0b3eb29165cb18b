"""The steps of ``hil tune``: collect, identify, design against all models, and verify on the rig.

Every experiment is a recording in the results folder. One that is complete is not repeated, so a tuning that
was interrupted goes on where it stopped. Experiments are run as commands (``hil collect``, ``hil run``), so
that they go through the gateway exactly as those of a user.
"""

from __future__ import annotations

import contextlib
import hashlib
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec

from design.errors import InfeasibleError
from design.output.tuning_results import Condition as Condition
from design.output.tuning_results import Job as Job
from design.output.tuning_results import Model as Model
from design.output.tuning_results import Tuning as Tuning
from design.output.tuning_results import Verified as Verified
from design.output.tuning_results import failures
from hil.core.documents import Document, from_toml, to_json
from hil.core.errors import DocumentError, HilError
from hil.host.text_file import read_text

if TYPE_CHECKING:
    from design.synthesis.design_file import DesignFile
    from design.synthesis.procedure import Design, OnProgress

ESTIMATION_SEED, VALIDATION_SEED = 1, 2
SETTLING_FACTOR = 1.5
"""Without a design file, an infeasible settling time is lengthened by this factor…"""
MAX_LENGTHENINGS = 4
"""… at most so many times. The report says which limit was used."""
END_TIMEOUT_S = 10.0
"""Time in which an experiment must end, valves centred, after it was interrupted."""
MAX_VERIFICATIONS = 3
"""Controllers that are tried on the rig at most, each with a longer settling time than the one before."""
SETTLE_S = 4.0
"""Rest before the step of a verification, in s, besides one settling time."""
DEFAULT_STEP = {"m": 0.1, "rad": 0.5}
"""Size of the step of a verification, by the axis' unit. It lies symmetrically about the centre."""

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


class ExperimentError(HilError):
    """An experiment on the rig failed, or did not give all that was asked for."""


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

    parse_structure(job.structure)
    if job.design is not None:
        load_design(job.design)
    if job.controller is not None:
        load_controller(job.controller)
    axis = load_rig(job.rig).axes[job.axis]
    low, high = axis.fence_limits
    half = 0.5 * (job.step if job.step is not None else DEFAULT_STEP[axis.unit])
    for condition in job.conditions:
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


def claim_folder(directory: Path, job: Job) -> bool:
    """Make the results folder, or find that it belongs to the same job. Return whether work is resumed.

    Raises DocumentError where it belongs to another job or holds other files.
    """
    note = directory / "tune.json"
    text = to_json(job)
    if note.exists():
        if note.read_text("utf-8") != text:
            raise DocumentError(
                f"{directory} holds the results of another tuning (see tune.json there); give another "
                "--out, or remove the folder"
            )
        return True
    if directory.exists() and any(directory.iterdir()):
        raise DocumentError(f"{directory} is not empty and holds no tuning; give another --out")
    directory.mkdir(parents=True, exist_ok=True)
    note.write_text(text, encoding="utf-8")
    return False


def collect(job: Job, directory: Path, say: Say, ask: Ask) -> list[tuple[Condition, Path, Path]]:
    """Run the experiments that are missing: for each condition, a record to fit and one to validate with."""
    found = []
    for condition in job.conditions:
        paths = [directory / f"{condition.name}-{seed}.mcap" for seed in (ESTIMATION_SEED, VALIDATION_SEED)]
        missing = [path for path in paths if not path.exists()]
        if missing and job.bus is not None:
            _show([*_collect_command(job, condition, ESTIMATION_SEED), "--dry-run"])
            ask(f"Condition {condition.name}. {condition.instruction} Then {job.axis} will be excited.")
        for path, seed in zip(paths, (ESTIMATION_SEED, VALIDATION_SEED), strict=True):
            if path in missing:
                say(f"{condition.name}: exciting {job.axis}, {job.duration_s:g} s, seed {seed}")
                _experiment(path, _collect_command(job, condition, seed))
            else:
                say(f"{condition.name}: {path.name} is there already")
        found.append((condition, paths[0], paths[1]))
    return found


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
            conditions=fitted.conditions,
            recording=fitted.sha256,
        )
        path = directory / f"{condition.name}.plant.json"
        path.write_text(to_json(plant), encoding="utf-8")
        say(f"{condition.name}: {job.structure}, fit {identification.fit_percent:.2f} % on the other record")
        models.append(Model(condition, plant, identification, path))
    return models


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
    from hil.views.summary import StepResponse, summarise

    found = []
    for model in models:
        condition = model.condition
        # Named after the controller, so that a step with an earlier one is not taken for it.
        path = directory / f"{condition.name}-step-{_digest(controller)}.mcap"
        if not path.exists():
            if job.bus is not None:
                what = f"Then the new controller will step {job.axis}."
                ask(f"Condition {condition.name}. {condition.instruction} {what}")
            say(f"{condition.name}: stepping {job.axis} with the new controller")
            _experiment(path, _step_command(job, model, requirements, controller))
        measured = summarise(open_recording(path)).axes[job.axis]
        if not isinstance(measured, StepResponse):
            raise HilError(f"{path}: no step response of {job.axis} can be read from it")
        found.append(Verified(condition, path, measured, failures(measured, requirements)))
    return found


def default_design() -> DesignFile:
    """Return the requirements of a tuning without a design file: those of the paper."""
    from design.synthesis.design_file import DesignFile

    return DesignFile()


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:8]


def _collect_command(job: Job, condition: Condition, seed: int) -> list[str]:
    return [
        "collect",
        "--axis",
        job.axis,
        "--amplitude",
        repr(job.amplitude),
        "--duration",
        repr(job.duration_s),
        f"--centre={condition.centre!r}",
        "--seed",
        str(seed),
        *([] if job.controller is None else ["--controller", f"{job.axis}={job.controller}"]),
        *_where(job, condition),
    ]


def _step_command(job: Job, model: Model, requirements: DesignFile, controller: Path) -> list[str]:
    from hil.shells.run_setup import load_rig

    axes = load_rig(job.rig).axes
    half = 0.5 * (job.step if job.step is not None else DEFAULT_STEP[model.plant.output_unit])
    settling = requirements.specifications.settling_s or 2.0
    low, high = model.condition.centre - half, model.condition.centre + half
    rest_s = round(SETTLE_S + settling, 3)
    setpoints = [f"{job.axis}=ladder:{low!r},{high!r}@0/{rest_s!r}"]
    setpoints += [f"{name}=hold" for name in axes if name != job.axis]
    return [
        "run",
        "--controller",
        f"{job.axis}={controller}",
        "--duration",
        repr(round(rest_s + 3.0 * settling + 2.0, 3)),
        *(part for setpoint in setpoints for part in ("--setpoint", setpoint)),
        *_where(job, model.condition),
    ]


def _where(job: Job, condition: Condition) -> list[str]:
    """Return the options that choose rig and bus."""
    rig = [] if job.rig is None else ["--rig", job.rig]
    if job.bus is None:
        return [*rig, "--lockstep", *(part for event in condition.events for part in ("--event", event))]
    return [*rig, "--bus", job.bus]


def _experiment(path: Path, command: list[str]) -> None:
    """Run a command that writes a recording, under a temporary name until it is complete.

    Raises HilError with what the command said where it failed.
    """
    partial = path.with_name(f"partial-{path.name}")
    plot = partial.with_suffix(".png")
    for left in (partial, plot):
        left.unlink(missing_ok=True)
    target = ["-o" if command[0] == "collect" else "--record", str(partial)]
    yes = ["--yes"] if command[0] == "collect" else []
    status, said = _run([*command, *target, *yes], captured="--lockstep" in command)
    if status != 0:
        raise ExperimentError(
            f"`hil {' '.join(command)}` ended with exit status {status}; its recording is {partial}"
            + (f":\n{said}" if said else "")
        )
    if plot.exists():
        plot.rename(path.with_suffix(".png"))
    partial.rename(path)


def _show(command: list[str]) -> None:
    """Run a command that moves nothing, with its output on the terminal. Raises ExperimentError."""
    status, _ = _run(command, captured=False)
    if status != 0:
        raise ExperimentError(
            f"`hil {' '.join(command)}` failed with exit status {status}; nothing was moved"
        )


def _run(command: list[str], *, captured: bool) -> tuple[int, str]:
    """Run a command of hil. Return its exit status and what it said, if that was captured.

    If this program is interrupted or terminated, the command is ended first, so that it centres the valves.
    """
    # -P: modules in the working directory are not imported.
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "hil.cli", *command],
        stdout=subprocess.PIPE if captured else None,
        stderr=subprocess.PIPE if captured else None,
        text=True,
    )
    try:
        out, err = process.communicate()
    except BaseException:
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.communicate(timeout=END_TIMEOUT_S)
        raise
    return process.returncode, (err or out or "").strip()
