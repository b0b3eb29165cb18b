"""Explain from its console why user-mode Linux stopped."""

from __future__ import annotations

from typing import Final

from hil.core.errors import EnvironmentLackError

_SHOWN_LINES: Final = 3
_NATIVE: Final = "sudo modprobe vcan && sudo ip link add dev vcan0 type vcan && sudo ip link set vcan0 up"
OTHER_WAY: Final = f"make vcan0 in this kernel, if it has CAN: {_NATIVE}"

_REMEDIES: Final = {
    "ptrace set fp regs failed": (
        "the processor's register area is longer than user-mode Linux's buffer, and the library that "
        "completes it (_xsave_area*.so beside hil/host/vcan/xsave_area.c) did not take effect; compile it "
        "again: pip install -e ."
    ),
    "must be not mounted noexec": (
        "user-mode Linux executes its memory file; allow that for the folder that the console names: "
        "sudo mount -o remount,exec /dev/shm"
    ),
    "ptrace: Operation not permitted": (
        "user-mode Linux needs ptrace; start the container with --cap-add SYS_PTRACE "
        "--security-opt seccomp=unconfined; outside a container: sudo sysctl kernel.yama.ptrace_scope=1"
    ),
    "likely just ran out of space": (
        "the memory of user-mode Linux is a file in /dev/shm or /tmp; free space there, or start the "
        "container with --shm-size=2g"
    ),
    "setup_physmem - mapping": "the address space of this process is limited; first: ulimit -v unlimited",
}
"""Remedy for each cause that is known, by a text on the console that identifies it."""


class MachineStoppedError(EnvironmentLackError):
    """User-mode Linux stopped before its command ended, or did not start in time."""

    def __init__(self, problem: str, console: str) -> None:
        """``problem`` says what happened; ``console`` is everything that the machine printed."""
        self.problem = problem
        self.last_lines = last_lines(console)
        """Last lines of the console that people can use."""
        self.remedy = next((text for cause, text in _REMEDIES.items() if cause in console), OTHER_WAY)
        """What to do about it."""
        shown = "\n  ".join(self.last_lines) or "(nothing)"
        super().__init__(f"{problem}. Its console ended with:\n  {shown}\nWhat to do: {self.remedy}")


def last_lines(console: str) -> list[str]:
    """Return the last lines before the stack trace, without the kernel's level marks such as ``<3>``.

    A kernel panic ends with a stack trace, which begins with a line ``CPU: …``.
    """
    lines = []
    for line in console.splitlines():
        text = line.strip()
        if text[:1] == "<" and text[2:3] == ">":
            text = text[3:]
        if text.startswith("CPU: "):
            break
        if text:
            lines.append(text)
    return lines[-_SHOWN_LINES:]
