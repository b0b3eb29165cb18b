"""Export a recording to a file of another format."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple, TypeVar

from hil.conversion import frame_files, signal_files
from hil.conversion.frames import bus_frames, frame_rows
from hil.conversion.output_file import new_file
from hil.conversion.signals import Selection, columns_of, signal_blocks
from hil.core.errors import RecordingError
from hil.recording.reader import Recording

Item = TypeVar("Item")


class Format(StrEnum):
    """Format of an exported file, as ``hil export --to`` names it."""

    CSV = "csv"
    PARQUET = "parquet"
    MAT = "mat"
    MF4 = "mf4"
    CANDUMP = "candump"
    ASC = "asc"
    BLF = "blf"
    MF4_BUS = "mf4-bus"

    @property
    def suffix(self) -> str:
        """Suffix of a file of this format."""
        return {Format.CANDUMP: ".log", Format.MF4_BUS: ".mf4"}.get(self, f".{self.value}")

    @property
    def has_frames(self) -> bool:
        """True for the formats of CAN frames, False for those of signals."""
        return self in (Format.CANDUMP, Format.ASC, Format.BLF, Format.MF4_BUS)


class Exported(NamedTuple):
    """Result of an export."""

    path: Path
    """File that was written."""
    length: int
    """Number of rows or frames in the file."""
    unit: str
    """Kind of what was counted: periods, rows, or frames."""


def export(
    recording: Recording,
    path: Path,
    file_format: Format,
    selection: Selection,
    *,
    force: bool = False,
    watch: Callable[[float], None] = lambda time_s: None,
) -> Exported:
    """Write the selected signals or frames to ``path``; the file appears when it is whole.

    ``watch`` is called now and then with the time that has been written, in seconds from the first recorded
    period. Raises RecordingExistsError, EnvironmentLackError, and RecordingError when the file cannot be
    written or nothing is selected.
    """
    with new_file(path, force=force, source=recording.path) as temporary:
        if file_format.has_frames:
            write, unit = _write_frames, "frames"
        else:
            write, unit = _write_signals, "periods" if selection.resample_s is None else "rows"
        length = write(recording, temporary, file_format, selection, watch)
        if length == 0:
            raise RecordingError(_nothing_selected(recording, selection, unit))
    return Exported(path, length, unit)


def _write_signals(
    recording: Recording,
    path: Path,
    file_format: Format,
    selection: Selection,
    watch: Callable[[float], None],
) -> int:
    columns = columns_of(recording, selection)
    blocks = _watched(signal_blocks(recording, selection), lambda block: block["time_s"][-1], watch)
    write = {
        Format.CSV: signal_files.write_csv,
        Format.PARQUET: signal_files.write_parquet,
        Format.MAT: signal_files.write_mat,
        Format.MF4: signal_files.write_mf4,
    }[file_format]
    return write(path, columns, blocks)


def _nothing_selected(recording: Recording, selection: Selection, unit: str) -> str:
    if selection.from_s is None and selection.to_s is None:
        return f"{recording.path}: has no {unit}, so there is nothing to export"
    begin = "the begin" if selection.from_s is None else f"{selection.from_s:g} s"
    end = "the end" if selection.to_s is None else f"{selection.to_s:g} s"
    return (
        f"{recording.path}: has no {unit} from {begin} to {end}; it lasts from 0 to "
        f"{recording.duration_s:.3f} s; choose --from and --to within them"
    )


def _write_frames(
    recording: Recording,
    path: Path,
    file_format: Format,
    selection: Selection,
    watch: Callable[[float], None],
) -> int:
    zero_ns = recording.start_ns + recording.epoch_offset_ns
    if file_format is Format.MF4_BUS:
        return frame_files.write_mf4_bus(path, frame_rows(recording, selection))
    frames = _watched(
        bus_frames(recording, selection), lambda frame: (frame.epoch_ns - zero_ns) * 1e-9, watch, every=20_000
    )
    if file_format is Format.CANDUMP:
        return frame_files.write_candump(path, frames, recording.bus)
    return {Format.ASC: frame_files.write_asc, Format.BLF: frame_files.write_blf}[file_format](path, frames)


def _watched(
    items: Iterable[Item], time_s: Callable[[Item], float], watch: Callable[[float], None], every: int = 1
) -> Iterator[Item]:
    """Yield the items, and report the time of every ``every``-th one."""
    for number, item in enumerate(items, 1):
        yield item
        if number % every == 0:
            watch(float(time_s(item)))
