"""Events: how a scenario file lists them, and what each one does to the arm."""

import pytest
from support.arm_files import arm_with
from support.constants import CENTRED

from firmware_sim.arm.arm import Arm
from firmware_sim.arm.events import (
    AnyEvent,
    BrokenWire,
    FrictionFactor,
    Leak,
    Payload,
    StuckSpool,
    SupplyPressure,
    Temperature,
)
from firmware_sim.scenario import read_scenario
from hil.core.errors import DocumentError

SECOND_NS = 1_000_000_000
EVENTS = """
title = "every kind of event"
duration_s = 10.0
[[events]]
at_s = 2.0
change = "payload"
mass_kg = 3

[[events]]
at_s = 3.0
change = "supply pressure"
gauge_kpa = 400.0

[[events]]
at_s = 4.0
change = "temperature"
celsius = 35.0

[[events]]
at_s = 5.0
change = "friction"
axis = "rotation"
factor = 1.5

[[events]]
at_s = 6.0
change = "leak"
axis = "horizontal"
chamber = 2
conductance_m3_s_pa = 1e-9

[[events]]
at_s = 7.0
change = "stuck spool"
axis = "vertical"

[[events]]
at_s = 8.0
change = "broken wire"
axis = "vertical"
broken = false
"""


def arm(*events: AnyEvent) -> Arm:
    return Arm(arm_with({}), seed=1, events=events)


def test_events_are_read() -> None:
    assert read_scenario(EVENTS, "scenario.toml").events == [
        Payload(at_s=2.0, mass_kg=3.0),
        SupplyPressure(at_s=3.0, gauge_kpa=400.0),
        Temperature(at_s=4.0, celsius=35.0),
        FrictionFactor(at_s=5.0, axis="rotation", factor=1.5),
        Leak(at_s=6.0, axis="horizontal", chamber=2, conductance_m3_s_pa=1e-9),
        StuckSpool(at_s=7.0, axis="vertical", stuck=True),
        BrokenWire(at_s=8.0, axis="vertical", broken=False),
    ]


@pytest.mark.parametrize(
    ("good", "bad", "place"),
    [
        ("mass_kg = 3", "mass_kg = -3", "events[0].mass_kg is -3"),
        ("at_s = 3.0", "at_s = -3.0", "events[1].at_s is -3.0"),
        ("gauge_kpa = 400.0", "gauge_kpa = 4000.0", "events[1].gauge_kpa is 4000.0"),
        ("celsius = 35.0", "celsius = 350.0", "events[2].celsius is 350.0"),
        (
            'axis = "rotation"',
            'axis = "elbow"',
            "events[3].axis is 'elbow', but must be 'horizontal' or 'rotation' or 'vertical'",
        ),
        ("factor = 1.5", "factor = -1.0", "events[3].factor is -1.0"),
        ("chamber = 2", "chamber = 3", "events[4].chamber is 3"),
        ("1e-9", "nan", "events[4].conductance_m3_s_pa"),
        ('change = "payload"', 'change = "pay load"', "events[0].change is 'pay load'"),
        ("stuck spool", "payload", "events[5]"),
        ("broken = false", "brocken = false", "brocken"),
    ],
)
def test_an_invalid_event_is_rejected_by_its_key(good: str, bad: str, place: str) -> None:
    assert EVENTS.count(good) >= 1
    with pytest.raises(DocumentError) as caught:
        read_scenario(EVENTS.replace(good, bad, 1), "scenario.toml")
    assert str(caught.value).startswith("scenario.toml: ")
    assert place in str(caught.value)
    assert str(caught.value).count("'vertical'") <= 1


def test_events_happen_at_their_time_in_any_order_of_listing() -> None:
    subject = arm(
        BrokenWire(at_s=0.030, axis="vertical", broken=False),
        BrokenWire(at_s=0.010, axis="vertical"),
        Payload(at_s=0.010, mass_kg=1.0),
        Payload(at_s=0.010, mass_kg=2.0),
    )
    subject.advance(9_999_999, CENTRED)
    assert subject.potentiometer_v()[0] > 1.0
    assert subject.view().payload_kg == 0.0
    subject.advance(1, CENTRED)
    assert subject.potentiometer_v()[0] == 0.0
    assert subject.view().payload_kg == 2.0
    subject.advance(19_999_999, CENTRED)
    assert subject.potentiometer_v()[0] == 0.0
    subject.advance(1, CENTRED)
    assert subject.potentiometer_v()[0] > 1.0


def test_an_event_in_the_past_happens_at_once() -> None:
    subject = arm()
    subject.advance(SECOND_NS, CENTRED)
    subject.schedule(Payload(at_s=0.5, mass_kg=1.0))
    subject.advance(1, CENTRED)
    assert subject.view().payload_kg == 1.0


def test_a_payload_pulls_the_arm_down_by_its_weight_over_the_spring_rate() -> None:
    subject = arm(Payload(at_s=0.0, mass_kg=3.0), Payload(at_s=20.0, mass_kg=0.0))
    before = subject.view().axes[0].position
    subject.advance(20 * SECOND_NS, CENTRED)
    sag_m = before - subject.view().axes[0].position
    spring_n_m = subject.parameters.axes.vertical.spring.rate_n_m
    assert sag_m == pytest.approx(3.0 * 9.80665 / spring_n_m, abs=0.007)  # static friction / spring: 4 mm
    assert sag_m > 0.04
    subject.advance(20 * SECOND_NS, CENTRED)
    assert subject.view().axes[0].position > before - 0.03


def test_a_payload_is_picked_up_at_rest_and_dropped_with_its_speed() -> None:
    subject = arm()
    body = subject.parameters.body
    for axis in subject.state.axis:
        axis.velocity_m_s = 0.2
    subject.apply(Payload(at_s=0.0, mass_kg=2.0))
    light_kg = body.vertical_kg + body.horizontal_kg
    vertical, horizontal, rotation = (axis.velocity_m_s for axis in subject.state.axis)
    assert vertical == pytest.approx(0.2 * light_kg / (light_kg + 2.0))
    assert horizontal == pytest.approx(0.2 * body.horizontal_kg / (body.horizontal_kg + 2.0))
    reach_m = body.reach_m + subject.state.axis[1].position_m
    empty = body.base_kg_m2 + body.horizontal_kg * reach_m**2
    assert rotation == pytest.approx(0.2 * empty / (empty + 2.0 * (reach_m + body.tip_m) ** 2))
    subject.apply(Payload(at_s=0.0, mass_kg=0.0))
    assert [axis.velocity_m_s for axis in subject.state.axis] == [vertical, horizontal, rotation]


def test_the_supply_falls_to_the_regulators_new_setting_minus_its_droop() -> None:
    subject = arm(SupplyPressure(at_s=1.0, gauge_kpa=400.0))
    subject.advance(SECOND_NS, CENTRED)
    assert 530e3 < subject.view().supply_pa < 545e3
    subject.advance(4 * SECOND_NS, CENTRED)
    view = subject.view()
    subject.advance(SECOND_NS, CENTRED)
    flow_kg_s = subject.view().supplied_kg - view.supplied_kg
    droop_pa = 1e3 * subject.parameters.supply.droop_kpa_s_kg * flow_kg_s
    assert view.supply_pa == pytest.approx(500e3 - droop_pa, abs=50.0)
    assert droop_pa > 1e3


def test_a_friction_factor_slows_the_axis() -> None:
    def travel(factor: float) -> float:
        subject = arm(FrictionFactor(at_s=0.0, axis="rotation", factor=factor))
        subject.advance(SECOND_NS // 2, (5.0, 5.0, 5.3))
        return subject.view().axes[2].position

    assert travel(0.5) > 1.1 * travel(1.0) > 1.3 * travel(3.0)
    assert travel(1.0) > 0.1


def test_a_leak_empties_a_chamber_and_moves_the_axis() -> None:
    subject = arm(Leak(at_s=0.0, axis="horizontal", chamber=2, conductance_m3_s_pa=1e-9))
    before = subject.view()
    subject.advance(SECOND_NS, CENTRED)
    after = subject.view()
    assert after.axes[1].pressure_pa[1] < before.axes[1].pressure_pa[1] - 20e3
    assert after.axes[1].position > before.axes[1].position + 0.02
    assert after.axes[0].position == pytest.approx(before.axes[0].position, abs=1e-3)


def test_a_stuck_spool_ignores_commands_until_it_is_loose() -> None:
    subject = arm(StuckSpool(at_s=0.5, axis="vertical"), StuckSpool(at_s=1.0, axis="vertical", stuck=False))
    subject.advance(SECOND_NS // 2, (5.5, 5.5, 5.0))
    subject.advance(SECOND_NS // 2, (4.0, 4.0, 5.0))
    stuck, moving, _ = subject.view().axes
    assert stuck.spool == pytest.approx(0.097, abs=1e-3)
    assert moving.spool == pytest.approx(-0.197, abs=1e-3)
    subject.advance(SECOND_NS // 10, (4.0, 4.0, 5.0))
    assert subject.view().axes[0].spool == pytest.approx(-0.201, abs=1e-3)


def test_a_broken_wire_reads_0_v_until_it_is_repaired() -> None:
    subject = arm(BrokenWire(at_s=0.0, axis="rotation"))
    subject.advance(1, CENTRED)
    assert subject.potentiometer_v()[2] == 0.0
    assert min(subject.potentiometer_v()[:2]) > 1.0
    subject.apply(BrokenWire(at_s=0.0, axis="rotation", broken=False))
    assert subject.potentiometer_v()[2] > 1.0


def test_cold_air_is_denser_and_slower() -> None:
    def used_kg(celsius: float) -> float:
        subject = arm(Temperature(at_s=0.0, celsius=celsius))
        subject.advance(5 * SECOND_NS, CENTRED)
        before = subject.view().supplied_kg
        subject.advance(SECOND_NS, CENTRED)
        return subject.view().supplied_kg - before

    assert used_kg(0.0) / used_kg(40.0) == pytest.approx((313.15 / 273.15) ** 0.5, rel=0.01)
