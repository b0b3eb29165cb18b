"""A running user-mode Linux: its start, its streams and its end."""

from __future__ import annotations

import contextlib
import os
import selectors
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final, Self

from hil.host.vcan.guest_job import GuestJob
from hil.host.vcan.xsave_area import xsave_area_library

_MAX_MEMORY_BYTES: Final = 2 << 30
_NICE: Final = -20
"""Priority of the machine among ordinary programs, the highest one."""

_KERNEL_ARGUMENTS: Final = (
    "rootfstype=hostfs rootflags=/ rw init=/bin/sh quiet con=null "
    # Without these, two thirds of the boot go into the choice of a RAID algorithm and into unused devices.
    "initcall_blacklist=raid6_select_algo,init_zswap pty.legacy_count=0"
)


class ControlPipe:
    """A pipe on which the guest reads names of signals for its command, one a line.

    When its writing end closes, the guest switches off: this process has ended, however it ended.
    """

    def __enter__(self) -> Self:
        self.reading_end, self._writing_end = os.pipe()
        return self

    def send(self, number: signal.Signals) -> None:
        """Pass a signal to the command."""
        os.write(self._writing_end, f"{number.name.removeprefix('SIG')}\n".encode())

    def __exit__(self, *_error: object) -> None:
        os.close(self.reading_end)
        os.close(self._writing_end)


class Machine:
    """User-mode Linux that runs one job. Entering boots it; leaving switches it off."""

    def __init__(self, job: GuestJob, control: ControlPipe) -> None:
        self._job = job
        self._control = control

    def __enter__(self) -> Self:
        self._output, guest_output = os.pipe()
        self._errors, guest_errors = os.pipe()
        try:
            self._process = self._boot(guest_output, guest_errors)
        except BaseException:
            self._close_streams()
            raise
        finally:
            os.close(guest_output)
            os.close(guest_errors)
        return self

    def __exit__(self, *_error: object) -> None:
        os.killpg(self._process.pid, signal.SIGKILL)  # the machine consists of several processes
        self._process.wait()
        self._close_streams()

    def pass_output(self, output: int, errors: int, timeout_s: float | None = None) -> bool:
        """Copy the command's streams to two descriptors until the machine is off and all is copied.

        Returns False if that takes longer than ``timeout_s`` seconds.
        """
        end = None if timeout_s is None else time.monotonic() + timeout_s
        targets = {self._output: output, self._errors: errors}
        with _pidfd(self._process.pid) as off, selectors.DefaultSelector() as selector:
            for source in (*targets, off):
                selector.register(source, selectors.EVENT_READ)
            while True:
                left_s = None if end is None else max(0.0, end - time.monotonic())
                ready = {key.fd for key, _ in selector.select(left_s)}
                if ready == {off}:
                    return True
                if not ready:
                    return False
                for source in ready - {off}:
                    if not _copy(source, targets[source]):
                        selector.unregister(source)

    def _close_streams(self) -> None:
        os.close(self._output)
        os.close(self._errors)

    def _boot(self, guest_output: int, guest_errors: int) -> subprocess.Popen[bytes]:
        job = self._job
        with job.console.open("wb") as console:
            return subprocess.Popen(
                [
                    str(find_program("linux.uml")),
                    *_KERNEL_ARGUMENTS.split(),
                    f"mem={_memory_bytes() >> 20}M",
                    f"uml_dir={job.path}/",
                    "con0=null,fd:1",
                    f"con1=null,fd:{guest_output}",
                    f"con2=null,fd:{guest_errors}",
                    "con3=fd:0,null",
                    f"job={job.path}",
                    "--",
                    str(job.init),
                ],
                stdin=self._control.reading_end,
                stdout=console,
                stderr=subprocess.STDOUT,
                env={
                    "TMPDIR": _directory_for_memory(),
                    "HOME": str(job.path),
                    "LD_PRELOAD": _preloaded(job),
                },
                pass_fds=(guest_output, guest_errors),
                start_new_session=True,  # Ctrl-C reaches the command through the control pipe
                preexec_fn=_take_priority,
            )


def find_program(name: str) -> str | None:
    """Return the path of a program; None if there is none.

    Looks into /usr/sbin and /sbin too, which an ordinary user's PATH does not name.
    """
    return shutil.which(name, path=os.environ.get("PATH", os.defpath) + ":/usr/sbin:/sbin")


@contextlib.contextmanager
def _pidfd(pid: int) -> Iterator[int]:
    """Yield a descriptor that becomes readable when process ``pid`` ends."""
    descriptor = os.pidfd_open(pid)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def _copy(source: int, target: int) -> bool:
    """Copy what ``source`` holds now to ``target``; return False at its end."""
    data = os.read(source, 65536)
    left = data
    while left:
        left = left[os.write(target, left) :]
    return bool(data)


def _preloaded(job: GuestJob) -> str:
    """Return the value of ``LD_PRELOAD``: a link in the job's folder, whose path contains no space."""
    link = job.path / "xsave_area.so"
    link.symlink_to(xsave_area_library())
    return str(link)


def _take_priority() -> None:
    """Put the machine before all ordinary programs where that is granted, on one processor.

    The machine consists of a process for its kernel and one for each of its programs, which run in turns. On
    several processors, each turn wakes another processor, which takes several times as long beside other
    programs. A machine that may have to wait for others must be able to move to an idle processor.

    It takes no real-time priority: a command in it may be busy for seconds. Linux then lets ordinary programs
    run for 50 ms in each second, and stops all real-time programs on that processor meanwhile.
    """
    try:
        os.setpriority(os.PRIO_PROCESS, 0, _NICE)
    except OSError:
        return
    with contextlib.suppress(OSError):  # Where sessions share the processors, the session counts.
        Path("/proc/self/autogroup").write_text(str(_NICE))
    with contextlib.suppress(OSError):
        processors = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {processors[os.getpid() % len(processors)]})


def _memory_bytes() -> int:
    """Return the machine's memory: at most half of what this host has available."""
    for line in Path("/proc/meminfo").read_text().splitlines():
        if line.startswith("MemAvailable:"):
            return min(_MAX_MEMORY_BYTES, int(line.split()[1]) * 1024 // 2)
    return _MAX_MEMORY_BYTES


def _directory_for_memory() -> str:
    """Return the folder for the machine's memory file; a container's /dev/shm is often too small for it."""
    shared = shutil.disk_usage("/dev/shm").free if Path("/dev/shm").is_dir() else 0
    return "/dev/shm" if shared >= _memory_bytes() else "/tmp"
