"""Gateway and boards of the same and of different wire versions, and data under a wrong identifier."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.board_bench import Bench, emergency, pdo
from support.constants import CENTRED, PERIOD_NS
from support.gateway_bench import RigBench, make_gateway, make_rig, make_stepped, rig_text, texts
from support.protected_rigs import EMERGENCY_STOP
from support.shipped_rig import SHIPPED_RIG

from firmware_sim.boards.dac import VendorCode
from hil.core.errors import DocumentError
from hil.core.frames import Frame
from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState
from hil.core.rig import Rig, read_rig
from hil.testing.boards_alone import BoardsAlone

SAMPLE, COMMAND, READ_BACK = 0x190, 0x220, 0x1A0
VOLTS = (9.0, 1.0, 7.0)
counts = st.tuples(*[st.integers(0, 32767)] * 3)


def with_version(rig: Rig, version: int) -> Rig:
    return msgspec.structs.replace(rig, bus=msgspec.structs.replace(rig.bus, wire_version=version))


def at_once(version: int) -> Rig:
    dac = msgspec.structs.replace(SHIPPED_RIG.dac, apply="at once")
    return with_version(msgspec.structs.replace(SHIPPED_RIG, dac=dac), version)


def test_a_rig_file_without_the_key_has_version_1_and_the_shipped_one_has_2() -> None:
    text = rig_text()
    assert read_rig(text, "rig.toml").bus.wire_version == 2
    old = "".join(line for line in text.splitlines(keepends=True) if not line.startswith("wire_version"))
    assert read_rig(old, "rig.toml").bus.wire_version == 1


def test_an_unknown_version_is_refused() -> None:
    with pytest.raises(DocumentError, match=r"rig\.toml: bus\.wire_version is 3, but must be 1 or 2"):
        read_rig(rig_text({"bus.wire_version": "3"}), "rig.toml")


class TestDataUnderAWrongIdentifier:
    """A sample of 9, 1 and 7 V, or the read-back of such commands, is sent under the commands' identifier."""

    @staticmethod
    def resent(version: int, source: int) -> tuple[Bench, list[Frame]]:
        """A board's own data sent under the identifier of commands: the bench, and the board's answers."""
        rig = at_once(version)
        bench = Bench(msgspec.structs.replace(rig, dac=msgspec.structs.replace(rig.dac, read_back=True)))
        bench.started().plant.volts = list(VOLTS)
        if source == READ_BACK:
            bench.command(*VOLTS)
        (frame,) = [frame for frame in bench.give(Frame(0x080)) if frame.id == source]
        bench.wait(10 * PERIOD_NS)  # the watchdog centres the valves
        assert bench.valve_v == CENTRED
        return bench, bench.give(Frame(COMMAND, frame.data))

    @pytest.mark.parametrize("source", [SAMPLE, READ_BACK])
    def test_the_board_refuses_it(self, source: int) -> None:
        bench, answers = self.resent(2, source)
        (answer,) = answers
        assert bench.valve_v == CENTRED
        assert emergency(answer) == (0x20, 0x8200, 0x11)
        assert answer.data[3] == VendorCode.CRC

    def test_in_version_1_the_board_applied_it(self) -> None:
        bench, answers = self.resent(1, SAMPLE)
        assert answers == []
        assert bench.valve_v == pytest.approx(VOLTS, abs=10 / 4096)

    @given(counts, st.integers(0, 255), st.sampled_from([SAMPLE, READ_BACK]))
    def test_the_board_refuses_all_of_it(
        self, values: tuple[int, int, int], counter: int, source: int
    ) -> None:
        bench = Bench(at_once(2)).started()
        (answer,) = bench.give(Frame(COMMAND, pdo(source, values, counter).data))
        assert emergency(answer)[1] == 0x8200
        assert bench.valve_v == CENTRED

    def test_boards_alone_show_it_to_users(self) -> None:
        boards = BoardsAlone()
        boards.start_nodes()
        sample = next(frame for frame in boards.sync() if frame.id == SAMPLE)
        boards.send(Frame(COMMAND, sample.data))
        boards.sync()
        assert boards.valve_v == CENTRED
        boards.command((6.0, 5.0, 5.0))
        boards.sync()
        assert boards.valve_v[0] == pytest.approx(6.0, abs=0.003)

    @pytest.mark.parametrize("version", [1, 2])
    def test_the_fault_library_sends_it(self, version: int, tmp_path: Path) -> None:
        path = tmp_path / "rig.toml"
        path.write_text(rig_text({"bus.wire_version": str(version)}))
        boards = BoardsAlone(path, faults=["mislabel:sample,command@0"])
        boards.boards.plant.state.axis[0].position_m += 0.05  # type: ignore[attr-defined]  # off the centre
        boards.start_nodes()
        boards.sync()
        answers = boards.wait(0.001)
        boards.sync()
        is_refused = [frame.data[:2] for frame in answers if frame.id == 0x0A0] == [b"\x00\x82"]
        assert is_refused is (version == 2)
        assert (boards.valve_v == CENTRED) is (version == 2)

    def test_the_gateway_refuses_a_command_under_the_identifier_of_samples(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.deadline()
        output = gateway.receive(Frame(SAMPLE, pdo(COMMAND, (16384, 16384, 16384), gateway.counter).data))
        assert output.cycle is None and output.frames == ()
        assert texts(output)[0].startswith("guard: rejected: TPDO1_ADC: CRC 0x")


class TestVersions:
    @pytest.mark.parametrize("version", [1, 2])
    def test_the_same_version_works(self, version: int) -> None:
        rig = read_rig(rig_text({"bus.wire_version": str(version)}) + EMERGENCY_STOP, "rig.toml")
        bench = RigBench(rig).run()
        bench.periods(20)
        assert bench.gateway.state is LifeCycleState.RUNNING
        assert not any("CRC" in text for text in bench.transcript.texts())
        assert bench.boards.dac.valve_v != CENTRED

    @pytest.mark.parametrize(("gateway_version", "board_version"), [(1, 2), (2, 1)])
    def test_another_version_does_not_become_ready_and_the_log_says_why(
        self, gateway_version: int, board_version: int
    ) -> None:
        rig = make_rig({"bus.wire_version": str(gateway_version)})
        bench = RigBench(rig, boards_rig=with_version(rig, board_version))
        bench.periods(20)
        assert bench.gateway.state is LifeCycleState.OFFLINE
        hint = (
            f"the sender speaks wire version {board_version}, the rig file says {gateway_version}: update "
            f"the board, or write wire_version = {board_version} (rig: bus.wire_version)"
        )
        log = bench.transcript.texts()
        assert any(text.startswith("guard: rejected: TPDO1_ADC: CRC 0x") and hint in text for text in log)

    def test_boards_without_counter_and_crc_work_in_either_version(self) -> None:
        for one, other in product((1, 2), repeat=2):
            changes = {"adc.protected": "false", "dac.protected": "false", "bus.wire_version": str(one)}
            rig = make_rig(changes)
            bench = Bench(with_version(rig, other)).started()
            sample = next(frame for frame in bench.give(Frame(0x080)) if frame.id == SAMPLE)
            assert len(sample.data) == 6
            frames = list(commands_of(make_gateway(rig)))
            assert frames and all(bench.give(frame) == [] for frame in frames)


def commands_of(gateway: Gateway) -> Iterator[Frame]:
    for _ in range(5):
        yield from (f for f in gateway.on_deadline(gateway.next_deadline_ns).frames if f.id == COMMAND)


@pytest.mark.parametrize(("own", "other"), [(1, 2), (2, 1)])
def test_the_valve_board_reports_a_command_of_another_version(own: int, other: int) -> None:
    bench = Bench(at_once(own)).started()
    (answer,) = bench.give(pdo(COMMAND, (20000, 16384, 16384), 0, other))
    assert emergency(answer) == (0x20, 0x8200, 0x11)
    assert (answer.data[3], answer.data[4]) == (VendorCode.WIRE_VERSION, other)
    assert bench.valve_v == CENTRED
    assert len(bench.give(pdo(COMMAND, (20000, 16384, 16384), 0, own))) == 1  # the error is over
    assert bench.valve_v[0] > 6.0


@pytest.mark.parametrize("version", [1, 2])
def test_sdo_reads_the_version_of_a_board(version: int) -> None:
    rig = Bench(with_version(SHIPPED_RIG, version)).rig
    assert rig.adc._object_dictionary()[0x2010, 0].read() == version
    assert rig.dac._object_dictionary()[0x2010, 0].read() == version
