"""The rig in simulated time on a modelled bus, which is overloaded or disturbed."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from support.shipped_rig import RIG_TEXT

from hil.cli import main
from hil.core.errors import DocumentError
from hil.core.frames import Frame
from hil.core.wire.frame_bits import bits_on_wire
from hil.lockstep_rig import LockstepRig
from hil.recording.entries import FrameReceived, FrameRefused, FrameSent, Logged
from hil.recording.reader import Recording

BIT_NS = 2_000
SYNC, SAMPLE = 0x080, 0x190
CENTRED = (5.0, 5.0, 5.0)


def running_rig(bit_rate: int | None = 500_000, faults: tuple[str, ...] = ()) -> LockstepRig:
    rig = LockstepRig(setpoints={"vertical": "sine:0.1@0/2"}, seed=1, bit_rate=bit_rate, faults=faults)
    rig.bring_up()
    rig.arm()
    rig.start()
    rig.run(1.5)
    assert rig.state.name == "RUNNING"
    return rig


def answer_times(rig: LockstepRig, periods: int) -> list[int]:
    """Return the times from SYNC to its answer in the next periods, in nanoseconds."""
    first = len(rig.cycles)
    rig.step(periods)
    return [cycle.receive_ns - cycle.wake_ns for cycle in rig.cycles[first:] if cycle.fresh]


def test_an_answer_takes_the_bits_of_sync_and_sample() -> None:
    rig = running_rig()
    received = []
    original = rig.gateway.receive

    def receive(frame: Frame, now_ns: int) -> object:
        received.append((frame, now_ns))
        return original(frame, now_ns)

    rig.gateway.receive = receive  # type: ignore[method-assign, assignment]
    rig.step(9)
    samples = [(frame, now_ns) for frame, now_ns in received if frame.id == SAMPLE]
    deadlines = {cycle.wake_ns for cycle in rig.cycles}
    bits = [
        (now_ns - max(time_ns for time_ns in deadlines if time_ns < now_ns)) // BIT_NS
        for _, now_ns in samples
    ]
    expected = [bits_on_wire(Frame(SYNC)) + bits_on_wire(frame) - 3 for frame, _ in samples]
    late = [found - wanted for found, wanted in zip(bits, expected, strict=True)]
    assert late.count(0) >= 7
    assert all(0 <= more <= 70 for more in late), "a heartbeat may be on the wire before"


@pytest.mark.parametrize("bit_rate", [50_000, 125_000, 1_000_000])
def test_control_works_at_other_bit_rates(bit_rate: int) -> None:
    rig = running_rig(bit_rate)
    rig.step(100)
    assert rig.state.name == "RUNNING"
    assert abs(rig.signals["vertical"].error) < 0.06


def test_the_step_response_is_that_of_a_bus_without_delay() -> None:
    """The boards sample and apply at SYNC, so that the same delay of every SYNC changes nothing."""
    positions = []
    for bit_rate in (None, 500_000):
        rig = LockstepRig(setpoints={"vertical": "step:0.1@0.5"}, seed=1, bit_rate=bit_rate)
        rig.bring_up()
        rig.arm()
        rig.start()
        rig.run(2.0)
        positions.append(rig.axis("vertical").position)
    assert abs(positions[0] - positions[1]).max() < 0.0005


def test_a_flood_of_high_priority_delays_sync_and_samples_until_the_gateway_faults() -> None:
    rig = running_rig()
    rig.inject_fault("flood:1,0.0002@0")
    rig.step(10)
    assert rig.state.name == "FAULT"
    assert "no good sample for 5 periods" in (rig.gateway.fault_reason or "")
    rig.step(4)
    assert rig.boards.dac.valve_v == CENTRED, "the board's watchdog"
    assert rig.bus is not None
    assert rig.bus.gateway.refused > 0


@pytest.mark.parametrize(("fault", "more_frames"), [("flood:1,0.001@0", 3), ("flood:0x7ff,0.00011@0", 1)])
def test_a_flood_that_leaves_room_or_has_low_priority_delays_by_few_frames(
    fault: str, more_frames: int
) -> None:
    rig = running_rig()
    usual_ns = max(answer_times(rig, 100))
    rig.inject_fault(fault)
    flooded_ns = max(answer_times(rig, 100))
    assert rig.state.name == "RUNNING"
    assert usual_ns <= flooded_ns <= usual_ns + more_frames * 135 * BIT_NS
    assert abs(rig.signals["vertical"].error) < 0.06


def test_a_burst_of_higher_priority_makes_samples_stale_and_control_goes_on() -> None:
    rig = running_rig()
    rig.inject_fault("flood:1,0.0002@0/0.02")
    rig.step(100)
    assert rig.state.name == "RUNNING"
    assert any(not cycle.fresh for cycle in rig.cycles[-100:])
    assert all(cycle.fresh for cycle in rig.cycles[-50:])


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("bus-off@0", "bus: bus-off"),
        ("error-frames:100%,gateway@0", "bus: bus-off"),
        ("error-frames:100%,adc@0", "adc: no good sample for 5 periods"),
        ("unplug@0", "adc: no good sample for 5 periods"),
    ],
)
def test_a_broken_bus_is_a_fault_and_the_valves_are_centred(fault: str, reason: str) -> None:
    rig = running_rig()
    rig.inject_fault(fault)
    rig.step(10)
    assert rig.state.name == "FAULT"
    assert reason in (rig.gateway.fault_reason or "")
    rig.step(4)
    assert rig.boards.dac.valve_v == CENTRED


@pytest.mark.parametrize("fault", ["error-frames:10%@0", "error-frames:30%,adc@0", "unplug@0/0.02"])
def test_control_goes_on_while_frames_are_repeated(fault: str) -> None:
    rig = running_rig()
    rig.inject_fault(fault)
    rig.step(200)
    assert rig.state.name == "RUNNING"
    assert abs(rig.signals["vertical"].error) < 0.06
    assert rig.bus is not None
    assert rig.bus.error_frames > 0 or fault.startswith("unplug")


def test_faults_of_the_bus_end() -> None:
    rig = running_rig()
    rig.inject_fault("error-frames:50%@0/0.02")
    rig.step(4)
    assert rig.bus is not None
    errors = rig.bus.error_frames
    assert errors > 0
    rig.step(100)
    assert rig.bus.error_frames == errors
    rig.inject_fault("bus-off@0/0.1")
    rig.step(60)
    assert rig.state.name == "FAULT"
    rig.reset()
    rig.bring_up()
    assert rig.state.name == "READY"


def test_frames_of_a_stalled_host_wait_in_order(tmp_path: Path) -> None:
    rig = running_rig()
    rig.inject_fault("stall:0.15@0.001")
    rig.step(30)
    recording = rig.save_recording(tmp_path / "run.mcap")
    received = [e for e in recording.entries() if isinstance(e, FrameReceived)]
    stamps = [e.stamp_ns for e in received]
    assert stamps == sorted(stamps)
    ages = [e.now_ns + recording.epoch_offset_ns - e.stamp_ns for e in received]
    assert max(ages) > 20_000_000, "a heartbeat waited"


def test_an_injected_frame_arrives_later_at_both_sides() -> None:
    rig = running_rig()
    rig.inject(Frame(0x000, b"\x80\x20"))
    assert rig.state.name == "RUNNING"
    rig.step()
    assert rig.state.name == "FAULT"
    assert "foreign NMT frame" in (rig.gateway.fault_reason or "")
    assert rig.boards.dac.state.name == "PRE_OPERATIONAL"


def test_the_same_run_gives_the_same_bytes_and_a_replay_verifies_refused_frames(tmp_path: Path) -> None:
    for name in ("a", "b"):
        rig = running_rig(faults=("error-frames:5%@0", "flood:1,0.0002@running+1.8"))
        rig.step(40)
        rig.save_recording(tmp_path / f"{name}.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    refused = [e for e in Recording(tmp_path / "a.mcap").entries() if isinstance(e, FrameRefused)]
    assert refused
    assert main(["replay", str(tmp_path / "a.mcap")]) == 0


class TestCommand:
    @pytest.fixture
    def rig_file(self, tmp_path: Path) -> Path:
        path = tmp_path / "rig.toml"
        path.write_text(RIG_TEXT.replace('channel = "sim"', 'bit_rate = 500000\nchannel = "sim"'))
        return path

    def run(self, rig_file: Path, *arguments: str) -> tuple[int, Recording]:
        record = rig_file.with_name("run.mcap")
        command = ["run", "--lockstep", "--rig", str(rig_file), "--record", str(record), "--no-plot"]
        status = main([*command, "--duration", "2", *arguments])
        return status, Recording(record)

    def test_the_rig_file_chooses_the_bit_rate(
        self, rig_file: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        status, recording = self.run(rig_file)
        assert status == 0
        assert re.search(r"\d+ sent, bus load [567]\.\d %", capsys.readouterr().out)
        carried = [e for e in recording.entries() if isinstance(e, FrameReceived | FrameSent)]
        load = sum(bits_on_wire(e.frame) for e in carried) * BIT_NS / carried[-1].now_ns
        assert float(recording.metadata["ending"]["bus load"]) == pytest.approx(load, rel=0.02)
        times = {e.now_ns % 11_200_000 for e in recording.entries() if isinstance(e, FrameReceived)}
        assert min(times) > 100_000, "frames take time"

    def test_a_bus_that_takes_no_command_ends_the_run_as_a_failed_link_does(
        self, rig_file: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        status, recording = self.run(rig_file, "--fault", "flood:1,0.0002@running+0.5")
        assert status == 1
        assert recording.metadata["ending"]["fault"].startswith("adc: no good sample for 5 periods")
        refused = [e for e in recording.entries() if isinstance(e, FrameRefused)]
        assert refused
        assert main(["replay", str(recording.path)]) == 0
        assert "transmit queue" in json.dumps(
            [e.entry.text for e in recording.entries() if hasattr(e, "entry")]
        )
        capsys.readouterr()

    def test_a_fault_is_logged_when_it_begins_and_destroyed_frames_are_counted(
        self, rig_file: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        status, recording = self.run(rig_file, "--fault", "error-frames:3@1")
        assert status == 0
        assert "3 frames destroyed by error frames and repeated" in capsys.readouterr().out
        begins = [
            (e.now_ns, e.entry.text)
            for e in recording.entries()
            if isinstance(e, Logged) and e.entry.source == "simulated fault"
        ]
        assert begins == [(pytest.approx(1_000_000_000, abs=200_000_000), "error-frames:3@1 begins")]
        assert main(["replay", str(recording.path)]) == 0

    @pytest.mark.parametrize("bit_rate", ["9999", "1000001", '"fast"'])
    def test_an_impossible_bit_rate_is_refused(
        self, rig_file: Path, bit_rate: str, capsys: pytest.CaptureFixture[str]
    ) -> None:
        rig_file.write_text(rig_file.read_text().replace("500000", bit_rate))
        assert main(["run", "--lockstep", "--rig", str(rig_file)]) == 2
        assert "bus.bit_rate" in capsys.readouterr().err


def test_error_frames_need_a_modelled_bus() -> None:
    with pytest.raises(
        DocumentError, match=r"'error-frames@0' needs a modelled bus: write bit_rate = 500000"
    ):
        LockstepRig(faults=["error-frames@0"])
