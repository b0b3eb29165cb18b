"""H-infinity loop shaping by both methods, against the figures of the paper, and Appendices A and B."""

from __future__ import annotations

import numpy as np
import pytest
from support.paper_loop import G0, HLS, PERIOD_S, W1

from design.errors import DesignError
from design.mathematics import polynomials as poly
from design.models.plant import paper_plant
from design.models.realisation import realise, transfer_function
from design.models.sampling import Sampling
from design.models.transfer_function import TransferFunction
from design.robustness.central_controller import central_controllers, optimal_margins
from design.robustness.loop_shaping import gamma_opt, normalised_left_coprime_factors, shaped, synthesise
from design.robustness.margins import stability_margin

GS = shaped(G0, W1)


def full_controller(K_inf: TransferFunction) -> TransferFunction:
    """Return K = W1 K∞ with a monic denominator."""
    num = np.polymul(W1.num, np.trim_zeros(np.ravel(K_inf.num), "f"))
    den = np.polymul(W1.den, np.ravel(K_inf.den))
    return TransferFunction(num / den[0], den / den[0])


def by_riccati() -> TransferFunction:
    H = transfer_function(synthesise(GS).controller)
    return TransferFunction(H.num[1:], H.den)


def by_interpolation() -> TransferFunction:
    return central_controllers(GS)[0]


@pytest.mark.parametrize("synthesis", [by_riccati, by_interpolation])
def test_both_methods_give_equation_18(synthesis: object) -> None:
    K = full_controller(synthesis())  # type: ignore[operator]
    np.testing.assert_allclose(K.num, HLS.num, rtol=1e-3)
    np.testing.assert_allclose(K.den, HLS.den, rtol=1e-3)
    np.testing.assert_allclose(K.num, [372.28, 6714.8, 67956.6, 55790.9, 11949.7], rtol=1e-5)
    np.testing.assert_allclose(K.den, [1.0, 39.9996, 701.33, 6310.2, 2647.7, 2.6414], rtol=1e-5)
    assert stability_margin(G0, K, W1)[0] == pytest.approx(0.5524, abs=5e-5)


def test_the_optimal_margin_of_the_papers_weight() -> None:
    assert optimal_margins(GS)[0] == pytest.approx(0.601487, abs=5e-7)
    assert 1.0 / gamma_opt(realise(GS)) == pytest.approx(optimal_margins(GS)[0], rel=1e-11)
    # Eq. (17) prints a damping of 16.67.
    misprint = TransferFunction(G0.num, np.polymul([1.0, 0.4231], [1.0, 16.67, 167.9]))
    assert optimal_margins(shaped(misprint, W1))[0] == pytest.approx(0.60209, abs=5e-6)
    assert 1.0 / (1.1 * gamma_opt(realise(GS))) == pytest.approx(0.54681, abs=1e-5)


def test_no_weight_depends_on_the_others_of_its_batch() -> None:
    kw, a = np.array([0.1, 2.0, 15.0, 49.0]), np.array([0.02, 30.0, 0.44, 7.0])
    W = TransferFunction(np.stack([kw, kw * a], axis=-1), np.array([[1.0, 0.001]]))
    together, margins = central_controllers(shaped(G0, W))
    for i in range(len(kw)):
        one, margin = central_controllers(shaped(G0, TransferFunction(W.num[i], W.den[0])))
        assert margins[i] == pytest.approx(margin[0], rel=1e-13)
        np.testing.assert_allclose(together.num[i], one.num[0], rtol=1e-10)
        assert margin[0] == pytest.approx(
            1.0 / gamma_opt(realise(shaped(G0, TransferFunction(W.num[i], W.den[0]))))
        )


def test_a_biproper_plant() -> None:
    Gs = TransferFunction(np.array([2.0, 1.0, 3.0]), np.array([1.0, -1.0, 5.0]))
    synthesis = synthesise(Gs, 1.2)
    K, margin = central_controllers(Gs, 1.2)
    H = transfer_function(synthesis.controller)
    np.testing.assert_allclose(K.num[0], H.num, rtol=1e-8)
    np.testing.assert_allclose(K.den[0], H.den, rtol=1e-8)
    # At infinity the plant is a constant, and the best controller there equals it.
    assert K.num[0, 0] / K.den[0, 0] == pytest.approx(2.0)
    assert margin[0] / 1.2 <= stability_margin(Gs, K)[0] <= margin[0]


@pytest.mark.parametrize("delay_samples", [0, 1, 2, 5])
def test_sampled_synthesis_reaches_the_optimum_with_delays(delay_samples: int) -> None:
    Gs = shaped(paper_plant().transfer_function(Sampling(PERIOD_S, delay_samples)), W1)
    K, margin = central_controllers(Gs, 1.0 + 1e-6)
    assert stability_margin(Gs, K)[0] == pytest.approx(margin[0], rel=2e-6)


def test_the_ratio_of_the_coprime_factors_is_the_plant() -> None:
    N_and_M = normalised_left_coprime_factors(realise(GS))
    s = 3.0j
    N, M = (N_and_M.C @ np.linalg.solve(s * np.eye(4) - N_and_M.A, N_and_M.B) + N_and_M.D)[0]
    assert abs(N) ** 2 + abs(M) ** 2 == pytest.approx(1.0)
    ratio = N / M
    assert ratio == pytest.approx(np.polyval(GS.num, s) / np.polyval(GS.den, s))


def test_a_gamma_at_or_below_the_optimum_is_refused() -> None:
    with pytest.raises(DesignError, match="not over 1"):
        synthesise(GS, 1.0)
    with pytest.raises(DesignError, match="not over 1"):
        central_controllers(GS, 0.9)


def test_realising_and_converting_back_keeps_the_transfer_function() -> None:
    H = TransferFunction(np.array([3.0, 1.0, 2.0]), np.array([2.0, 5.0, 7.0, 1e-3]))
    back = transfer_function(realise(H))
    np.testing.assert_allclose(back.num[1:], H.num / 2.0, rtol=1e-11)
    np.testing.assert_allclose(back.den, H.den / 2.0, rtol=1e-11)
    constant = transfer_function(realise(TransferFunction(np.array([4.0]), np.array([2.0]))))
    assert constant.num.tolist() == [2.0]
    assert poly.at(back.den, np.zeros(1))[0] == pytest.approx(5e-4)
