"""The server of the live page: who is answered, and that a viewer cannot do more than look."""

import asyncio
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from tornado.httpclient import HTTPRequest
from tornado.testing import AsyncHTTPTestCase, gen_test
from tornado.web import Application
from tornado.websocket import WebSocketClientConnection, websocket_connect

from hil.live import server
from hil.live.history import History
from hil.live.run import Run
from hil.live.server import RunSource, application

TOKEN = "correct"
RUN = {
    "axes": [["vertical", "m"]],
    "period_s": 0.0112,
    "states": ["offline", "ready", "armed", "running", "fault"],
    "start_ns": 0,
}


class Recorded:
    """An operator that notes what it is asked."""

    def __init__(self) -> None:
        self.asked: list[Mapping[str, Any]] = []

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        self.asked.append(request)
        return {"accepted": True, "text": "done"}


class LivePage(AsyncHTTPTestCase):
    def get_app(self) -> Application:
        self.run_ = Run()
        self.run_.begin(RUN)
        assert self.run_.history is not None
        for _ in range(3):
            self.run_.history.add_row(np.ones(8))
        self.operator: Recorded | None = None
        app = application([], TOKEN, lambda: RunSource(self.run_, self.operator))
        self.hosts: list[str] = app.settings["hosts"]
        return app

    def setUp(self) -> None:
        super().setUp()
        self.host = f"127.0.0.1:{self.get_http_port()}"
        self.hosts.append(self.host)

    def status(self, path: str, host: str | None = None) -> int:
        return int(self.fetch(path, headers={"Host": host or self.host}).code)

    async def viewer(self, token: str = TOKEN, origin: str | None = None) -> WebSocketClientConnection:
        request = HTTPRequest(
            f"ws://{self.host}/stream?token={token}", headers={"Origin": origin or f"http://{self.host}"}
        )
        return await websocket_connect(request)

    def test_the_page_needs_the_token(self) -> None:
        assert self.status(f"/?token={TOKEN}") == 200
        assert self.status("/") == 403
        assert self.status("/?token=wrong") == 403
        assert b"hil live" not in self.fetch("/").body

    def test_a_browser_that_calls_the_server_by_another_name_is_refused(self) -> None:
        for path in (f"/?token={TOKEN}", "/page/live.js", "/library/bokeh.min.js"):
            assert self.status(path) == 200
            assert self.status(path, host="rebound.example") == 403

    def test_no_other_file_is_served(self) -> None:
        for path in ("/page/page.html", "/page/../server.py", "/library/bokeh.js", "/page/%2e%2e/feed.py"):
            assert self.status(path) in (403, 404)

    def test_the_page_loads_nothing_from_elsewhere(self) -> None:
        response = self.fetch(f"/?token={TOKEN}", headers={"Host": self.host})
        assert response.headers["Content-Security-Policy"].startswith("default-src 'self'")
        assert b"http://" not in response.body and b"https://" not in response.body

    @gen_test
    async def test_a_stream_needs_token_and_origin(self) -> None:
        for token, origin in (
            ("wrong", None),
            (TOKEN, "http://evil.example"),
            (TOKEN, "http://127.0.0.1:1"),
        ):
            with pytest.raises(Exception, match="403"):
                await self.viewer(token, origin)

    @gen_test
    async def test_a_viewer_gets_the_run_and_its_rows(self) -> None:
        connection = await self.viewer()
        (viewer,) = self._app.settings["viewers"]
        await viewer.update()
        first = json.loads(str(await connection.read_message()))
        assert first["run"] == RUN and first["may_operate"] is False
        rows: object = ""
        while isinstance(rows, str):
            rows = await connection.read_message()
        assert isinstance(rows, bytes)
        np.testing.assert_array_equal(np.frombuffer(rows), np.ones(24))

    async def answer_to(self, message: str) -> dict[str, Any]:
        connection = await self.viewer()
        (viewer,) = self._app.settings["viewers"]
        await connection.write_message(message)
        while not viewer._answers:
            await asyncio.sleep(0)
        await viewer.update()
        while True:
            received = await connection.read_message()
            if isinstance(received, str) and "reply" in json.loads(received):
                connection.close()
                self._app.settings["viewers"].clear()
                return dict(json.loads(received)["reply"])

    @gen_test
    async def test_a_page_that_only_shows_refuses_requests(self) -> None:
        answer = await self.answer_to('{"request": "stop"}')
        assert answer == {"accepted": False, "text": "this page only shows; start it with --operate"}

    @gen_test
    async def test_garbage_is_answered_with_the_reason(self) -> None:
        for message in ("{", "[1]", '"text"', "\x00"):
            answer = await self.answer_to(message)
            assert not answer["accepted"] and answer["text"].startswith("not a request")

    @gen_test
    async def test_an_operator_is_asked(self) -> None:
        self.operator = Recorded()
        answer = await self.answer_to('{"request": "stop"}')
        assert answer == {"accepted": True, "text": "done"}
        assert self.operator.asked == [{"request": "stop"}]

    @gen_test
    async def test_one_page_too_many_is_refused(self) -> None:
        viewers = [await self.viewer() for _ in range(server.MAX_VIEWERS)]
        with pytest.raises(Exception, match="503"):
            await self.viewer()
        assert len(viewers) == server.MAX_VIEWERS

    @gen_test
    async def test_a_viewer_that_reads_nothing_makes_nothing_grow(self) -> None:
        connection = await self.viewer()
        (viewer,) = self._app.settings["viewers"]
        viewer._is_sending = True  # an update that is still on its way
        assert self.run_.history is not None
        self.run_.history.add_row(np.ones(8))
        await viewer.update()
        assert viewer.source._next_row == 0
        connection.close()


def test_a_message_that_is_read_before_the_run_is_known_is_ignored() -> None:
    run = Run()
    run.take_message(b"P" + bytes(50))
    assert run.history is None


def test_log_entries_count_from_the_run() -> None:
    run = Run()
    run.begin({**RUN, "start_ns": 1_000_000_000})
    run.take_message(json.dumps({"log": [3_500_000_000, 30, "adc", "late"]}).encode())
    assert list(run.log) == [[2.5, 30, "adc", "late"]]
    assert isinstance(run.history, History)
