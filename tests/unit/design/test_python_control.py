"""Conversions to and from python-control, and its own computation of what was designed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import control
import msgspec
import numpy as np
import pytest
from support.designs import sampled_design
from support.paper_loop import G0, PERIOD_S

from design.errors import DesignError
from design.models.plant import Plant, paper_plant
from design.models.sampling import Sampling
from design.output.controller_files import controller_files
from design.python_control import controller_to_control, plant_from_control, plant_to_control
from hil.core.controller_file import PidLaw, read_controller
from hil.core.errors import DocumentError, HilError

SAMPLING = Sampling(PERIOD_S, 1)
FILES = {Path(name).stem: text for name, text in controller_files(sampled_design()).items()}


def running(stem: str) -> control.StateSpace:
    return controller_to_control(read_controller(FILES[stem], stem))


def test_a_plant_converted_forth_and_back_is_the_same() -> None:
    there = plant_to_control(paper_plant())
    omega = np.geomspace(0.01, 300.0, 50)
    expected = np.polyval(G0.num, 1j * omega) / np.polyval(G0.den, 1j * omega)
    np.testing.assert_allclose(there(1j * omega), expected, rtol=1e-12)
    for system in (there, control.ss(there)):
        back = plant_from_control(system, name="paper", output_unit="m")
        np.testing.assert_allclose(back.num, paper_plant().num, rtol=1e-9)
        np.testing.assert_allclose(back.den, paper_plant().den, rtol=1e-9)
        assert back.sample_time_s is None


def test_the_hold_of_a_discrete_time_model_is_inverted() -> None:
    held = control.sample_system(control.ss(plant_to_control(paper_plant())), PERIOD_S, "zoh")
    back = plant_from_control(held, name="held", output_unit="m")
    np.testing.assert_allclose(back.num, paper_plant().num, rtol=1e-6)
    np.testing.assert_allclose(back.den, paper_plant().den, rtol=1e-6)
    assert back.sample_time_s == PERIOD_S
    integrating = control.sample_system(control.tf([2.0], [1.0, 3.0, 0.0]), 0.1, "zoh")
    back = plant_from_control(integrating, name="integrating", output_unit="rad")
    assert back.output_unit == "rad"
    np.testing.assert_allclose(back.num, [2.0], rtol=1e-6)
    np.testing.assert_allclose(back.den, [1.0, 3.0, 0.0], atol=1e-9)


def test_hold_and_delay_agree_with_python_control() -> None:
    held = control.sample_system(control.ss(plant_to_control(paper_plant())), PERIOD_S, "zoh")
    late = held * control.ss(control.tf([1.0], [1.0, 0.0], PERIOD_S))
    z = np.exp(1j * np.geomspace(0.01, 250.0, 60) * PERIOD_S)
    np.testing.assert_allclose(plant_to_control(paper_plant(), SAMPLING)(z), late(z), rtol=1e-8)


@pytest.mark.parametrize(("dead_time_s", "tenths"), [(0.0, 0), (0.0448, 40), (0.03696, 33), (0.00112, 1)])
def test_a_dead_time_is_exact_in_discrete_time(dead_time_s: float, tenths: int) -> None:
    """The reference samples the plant ten times in a period, and delays its input by tenths of the period."""
    late = msgspec.structs.replace(paper_plant(), dead_time_s=dead_time_s)
    converted = plant_to_control(late, SAMPLING)
    assert converted.D[0, 0] == 0.0
    assert np.isfinite(converted.A).all()
    fast = control.sample_system(control.ss(plant_to_control(paper_plant())), PERIOD_S / 10.0, "zoh")
    u = np.random.default_rng(2).choice([-1.0, 1.0], 40)
    delayed_u = np.concatenate([np.zeros(tenths + 10), np.repeat(u, 10)])[: 10 * len(u)]
    expected = control.forced_response(fast, inputs=delayed_u).outputs[::10]
    simulated = control.forced_response(converted, inputs=u).outputs
    np.testing.assert_allclose(simulated, expected, atol=1e-9)


def test_a_dead_time_has_no_exact_continuous_model() -> None:
    late = msgspec.structs.replace(paper_plant(), dead_time_s=0.03)
    with pytest.raises(DesignError, match=r"dead_time_s: the plant has a dead time of 0\.03 s"):
        plant_to_control(late)
    only_of_the_rig = msgspec.structs.replace(paper_plant(), dead_time_s=PERIOD_S, contains_delay_samples=1)
    assert plant_to_control(only_of_the_rig)(0.0).real == pytest.approx(0.6126, abs=1e-4)


def test_a_dead_time_can_be_given_with_a_model() -> None:
    plant = plant_from_control(
        control.sample_system(control.tf([2.0], [1.0, 3.0]), 0.01, "zoh"),
        name="p",
        output_unit="m",
        dead_time_s=0.025,
        contains_delay_samples=1,
    )
    assert plant.own_dead_time_s == pytest.approx(0.015)
    assert plant.sample_time_s == 0.01


@pytest.mark.parametrize("index", range(5))
def test_the_reported_response_is_python_controls_simulation_of_the_file(index: int) -> None:
    design = sampled_design()
    stem = list(FILES)[index]
    loop = control.interconnect(
        [plant_to_control(paper_plant(), SAMPLING), running(stem)], inputs="r", outputs=["y", "u"]
    )
    expected = design.problem.step(design.candidates[index], 3.0)
    simulated = control.step_response(loop, expected.time_s)
    np.testing.assert_allclose(simulated.outputs[0, 0], expected.y[0], atol=1e-9)
    np.testing.assert_allclose(simulated.outputs[1, 0], expected.u[0], atol=1e-7 * np.abs(expected.u).max())


@pytest.mark.parametrize("index", range(5))
def test_the_reported_margin_is_slycots_norm_of_what_the_daemon_runs(index: int) -> None:
    """The loop consists of hold, plant, one sample of delay, and the law of the file, eq. (13)."""
    design = sampled_design()
    stem = list(FILES)[index]
    W = control.tf(design.weight.weight.num, design.weight.weight.den)
    W, W_inverse = (control.sample_system(control.ss(H), PERIOD_S, "bilinear") for H in (W, 1 / W))
    held = control.sample_system(control.ss(plant_to_control(paper_plant())), PERIOD_S, "zoh")
    Gs = held * control.ss(control.tf([1.0], [1.0, 0.0], PERIOD_S)) * W
    n = Gs.nstates
    P = control.ss(
        Gs.A,
        np.hstack([np.zeros((n, 1)), Gs.B, Gs.B]),
        np.vstack([Gs.C, np.zeros((1, n)), Gs.C]),
        [[1.0, *2 * [Gs.D[0, 0]]], [0.0, 0.0, 1.0], [1.0, *2 * [Gs.D[0, 0]]]],
        PERIOD_S,
    )
    law = running(stem)
    feedback = control.ss(law.A, law.B[:, 1:], law.C, law.D[:, 1:], PERIOD_S)
    norm, _ = control.linfnorm(P.lft(W_inverse * feedback), tol=1e-12)
    reported = read_controller(FILES[stem], stem).origin["margins"]["eps_sampled"]
    assert reported == design.measures[index].eps_sampled
    assert 1.0 / norm == pytest.approx(reported, rel=1e-7)


@pytest.mark.parametrize("delay_samples", [0, 1, 3])
def test_no_feedback_becomes_an_algebraic_loop(delay_samples: int) -> None:
    """Rounding leaves this lightly damped plant a direct path of 1e-19, which must be removed."""
    plant = Plant(
        format="hil-plant",
        version=1,
        name="p",
        input_unit="V",
        output_unit="m",
        num=[1.0],
        den=[1.0, 0.02, 4.0],
    )
    G = plant_to_control(plant, Sampling(PERIOD_S, delay_samples))
    assert G.D[0, 0] == 0.0
    law = msgspec.structs.replace(read_controller(FILES["controller"], "c"), law=PidLaw(kp=0.1, ki=0.1))
    loop = control.interconnect([G, controller_to_control(law)], inputs="r", outputs="y")
    assert loop.nstates == 3 + delay_samples
    biproper = msgspec.structs.replace(plant, num=[1.0, 0.0, 8.0])
    assert plant_to_control(biproper, Sampling(PERIOD_S, 0)).D[0, 0] == pytest.approx(1.0)


def test_setpoint_weights_are_converted_too() -> None:
    file = read_controller(FILES["controller"], "c")
    pid = PidLaw(kp=3.0, ki=2.0, kd=0.1, tau_d=0.05, b=0.4, c=0.0)
    law = controller_to_control(msgspec.structs.replace(file, law=pid))
    assert (law.input_labels, law.output_labels, law.dt) == (["r", "y"], ["u"], PERIOD_S)
    first = control.step_response(law, PERIOD_S * np.arange(3.0)).outputs[0, :, 0]
    half, filtered = 0.5 * 2.0 * PERIOD_S, 2.0 * 0.1 / (2.0 * 0.05 + PERIOD_S)
    np.testing.assert_allclose(first, [0.4 * 3.0 + half, -(3.0 + half + filtered)], rtol=1e-12)


@pytest.mark.parametrize(
    ("system", "said"),
    [
        (control.ss([[-1.0]], [[1.0, 2.0]], [[1.0]], [[0.0, 0.0]]), "2 inputs and 1 outputs"),
        (control.tf([1.0], [1.0, -0.5], True), "sample time is not given"),
        (
            control.tf([1.0], [1.0, -0.5, 0.0], 0.1),
            "remove whole samples of delay .* give them as dead_time_s",
        ),
        (control.tf([1.0], [1.0, 0.5], 0.1), "z = -0.5: no continuous system"),
    ],
)
def test_what_is_no_plant_is_refused(system: control.TransferFunction, said: str) -> None:
    with pytest.raises(DesignError, match=said):
        plant_from_control(system, name="p", output_unit="m")


def test_a_plant_from_there_is_checked_like_any_other() -> None:
    hidden = control.tf([1.0, -1.0], [1.0, 1.0, -2.0])
    with pytest.raises(DocumentError, match="unstable pole at s = 1 is cancelled"):
        plant_from_control(hidden, name="p", output_unit="m")
    with pytest.raises(HilError, match="improper"):
        plant_from_control(control.tf([1.0, 0.0, 0.0], [1.0, 1.0]), name="p", output_unit="m")
    assert isinstance(plant_from_control(control.tf([1.0], [1.0, 1.0]), name="p", output_unit="m"), Plant)


def test_a_design_imports_neither_python_control_nor_scipy(tmp_path: Path) -> None:
    """Importing one of them takes a good part of the time of a whole design."""
    code = (
        "import sys; from hil.cli import main; import design.python_control\n"
        "status = main(['design', '--out', sys.argv[1]])\n"
        "assert not {'control', 'slycot', 'matplotlib', 'scipy'} & set(sys.modules)\n"
        "sys.exit(status)"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "out")], check=True, capture_output=True)
