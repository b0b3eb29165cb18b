"""The page after a loss of its connection: it says so, tries again, and shows no old data as the present."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from time import monotonic_ns

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect
from support.live_feeds import PERIOD_NS, cycle, gateway, make_feed, write_periods
from support.recorded_runs import wait_until

from hil.cli import main
from hil.live.address import Address, open_address
from hil.live.feed import STATUS_PERIODS, LiveFeed
from hil.live.process import start_page_server
from hil.operation.protocol import PROTOCOL, VERSION, Answer, Greeting, decode_call, encode_line

pytestmark = pytest.mark.real_time

HIL = [sys.executable, "-m", "hil.cli"]
WAIT_MS = 60_000


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """Give an empty page; an error of a script fails the test."""
    page = browser.new_page(viewport={"width": 1366, "height": 900}, bypass_csp=True)
    page.set_default_timeout(WAIT_MS)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    yield page
    page.close()
    assert errors == []


class Served:
    """A feed that a test writes, and the process that serves it, which may be started again."""

    def __init__(self, socket_path: Path) -> None:
        self.feed: LiveFeed = make_feed()
        self.address: Address = open_address()
        self._socket_path = socket_path
        self.start()

    def start(self, token: str | None = None) -> None:
        address = self.address if token is None else dataclasses.replace(self.address, token=token)
        self._process = start_page_server(address, feed=self.feed.path, operator_socket=self._socket_path)

    def send_signal(self, number: signal.Signals) -> None:
        os.kill(self._process.pid, number)

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def write(self, *numbers: int) -> None:
        """Write periods, which are old: the page's second 0 is the start of the machine."""
        write_periods(self.feed, *numbers)
        self.feed.cycle(cycle(STATUS_PERIODS), gateway())

    def write_now_until(self, is_seen: Callable[[], bool]) -> None:
        """Write the period of the present again and again until the page shows something."""
        while not is_seen():
            write_periods(self.feed, monotonic_ns() // PERIOD_NS)

    def close(self) -> None:
        self.kill()
        self.address.listener.close()
        self.feed.close()


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    made = Served(tmp_path / "no-daemon")
    yield made
    made.close()


def open_page(page: Page, served: Served, periods: int) -> None:
    served.write(*range(periods))
    page.goto(served.address.url)
    page.wait_for_function(f"hilLive.drawn === {periods}", timeout=WAIT_MS)


def test_a_lost_connection_is_shown_and_opened_again(page: Page, served: Served) -> None:
    open_page(page, served, 200)
    served.kill()
    state, trouble, stop = page.locator("#state"), page.locator("#connection"), page.locator("#stop")
    expect(state).to_have_text("connection lost", timeout=WAIT_MS)
    expect(trouble).to_contain_text("Connection lost, trying again.")
    expect(trouble).to_contain_text(re.compile(r"The last data are from .*\d.*, \d+ (s|min|h) ago"))
    expect(stop).to_have_text("Stop: no connection")
    expect(page.locator(".chart h3").first).to_contain_text("measured –")
    page.keyboard.press("Escape")
    expect(page.locator("#reply")).to_contain_text(
        "stop was not sent: no connection. Use `hil stop` in a terminal, or the emergency stop"
    )
    page.wait_for_function("hilLive.charts[0].figure.x_range.end > hilLive.rows.last + 1", timeout=WAIT_MS)
    served.write(*range(200, 300))
    served.start()
    page.wait_for_function("hilLive.rows.length === 300", timeout=WAIT_MS)  # also what came meanwhile, once
    expect(state).not_to_have_text("connection lost")
    expect(stop).to_have_text("Stop")
    expect(state).to_have_text(
        "no data", timeout=WAIT_MS
    )  # the periods are old, although they have come just now
    served.write_now_until(lambda: state.inner_text() == "running" and not trouble.is_visible())
    expect(page.get_by_role("button", name="Arm", exact=True)).to_have_count(1)  # not built twice


def test_missing_periods_are_a_gap_and_no_line(page: Page, served: Served) -> None:
    open_page(page, served, 100)
    served.write(*range(300, 400))
    page.wait_for_function("hilLive.drawn === 200", timeout=WAIT_MS)
    for points in (10_000, 20):  # every period, and only the lowest and highest value of parts
        times, values = page.evaluate(
            f"""(() => {{ const {{ rows, charts: [chart] }} = hilLive;
                const curve = rows.cut(rows.begin, rows.end, chart.values[1], {points});
                return [curve.t, curve.v]; }})()"""
        )
        between = [v for t, v in zip(times, values, strict=True) if 98.5 * 0.0112 < t < 299.5 * 0.0112]
        assert np.isnan(between[-1])
        assert max(times) == pytest.approx(399 * 0.0112)


def test_a_server_or_loop_that_hangs_is_not_shown_as_the_present(page: Page, served: Served) -> None:
    open_page(page, served, 100)
    state, trouble = page.locator("#state"), page.locator("#connection")
    expect(state).to_have_text("no data", timeout=WAIT_MS)
    expect(trouble).to_contain_text("The loop sends no data.")
    served.send_signal(signal.SIGSTOP)
    try:
        expect(trouble).to_contain_text("The server does not answer.", timeout=WAIT_MS)
        expect(state).to_have_text("connection lost", timeout=WAIT_MS)
    finally:
        served.send_signal(signal.SIGCONT)
    served.write(*range(100, 200))
    page.wait_for_function("hilLive.rows.length === 200", timeout=WAIT_MS)
    expect(page.locator("#stop")).to_have_text("Stop")


def test_a_stop_without_an_answer_is_reported(page: Page, served: Served) -> None:
    open_page(page, served, 100)
    served.send_signal(signal.SIGSTOP)
    try:
        page.keyboard.press("Escape")  # also after the connection was given up, on a slow machine
        expect(page.locator("#reply")).to_contain_text(
            re.compile(
                r"stop(: (no answer for 2 s|the connection was lost before the answer)\. It may have been "
                r"done or not| was not sent: no connection)\. Use `hil stop` in a terminal, or the emergency"
            ),
            timeout=WAIT_MS,
        )
    finally:
        served.send_signal(signal.SIGCONT)


class JoggedDaemon:
    """A daemon that accepts and counts every request."""

    def __init__(self, path: Path) -> None:
        self.requests: list[str] = []
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(path))
        self._listener.listen()
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with connection, connection.makefile("rwb") as lines:
            lines.write(encode_line(Greeting(PROTOCOL, VERSION, "test")))
            lines.flush()
            for line in lines:
                call = decode_call(line)
                self.requests.append(json.loads(line)["request"])
                lines.write(encode_line(Answer(id=call.id, accepted=True, text="done")))
                lines.flush()

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()


def test_a_jog_that_was_held_while_the_server_was_suspended_is_not_given_later(
    page: Page, served: Served, tmp_path: Path
) -> None:
    daemon = JoggedDaemon(tmp_path / "no-daemon")
    sent: list[str] = []

    def note(data: str | bytes) -> None:
        if "jog" in str(data):
            sent.append(str(data))

    page.on("websocket", lambda opened: opened.on("framesent", note))
    open_page(page, served, 100)
    jog = page.get_by_role("button", name="Hold to jog")
    jog.dispatch_event("pointerdown")
    wait_until(
        lambda: bool(page.evaluate("jog.isHeld")) and daemon.requests.count("jog") >= 3, "three jogs", 60.0
    )
    jog.dispatch_event("pointerup")
    page.wait_for_function("jog.waitingId === 0")
    given, before = daemon.requests.count("jog"), len(sent)
    served.send_signal(signal.SIGSTOP)
    try:
        jog.dispatch_event("pointerdown")
        expect(page.locator("#trouble")).to_contain_text("The server does not answer.", timeout=WAIT_MS)
        jog.dispatch_event("pointerup")
        assert len(sent) == before + 1  # the next one waits for the answer
    finally:
        served.send_signal(signal.SIGCONT)
    page.wait_for_function("jog.waitingId === 0")
    refused = re.compile("jog(: the connection was lost| was not given to the daemon: it is)")
    expect(page.locator("#reply")).to_contain_text(refused)
    expect(page.locator("#stop")).to_have_text("Stop", timeout=WAIT_MS)
    page.keyboard.press("Escape")
    wait_until(lambda: bool(page.evaluate("true")) and "stop" in daemon.requests, "the Stop", 60.0)
    assert daemon.requests.count("jog") == given
    daemon.close()


def test_another_token_is_explained(page: Page, served: Served) -> None:
    open_page(page, served, 100)
    served.kill()
    served.start("another")
    expect(page.locator("#connection")).to_contain_text(
        "the command that serves the page was restarted. Open the new address that it printed.",
        timeout=WAIT_MS,
    )


def test_hil_live_shows_the_next_run_of_a_daemon(page: Page, tmp_path: Path) -> None:
    at = str(tmp_path / "socket")
    with contextlib.ExitStack() as stack:

        def start(*arguments: str) -> tuple[subprocess.Popen[str], str]:
            """Start a command; return it and the first line that it prints."""
            process = subprocess.Popen([*HIL, *arguments, "--socket", at], stdout=subprocess.PIPE, text=True)
            stack.enter_context(process)
            stack.callback(process.kill)
            assert process.stdout is not None
            return process, process.stdout.readline().strip()

        daemon = ["daemon", "--foxglove", "0", "--no-record"]
        first, _ = start(*daemon)
        shown, address = start("live", "--operate")
        page.goto(address)
        state, reply = page.locator("#state"), page.locator("#reply")
        expect(state).to_have_text("ready", timeout=WAIT_MS)
        page.get_by_role("button", name="Arm", exact=True).click()
        expect(state).to_have_text("armed", timeout=WAIT_MS)
        start_ns = page.evaluate("hilLive.run.start_ns")
        first.kill()  # its link stays
        first.wait()
        expect(state).to_have_text("waiting for a daemon", timeout=WAIT_MS)
        second, _ = start(*daemon)
        expect(state).to_have_text("ready", timeout=WAIT_MS)
        assert page.evaluate("hilLive.run.start_ns") > start_ns
        page.wait_for_function("hilLive.rows.length > 100", timeout=WAIT_MS)
        page.get_by_role("button", name="Arm", exact=True).click()
        expect(state).to_have_text("armed", timeout=WAIT_MS)  # with the first request
        expect(reply).not_to_contain_text("ended")
        assert main(["shutdown", "--socket", at]) == 0
        assert second.wait() == 0
        expect(state).to_have_text("waiting for a daemon", timeout=WAIT_MS)
        shown.terminate()
        assert shown.wait() == 128 + signal.SIGTERM
