"""``hil collect``: excite one axis and record it, as data for ``hil identify``.

The experiment goes through the same core as every run: guards, limits, life cycle, recorder. Before anything
moves, the spectrum of the excitation is shown, and a lockstep run on the simulated arm predicts the travel.
"""

from __future__ import annotations

import argparse
import shlex
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from firmware_sim.plant_options import add_plant_options, check_plant_options
from firmware_sim.simulated_plant import plant_texts
from hil.cli.axis_values import by_axis
from hil.cli.launch import run_lockstep, run_realtime
from hil.cli.record_path import create_folder_of, recording_path
from hil.cli.run import chosen_bus, duration_argument
from hil.cli.run_parts import SIMULATED
from hil.core.check_names import check_overrides
from hil.core.documents import to_json
from hil.core.errors import DocumentError, HilError
from hil.core.excitation import KINDS, Signal, read_table, samples
from hil.core.experiment import MAX_PAUSE_S, Experiment, Origins, check_experiment
from hil.core.experiment import NAME as EXPERIMENT_NAME
from hil.core.phase import Phase
from hil.core.rig import Rig
from hil.core.setpoints import HOLD
from hil.core.suggestions import did_you_mean
from hil.host.command_parser import CommandParser, add_override_option, number
from hil.host.text_file import MAX_TABLE_BYTES, read_text
from hil.live.address import add_page_options, check_page_options
from hil.shells.real_bus import check_interface
from hil.shells.run_plan import Ending, RunPlan
from hil.shells.run_setup import RunSetup, load_rig, load_setup

if TYPE_CHECKING:
    from rich.console import Console

    from hil.recording.recorder import RecorderReport
    from hil.recording.tables import BoolArray, IntArray

DESCRIPTION = """\
Excite one axis and record it, as data for `hil identify`. The axis is first brought to its centre by its
controller, and the valve voltage at which it stands still is measured. The other axes are held where they
are. Exit status: 0 if the whole excitation was given and recorded, 1 if not, 2 if the arguments or files are
wrong, 130 if it was interrupted: then the recording is incomplete."""
EPILOG = """\
excitations, with the options that belong to each:
  prbs       pseudo-random sequence of 2, 3, 5 or 7 levels
             --amplitude --duration --clock --levels --seed
  multisine  sines on all lines of a band
             --amplitude --duration --band --repetitions --phases --seed
  chirp      a sine that sweeps over a band once
             --amplitude --duration --band --sweep
  steps      +amplitude, 0, -amplitude, 0, and again
             --amplitude --duration --hold
  csv:FILE   columns time_s,value; each value is held until the next row

Amplitudes are in V about the valve's centre, or in the axis' unit with --excite setpoint.

A position beyond the travel fence (rig file: fence_min_y, fence_max_y) takes the axis back under its
controller. The excitation goes on when the axis is back in the centre.
"""
FIELDS = {
    "amplitude": "amplitude",
    "duration": "duration_s",
    "clock": "clock_periods",
    "levels": "levels",
    "repetitions": "repetitions",
    "phases": "phases",
    "sweep": "sweep",
    "hold": "hold_s",
}
"""Option of the command to field of the excitation's document."""
DEFAULTS = {"amplitude": 0.4, "duration_s": 60.0}
"""±0.4 V: less drowns in the friction of the simulated arm, more reaches its stops."""
SECOND_RECORD = "SECOND.mcap"
SECOND_RECORD_NOTE = (
    "a second recording of hil collect, such as with another --seed; without --validate, the last third of "
    "this one is kept from the fit"
)
MODES = {"valve": "open loop", "controller": "controller output", "setpoint": "setpoint"}
MAX_PAUSE_FACTOR = 5.0
"""The fence may lengthen an experiment to this many times its duration before the run is ended."""


@dataclass(frozen=True)
class Collected:
    """What a run of an experiment gave."""

    excited: int
    """Samples under excitation."""
    gaps: int
    """Periods under excitation without a good sample: none came, or the sample guard rejected it."""
    rejected: int
    """Frames that the gateway rejected in the whole run, as sample or otherwise."""
    lowest: float
    """Lowest position of the whole experiment in the axis' unit, with the paths to and from the centre."""
    highest: float
    fence_crossings: int
    offset_v: float
    is_complete: bool
    """True if all of the excitation was given."""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil collect``."""
    command = CommandParser(prog="hil collect", description=DESCRIPTION, epilog=EPILOG)
    command.add_argument("--axis", required=True, metavar="AXIS", help="axis to excite")
    command.add_argument("--excitation", default="prbs", metavar="KIND", help="see below (default prbs)")
    command.add_argument("--amplitude", type=number, metavar="V", help="largest deviation (default 0.4)")
    command.add_argument(
        "--duration", type=duration_argument, metavar="S", help="seconds of excitation (default 60)"
    )
    command.add_argument(
        "--clock", type=int, metavar="N", help="periods between changes of a prbs (default 12)"
    )
    command.add_argument("--levels", type=int, metavar="N", help="levels of a prbs: 2, 3, 5 or 7 (default 2)")
    command.add_argument("--band", metavar="LOW:HIGH", help="band in rad/s (default 0.2:40)")
    command.add_argument(
        "--repetitions", type=int, metavar="N", help="repetitions of a multisine (default 2)"
    )
    command.add_argument("--phases", metavar="KIND", help="phases of a multisine: schroeder or random")
    command.add_argument("--sweep", metavar="KIND", help="sweep of a chirp: logarithmic or linear")
    command.add_argument("--hold", type=number, metavar="S", help="seconds that a step is held (default 2)")
    command.add_argument(
        "--excite",
        choices=tuple(MODES),
        default="valve",
        help="valve: open loop; controller: added to its output; setpoint: added to it (default valve)",
    )
    command.add_argument(
        "--centre", type=number, default=0.0, metavar="Y", help="position to excite about (default 0)"
    )
    command.add_argument(
        "--settle", type=number, default=4.0, metavar="S", help="seconds at rest before (default 4)"
    )
    command.add_argument("--rig", type=Path, metavar="FILE", help="rig file (default: the shipped example)")
    command.add_argument(
        "--controller",
        action="append",
        default=[],
        metavar="AXIS=FILE",
        help="controller of an axis instead of the rig file's; may be repeated",
    )
    where = command.add_mutually_exclusive_group()
    where.add_argument("--bus", metavar="BUS", help="bus of the boards instead of the rig file's")
    where.add_argument("--lockstep", action="store_true", help="simulated boards in simulated time")
    command.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="recording (default runs/<date>-<time>.mcap)"
    )
    command.add_argument("--dry-run", action="store_true", help="show spectrum and predicted travel, and end")
    command.add_argument("--yes", action="store_true", help="do not ask before a real axis moves")
    add_override_option(command)
    add_plant_options(command)
    add_page_options(command)
    return command


def main(argv: list[str]) -> int:
    """Run ``hil collect`` with ``argv``; return its exit status. Raises HilError for wrong input."""
    from rich.console import Console

    from hil.views.excitation_summary import excitation_summary, loop_crossover

    options = parser().parse_args(argv)
    check_plant_options(options)
    check_page_options(options)
    console = Console(highlight=False, soft_wrap=True, markup=False)
    rig = load_rig(options.rig)
    check_overrides(options.override, rig)
    experiment = _experiment(options, rig)
    setup = _setup(options, rig, experiment)
    bus = chosen_bus(options, setup)
    if not options.dry_run:
        recording_path(options.output, experiment.duration_s(rig.loop.period_s), has_figure=False)
    period_s = rig.loop.period_s
    unit = rig.axes[experiment.axis].unit if experiment.mode == "setpoint" else "V"
    crossover = loop_crossover(setup.controllers[experiment.axis])
    values = samples(experiment.signal, period_s)
    console.print(excitation_summary(experiment.signal, values, period_s, unit, crossover))
    if not options.lockstep or options.dry_run:
        is_predicted = _print_prediction(console, setup, experiment, options)
        if not is_predicted and bus != SIMULATED:
            raise HilError("without a prediction no real axis is moved; see hil run --help")
    if options.dry_run:
        return 0
    if bus != SIMULATED and not options.yes:
        _confirm(experiment, bus)
    report, plan = _record(setup, experiment, bus, options)
    collected = read_collected(report.path, experiment)
    _print_collected(console, collected, experiment, rig)
    console.print(f"recording   {report.path}")
    if report.failure:
        console.print(f"The recording is incomplete: {report.failure}", style="red")
    if plan.ending is Ending.INTERRUPTED:
        console.print("Interrupted: the excitation was not given completely.", style="red")
        return 130
    if plan.ending is not Ending.COMPLETED or not collected.is_complete:
        console.print(f"The excitation was not given completely: {_reason(plan, collected)}.", style="red")
        return 1
    console.print(
        f"next        hil identify {shlex.quote(str(report.path))} --axis {experiment.axis} "
        f"--validate {SECOND_RECORD}"
    )
    console.print(f"            {SECOND_RECORD}: {SECOND_RECORD_NOTE}")
    return 1 if report.failure else 0


def _reason(plan: RunPlan, collected: Collected) -> str:
    """Return why an experiment ended early."""
    if plan.ending is not Ending.COMPLETED:
        return f"the run ended: {plan.ending}"
    if collected.fence_crossings:
        return f"the fence acted {collected.fence_crossings} times; reduce --amplitude, or widen the fence"
    return "the axis did not come to rest near its centre; check its controller"


def read_collected(path: Path, experiment: Experiment) -> Collected:
    """Read what an experiment gave from its recording. Raises RecordingError."""
    from hil.recording.reader import Recording

    recording = Recording(path)
    axis = recording.axis(experiment.axis)
    excited = axis["phase"] == Phase.EXCITED
    moved = axis["phase"] != Phase.NONE
    position = axis["position"][moved & axis["fresh"]]
    ending = recording.metadata.get("ending", {})
    return Collected(
        excited=int((excited & axis["fresh"]).sum()),
        gaps=_gaps(recording.timing().number, excited, axis["fresh"]),
        rejected=int(ending.get("rejected frames", "0")),
        lowest=float(position.min()) if len(position) else float("nan"),
        highest=float(position.max()) if len(position) else float("nan"),
        fence_crossings=int(ending.get("fence crossings", "0")),
        offset_v=float(ending.get("valve offset, V", "0")),
        is_complete=ending.get("experiment", "") == "complete",
    )


def _gaps(number: IntArray, excited: BoolArray, fresh: BoolArray) -> int:
    """Count periods under excitation without a good sample, with those that the gateway missed altogether."""
    missed = (np.diff(number) - 1)[excited[:-1] & excited[1:]]
    return int(np.count_nonzero(excited & ~fresh) + missed.sum())


def _experiment(options: argparse.Namespace, rig: Rig) -> Experiment:
    """Build the experiment that the options ask for. Raises DocumentError naming the option."""
    if options.axis not in rig.axes:
        raise DocumentError(
            f"--axis {options.axis}: the axes of the rig are {', '.join(rig.axes)}"
            f"{did_you_mean(options.axis, rig.axes)}"
        )
    if not 0.0 < options.settle <= MAX_PAUSE_S:
        raise DocumentError(f"--settle {options.settle:g}: must be over 0 s and at most {MAX_PAUSE_S:g} s")
    experiment = Experiment(
        format="hil-experiment",
        version=1,
        axis=options.axis,
        mode=MODES[options.excite],  # type: ignore[arg-type]  # argparse allows the keys of MODES only
        signal=_signal(options),
        centre=options.centre,
        settle_s=options.settle,
    )
    kind = options.excitation.partition(":")[0]
    signal = f"--excitation {options.excitation}" if kind == "csv" else "--amplitude"
    check_experiment(experiment, rig, Origins("--axis", "--centre", signal))
    return experiment


def _signal(options: argparse.Namespace) -> Signal:
    """Build the excitation. Raises DocumentError for an option that does not belong to its kind."""
    kind, _, file = options.excitation.partition(":")
    if kind not in KINDS:
        raise DocumentError(
            f"--excitation {options.excitation}: must be one of prbs, multisine, chirp, steps, csv:FILE"
            f"{did_you_mean(kind, KINDS)}"
        )
    given: dict[str, Any] = {
        field: getattr(options, option)
        for option, field in FIELDS.items()
        if getattr(options, option) is not None
    }
    if options.band is not None:
        given["low_rad_s"], given["high_rad_s"] = _band(options.band)
    if kind == "csv":
        if given:
            raise DocumentError(
                f"--excitation csv: --{_option(next(iter(given)))} does not belong to it: the file says all"
            )
        if not file:
            raise DocumentError("--excitation csv: the file is missing; write --excitation csv:FILE")
        return read_table(read_text(Path(file), MAX_TABLE_BYTES), file)
    document = KINDS[kind]
    fields = {field.name for field in msgspec.structs.fields(document)}
    for field in given:
        if field not in fields:
            raise DocumentError(
                f"--{_option(field)} does not belong to --excitation {kind}; see hil collect --help"
            )
    if "seed" in fields:
        given["seed"] = options.seed
    try:
        return msgspec.convert({"kind": kind, **DEFAULTS, **given}, document)  # type: ignore[return-value]
    except msgspec.ValidationError as error:
        raise DocumentError(f"--excitation {kind}: {_in_options(str(error))}") from None


def _in_options(problem: str) -> str:
    """Return msgspec's problem with the option in place of the field's path."""
    text, _, path = problem.partition(" - at `$.")
    field = path.rstrip("`")
    return f"--{_option(field)}: {text[:1].lower()}{text[1:]}" if field else text


def _option(field: str) -> str:
    """Return the option that sets a field."""
    names = {field: option for option, field in FIELDS.items()}
    return names.get(field, "band")


def _band(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise DocumentError(f"--band {text}: must be two frequencies in rad/s, such as 0.2:40") from None
    return low, high


def _setup(options: argparse.Namespace, rig: Rig, experiment: Experiment) -> RunSetup:
    """Read the setup of the run: the axes that are not excited keep their positions."""
    controllers = by_axis("--controller", options.controller, "vertical=ppid")
    texts = {EXPERIMENT_NAME: to_json(experiment)}
    return load_setup(options.rig, controllers, dict.fromkeys(rig.axes, HOLD), texts)


def _record(
    setup: RunSetup, experiment: Experiment, bus: str, options: argparse.Namespace
) -> tuple[RecorderReport, RunPlan]:
    if bus == SIMULATED:
        setup = replace(setup, texts={**setup.texts, **plant_texts(setup.rig, options)})
    nominal_s = experiment.duration_s(setup.rig.loop.period_s)
    limit_s = MAX_PAUSE_FACTOR * nominal_s
    plan = RunPlan(limit_s, setup.rig.loop.period_s, overrides=options.override)
    path = recording_path(options.output, nominal_s, has_figure=False)
    create_folder_of(path)
    if options.lockstep:
        return run_lockstep(setup, plan, path, nominal_s, options), plan
    return run_realtime(setup, plan, path, bus, options), plan


def _print_prediction(
    console: Console, setup: RunSetup, experiment: Experiment, options: argparse.Namespace
) -> bool:
    """Run the experiment in lockstep on the simulated arm, and print the travel. Return whether it is known.

    Raises KeyboardInterrupt if the user interrupted it.
    """
    with tempfile.TemporaryDirectory() as folder:
        dry = argparse.Namespace(
            **{**vars(options), "lockstep": True, "output": Path(folder) / "dry-run.mcap"}
        )
        try:
            report, plan = _record(setup, experiment, SIMULATED, dry)
            if plan.ending is Ending.INTERRUPTED:
                raise KeyboardInterrupt
            predicted = read_collected(report.path, experiment)
        except HilError as error:
            console.print(f"prediction  not possible: {error}", style="yellow")
            return False
    text, stays = _travel_text(predicted, experiment, setup.rig)
    console.print(f"prediction  simulated arm: {text}", style=None if stays else "yellow")
    if not predicted.is_complete:
        reason = _reason(plan, predicted)
        console.print(f"prediction  the excitation would not be given completely: {reason}", style="yellow")
    return True


def _print_collected(console: Console, collected: Collected, experiment: Experiment, rig: Rig) -> None:
    text, stays = _travel_text(collected, experiment, rig)
    console.print(f"travel      {text}", style=None if stays else "yellow")
    if experiment.mode == "open loop":
        centre_v = rig.axes[experiment.axis].valve.centre_v
        console.print(
            f"offset      {collected.offset_v:+.3f} V about {centre_v:g} V: with it the axis stands still"
        )
    console.print(_samples_text(collected))


def _samples_text(collected: Collected) -> str:
    """Return how many samples were excited, and what was lost of them."""
    text = f"samples     {collected.excited} excited, {collected.gaps} periods without a good sample"
    if not collected.rejected:
        return text
    return f"{text}; {collected.rejected} frames rejected in the whole run (see the log in the recording)"


def _travel_text(collected: Collected, experiment: Experiment, rig: Rig) -> tuple[str, bool]:
    """Return the travel in words, and whether the axis stayed within its fence."""
    axis = rig.axes[experiment.axis]
    low, high = axis.fence_limits
    scale, unit = (1000.0, "mm") if axis.unit == "m" else (1.0, axis.unit)
    moved = f"{scale * collected.lowest:.3g} to {scale * collected.highest:.3g} {unit}"
    fence = f"the fence at {scale * low:.3g} and {scale * high:.3g} {unit}"
    if collected.excited == 0:
        return f"no sample of {experiment.axis} was excited", False
    if collected.fence_crossings == 0:
        return f"{experiment.axis} moves from {moved}, inside {fence}", True
    return f"{experiment.axis} moves from {moved}; {fence} acts {collected.fence_crossings} times", False


def _confirm(experiment: Experiment, bus: str) -> None:
    """Ask before a real axis moves. Raises HilError without a yes."""
    check_interface(bus)
    if not sys.stdin.isatty():
        raise HilError(
            f"{bus} is a real bus and there is no terminal to ask on; give --yes to move {experiment.axis}"
        )
    sys.stdout.write(
        f"{experiment.axis} on {bus} will move as predicted. Is its range free of people? Type yes: "
    )
    sys.stdout.flush()
    if sys.stdin.readline().strip().lower() != "yes":
        raise HilError("not confirmed; nothing was moved")
