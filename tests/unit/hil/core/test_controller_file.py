"""Controller files: the shipped ones load; an error names file, key and limit."""

from __future__ import annotations

import copy
import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.controller_file import (
    MAX_COEFFICIENT,
    MAX_STATES,
    ControllerFile,
    PidLaw,
    StateSpaceLaw,
    TransferFunctionLaw,
    check_controller_fits,
    read_controller,
)
from hil.core.documents import to_json
from hil.core.errors import DocumentError
from hil.host.controller_files import SHIPPED_CONTROLLERS, shipped_controllers

PID: dict[str, Any] = {
    "format": "hil-controller",
    "version": 1,
    "name": "mine",
    "description": "a PID",
    "sample_time_s": 0.0112,
    "input_unit": "m",
    "output_unit": "V",
    "law": {"kind": "pid", "kp": 11.0, "ki": 5.6, "kd": 0.3, "tau_d": 0.02},
    "origin": {"method": "by hand", "margins": [0.5, {"gm_db": 12.0}]},
}


def with_law(**law: Any) -> dict[str, Any]:
    return PID | {"law": law}


def refusal(plain: dict[str, Any]) -> str:
    with pytest.raises(DocumentError) as caught:
        read_controller(json.dumps(plain), "mine.json")
    return str(caught.value)


class TestShipped:
    def test_the_four_controllers_of_the_paper_are_shipped(self) -> None:
        assert {"hls", "ppid", "tlc", "zn"} <= set(shipped_controllers())

    @pytest.mark.parametrize("name", shipped_controllers())
    def test_shipped_controllers_fit_the_loop_of_the_paper(self, name: str) -> None:
        controller = read_controller((SHIPPED_CONTROLLERS / f"{name}.json").read_text(), name)
        assert controller.name == name
        check_controller_fits(controller, name, 0.0112, controller.input_unit)
        assert controller.origin

    def test_ppid_is_eq_20(self) -> None:
        law = read_controller((SHIPPED_CONTROLLERS / "ppid.json").read_text(), "ppid").law
        assert law == PidLaw(kp=11.013, ki=5.6444, kd=38.639, tau_d=74.162)


def test_a_pid_is_read_with_its_defaults() -> None:
    controller = read_controller(json.dumps(PID), "mine.json")
    assert controller.law == PidLaw(kp=11.0, ki=5.6, kd=0.3, tau_d=0.02, b=1.0, c=1.0)
    assert controller.origin == PID["origin"]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"format": "hil"}, "format is 'hil', but must be 'hil-controller'"),
        ({"version": 2}, "version is 2, but must be 1"),
        ({"version": "1"}, "version is '1', but must be a whole number"),
        ({"input_unit": "mm"}, "input_unit is 'mm', but must be 'm' or 'rad'"),
        ({"output_unit": "mV"}, "output_unit is 'mV', but must be 'V'"),
        ({"sample_time_s": 0}, "sample_time_s is 0, but must be more than 0.0"),
        ({"sample_time_s": -0.0112}, "sample_time_s is -0.0112, but must be more than 0.0"),
        (
            {"sample_time": 1},
            "unknown key sample_time; did you mean sample_time_s? "
            "Valid keys: format, version, name, description, sample_time_s, input_unit, output_unit, law, "
            "origin",
        ),
        (
            {"law": {"kind": "lqr"}},
            "law.kind is 'lqr', but must be 'pid' or 'transfer_function' or 'state_space'",
        ),
        (
            {"law": {"kp": 1.0}},
            "law: missing key kind, which must be 'pid' or 'transfer_function' or 'state_space'",
        ),
        ({"law": {"kind": "pid", "kp": 1.0}}, "law: missing key ki"),
        (
            {"law": PID["law"] | {"Kp": 1.0}},
            "law: unknown key Kp; did you mean kp? Valid keys: kind, kp, ki, kd, tau_d, b, c",
        ),
        ({"law": PID["law"] | {"kp": "11"}}, "law.kp is '11', but must be a number"),
        ({"law": PID["law"] | {"tau_d": -0.1}}, "law.tau_d is -0.1, but must be at least 0.0"),
        (
            {"law": PID["law"] | {"tau_d": 0}},
            "law.tau_d is 0 s with kd 0.3: the derivative is not filtered; give tau_d > 0",
        ),
        (
            {"law": {"kind": "transfer_function", "num": [1.0], "den": [1.0, [2.0]]}},
            "law.den[1] is a list, but must be a number",
        ),
        (
            {"law": {"kind": "transfer_function", "num": [1.0, 2.0, 3.0], "den": [1.0, -1.0]}},
            "law: num has degree 2, den 1: the law would need future errors",
        ),
        (
            {"law": {"kind": "transfer_function", "num": [1.0], "den": [0.0, 1.0]}},
            "law.den: the leading coefficient must not be 0",
        ),
        (
            {"law": {"kind": "transfer_function", "num": [1.0], "den": []}},
            "law.den: the leading coefficient must not be 0",
        ),
        (
            {"law": {"kind": "transfer_function", "num": [], "den": [1.0]}},
            "law.num is empty; give at least one coefficient",
        ),
        (
            {"law": {"kind": "state_space", "A": [[1]], "B": [[1]], "C": [[1]], "D": [[1]], "inputs": "y"}},
            "law.inputs is 'y', but must be 'e' or 'r, y'",
        ),
    ],
)
def test_an_error_names_file_and_key(changes: dict[str, Any], text: str) -> None:
    assert refusal(PID | changes) == f"mine.json: {text}"


@pytest.mark.parametrize("key", sorted(set(PID) - {"law"}))
def test_every_key_is_required(key: str) -> None:
    plain = {k: v for k, v in PID.items() if k != key}
    assert refusal(plain) == f"mine.json: missing key {key}"


@pytest.mark.parametrize(("literal", "shown"), [("NaN", "nan"), ("Infinity", "inf"), ("-1e400", "-inf")])
def test_numbers_that_are_not_finite_are_refused_by_key(literal: str, shown: str) -> None:
    for place, text in (("law.kp", '"kp": 11.0'), ("sample_time_s", '"sample_time_s": 0.0112')):
        json_text = json.dumps(PID).replace(text, f"{text.split(':')[0]}: {literal}")
        with pytest.raises(DocumentError) as caught:
            read_controller(json_text, "mine.json")
        assert str(caught.value) == f"mine.json: {place}: {shown} is not a finite number"


def test_text_that_is_not_json_is_refused() -> None:
    with pytest.raises(DocumentError, match=r"^mine\.json: not valid JSON: Expecting ',' delimiter: line 1"):
        read_controller('{"format": "hil-controller" "version": 1}', "mine.json")


SOUND: dict[str, Any] = {
    "A": [[1.0, 0.0], [0.0, 0.5]],
    "B": [[1.0], [2.0]],
    "C": [[1.0, 1.0]],
    "D": [[0.5]],
}


class TestShapes:
    def test_matching_shapes_are_read(self) -> None:
        law = read_controller(json.dumps(with_law(kind="state_space", **SOUND)), "x").law
        assert law == StateSpaceLaw(**SOUND)

    def test_two_inputs_have_two_columns(self) -> None:
        two = SOUND | {"B": [[1.0, -1.0], [2.0, 0.0]], "D": [[0.5, -0.5]], "inputs": "r, y"}
        assert read_controller(json.dumps(with_law(kind="state_space", **two)), "x").law == StateSpaceLaw(
            **two
        )

    def test_a_law_without_states_is_read(self) -> None:
        law = read_controller(
            json.dumps(with_law(kind="state_space", A=[], B=[], C=[[]], D=[[2.0]])), "x"
        ).law
        assert law == StateSpaceLaw(A=[], B=[], C=[[]], D=[[2.0]])

    @pytest.mark.parametrize(
        ("changes", "text"),
        [
            ({"A": [[1.0, 0.0]]}, "A must have the shape (1, 1)"),
            ({"A": [[1.0, 0.0], [0.5]]}, "A must have the shape (2, 2)"),
            ({"B": [[1.0]]}, "B must have the shape (2, 1)"),
            ({"B": [[1.0, 2.0], [1.0, 2.0]]}, "B must have the shape (2, 1)"),
            ({"B": [[1.0], [2.0]], "inputs": "r, y"}, "B must have the shape (2, 2)"),
            ({"C": [[1.0]]}, "C must have the shape (1, 2)"),
            ({"C": [[1.0, 1.0], [1.0, 1.0]]}, "C must have the shape (1, 2)"),
            ({"C": []}, "C must have the shape (1, 2)"),
            ({"D": []}, "D must have the shape (1, 1)"),
            ({"D": [[1.0, 2.0]]}, "D must have the shape (1, 1)"),
        ],
    )
    def test_another_shape_is_refused_with_the_matrix(self, changes: dict[str, Any], text: str) -> None:
        law = copy.deepcopy(SOUND) | changes
        assert refusal(with_law(kind="state_space", **law)) == f"mine.json: law.{text}"


class TestLimits:
    """Without limits, a law of high order would take hours, or all memory."""

    ORDER = MAX_STATES

    def state_space(self, n: int) -> dict[str, Any]:
        A = [[float(i == j) / 2 for j in range(n)] for i in range(n)]
        return with_law(kind="state_space", A=A, B=[[1.0]] * n, C=[[1.0] * n], D=[[0.0]])

    def test_the_highest_order_is_read(self) -> None:
        n = self.ORDER
        law = read_controller(json.dumps(self.state_space(n)), "x").law
        assert isinstance(law, StateSpaceLaw) and len(law.A) == n
        law = read_controller(
            json.dumps(with_law(kind="transfer_function", num=[1.0], den=[1.0] * (n + 1))), "x"
        ).law
        assert isinstance(law, TransferFunctionLaw) and len(law.den) == n + 1

    def test_a_higher_order_is_refused(self) -> None:
        n = self.ORDER + 1
        assert refusal(self.state_space(n)) == "mine.json: law.A has 51 entries, but must have at most 50"
        for key in ("num", "den"):
            law = {"num": [1.0], "den": [1.0]} | {key: [1.0] * (n + 1)}
            assert refusal(with_law(kind="transfer_function", **law)) == (
                f"mine.json: law.{key} has 52 entries, but must have at most 51"
            )

    @pytest.mark.parametrize("n", [3000, 5000])
    def test_a_list_of_thousands_is_refused_at_once(self, n: int) -> None:
        assert "law.den has" in refusal(with_law(kind="transfer_function", num=[1.0], den=[1.0] * n))

    @pytest.mark.parametrize(
        ("law", "text"),
        [
            (PID["law"] | {"kp": 1.1e12}, "law.kp is 1100000000000.0, but must be at most 1000000000000.0"),
            (PID["law"] | {"ki": -1e300}, "law.ki is -1e+300, but must be at least -1000000000000.0"),
            (
                {"kind": "transfer_function", "num": [1.0], "den": [1.0, 1e300]},
                "law.den[1] is 1e+300, but must be at most 1000000000000.0",
            ),
        ],
    )
    def test_a_coefficient_without_correct_digits_is_refused(self, law: dict[str, Any], text: str) -> None:
        assert refusal(PID | {"law": law}) == f"mine.json: {text}"


def test_a_gain_that_is_given_twice_is_refused() -> None:
    text = json.dumps(PID).replace('"kp": 11.0', '"kp": 11.0, "kp": -2000000')
    with pytest.raises(DocumentError) as caught:
        read_controller(text, "mine.json")
    assert str(caught.value) == "mine.json: law: key kp is given twice, as 11.0 and as -2000000; remove one"


class TestFit:
    CONTROLLER = read_controller(json.dumps(PID), "mine.json")

    def test_a_controller_for_this_sample_time_and_unit_fits(self) -> None:
        check_controller_fits(self.CONTROLLER, "mine.json", 0.0112, "m")
        check_controller_fits(self.CONTROLLER, "mine.json", 0.0112 * (1 + 1e-10), "m")

    @pytest.mark.parametrize("period_s", [0.01, 0.0112001, 0.01119999])
    def test_another_sample_time_is_refused(self, period_s: float) -> None:
        with pytest.raises(DocumentError) as caught:
            check_controller_fits(self.CONTROLLER, "mine.json", period_s, "m")
        assert str(caught.value) == (
            f"mine.json: sample_time_s: 0.0112 s is not the loop's {period_s} s (rig: loop.period_s); "
            "design it again for this loop"
        )

    def test_another_unit_is_refused(self) -> None:
        with pytest.raises(
            DocumentError, match=r"^mine\.json: input_unit is m, but the axis is in rad; give a"
        ):
            check_controller_fits(self.CONTROLLER, "mine.json", 0.0112, "rad")


finite = st.floats(-MAX_COEFFICIENT, MAX_COEFFICIENT)
nonzero = finite.filter(bool)
polynomials = st.integers(1, 4).flatmap(
    lambda n: st.builds(
        TransferFunctionLaw,
        num=st.lists(finite, min_size=1, max_size=n),
        den=st.tuples(nonzero, st.lists(finite, min_size=n - 1, max_size=n - 1)).map(lambda d: [d[0], *d[1]]),
    )
)
pids = st.builds(
    PidLaw, kp=finite, ki=finite, kd=finite, tau_d=st.floats(1e-9, MAX_COEFFICIENT), b=finite, c=finite
)


@given(polynomials | pids, st.text(), st.floats(1e-6, 1e3))
def test_a_written_controller_is_read_back_bit_for_bit(law: Any, name: str, sample_time_s: float) -> None:
    controller = ControllerFile(
        format="hil-controller",
        version=1,
        name=name,
        description="",
        sample_time_s=sample_time_s,
        input_unit="rad",
        output_unit="V",
        law=law,
        origin={},
    )
    assert read_controller(to_json(controller), "x") == controller
