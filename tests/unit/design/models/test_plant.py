"""Plant documents and what the loop sees of them."""

from __future__ import annotations

import json

import numpy as np
import pytest
import scipy.signal

from design.errors import DesignError
from design.models.plant import (
    Plant,
    Sampling,
    TransferFunction,
    check_plant_fits,
    delayed,
    paper_plant,
    read_plant,
    to_z,
    zero_order_hold,
)
from hil.core.documents import to_json
from hil.core.errors import DocumentError


def text(**changes: object) -> str:
    document = json.loads(to_json(paper_plant()))
    document.update(changes)
    return json.dumps(document)


def test_the_paper_plant_is_equation_15() -> None:
    G = paper_plant().transfer_function()
    np.testing.assert_allclose(G.num, 0.47947 * np.array([1.0, 90.76]), rtol=1e-12)
    np.testing.assert_allclose(G.den, np.polymul([1.0, 0.4231], [1.0, 16.97, 167.9]), rtol=1e-12)
    assert paper_plant().sample_time_s == 0.0112


def test_a_plant_document_comes_back_as_it_was_written() -> None:
    plant = paper_plant()
    assert read_plant(to_json(plant), "p.json") == plant


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"num": [0.0, 0.0]}, "num: the plant's gain is 0"),
        ({"den": [0.0]}, "den: all coefficients are 0"),
        ({"num": [1.0, 0.0, 0.0, 0.0, 0.0]}, "improper"),
        ({"output_unit": "mm"}, "output_unit"),
        ({"sample_time_s": 0.0}, "sample_time_s"),
        ({"gain": 3.0}, "gain"),
        ({"num": [1.0, -2.0], "den": [1.0, 1.0, -6.0]}, "unstable pole at s = 2 is cancelled by a zero"),
        ({"num": [1.0, 0.0], "den": [1.0, 3.0, 0.0]}, "num and den share the root s = 0"),
        (
            {"num": [1.0, -0.2, 4.0], "den": [1.0, 2.8, 3.4, 12.0]},
            "unstable pole at s = 0.1 ± 1.997j is cancelled by a zero",
        ),
        ({"num": [1.0, 0.0, 9.0], "den": [1.0, 3.0, 9.0, 27.0]}, "pole at s = 0 ± 3j is cancelled"),
        ({"version": 2}, "version"),
    ],
)
def test_refused(changes: dict[str, object], named: str) -> None:
    with pytest.raises(DocumentError, match=r"^p\.json: ") as refusal:
        read_plant(text(**changes), "p.json")
    assert named in str(refusal.value)


def test_leading_zeros_do_not_make_a_plant_improper() -> None:
    plant = read_plant(text(num=[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), "p.json")
    assert plant.transfer_function().num.tolist() == [1.0]


def test_the_unit_must_be_the_axis() -> None:
    check_plant_fits(paper_plant(), "p.json", "m")
    with pytest.raises(DocumentError, match=r"p\.json: output_unit: m, but the axis is in rad"):
        check_plant_fits(paper_plant(), "p.json", "rad")


SYSTEMS = {
    "paper": ([0.47947, 43.5166972], [1.0, 17.3931, 175.080007, 71.03849]),
    "integrator": ([3.0], [1.0, 4.0, 0.0]),
    "double integrator": ([2.0], [1.0, 0.0, 0.0]),
    "unstable": ([1.0, 2.0], [1.0, -1.0, 4.0]),
    "biproper": ([2.0, 1.0, 3.0], [1.0, 2.0, 5.0]),
    "repeated poles": ([1.0], [1.0, 6.0, 12.0, 8.0]),
    "constant": ([2.5], [1.0]),
}


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("period_s", [0.0112, 0.3])
def test_zero_order_hold_is_scipys_on_the_unit_circle(name: str, period_s: float) -> None:
    num, den = map(np.array, SYSTEMS[name])
    plane = delayed(zero_order_hold(TransferFunction(num, den), period_s), Sampling(period_s, 2))
    omega = np.linspace(0.05, 0.95, 40) * np.pi / period_s
    z = np.exp(1j * omega * period_s)
    # In state space: scipy's num/den has lost half its digits at the short period.
    A, B, C, D, _ = scipy.signal.cont2discrete(scipy.signal.tf2ss(num, den), period_s)
    responses = [(C @ np.linalg.solve(point * np.eye(len(A)) - A, B) + D)[0, 0] for point in z]
    expected = np.array(responses) / z**2
    s = 2.0 / period_s * (z - 1.0) / (z + 1.0)
    np.testing.assert_allclose(np.polyval(plane.num, s) / np.polyval(plane.den, s), expected, rtol=1e-9)
    in_z = to_z(plane, period_s)
    np.testing.assert_allclose(np.polyval(in_z.num, z) / np.polyval(in_z.den, z), expected, rtol=1e-7)


def test_tustins_rule() -> None:
    # 11 + 5.6/s
    H = to_z(TransferFunction(np.array([11.0, 5.6]), np.array([1.0, 0.0])), 0.0112)
    np.testing.assert_allclose(H.den, [1.0, -1.0])
    np.testing.assert_allclose(H.num, [11.0 + 0.0056 * 5.6, -11.0 + 0.0056 * 5.6], rtol=1e-12)


def test_a_mode_that_the_period_cannot_see() -> None:
    period_s = 0.1
    blind = TransferFunction(np.array([1.0]), np.array([1.0, 0.0, (np.pi / period_s) ** 2]))
    with pytest.raises(DesignError, match="half the sampling frequency"):
        zero_order_hold(blind, period_s)


def test_frequencies_of_the_plane() -> None:
    sampling = Sampling(0.0112)
    assert float(sampling.warp(100.0)) > 100.0
    assert float(sampling.unwarp(sampling.warp(100.0))) == pytest.approx(100.0)
    assert float(sampling.unwarp(np.inf)) == pytest.approx(np.pi / 0.0112)


def test_a_plant_is_frozen() -> None:
    with pytest.raises(AttributeError):
        paper_plant().name = "other"  # type: ignore[misc]
    assert isinstance(paper_plant(), Plant)
