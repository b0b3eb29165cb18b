"""Passes the requests of a page to a daemon."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from time import monotonic
from typing import Any

import msgspec

from hil.core.errors import OperationError
from hil.operation.client import Client, connect
from hil.operation.protocol import Answer, AnyCall, StopCall, decode_call

ALLOWED = frozenset({"arm", "disarm", "start", "stop", "reset", "setpoint", "controller", "jog"})
"""Requests that a page may make. Recordings, and the end of the daemon, are not among them."""
MOVING = frozenset({"start", "jog"})
"""Requests after which an axis moves."""
MAX_JOG_AGE_S = 0.3
"""Longest time in s from the beat that a jog repeats until the jog is given to the daemon. An older jog is
refused: the button may have been released since."""


class DaemonOperator:
    """Connections to a daemon, whose rules apply. It is used by the thread of an event loop.

    Stop, jogs, and all other requests have a connection and a thread each. So Stop never waits for another
    request, and a jog never for a controller that is checked. Nothing here waits in the event loop.
    """

    def __init__(self, path: str) -> None:
        """``path``: of the daemon's socket. It is connected with the first request."""
        self._stop_lane, self._jog_lane, self._other_lane = (_Lane(Path(path)) for _ in range(3))
        self._stops = 0
        """Number of Stops that were ever asked for."""
        self._last_stop: Future[Answer] | None = None

    def disconnect(self) -> None:
        """Forget the connections to a daemon that has ended; the next request opens another."""
        for lane in (self._stop_lane, self._jog_lane, self._other_lane):
            lane.disconnect()

    async def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Make a request of ``hil.operation.protocol`` and return ``accepted`` and ``text``.

        A jog has the additional key ``beat_s``: the last time of the monotonic clock that the server had sent
        to the page. A Stop cancels all requests that were not given to the daemon before it.

        Raises ValueError if it is no request, or one that a page may not make.
        """
        name = request.get("request")
        if name not in ALLOWED:
            raise ValueError(f"{name!r:.60} is not one of {', '.join(sorted(ALLOWED))}")
        if name == "setpoint" and not str(request.get("setpoint", "")).strip():
            return {"accepted": False, "text": "the setpoint is empty: enter a position, such as 0.05"}
        keys = dict(request)
        beat_s = float(keys.pop("beat_s")) if name == "jog" else monotonic()
        call = decode_call(msgspec.json.encode(keys))
        self._stops += name == "stop"
        stops = self._stops

        def refusal() -> str | None:
            """Return why the request is not given to the daemon now, or None."""
            if self._stops != stops:
                return f"{name} was not given to the daemon: Stop was pressed after it; press it again"
            age_s = monotonic() - beat_s
            if name == "jog" and not 0.0 <= age_s <= MAX_JOG_AGE_S:
                return (
                    f"jog was not given to the daemon: it is {age_s:.1f} s old, limit {MAX_JOG_AGE_S:g} s; "
                    "the connection, the server or the daemon was too slow: press again"
                )
            return None

        try:
            if name == "stop":
                answer = await asyncio.wrap_future(self._stop())
            else:
                lane = self._jog_lane if name == "jog" else self._other_lane
                answer = await asyncio.wrap_future(lane.give(call, refusal))
        except OperationError as error:
            return {"accepted": False, "text": str(error)}
        if answer.accepted and name in MOVING and self._stops != stops:
            self._stop()  # the daemon may have read the Stop, from the other connection, before this request
        return {"accepted": answer.accepted, "text": answer.text}

    def _stop(self) -> Future[Answer]:
        """Give Stop to the daemon. All Stops that wait at the same time are one."""
        if self._last_stop is None or self._last_stop.running() or self._last_stop.done():
            self._last_stop = self._stop_lane.give(StopCall(), lambda: None)
        return self._last_stop


class _Lane:
    """A connection to the daemon, and the thread that gives it one request after the other."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._client: Client | None = None
        self._thread = ThreadPoolExecutor(1)

    def give(self, call: AnyCall, refusal: Callable[[], str | None]) -> Future[Answer]:
        """Give a request to the daemon after those before it. The future can be cancelled until then.

        ``refusal`` is called immediately before; if it returns a text, the request is refused with it. The
        future raises OperationError.
        """
        return self._thread.submit(self._give, call, refusal)

    def disconnect(self) -> None:
        """Close the connection after the requests that wait."""
        self._thread.submit(self._close)

    def _give(self, call: AnyCall, refusal: Callable[[], str | None]) -> Answer:
        is_first_use = self._client is None
        self._client = self._client or connect(self._path)  # may wait for the daemon
        text = refusal()
        if text is not None:
            return Answer(id=call.id, accepted=False, text=text)
        try:
            return self._client.answer_to(call)
        except OperationError:
            self._close()
            # A daemon may close a connection that was idle. Stop can be repeated without harm.
            if isinstance(call, StopCall) and not is_first_use:
                return self._give(call, refusal)
            raise

    def _close(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client = None
