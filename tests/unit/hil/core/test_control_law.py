"""Control laws: compared with python-control; anti-windup and bumpless start as their docstrings say."""

from __future__ import annotations

import math
from collections.abc import Sequence

import control
import numpy as np
import pytest
import scipy.linalg
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.gateway_bench import make_rig

from firmware_sim.plants.linear_plant import LinearPlant
from hil.core.control_law import ControlLaw, anti_windup_gain, check_law_runs, realise
from hil.core.controller_file import Law, PidLaw, StateSpaceLaw, TransferFunctionLaw, read_controller
from hil.core.errors import DocumentError
from hil.host.controller_files import SHIPPED_CONTROLLERS, shipped_controllers

TS = 0.0112
Array = NDArray[np.float64]


def shipped(name: str) -> Law:
    return read_controller((SHIPPED_CONTROLLERS / f"{name}.json").read_text(), name).law


SHIPPED = pytest.mark.parametrize("name", shipped_controllers())


def run(law: ControlLaw, r: Sequence[float], y: Sequence[float]) -> Array:
    """Return the outputs of a law without limits."""
    outputs = []
    for r_k, y_k in zip(r, y, strict=True):
        outputs.append(law.output(r_k, y_k))
        law.advance(outputs[-1])
    return np.array(outputs)


def simulated(G: control.TransferFunction | control.StateSpace, inputs: Array) -> Array:
    """Return the response of a sampled system from rest, as python-control computes it."""
    steps = np.arange(inputs.shape[-1]) * G.dt
    return np.atleast_2d(control.forced_response(G, steps, inputs).outputs)[0]


def eq_19(pid: PidLaw) -> tuple[control.TransferFunction, ...]:
    """Return eq. (19) from r and from y, each term sampled by Tustin's rule."""
    s = control.tf("s")
    integral = pid.ki / s
    derivative = pid.kd * s / (pid.tau_d * s + 1)
    return tuple(
        control.sample_system(control.ss(kp * pid.kp + integral + weight * derivative), TS, "tustin")
        for kp, weight in ((pid.b, pid.c), (1.0, 1.0))
    )


def random_signals(seed: int, length: int = 400) -> tuple[Array, Array]:
    generator = np.random.default_rng(seed)
    return generator.normal(size=length), generator.normal(size=length)


class TestAgainstPythonControl:
    @pytest.mark.parametrize(
        "pid",
        [
            PidLaw(kp=11.013, ki=5.6444, kd=38.639, tau_d=74.162),
            PidLaw(kp=44.856, ki=198.17, kd=2.538, tau_d=0.00566),
            PidLaw(kp=-2.0, ki=0.5, kd=0.1, tau_d=0.05),
            PidLaw(kp=3.0, ki=2.0),
            PidLaw(kp=3.0, ki=0.0, kd=0.2, tau_d=0.03),
            PidLaw(kp=0.0, ki=7.0),
            PidLaw(kp=11.0, ki=5.0, kd=0.27, tau_d=0.0267, b=0.4, c=0.0),
            PidLaw(kp=11.0, ki=5.0, kd=0.27, tau_d=0.0267, b=0.0, c=1.0),
        ],
    )
    def test_pid_is_eq_19_by_tustin(self, pid: PidLaw) -> None:
        r, y = random_signals(1)
        from_r, from_y = eq_19(pid)
        expected = simulated(from_r, r) - simulated(from_y, y)
        assert np.max(np.abs(run(ControlLaw(pid, TS), r, y) - expected)) <= 1e-9 * np.max(np.abs(expected))

    def test_without_dynamics_the_pid_is_its_gain(self) -> None:
        assert run(ControlLaw(PidLaw(kp=3.0, ki=0.0, b=0.5), TS), [2.0, 0.0], [0.0, 1.0]).tolist() == [
            3.0,
            -3.0,
        ]

    @given(st.integers(0, 2**32), st.integers(0, 5), st.integers(0, 5))
    @settings(max_examples=40)
    def test_transfer_functions(self, seed: int, order: int, lacking: int) -> None:
        generator = np.random.default_rng(seed)
        poles = generator.uniform(-0.95, 0.95, order)
        den = np.poly(poles) * generator.uniform(0.1, 10.0)
        num = generator.normal(size=max(order + 1 - lacking, 1))
        law = TransferFunctionLaw(num=num.tolist(), den=np.atleast_1d(den).tolist())
        r, y = random_signals(seed % 1000, 100)
        expected = simulated(control.ss(control.tf(num, den, TS)), r - y)
        assert run(ControlLaw(law, TS), r, y) == pytest.approx(expected, rel=1e-9, abs=1e-9)

    @given(st.integers(0, 2**32), st.integers(0, 4), st.sampled_from(["e", "r, y"]))
    @settings(max_examples=40)
    def test_state_spaces(self, seed: int, n: int, inputs: str) -> None:
        generator = np.random.default_rng(seed)
        m = 1 if inputs == "e" else 2
        A = generator.normal(size=(n, n))
        A *= 0.95 / max(np.max(np.abs(np.linalg.eigvals(A)), initial=0.0), 1.0)
        B, C, D = (generator.normal(size=shape) for shape in ((n, m), (1, n), (1, m)))
        law = StateSpaceLaw(A=A.tolist(), B=B.tolist(), C=C.tolist(), D=D.tolist(), inputs=inputs)  # type: ignore[arg-type]
        r, y = random_signals(seed % 1000, 100)
        w = np.vstack([r, y]) if m == 2 else r - y
        expected = simulated(control.ss(A, B, C, D, TS), w) if n else (D @ np.atleast_2d(w))[0]
        assert run(ControlLaw(law, TS), r, y) == pytest.approx(expected, rel=1e-9, abs=1e-9)

    @SHIPPED
    def test_shipped_controllers(self, name: str) -> None:
        law = shipped(name)
        r, y = random_signals(2, 150)
        if isinstance(law, PidLaw):
            from_r, from_y = eq_19(law)
            expected = simulated(from_r, r) - simulated(from_y, y)
        else:
            assert isinstance(law, TransferFunctionLaw)
            expected = simulated(control.ss(control.tf(law.num, law.den, TS)), r - y)
        assert np.max(np.abs(run(ControlLaw(law, TS), r, y) - expected)) <= 1e-9 * np.max(np.abs(expected))


def spectral_radius(A: Array) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(A)), initial=0.0))


def conditioned(law: Law) -> Array:
    """Return A - L C, the dynamics of the law while its valve is limited."""
    A, B, C, D = realise(law, TS)
    return A - anti_windup_gain(A, B, C, D) @ C


gains = st.floats(-50.0, 50.0).filter(lambda k: k == 0 or abs(k) > 1e-3)
pids = st.builds(
    PidLaw,
    kp=gains,
    ki=gains,
    kd=gains,
    tau_d=st.floats(1e-3, 100.0),
    b=st.floats(0.0, 1.0),
    c=st.floats(0.0, 1.0),
)
INTEGRATING = [
    PidLaw(kp=0.0, ki=7.0),
    PidLaw(kp=3.0, ki=2.0),
    PidLaw(kp=-3.0, ki=2.0),  # an unstable zero
    PidLaw(kp=0.0, ki=0.0, kd=1.0, tau_d=0.1),  # a zero on the unit circle
    TransferFunctionLaw(num=[1.0, -1.8, 0.81], den=[1.0, -2.0, 1.0]),  # two integrators
    TransferFunctionLaw(num=[1.0, -1.2], den=[1.0, -1.0, 0.0]),  # an unstable zero, no direct feedthrough
    TransferFunctionLaw(num=[1.0], den=[1.0, -1.5, 0.5]),
    TransferFunctionLaw(num=[2.0, 1.0], den=[1.0, -2 * math.cos(0.3), 1.0]),  # a resonator on the circle
    TransferFunctionLaw(num=[1.0, 0.0], den=[1.0, -1.1]),  # unstable
    # Integrates y alone.
    StateSpaceLaw(A=[[1.0]], B=[[0.0, -1.0]], C=[[1.0]], D=[[0.5, -1.0]], inputs="r, y"),
]


def positions(law: ControlLaw, limit_v: float, steps: int, setpoint_until: int = 10_000) -> Array:
    """Simulate the closed loop with eq. (15): setpoint 0.1 m, and 0 from period ``setpoint_until`` on."""
    rig = make_rig()
    plant = LinearPlant(rig)
    result = []
    for k in range(steps):
        result.append(plant.position("vertical"))
        u = law.output(0.1 if k < setpoint_until else 0.0, result[-1])
        applied = min(max(u, -limit_v), limit_v)
        law.advance(applied)
        plant.advance(rig.loop.period_ns, (5.0 + applied, 5.0, 5.0))
    return np.array(result)


def way_back(law: ControlLaw, limit_v: float) -> float:
    """Return the integral of the absolute error after the setpoint has gone back to 0."""
    return float(np.sum(np.abs(positions(law, limit_v, 2700, setpoint_until=900)[900:]))) * TS


class TestAntiWindup:
    @SHIPPED
    def test_shipped_laws_decay_while_limited(self, name: str) -> None:
        assert spectral_radius(conditioned(shipped(name))) < 1 - 1e-5
        check_law_runs(shipped(name), TS, name)

    @pytest.mark.parametrize("law", INTEGRATING)
    def test_marginal_and_unstable_laws_decay_while_limited(self, law: Law) -> None:
        assert spectral_radius(conditioned(law)) < 0.9999
        check_law_runs(law, TS, "law")

    @given(pids)
    def test_any_pid_decays_while_limited(self, pid: PidLaw) -> None:
        assert spectral_radius(conditioned(pid)) < 1 - 1e-10
        check_law_runs(pid, TS, "pid")

    @given(st.integers(0, 2**32), st.integers(1, 5), st.integers(0, 2))
    def test_any_law_without_hidden_modes_decays_while_limited(
        self, seed: int, n: int, integrators: int
    ) -> None:
        generator = np.random.default_rng(seed)
        poles = np.concatenate([np.ones(min(integrators, n)), generator.uniform(-0.99, 0.99, n)])[:n]
        zeros = generator.uniform(-1.5, 1.5, generator.integers(0, n + 1))
        assume(np.min(np.abs(poles[:, None] - zeros[None, :]), initial=1.0) > 1e-3)  # no cancellation
        num = np.atleast_1d(np.poly(zeros)) * generator.uniform(0.1, 30.0)
        law = TransferFunctionLaw(num=num.tolist(), den=np.poly(poles).tolist())
        assert spectral_radius(conditioned(law)) < 1 - 1e-10

    @pytest.mark.parametrize("law", [*INTEGRATING, *map(shipped, shipped_controllers())])
    def test_the_gain_is_that_of_the_stationary_kalman_predictor(self, law: Law) -> None:
        """The reference is scipy's Riccati solver with the noise that the docstring states."""
        A, B, C, D = realise(law, TS)
        m = B.shape[1]
        responses = [D, *(C @ np.linalg.matrix_power(A, k) @ B for k in range(len(A)))]
        R = D @ D.T / m + (0.1 * np.max(np.abs(responses))) ** 2
        S = B @ D.T / m
        P = scipy.linalg.solve_discrete_are(A.T, C.T, B @ B.T / m, R, s=S)
        expected = (A @ P @ C.T + S) / (R + C @ P @ C.T)
        L = anti_windup_gain(A, B, C, D)
        assert pytest.approx(expected, abs=1e-4 * np.max(np.abs(expected))) == L

    @pytest.mark.parametrize("law", INTEGRATING)
    @pytest.mark.parametrize("factor", [1e-4, 100.0])
    def test_the_gain_does_not_depend_on_units(self, law: Law, factor: float) -> None:
        A, B, C, D = realise(law, TS)
        L = anti_windup_gain(A, B, C, D)
        in_other_input_units = anti_windup_gain(A, factor * B, C, factor * D)
        in_other_output_units = anti_windup_gain(A, B, factor * C, factor * D)
        assert in_other_input_units == pytest.approx(L, rel=1e-6)
        assert in_other_output_units * factor == pytest.approx(L, rel=1e-6)

    def test_the_gain_is_hanus_conditioning_for_stable_zeros(self) -> None:
        A, B, C, D = realise(PidLaw(kp=3.0, ki=20.0), TS)
        # L = b/d leaves A - L C with the law's own zero.
        zero = float(A[0, 0] - B[0, 0] / D[0, 0] * C[0, 0])
        assert float(conditioned(PidLaw(kp=3.0, ki=20.0))[0, 0]) == pytest.approx(zero, abs=0.01)

    @pytest.mark.parametrize("law", [*INTEGRATING, *map(shipped, shipped_controllers())])
    def test_anti_windup_does_not_act_without_a_limit(self, law: Law) -> None:
        tracking, without = ControlLaw(law, TS), ControlLaw(law, TS)
        without._L = [0.0] * len(without._L)
        r, y = random_signals(3, 60)
        assert np.array_equal(run(tracking, r, y), run(without, r, y))

    @pytest.mark.parametrize("name", ["ppid", "hls", "zn", "tlc"])
    def test_a_saturated_loop_recovers_sooner_than_without(self, name: str) -> None:
        law, naive = ControlLaw(shipped(name), TS), ControlLaw(shipped(name), TS)
        naive._L = [0.0] * len(naive._L)
        # 0.12 V cannot reach the setpoint: 10 s of limit, then back to 0.
        assert way_back(law, limit_v=0.12) < 0.25 * way_back(naive, limit_v=0.12)

    @pytest.mark.parametrize("name", ["ppid", "hls", "zn", "tlc"])
    def test_a_saturated_step_overshoots_less_than_without(self, name: str) -> None:
        law, naive = ControlLaw(shipped(name), TS), ControlLaw(shipped(name), TS)
        naive._L = [0.0] * len(naive._L)
        overshoot, of_naive = (np.max(positions(k, limit_v=0.5, steps=900)) - 0.1 for k in (law, naive))
        assert overshoot < 0.25 * of_naive

    @SHIPPED
    def test_after_a_long_limit_the_output_leaves_it_with_the_error(self, name: str) -> None:
        """After 30 s at the limit, the output leaves it in the sample in which the error changes its sign."""
        law = ControlLaw(shipped(name), TS)
        for _ in range(2700):
            law.advance(min(law.output(0.1, 0.0), 0.5))
        assert law.output(0.1, 0.0) > 0.5
        assert law.output(0.0, 0.1) < 0.5

    @pytest.mark.parametrize(
        ("law", "said"),
        [
            (
                StateSpaceLaw(A=[[1.0, 0.0], [0.0, 0.5]], B=[[1.0], [1.0]], C=[[0.0, 1.0]], D=[[1.0]]),
                "not seen in the output",
            ),
            (StateSpaceLaw(A=[[1.1]], B=[[0.0]], C=[[1.0]], D=[[1.0]]), "not moved by the input"),
            (StateSpaceLaw(A=[[1.0]], B=[[0.0]], C=[[1.0]], D=[[1.0]]), "give a minimal realisation"),
            (TransferFunctionLaw(num=[1.0], den=[1e-320, 1.0]), "coefficient of nan"),
            (
                TransferFunctionLaw(num=[1.0], den=[1e-300, 1.0]),
                "coefficient of 1e+300, over the limit 1e+12",
            ),
            (TransferFunctionLaw(num=[1e13], den=[1.0]), "coefficient of 1e+13"),
            (PidLaw(kp=1e300, ki=0.0), "scale the law"),
        ],
    )
    def test_what_cannot_be_conditioned_or_computed_is_refused(self, law: Law, said: str) -> None:
        with pytest.raises(DocumentError, match=r"^vertical: x\.json: law: ") as caught:
            check_law_runs(law, TS, "vertical: x.json")
        assert said in str(caught.value)

    def test_a_law_with_the_largest_coefficient_is_accepted(self) -> None:
        check_law_runs(TransferFunctionLaw(num=[1e12], den=[1.0]), TS, "x")


WITH_DYNAMICS: list[Law] = [
    *map(shipped, shipped_controllers()),
    PidLaw(kp=3.0, ki=2.0),
    PidLaw(kp=3.0, ki=2.0, kd=1.0, tau_d=1e-6),
    PidLaw(kp=3.0, ki=0.0, kd=0.2, tau_d=0.03),
    PidLaw(kp=11.0, ki=5.0, kd=0.27, tau_d=0.0267, b=0.4, c=0.0),
    TransferFunctionLaw(num=[1.0, -0.5], den=[1.0, -0.9]),
    *INTEGRATING,
]


class TestBumplessStart:
    @pytest.mark.parametrize("law", WITH_DYNAMICS)
    @pytest.mark.parametrize(
        ("r", "y", "u"), [(0.0, 0.1, 0.0), (0.05, -0.02, 1.5), (0.1, 0.1, -2.0), (0.0, 0.0, 0.0)]
    )
    def test_the_next_output_is_what_was_asked_for(self, law: Law, r: float, y: float, u: float) -> None:
        control_law = ControlLaw(law, TS)
        control_law.initialise(r, y, u)
        assert control_law.output(r, y) == pytest.approx(u, abs=1e-9)

    @pytest.mark.parametrize(
        "pid", [law for law in WITH_DYNAMICS if isinstance(law, PidLaw) and law.ki and law.b == law.c == 1.0]
    )
    @pytest.mark.parametrize(("r", "y", "u"), [(0.0, 0.1, 0.0), (0.05, -0.02, 1.5)])
    def test_afterwards_a_pid_only_integrates(self, pid: PidLaw, r: float, y: float, u: float) -> None:
        """For constant r and y, the output changes only by ki times the error: no sample has a jump."""
        law = ControlLaw(pid, TS)
        law.initialise(r, y, u)
        k = np.arange(50)
        expected = u + k * TS * pid.ki * (r - y)
        assert run(law, [r] * 50, [y] * 50) == pytest.approx(expected, abs=1e-7)

    def test_a_two_degree_of_freedom_pid_only_integrates_too(self) -> None:
        law = ControlLaw(PidLaw(kp=11.0, ki=5.0, kd=0.27, tau_d=0.0267, b=0.4, c=0.0), TS)
        law.initialise(0.1, 0.02, 0.7)
        assert run(law, [0.1] * 20, [0.02] * 20) == pytest.approx(0.7 + np.arange(20) * TS * 5.0 * 0.08)

    def test_afterwards_hls_does_not_jump(self) -> None:
        law = ControlLaw(shipped("hls"), TS)
        law.initialise(0.0, 0.1, 0.0)
        steps = np.abs(np.diff(run(law, [0.0] * 200, [0.1] * 200)))
        proportional = 0.1 * 18.0  # what an error of 0.1 m would give from rest, in volts
        assert np.max(steps) < 0.01 * proportional

    @pytest.mark.parametrize("law", WITH_DYNAMICS)
    def test_initialise_removes_the_earlier_state(self, law: Law) -> None:
        used, fresh = ControlLaw(law, TS), ControlLaw(law, TS)
        run(used, *random_signals(4, 30))
        for control_law in (used, fresh):
            control_law.initialise(0.03, 0.01, 0.4)
        r, y = random_signals(5, 20)
        assert np.array_equal(run(used, r, y), run(fresh, r, y))

    @pytest.mark.parametrize("law", [PidLaw(kp=2.0, ki=0.0), StateSpaceLaw(A=[], B=[], C=[[]], D=[[2.0]])])
    def test_a_law_without_dynamics_has_no_state_to_set(self, law: Law) -> None:
        control_law = ControlLaw(law, TS)
        control_law.initialise(0.1, 0.0, 5.0)
        assert control_law.output(0.1, 0.0) == pytest.approx(0.2)

    def test_a_law_whose_state_is_not_seen_in_the_output(self) -> None:
        law = ControlLaw(StateSpaceLaw(A=[[0.5]], B=[[1.0]], C=[[0.0]], D=[[1.0]]), TS)
        law.initialise(0.2, 0.0, 9.0)
        assert law.output(0.2, 0.0) == pytest.approx(0.2)


def test_output_does_not_change_the_state() -> None:
    asked_once, asked_often = ControlLaw(shipped("zn"), TS), ControlLaw(shipped("zn"), TS)
    for r, y in zip(*random_signals(6, 20), strict=True):
        expected = asked_once.output(r, y)
        asked_once.advance(expected)
        asked_often.output(y, r)
        assert asked_often.output(r, y) == expected
        asked_often.advance(expected)


@pytest.mark.parametrize("law", [*INTEGRATING, *map(shipped, shipped_controllers())])
def test_the_limited_output_acts_through_the_gain(law: Law) -> None:
    A, B, C, D = realise(law, TS)
    expected = float((C @ anti_windup_gain(A, B, C, D))[0, 0])
    free, limited = ControlLaw(law, TS), ControlLaw(law, TS)
    free.advance(free.output(0.1, 0.2))
    limited.advance(limited.output(0.1, 0.2) - 0.5)
    assert limited.output(0.3, 0.1) - free.output(0.3, 0.1) == pytest.approx(-0.5 * expected)
