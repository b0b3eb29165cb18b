"""Exported signals, read back by readers that are not ours: pandas, pyarrow, scipy, asammdf."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import asammdf
import numpy as np
import pandas
import pytest
from numpy.typing import NDArray
from pyarrow import parquet
from scipy.io import loadmat

from hil.conversion.export import Exported, Format, export
from hil.conversion.frames import bus_frames
from hil.conversion.signals import Selection, columns_of, signal_blocks
from hil.core.errors import EnvironmentLackError, RecordingError
from hil.recording.reader import Recording

WHOLE = Selection()
SIGNALS = {
    "setpoint_{unit}": "setpoint",
    "position_{unit}": "position",
    "error_{unit}": "error",
    "output_v": "output_v",
    "command_v": "command_v",
    "potentiometer_v": "potentiometer_v",
    "phase": "phase",
}


def exported(run: Recording, folder: Path, kind: Format, selection: Selection = WHOLE) -> Path:
    path = folder / f"out{kind.suffix}"
    length = len(next(signal_blocks(run, selection))["time_s"])
    assert export(run, path, kind, selection) == Exported(path, length, "periods")
    return path


def expected(run: Recording) -> dict[str, NDArray[np.float64]]:
    """Every exported column of a run, taken from the reader."""
    first = run.axis("vertical")
    columns = {
        "time_s": first.time_s,
        "epoch_ns": first.time_ns + run.epoch_offset_ns,
        "state": first.state,
        "fresh": first.fresh,
        "running": first.running,
    }
    for axis, unit in run.axes.items():
        table = run.axis(axis)
        columns |= {f"{axis}.{name.format(unit=unit)}": table[key] for name, key in SIGNALS.items()}
    return columns


def test_csv_read_by_pandas_is_exact(run: Recording, tmp_path: Path) -> None:
    table = pandas.read_csv(exported(run, tmp_path, Format.CSV))
    columns = expected(run)
    assert list(table.columns) == list(columns)
    for name, values in columns.items():
        assert np.array_equal(table[name].to_numpy().astype(values.dtype), values, equal_nan=True), name


def test_parquet_read_by_pyarrow_is_exact_and_has_units(run: Recording, tmp_path: Path) -> None:
    table = parquet.read_table(exported(run, tmp_path, Format.PARQUET))
    columns = expected(run)
    assert table.column_names == list(columns)
    for name, values in columns.items():
        read = table[name].to_numpy()
        assert read.dtype == values.dtype
        assert np.array_equal(read, values), name
    assert table.schema.field("rotation.position_rad").metadata == {b"unit": b"rad"}
    assert table.schema.field("vertical.command_v").metadata == {b"unit": b"V"}
    assert table.schema.field("fresh").metadata is None


def test_mat_read_by_scipy_is_exact_and_has_units(run: Recording, tmp_path: Path) -> None:
    content = loadmat(exported(run, tmp_path, Format.MAT), simplify_cells=True)
    for name, values in expected(run).items():
        axis, _, signal = name.rpartition(".")
        read = content[axis][signal] if axis else content[signal]
        assert np.array_equal(read, values), name
    assert content["units"]["rotation"]["position_rad"] == "rad"
    assert content["units"]["vertical"]["output_v"] == "V"


def test_mf4_read_by_asammdf_is_exact_and_has_units(run: Recording, tmp_path: Path) -> None:
    with asammdf.MDF(exported(run, tmp_path, Format.MF4)) as file:
        columns = expected(run)
        time_s = columns.pop("time_s")
        for name, values in columns.items():
            signal = file.get(name)
            assert np.array_equal(signal.samples, values), name
            assert np.allclose(signal.timestamps, time_s, atol=1e-12)
        assert file.get("vertical.position_m").unit == "m"
        assert file.get("rotation.command_v").unit == "V"
        assert file.header.start_time.timestamp() == pytest.approx(columns["epoch_ns"][0] / 1e9, abs=1e-5)


STATES = {0: "offline", 1: "ready", 2: "armed", 3: "running", 4: "fault"}
PHASES = {0: "none", 1: "approach", 2: "settle", 3: "excited", 4: "recover", 5: "return", 6: "done"}


def test_parquet_has_the_names_of_states_and_phases(run: Recording, tmp_path: Path) -> None:
    schema = parquet.read_schema(exported(run, tmp_path, Format.PARQUET))
    for column, names in (("state", STATES), ("vertical.phase", PHASES)):
        read = json.loads(schema.field(column).metadata[b"names"])
        assert read == {str(value): name for value, name in names.items()}


def test_mat_has_the_numbers_of_states_and_phases_by_name(run: Recording, tmp_path: Path) -> None:
    content = loadmat(exported(run, tmp_path, Format.MAT), simplify_cells=True)
    assert content["names"] == {
        "state": {name: value for value, name in STATES.items()},
        "phase": {name: value for value, name in PHASES.items()},
    }


def test_mf4_has_the_names_of_states_and_phases_in_comments(run: Recording, tmp_path: Path) -> None:
    with asammdf.MDF(exported(run, tmp_path, Format.MF4)) as file:
        assert file.get("state").comment == "0 offline, 1 ready, 2 armed, 3 running, 4 fault"
        assert file.get("rotation.phase").comment.startswith("0 none, 1 approach, 2 settle, 3 excited")
        assert file.get("rotation.command_v").comment == ""


def test_a_selection_of_axes_and_time(run: Recording, tmp_path: Path) -> None:
    selection = Selection(("rotation",), 0.5, 1.0)
    table = pandas.read_csv(exported(run, tmp_path, Format.CSV, selection))
    assert [name for name in table.columns if "." in name] == [
        f"rotation.{name.format(unit='rad')}" for name in SIGNALS
    ]
    recorded = run.axis("rotation")
    inside = (recorded.time_s >= 0.5) & (recorded.time_s < 1.0)
    assert np.array_equal(table["rotation.position_rad"], recorded.position[inside])


@pytest.mark.parametrize("interval_s", [0.001, 0.0112, 0.05])
def test_resampling_holds_the_last_period(run: Recording, interval_s: float) -> None:
    blocks = list(signal_blocks(run, Selection(("vertical",), 0.5, 1.5, interval_s)))
    time_s = np.concatenate([block["time_s"] for block in blocks])
    position = np.concatenate([block["vertical.position_m"] for block in blocks])
    recorded = run.axis("vertical")
    assert np.allclose(np.diff(time_s), interval_s, atol=1e-12)
    rows = np.searchsorted(recorded.time_s, time_s + 1e-9, "right") - 1
    assert np.array_equal(position, recorded.position[rows])
    assert time_s[-1] <= 1.5 < time_s[-1] + interval_s + 0.0112
    epoch_ns = np.concatenate([block["epoch_ns"] for block in blocks])
    zero_ns = run.start_ns + run.epoch_offset_ns
    assert np.allclose((epoch_ns - zero_ns) * 1e-9, time_s, atol=2e-9)


def test_columns_carry_their_units(run: Recording) -> None:
    columns = {column.name: column.unit for column in columns_of(run, Selection(("vertical",)))}
    assert columns["time_s"] == "s"
    assert columns["vertical.position_m"] == "m"
    assert columns["vertical.potentiometer_v"] == "V"
    assert columns["vertical.phase"] == ""


@pytest.mark.parametrize(
    ("selection", "message"),
    [
        (Selection(("vertcal",)), "no axis 'vertcal'; .*did you mean vertical"),
        (Selection(from_s=90.0), r"has no periods from 90 s to the end; it lasts from 0 to 2\.\d+ s"),
        (Selection(to_s=-1.0), "has no periods from the begin to -1 s"),
    ],
)
def test_a_selection_without_content_leaves_no_file(
    run: Recording, tmp_path: Path, selection: Selection, message: str
) -> None:
    with pytest.raises(RecordingError, match=message):
        export(run, tmp_path / "out.csv", Format.CSV, selection)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("kind", "module", "extra"),
    [
        (Format.PARQUET, "pyarrow", "parquet"),
        (Format.MF4, "asammdf", "mf4"),
        (Format.MF4_BUS, "asammdf", "mf4"),
    ],
)
def test_a_missing_library_is_named_with_its_remedy(
    run: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: Format, module: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(
        EnvironmentLackError, match=rf"needs {module}; pip install 'pneumatic-hil\[{extra}\]'"
    ):
        export(run, tmp_path / "out", kind, Selection())
    assert list(tmp_path.iterdir()) == []


def test_progress_is_reported_in_seconds(run: Recording, tmp_path: Path) -> None:
    reported: list[float] = []
    export(run, tmp_path / "out.csv", Format.CSV, Selection(), watch=reported.append)
    assert reported[-1] == pytest.approx(run.axis("vertical").time_s[-1])


def test_periods_that_an_axis_lacks_are_left_out(run: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    """Messages that were dropped while recording may belong to one axis alone."""
    whole = Recording.axis
    monkeypatch.setattr(
        Recording,
        "axis",
        lambda recording, name: whole(recording, name)[3 if name == "rotation" else 0 :],
    )
    (block,) = signal_blocks(run, WHOLE)
    assert np.array_equal(block["time_s"], whole(run, "vertical").time_s[3:])
    assert np.array_equal(block["vertical.position_m"], whole(run, "vertical").position[3:])


def test_resampling_goes_on_over_the_borders_of_blocks(
    run: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    selection = Selection(("vertical",), resample_s=0.01)
    (at_once,) = signal_blocks(run, selection)
    pieces = [run.axis("vertical")[start : start + 7] for start in range(0, len(run.axis("vertical")), 7)]
    monkeypatch.setattr("hil.conversion.signals.parts", lambda *_: pieces)
    monkeypatch.setattr(type(pieces[0]), "axis", lambda table, _name: table, raising=False)
    blocks = list(signal_blocks(run, selection))
    assert len(blocks) > 20
    for name, values in at_once.items():
        assert np.array_equal(np.concatenate([block[name] for block in blocks]), values), name


@pytest.mark.parametrize("selection", [WHOLE, Selection(from_s=0.3, to_s=1.7)])
def test_ranges_that_are_read_one_at_a_time_give_the_whole(
    run: Recording, monkeypatch: pytest.MonkeyPatch, selection: Selection
) -> None:
    """Memory is bounded because no more than one range is held."""
    (at_once,) = signal_blocks(run, selection)
    frames = list(bus_frames(run, selection))
    monkeypatch.setattr("hil.conversion.signals.PART_S", 0.25)
    blocks = list(signal_blocks(run, selection))
    assert len(blocks) >= 5
    assert max(len(block["time_s"]) for block in blocks) <= 25
    for name, values in at_once.items():
        assert np.array_equal(np.concatenate([block[name] for block in blocks]), values), name
    assert list(bus_frames(run, selection)) == frames


def test_a_recording_without_an_axis_has_no_signals(run: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Recording, "axes", {})
    with pytest.raises(RecordingError, match="has no axis, so it has no signals"):
        columns_of(run, WHOLE)
