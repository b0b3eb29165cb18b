"""The server of the live page: who is answered, and that a viewer cannot do more than look."""

import asyncio
import json
from collections.abc import Mapping
from typing import Any
from unittest import mock

import numpy as np
import pytest
from support.live_feeds import cycle, gateway, make_feed, write_periods
from tornado.httpclient import HTTPRequest
from tornado.testing import AsyncHTTPTestCase, gen_test
from tornado.web import Application
from tornado.websocket import WebSocketClientConnection, websocket_connect

from hil.live import run_source, server
from hil.live.current_run import CurrentRun
from hil.live.feed import STATUS_PERIODS
from hil.live.run import MISSED
from hil.live.run_source import MAX_ROWS, RunSource
from hil.live.server import LAST_UPDATES_S, RunUpdates, application

TOKEN = "correct"
patient = gen_test(timeout=60.0)
"""A test of the event loop, which a loaded machine may make slow."""


class Recorded:
    """An operator that notes what it is asked."""

    def __init__(self) -> None:
        self.asked: list[Mapping[str, Any]] = []

    async def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        self.asked.append(request)
        return {"accepted": True, "text": "done"}


class Hung:
    """An operator that answers only Stop."""

    def __init__(self) -> None:
        self.cancelled: list[object] = []

    async def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        try:
            if request["request"] != "stop":
                await asyncio.Event().wait()
        except asyncio.CancelledError:
            self.cancelled.append(request["request"])
            raise
        return {"accepted": True, "text": "stopped"}


class LivePage(AsyncHTTPTestCase):
    def get_app(self) -> Application:
        self.feed = make_feed()
        self.current = CurrentRun(self.feed.path, is_followed=False)
        self.run_ = self.current.run
        write_periods(self.feed, 1, 2, 3)
        self.run_.update()
        self.operator: Recorded | Hung | None = None
        app = application([], TOKEN, lambda: RunSource(self.current, self.operator))
        self.hosts: list[str] = app.settings["hosts"]
        return app

    def setUp(self) -> None:
        super().setUp()
        self.host = f"127.0.0.1:{self.get_http_port()}"
        self.hosts.append(self.host)

    def tearDown(self) -> None:
        super().tearDown()
        self.feed.close()

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

    @patient
    async def test_a_stream_needs_token_and_origin(self) -> None:
        for token, origin in (
            ("wrong", None),
            (TOKEN, "http://evil.example"),
            (TOKEN, "http://127.0.0.1:1"),
        ):
            with pytest.raises(Exception, match="403"):
                await self.viewer(token, origin)

    @patient
    async def test_a_viewer_gets_the_run_and_its_rows(self) -> None:
        connection = await self.viewer()
        (viewer,) = self._app.settings["viewers"]
        await viewer.update()
        messages = json.loads(str(await connection.read_message()))
        assert messages[0]["run"]["axes"] == [["vertical", "m"]] and messages[0]["may_operate"] is False
        assert "rig_text" not in messages[0]["run"]
        rows = await connection.read_message()
        assert isinstance(rows, bytes)
        np.testing.assert_array_equal(np.frombuffer(rows).reshape(3, 8), self.run_.history.since(0))

    @patient
    async def test_an_update_is_at_most_two_messages(self) -> None:
        connection = await self.viewer()
        (viewer,) = self._app.settings["viewers"]
        await viewer.update()
        self.run_.log.append([0.0, 20, "a", "b"])
        self.run_.log_end += 1
        self.run_.status, self.run_.readings, self.run_.bus = {"counts": {}}, {"a": {}}, {"bus load": "1 %"}
        write_periods(self.feed, 4)
        self.run_.update()
        await viewer.update()
        received = [await connection.read_message() for _ in range(4)]
        assert [type(message) for message in received] == [str, bytes, str, bytes]
        assert [list(message) for message in json.loads(str(received[2]))] == [
            ["log"],
            ["status"],
            ["bus"],
            ["readings"],
            ["beat_s", "age_s", "is_behind"],
        ]

    async def answer_to(self, message: str) -> dict[str, Any]:
        connection = await self.viewer()
        await connection.write_message(message)
        answer = await self.next_answer(connection)
        connection.close()
        self._app.settings["viewers"].clear()
        return dict(answer["reply"])

    async def next_answer(self, connection: WebSocketClientConnection) -> dict[str, Any]:
        """Return the next message with an answer. The server sends it at once."""
        while True:
            received = await connection.read_message()
            assert received is not None
            replies = [m for m in json.loads(received) if "reply" in m] if isinstance(received, str) else []
            if replies:
                return dict(replies[0])

    @patient
    async def test_a_page_that_only_shows_refuses_requests(self) -> None:
        answer = await self.answer_to('{"request": "stop"}')
        assert answer == {"accepted": False, "text": "this page only shows; start it with --operate"}

    @patient
    async def test_garbage_is_answered_with_the_reason(self) -> None:
        for message in ("{", "[1]", '"text"', "\x00", "[" * 50_000, '{"speed": 1' + 400 * "0" + "}"):
            answer = await self.answer_to(message)
            assert not answer["accepted"]
            assert answer["text"].startswith(("not a request", "this page only shows"))

    @patient
    async def test_an_operator_is_asked(self) -> None:
        self.operator = Recorded()
        answer = await self.answer_to('{"request": "stop"}')
        assert answer == {"accepted": True, "text": "done"}
        assert self.operator.asked == [{"request": "stop"}]

    @patient
    async def test_one_page_too_many_is_refused(self) -> None:
        viewers = [await self.viewer() for _ in range(server.MAX_VIEWERS)]
        with pytest.raises(Exception, match="503"):
            await self.viewer()
        assert len(viewers) == server.MAX_VIEWERS

    @patient
    async def test_a_viewer_that_reads_nothing_makes_nothing_grow(self) -> None:
        connection = await self.viewer()
        (viewer,) = self._app.settings["viewers"]
        viewer._is_sending = True  # an update that is still on its way
        write_periods(self.feed, 4)
        self.run_.update()
        await viewer.update()
        assert viewer.source._next_row == 0
        connection.close()

    @patient
    async def test_a_viewer_that_was_too_slow_is_told_how_many_periods_it_missed(self) -> None:
        connection = await self.viewer()
        (viewer,) = self._app.settings["viewers"]
        await viewer.update()
        assert len(await self.rows_of(connection)) == 3
        capacity = len(self.run_.history._rows)
        for begin in range(4, 4 + capacity + 7, capacity // 2):
            write_periods(self.feed, *range(begin, min(begin + capacity // 2, 4 + capacity + 7)))
            self.feed.cycle(cycle(STATUS_PERIODS), gateway())
            self.run_.update()  # as the server does, while this viewer is suspended
        await viewer.update()
        messages = json.loads(str(await connection.read_message()))
        (status,) = [message["status"] for message in messages if "status" in message]
        assert status["counts"][MISSED] == 7
        rows = await self.rows_of(connection)
        assert len(rows) == MAX_ROWS  # the most that waits for a viewer
        assert rows[0, 0] == pytest.approx(11 * 0.0112)
        connection.close()

    async def rows_of(self, connection: WebSocketClientConnection) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Return the rows of the next message that has some."""
        message: object = ""
        while not isinstance(message, bytes):
            message = await connection.read_message()
            assert message is not None
        return np.frombuffer(message).reshape(-1, 8)

    async def beat_of(self, connection: WebSocketClientConnection) -> dict[str, Any]:
        """Return the next message about the age of the data."""
        while True:
            message = await connection.read_message()
            assert message is not None
            beats = [m for m in json.loads(message) if "beat_s" in m] if isinstance(message, str) else []
            if beats:
                return dict(beats[0])

    @patient
    async def test_a_page_is_told_that_the_server_lives_although_no_data_come(self) -> None:
        connection = await self.viewer()
        (viewer,) = self._app.settings["viewers"]
        for now_s in (100.0, 100.05):
            with mock.patch.object(run_source, "monotonic", lambda now_s=now_s: now_s):
                await viewer.update()
            assert (await self.beat_of(connection))["beat_s"] == now_s
        connection.close()

    @patient
    async def test_data_of_a_feed_that_stands_still_are_old_from_the_first_message_on(self) -> None:
        last_s = 3 * 0.0112  # the page's second 0 is that of the clock
        with mock.patch.object(run_source, "monotonic", lambda: last_s + 600.0):
            connection = await self.viewer()
            (viewer,) = self._app.settings["viewers"]
            await viewer.update()
        assert (await self.beat_of(connection))["age_s"] == pytest.approx(600.0)
        connection.close()

    @patient
    async def test_an_answer_has_the_number_of_the_request(self) -> None:
        self.operator = Recorded()
        connection = await self.viewer()
        await connection.write_message('{"request": "stop", "id": 7}')
        assert (await self.next_answer(connection))["id"] == 7
        connection.close()

    @patient
    async def test_stop_does_not_wait_for_an_earlier_request_of_the_same_page(self) -> None:
        self.operator = Hung()
        connection = await self.viewer()
        await connection.write_message('{"request": "controller", "id": 1}')
        await connection.write_message('{"request": "stop", "id": 2}')
        assert await self.next_answer(connection) == {
            "reply": {"accepted": True, "text": "stopped"},
            "id": 2,
        }
        connection.close()

    @patient
    async def test_of_the_requests_that_wait_the_number_is_limited_but_stop_is_answered(self) -> None:
        self.operator = Hung()
        connection = await self.viewer()
        for number in range(server.MAX_REQUESTS + 1):
            await connection.write_message(json.dumps({"request": "arm", "id": number}))
        answer = await self.next_answer(connection)
        assert answer["id"] == server.MAX_REQUESTS
        assert answer["reply"]["text"].startswith("20 requests of this page wait for their answer")
        await connection.write_message('{"request": "stop", "id": 99}')
        assert (await self.next_answer(connection))["id"] == 99
        connection.close()

    @patient
    async def test_jogs_of_a_page_that_was_closed_are_dropped(self) -> None:
        self.operator = Hung()
        connection = await self.viewer()
        (viewer,) = self._app.settings["viewers"]
        await connection.write_message('{"request": "start"}')
        await connection.write_message('{"request": "jog"}')
        while len(viewer._requests) < 2:
            await asyncio.sleep(0)
        connection.close()
        while not self.operator.cancelled:
            await asyncio.sleep(0)
        assert self.operator.cancelled == ["jog"]


def updates_of(current: mock.Mock, viewers: set[object], operator: mock.Mock | None = None) -> RunUpdates:
    app = mock.Mock(settings={"viewers": viewers})
    current.run.until_idle_s.return_value = 0.0336
    return RunUpdates(app, current, operator, mock.Mock())


def test_an_update_that_fails_does_not_end_the_updates() -> None:
    current = mock.Mock()
    current.update.side_effect = OSError("no room")
    updates = updates_of(current, set())
    with pytest.raises(OSError, match="no room"):
        updates.update()
    updates._loop.call_later.assert_called_once_with(0.0336, updates.update)  # type: ignore[attr-defined]


def test_readings_are_made_once_a_second_and_for_viewers_alone() -> None:
    current = mock.Mock(is_followed=True)
    current.run.is_over = False
    updates = updates_of(current, set())
    for _ in range(3):
        updates.update()
    updates._loop.add_callback.assert_called_once_with(updates._update_readings)  # type: ignore[attr-defined]
    updates._update_readings()
    current.run.update_readings.assert_not_called()
    updates._app.settings["viewers"].add(object())
    updates._update_readings()
    current.run.update_readings.assert_called_once_with()


def test_after_the_last_run_the_server_stops_and_the_operator_is_released() -> None:
    current, operator = mock.Mock(is_followed=False), mock.Mock()
    current.run.is_over = False

    def end() -> bool:
        current.run.is_over = True
        return True

    current.update.side_effect = end
    updates = updates_of(current, set(), operator)
    updates.update()
    operator.disconnect.assert_called_once_with()
    stop = mock.call(LAST_UPDATES_S, updates._loop.stop)
    assert stop in updates._loop.call_later.call_args_list  # type: ignore[attr-defined]
