"""Faults as texts and as typed documents: the same fault in both, and errors that say what is wrong."""

from __future__ import annotations

from typing import get_args

import pytest

from firmware_sim.arm.events import AnyEvent, Leak
from firmware_sim.faults.fault_text import FORM_OF, fault_text, parse_fault
from firmware_sim.faults.kinds import (
    AnyFault,
    ArmFault,
    BusOff,
    ErrorFrames,
    Flood,
    Hang,
    Late,
    Lose,
    Miscount,
)
from firmware_sim.scenario import read_scenario
from hil.core.errors import DocumentError

LEAK = Leak(at_s=0, axis="vertical", chamber=1, conductance_m3_s_pa=1e-8)
EXAMPLES: list[tuple[str, AnyFault]] = [
    ("lose:sample,5@2", Lose("sample", 5, at_s=2.0)),
    ("lose:sample@0", Lose("sample")),
    ("late:command,0.02,12.5%@1.5/0.25", Late("command", 0.02, "12.5%", at_s=1.5, for_s=0.25)),
    ("miscount:sample,-1,1@running", Miscount("sample", -1, 1, when="running")),
    ("hang:adc@vertical>0.05+0.5", Hang("adc", when="vertical>0.05", at_s=0.5)),
    ("bus-off@rotation<-1e-2/1", BusOff(when="rotation<-1e-2", for_s=1.0)),
    ("hang:dac@armed+2", Hang("dac", when="armed", at_s=2.0)),
    ("lose:sample,10%@fault/1", Lose("sample", "10%", when="fault", for_s=1.0)),
    ("flood:2047,0.001@0", Flood(0x7FF, 0.001)),
    ("error-frames@running/1", ErrorFrames(when="running", for_s=1.0)),
    ("error-frames:5%,adc@2", ErrorFrames("5%", "adc", at_s=2.0)),
    ("leak:vertical,1,1e-08@running+1", ArmFault(LEAK, when="running", at_s=1.0)),
]


@pytest.mark.parametrize(("text", "fault"), EXAMPLES)
def test_a_text_and_its_fault_are_converted_into_each_other(text: str, fault: AnyFault) -> None:
    assert parse_fault(text) == fault
    assert fault_text(fault) == text


def test_values_that_may_be_omitted_have_defaults() -> None:
    assert parse_fault("lose:sample@2") == parse_fault("lose:sample,100%@2")
    assert parse_fault("flood:0x7FF,0.001@0") == Flood(2047, 0.001)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            "lose:sample",
            "its time is missing. Write lose:FRAME[,AMOUNT] and its time, @SECONDS, @STATE, @AXIS",
        ),
        (
            "lose:sample@jog",
            "'jog' is neither a time nor a condition. Write lose:FRAME[,AMOUNT] and its time",
        ),
        ("lose:sample,5@armd", "'armd' is neither a time nor a condition; did you mean armed? Write lose:"),
        ("hang:adc@vertical", "STATE is running (a command moves a valve), offline, ready, armed, fault"),
        ("hang:adc@armd+2/1", "'armd+2' is neither a time nor a condition; did you mean armed? Write hang"),
        ("hang:adc@running+x", "the time 'x' after its condition is not a number of seconds. Write hang"),
        ("hang:adc@1/x", "its duration 'x' is not a number of seconds. Write hang:BOARD"),
        ("hang:@1", "its values are missing. Write hang:BOARD"),
        ("payload@1", "its values are missing; write payload:KG"),
        ("loose:sample@1", "there is no fault 'loose'; did you mean lose? The names are: lose, late, "),
        ("lose:samples@1", "frame is 'samples'"),
        ("lose:sample,0@1", "amount"),
        (
            "lose:sample,5,6@1",
            "lose takes frame, amount; 'sample,5,6' has 3; the form is lose:FRAME[,AMOUNT]",
        ),
        ("hang@1", "hang takes board; '' has 0"),
        ("bus-off:now@1", "bus-off takes no values; 'now' has 1"),
        ("late:sample,-1@1", "delay_s is -1, but must be more than 0.0; the form is late:FRAME,S"),
        ("lose:sample@1/0", "for_s"),
        ("alter:sync@1", "frame is 'sync', but must be 'command' or 'sample'"),
        ("payload:500@1", "mass_kg"),
    ],
)
def test_an_error_names_the_text_and_the_problem(text: str, problem: str) -> None:
    with pytest.raises(DocumentError) as caught:
        parse_fault(text)
    assert problem in str(caught.value)
    assert repr(text) in str(caught.value)


@pytest.mark.parametrize("text", ["lose:sample,5@armd", "lose:sample,5", "hang:adc@vertical", "hang:a@1"])
def test_an_error_about_a_known_fault_has_the_form_of_no_other_one(text: str) -> None:
    with pytest.raises(DocumentError) as caught:
        parse_fault(text)
    name = text.partition(":")[0]
    forms = {form for form in FORM_OF.values() if form in str(caught.value)}
    assert forms == {FORM_OF[name]}


def test_every_fault_and_every_event_has_a_form() -> None:
    kinds = [*get_args(AnyFault), *get_args(AnyEvent)]
    names = {str(kind.__struct_config__.tag).replace(" ", "-") for kind in kinds if kind is not ArmFault}
    assert set(FORM_OF) == names


def test_a_scenario_file_lists_the_same_faults() -> None:
    text = """
        title = "lost samples"
        duration_s = 3.0
        [[faults]]
        fault = "lose"
        frame = "sample"
        amount = 5
        when = "vertical>0.05"
        [[faults]]
        fault = "bus off"
        at_s = 2.0
        for_s = 0.5
        [[faults]]
        fault = "hang"
        board = "adc"
        when = "ready"
        at_s = 1.0
    """
    faults = read_scenario(text, "lost.toml").faults
    assert [fault_text(fault) for fault in faults] == [
        "lose:sample,5@vertical>0.05",
        "bus-off@2/0.5",
        "hang:adc@ready+1",
    ]


def test_an_error_in_a_scenario_names_file_and_key() -> None:
    text = 'title = ""\nduration_s = 3.0\n[[faults]]\nfault = "hang"\nboard = "third"\n'
    with pytest.raises(DocumentError, match=r"s\.toml: faults\[0\]\.board is 'third'"):
        read_scenario(text, "s.toml")
