"""A recording on the live page: what a viewer gets, by its own position and speed."""

import asyncio
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from support.recorded_runs import PERIOD_S, following, lag, record_run, step

import hil
from hil.cli import main
from hil.core.errors import EnvironmentLackError
from hil.live import address, playback
from hil.live.address import LOOPBACK, open_address
from hil.live.history import COLUMNS
from hil.live.playback import Playback, PlaybackSource


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    path = tmp_path / "run.mcap"
    record_run(path, round(3.0 / PERIOD_S), following(step(0.1, 0.5), lag(0.1, 0.5, 0.1)))
    return path


@pytest.fixture
def clock() -> mock.Mock:
    return mock.Mock(return_value=100.0)


@pytest.fixture
def source(recorded: Path, clock: mock.Mock, monkeypatch: pytest.MonkeyPatch) -> PlaybackSource:
    monkeypatch.setattr(playback, "monotonic", clock)
    return PlaybackSource(Playback([recorded]))


def test_rows_are_those_of_the_recording(recorded: Path) -> None:
    rows = Playback([recorded]).rows
    axis = hil.open_recording(recorded).axis("vertical")
    np.testing.assert_array_equal(
        rows[:, len(COLUMNS) : len(COLUMNS) + 3].T, [axis.setpoint, axis.position, axis.command_v]
    )


def test_time_passes_at_the_chosen_speed(source: PlaybackSource, clock: mock.Mock) -> None:
    source.take()
    asyncio.run(source.request({"speed": 2}))
    clock.return_value += 0.5
    messages, rows = source.take()
    assert {"position_s": 1.0} in messages
    assert 0.9 < rows[-1, 0] <= 1.0
    clock.return_value += 0.1
    _, more = source.take()
    assert more[0, 0] > rows[-1, 0]


def test_a_paused_recording_stands_still(source: PlaybackSource, clock: mock.Mock) -> None:
    asyncio.run(source.request({"paused": True}))
    clock.return_value += 5.0
    messages, rows = source.take()
    assert {"position_s": 0.0} in messages and len(rows) <= 1


def test_seeking_sends_what_came_before(source: PlaybackSource, clock: mock.Mock) -> None:
    clock.return_value += 1.0
    source.take()
    asyncio.run(source.request({"seek_s": 2.0}))
    messages, rows = source.take()
    assert messages[0] == {"clear": True}
    assert rows[0, 0] == 0.0 and 1.9 < rows[-1, 0] <= 2.0


def test_it_stops_at_the_end(source: PlaybackSource, clock: mock.Mock) -> None:
    clock.return_value += 1000.0
    messages, rows = source.take()
    end_s = rows[-1, 0]
    assert {"position_s": end_s} in messages
    clock.return_value += 1.0
    assert len(source.take()[1]) == 0


def test_the_last_step_is_read_as_in_the_summary(
    source: PlaybackSource, recorded: Path, clock: mock.Mock
) -> None:
    from hil.views.summary import StepResponse, summarise

    clock.return_value += 2.9
    messages, _ = source.take()
    (found,) = [m["readings"]["vertical"] for m in messages if "readings" in m]
    whole = summarise(hil.open_recording(recorded)).axes["vertical"]
    assert isinstance(whole, StepResponse)
    assert found["kind"] == "StepResponse"
    assert found["settling_s"] == pytest.approx(whole.settling_s, abs=0.012)
    assert (found["step_from"], found["step_to"]) == (whole.step_from, whole.step_to)


def test_a_recording_says_how_small_a_step_is(tmp_path: Path, clock: mock.Mock) -> None:
    path = tmp_path / "hold.mcap"
    assert main(["run", "--lockstep", "--duration", "1", "--no-plot", "--record", str(path)]) == 0
    found = Playback([path])
    assert found.min_steps["vertical"] == pytest.approx(0.005 * 0.3)
    with mock.patch.object(playback, "readings", return_value={}) as read:
        PlaybackSource(found).take()
    assert read.call_args.args[-1] == found.min_steps


@pytest.mark.parametrize(
    "request_", [{"speed": 0}, {"speed": 1e9}, {"seek_s": -1}, {"seek_s": 1e6}, {"arm": 1}]
)
def test_a_wrong_request_is_refused(source: PlaybackSource, request_: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"speed|seek_s|between"):
        asyncio.run(source.request(request_))


def test_the_address_is_on_this_machine_alone() -> None:
    with open_address() as here:
        assert here.listener.getsockname()[0] == LOOPBACK
        assert here.url.startswith(f"http://{here.hosts[0]}/?token=")
        assert len(here.token) >= 32


def test_a_page_on_the_network_is_warned_of(capsys: pytest.CaptureFixture[str]) -> None:
    with open_address("0.0.0.0"):
        pass
    assert "without encryption" in capsys.readouterr().err


def test_a_port_in_use_is_refused() -> None:
    with open_address() as here, pytest.raises(EnvironmentLackError, match="cannot be served on"):
        open_address(LOOPBACK, here.listener.getsockname()[1])


def test_without_the_extra_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(address.importlib.util, "find_spec", lambda _name: None)
    with pytest.raises(EnvironmentLackError, match=r"pip install 'pneumatic-hil\[live\]'"):
        open_address()
