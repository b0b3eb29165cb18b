"""The files of one run as one: the recorder may begin a new file in the course of a run.

Each file names the run and its place in it in the metadata ``recording`` (``rotation_names``): ``run id`` and
``part``. The first files of a long run may have been removed to make room, so the parts may begin with any
number, but none may be missing among them.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from mcap.records import Channel

from hil.core.errors import RecordingError
from hil.recording.mcap_chunks import Offsets
from hil.recording.mcap_reader import Columns, McapContents, Rows
from hil.recording.metadata_digests import DIGESTS, damaged_metadata
from hil.recording.rotation_names import PART, RUN_ID, STATE_NAME
from hil.recording.scan_result import NO_DATA

Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]
"""A file, a folder with the files of one run, or the files of one run."""
_COUNTS = "recorder"
"""Metadata with the numbers of messages that were recorded and dropped; they are added up over the files."""


def open_contents(given: Paths) -> McapContents | RunFiles:
    """Open the file or files of a run. Raises RecordingError."""
    paths = _paths(given)
    files = [_checked(McapContents(path), is_alone=len(paths) == 1) for path in paths]
    return files[0] if len(files) == 1 else RunFiles(files)


def _checked(file: McapContents, is_alone: bool) -> McapContents:
    """Return the file. Raises RecordingError if it was cut off, and data or recorded metadata are missing.

    Among other files of its run, a file without data is useful if it says which one it is.
    """
    if file.is_complete:
        return file
    damaged = damaged_metadata(file.metadata)
    if file.time_range_ns() is None and (is_alone or damaged or "recording" not in file.metadata):
        raise RecordingError(f"{file.path}: {NO_DATA}")
    if damaged:
        raise RecordingError(
            f"{file.path}: damaged: metadata {', '.join(damaged)} are missing or not as recorded, by their "
            f"SHA-256 in metadata {DIGESTS}; `hil recover {file.path}` saves what is whole"
        )
    return file


def _paths(given: Paths) -> list[Path]:
    if not isinstance(given, str | os.PathLike):
        paths = [Path(path) for path in given]
        if not paths:
            raise RecordingError("no file of a recording is given; name at least one")
        return paths
    path = Path(given)
    if not path.is_dir():
        return [path]
    found = sorted(path.glob("*.mcap"))
    if not found:
        raise RecordingError(f"{path}: the folder has no recording (*.mcap)")
    return found


class RunFiles:
    """The contents of several files of one run, with the interface of :class:`McapContents`.

    Documents and the metadata of the run's begin are those of the first file, and the metadata of its end are
    those of the last one. Raises RecordingError when the files do not belong to one run, or one of them is
    missing.
    """

    def __init__(self, files: Sequence[McapContents]) -> None:
        numbered = sorted((_part(file), file.path, file) for file in files)
        runs = {file.metadata["recording"][RUN_ID]: file.path for file in files}
        if len(runs) > 1:
            (_, one), (_, other), *_ = runs.items()
            raise RecordingError(
                f"{one} and {other} are of different runs (metadata recording.{RUN_ID}); open them one by one"
            )
        for (one_part, _, _), (part, path, _) in pairwise(numbered):
            if part == one_part:
                raise RecordingError(f"{path}: part {part} of its run is given twice")
            if part != one_part + 1:
                raise RecordingError(f"{path}: part {one_part + 1} of its run is missing")
        self.files = tuple(file for _, _, file in numbered)
        """The files, in the order of the run."""
        self.path = self.files[0].path
        self.attachments: dict[str, bytes] = {}
        self.metadata = _merged_metadata(self.files)
        self.channels: dict[str, Channel] = {}
        for place, file in enumerate(self.files):
            later = {name: data for name, data in file.attachments.items() if not place or name != STATE_NAME}
            self.attachments = {**later, **self.attachments}
            self._add_channels(file)
        self.is_complete = all(file.is_complete for file in self.files)

    def _add_channels(self, file: McapContents) -> None:
        for topic, channel in file.channels.items():
            known = self.channels.setdefault(topic, channel)
            if known.id != channel.id:
                raise RecordingError(f"{file.path}: {topic} has another channel id than in {self.path}")

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages, by topic."""
        total: Counter[str] = Counter()
        for file in self.files:
            total.update(file.counts)
        return {topic: total[topic] for topic in self.channels}

    def channel(self, topic: str) -> Channel:
        """Return the channel of ``topic``. Raises RecordingError when there is none."""
        return self._with(topic).channel(topic)

    def definition(self, topic: str) -> str:
        """Return the ``ros2msg`` definition of the messages of ``topic``. Raises RecordingError."""
        return self._with(topic).definition(topic)

    def chunks(self, topic: str | None = None) -> Iterator[tuple[bytes, Offsets]]:
        """Yield the chunks of all files, as :meth:`McapContents.chunks` does."""
        for file in self.files:
            if topic is None or topic in file.channels:
                yield from file.chunks(topic)

    def columns(
        self, topic: str, frame_id: str, names: Sequence[str], range_ns: tuple[int, int] | None = None
    ) -> Columns:
        """Return columns of all messages of ``topic``, as :meth:`McapContents.columns` does."""
        self.channel(topic)
        files = [file for file in self.files if topic in file.channels]
        found = [file.columns(topic, frame_id, names, range_ns) for file in files]
        return {name: np.concatenate([columns[name] for columns in found]) for name in names}

    def row_type(self, topic: str, frame_id: str) -> np.dtype[np.void]:
        """Return the type of a row of ``topic``, as :meth:`McapContents.row_type` does."""
        return self._with(topic).row_type(topic, frame_id)

    def first_row(self, topic: str, frame_id: str) -> Rows:
        """Return the first row of ``topic``; an empty array if there is none."""
        self.channel(topic)
        found = [file.first_row(topic, frame_id) for file in self.files if topic in file.channels]
        return next((rows for rows in found if len(rows)), found[0])

    def time_range_ns(self) -> tuple[int, int] | None:
        """Return the smallest and the largest log time in epoch ns; None without a message."""
        ranges = [span for file in self.files if (span := file.time_range_ns()) is not None]
        return (min(low for low, _ in ranges), max(high for _, high in ranges)) if ranges else None

    def _with(self, topic: str) -> McapContents:
        """Return the first file that has ``topic``, or the first file."""
        return next((file for file in self.files if topic in file.channels), self.files[0])


def _merged_metadata(files: Sequence[McapContents]) -> dict[str, dict[str, str]]:
    merged: dict[str, dict[str, str]] = {}
    for file in files:
        at_begin = {"recording", DIGESTS, *file.metadata.get(DIGESTS, {})}
        for name, entries in file.metadata.items():
            if name not in merged or name not in at_begin:
                merged[name] = entries
    counts: Counter[str] = Counter()
    for file in files:
        stated = file.metadata.get(_COUNTS, {})
        counts.update({key: int(count) for key, count in stated.items() if count.isdecimal()})
    if counts:
        merged[_COUNTS] = {key: str(count) for key, count in counts.items()}
    return merged


def _part(file: McapContents) -> int:
    own = file.metadata.get("recording", {})
    number = own.get(PART, "")
    if RUN_ID not in own or not number.isdecimal():
        raise RecordingError(
            f"{file.path}: is not a part of a run in several files (metadata recording.{RUN_ID} and "
            f"recording.{PART}); open it alone"
        )
    return int(number)
