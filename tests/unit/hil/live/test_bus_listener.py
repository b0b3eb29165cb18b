"""The serving process listens to the bus for rates and load, and the loop has no part in it."""

import queue
import threading
from pathlib import Path

import pytest

import hil
from hil.core.frames import Frame
from hil.core.rig import read_rig
from hil.links import open_link
from hil.live import bus_listener
from hil.live.bus_listener import listen

RIG_TEXT = (Path(hil.__file__).parent / "shipped" / "rig.toml").read_text()


@pytest.mark.parametrize(
    ("rig_text", "end"),
    [
        (RIG_TEXT, "% of 500 kbit/s"),
        (RIG_TEXT.replace("[bus]\n", "[bus]\nbit_rate = 125000\n"), "% of 125 kbit/s"),
    ],
)
def test_frames_on_the_bus_are_counted(rig_text: str, end: str) -> None:
    reports: queue.Queue[dict[str, str]] = queue.Queue()
    with open_link("inproc:listener") as link:
        ended = threading.Event()
        listen("inproc:listener", rig_text, reports.put, ended)
        report = {"frames on the bus": "0/s"}
        while report["frames on the bus"] == "0/s":
            link.send(Frame(0x080))
            try:
                report = reports.get(timeout=0.05)
            except queue.Empty:
                continue
        ended.set()
    assert report["bus load"].endswith(end)
    assert not report["SYNC, samples, commands"].startswith("0,")


def test_a_bus_that_cannot_be_opened_is_not_reported() -> None:
    bus_listener._listen(
        "vcan-that-is-not-there", read_rig(RIG_TEXT, "rig.toml"), lambda _counts: None, threading.Event()
    )


def test_a_rig_file_that_cannot_be_read_is_not_reported() -> None:
    listen("inproc:listener", "", lambda _counts: None, threading.Event())
