"""Margins of one sampled loop as text."""

from __future__ import annotations

from dataclasses import replace

import design
import hil


def test_the_text_states_units_and_how_the_margin_relates_to_that_of_a_design() -> None:
    found = design.loop_margins(design.paper_plant(), hil.load_controller("ppid"))
    text = str(found)
    assert "(W1 = 1, not the eps of hil design)" in text
    assert "gain margin 5.1, that is 14.2 dB" in text
    assert "crossover 3.02 rad/s" in text
    assert str(replace(found, stable=False)) == "unstable"
