"""The EDS files of both boards open in a CANopen tool and describe what the simulated boards have."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any

import canopen
import cantools
import pytest
from support.board_bench import SYNC, Bench
from support.protected_rigs import protected_rig
from support.shipped_rig import SHIPPED_RIG

from firmware_sim.boards.object_dictionary import AbortCode, Dictionary
from hil.core.wire import codec

BOARDS = {"adc": 0x10, "dac": 0x20}
DATABASE: Any = cantools.database.load_file(str(Path(codec.__file__).with_name("arm.dbc")))
NOT_USED = 1 << 31


def eds(board: str, node: int | None = None) -> Any:
    path = str(files("hil.shipped") / f"{board}.eds")
    return canopen.import_od(path, node_id=node or BOARDS[board])


def entries(dictionary: Any) -> dict[tuple[int, int], Any]:
    """The variables of an object dictionary of ``canopen``, by index and subindex."""
    found = {}
    for index in dictionary:
        thing = dictionary[index]
        if isinstance(thing, canopen.objectdictionary.ODVariable):
            found[index, 0] = thing
        else:
            found |= {(index, subindex): thing[subindex] for subindex in thing}
    return found


def simulated(board: str) -> Dictionary:
    return getattr(Bench(SHIPPED_RIG).rig, board)._object_dictionary()  # type: ignore[no-any-return]


@pytest.mark.parametrize("board", BOARDS)
def test_the_file_has_the_entries_of_the_simulated_board_with_their_types_and_access(board: str) -> None:
    described, real = entries(eds(board)), simulated(board)
    assert described.keys() == real.keys()
    for key, variable in described.items():
        assert variable.data_type == real[key].data_type, key
        assert (variable.access_type == "rw") is (real[key].write is not None), key


@pytest.mark.parametrize("board", BOARDS)
def test_default_values_are_those_of_the_board_after_power_on(board: str) -> None:
    real = simulated(board)
    compared = 0
    for key, variable in entries(eds(board)).items():
        value = real[key].read()
        if variable.default is not None and not isinstance(value, AbortCode):
            assert variable.default == value, key
            compared += 1
    assert compared > 30


@pytest.mark.parametrize("board", BOARDS)
def test_the_identity_is_the_same(board: str) -> None:
    described = eds(board)
    device = described.device_information
    assert device.product_name == described[0x1008].default
    assert (device.product_number, device.revision_number) == (BOARDS[board], 0x10000)
    assert [described[0x1018][n].default for n in (1, 2, 3)] == [0, BOARDS[board], 0x10000]


@pytest.mark.parametrize(
    ("board", "parameter", "message"),
    [
        ("adc", 0x1800, "TPDO1_ADC"),
        ("adc", 0x1801, "TPDO2_ADC"),
        ("dac", 0x1400, "RPDO1_DAC"),
        ("dac", 0x1800, "TPDO1_DAC"),
    ],
)
def test_identifiers_and_mapping_are_those_of_arm_dbc(board: str, parameter: int, message: str) -> None:
    described, frame = eds(board), DATABASE.get_message_by_name(message)
    assert described[parameter][1].default & ~NOT_USED == frame.frame_id
    mapping = described[parameter + 0x200]
    mapped = [mapping[n].default for n in range(1, mapping[0].default + 1)]
    signals = sorted(frame.signals, key=lambda signal: signal.start)
    assert [value & 0xFF for value in mapped] == [signal.length for signal in signals]
    for value, signal in zip(mapped, signals, strict=True):
        variable = described[value >> 16][value >> 8 & 0xFF]
        assert variable.pdo_mappable
        assert (variable.data_type == canopen.objectdictionary.INTEGER16) is signal.is_signed


def test_optional_pdos_are_switched_off_until_a_rig_file_asks_for_them() -> None:
    assert eds("adc")[0x1801][1].default == NOT_USED | 0x290
    assert eds("dac")[0x1800][1].default == NOT_USED | 0x1A0
    assert eds("dac")[0x1400][1].default == 0x220
    asked = Bench(protected_rig(read_back=True)).rig
    assert asked.adc._object_dictionary()[0x1801, 1].read() == 0x290
    assert asked.dac._object_dictionary()[0x1800, 1].read() == 0x1A0


@pytest.mark.parametrize("board", BOARDS)
def test_identifiers_follow_the_node_id(board: str) -> None:
    assert eds(board, 0x33)[0x1014].default == 0x080 + 0x33


def test_process_data_that_sdo_reads_are_those_of_the_last_frames() -> None:
    bench = Bench().started()
    bench.plant.volts = [1.25, 2.5, 7.5]
    bench.command(6.25, 5.0, 5.0)
    bench.give(SYNC)
    adc, dac = bench.rig.adc._object_dictionary(), bench.rig.dac._object_dictionary()
    assert [adc[0x6401, channel].read() for channel in (1, 2, 3)] == [4096, 8192, 24576]
    assert [dac[0x6411, channel].read() for channel in (1, 2, 3)] == [20480, 16384, 16384]
    assert [dac[0x2002, channel].read() for channel in (1, 2, 3)] == [20480, 16384, 16384]
    assert (adc[0x2000, 1].read(), dac[0x2000, 1].read()) == (0, bench.counter)
