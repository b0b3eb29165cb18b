"""What a run is made of: rig, controllers and setpoints, as texts and as objects.

The texts go into the recording, and a replay builds the same gateway from them. This module reads files; it
knows no bus.
"""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from hil.core.calibration_rig import calibration_text
from hil.core.closed_loop_poles import check_closed_loop
from hil.core.control_law import ControlLaw, LawNumbers, check_law_runs, law_numbers
from hil.core.controller_change import delay_periods
from hil.core.controller_file import ControllerFile, check_controller_fits, read_controller
from hil.core.errors import DocumentError, SetpointError
from hil.core.experiment import NAME as EXPERIMENT_NAME
from hil.core.experiment import Experiment, read_experiment
from hil.core.gateway import Gateway
from hil.core.rig import AxisSettings, Rig, read_rig
from hil.core.setpoints import HOLD, Setpoint, check_speed, check_within, csv_file, parse_setpoint
from hil.core.suggestions import did_you_mean
from hil.host.controller_files import controller_path
from hil.host.text_file import MAX_TABLE_BYTES, read_text

PACKAGE = Path(__file__).parents[1]
SHIPPED = PACKAGE / "shipped"
RIG_NAME = "rig.toml"
DBC_NAME = "arm.dbc"


@dataclass(frozen=True)
class RunSetup:
    """A checked set of rig, controllers and setpoints."""

    rig: Rig
    controllers: Mapping[str, ControllerFile]
    """Controller files by axis name."""
    setpoints: Mapping[str, Setpoint]
    """Setpoints by axis name."""
    texts: Mapping[str, str]
    """Every document by its name in the recording: ``rig.toml``, ``arm.dbc``, ``controllers/<axis>.json``,
    ``setpoints/<axis>.csv``.
    """

    experiment: Experiment | None = None
    """The experiment of this run (``experiment.json``), or None."""

    def gateway(self, first_deadline_ns: int) -> Gateway:
        """Return a new gateway core in state offline."""
        laws = {
            name: ControlLaw.of_numbers(numbers, self.controllers[name].sample_time_s)
            for name, numbers in self._law_numbers.items()
        }
        failures = self.controller_failures
        return Gateway(self.rig, laws, self.setpoints, first_deadline_ns, self.experiment, failures)

    @functools.cached_property
    def controller_failures(self) -> dict[str, str]:
        """Reasons, by axis name, why a controller must not run: its closed loop is unstable.

        The texts depend on the documents alone, so that a replay has the same.
        """
        failures = {}
        for name, controller in self.controllers.items():
            try:
                check_closed_loop(controller, controller.name, delay_periods(self.rig))
            except DocumentError as error:
                failures[name] = str(error)
        return failures

    @functools.cached_property
    def _law_numbers(self) -> dict[str, LawNumbers]:
        """Numbers of the control laws by axis, which are computed once for all gateways of this setup."""
        return {name: law_numbers(c.law, c.sample_time_s) for name, c in self.controllers.items()}

    def digests(self) -> dict[str, str]:
        """Return the SHA-256 of every document, by its name."""
        return {name: hashlib.sha256(text.encode()).hexdigest() for name, text in self.texts.items()}

    def fingerprint(self) -> str:
        """Return the SHA-256 over all texts and setpoints, which is equal for equal configurations."""
        digest = hashlib.sha256()
        for name, text in sorted(self.texts.items()):
            digest.update(f"{name}\0{text}\0".encode())
        for name, setpoint in self.setpoints.items():
            digest.update(f"{name}\0{setpoint.text}\0".encode())
        return digest.hexdigest()


def load_rig(path: str | os.PathLike[str] | None = None) -> Rig:
    """Read a rig file, or the shipped one if ``path`` is None; not the files that it names.

    Raises DocumentError.
    """
    return read_rig(read_text(Path(path or SHIPPED / RIG_NAME)), str(path or RIG_NAME))


def load_controller(name: str | os.PathLike[str]) -> ControllerFile:
    """Read a controller file, or a shipped one by its name. Raises DocumentError."""
    text = os.fspath(name)
    return read_controller(read_text(controller_path(text)), text)


def load_setup(
    rig_path: Path | None,
    controllers: Mapping[str, str],
    setpoints: Mapping[str, str],
    further_texts: Mapping[str, str] | None = None,
    origins: Mapping[str, str] | None = None,
) -> RunSetup:
    """Read a rig file (the shipped one if ``rig_path`` is None) and the files that it names.

    ``controllers`` and ``setpoints``, by axis name, replace those of the rig file. What they replace is
    neither read nor checked. File names in the rig file are relative to it, others to the working directory.
    ``further_texts`` are kept with the run. ``origins`` says for errors where a replacement comes from, by
    ``controllers.<axis>`` or ``setpoints.<axis>``; without an entry it is a command-line option.

    Raises DocumentError or SetpointError.
    """
    source = rig_path or SHIPPED / RIG_NAME
    base = source.parent
    texts = {RIG_NAME: read_text(source), DBC_NAME: read_text(PACKAGE / "core" / "wire" / DBC_NAME)}
    texts |= further_texts or {}
    sources = {RIG_NAME: str(rig_path or RIG_NAME)}
    rig = read_rig(texts[RIG_NAME], sources[RIG_NAME])
    origins = origins or {}
    for option, given in (("--controller", controllers), ("--setpoint", setpoints)):
        for name in given:
            if name not in rig.axes:
                raise DocumentError(
                    f"{option} {name}=…: the axes of the rig are {', '.join(rig.axes)}"
                    f"{did_you_mean(name, rig.axes)}"
                )
    chosen: dict[str, str] = {}
    for name, axis in rig.axes.items():
        of_axis = f"{sources[RIG_NAME]}: axes.{name}"
        if name in controllers:
            origin = origins.get(f"controllers.{name}", f"--controller {name}")
            path = controller_path(controllers[name], Path(), origin)
        else:
            path = controller_path(axis.controller, base, f"{of_axis}.controller")
        document = f"controllers/{name}.json"
        texts[document], sources[document] = read_text(path), str(path)
        chosen[name] = setpoints.get(name, axis.setpoint)
        sources[f"setpoints.{name}"] = (
            origins.get(f"setpoints.{name}", f"--setpoint {name}")
            if name in setpoints
            else f"{of_axis}.setpoint"
        )
        file = csv_file(chosen[name])
        if file is not None:
            path = Path(file) if name in setpoints else base / file
            texts[f"setpoints/{name}.csv"] = read_text(path, MAX_TABLE_BYTES)
    return setup_from_texts(texts, chosen, sources)


def setup_from_texts(
    texts: Mapping[str, str], setpoints: Mapping[str, str], sources: Mapping[str, str] | None = None
) -> RunSetup:
    """Build and check a setup from its documents, as a recording holds them.

    ``sources`` says for errors which files the documents were read from, and where each setpoint
    (``setpoints.vertical``) is written. Without an entry, the document's own name is used.
    Raises DocumentError or SetpointError.
    """
    sources = sources or {}
    rig = read_rig(_document(texts, RIG_NAME), sources.get(RIG_NAME, RIG_NAME))
    files: dict[str, ControllerFile] = {}
    parsed: dict[str, Setpoint] = {}
    for name, axis in rig.axes.items():
        document = f"controllers/{name}.json"
        source = f"{name}: {sources.get(document, document)}"
        files[name] = controller = read_controller(_document(texts, document), source)
        check_controller_fits(controller, source, rig.loop.period_s, axis.unit)
        check_law_runs(controller.law, controller.sample_time_s, source)
        if name not in setpoints:
            raise SetpointError(f"no setpoint for axis {name}")
        has_table = csv_file(setpoints[name]) is not None
        table = _document(texts, f"setpoints/{name}.csv") if has_table else ""
        origin = sources.get(f"setpoints.{name}", f"setpoints.{name}")
        parsed[name] = _setpoint(setpoints[name], table, name, axis, origin)
    experiment = read_experiment(texts[EXPERIMENT_NAME], rig) if EXPERIMENT_NAME in texts else None
    return RunSetup(rig, files, parsed, dict(texts), experiment)


def _setpoint(text: str, table: str, name: str, axis: AxisSettings, origin: str) -> Setpoint:
    """Read a setpoint and check it against its axis. Raises SetpointError."""
    try:
        setpoint = parse_setpoint(text, table)
        check_within(setpoint, name, axis.min_y, axis.max_y, axis.unit)
        check_speed(setpoint, name, axis.limits.max_speed, axis.unit)
    except SetpointError as error:
        problem = str(error).removeprefix(f"{name}: ")  # The origin names the axis.
        raise SetpointError(f"{origin}: {problem}") from None
    return setpoint


def unusable_setpoints(rig_path: Path | None, setup: RunSetup) -> Iterator[str]:
    """Yield what is wrong with setpoints of the rig file for axes that hold their positions in ``setup``.

    `hil run` and `hil rig --check` refuse such a file.
    """
    source = rig_path or SHIPPED / RIG_NAME
    for name, axis in setup.rig.axes.items():
        if setup.setpoints[name].text != HOLD:
            continue
        file = csv_file(axis.setpoint)
        try:
            table = "" if file is None else read_text(source.parent / file, MAX_TABLE_BYTES)
            _setpoint(axis.setpoint, table, name, axis, f"{rig_path or RIG_NAME}: axes.{name}.setpoint")
        except (DocumentError, SetpointError) as error:
            yield str(error)


def calibration_setup(setup: RunSetup, axis: str, source: str) -> RunSetup:
    """Return ``setup`` with the limits of ``axis`` widened for its calibration.

    ``source`` names the rig file in errors. Raises DocumentError.
    """
    text = calibration_text(setup.texts[RIG_NAME], axis, source)
    setpoints = {name: setpoint.text for name, setpoint in setup.setpoints.items()}
    return setup_from_texts({**setup.texts, RIG_NAME: text}, setpoints, {RIG_NAME: source})


def _document(texts: Mapping[str, str], name: str) -> str:
    if name not in texts:
        raise DocumentError(f"{name} is missing; the gateway cannot be built without it")
    return texts[name]
