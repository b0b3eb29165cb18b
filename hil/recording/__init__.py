"""Recordings: one MCAP file for each run, written by a process of its own, read for replay and analysis.

``schemas`` defines what is in the file. Writing: ``recorder`` (the loop's side), ``pipe``, ``handover``
(format of the data between the processes), ``recorder_process``, ``mcap_writer``, ``indexed_file``, and
``metadata_digests``, which show damage of metadata. Reading: ``open_recording``, ``reader``, ``tables``,
``entry_reader`` with ``entries`` and ``entry_columns``, ``run_files`` (several files as one), and for MCAP
itself ``mcap_reader``, ``mcap_summary`` (complete files), ``mcap_scan`` with ``record_search`` (files without
an index, or damaged), ``mcap_chunks``, ``mcap_records``. ``recover`` saves what is whole, and ``repairs``
names damage that cost no data. Only the reading modules import numpy; the loop's side imports neither numpy
nor mcap.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hil.recording.reader import Recording

__all__ = ["open_recording"]


def open_recording(path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> Recording:
    """Open the recording of a run: its file, all files of a run in several files, or their folder.

    Raises RecordingError when ``path`` is not a recording or is damaged. A file that was cut off, by a crash
    for example, is opened: it has everything up to its last complete chunk, and ``complete`` is False.

    >>> from hil.recording import open_recording
    >>> run = open_recording("run.mcap")
    >>> run.axes
    {'vertical': 'm', 'horizontal': 'm', 'rotation': 'rad'}

    The signals of an axis are numpy arrays with one value for each period of the loop. Each is an attribute
    and a key, and a condition selects periods:

    >>> vertical = run.axis("vertical")
    >>> vertical.position is vertical["position"]
    True
    >>> controlled = vertical[vertical.running]
    >>> print(f"{controlled.setpoint[-1]:.2f} {vertical.unit}, {abs(controlled.error[-1]) < 0.005}")
    0.10 m, True
    >>> print(*vertical.columns)
    time_s time_ns setpoint position error output_v command_v potentiometer_v phase state fresh running

    ``time_s`` counts from the first recorded period. Setpoint times count from the first period in which the
    controllers act, when the boards are up:

    >>> float(vertical.time_s[0])
    0.0
    >>> step_at_s = controlled.time_s[controlled.setpoint > 0.05][0] - controlled.time_s[0]
    >>> print(f"{step_at_s:.4f} s")
    1.0080 s

    The timing of the loop and the CAN frames are tables of the same kind:

    >>> timing = run.timing()
    >>> int((timing.wake_ns - timing.deadline_ns).max())
    0
    >>> samples = run.frames("received", identifier=0x190)
    >>> samples.data.shape == (len(samples), 8)
    True

    ``numpy.asarray(table)`` is a structured array; ``to_pandas()``, ``to_polars()`` and ``to_xarray()`` give
    the types of those libraries. A range of time is read without the rest of the file:

    >>> run.between(0.5, 0.6).axis("vertical").to_pandas().shape
    (9, 12)

    Log, documents and metadata:

    >>> last = run.log()[-1]
    >>> print(f"{run.seconds(last.now_ns):.2f} s, {last.entry.severity.name}, {last.entry.source}")
    2.13 s, INFO, life cycle
    >>> sorted(run.documents)[:2]
    ['arm.dbc', 'arm.toml']
    >>> run.metadata["setpoints"]["vertical"]
    'step:0.1@1'
    """
    from hil.recording.reader import Recording

    return Recording(path)
