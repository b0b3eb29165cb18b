"""Computes the load of the bus by the rig's own frames, from the rig file alone.

Each frame is counted with the most stuff bits that it can have, so the real load is smaller. The bus can be
planned only if this worst case leaves room: with 100 % or more, frames wait longer in every period.
"""

from __future__ import annotations

from typing import Final

from hil.core.rig import Rig
from hil.core.wire.frame_bits import max_bits_on_wire

MAX_USUAL_LOAD: Final = 0.7
"""Load above which a bus has too little room for repeated frames and other nodes."""
HEARTBEATS_PER_TIMEOUT: Final = 3
"""Number of heartbeats that a board is assumed to send within the time-out of the rig file."""
_PLAIN_BYTES: Final = 6
_FULL_BYTES: Final = 8
_HEARTBEAT_BYTES: Final = 1


def own_bus_load(rig: Rig, bit_rate: int) -> float:
    """Return the largest share of the time for which the rig's own frames use the bus.

    ``bit_rate`` is in bit/s. In each period there are SYNC, the sample, the command, the read-back, and one
    frame for each digital input; the heartbeats of the gateway and of both boards come besides.
    """
    lengths = [0, _bytes(rig.adc.protected), _bytes(rig.dac.protected)]
    if rig.dac.read_back:
        lengths.append(_bytes(rig.dac.protected))
    lengths += [_FULL_BYTES for _ in {settings.frame for settings in rig.inputs.values()}]
    bits_per_s = sum(map(max_bits_on_wire, lengths)) / rig.loop.period_s
    timeouts_s = (rig.adc.heartbeat_timeout_s, rig.dac.heartbeat_timeout_s)
    heartbeats_per_s = 1.0 / (rig.heartbeat_periods * rig.loop.period_s)
    heartbeats_per_s += sum(HEARTBEATS_PER_TIMEOUT / timeout_s for timeout_s in timeouts_s)
    return (bits_per_s + heartbeats_per_s * max_bits_on_wire(_HEARTBEAT_BYTES)) / bit_rate


def _bytes(is_protected: bool) -> int:
    return _FULL_BYTES if is_protected else _PLAIN_BYTES
