"""The live page in a real browser: what is drawn is what is recorded."""

from __future__ import annotations

import contextlib
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from time import monotonic_ns
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect
from support.recorded_runs import wait_until

import hil
from hil.cli import main
from hil.core.errors import RequestRefusedError
from hil.live.history import COLUMNS

HIL = [sys.executable, "-m", "hil.cli"]
PHONE = {"width": 390, "height": 844}
LAPTOP = {"width": 1366, "height": 768}
SMALL = {"width": 1280, "height": 720}
VIEW = "[hilLive.charts[0].figure.x_range.start, hilLive.charts[0].figure.x_range.end]"
"""Expression for the times at the edges of the charts."""
TALL = {"width": 1366, "height": 1600}


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


@pytest.mark.real_time
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
            is_gap = np.isnan(values) & np.isfinite(rows[np.searchsorted(rows[:, 0], times), column])
            times, values = times[~is_gap], values[~is_gap]  # between them, a loaded machine missed periods
            shown = np.searchsorted(rows[:, 0], times)
            np.testing.assert_array_equal(rows[shown, 0], times)
            np.testing.assert_array_equal(rows[shown, column], values)
            assert shown[-1] - shown[0] > 250
            between = rows[shown[0] : shown[-1] + 1]
            place = np.searchsorted(times, between[:, 0], side="right") - 1
            around = np.clip(place[:, None] + np.arange(-1, 3), 0, len(values) - 1)
            finite = np.isfinite(between[:, column]) & np.isfinite(values[around]).all(axis=1)
            assert finite.sum() > 100
            near, value = values[around][finite], between[finite, column]
            assert (near.min(axis=1) <= value).all() and (value <= near.max(axis=1)).all()


def test_a_row_counts_as_drawn_after_every_chart_with_it_was_painted(page: Page, playing: str) -> None:
    page.goto(playing)
    page.wait_for_function("hilLive.charts.every((chart) => chart.isVisible) && hilLive.delays_ms.length > 0")
    page.evaluate(
        """() => {
            const events = window.events = [], { draw } = Chart.prototype;
            const { delays_ms } = hilLive, { push } = [];
            Chart.prototype.draw = function (curves) { events.push("new data"); draw.call(this, curves); };
            for (const chart of hilLive.charts)
                chart.view.then((view) => view.repainted.connect(() => events.push("painted")));
            delays_ms.push = (ms) => { events.push("noted"); return push.call(delays_ms, ms); };
        }"""
    )
    noted_now = "name === 'noted' && events[place - 1] !== 'noted'"
    page.wait_for_function(f"events.filter((name, place) => {noted_now}).length > 6")
    events: list[str] = page.evaluate("events")
    letters = "".join({"new data": "d", "painted": "p", "noted": "n"}[name] for name in events)
    charts = page.evaluate("hilLive.charts.length")
    painted = noted = 0
    # From a picture on that begins after the rows of the one before were noted.
    for part in re.findall("d+|p+|n+", letters[letters.index("nd") + 1 :]):
        if part[0] == "d":
            unpainted = charts
        elif part[0] == "p":
            painted += 0 < unpainted <= len(part)
            unpainted -= len(part)
        else:
            noted += 1
            assert noted <= painted, letters
    assert noted > 2


def test_an_update_is_drawn_at_once_and_a_large_part_of_the_past_in_the_next_frame(
    page: Page, playing: str
) -> None:
    page.goto(playing)
    page.wait_for_function("hilLive.drawn > 10")
    is_drawn = """(count) => {
        const { rows } = hilLive, last = rows.data.slice((rows.end - 1) * rows.width, rows.end * rows.width);
        const more = Float64Array.from({ length: count * rows.width }, (_, i) => last[i % rows.width]);
        next_draw_ms = 0;
        takeRows(more);
        return hilLive.drawn === hilLive.received;
    }"""
    assert page.evaluate(is_drawn, 3)
    assert not page.evaluate(is_drawn, 1000)
    page.wait_for_function("hilLive.drawn === hilLive.received")


@pytest.mark.parametrize("viewport", [LAPTOP, SMALL, PHONE], ids=["laptop", "1280 pixels", "phone"])
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
    table = "document.getElementById('readings')"
    assert page.evaluate(f"{table}.scrollWidth <= {table}.clientWidth")
    context.close()


def test_the_slider_reaches_the_end(page: Page, playing: str) -> None:
    page.goto(playing)
    expect(page.locator("#position-text")).to_contain_text(" of ")
    value, end = page.evaluate(
        "(({ slider }) => { slider.value = slider.max; return [slider.value, slider.max]; })"
        "({ slider: document.querySelector('#position') })"
    )
    assert value == end


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


def test_the_keyboard_pans_zooms_and_moves_the_cursor(page: Page, playing: str) -> None:
    page.goto(playing)
    page.wait_for_function("hilLive.drawn > 200", timeout=60_000)
    page.locator("#charts").focus()
    before = page.evaluate(VIEW)
    page.keyboard.press("+")
    page.wait_for_function(f"Math.abs(({VIEW})[1] - ({VIEW})[0] - {(before[1] - before[0]) / 2}) < 1e-6")
    assert page.locator("#pause").get_attribute("aria-pressed") == "true"
    zoomed = page.evaluate(VIEW)
    page.keyboard.press("ArrowLeft")
    page.wait_for_function(f"({VIEW})[0] < {zoomed[0]}")
    page.keyboard.press("Shift+ArrowLeft")
    cursor_s = float(page.locator("#cursor").inner_text().removeprefix("cursor ").removesuffix(" s"))
    setpoint, position = page.evaluate(
        f"""(() => {{ const row = hilLive.rows.find({cursor_s} - 0.0006);
            return [hilLive.rows.at(row, {len(COLUMNS)}), hilLive.rows.at(row, {len(COLUMNS) + 1})]; }})()"""
    )
    heading = page.locator(".chart h3").first
    expect(heading).to_contain_text(f"setpoint {setpoint:.4f}")
    expect(heading).to_contain_text(f"measured {position:.4f}")
    page.keyboard.press("End")
    expect(page.locator("#pause")).to_have_text("Pause")
    expect(page.locator("#cursor")).to_have_text("")


def test_the_pointer_shows_values_and_the_wheel_zooms_with_ctrl(page: Page, playing: str) -> None:
    page.goto(playing)
    page.wait_for_function("hilLive.drawn > 200", timeout=60_000)
    page.locator(".chart").nth(1).hover(position={"x": 200, "y": 100})
    expect(page.locator("#cursor")).to_contain_text("cursor ")
    before = page.evaluate(VIEW)
    page.keyboard.down("Control")
    page.mouse.wheel(0, -100)
    page.keyboard.up("Control")
    page.wait_for_function(f"({VIEW})[1] - ({VIEW})[0] < {0.9 * (before[1] - before[0])}")


def test_charts_outside_the_window_are_drawn_when_they_come_into_it(page: Page, playing: str) -> None:
    page.set_viewport_size({"width": 600, "height": 500})
    page.goto(playing)
    page.wait_for_function("hilLive.drawn > 200", timeout=60_000)
    last = "hilLive.charts.at(-1)"
    assert page.evaluate(f"[{last}.isVisible, {last}.sources[0].data.t.length]") == [False, 0]
    page.locator(".chart").last.scroll_into_view_if_needed()
    page.wait_for_function(f"{last}.sources[0].data.t.length > 10")


# Machado, Oliveira and Fernandes 2009, severity 1.0; linear RGB.
COLOUR_BLIND = {
    "protanopia": (
        0.152286,
        1.052583,
        -0.204868,
        0.114503,
        0.786281,
        0.099216,
        -0.003882,
        -0.048116,
        1.051998,
    ),
    "deuteranopia": (
        0.367322,
        0.860646,
        -0.227968,
        0.280085,
        0.672501,
        0.047413,
        -0.01182,
        0.04294,
        0.968881,
    ),
    "tritanopia": (1.255528, -0.076749, -0.178779, -0.078411, 0.930809, 0.147602, 0.004733, 0.691367, 0.3039),
}


def linear(colour: str) -> np.ndarray[Any, Any]:
    """Return linear RGB of a colour such as #0072b2 or #fff (IEC 61966-2-1)."""
    digits = colour.lstrip("#")
    digits = "".join(2 * digit for digit in digits) if len(digits) == 3 else digits
    values = np.array([int(digits[at : at + 2], 16) / 255.0 for at in (0, 2, 4)])
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def contrast(one: str, other: str) -> float:
    """Return the contrast ratio of WCAG 2."""
    dark, light = sorted(float(linear(colour) @ [0.2126, 0.7152, 0.0722]) + 0.05 for colour in (one, other))
    return light / dark


def lab(rgb: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return CIELAB of linear RGB, for D65."""
    to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    x, y, z = np.cbrt(np.clip(to_xyz @ rgb, 0.0089, None) / [0.9505, 1.0, 1.089])
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_colours_have_contrast_and_colour_blind_people_can_tell_them_apart(
    browser: Browser, playing: str, scheme: Any
) -> None:
    context = browser.new_context(viewport=LAPTOP, color_scheme=scheme)  # type: ignore[arg-type]
    page = context.new_page()
    page.goto(playing)
    names = ["--back", "--fill", "--ink", "--soft", "--bad", "--good", "--warn", "--key"]
    back, fill, *texts = (page.evaluate(f"colourOf('{name}')") for name in names)
    curves = page.evaluate("COLOURS()")
    context.close()
    assert min(contrast(text, ground) for text in texts for ground in (back, fill)) >= 4.5
    assert min(contrast(curve, back) for curve in curves.values()) >= 3.0
    assert contrast("#b3261e", "#fff") >= 4.5  # the stop button
    for matrix in COLOUR_BLIND.values():
        seen = [lab(np.reshape(matrix, (3, 3)) @ linear(curve)) for curve in curves.values()]
        assert float(np.linalg.norm(seen[0] - seen[1])) > 25.0


@pytest.mark.real_time
@pytest.mark.parametrize("viewport", [LAPTOP, SMALL, PHONE], ids=["laptop", "1280 pixels", "phone"])
def test_the_stop_button_is_always_large_and_there(
    browser: Browser, tmp_path: Path, viewport: dict[str, int]
) -> None:
    at = str(tmp_path / "socket")
    command = [*HIL, "daemon", "--socket", at, "--live", "--operate", "--no-record"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        page = browser.new_page(viewport=viewport)  # type: ignore[arg-type]
        page.goto(re.sub("^page: ", "", process.stdout.readline().strip()))
        stop = page.locator("#stop")
        expect(stop).to_be_visible(timeout=60_000)
        for place in (0, 0.5, 1):
            page.evaluate(f"scrollTo(0, {place} * document.body.scrollHeight)")
            expect(stop).to_be_in_viewport(ratio=1)
            box = stop.bounding_box()
            assert box is not None and box["height"] >= 56 and box["width"] >= 150
            page.evaluate(
                "(() => { const b = document.getElementById('stop').getBoundingClientRect();"
                "if (document.elementFromPoint(b.x + b.width / 2, b.y + b.height / 2).id !== 'stop')"
                "throw new Error('the stop button is covered'); })()"
            )
        page.keyboard.press("Escape")
        expect(page.locator("#reply")).to_contain_text("refused", timeout=30_000)  # nothing runs
        assert main(["shutdown", "--socket", at]) == 0
        page.close()


def periods_of(socket_path: str) -> int:
    """Return the number of periods of a daemon, 0 before its first one."""
    with hil.connect(socket_path) as daemon, contextlib.suppress(RequestRefusedError):
        return daemon.status().period
    return 0


@pytest.mark.real_time
def test_a_page_beside_a_daemon_shows_every_period_and_those_before_it_was_opened(
    page: Page, tmp_path: Path
) -> None:
    path, at = tmp_path / "run.mcap", str(tmp_path / "socket")
    with subprocess.Popen(
        [*HIL, "daemon", "--socket", at, "--foxglove", "0", "--record", str(path)],
        stdout=subprocess.PIPE,
        text=True,
    ) as daemon:
        assert daemon.stdout is not None
        daemon.stdout.readline()
        wait_until(lambda: periods_of(at) > 100, "100 periods")
        opened_ns = monotonic_ns()
        with subprocess.Popen([*HIL, "live", "--socket", at], stdout=subprocess.PIPE, text=True) as shown:
            assert shown.stdout is not None
            page.goto(shown.stdout.readline().strip())
            page.wait_for_function("hilLive.drawn > 300", timeout=60_000)
            rows, _, start_ns = contents_of(page)
            assert main(["shutdown", "--socket", at]) == 0
            expect(page.locator("#state")).to_have_text("waiting for a daemon", timeout=30_000)
            shown.terminate()
    assert rows[0, 0] < (opened_ns - start_ns) * 1e-9 - 1.0
    shown_ns = np.round(rows[:, 0] * 1e9).astype(np.int64) + start_ns
    recorded_ns = hil.open_recording(path).timing().deadline_ns
    inside = (recorded_ns >= shown_ns[0]) & (recorded_ns <= shown_ns[-1])
    np.testing.assert_array_equal(shown_ns, recorded_ns[inside])
    assert np.isfinite(rows[:, 2]).all()


@pytest.mark.real_time
def test_a_page_operates_a_daemon(page: Page, tmp_path: Path) -> None:
    path, at = tmp_path / "run.mcap", str(tmp_path / "socket")
    command = [*HIL, "daemon", "--socket", at, "--live", "--operate", "--record", str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        page.goto(re.sub("^page: ", "", process.stdout.readline().strip()))
        state, reply = page.locator("#state"), page.locator("#reply")
        expect(state).to_have_text("ready", timeout=60_000)
        arm, start = (page.get_by_role("button", name=name, exact=True) for name in ("Arm", "Start"))
        expect(start).to_be_disabled()
        start.press("Enter")
        expect(reply).to_have_text("Start needs state armed; the state is ready")
        arm.press("Enter")
        expect(state).to_have_text("armed", timeout=30_000)
        expect(arm).to_be_disabled()
        expect(arm).to_be_focused()  # the keyboard goes on from there
        start.click()
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


@pytest.mark.real_time
def test_a_page_says_why_the_loop_is_offline_and_shows_no_old_position(page: Page, tmp_path: Path) -> None:
    at = str(tmp_path / "socket")
    command = [*HIL, "daemon", "--socket", at, "--live", "--operate", "--no-record"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        page.goto(re.sub("^page: ", "", process.stdout.readline().strip()))
        state, reason = page.locator("#state"), page.locator("#fault")
        expect(state).to_have_text("ready", timeout=60_000)
        expect(reason).to_be_hidden()
        jog = page.get_by_role("button", name="Hold to jog")
        jog.press("Enter")
        expect(page.locator("#reply")).to_have_text("Hold to jog needs state armed; the state is ready")
        assert main(["event", "hang:adc", "--socket", at]) == 0
        expect(state).to_have_text("offline", timeout=60_000)
        expect(reason).to_contain_text("Offline: ")
        expect(reason).to_contain_text("adc silent", timeout=60_000)
        expect(reason).to_contain_text(
            re.compile("The last good sample is [1-9][0-9]* s old"), timeout=60_000
        )
        measured = page.locator(".chart .key", has_text="measured")
        expect(measured.first).to_have_text("measured –")
        assert page.evaluate("Number.isNaN(hilLive.charts[0].sources[1].data.v.at(-1))")
        assert main(["shutdown", "--socket", at]) == 0
    assert process.returncode == 0
