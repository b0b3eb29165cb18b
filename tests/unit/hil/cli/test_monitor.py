"""``hil monitor`` on a simulated clock and simulated boards, and as a command on a bus in this process."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import pytest
from support.boards_on_a_link import BoardsOnALink
from support.shipped_rig import RIG_TEXT, SHIPPED_RIG

from hil.cli import monitor as command
from hil.cli.monitor import Monitor
from hil.core.board_watch import NMT_START
from hil.core.errors import DocumentError
from hil.core.frames import Frame
from hil.core.wire import codec
from hil.links import Link, open_link
from hil.views.bus_watch import SILENT_NS

SECOND_NS = 1_000_000_000


@pytest.fixture
def boards() -> BoardsOnALink:
    return BoardsOnALink()


def monitor_of(boards: BoardsOnALink, sends_sync: bool) -> Monitor:
    return Monitor(boards, SHIPPED_RIG, 500_000, sends_sync, boards.clock_ns)  # type: ignore[arg-type]


def test_without_sync_nothing_is_sent(boards: BoardsOnALink) -> None:
    monitor = monitor_of(boards, sends_sync=False)
    monitor.listen_until(5 * SECOND_NS)
    assert boards.sent == []
    status = monitor.watch.status(boards.now_ns)
    assert [board.state for board in status.boards.values()] == ["pre-operational", "pre-operational"]
    assert status.axes["vertical"].position is None
    assert "use --sync" in status.hints[0]


def test_with_sync_the_adc_board_is_started_and_no_command_leaves(boards: BoardsOnALink) -> None:
    monitor = monitor_of(boards, sends_sync=True)
    monitor.listen_until(5 * SECOND_NS)
    assert boards.sent[0][0] >= SILENT_NS, "nothing is sent before a gateway would have been heard"
    assert {frame.id for _, frame in boards.sent} == {codec.SYNC, codec.NMT}
    starts = [frame for _, frame in boards.sent if frame.id == codec.NMT]
    assert starts == [Frame(codec.NMT, bytes((NMT_START, 0x10)))]
    syncs_ns = [ns for ns, frame in boards.sent if frame.id == codec.SYNC]
    gaps_ns = {later - sooner for sooner, later in pairwise(syncs_ns)}
    assert gaps_ns == {SHIPPED_RIG.loop.period_ns}
    status = monitor.watch.status(boards.now_ns)
    assert status.boards["adc"].state == "operational"
    assert status.boards["dac"].state == "pre-operational", "the valve board is not started"
    assert status.axes["vertical"].position == pytest.approx(0.0, abs=0.001)
    assert status.hints == []


def test_it_stops_to_send_sync_when_a_gateway_appears_and_goes_on_when_it_leaves(
    boards: BoardsOnALink,
) -> None:
    for number in range(20):
        boards.foreign.append(
            (3 * SECOND_NS + number * SECOND_NS // 10, Frame(codec.HEARTBEAT_GATEWAY, b"\5"))
        )
    monitor = monitor_of(boards, sends_sync=True)
    monitor.listen_until(10 * SECOND_NS)
    sync_s = [ns / SECOND_NS for ns, frame in boards.sent if frame.id == codec.SYNC]
    assert not [at_s for at_s in sync_s if 3.02 < at_s < 6.0]
    assert [at_s for at_s in sync_s if at_s > 8.0]


def test_after_a_stall_sync_comes_once(boards: BoardsOnALink) -> None:
    monitor = monitor_of(boards, sends_sync=True)
    monitor.listen_until(2 * SECOND_NS)
    boards.now_ns = 4 * SECOND_NS
    monitor.listen_until(boards.now_ns + 1)
    assert sum(ns >= 4 * SECOND_NS for ns, _ in boards.sent) == 1


def test_a_frame_that_the_bus_refuses_is_not_counted(boards: BoardsOnALink) -> None:
    boards.takes_frames = False
    monitor = monitor_of(boards, sends_sync=True)
    monitor.listen_until(2 * SECOND_NS)
    assert monitor.watch.status(boards.now_ns).own_sync_per_s == 0


class TestCommand:
    @pytest.fixture
    def other(self, monkeypatch: pytest.MonkeyPatch) -> Link:
        monkeypatch.setattr(command, "ONCE_S", 0.05)
        monkeypatch.setattr(command, "REFRESH_NS", 10_000_000)
        return open_link("inproc:monitored")

    @pytest.fixture
    def talking(self, other: Link, monkeypatch: pytest.MonkeyPatch) -> Link:
        """A node that sends its heartbeat when the monitor has opened the bus."""
        real = command.open_link

        def opened(spec: str, bit_rate: int | None) -> Link:
            link = real(spec, bit_rate)
            other.send(Frame(codec.HEARTBEAT_ADC, b"\x7f"))
            return link

        monkeypatch.setattr(command, "open_link", opened)
        return other

    def test_once_prints_a_picture(self, talking: Link, capsys: pytest.CaptureFixture[str]) -> None:
        assert command.main(["--bus", talking.spec, "--once"]) == 0
        assert "ADC 0x10       pre-operational" in capsys.readouterr().out

    def test_once_prints_json(self, talking: Link, capsys: pytest.CaptureFixture[str]) -> None:
        assert command.main(["--bus", talking.spec, "--once", "--json", "--bit-rate", "250000"]) == 0
        status = json.loads(capsys.readouterr().out)
        assert status["boards"]["adc"]["state"] == "pre-operational"
        assert (status["bus"]["name"], status["bus"]["bit_rate"]) == (talking.spec, 250_000)

    def test_the_rig_file_gives_the_bit_rate(
        self, talking: Link, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        rig = tmp_path / "rig.toml"
        rig.write_text(RIG_TEXT.replace('channel = "sim"', "bit_rate = 125000"))
        assert command.main(["--bus", talking.spec, "--once", "--json", "--rig", str(rig)]) == 0
        assert json.loads(capsys.readouterr().out)["bus"]["bit_rate"] == 125_000

    def test_on_a_silent_bus_once_has_status_1(self, other: Link, capsys: pytest.CaptureFixture[str]) -> None:
        assert command.main(["--bus", other.spec, "--once"]) == 1
        assert "no frame at all" in capsys.readouterr().out

    @pytest.mark.parametrize("arguments", [[], ["--json"]])
    @pytest.mark.parametrize("is_terminal", [False, True])
    def test_it_shows_again_and_again_until_it_is_interrupted(
        self,
        talking: Link,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
        arguments: list[str],
        is_terminal: bool,
    ) -> None:
        listen, calls = Monitor.listen_until, []

        def listen_until(monitor: Monitor, end_ns: int) -> None:
            calls.append(end_ns)
            if len(calls) > 3:
                raise KeyboardInterrupt
            listen(monitor, end_ns)

        monkeypatch.setattr(Monitor, "listen_until", listen_until)
        monkeypatch.setattr("rich.console.Console.is_terminal", is_terminal)
        assert command.main(["--bus", talking.spec, *arguments]) == 0
        assert capsys.readouterr().out.count("pre-operational") >= 3
        assert all(later - sooner >= command.REFRESH_NS for sooner, later in pairwise(calls))

    def test_a_bus_that_only_a_run_can_reach_is_refused(self) -> None:
        with pytest.raises(DocumentError, match=r"^rig\.toml: bus\.channel: 'sim' is a bus"):
            command.main([])

    def test_a_serial_adapter_is_set_by_the_rig_file_alone(self) -> None:
        with pytest.raises(DocumentError, match=r"--bit-rate 250000: .* is set to the rate of the rig file"):
            command.main(["--bus", "slcan:/dev/none", "--bit-rate", "250000", "--once"])

    @pytest.mark.parametrize("text", ["0", "9999", "1000001", "5e5", "fast", "-1"])
    def test_an_impossible_bit_rate_is_refused(self, text: str, capsys: pytest.CaptureFixture[str]) -> None:
        with pytest.raises(SystemExit):
            command.main(["--bit-rate", text, "--once"])
        assert "is not a bit rate of classic CAN, 10000 to 1000000 bit/s" in capsys.readouterr().err
