"""Faults between pins and plant, on given voltages."""

from __future__ import annotations

from random import Random

import pytest

from firmware_sim.faults.fault_text import parse_fault
from firmware_sim.faults.kinds import SensorFault, ValveFault
from firmware_sim.faults.wires import Wires

S = 1_000_000_000


def broken_sensor(text: str) -> tuple[Wires, SensorFault]:
    wires, fault = Wires(), parse_fault(text)
    assert isinstance(fault, SensorFault)
    wires.break_sensor(fault, 1, 10 * S, Random(1))
    return wires, fault


@pytest.mark.parametrize(
    ("text", "read_v"),
    [
        ("freeze-sensor:horizontal@0", [3.0, 3.0]),
        ("drift-sensor:horizontal,0.5@0", [3.0, 4.5]),
        ("offset-sensor:horizontal,-1@0", [2.0, 3.0]),
        ("offset-sensor:horizontal,9@0", [10.0, 10.0]),
        ("noisy-sensor:horizontal,0@0", [3.0, 4.0]),
    ],
)
def test_a_faulty_sensor_reads_these_voltages_and_the_others_are_right(
    text: str, read_v: list[float]
) -> None:
    wires, fault = broken_sensor(text)
    first, second = wires.sensed_v([1.0, 3.0, 2.0], 10 * S), wires.sensed_v([1.0, 4.0, 2.0], 11 * S)
    assert [first[1], second[1]] == pytest.approx(read_v)
    assert (first[0], first[2]) == (1.0, 2.0)
    wires.repair(fault)
    assert list(wires.sensed_v([1.0, 4.0, 2.0], 12 * S)) == [1.0, 4.0, 2.0]


def test_noise_has_its_standard_deviation() -> None:
    wires, _ = broken_sensor("noisy-sensor:horizontal,0.2@0")
    read = [wires.sensed_v([0.0, 5.0, 0.0], 10 * S)[1] - 5.0 for _ in range(4000)]
    assert (sum(value**2 for value in read) / len(read)) ** 0.5 == pytest.approx(0.2, rel=0.05)


@pytest.mark.parametrize(
    ("text", "driven_v"),
    [("stick-valve:vertical@0", [6.0, 6.0]), ("slow-valve:vertical,0.1@0", [8.528, 9.458])],
)
def test_a_faulty_valve_gets_these_voltages(text: str, driven_v: list[float]) -> None:
    wires, fault = Wires(), parse_fault(text)
    assert isinstance(fault, ValveFault)
    assert list(wires.driven_v([6.0, 5.0, 4.0], S)) == [6.0, 5.0, 4.0]
    wires.break_valve(fault, 0)
    held = [wires.driven_v([10.0, 5.0, 4.0], S // 10) for _ in range(2)]
    assert [volts[0] for volts in held] == pytest.approx(driven_v, abs=1e-3)
    assert list(held[0])[1:] == [5.0, 4.0]
    wires.repair(fault)
    assert list(wires.driven_v([10.0, 5.0, 4.0], S)) == [10.0, 5.0, 4.0]
