"""A command in user-mode Linux: a kernel with vcan that runs as an ordinary program, as any user.

Its root directory is this host's; ``init.sh``, beside, is its first process. Debian's package is assumed.
"""

from __future__ import annotations

import contextlib
import os
import platform
import resource
import selectors
import shlex
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Final, Self

from hil.core.errors import EnvironmentLackError

_MODULES: Final = Path("/usr/lib/uml/modules")
_PACKAGES: Final = {"linux.uml": "user-mode-linux", "modprobe": "kmod", "ip": "iproute2"}
_MOST_MEMORY_BYTES: Final = 2 << 30
_PATIENCE: Final = 3
"""So many signals, and the machine is switched off."""

_KERNEL: Final = (
    "rootfstype=hostfs rootflags=/ rw init=/bin/sh quiet con=null "
    # Two thirds of the boot would go into the choice of a RAID algorithm and into devices that nobody uses.
    "initcall_blacklist=raid6_select_algo,init_zswap pty.legacy_count=0"
)


def require_user_mode_linux() -> None:
    """Raises EnvironmentLackError, which says what to install."""
    missing = [package for program, package in _PACKAGES.items() if not _find(program)]
    if not _MODULES.is_dir():
        missing = [*{"user-mode-linux": 0, **dict.fromkeys(missing)}]
    if missing:
        raise EnvironmentLackError(
            "there is no vcan0, it cannot be made here, and user-mode Linux is not complete. Either: "
            "sudo modprobe vcan && sudo ip link add dev vcan0 type vcan && sudo ip link set vcan0 up; "
            f"or, on Debian: sudo apt-get install --no-install-recommends {' '.join(missing)}"
        )


def run_in_user_mode_linux(command: Sequence[str]) -> int:
    """Boot, run ``command``, power off; its exit status (127: not found, 128 + n: ended by signal n).

    Output comes as it is written; SIGINT, SIGTERM and SIGHUP are passed to the command. Raises
    EnvironmentLackError when the machine does not come up.
    """
    with tempfile.TemporaryDirectory(prefix="hil-vcan-", dir="/tmp") as name:
        job = Path(name)
        shutil.copy(Path(__file__).with_name("init.sh"), job / "init")
        (job / "settings").write_text(_settings())
        (job / "command").write_bytes(os.fsencode(_script(command)))
        last_signal = _run_machine(job)
        if (job / "status").exists():
            return int((job / "status").read_text())
        if last_signal:
            return 128 + last_signal
        console = (job / "console").read_text(errors="replace").strip() or "(it said nothing)"
        raise EnvironmentLackError(f"user-mode Linux ended before the command did. Its console:\n{console}")


def _run_machine(job: Path) -> int:
    """Until power-off; returns the last signal that was passed on, or 0."""
    output, guest_output = os.pipe()
    errors, guest_errors = os.pipe()
    guest_control, control = os.pipe()
    with _Signals(control) as signals:
        with (job / "console").open("wb") as console:
            machine = subprocess.Popen(
                [
                    str(_find("linux.uml")),
                    *_KERNEL.split(),
                    f"mem={_memory_bytes() >> 20}M",
                    f"uml_dir={job}/",
                    "con0=null,fd:1",
                    f"con1=null,fd:{guest_output}",
                    f"con2=null,fd:{guest_errors}",
                    "con3=fd:0,null",
                    f"job={job}",
                    "--",
                    f"{job}/init",
                ],
                stdin=guest_control,
                stdout=console,
                stderr=subprocess.STDOUT,
                env={"TMPDIR": _directory_for_memory(), "HOME": str(job)},
                pass_fds=(guest_output, guest_errors),
                start_new_session=True,  # Ctrl-C reaches the command through us
                preexec_fn=_take_priority,
            )
        try:
            for descriptor in (guest_output, guest_errors, guest_control):
                os.close(descriptor)
            _pass_output(machine.pid, {output: 1, errors: 2})
        finally:
            os.killpg(machine.pid, signal.SIGKILL)  # it is made of several processes
            machine.wait()
            for descriptor in (output, errors, control):
                os.close(descriptor)
    return signals.last


class _Signals:
    """While entered, signals to this process become lines in ``control``."""

    def __init__(self, control: int) -> None:
        self._control = control
        self._count = 0
        self.last = 0

    def __enter__(self) -> Self:
        self._before = {
            number: signal.signal(number, self._pass)
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        }
        return self

    def __exit__(self, *_error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _pass(self, number: int, _frame: FrameType | None) -> None:
        self.last = number
        self._count += 1
        if self._count == _PATIENCE:
            raise KeyboardInterrupt
        os.write(self._control, f"{signal.Signals(number).name.removeprefix('SIG')}\n".encode())


def _pass_output(pid: int, targets: dict[int, int]) -> None:
    """Copy from each key to its value until process ``pid`` has ended and its last word is out."""
    ended = os.pidfd_open(pid)
    with selectors.DefaultSelector() as selector:
        for source in (*targets, ended):
            selector.register(source, selectors.EVENT_READ)
        while (ready := {key.fd for key, _ in selector.select()}) != {ended}:
            for source in ready - {ended}:
                data = os.read(source, 65536)
                if not data:
                    selector.unregister(source)
                while data:
                    data = data[os.write(targets[source], data) :]
    os.close(ended)


def _take_priority() -> None:
    """A loop in the machine is no more punctual than the machine; where granted, it waits for nobody.

    Not on a single processor: a busy command in there would hold up everything else.
    """
    if (
        len(os.sched_getaffinity(0)) > 1
        and resource.getrlimit(resource.RLIMIT_RTTIME)[1] == resource.RLIM_INFINITY
    ):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))


def _settings() -> str:
    is_terminal = os.isatty(1)
    size = os.get_terminal_size(1) if is_terminal else os.terminal_size((80, 24))
    return (
        f"host={shlex.quote(platform.node())}\nis_terminal={'yes' if is_terminal else 'no'}\n"
        f"rows={size.lines}\ncolumns={size.columns}\n"
    )


def _script(command: Sequence[str]) -> str:
    """A shell script that runs ``command`` in this directory with this environment and no other."""
    environment = [f"{name}={value}" for name, value in os.environ.items()]
    return f"cd {shlex.quote(str(Path.cwd()))} && exec env -i {shlex.join([*environment, *command])}\n"


def _memory_bytes() -> int:
    """At most half of what this host has to give."""
    for line in Path("/proc/meminfo").read_text().splitlines():
        if line.startswith("MemAvailable:"):
            return min(_MOST_MEMORY_BYTES, int(line.split()[1]) * 1024 // 2)
    return _MOST_MEMORY_BYTES


def _directory_for_memory() -> str:
    """The machine's memory is a file; a container's /dev/shm is often too small for it."""
    shared = shutil.disk_usage("/dev/shm").free if Path("/dev/shm").is_dir() else 0
    return "/dev/shm" if shared >= _memory_bytes() else "/tmp"


def _find(program: str) -> str | None:
    """Also where an ordinary user's PATH does not look."""
    return shutil.which(program, path=os.environ.get("PATH", os.defpath) + ":/usr/sbin:/sbin")
