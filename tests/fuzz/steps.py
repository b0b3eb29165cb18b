"""Draw sequences of steps at random, and change those that were kept."""

from __future__ import annotations

from random import Random
from typing import NamedTuple

from fuzz import rigs, wire
from fuzz.played_rig import CONTROLLERS, SETPOINTS, Step
from fuzz.rigs import RIGS

MAX_STEPS = 40
P = rigs.PERIOD_NS
LATE_NS = (0, 0, 0, 0, 1, -1, -P // 2, P // 2, P // 2 + 1, P - 1, P, 3 * P, 40 * P)
AFTER_NS = (0, 1_000_000, 1_000_000, 1_000_000, P // 2, P - 1, P, P + 1)
COUNTER_STEPS = (1, 1, 1, 1, 1, 2, 0, -1, 127, 128, 200)
PAUSES_NS = (1, 1_000_000, P // 3, P, 49_000_000, 50_000_000, 50_000_001, 300_000_000, 502_000_000)
WAYS = (0, 0, 0, 1, -1, 59, 60, 61, 300, -300, 2000, -2000, 9000, -9000, 20000)
IDENTIFIERS = (
    *(0x000, 0x080, 0x090, 0x0A0, 0x190, 0x1A0, 0x220, 0x290, 0x320, 0x420, 0x520, 0x590, 0x5A0, 0x610),
    *(0x620, 0x701, 0x710, 0x720, 0x040, 0x004, 0x123),
)
TRIGGERS = ("arm", "start", "start", "stop", "disarm", "reset", "boards up", "fault")
CODES = (0, 0x1000, 0x8110, 0x8250, 0xFFFF)
TEXTS = ("0.05", "-0.1", "9", "hold", "sine:0.02@0/1", "ladder:0.1,-0.1@0/0.05", "no", "1.2")


class Sequence(NamedTuple):
    """A sequence: the rig, its controllers and setpoints, and the steps."""

    rig: str
    law: str
    setpoint: str
    steps: list[Step]


def draw_sequence(random: Random) -> Sequence:
    """Return a random sequence that begins with a bring-up."""
    rig = random.choice(list(RIGS.values()))
    until = _draw("until", random)
    number = random.randint(5, MAX_STEPS)
    steps = [["bring up", until], *draw_steps(number, random)]
    return Sequence(rig.name, random.choice(rig.laws), random.choice(SETPOINTS), steps)


def changed(sequence: Sequence, other: Sequence, random: Random) -> Sequence:
    """Return ``sequence`` with steps removed, inserted, repeated or changed, or with the end of ``other``."""
    steps = [list(step) for step in sequence.steps]
    for _ in range(random.choice((1, 1, 2, 3, 5))):
        place = random.randrange(len(steps) + 1)
        match random.randrange(6):
            case 0:
                del steps[place : place + random.choice((1, 1, 2, 8))]
            case 1:
                steps[place:place] = draw_steps(random.choice((1, 1, 2, 6)), random)
            case 2:
                steps[place:place] = [list(step) for step in steps[place : place + random.choice((1, 2, 5))]]
            case 3:
                steps[place:] = [list(step) for step in other.steps[random.randrange(len(other.steps) + 1) :]]
            case 4:
                steps += draw_steps(random.randint(1, 10), random)
            case _:
                if place < len(steps):
                    steps[place] = _changed_step(steps[place], random)
    rig = RIGS[sequence.rig]
    law = random.choice(rig.laws) if random.random() < 0.1 else sequence.law
    setpoint = random.choice(SETPOINTS) if random.random() < 0.1 else sequence.setpoint
    return Sequence(sequence.rig, law, setpoint, steps[-MAX_STEPS:] or draw_steps(1, random))


def draw_steps(number: int, random: Random) -> list[Step]:
    """Return random steps of some kinds, beside good periods and bring-ups.

    Few kinds at a time let the gateway stay in state running for longer, and combine what is rare (swarm
    testing, Groce et al. 2012).
    """
    kinds = [*ALWAYS, *random.sample(KINDS, random.choice((1, 1, 2, 3, 5)))]
    weights = [FREQUENCIES[kind] for kind in kinds]
    return [_draw_step(kind, random) for kind in random.choices(kinds, weights, k=number)]


def _draw_step(kind: str, random: Random) -> Step:
    step = [kind, *(_draw(argument, random) for argument in ARGUMENTS[kind])]
    if kind == "periods":
        match random.randrange(12):
            case 0:
                step[1], step[-1] = random.choice((1, 2, 3, 6, 30)), 1 << random.randrange(5)
            case 1:
                step[4] = random.choice(COUNTER_STEPS)
            case 2:
                step[5] = random.randint(1, 66)
    return step


def _changed_step(step: Step, random: Random) -> Step:
    """Return a step of the same kind with one new argument."""
    arguments = ARGUMENTS[step[0]]
    if not arguments:
        return draw_steps(1, random)[0]
    place = random.randrange(len(arguments))
    return [*step[: place + 1], _draw(arguments[place], random), *step[place + 2 :]]


def _draw(argument: str, random: Random) -> object:
    choice = random.choice
    match argument:
        case "ways":
            return [choice(WAYS) if random.random() < 0.4 else 0 for _ in range(wire.CHANNELS)]
        case "damage":
            return random.randint(1, 66) if random.random() < 0.25 else 0
        case "data":
            drawn = random.randbytes(random.randint(0, 8)).hex()
            return choice((drawn, drawn, "00", "05", "7f", "00" * 8))
        case "identifier":
            return choice((choice(IDENTIFIERS), choice(IDENTIFIERS), random.randrange(0x800)))
        case "flags":
            return choice((0, 0, 0, 0, 0, 1, 2, 4))
        case "volts":
            return choice((0.5, -0.5, 1.0, -1.0, 1.2, random.uniform(-1.1, 1.1)))
    return choice(CHOICES[argument])


ARGUMENTS = {
    "periods": ("number", "ways", "after", "one", "zero", "zero"),
    "deadline": ("late",),
    "pause": ("pause",),
    "sample": ("ways", "after", "step", "damage"),
    "heartbeat": ("board", "nmt"),
    "emergency": ("emergency", "code"),
    "inputs": ("bits", "step", "damage"),
    "read back": ("ways", "step", "damage"),
    "frame": ("identifier", "data", "flags"),
    "operate": ("trigger",),
    "arm": ("checks", "checks"),
    "setpoint": ("axis", "text"),
    "controller": ("axis", "controller", "prepared"),
    "jog": ("axis", "volts", "duration"),
    "link failure": (),
    "refuse": (),
    "bring up": ("until",),
}
"""Arguments of each kind of step, by the name under which :func:`_draw` knows them."""
CHOICES: dict[str, tuple[object, ...]] = {
    "after": AFTER_NS,
    "late": LATE_NS,
    "number": (1, 1, 1, 2, 3, 6),
    "one": (1,),
    "zero": (0,),
    "pause": PAUSES_NS,
    "step": COUNTER_STEPS,
    "board": (wire.ADC_HEARTBEAT, wire.DAC_HEARTBEAT),
    "nmt": (5, 5, 5, 0, 4, 127, 66),
    "emergency": (wire.ADC_EMERGENCY, wire.DAC_EMERGENCY),
    "code": CODES,
    "bits": (3, 3, 3, 1, 2, 0, 0xFF),
    "trigger": TRIGGERS,
    "checks": (0, 0, 1, 2, 3),
    "axis": ("vertical", "horizontal", "rotation", "vertical", "horizontal", "elbow"),
    "text": TEXTS,
    "controller": tuple(range(len(CONTROLLERS))),
    "prepared": (0, 1, 1, 1, 1, 1, 1, 1),
    "duration": (0.01, 0.1, 0.5, 2.0, -1.0, 0.03),
    "until": ("running", "running", "running", "jogged", "jogged", "armed", "ready"),
}
FREQUENCIES = {
    "periods": 10,
    "deadline": 8,
    "pause": 2,
    "sample": 10,
    "heartbeat": 3,
    "emergency": 1,
    "inputs": 3,
    "read back": 3,
    "frame": 3,
    "operate": 6,
    "arm": 2,
    "setpoint": 2,
    "controller": 1,
    "jog": 5,
    "link failure": 1,
    "refuse": 2,
    "bring up": 5,
}
KINDS = tuple(FREQUENCIES)
ALWAYS = ("periods", "bring up")
