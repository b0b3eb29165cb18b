"""The server of the daemon's clients. It runs in the socket process.

What takes long to check, such as a controller, is checked in a thread before the loop gets it
(``request_checks``). A connection has one request under way at a time, so that at most ``MAX_CONNECTIONS``
requests wait for the loop. Whoever sends faster is read more slowly.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from collections import deque

import msgspec

from hil.core.controller_change import PreparedController
from hil.core.errors import HilError
from hil.core.output import LogThrottle, Severity
from hil.core.printable import printable
from hil.operation.peer import check_peer
from hil.operation.pipe import MAX_MESSAGE_BYTES, Asked, Facts, FromLoop, Logged, Replied, StatusNow
from hil.operation.places import Place, Places
from hil.operation.protocol import (
    ALREADY_SHUTTING_DOWN,
    MAX_CONNECTIONS,
    MAX_LINE_BYTES,
    MAX_REQUESTS_PER_S,
    PROTOCOL,
    VERSION,
    WRITE_TIMEOUT_S,
    Answer,
    ControllerCall,
    Greeting,
    LogLine,
    LoopCall,
    RigCall,
    ShutdownCall,
    Status,
    StatusCall,
    Update,
    WatchCall,
    WrongRequestError,
    decode_call,
    encode_line,
)
from hil.operation.request_checks import Checked, CheckedCall, RequestChecks

REPLY_TIMEOUT_S = 15.0
"""Longest wait for the loop's reply. Closing a recording on a slow disk takes longest."""
ENDED = "the daemon ended before it replied"
"""Answer to requests that the loop has not taken when it ends."""
LAST_ANSWERS_S = 0.1
"""Time in which the last answers are sent after the loop has ended."""
BURST_REQUESTS = 50
"""Number of requests that a connection may send at once before its rate is limited."""
MAX_REFUSED_CONNECTIONS = 64
"""Number of surplus connections that are answered at the same time. Others are closed without a word."""
WRITE_BUFFER_BYTES = 64 * 1024
"""Answers that wait for a client beyond the kernel's own buffer."""
LOG_LINES = 256
"""Number of log entries that are kept for watching clients."""


class Server:
    """Serves the clients of ``listener``; passes their requests to the loop at the other end of ``pipe``."""

    def __init__(self, listener: socket.socket, pipe: socket.socket, facts: Facts) -> None:
        self._listener = listener
        self._pipe = pipe
        self._facts = facts
        self._decoder: msgspec.msgpack.Decoder[FromLoop] = msgspec.msgpack.Decoder(FromLoop)
        self._waiting: dict[int, asyncio.Future[Replied]] = {}
        self._number = time.monotonic_ns()  # later than every number of a server that ran before
        self._places = Places(MAX_CONNECTIONS)
        self._refusing = 0
        self._is_checking = asyncio.Lock()
        """Held during a check in another thread, so that no more than one takes processor time."""
        self._status: Status | None = None
        self._log: deque[tuple[int, LogLine]] = deque(maxlen=LOG_LINES)
        self._log_count = 0
        self._checks = RequestChecks(facts)
        self._throttle = LogThrottle()
        self._has_loop_ended = asyncio.Event()
        self._is_shutting_down = False
        """True after the loop's answer to ``shutdown``. It takes no request while it closes the recording."""
        self._tasks: set[asyncio.Task[None]] = set()
        self._writers: set[asyncio.StreamWriter] = set()

    async def run(self) -> None:
        """Serve until the loop closes its end of the pipe."""
        events = asyncio.get_running_loop()
        events.add_reader(self._pipe, self._read_pipe)
        server = await asyncio.start_unix_server(
            self._connected, sock=self._listener, limit=MAX_LINE_BYTES, backlog=MAX_CONNECTIONS
        )
        await self._has_loop_ended.wait()
        events.remove_reader(self._pipe)
        server.close()
        for number, future in self._waiting.items():
            if not future.done():
                future.set_result(Replied(number, False, ENDED))
        await asyncio.sleep(LAST_ANSWERS_S)
        for writer in self._writers:
            writer.transport.abort()
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=LAST_ANSWERS_S)

    # The loop's side

    def _read_pipe(self) -> None:
        try:
            data = self._pipe.recv(MAX_MESSAGE_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._has_loop_ended.set()
            return
        match self._decoder.decode(data):
            case StatusNow(status):
                self._status = status
            case Logged(line):
                self._log_count += 1
                self._log.append((self._log_count, line))
            case Replied(number) as reply:
                future = self._waiting.get(number)
                if future is not None and not future.done():
                    future.set_result(reply)

    async def _ask_loop(self, call: LoopCall, asked_by: str, prepared: Checked) -> Answer:
        self._number += 1
        number = self._number
        controller = prepared if isinstance(prepared, PreparedController) else None
        tables = () if prepared is None or isinstance(prepared, PreparedController) else prepared
        try:
            self._pipe.send(msgspec.msgpack.encode(Asked(number, asked_by, call, controller, tables)))
        except ConnectionError:
            return Answer(id=call.id, accepted=isinstance(call, ShutdownCall), text="the daemon has ended")
        except OSError:  # it is full, or the message is too large for it
            return Answer(
                id=call.id, accepted=False, text="the loop takes no requests at the moment; try again"
            )
        future = self._waiting[number] = asyncio.get_running_loop().create_future()
        try:
            reply = await asyncio.wait_for(future, REPLY_TIMEOUT_S)
        except TimeoutError:
            return Answer(
                id=call.id,
                accepted=False,
                text=f"the loop did not reply within {REPLY_TIMEOUT_S:g} s, and may still take the request: "
                "see `hil status`",
            )
        finally:
            del self._waiting[number]
        if isinstance(call, ShutdownCall):
            if reply.text == ENDED:
                return Answer(id=call.id, accepted=True, text="the daemon has ended")
            self._is_shutting_down = reply.accepted
        return Answer(id=call.id, accepted=reply.accepted, text=reply.text)

    # The clients' side

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        self._writers.add(writer)
        writer.transport.set_write_buffer_limits(high=WRITE_BUFFER_BYTES)
        with contextlib.suppress(OSError, TimeoutError):
            await self._admit(reader, writer)
        self._writers.discard(writer)
        self._tasks.discard(task)
        if writer.transport.get_write_buffer_size() > 0:
            writer.transport.abort()  # the client reads nothing: closing would wait for it
        else:
            writer.close()

    async def _admit(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve a client, or refuse to."""
        peer, refusal = check_peer(writer.get_extra_info("socket"))
        place = None
        if refusal is None:
            place = self._places.take(peer.process_id, time.monotonic(), lambda: _evict(writer))
            refusal = f"{MAX_CONNECTIONS} clients are connected, the limit; disconnect one"
        if place is None:
            if self._refusing < MAX_REFUSED_CONNECTIONS:
                self._refusing += 1
                try:
                    await _write(writer, Answer(id=0, accepted=False, text=refusal))
                finally:
                    self._refusing -= 1
            return
        try:
            await _write(writer, Greeting(PROTOCOL, VERSION, self._facts.hil))
            await self._serve(reader, writer, str(peer), place)
        finally:
            self._places.release(place)

    async def _serve(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, asked_by: str, place: Place
    ) -> None:
        """Answer the requests of a client, one after the other, until it disconnects or sends nonsense."""
        paid_until_s = time.monotonic()
        while True:
            try:
                line = await reader.readuntil(b"\n")
            except asyncio.IncompleteReadError:
                return
            except asyncio.LimitOverrunError:
                text = f"the line is longer than {MAX_LINE_BYTES} bytes, the limit"
                await _write(writer, Answer(id=0, accepted=False, text=text))
                return
            place.active_s = now_s = time.monotonic()
            paid_until_s = max(paid_until_s, now_s - BURST_REQUESTS / MAX_REQUESTS_PER_S)
            paid_until_s += 1.0 / MAX_REQUESTS_PER_S
            await asyncio.sleep(max(paid_until_s - now_s, 0.0))
            try:
                call = decode_call(line)
            except WrongRequestError as error:
                await _write(writer, Answer(id=error.call_id, accepted=False, text=str(error)))
                continue
            except ValueError as error:
                text = f"not a request of {PROTOCOL} version {VERSION}: {error}"
                await _write(writer, Answer(id=0, accepted=False, text=text))
                return
            if isinstance(call, WatchCall):
                await self._watch(reader, writer, call)
                return
            await _write(writer, await self._answer(call, asked_by))

    async def _answer(self, call: StatusCall | RigCall | LoopCall, asked_by: str) -> Answer:
        if isinstance(call, StatusCall):
            if self._status is None:
                return Answer(id=call.id, accepted=False, text="the daemon has not begun its first period")
            return Answer(id=call.id, accepted=True, text=self._status.state, status=self._status)
        if isinstance(call, RigCall):
            return Answer(id=call.id, accepted=True, text=self._facts.rig)
        if isinstance(call, ShutdownCall) and self._is_shutting_down:
            return Answer(id=call.id, accepted=True, text=ALREADY_SHUTTING_DOWN)
        try:
            prepared = None
            if isinstance(call, CheckedCall):
                async with self._is_checking:
                    prepared = await asyncio.to_thread(self._checks.check, call)
        except HilError as error:
            self._log_refusal(asked_by, str(error))
            return Answer(id=call.id, accepted=False, text=str(error))
        if isinstance(call, ControllerCall) and call.only_check:
            return Answer(id=call.id, accepted=True, text=f"controller {call.name} fits")
        return await self._ask_loop(call, asked_by, prepared)

    async def _watch(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, call: WatchCall
    ) -> None:
        """Send an update at every interval until the client disconnects."""
        await _write(writer, Answer(id=call.id, accepted=True, text="watching"))
        seen = self._log_count
        while not (writer.is_closing() or reader.at_eof() or self._has_loop_ended.is_set()):
            if self._status is not None:
                lines = tuple(line for number, line in self._log if number > seen)
                seen = self._log_count
                await _write(writer, Update(msgspec.structs.replace(self._status, log=lines)))
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._has_loop_ended.wait(), call.interval_s)

    def _log_refusal(self, asked_by: str, reason: str) -> None:
        """Give the loop a log entry about a request that it never saw."""
        if self._throttle.should_report("refusal"):
            text = printable(f"{asked_by}: request refused: {reason}")
            line = LogLine(time.time_ns(), int(Severity.WARNING), "operator", text)
            with contextlib.suppress(OSError):
                self._pipe.send(msgspec.msgpack.encode(Logged(line)))


def _evict(writer: asyncio.StreamWriter) -> None:
    """Disconnect a client whose place another process gets."""
    text = f"disconnected: more than {MAX_CONNECTIONS} clients, and this one was idle for longest"
    writer.write(encode_line(Answer(id=0, accepted=False, text=text)))
    if writer.transport.get_write_buffer_size() > 0:
        writer.transport.abort()
    else:
        writer.close()


async def _write(writer: asyncio.StreamWriter, message: msgspec.Struct) -> None:
    """Send a line. Raises TimeoutError if the client does not read, and OSError if it has disconnected."""
    writer.write(encode_line(message))
    await asyncio.wait_for(writer.drain(), WRITE_TIMEOUT_S)
