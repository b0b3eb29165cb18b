"""The preloaded wrapper of ptrace, which completes a register area that is too short."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from hil.core.errors import EnvironmentLackError
from hil.host.vcan import machine, user_mode_linux, xsave_area
from hil.host.vcan.console import MachineStoppedError
from hil.host.vcan.xsave_area import xsave_area_library

LONG_XSAVE_AREA = Path(__file__).parents[4] / "support" / "long_xsave_area.c"

WITH_A_TRACED_CHILD = """
import ctypes, json, os, signal, sys

libc = ctypes.CDLL(None, use_errno=True)
libc.ptrace.restype = ctypes.c_long
libc.ptrace.argtypes = [ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p]
TRACEME, PEEKTEXT, PEEKDATA, PEEKUSER, GETREGSET, SETREGSET = 0, 1, 2, 3, 0x4204, 0x4205
NT_X86_XSTATE = 0x202
XMM = slice(160, 416)
HEADER = 512
UPPER_YMM = slice(576, 832)

class IoVec(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))

def ptrace(request, address, data):
    ctypes.set_errno(99)
    result = libc.ptrace(request, child, address, data)
    return result, ctypes.get_errno()

def read_area(length=65536):
    buffer = ctypes.create_string_buffer(length)
    vector = IoVec(ctypes.addressof(buffer), length)
    assert ptrace(GETREGSET, NT_X86_XSTATE, ctypes.addressof(vector))[0] == 0
    return bytearray(buffer.raw[: vector.length])

def write_area(area):
    buffer = ctypes.create_string_buffer(bytes(area), len(area))
    vector = IoVec(ctypes.addressof(buffer), len(area))
    result, error = ptrace(SETREGSET, NT_X86_XSTATE, ctypes.addressof(vector))
    return result, error if result < 0 else 0, vector.length

value = ctypes.c_long(-1)
child = os.fork()
if child == 0:
    libc.ptrace(TRACEME, 0, None, None)
    os.kill(os.getpid(), signal.SIGSTOP)
    os._exit(0)
os.waitpid(child, 0)
"""
"""A program that traces a child, and shortens what it writes to the child's register area."""

WRITE_SHORT = """
length = int(sys.argv[1])
before = read_area()
before[HEADER] |= 0b110  # the SSE and AVX registers are in use
before[UPPER_YMM] = bytes(range(256))
whole = write_area(before)
changed = bytearray(before)
changed[XMM] = bytes(reversed(range(256)))
short = write_area(changed[:length])
after = read_area()
os.kill(child, signal.SIGKILL)
print(json.dumps({"whole": whole, "short": short, "area": len(before),
                  "is changed": after == changed, "is unchanged": after == before}))
"""

WRITE_TOO_LONG = """
area = read_area()
area[HEADER] |= 0b10
area[XMM] = bytes(range(256))
long = write_area(area + bytes(64))
after = read_area()
os.kill(child, signal.SIGKILL)
print(json.dumps({"long": long, "area": len(area), "is changed": after == area}))
"""

OTHER_REQUESTS = """
address = ctypes.addressof(value)
results = [ptrace(request, address, None) for request in (PEEKTEXT, PEEKDATA)]
results.append(ptrace(PEEKUSER, None, None)[1])
results.append(ptrace(PEEKDATA, None, None))
vector = IoVec(address, 8)
results.append(ptrace(SETREGSET, 0x999, ctypes.addressof(vector)))
os.kill(child, signal.SIGKILL)
print(json.dumps(results))
"""


def run_traced(program: str, *arguments: str, is_preloaded: bool) -> dict[str, object]:
    environment = {**os.environ, **({"LD_PRELOAD": str(xsave_area_library())} if is_preloaded else {})}
    done = subprocess.run(
        [sys.executable, "-c", WITH_A_TRACED_CHILD + program, *arguments],
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)  # type: ignore[no-any-return]


EFAULT = 14


class TestWrapper:
    @pytest.mark.parametrize("length", [512, 576])
    def test_the_kernel_rejects_a_short_area(self, length: int) -> None:
        found = run_traced(WRITE_SHORT, str(length), is_preloaded=False)
        assert found["whole"] == [0, 0, found["area"]]
        assert found["short"] == [-1, EFAULT, length]
        assert found["is unchanged"]

    @pytest.mark.parametrize("length", [512, 576])
    def test_with_the_wrapper_a_short_area_replaces_the_beginning_alone(self, length: int) -> None:
        found = run_traced(WRITE_SHORT, str(length), is_preloaded=True)
        assert found["whole"] == [0, 0, found["area"]]
        assert found["short"] == [0, 0, length]
        assert found["is changed"]

    @pytest.mark.parametrize("is_preloaded", [False, True])
    def test_of_an_area_that_is_too_long_the_kernel_takes_its_length(self, is_preloaded: bool) -> None:
        found = run_traced(WRITE_TOO_LONG, is_preloaded=is_preloaded)
        assert found["long"] == [0, 0, found["area"]]
        assert found["is changed"]

    def test_other_requests_follow_the_conventions_of_the_c_library(self) -> None:
        """A PEEK request returns the value, which may be -1: errno says whether that is an error."""
        plain = run_traced(OTHER_REQUESTS, is_preloaded=False)
        assert plain == run_traced(OTHER_REQUESTS, is_preloaded=True)
        assert plain == [[-1, 0], [-1, 0], 0, [-1, 5], [-1, 22]]


@pytest.fixture
def emulated_amx(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Boot user-mode Linux with the given libraries, on a host whose XSAVE area is too long for it."""
    host = tmp_path / "long_xsave_area.so"
    subprocess.run(["gcc", "-std=c11", "-shared", "-fPIC", "-o", host, LONG_XSAVE_AREA, "-ldl"], check=True)

    def preload(*libraries: Path) -> None:
        monkeypatch.setattr(machine, "_preloaded", lambda _job: ":".join(map(str, [*libraries, host])))

    return preload


ADD_ROOTS = "total = 0.0\nfor number in range(100_000):\n    total += number**0.5\nprint(total)"


class TestLongArea:
    """User-mode Linux on a processor whose XSAVE area is longer than its buffer."""

    def test_without_the_wrapper_it_does_not_start(self, emulated_amx: Callable[..., None]) -> None:
        emulated_amx()
        with pytest.raises(MachineStoppedError) as caught:
            user_mode_linux.try_user_mode_linux()
        assert caught.value.problem == "user-mode Linux does not start"
        assert any("ptrace set fp regs failed, errno = 14" in line for line in caught.value.last_lines)
        assert "pip install -e ." in caught.value.remedy

    def test_with_the_wrapper_it_runs_and_keeps_the_registers_of_each_process(
        self, emulated_amx: Callable[..., None], tmp_path: Path
    ) -> None:
        """Two processes compute at the same time on the one processor of the machine."""
        emulated_amx(xsave_area_library())
        (tmp_path / "add_roots.py").write_text(ADD_ROOTS)
        python = f"{sys.executable} -S {tmp_path}/add_roots.py"
        script = f"{python} >{tmp_path}/one & {python} >{tmp_path}/other; wait; exit 7"
        assert user_mode_linux.run_in_user_mode_linux(["sh", "-c", script]) == 7
        expected = subprocess.check_output([sys.executable, "-c", ADD_ROOTS], text=True)
        assert [(tmp_path / name).read_text() for name in ("one", "other")] == [expected, expected]


def test_a_missing_library_is_reported_with_the_command_that_compiles_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(xsave_area, "__file__", str(tmp_path / "xsave_area.py"))
    with pytest.raises(EnvironmentLackError) as caught:
        xsave_area_library()
    assert f"no _xsave_area*.so in {tmp_path}" in str(caught.value)
    assert "apt-get install gcc libc6-dev" in str(caught.value)


def test_the_newest_library_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xsave_area, "__file__", str(tmp_path / "xsave_area.py"))
    for age_s, name in enumerate(("_xsave_area.so", "_xsave_area.cpython-313.so", "_xsave_area.abi3.so")):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (1e9 - age_s, 1e9 - age_s))
    assert xsave_area_library().name == "_xsave_area.so"
