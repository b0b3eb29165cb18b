"""Run a command where the CAN interface ``vcan0`` exists, whatever the running kernel offers."""

from hil.host.vcan.ways import INTERFACE, Way, choose_way, run_with_vcan

__all__ = ["INTERFACE", "Way", "choose_way", "run_with_vcan"]
