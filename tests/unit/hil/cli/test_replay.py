"""``hil replay`` onto a bus and with another controller: options, questions, reports and exit status."""

from __future__ import annotations

import io
import signal
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from support.recorded_runs import RUN_HEADER, in_memory
from support.wire import crc8, frame_crc

from hil.cli import main
from hil.core.errors import LinkError
from hil.core.output import LogEntry, Severity
from hil.core.wire import codec
from hil.links.in_process import InProcessBus
from hil.links.link import Link, open_link
from hil.lockstep_rig import run_experiment
from hil.recording.recorder import Recorder
from hil.shells.bus_guard import sole_gateway

BUS = "inproc:replay"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("replay") / "run.mcap"
    run_experiment(path, duration_s=0.3, setpoints={"vertical": "hold"})
    return path


@pytest.fixture
def folder(recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "run.mcap").write_bytes(recorded.read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def listener() -> Iterator[InProcessBus]:
    bus = InProcessBus("replay")
    yield bus
    bus.shutdown()


def heard(bus: InProcessBus) -> list[can.Message]:
    return list(iter(lambda: bus.recv(0), None))


class Terminal(io.StringIO):
    """A standard input at which somebody sits."""

    def isatty(self) -> bool:
        return True


def test_the_boards_frames_arrive_and_the_timing_is_reported(
    folder: Path, listener: InProcessBus, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", "run.mcap", "--bus", BUS, "--speed", "10"]) == 0
    frames = heard(listener)
    assert {frame.arbitration_id for frame in frames} == {0x190, 0x710, 0x720}
    first, timing = capsys.readouterr().out.splitlines()
    assert first == f"replayed   {len(frames)} frames of the boards onto {BUS}; others sent 0"
    assert timing.startswith("timing     error p50 0.")
    assert "p99" in timing
    assert "worst" in timing


def test_fresh_samples_have_the_crc_of_the_recordings_wire_version(
    folder: Path, listener: InProcessBus
) -> None:
    assert main(["replay", "run.mcap", "--bus", BUS, "--fresh", "--speed", "20"]) == 0
    samples = [bytes(frame.data) for frame in heard(listener) if frame.arbitration_id == codec.TPDO1_ADC]
    assert samples and all(data[7] == frame_crc(codec.TPDO1_ADC, data[:7]) for data in samples)
    old = str(Path(__file__).parents[3] / "data" / "hil-0.2.0-run.mcap")
    assert main(["replay", old, "--bus", BUS, "--fresh", "--speed", "100"]) == 0
    samples = [bytes(frame.data) for frame in heard(listener) if frame.arbitration_id == codec.TPDO1_ADC]
    assert samples and all(data[7] == crc8(data[:7]) for data in samples)


def test_the_gateways_frames_end_with_centred_valves(
    folder: Path, listener: InProcessBus, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", "run.mcap", "--bus", BUS, "--as", "gateway", "--speed", "10"]) == 0
    commands = [frame.data for frame in heard(listener) if frame.arbitration_id == codec.RPDO1_DAC]
    counters = [codec.decode_rpdo1_dac(data).counter for data in commands]
    assert counters == [(counters[0] + k) & 0xFF for k in range(len(counters))]
    assert all(codec.decode_rpdo1_dac(data)[:3] == (5.0, 5.0, 5.0) for data in commands[-3:])
    assert "valves     centred: the command was sent 3 times\n" in capsys.readouterr().out


@pytest.mark.parametrize(("loop", "status"), [(True, 0), (False, 130)])
def test_a_signal_ends_the_replay_with_centred_valves(
    folder: Path,
    listener: InProcessBus,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    loop: bool,
    status: int,
) -> None:
    send = Link.send
    sent = 0

    def interrupted(link: Link, frame: object) -> bool:
        nonlocal sent
        sent += 1
        if sent == 20:
            signal.raise_signal(signal.SIGINT)
        return send(link, frame)  # type: ignore[arg-type]

    monkeypatch.setattr(Link, "send", interrupted)
    command = ["replay", "run.mcap", "--bus", BUS, "--as", "gateway", "--speed", "10"]
    assert main([*command, *(["--loop"] if loop else [])]) == status
    output = capsys.readouterr().out
    assert "replayed   20 frames of the gateway" in output
    assert "valves     centred" in output


def test_a_bus_that_fails_is_an_error_after_the_report(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_link: Link, _frame: object) -> bool:
        raise LinkError("vcan0: cannot send: Network is down")

    monkeypatch.setattr(Link, "send", fail)
    assert main(["replay", "run.mcap", "--bus", BUS, "--as", "gateway"]) == 2
    shown = capsys.readouterr()
    assert "the command that centres them was sent 0 times, not 3" in shown.out
    assert "Network is down" in shown.err


def test_frames_that_the_bus_refuses_are_reported(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Link, "send", lambda _link, _frame: False)
    assert main(["replay", "run.mcap", "--bus", BUS, "--speed", "50"]) == 1
    assert "frames: the queue of the bus was full" in capsys.readouterr().out


def test_no_gateway_is_played_on_a_bus_that_has_one(
    folder: Path, capsys: pytest.CaptureFixture[str], listener: InProcessBus
) -> None:
    with open_link(BUS) as link, sole_gateway(link, 0.0):
        assert main(["replay", "run.mcap", "--bus", BUS, "--as", "gateway", "--speed", "50"]) == 2
    assert "is the gateway of this bus" in capsys.readouterr().err
    assert not heard(listener)


class TestConfirmation:
    """On a bus with wires, valves move."""

    @pytest.fixture(autouse=True)
    def with_wires(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("hil.cli.replay_onto_bus.is_real", lambda _bus: True)

    @pytest.mark.parametrize("side", ["boards", "gateway"])
    def test_without_a_terminal_it_is_refused(
        self, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, side: str
    ) -> None:
        monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
        assert main(["replay", "run.mcap", "--bus", BUS, "--as", side]) == 2
        error = capsys.readouterr().err
        assert f"{BUS} is not virtual" in error
        assert "valves" in error
        assert "confirm it with --yes" in error

    @pytest.mark.parametrize("answer", ["n\n", "\n", "", "yes please\n"])
    def test_only_yes_is_yes(
        self, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, answer: str
    ) -> None:
        monkeypatch.setattr("sys.stdin", Terminal(answer))
        assert main(["replay", "run.mcap", "--bus", BUS, "--as", "gateway"]) == 2
        assert "not confirmed; nothing was sent" in capsys.readouterr().err

    @pytest.mark.parametrize(("options", "answer"), [([], "y\n"), (["--yes"], "")])
    def test_yes_opens_the_bus(
        self,
        folder: Path,
        listener: InProcessBus,
        monkeypatch: pytest.MonkeyPatch,
        options: list[str],
        answer: str,
    ) -> None:
        monkeypatch.setattr("sys.stdin", Terminal(answer))
        command = ["replay", "run.mcap", "--bus", BUS, "--as", "gateway", "--speed", "20"]
        assert main([*command, *options]) == 0
        assert heard(listener)


@pytest.mark.parametrize(
    ("entries", "ending", "words"),
    [
        (2, "interrupted", "its messages are 2 on /gateway/log; the run ended by: interrupted"),
        (0, "", "it has no message"),
    ],
)
def test_a_recording_without_a_period_says_what_it_has(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], entries: int, ending: str, words: str
) -> None:
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    for now_ns in range(entries):
        recorder.log_entry(LogEntry(Severity.INFO, "boards", "not seen yet"), now_ns)
    recorder.close({"ending": {"reason": ending}})
    assert main(["replay", str(path)]) == 2
    error = capsys.readouterr().err
    assert error == f"refused    {path}: has no period, so there is nothing to replay; {words}\n"
    path.write_bytes(path.read_bytes()[:-30])
    assert main(["replay", str(path)]) == 2
    error = capsys.readouterr().err
    if entries:
        assert error.endswith(", and it was cut off\n")
    else:
        assert f"{path}: was cut off before its first period: it holds no data" in error


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--speed", "2"], "--speed is for a replay onto a bus; add --bus"),
        (["--from", "0"], "--from is for a replay onto a bus"),
        (["--to", "0"], "--to is for a replay onto a bus"),
        (["--as", "boards"], "--as is for a replay onto a bus"),
        (["--loop"], "--loop is for a replay onto a bus"),
        (["--bus", BUS, "--speed", "0"], "0 is not from 0.01 to 100"),
        (["--bus", BUS, "--speed", "fast"], "'fast' is not a number"),
        (["--bus", BUS, "--as", "gateway", "--fresh"], "--fresh is for --as boards"),
        (["--bus", BUS, "--as", "gateway", "--answer-sync"], "--answer-sync is for --as boards"),
        (["--bus", BUS, "--from", "2", "--to", "1"], "--from 2 s is not before --to 1 s"),
        (["--bus", BUS, "--from", "90"], "has no frame of the boards to send in this range"),
        (["--bus", "sim"], "start `firmware-sim --bus udp:43113`"),
        (["--bus", "nowhere:0"], "names no bus"),
        (["other.mcap", "--bus", BUS], "2 recordings are given; replay them one by one"),
        (["--bus", BUS, "--with-controller", "vertical=ppid"], "exclude each other"),
        (["-o", "plot.png"], "-o is for the plot of --with-controller"),
        (["--with-controller", "vertical"], "--with-controller vertical: write AXIS=FILE"),
        (["--with-controller", "elbow=ppid"], "no axis 'elbow'"),
        (["--with-controller", "vertical=none.json"], "there is no file none.json"),
        (["--with-controller", "rotation=ppid"], "input_unit is m, but the axis is in rad"),
        (["--with-controller", "vertical=hls", "-o", "x.pdf"], "a plot's name ends in .png"),
        (["--with-controller", "vertical=hls", "--with-controller", "vertical=zn"], "is given twice"),
    ],
)
def test_wrong_options_are_refused_in_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    before = sorted(folder.iterdir())
    try:
        status = main(["replay", "run.mcap", *arguments])
    except SystemExit as ended:
        status = int(str(ended.code))
    assert status == 2
    assert message in capsys.readouterr().err.splitlines()[0]
    assert sorted(folder.iterdir()) == before


def test_another_controller_is_drawn_beside_the_recorded_one(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["replay", "run.mcap", "--with-controller", "vertical=hls", "--with-controller"]
    assert main([*command, "rotation=rotation"]) == 0
    output = capsys.readouterr().out
    assert "vertical: hls beside ppid, " in output
    assert "rotation: rotation beside rotation, " in output
    assert "largest difference of the command  0.0000 V" in output
    assert "open loop: the measurements are the recorded ones" in output
    assert output.endswith("plot       run-with-controller.png\n")
    assert Path("run-with-controller.png").read_bytes().startswith(b"\x89PNG")
    assert main([*command, "rotation=rotation"]) == 2
    assert "exists already" in capsys.readouterr().err
    assert main([*command, "rotation=none.json"]) == 2
    assert "there is no file none.json" in capsys.readouterr().err, "the inputs are checked first"
    Path("picture.mcap").write_bytes(Path("run-with-controller.png").read_bytes())
    Path("picture-with-controller.png").write_bytes(b"")
    assert main(["replay", "picture.mcap", "--with-controller", "vertical=hls"]) == 2
    assert "exists already" not in capsys.readouterr().err


def test_a_recording_without_the_rig_is_replayed_only_as_boards(
    folder: Path, listener: InProcessBus, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from hil.recording.reader import Recording

    monkeypatch.setattr(Recording, "documents", {})
    assert main(["replay", "run.mcap", "--bus", BUS, "--as", "gateway"]) == 2
    assert "only --as boards is possible" in capsys.readouterr().err
    assert main(["replay", "run.mcap", "--bus", BUS, "--speed", "50"]) == 0
