"""The log of a daemon on stderr, one line an entry: time, severity, source and text.

    2026-03-02 14:05:31.482 warning  loop: woke up 12.1 ms late, skipped periods: 1

If stderr goes to the journal of systemd, the journal has the time, and the severity is the prefix of
sd-daemon(3) that the journal understands. Another process prints, because a terminal may stall.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING

from hil.core.output import Cycle, LogEntry, Severity
from hil.views.display_process import DisplayProcess, received_messages

if TYPE_CHECKING:
    from hil.core.gateway import Gateway

NAMES = {
    Severity.INFO: "info",
    Severity.WARNING: "warning",
    Severity.ERROR: "error",
    Severity.FATAL: "fault",
}
"""Word for each severity."""
JOURNAL_LEVELS = {Severity.INFO: 6, Severity.WARNING: 4, Severity.ERROR: 3, Severity.FATAL: 2}
"""Level of each severity in the journal (syslog(3))."""


class LogLines:
    """Observer of a run that prints its log entries. Close it before this process prints anything itself."""

    def __init__(self) -> None:
        self._process = DisplayProcess("hil.views.log_lines")

    def log(self, entry: LogEntry) -> None:
        """Print a log entry with the present time."""
        self._process.send({"log": [time.time(), int(entry.severity), entry.source, entry.text]})

    def cycle(self, cycle: Cycle, gateway: Gateway) -> None:
        """Take a period; nothing is printed of it."""

    def close(self) -> None:
        """Wait until everything is printed."""
        self._process.close()


def main(file_descriptor: int) -> None:
    """Print the messages of a :class:`LogLines` until it is closed."""
    is_journal = goes_to_journal(2, os.environ)
    for message in received_messages(file_descriptor):
        time_s, severity, source, text = message["log"]
        sys.stderr.write(log_line(time_s, severity, source, text, is_journal))
        sys.stderr.flush()


def goes_to_journal(descriptor: int, environment: Mapping[str, str]) -> bool:
    """Return whether a descriptor is the connection to the journal that systemd made (systemd.exec(5))."""
    device, _, inode = environment.get("JOURNAL_STREAM", "").partition(":")
    status = os.fstat(descriptor)
    return (device, inode) == (str(status.st_dev), str(status.st_ino))


def log_line(time_s: float, severity: int, source: str, text: str, is_journal: bool) -> str:
    """Return the line of a log entry, whose ``time_s`` is seconds since 1970."""
    kind = Severity(severity)
    words = " ".join(text.split())
    if is_journal:
        return f"<{JOURNAL_LEVELS[kind]}>{NAMES[kind]:7}  {source}: {words}\n"
    stamp = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(time_s))
    return f"{stamp}.{int(time_s % 1 * 1000):03} {NAMES[kind]:7}  {source}: {words}\n"


if __name__ == "__main__":
    main(int(sys.argv[1]))
