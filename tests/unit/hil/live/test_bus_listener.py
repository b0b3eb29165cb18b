"""The serving process listens to the bus for rates and load, and the loop has no part in it."""

import queue
import threading
from pathlib import Path

import hil
from hil.core.frames import Frame
from hil.core.rig import read_rig
from hil.links import open_link
from hil.live import bus_listener
from hil.live.bus_listener import listen

RIG_TEXT = (Path(hil.__file__).parent / "shipped" / "rig.toml").read_text()


def test_frames_on_the_bus_are_counted() -> None:
    reports: queue.Queue[dict[str, str]] = queue.Queue()
    with open_link("inproc:listener") as link:
        ended = threading.Event()
        listen("inproc:listener", RIG_TEXT, reports.put, ended)
        report = {"frames on the bus": "0/s"}
        while report["frames on the bus"] == "0/s":
            link.send(Frame(0x080))
            try:
                report = reports.get(timeout=0.05)
            except queue.Empty:
                continue
        ended.set()
    assert report["bus load"].endswith("% of 500 kbit/s")
    assert not report["SYNC, samples, commands"].startswith("0,")


def test_a_bus_that_cannot_be_opened_is_not_reported() -> None:
    bus_listener._listen(
        "vcan-that-is-not-there", read_rig(RIG_TEXT, "rig.toml"), lambda _counts: None, threading.Event()
    )


def test_a_rig_file_that_cannot_be_read_is_not_reported() -> None:
    listen("inproc:listener", "", lambda _counts: None, threading.Event())
