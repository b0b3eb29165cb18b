"""``hil tune``: from experiments on the rig to a controller that was verified there, with one page."""

from __future__ import annotations

import argparse
import hashlib
import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from hil.core.errors import DocumentError, HilError
from hil.core.suggestions import did_you_mean
from hil.host.command_parser import CommandParser, add_override_option, number, seconds

if TYPE_CHECKING:
    from design.tuning import Job

SUMMARY = "collect, identify, design and verify the controller of an axis"
DESCRIPTION = """\
Tune the controller of an axis: excite it under two or more conditions, identify each, design one controller
against all models, step the axis with it, and write one page that puts specification, prediction and
measurement side by side. An interrupted tuning goes on where it stopped.
Exit status: 0 if the specifications are met on all models and on the rig, 1 if not, 2 for wrong input."""
EPILOG = """\
In lockstep, the conditions are the paper's: nominal, and 3 kg at 400 kPa. On a real bus they are a
measurement and its repetition. --conditions names a file with others:

  [[condition]]
  name = "nominal"

  [[condition]]
  name = "loaded"
  instruction = "Put 3 kg on the gripper, and set the supply to 400 kPa."
  events = ["payload:3@0", "supply-pressure:400@0"]   # the simulated arm only
"""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil tune``."""
    command = CommandParser(prog="hil tune", description=DESCRIPTION, epilog=EPILOG)
    command.add_argument("--axis", required=True, metavar="AXIS", help="axis to tune")
    command.add_argument(
        "--amplitude", type=number, default=0.4, metavar="V", help="of the excitation (default 0.4)"
    )
    command.add_argument(
        "--duration", type=seconds, default=60.0, metavar="S", help="of an experiment (default 60)"
    )
    command.add_argument(
        "--structure", default="OE(1,3,1)", metavar="TEXT", help="model structure, see hil identify"
    )
    command.add_argument("--design", metavar="FILE", help="design file (default: that of hil design --init)")
    command.add_argument("--conditions", type=Path, metavar="FILE", help="conditions, TOML, see below")
    command.add_argument(
        "--step", type=number, metavar="Y", help="step of the verification (default 0.1 m, 0.5 rad)"
    )
    command.add_argument(
        "--controller", metavar="FILE", help="controller during the experiments (rig file's)"
    )
    command.add_argument("--rig", metavar="FILE", help="rig file (default: the shipped example)")
    where = command.add_mutually_exclusive_group(required=True)
    where.add_argument("--bus", metavar="BUS", help="bus of the boards")
    where.add_argument("--lockstep", action="store_true", help="the simulated arm, in simulated time")
    command.add_argument("--out", type=Path, metavar="DIR", help="results (default tuning/AXIS)")
    command.add_argument("--yes", action="store_true", help="do not ask before each motion on a bus")
    add_override_option(command)
    return command


def main(argv: list[str]) -> int:
    """Run ``hil tune`` and return the exit status. Raises HilError where a step fails."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    options = parser().parse_args(argv)
    from design.tuning import ExperimentError

    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        return _tune(options)
    except KeyboardInterrupt:
        sys.stderr.write("hil tune: interrupted; the same command goes on from here\n")
        return 130
    except ExperimentError as error:
        sys.stderr.write(f"hil tune: {error}\n")
        return 1
    finally:
        signal.signal(signal.SIGTERM, before)


def _interrupt(*_signal: object) -> None:
    """End as Ctrl-C does, so that a running experiment centres the valves."""
    raise KeyboardInterrupt


def _tune(options: argparse.Namespace) -> int:
    from rich.console import Console

    from design import tuning
    from design.output.progress import progress_bars
    from design.output.results import write_design
    from design.output.tuning_report import print_tuning, write_tuning_report
    from hil.links.opening import check_name
    from hil.shells.real_bus import check_interface
    from hil.shells.run_setup import load_rig

    console = Console(highlight=False, soft_wrap=True, markup=False)
    axes = load_rig(options.rig).axes
    if options.axis not in axes:
        raise DocumentError(
            f"--axis {options.axis}: the axes of the rig are {', '.join(axes)}"
            f"{did_you_mean(options.axis, axes)}"
        )
    job = _job(options)
    tuning.check(job)
    _check_terminal(options)
    if job.bus is not None and job.bus != "sim":
        check_name(job.bus)
        check_interface(job.bus)
    directory: Path = options.out or Path("tuning") / job.axis
    resumed = tuning.claim_folder(directory, job)

    def say(text: str) -> None:
        console.print(text)

    def ask(question: str) -> None:
        if not options.yes:
            _confirm(question)

    if resumed:
        say(f"{directory}: going on with an earlier tuning")
    records = tuning.collect(job, directory, say, ask)
    models = tuning.identify(job, records, directory, say)
    settling_s = None
    for attempt in range(1, tuning.MAX_VERIFICATIONS + 1):
        with progress_bars() as on_progress:
            design, requirements = tuning.design(job, models, say, on_progress, settling_s)
        written = write_design(design, directory / "design", keeps_earlier=False)
        if written.controller is None:
            raise HilError(
                f"no controller was written: its loop is unstable on the rig; see {written.report}"
            )
        controller_file = written.controller
        verified = tuning.verify(job, models, requirements, controller_file, directory, say, ask)
        failures = [failure for step in verified for failure in step.failures]
        if job.design is not None or not failures or attempt == tuning.MAX_VERIFICATIONS:
            break
        settling_s = tuning.longer_settling(requirements)
        say(f"the measured steps miss the specifications ({'; '.join(failures)}); trying {settling_s:g} s")
    requested = None if job.design is not None else tuning.default_design().specifications.settling_s
    result = tuning.Tuning(
        job, tuple(models), requirements, requested, design, controller_file, tuple(verified)
    )
    report = directory / "tuning.html"
    write_tuning_report(result, report)
    print_tuning(console, result)
    console.print(f"report      {report}")
    console.print(f"controller  {controller_file}")
    return 0 if result.is_stable_on_all and result.meets_specifications else 1


def _job(options: argparse.Namespace) -> Job:
    from design import tuning

    if options.conditions is not None:
        conditions = tuning.read_conditions(options.conditions)
    else:
        conditions = list(tuning.SIMULATED_CONDITIONS if options.lockstep else tuning.REAL_CONDITIONS)
    return tuning.Job(
        axis=options.axis,
        amplitude=options.amplitude,
        duration_s=options.duration,
        structure=options.structure,
        conditions=conditions,
        rig=options.rig,
        bus=options.bus,
        design=options.design,
        step=options.step,
        controller=options.controller,
        overrides=options.override,
        digests={
            name: hashlib.sha256(Path(name).read_bytes()).hexdigest()
            for name in (options.rig, options.controller, options.design)
            if name is not None and Path(name).is_file()
        },
    )


def _check_terminal(options: argparse.Namespace) -> None:
    """Raise HilError if questions must be asked on a bus, and there is no terminal for them."""
    if options.bus is not None and not options.yes and not sys.stdin.isatty():
        raise HilError(
            f"each motion on {options.bus} must be confirmed, and there is no terminal to ask on; give --yes "
            f"to move {options.axis} without questions"
        )


def _confirm(question: str) -> None:
    """Ask for a yes. Raises HilError without one."""
    sys.stdout.write(f"{question} Type yes: ")
    sys.stdout.flush()
    if sys.stdin.readline().strip().lower() != "yes":
        raise HilError("not confirmed; nothing more is moved. The same command goes on from here")
