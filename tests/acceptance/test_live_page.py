"""The live page in a real browser: what is drawn is what is recorded."""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

import hil
from hil.cli import main
from hil.live.history import COLUMNS

pytestmark = pytest.mark.real_time

HIL = [sys.executable, "-m", "hil.cli"]
PHONE = {"width": 390, "height": 844}
LAPTOP = {"width": 1366, "height": 768}
TALL = {"width": 1366, "height": 1600}


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    chromium = shutil.which("chromium")
    assert chromium is not None, "install the Debian package chromium"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """Give an empty page; an error of a script fails the test.

    The page's content security policy is off: it forbids the expressions that the tests wait for.
    """
    page = browser.new_page(viewport=TALL, bypass_csp=True)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    yield page
    page.close()
    assert errors == []


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("live") / "run.mcap"
    assert main(["run", "--lockstep", "--duration", "20", "--record", str(path)]) == 0
    return path


@pytest.fixture(scope="module")
def playing(recorded: Path) -> Iterator[str]:
    """Give the address of a page that plays the recording."""
    with subprocess.Popen([*HIL, "live", str(recorded)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
        process.terminate()


def numbers(values: list[float | None]) -> np.ndarray[Any, Any]:
    return np.array([np.nan if value is None else value for value in values], float)


def contents_of(
    page: Page,
) -> tuple[np.ndarray[Any, Any], list[tuple[list[int], list[dict[str, list[float]]]]], int]:
    """Return the rows that the page has, columns and curves of its charts, and its time 0 in ns."""
    width, values, charts, start_ns = page.evaluate(
        """[hilLive.rows.width, Array.from(hilLive.rows.data.slice(0, hilLive.rows.end * hilLive.rows.width)),
            hilLive.charts.filter((chart) => chart.isVisible).map((chart) =>
                [chart.columns, chart.sources.map((source) => source.data)]), hilLive.run.start_ns]"""
    )
    return numbers(values).reshape(-1, width), charts, start_ns


def test_what_is_drawn_is_what_is_recorded(page: Page, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    command = [*HIL, "run", "--live", "--duration", "300", "--record", str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        address = re.sub("^page: ", "", process.stdout.readline().strip())
        page.goto(address)
        page.wait_for_function("hilLive.drawn > 300", timeout=60_000)
        rows, charts, start_ns = contents_of(page)
        process.send_signal(signal.SIGINT)
        process.stdout.read()
        page.wait_for_function("document.getElementById('state').textContent === 'run has ended'")
    assert process.returncode == 0
    recording = hil.open_recording(path)
    timing = recording.timing()
    deadline_ns = np.round(rows[:, 0] * 1e9).astype(np.int64) + start_ns
    place = np.searchsorted(timing.deadline_ns, deadline_ns)
    np.testing.assert_array_equal(timing.deadline_ns[place], deadline_ns)
    for index, name in enumerate(recording.axes):
        axis = recording.axis(name)[place]
        columns = rows[:, len(COLUMNS) + 3 * index :][:, :3]
        np.testing.assert_array_equal(columns.T, [axis.setpoint, axis.position, axis.command_v])
    assert len(charts) == 6  # position and valve of three axes
    for columns, curves in charts:
        for column, curve in zip(columns, curves, strict=True):
            times, values = numbers(curve["t"]), numbers(curve["v"])
            shown = np.searchsorted(rows[:, 0], times)
            np.testing.assert_array_equal(rows[shown, 0], times)
            np.testing.assert_array_equal(rows[shown, column], values)
            # Every row that is not a point of the curve lies on it: it repeats the value before it.
            known = np.searchsorted(times, rows[shown[0] : shown[-1] + 1, 0], side="right") - 1
            np.testing.assert_array_equal(values[known], rows[shown[0] : shown[-1] + 1, column])
            assert shown[-1] - shown[0] > 250


@pytest.mark.parametrize("viewport", [LAPTOP, PHONE], ids=["laptop", "phone"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_recording_fits_the_screen(
    browser: Browser, playing: str, viewport: dict[str, int], scheme: Any
) -> None:
    context = browser.new_context(viewport=viewport, color_scheme=scheme)  # type: ignore[arg-type]
    page = context.new_page()
    page.goto(playing)
    expect(page.locator("#readings tbody tr")).to_have_count(3, timeout=60_000)
    assert page.evaluate("document.documentElement.scrollWidth") <= viewport["width"]
    assert page.locator(".chart canvas").count() > 0
    context.close()


def test_the_slider_goes_to_a_time_and_the_step_is_read(page: Page, playing: str) -> None:
    page.goto(playing)
    page.wait_for_function("hilLive.drawn > 10", timeout=60_000)
    page.select_option("#speed", "0.1")
    page.locator("#position").fill("15")
    page.wait_for_function("hilLive.rows.last > 14.9 && hilLive.rows.last < 17", timeout=60_000)
    page.wait_for_function("document.querySelectorAll('#readings tbody tr').length === 3", timeout=60_000)
    assert "0.000 → 0.100 m" in page.locator("#readings").inner_text()
    expect(page.locator("#state")).to_have_text("running")


def test_the_keyboard_pauses_and_chooses_series(page: Page, playing: str) -> None:
    page.goto(playing)
    page.wait_for_function("hilLive.charts.length === 6", timeout=60_000)
    page.keyboard.press("Tab")
    page.keyboard.press("Space")
    assert page.locator("#pause").get_attribute("aria-pressed") == "true"
    expect(page.locator("#pause")).to_have_text("Play")
    page.locator("#series input[value=error]").focus()
    page.keyboard.press("Space")
    page.wait_for_function("hilLive.charts.length === 9")
    page.locator("#series input[value=rotation]").focus()
    page.keyboard.press("Space")
    page.wait_for_function("hilLive.charts.length === 6")


def test_a_page_operates_a_daemon(page: Page, tmp_path: Path) -> None:
    path, at = tmp_path / "run.mcap", str(tmp_path / "socket")
    command = [*HIL, "daemon", "--socket", at, "--live", "--operate", "--record", str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        page.goto(re.sub("^page: ", "", process.stdout.readline().strip()))
        state, reply = page.locator("#state"), page.locator("#reply")
        expect(state).to_have_text("ready", timeout=60_000)
        page.get_by_role("button", name="Start", exact=True).click()
        expect(reply).to_contain_text("refused", timeout=30_000)
        page.get_by_role("button", name="Arm", exact=True).click()
        expect(state).to_have_text("armed", timeout=30_000)
        page.get_by_role("button", name="Start", exact=True).click()
        expect(state).to_have_text("running", timeout=30_000)
        page.get_by_label("setpoint", exact=True).fill("0.02")
        page.get_by_role("button", name="Set", exact=True).click()
        expect(reply).to_contain_text("setpoint 0.02", timeout=30_000)
        page.wait_for_function(f"Math.abs(hilLive.last[{len(COLUMNS)}] - 0.02) < 1e-9", timeout=30_000)
        page.get_by_role("button", name="Stop", exact=True).click()
        expect(state).to_have_text("armed", timeout=30_000)
        assert main(["shutdown", "--socket", at]) == 0
    assert process.returncode == 0
    assert main(["replay", str(path)]) == 0
    vertical = hil.open_recording(path).axis("vertical")
    assert vertical.setpoint[vertical.running][-1] == pytest.approx(0.02, abs=1e-12)
