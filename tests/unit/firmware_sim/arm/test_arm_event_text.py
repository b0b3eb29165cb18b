"""Events as texts of a command line: the same changes as in a scenario file, refused in the same words."""

from __future__ import annotations

from typing import get_args

import pytest

from firmware_sim.arm.conditions import (
    AnyChange,
    BrokenWire,
    FrictionChange,
    Leak,
    Payload,
    StuckSpool,
    SupplyPressure,
    Temperature,
)
from firmware_sim.arm.event_text import FORMS, parse_event
from hil.core.errors import DocumentError


@pytest.mark.parametrize(
    ("text", "change"),
    [
        ("payload:3@2", Payload(at_s=2.0, mass_kg=3.0)),
        ("supply-pressure:400@0", SupplyPressure(at_s=0.0, gauge_kpa=400.0)),
        ("temperature:-5.5@1e1", Temperature(at_s=10.0, celsius=-5.5)),
        ("friction:rotation,1.5@.5", FrictionChange(at_s=0.5, axis="rotation", factor=1.5)),
        ("leak:vertical,1,1e-8@2", Leak(at_s=2.0, axis="vertical", chamber=1, conductance_m3_s_pa=1e-8)),
        ("stuck-spool:vertical@3", StuckSpool(at_s=3.0, axis="vertical")),
        ("stuck-spool:vertical,false@4", StuckSpool(at_s=4.0, axis="vertical", stuck=False)),
        ("broken-wire:horizontal@3", BrokenWire(at_s=3.0, axis="horizontal")),
        ("broken-wire:horizontal,false@3.25", BrokenWire(at_s=3.25, axis="horizontal", broken=False)),
    ],
)
def test_every_change_has_its_text(text: str, change: AnyChange) -> None:
    assert parse_event(text) == change


def test_the_forms_name_every_change() -> None:
    for kind in get_args(AnyChange):
        assert f"{kind.__struct_config__.tag.replace(' ', '-')}:" in FORMS


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("payload", "is none of: payload:KG@S, "),
        ("payload:3", "is none of: payload:KG@S, "),
        ("payload:@3", "is none of"),
        ("payload:3@-1", "at_s: -1.0: expected `float` >= 0.0"),
        ("payload:3@soon", "is none of"),
        ("elephant:3@2", "is none of"),
        ("payload:300@2", "mass_kg: 300: expected `float` <= 100.0"),
        ("payload:3,4@2", "payload takes mass_kg; '3,4' does not fit"),
        ("leak:vertical@2", "leak takes axis, chamber, conductance_m3_s_pa; 'vertical' does not fit"),
        ("leak:vertical,3,1e-8@2", "chamber: 3: must be 1 or 2"),
        ("leak:vertical,1,1@2", "conductance_m3_s_pa: 1: expected `float` <= 1e-06"),
        ("friction:elbow,2@2", "axis: 'elbow': must be 'horizontal' or 'rotation' or 'vertical'"),
        ("temperature:warm@2", "celsius: 'warm': expected `float`, got `str`"),
        ("temperature:1e999@2", "celsius: inf is not a finite number"),
        ("stuck-spool:vertical,maybe@2", "stuck: 'maybe': expected `bool`"),
        ("payload:" + "9" * 400 + "@2", "is not a finite number"),
    ],
)
def test_what_cannot_be_is_refused_with_its_text_value_and_limit(text: str, complaint: str) -> None:
    with pytest.raises(DocumentError) as caught:
        parse_event(text)
    assert str(caught.value).startswith(f"--event {text!r}")
    assert complaint in str(caught.value)
