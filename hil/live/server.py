"""The process that serves the live page: ``python -m hil.live.server DESCRIPTOR``.

It reads its options as JSON from the descriptor. It shows a run, whose feed it reads, or a recording. It can
only show, unless it was given the socket of a daemon.

A browser is answered if it calls the server by one of the names in the options and has the token. A page of
another origin is refused (DNS rebinding, cross-site requests).
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import logging
import os
import socket
import sys
from collections.abc import Mapping
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from time import monotonic
from typing import Any, Protocol
from urllib.parse import urlsplit

import numpy as np
from tornado import httpserver, ioloop, iostream, web, websocket

from hil.core.errors import OperationError
from hil.live.address import WRONG_NAME
from hil.live.current_run import CurrentRun
from hil.live.history import Rows
from hil.live.operator import DaemonOperator
from hil.live.run_source import MAX_ROWS, RunSource

UPDATE_S = 0.03
"""Smallest time between two updates of a viewer. For a run it is a whole number of periods: 30 a second."""
READINGS_S = 1.0
"""Time between two readings of the last steps."""
LAST_UPDATES_S = 1.0
"""Time for which viewers are served after the end of the run."""
MAX_VIEWERS = 16
MAX_ANSWERS = 20
"""Number of answers that wait for a viewer; older ones are dropped."""
MAX_REQUESTS = 20
"""Number of requests of a viewer that wait for their answer. Further ones are refused; Stops are counted
beyond it, up to twice this number."""
MAX_REQUEST_BYTES = 100_000
"""Longest message of a viewer. A controller document fits in."""
MAX_ERROR_CHARACTERS = 300
"""Longest text that says why a message is no request. A longer one is cut off."""
MAX_CONNECTIONS = 256
"""Number of open connections, of viewers and others."""
REQUEST_TIMEOUT_S = 30.0
"""Time in which a new connection must send its request."""
CONTENT_SECURITY = "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:"
PAGE_FOLDER = Path(__file__).parent / "page"
LIBRARY_FILES = ("bokeh.min.js", "bokeh-api.min.js")


class Source(Protocol):
    """Where the data of one viewer come from."""

    def begin(self) -> list[dict[str, Any]]:
        """Return the messages with which a viewer begins."""

    def take(self) -> tuple[list[dict[str, Any]], Rows]:
        """Return messages and rows that are new since the last call."""

    async def request(self, request: Mapping[str, Any]) -> dict[str, Any] | None:
        """Take a request of the viewer; return an answer or None."""


class Viewer(websocket.WebSocketHandler):
    """One page that is open in a browser."""

    async def prepare(self) -> None:
        """Refuse a viewer without the token, by another name, or one too many."""
        refuse_foreigners(self)
        if not has_token(self):
            raise web.HTTPError(403, reason="the token in the address is missing or wrong")
        if len(self.application.settings["viewers"]) >= MAX_VIEWERS:
            raise web.HTTPError(503, reason=f"{MAX_VIEWERS} pages are open already")

    def check_origin(self, origin: str) -> bool:
        """Accept only pages of this server."""
        parts = urlsplit(origin)
        return parts.scheme == "http" and parts.netloc in self.application.settings["hosts"]

    def open(self, *_args: str, **_kwargs: str) -> None:
        """Begin to send."""
        self.set_nodelay(True)
        self.source: Source = self.application.settings["make_source"]()
        self._answers: list[dict[str, Any]] = []
        self._is_sending = False
        self._is_first = True
        self._requests: dict[asyncio.Task[None], object] = {}
        """Names of the requests that wait for their answer."""
        self.application.settings["viewers"].add(self)

    def on_close(self) -> None:
        """Forget the viewer, and its jogs that were not given to the daemon yet."""
        self.application.settings["viewers"].discard(self)
        for task, name in self._requests.items():
            if name == "jog":
                task.cancel()

    def on_message(self, message: str | bytes) -> None:
        """Take a request of the page. What is no request is answered with the reason.

        The next message is read at once: a Stop must not wait for the answer to an earlier request.
        """
        request: Any = None
        try:
            request = json.loads(message)
            if not isinstance(request, dict):
                raise ValueError("a request is a JSON object")
        except (ValueError, RecursionError) as error:
            self._add_answer(request, _refusal(f"not a request: {error}"))
            return
        name = request.get("request")
        if len(self._requests) >= MAX_REQUESTS * (2 if name == "stop" else 1):
            text = f"{MAX_REQUESTS} requests of this page wait for their answer, the limit; try again later"
            self._add_answer(request, _refusal(text))
            return
        task = asyncio.create_task(self._serve(request))
        self._requests[task] = name
        task.add_done_callback(lambda done: self._requests.pop(done, None))

    async def _serve(self, request: dict[str, Any]) -> None:
        """Let the source take a request, and send its answer."""
        try:
            answer = await self.source.request(request)
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            answer = _refusal(f"not a request: {error}")
        if answer is not None:
            self._add_answer(request, answer)

    def _add_answer(self, request: object, answer: dict[str, Any]) -> None:
        """Send an answer as soon as possible. It has the request's ``id``, if that is a number."""
        if isinstance(request, dict) and isinstance(request.get("id"), int):
            answer["id"] = request["id"]
        self._answers = [*self._answers[-MAX_ANSWERS:], answer]
        ioloop.IOLoop.current().add_callback(self.update)

    async def update(self) -> None:
        """Send what is new, unless the last update is still on its way: a slow viewer loses rows.

        A source always has a message, by which a page notices that the server lives.
        """
        if self._is_sending:
            return
        self._is_sending = True
        try:
            messages, rows = self.source.take()
            answers, self._answers = self._answers, []
            messages += answers
            if self._is_first:
                messages = self.source.begin() + messages
                self._is_first = False
            await self.write_message(json.dumps(messages))
            for begin in range(0, len(rows), MAX_ROWS):
                part = np.ascontiguousarray(rows[begin : begin + MAX_ROWS])
                await self.write_message(part.tobytes(), binary=True)
        except websocket.WebSocketClosedError:
            self.application.settings["viewers"].discard(self)
        finally:
            self._is_sending = False


def _refusal(text: str) -> dict[str, Any]:
    """Return the answer to a message that is refused."""
    return {"reply": {"accepted": False, "text": text[:MAX_ERROR_CHARACTERS]}}


class Page(web.RequestHandler):
    """The page itself, for whoever has the token."""

    def get(self) -> None:
        """Send the page, or say where its address is found."""
        refuse_foreigners(self)
        self.set_header("Content-Security-Policy", CONTENT_SECURITY)
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("Cache-Control", "no-store")
        if not has_token(self):
            self.set_status(403)
            self.write("The token is missing or wrong: open the address that the command has printed.")
            return
        self.write((PAGE_FOLDER / "page.html").read_bytes())


class PageFile(web.StaticFileHandler):
    """Scripts and styles of the page, which contain nothing about the run."""

    def prepare(self) -> None:
        """Refuse a request by another name."""
        refuse_foreigners(self)


def refuse_foreigners(handler: web.RequestHandler) -> None:
    """Raise an error if the browser calls the server by a name that is not its own."""
    if handler.request.headers.get("Host") not in handler.application.settings["hosts"]:
        raise web.HTTPError(403, reason=WRONG_NAME)


def has_token(handler: web.RequestHandler) -> bool:
    """Return whether the request has the token."""
    given = handler.get_query_argument("token", "")
    return hmac.compare_digest(given.encode(), handler.application.settings["token"].encode())


class Server(httpserver.HTTPServer):
    """The HTTP server, with a limit of open connections."""

    def handle_stream(self, stream: iostream.IOStream, address: tuple[str, int]) -> None:
        """Serve a connection, or close it if too many are open."""
        if len(self._connections) >= MAX_CONNECTIONS:
            stream.close()
        else:
            super().handle_stream(stream, address)


def application(hosts: list[str], token: str, make_source: object) -> web.Application:
    """Return the server's application."""
    bokeh = find_spec("bokeh")
    assert bokeh is not None and bokeh.origin is not None
    library = str(Path(bokeh.origin).parent / "server" / "static" / "js")
    names = "|".join(name.replace(".", r"\.") for name in LIBRARY_FILES)
    return web.Application(
        [
            (r"/", Page),
            (r"/stream", Viewer),
            (rf"/library/({names})", PageFile, {"path": library}),
            (
                r"/page/((?:live|chart|connection|jog)\.js|live\.css)",
                PageFile,
                {"path": str(PAGE_FOLDER)},
            ),
        ],
        hosts=hosts,
        token=token,
        make_source=make_source,
        viewers=set(),
        websocket_max_message_size=MAX_REQUEST_BYTES,
        websocket_ping_interval=20,
    )


def serve(options: dict[str, Any]) -> None:
    """Serve until the run has ended, or until the process is killed."""
    loop = ioloop.IOLoop.current()
    if options["recording"] is not None:
        from hil.live.playback import Playback, PlaybackSource

        playback = Playback([Path(name) for name in options["recording"]], *options["range_s"])
        app = application(options["hosts"], options["token"], lambda: PlaybackSource(playback))
        ioloop.PeriodicCallback(partial(_update_viewers, app), UPDATE_S * 1e3).start()
    else:
        operator = None if options["operate"] is None else DaemonOperator(options["operate"])
        current = CurrentRun(Path(options["feed"]), is_followed=options["is_followed"])
        app = application(options["hosts"], options["token"], lambda: RunSource(current, operator))
        loop.add_callback(RunUpdates(app, current, operator, loop).update)
    server = Server(app, max_header_size=16384, max_body_size=0, idle_connection_timeout=REQUEST_TIMEOUT_S)
    server.add_socket(socket.socket(fileno=options["listen"]))
    loop.start()


class RunUpdates:
    """Takes what is new of the run and sends it to the viewers, while the loop waits for its deadline."""

    def __init__(
        self,
        app: web.Application,
        current: CurrentRun,
        operator: DaemonOperator | None,
        loop: ioloop.IOLoop,
    ) -> None:
        self._app = app
        self._current = current
        self._operator = operator
        self._loop = loop
        self._next_readings_s = 0.0

    def update(self) -> None:
        """Plan the next update and make this one. After the last run, stop."""
        current, now_s = self._current, monotonic()
        self._loop.call_later(current.run.until_idle_s(now_s, UPDATE_S), self.update)
        was_over = current.run.is_over
        if current.update() and self._operator is not None:
            self._operator.disconnect()
        _update_viewers(self._app)
        if now_s >= self._next_readings_s:
            self._next_readings_s = now_s + READINGS_S
            self._loop.add_callback(self._update_readings)  # after the viewers
        if current.run.is_over and not was_over and not current.is_followed:
            self._loop.call_later(LAST_UPDATES_S, self._loop.stop)

    def _update_readings(self) -> None:
        if self._app.settings["viewers"] and not self._current.run.is_over:
            self._current.run.update_readings()


def _update_viewers(app: web.Application) -> None:
    loop = ioloop.IOLoop.current()
    for viewer in list(app.settings["viewers"]):
        loop.add_callback(viewer.update)


def be_quiet() -> None:
    """Print nothing about requests: what a viewer sends is not the user's concern."""
    for name in ("tornado.access", "tornado.general"):
        logging.getLogger(name).setLevel(logging.CRITICAL)


def main(descriptor: int) -> None:
    """Read the options from ``descriptor`` and serve."""
    os.nice(5)
    be_quiet()
    with open(descriptor) as pipe:
        options = json.load(pipe)
    with contextlib.suppress(OperationError):  # The run has ended before this process began.
        serve(options)


if __name__ == "__main__":
    main(int(sys.argv[1]))
