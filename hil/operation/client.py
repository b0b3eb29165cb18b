"""Operate a running daemon from Python."""

from __future__ import annotations

import contextlib
import os
import socket
import struct
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Self, TypeVar

import msgspec

from hil.core.errors import (
    ConnectionLostError,
    DocumentError,
    NoDaemonError,
    OperationError,
    RequestRefusedError,
)
from hil.core.setpoint_change import MAX_TABLE_CHARACTERS
from hil.core.setpoints import COLUMNS, csv_file
from hil.host.controller_files import controller_path
from hil.host.text_file import MAX_DOCUMENT_BYTES, read_text
from hil.operation.protocol import (
    MAX_LINE_BYTES,
    PROTOCOL,
    VERSION,
    Answer,
    AnyCall,
    ArmCall,
    AxisSetpoint,
    ControllerCall,
    DisarmCall,
    EventCall,
    Greeting,
    JogCall,
    RecordNewCall,
    RecordStopCall,
    ResetCall,
    RigCall,
    SetpointCall,
    SetpointsCall,
    ShutdownCall,
    StartCall,
    Status,
    StatusCall,
    StopCall,
    Update,
    WatchCall,
    encode_line,
)
from hil.operation.socket_path import default_path

TIMEOUT_S = 20.0
"""Longest wait for an answer. It is longer than the daemon's own wait for the loop."""

_MAX_LOST_CONNECTIONS = 5
"""Number of connections in a row that a daemon may close without a word while it ends."""
_TIMEVAL = struct.Struct("ll")  # struct timeval of the kernel

_Kind = TypeVar("_Kind")


def connect(path: str | os.PathLike[str] | None = None) -> Client:
    """Connect to the running daemon, at its socket ``path`` or at the default one of this user.

    Raises OperationError if no daemon runs there.
    """
    return Client(Path(path) if path is not None else default_path())


def await_end(path: str | os.PathLike[str] | None = None) -> bool:
    """Wait until a daemon that closes connections has ended. Return False if it serves a client meanwhile."""
    for _ in range(_MAX_LOST_CONNECTIONS):
        try:
            connect(path).close()
        except NoDaemonError:
            return True
        except ConnectionLostError:
            continue  # It was about to be accepted when the daemon closed its socket.
        except OperationError:
            pass
        return False
    return False


class Client:
    """A connection to a running daemon.

    Each method waits for the daemon's answer. It raises :class:`~hil.core.errors.RequestRefusedError` with
    the daemon's words if the daemon refuses, and :class:`~hil.core.errors.OperationError` if the connection
    fails. Positions are in the axis' unit, m or rad::

        import hil

        with hil.connect() as daemon:
            daemon.arm()
            daemon.start()
            daemon.set_setpoint("vertical", 0.05)
            for status in daemon.watch():
                vertical = status.axes[0]
                if vertical.error is not None and abs(vertical.error) < 0.001:
                    break
            daemon.stop()
            daemon.disarm()

    Watching uses a second connection, so that requests can be made meanwhile. An object is used by one thread
    at a time.
    """

    def __init__(self, path: Path) -> None:
        """Connect to the socket ``path``. Raises OperationError."""
        self.path = path
        """Path of the daemon's socket."""
        self._id = 0
        self._lines = _Lines(path)

    def status(self) -> Status:
        """Return the state of the daemon, at most 0.1 s old."""
        status = self._ask(StatusCall(id=self._next_id())).status
        if status is None:
            raise OperationError(f"{self.path}: the daemon's answer has no status; update the daemon")
        return status

    def rig_text(self) -> str:
        """Return the text of the rig file that the daemon uses, also if the file was changed since."""
        return self._ask(RigCall(id=self._next_id())).text

    def watch(self, interval_s: float = 0.2) -> Iterator[Status]:
        """Yield the status every ``interval_s`` seconds, with the log entries since the one before.

        ``interval_s`` is 0.05 to 60. Ends when the daemon ends.
        """
        with _Lines(self.path) as lines:
            answer = lines.ask(WatchCall(interval_s=interval_s))
            if not answer.accepted:
                raise RequestRefusedError(answer.text)
            while line := lines.read(timeout_s=interval_s + TIMEOUT_S):
                if not line.startswith(b'{"status"'):  # The daemon says why it disconnects.
                    raise RequestRefusedError(_decode(line, Answer, self.path).text)
                yield _decode(line, Update, self.path).status

    def arm(self, override: str | Iterable[str] = ()) -> str:
        """Allow motion: ready becomes armed. The valves stay centred. Return what happened.

        The daemon refuses if a check fails, such as a right that the rig requires of the machine. The refusal
        names the check; ``override`` is the name of a check that may fail, or the names of several.
        """
        names = (override,) if isinstance(override, str) else tuple(override)
        return self._ask(ArmCall(id=self._next_id(), override=names)).text

    def disarm(self) -> str:
        """Forbid motion: armed becomes ready. Return what happened."""
        return self._ask(DisarmCall(id=self._next_id())).text

    def start(self) -> str:
        """Begin to control: armed becomes running, and the controllers move the valves."""
        return self._ask(StartCall(id=self._next_id())).text

    def stop(self) -> str:
        """Stop controlling and centre the valves: running becomes armed. The daemon goes on."""
        return self._ask(StopCall(id=self._next_id())).text

    def reset(self) -> str:
        """Leave state fault. The boards are then brought up again."""
        return self._ask(ResetCall(id=self._next_id())).text

    def set_setpoint(self, axis: str, setpoint: float | str) -> str:
        """Change the setpoint of ``axis``.

        A number is a position in the axis' unit. A text is a setpoint as in a rig file, such as
        ``"sine:0.05@0/4"``; its time 0 is now. In state running, the axis approaches it within the limits of
        the rig file. This process reads the file of a setpoint ``"csv:FILE"``.

        Raises DocumentError if the file cannot be read.
        """
        text, table = _setpoint_texts(setpoint)
        return self._ask(SetpointCall(id=self._next_id(), axis=axis, setpoint=text, table=table)).text

    def set_setpoints(self, setpoints: Mapping[str, float | str]) -> str:
        """Change the setpoints of several axes in one period, or none of them if one is refused.

        ``setpoints`` are those of :meth:`set_setpoint` by axis name. Returns one line for each axis, which
        begins with its name. Raises DocumentError if a file cannot be read.
        """
        given = []
        for axis, setpoint in setpoints.items():
            text, table = _setpoint_texts(setpoint)
            given.append(AxisSetpoint(axis, text, table))
        return self._ask(SetpointsCall(id=self._next_id(), setpoints=tuple(given))).text

    def set_controller(self, axis: str, file: str | os.PathLike[str]) -> str:
        """Change the controller of ``axis`` to that of a controller file, or to a shipped one by its name.

        This process reads the file. Raises DocumentError if it cannot be read.
        """
        return self._controller(axis, file, only_check=False)

    def check_controller(self, axis: str, file: str | os.PathLike[str]) -> str:
        """Check a controller as :meth:`set_controller` does, and change nothing."""
        return self._controller(axis, file, only_check=True)

    def _controller(self, axis: str, file: str | os.PathLike[str], only_check: bool) -> str:
        path = controller_path(file)
        document = read_text(path, MAX_DOCUMENT_BYTES)
        call = ControllerCall(
            id=self._next_id(), axis=axis, name=path.name, document=document, only_check=only_check
        )
        return self._ask(call).text

    def jog(self, axis: str, offset_v: float, duration_s: float) -> str:
        """Move ``axis`` with a constant valve voltage, ``offset_v`` from the valve's centre.

        The valve is centred after ``duration_s`` seconds. A further call before the end extends the motion.
        """
        call = JogCall(id=self._next_id(), axis=axis, offset_v=offset_v, duration_s=duration_s)
        return self._ask(call).text

    def event(self, text: str) -> str:
        """Let something happen to the simulated arm now, such as ``"payload:3"``."""
        return self._ask(EventCall(id=self._next_id(), text=text)).text

    def record_new(self) -> str:
        """Close the recording and begin another. Return what happened, with the new file's name."""
        return self._ask(RecordNewCall(id=self._next_id())).text

    def record_stop(self) -> str:
        """Close the recording. The daemon goes on without one."""
        return self._ask(RecordStopCall(id=self._next_id())).text

    def shutdown(self) -> str:
        """End the daemon: it centres the valves and closes the recording. Wait until this is done.

        Simulated boards and a page end after that, so that its process runs for a moment more. ``hil
        shutdown`` waits for that too; another daemon at the same socket is refused until then.
        """
        text = self._ask(ShutdownCall(id=self._next_id())).text
        with contextlib.suppress(ConnectionLostError):
            while self._lines.read(TIMEOUT_S):
                pass
        return text

    def answer_to(self, call: AnyCall) -> Answer:
        """Make any request of the protocol, and return the answer, also if it is a refusal."""
        return self._lines.ask(call)

    def close(self) -> None:
        """Disconnect."""
        self._lines.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _next_id(self) -> int:
        self._id += 1
        return self._id

    def _ask(self, call: AnyCall) -> Answer:
        answer = self.answer_to(call)
        if not answer.accepted:
            raise RequestRefusedError(answer.text)
        return answer


class _Lines:
    """A connection that sends and receives lines."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._unread = bytearray()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            # The kernel waits for room in the daemon's queue of connections. With a timeout of Python, it
            # would refuse at once while many clients connect.
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _TIMEVAL.pack(int(TIMEOUT_S), 0))
            self._socket.connect(os.fspath(path))
            self._greet()
        except FileNotFoundError:
            self.close()
            raise NoDaemonError(
                f"no daemon runs at {path}: start one with `hil daemon`, or give --socket its path"
            ) from None
        except ConnectionRefusedError:
            self.close()
            raise NoDaemonError(
                f"no daemon answers at {path}: it is ending, or was killed, or only its socket process was, "
                "which its log says; start one with `hil daemon`, or give --socket its path"
            ) from None
        except OSError as error:
            self.close()
            raise OperationError(f"{path}: cannot connect to the daemon: {_reason(error)}") from None
        except OperationError:
            self.close()
            raise

    def _greet(self) -> None:
        line = self.read(TIMEOUT_S)
        if not line:
            raise ConnectionLostError(
                f"{self._path}: the daemon does not serve this client: it closed the connection"
            )
        greeting = _decode(line, Greeting, self._path) if b'"protocol"' in line else None
        if greeting is None:
            refusal = _decode(line, Answer, self._path).text
            raise OperationError(f"{self._path}: the daemon does not serve this client: {refusal}")
        if (greeting.protocol, greeting.version) != (PROTOCOL, VERSION):
            raise OperationError(
                f"{self._path}: the daemon speaks {greeting.protocol} version {greeting.version} (hil "
                f"{greeting.hil}), this program {PROTOCOL} version {VERSION}; use the same hil for both"
            )

    def ask(self, call: AnyCall) -> Answer:
        """Send a request and return its answer. Raises OperationError."""
        data = encode_line(call)
        if len(data) > MAX_LINE_BYTES:
            raise OperationError(
                f"the request has {len(data)} bytes, limit {MAX_LINE_BYTES}: shorten the file that it sends"
            )
        try:
            self._socket.settimeout(TIMEOUT_S)
            self._socket.sendall(data)
        except OSError as error:
            words = self._last_words()
            if not words:
                raise ConnectionLostError(
                    f"{self._path}: the daemon has closed the connection: {_reason(error)}"
                ) from None
            raise OperationError(f"{self._path}: {words}") from None
        line = self.read(TIMEOUT_S)
        if not line:
            raise ConnectionLostError(f"{self._path}: the daemon closed the connection without an answer")
        return _decode(line, Answer, self._path)

    def read(self, timeout_s: float) -> bytes:
        """Return the next line, or nothing at the end of the connection. Raises OperationError."""
        self._socket.settimeout(timeout_s)
        try:
            while b"\n" not in self._unread:
                data = self._socket.recv(65536)
                if not data:
                    return b""
                self._unread += data
        except ConnectionResetError:
            raise ConnectionLostError(f"{self._path}: the daemon closed the connection") from None
        except OSError as error:
            raise OperationError(f"{self._path}: the daemon does not answer: {_reason(error)}") from None
        line, _, self._unread = self._unread.partition(b"\n")
        return bytes(line)

    def _last_words(self) -> str:
        """Return why the daemon has disconnected this client, or nothing if it has not said so."""
        with contextlib.suppress(OperationError):
            line = self.read(TIMEOUT_S)
            return _decode(line, Answer, self._path).text if line else ""
        return ""

    def close(self) -> None:
        """Disconnect."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _setpoint_texts(setpoint: float | str) -> tuple[str, str]:
    """Return the text of a setpoint, and that of the file that it names. Raises DocumentError."""
    text = setpoint if isinstance(setpoint, str) else f"step:{float(setpoint)!r}@0"
    file = csv_file(text)
    if file is None:
        return text, ""
    table = read_text(Path(file), MAX_TABLE_CHARACTERS)
    if not table.strip():
        raise DocumentError(f"{file}: the file is empty; write one or more rows of {','.join(COLUMNS)}")
    return text, table


def _decode(line: bytes, kind: type[_Kind], path: Path) -> _Kind:
    try:
        return msgspec.json.decode(line, type=kind)
    except ValueError as error:
        raise OperationError(f"{path}: not an answer of a hil daemon: {error}") from None


def _reason(error: OSError) -> str:
    return error.strerror or "timed out"
