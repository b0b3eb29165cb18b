"""Rigs with an emergency stop, an enable switch and a read-back of the valves, and the frames of these."""

from __future__ import annotations

from collections.abc import Sequence

from hil.core.frames import Frame
from hil.core.rig import Rig, read_rig
from hil.core.wire import codec
from support.gateway_bench import AXES, rig_text
from support.wire import frame_crc
from support.wire import protected as protected_frame

INPUTS_ID = 0x290
TIMEOUT_NS = 50_000_000
EMERGENCY_STOP = """
[emergency_stop]
frame = 0x290
byte = 0
bit = 0
timeout_s = 0.05
"""
ENABLE = """
[enable]
frame = 0x290
byte = 0
bit = 1
timeout_s = 0.05
"""
STOP_BIT, ENABLE_BIT = 1, 2
BOTH = STOP_BIT | ENABLE_BIT


def protected_rig(
    tables: str = EMERGENCY_STOP, read_back: bool = False, protected: bool = True, axes: Sequence[str] = AXES
) -> Rig:
    """The rig of ``rig_text`` with further tables; ``protected`` is that of the valve board."""
    dac = str(protected).lower() + ("\nread_back = true" if read_back else "")
    text = rig_text({"dac.protected": dac, "adc.stale_after_periods": "3"}, axes) + tables
    return read_rig(text, "rig.toml")


def inputs_frame(bits: int, counter: int, crc_error: int = 0) -> Frame:
    """A TPDO2_ADC frame."""
    data = bytes((bits, counter & 0xFF))
    return Frame(INPUTS_ID, data + bytes((frame_crc(INPUTS_ID, data) ^ crc_error,)))


def read_back_frame(volts: Sequence[float], counter: int, protected: bool = True) -> Frame:
    """A TPDO1_DAC frame."""
    first, second, third = volts
    data = codec.encode_tpdo1_dac(first, second, third, counter & 0xFF, 0)
    if not protected:
        return Frame(codec.TPDO1_DAC, data[:6])
    return protected_frame(codec.TPDO1_DAC, data[:7])
