"""Events as texts on a command line: equal to the events of a scenario file, with the same limits."""

from __future__ import annotations

from typing import get_args

import pytest

from firmware_sim.arm.event_text import FORMS, event_text, parse_event
from firmware_sim.arm.events import (
    AnyEvent,
    BrokenWire,
    EmergencyStop,
    EnableSwitch,
    FrictionFactor,
    Leak,
    Payload,
    StuckSpool,
    SupplyPressure,
    Temperature,
)
from hil.core.errors import DocumentError


@pytest.mark.parametrize(
    ("text", "event"),
    [
        ("payload:3@2", Payload(at_s=2.0, mass_kg=3.0)),
        ("supply-pressure:400@0", SupplyPressure(at_s=0.0, gauge_kpa=400.0)),
        ("temperature:-5.5@1e1", Temperature(at_s=10.0, celsius=-5.5)),
        ("friction:rotation,1.5@.5", FrictionFactor(at_s=0.5, axis="rotation", factor=1.5)),
        ("leak:vertical,1,1e-8@2", Leak(at_s=2.0, axis="vertical", chamber=1, conductance_m3_s_pa=1e-8)),
        ("stuck-spool:vertical@3", StuckSpool(at_s=3.0, axis="vertical")),
        ("stuck-spool:vertical,false@4", StuckSpool(at_s=4.0, axis="vertical", stuck=False)),
        ("emergency-stop:pressed@1", EmergencyStop(at_s=1.0, button="pressed")),
        ("enable-switch:held@2", EnableSwitch(at_s=2.0, switch="held")),
        ("broken-wire:horizontal@3", BrokenWire(at_s=3.0, axis="horizontal")),
        ("broken-wire:horizontal,false@3.25", BrokenWire(at_s=3.25, axis="horizontal", broken=False)),
    ],
)
def test_every_event_has_a_text(text: str, event: AnyEvent) -> None:
    assert parse_event(text) == event
    assert parse_event(event_text(event)) == event


def test_the_forms_name_every_event() -> None:
    for kind in get_args(AnyEvent):
        assert f"{kind.__struct_config__.tag.replace(' ', '-')}:" in FORMS


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("payload", "not an event; write payload:KG@S, where S is its time in seconds"),
        ("payload:3", "not an event; write payload:KG@S, where S is its time in seconds"),
        ("payload:3kg@1", "mass_kg is '3kg', but must be a number; the form is payload:KG"),
        ("payload:@3", "not an event"),
        ("paylod:3@2", "not an event; did you mean payload? The forms are: payload:KG@S, "),
        ("payload:3@-1", "at_s is -1.0, but must be at least 0.0"),
        ("payload:3@soon", "not an event"),
        ("elephant:3@2", "not an event"),
        ("payload:300@2", "mass_kg is 300, but must be at most 100.0"),
        ("payload:3,4@2", "payload takes the values mass_kg; '3,4' has 2"),
        ("leak:vertical@2", "leak takes the values axis, chamber, conductance_m3_s_pa; 'vertical' has 1"),
        ("leak:vertical,3,1e-8@2", "chamber is 3, but must be 1 or 2"),
        ("leak:vertical,1,1@2", "conductance_m3_s_pa is 1, but must be at most 1e-06"),
        ("friction:elbow,2@2", "axis is 'elbow', but must be 'horizontal' or 'rotation' or 'vertical'"),
        ("temperature:warm@2", "celsius is 'warm', but must be a number"),
        ("temperature:1e999@2", "celsius: inf is not a finite number"),
        ("stuck-spool:vertical,maybe@2", "stuck is 'maybe', but must be true or false"),
        ("payload:" + "9" * 400 + "@2", "is not a finite number"),
    ],
)
def test_an_invalid_text_is_rejected_with_its_value_and_limit(text: str, complaint: str) -> None:
    with pytest.raises(DocumentError) as caught:
        parse_event(text)
    assert str(caught.value).startswith(f"--event {text!r}")
    assert complaint in str(caught.value)
