"""The serving process counts the frames on the bus, and the loop has no part in it."""

from pathlib import Path
from time import monotonic_ns

import pytest

import hil
from hil.core.frames import Frame
from hil.links import Received, open_link
from hil.live import bus_listener
from hil.live.bus_listener import BusListener

RIG_TEXT = (Path(hil.__file__).parent / "shipped" / "rig.toml").read_text()


@pytest.mark.parametrize(
    ("rig_text", "end"),
    [
        (RIG_TEXT, "% of 500 kbit/s"),
        (RIG_TEXT.replace("[bus]\n", "[bus]\nbit_rate = 125000\n"), "% of 125 kbit/s"),
    ],
)
def test_the_frames_that_wait_are_counted_once_a_second(
    rig_text: str, end: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_link("inproc:listener") as link:
        listener = BusListener("inproc:listener", rig_text)
        for _ in range(7):
            link.send(Frame(0x080))
        assert listener.take() is None
        link.send(Frame(0x123))
        later_ns = monotonic_ns() + bus_listener.INTERVAL_NS
        monkeypatch.setattr(bus_listener, "monotonic_ns", lambda: later_ns - 300_000_000)
        assert listener.take() is None
        listener._next_ns = 0
        report = listener.take()
        listener.close()
    assert report is not None
    assert report["frames on the bus"] == "8/s"
    assert report["SYNC, samples, commands"] == "7, 0, 0/s"
    assert report["bus load"].endswith(end)
    assert listener.take() is None, "closed"


def test_a_flood_does_not_hold_the_server(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bus_listener, "MAX_FRAMES", 5)
    with open_link("inproc:flooded") as link:
        listener = BusListener("inproc:flooded", RIG_TEXT)
        for _ in range(12):
            link.send(Frame(0x080))
        taken = []
        for _ in range(3):
            listener.take()
            taken.append(listener._watch.status(monotonic_ns()).bus.frames)
        listener.close()
    assert taken == [5, 10, 12]


def test_a_bus_that_fails_is_reported_no_more() -> None:
    with open_link("inproc:failing"):
        listener = BusListener("inproc:failing", RIG_TEXT)
        assert listener._link is not None
        listener._link.close()
        assert listener.take() is None
        assert listener._link is None
        assert listener.take() is None


def test_frames_from_before_the_clock_was_set_back_are_counted_once() -> None:
    with open_link("inproc:clock") as link:
        listener = BusListener("inproc:clock", RIG_TEXT)
        assert listener._link is not None
        receive, hour_ns = listener._link.receive, 3600 * 10**9

        def receive_late(timeout_s: float) -> Received | None:
            received = receive(timeout_s)
            return None if received is None else received._replace(stamp_ns=received.stamp_ns + hour_ns)

        listener._link.receive = receive_late  # type: ignore[method-assign]
        for _ in range(5):
            link.send(Frame(0x080))
        listener.take()
        later_ns = monotonic_ns() + bus_listener.INTERVAL_NS
        assert listener._watch.status(later_ns).bus.frames_per_s == 0.0
        listener.close()


def test_a_serial_adapter_is_left_to_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr(bus_listener, "open_link", lambda bus, _bit_rate: opened.append(bus))
    assert BusListener("slcan:/dev/ttyACM0", RIG_TEXT).take() is None
    assert opened == []


@pytest.mark.parametrize(
    ("bus", "rig_text"),
    [("vcan-that-is-not-there", RIG_TEXT), ("inproc:listener", "")],
)
def test_what_cannot_be_listened_to_is_not_reported(bus: str, rig_text: str) -> None:
    listener = BusListener(bus, rig_text)
    assert listener.take() is None
    listener.close()
