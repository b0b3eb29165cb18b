"""The files of one run as one: the recorder may begin a new file in the course of a run.

Each file of such a run names the run and its place in it in the metadata ``recording``: ``run id`` and
``part``, which counts from 1. A run in one file may have neither.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from mcap.records import Channel

from hil.core.errors import RecordingError
from hil.recording.mcap_chunks import Offsets
from hil.recording.mcap_reader import McapContents, Rows

RUN_ID, PART = "run id", "part"
"""Keys in metadata ``recording``: name of the run, equal in all of its files; number of the file, from 1."""

Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]
"""A file, a folder with the files of one run, or the files of one run."""


def open_contents(given: Paths) -> McapContents | RunFiles:
    """Open the file or files of a run. Raises RecordingError."""
    paths = _paths(given)
    files = [McapContents(path) for path in paths]
    return files[0] if len(files) == 1 else RunFiles(files)


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

    Raises RecordingError when the files do not belong to one run, or one of them is missing.
    """

    def __init__(self, files: Sequence[McapContents]) -> None:
        numbered = sorted((_part(file), file.path, file) for file in files)
        runs = {file.metadata["recording"][RUN_ID]: file.path for file in files}
        if len(runs) > 1:
            (_, one), (_, other), *_ = runs.items()
            raise RecordingError(
                f"{one} and {other} are of different runs (metadata recording.{RUN_ID}); open them one by one"
            )
        for expected, (part, path, _) in enumerate(numbered, 1):
            if part != expected:
                problem = "is given twice" if part < expected else "is missing"
                number = part if part < expected else expected
                raise RecordingError(f"{path}: part {number} of its run {problem}")
        self._files = [file for _, _, file in numbered]
        self.path = self._files[0].path
        self.attachments: dict[str, bytes] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.channels: dict[str, Channel] = {}
        for file in self._files:
            self.attachments |= file.attachments
            self.metadata |= file.metadata
            self._add_channels(file)
        self.metadata["recording"] = self._files[0].metadata["recording"]
        self.is_complete = all(file.is_complete for file in self._files)

    def _add_channels(self, file: McapContents) -> None:
        for topic, channel in file.channels.items():
            known = self.channels.setdefault(topic, channel)
            if known.id != channel.id:
                raise RecordingError(f"{file.path}: {topic} has another channel id than in {self.path}")

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages, by topic."""
        total: Counter[str] = Counter()
        for file in self._files:
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
        for file in self._files:
            if topic is None or topic in file.channels:
                yield from file.chunks(topic)

    def rows(self, topic: str, frame_id: str, range_ns: tuple[int, int] | None = None) -> Rows:
        """Return all messages of ``topic``, as :meth:`McapContents.rows` does."""
        self.channel(topic)
        files = [file for file in self._files if topic in file.channels]
        return np.concatenate([file.rows(topic, frame_id, range_ns) for file in files])

    def row_type(self, topic: str, frame_id: str) -> np.dtype[np.void]:
        """Return the type of a row of ``topic``, as :meth:`McapContents.row_type` does."""
        return self._with(topic).row_type(topic, frame_id)

    def first_row(self, topic: str, frame_id: str) -> Rows:
        """Return the first row of :meth:`rows`; an empty array if there is none."""
        self.channel(topic)
        found = [file.first_row(topic, frame_id) for file in self._files if topic in file.channels]
        return next((rows for rows in found if len(rows)), found[0])

    def time_range_ns(self) -> tuple[int, int] | None:
        """Return the smallest and the largest log time in epoch ns; None without a message."""
        ranges = [span for file in self._files if (span := file.time_range_ns()) is not None]
        return (min(low for low, _ in ranges), max(high for _, high in ranges)) if ranges else None

    def _with(self, topic: str) -> McapContents:
        """Return the first file that has ``topic``, or the first file."""
        return next((file for file in self._files if topic in file.channels), self._files[0])


def _part(file: McapContents) -> int:
    own = file.metadata.get("recording", {})
    number = own.get(PART, "")
    if RUN_ID not in own or not number.isdecimal():
        raise RecordingError(
            f"{file.path}: is not a part of a run in several files (metadata recording.{RUN_ID} and "
            f"recording.{PART}); open it alone"
        )
    return int(number)
