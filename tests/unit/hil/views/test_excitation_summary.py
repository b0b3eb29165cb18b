"""The table that ``hil collect`` shows before anything moves."""

import json
from importlib import resources
from io import StringIO

import pytest
from rich.console import Console

from hil.core.controller_file import read_controller
from hil.core.excitation import Chirp, Multisine, Prbs, Signal, Steps, Table, samples
from hil.views.excitation_summary import describe, excitation_summary, loop_crossover

TS = 0.0112
SIGNALS: list[tuple[Signal, str]] = [
    (Prbs(amplitude=0.4, duration_s=60.0), "prbs, ±0.4 V, 60 s, clock 12 periods, seed 1"),
    (Prbs(amplitude=0.4, duration_s=60.0, levels=5), "prbs of 5 levels, ±0.4 V"),
    (Multisine(amplitude=0.4, duration_s=60.0), "0.2 to 40 rad/s, 2 repetitions, schroeder phases"),
    (Multisine(amplitude=0.4, duration_s=60.0, phases="random", seed=3), "random phases, seed 3"),
    (Chirp(amplitude=0.4, duration_s=60.0), "logarithmic chirp, ±0.4 V, 60 s, 0.2 to 40 rad/s"),
    (Steps(amplitude=0.4, duration_s=60.0), "steps, ±0.4 V, 60 s, each held 2 s"),
    (Table(file="u.csv", time_s=[0.0, 2.5, 5.0], value=[0.1, -0.1, 0.0]), "u.csv, 5 s"),
]


def shipped(name: str) -> str:
    return (resources.files("hil.shipped") / f"controllers/{name}.json").read_text()


@pytest.mark.parametrize(("signal", "expected"), SIGNALS)
def test_a_signal_is_described_in_words(signal: Signal, expected: str) -> None:
    assert expected in describe(signal, "V")


@pytest.mark.parametrize("signal", [signal for signal, _ in SIGNALS])
def test_the_table_fits_80_columns_and_its_shares_add_up(signal: Signal) -> None:
    out = StringIO()
    Console(file=out, width=80).print(excitation_summary(signal, samples(signal, TS), TS, "V", 4.07))
    lines = out.getvalue().splitlines()
    assert max(map(len, lines)) <= 80
    shares = [int(line.split("%")[0].split()[-1]) for line in lines if "rad/s " in line and " %" in line[18:]]
    assert sum(shares) == pytest.approx(100, abs=4)
    (marked,) = [line for line in lines if "crossover of the loop, 4.07 rad/s" in line]
    assert marked.lstrip().startswith("3 to 10 rad/s")


class TestCrossover:
    def test_it_is_that_of_the_plant_in_the_controller_file(self) -> None:
        controller = read_controller(shipped("rotation"), "rotation")
        assert loop_crossover(controller) == pytest.approx(2.49, abs=0.05)

    @pytest.mark.parametrize("plant", ["eq. (15)", None, {"num": "x", "den": [1.0]}, {}])
    def test_without_a_plant_in_the_file_it_is_not_known(self, plant: object) -> None:
        document = json.loads(shipped("rotation"))
        document["origin"]["plant"] = plant
        assert loop_crossover(read_controller(json.dumps(document), "x")) is None

    def test_a_gain_that_never_reaches_one_has_none(self) -> None:
        document = json.loads(shipped("rotation"))
        document["law"] = {"kind": "pid", "kp": 1e-4, "ki": 0.0}
        assert loop_crossover(read_controller(json.dumps(document), "x")) is None
