"""``hil live``: what it shows, and which arguments do not fit together."""

import signal
import socket
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from unittest import mock

import pytest
from support.recorded_runs import record_run

from hil.cli import live, run
from hil.core.errors import DocumentError, EnvironmentLackError, OperationError, RecordingError


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> mock.Mock:
    """Give the function that starts the page's process, which ends at once."""
    start = mock.Mock(return_value=mock.Mock(wait=mock.Mock(return_value=0)))
    monkeypatch.setattr("hil.live.process.start_page_server", start)
    return start


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    """Restore the signal handlers that the command sets."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    path = tmp_path / "run.mcap"
    record_run(path, 300)
    return path


def test_a_range_of_a_recording_is_played(
    started: mock.Mock, recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert live.main([str(recorded), "--from", "1", "--to", "2"]) == 0
    assert started.call_args.kwargs["recording"] == [recorded]
    assert started.call_args.kwargs["range_s"] == (1.0, 2.0)
    assert started.call_args.kwargs["feed"] is None
    assert capsys.readouterr().out.startswith("http://127.0.0.1:")


def test_a_recording_that_cannot_be_read_is_refused(started: mock.Mock, tmp_path: Path) -> None:
    with pytest.raises(RecordingError):
        live.main([str(tmp_path / "none.mcap")])
    started.assert_not_called()


def test_a_range_without_a_period_is_refused_with_the_recorded_times(
    started: mock.Mock, recorded: Path
) -> None:
    with pytest.raises(RecordingError, match=r"between --from and --to; its periods: 0\.000 to 3\."):
        live.main([str(recorded), "--from", "5"])
    started.assert_not_called()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run.mcap", "--operate"], "--operate needs a daemon"),
        (["run.mcap", "--foxglove"], "Foxglove itself opens the recording: open run.mcap there"),
        (["--operate", "--foxglove"], "--operate needs the page"),
        (["--from", "1"], "--from and --to are times of a recording"),
    ],
)
def test_arguments_that_do_not_fit_together_are_refused(arguments: list[str], message: str) -> None:
    with pytest.raises(DocumentError, match=message):
        live.main(arguments)


@pytest.mark.parametrize("option", ["--port", "--foxglove"])
@pytest.mark.parametrize("text", ["65536", "80000", "-1"])
def test_a_number_that_is_no_port_is_refused(
    option: str, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """`hil live`, `hil run` and `hil daemon` take the same options."""
    for parser in (live.parser(), run.parser()):
        with pytest.raises(SystemExit):
            parser.parse_args([f"{option}={text}"])
        assert f"{text!r} is not a port: give a whole number from 0" in capsys.readouterr().err


def test_a_word_is_no_port(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        live.main(["--port", "8o"])
    assert "'8o' is not a port" in capsys.readouterr().err


def test_foxglove_opens_a_recording_by_itself(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        live.main(["--foxglove", "run.mcap"])
    assert "'run.mcap' is not a port. A recording needs no server: open it in Foxglove directly" in (
        capsys.readouterr().err
    )


def test_the_largest_port_is_accepted() -> None:
    assert live.parser().parse_args(["--port", "65535", "--foxglove", "0"]).port == 65535


def test_without_a_daemon_the_error_says_so(tmp_path: Path) -> None:
    for arguments in ([], ["--foxglove"]):
        with pytest.raises(OperationError, match="no daemon runs at"):
            live.main(["--socket", str(tmp_path / "none"), *arguments])


@pytest.mark.parametrize("command", ["run", "collect"])
@pytest.mark.parametrize("view", ["--live", "--foxglove"])
def test_a_run_in_simulated_time_cannot_be_watched(command: str, view: str) -> None:
    module = import_module(f"hil.cli.{command}")
    axis = ["--axis", "vertical"] if command == "collect" else []
    with pytest.raises(DocumentError, match=f"{view} shows a run in real time"):
        module.main([*axis, "--lockstep", view])


def test_every_command_that_runs_in_real_time_has_the_options_of_the_views() -> None:
    for command, axis in (("run", []), ("collect", ["--axis", "vertical"]), ("daemon", [])):
        options = import_module(f"hil.cli.{command}").parser().parse_args(axis)
        assert options.live is False and options.foxglove is None and options.host == "127.0.0.1"


def test_a_signal_ends_the_serving_process_too(started: mock.Mock, recorded: Path) -> None:
    process = started.return_value
    process.wait.side_effect = lambda: signal.raise_signal(signal.SIGTERM)
    with pytest.raises(SystemExit) as ended:
        live.main([str(recorded)])
    assert ended.value.code == 128 + signal.SIGTERM
    process.terminate.assert_called_once_with()


@pytest.mark.parametrize("command", ["run", "daemon"])
def test_a_page_that_cannot_be_served_leaves_no_recording(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = str(other.getsockname()[1])
        options = ["--socket", str(tmp_path / "hil.sock")] if command == "daemon" else ["--duration", "1"]
        with pytest.raises(EnvironmentLackError, match=f"the page cannot be served on 127.0.0.1:{port}"):
            import_module(f"hil.cli.{command}").main(["--live", "--port", port, *options])
    assert not (tmp_path / "runs").exists()


def test_a_daemon_that_cannot_record_announces_no_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    there = tmp_path / "run.mcap"
    there.write_text("mine")
    options = ["--live", "--socket", str(tmp_path / "hil.sock"), "--record", str(there)]
    with pytest.raises(RecordingError, match="exists already"):
        import_module("hil.cli.daemon").main(options)
    assert "page" not in capsys.readouterr().out
