"""What a listener knows about the bus of the rig: boards, samples, positions, rates and load.

It is given frames and the time, and sends nothing. Times are monotonic nanoseconds.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable

import msgspec

from hil.core.board_watch import ADC_NODE, DAC_NODE, NmtState, describe_emergency
from hil.core.frames import Frame
from hil.core.rig import Rig
from hil.core.wire import codec
from hil.core.wire.frame_bits import bits_on_wire
from hil.core.wire.frame_crc import frame_crc, version_hint

WINDOW_NS = 1_000_000_000
"""Time over which rates and the load are counted."""
SPEED_WINDOW_NS = 100_000_000
"""Time over which the speed of an axis is computed."""
SILENT_NS = 1_500_000_000
"""Time without a frame after which its sender counts as silent: more than the longest heartbeat interval."""
MAX_UNKNOWN_IDENTIFIERS = 64
"""Number of unknown identifiers that are counted one by one."""


class Board(msgspec.Struct, frozen=True):
    """One board."""

    node_id: int
    state: str
    """NMT state of the last heartbeat, ``silent`` if there is none, or its number if it is unknown."""
    heartbeat_age_s: float | None
    """Time since the last heartbeat; None if there was none."""
    emergencies: int
    """Number of emergency messages so far."""
    last_emergency: str
    """Last emergency message in words; empty if there was none."""


class Samples(msgspec.Struct, frozen=True):
    """Frames TPDO1_ADC."""

    per_s: float
    counter: int | None
    """Counter of the last frame; None without one."""
    lost: int
    """Number of samples that are missing between two that arrived, by their counter."""
    damaged: int
    """Number of frames with a wrong length or CRC."""


class Axis(msgspec.Struct, frozen=True):
    """Last values of one axis; None before the first frame, or if its sender is silent."""

    unit: str
    potentiometer_v: float | None
    position: float | None
    """Position in the axis' unit."""
    speed: float | None
    """Speed in the axis' unit per second, over the last 0.1 s."""
    valve_v: float | None
    """Voltage of the last valve command on the bus."""
    is_in_range: bool
    """True if the potentiometer's voltage is within its limits in the rig file."""


class Gateway(msgspec.Struct, frozen=True):
    """A gateway that is heard on the bus."""

    state: str
    """NMT state of its last heartbeat, or ``silent``."""
    sync_per_s: float
    commands_per_s: float


class Bus(msgspec.Struct, frozen=True):
    """The bus itself."""

    load: float
    """Share of the time in which frames are on the wire, by their bits and the bit rate."""
    bit_rate: int
    frames_per_s: float
    frames: int
    """Number of frames of other nodes so far."""
    error_frames: int
    last_error_frame: str


class Status(msgspec.Struct, frozen=True):
    """Everything that a listener knows at one instant."""

    bus: Bus
    gateway: Gateway
    boards: dict[str, Board]
    samples: Samples
    axes: dict[str, Axis]
    own_sync_per_s: float
    """Number of SYNC frames that the listener itself has sent in the last second."""
    unknown: dict[str, int]
    """Number of frames that are not in ``arm.dbc``, by identifier."""
    hints: list[str]
    """What is missing on the bus, and what to do about it."""


class _Rate:
    """Number of occurrences in the last second."""

    def __init__(self) -> None:
        self._times_ns: deque[int] = deque()
        self.last_ns: int | None = None

    def count(self, now_ns: int) -> None:
        self._times_ns.append(now_ns)
        self.last_ns = now_ns
        self._forget(now_ns)

    def per_s(self, now_ns: int) -> float:
        self._forget(now_ns)
        return len(self._times_ns) * 1e9 / WINDOW_NS

    def is_silent(self, now_ns: int) -> bool:
        return self.last_ns is None or now_ns - self.last_ns > SILENT_NS

    def _forget(self, now_ns: int) -> None:
        while self._times_ns and self._times_ns[0] <= now_ns - WINDOW_NS:
            self._times_ns.popleft()


class _BoardState:
    def __init__(self, node_id: int) -> None:
        self.node_id = node_id
        self.heartbeats = _Rate()
        self.nmt_state: int | None = None
        self.emergencies = 0
        self.last_emergency = ""

    def heartbeat(self, data: bytes, now_ns: int) -> None:
        if len(data) == codec.HEARTBEAT_ADC_LENGTH:
            self.heartbeats.count(now_ns)
            self.nmt_state = data[0]

    def emergency(self, data: bytes) -> None:
        if len(data) == codec.EMCY_ADC_LENGTH:
            self.emergencies += 1
            self.last_emergency = describe_emergency(
                int.from_bytes(data[:2], "little"), data[2], bytes(data[3:])
            )

    def state(self, now_ns: int) -> str:
        if self.nmt_state is None or self.heartbeats.is_silent(now_ns):
            return "silent"
        try:
            return NmtState(self.nmt_state).name.lower().replace("_", "-")
        except ValueError:
            return f"unknown NMT state {self.nmt_state}"

    def status(self, now_ns: int) -> Board:
        last_ns = self.heartbeats.last_ns
        age_s = None if last_ns is None else (now_ns - last_ns) / 1e9
        return Board(self.node_id, self.state(now_ns), age_s, self.emergencies, self.last_emergency)


class BusWatch:
    """Collects what the frames on the bus say about the rig."""

    def __init__(
        self,
        rig: Rig,
        bit_rate: int,
        on_sample: Callable[[tuple[float, ...]], None] = lambda _volts: None,
    ) -> None:
        """``bit_rate`` is that of the bus, in bit/s.

        ``on_sample`` is called with the voltages of the channels of each undamaged sample.
        """
        self._on_sample = on_sample
        self._rig = rig
        self._bit_rate = bit_rate
        self._boards = {"adc": _BoardState(ADC_NODE), "dac": _BoardState(DAC_NODE)}
        self._gateway = _BoardState(1)
        self._frames, self._syncs, self._own_syncs = _Rate(), _Rate(), _Rate()
        self._commands, self._samples = _Rate(), _Rate()
        self._bits: deque[tuple[int, int]] = deque()
        """Times and lengths in bits of the frames of the last second."""
        self._bits_in_window = 0
        self._frame_count = self._error_frames = self._lost = self._damaged = 0
        self._last_error_frame = ""
        self._crc = frame_crc(codec.TPDO1_ADC, rig.bus.wire_version, protected=rig.adc.protected)
        self._other_version: int | None = None
        """Wire version in which the CRC of the last sample is right, if it is not that of the rig file."""
        self._counter: int | None = None
        self._sampled: deque[tuple[int, tuple[float, ...]]] = deque()
        """Times and potentiometer voltages of the last 0.1 s, by channel."""
        self._valve_v: tuple[float, ...] | None = None
        self._unknown: Counter[str] = Counter()
        self._handlers: dict[int, Callable[[bytes, int], None]] = {
            codec.SYNC: lambda _data, now_ns: self._syncs.count(now_ns),
            codec.NMT: lambda _data, _now_ns: None,
            codec.TPDO1_ADC: self._receive_sample,
            codec.RPDO1_DAC: self._receive_command,
            codec.HEARTBEAT_GATEWAY: self._gateway.heartbeat,
            codec.HEARTBEAT_ADC: self._boards["adc"].heartbeat,
            codec.HEARTBEAT_DAC: self._boards["dac"].heartbeat,
            codec.EMCY_ADC: lambda data, _now_ns: self._boards["adc"].emergency(data),
            codec.EMCY_DAC: lambda data, _now_ns: self._boards["dac"].emergency(data),
        }

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take a frame of another node."""
        if frame.is_error:
            self._error_frames += 1
            self._last_error_frame = str(frame)
            return
        self._frame_count += 1
        self._count_load(frame, now_ns)
        handler = None if frame.is_extended or frame.is_remote else self._handlers.get(frame.id)
        if handler is not None:
            handler(frame.data, now_ns)
            return
        name = str(frame).partition("#")[0]
        if name in self._unknown or len(self._unknown) < MAX_UNKNOWN_IDENTIFIERS:
            self._unknown[name] += 1

    def sent(self, frame: Frame, now_ns: int) -> None:
        """Take a frame that the listener itself has sent."""
        self._count_load(frame, now_ns)
        if frame.id == codec.SYNC:
            self._own_syncs.count(now_ns)

    def _count_load(self, frame: Frame, now_ns: int) -> None:
        self._frames.count(now_ns)
        bits = bits_on_wire(frame)
        self._bits.append((now_ns, bits))
        self._bits_in_window += bits
        self._forget_bits(now_ns)

    def hears_a_gateway(self, now_ns: int) -> bool:
        """Return whether another node has sent what only a gateway sends, within ``SILENT_NS``."""
        rates = (self._syncs, self._commands, self._gateway.heartbeats)
        return not all(rate.is_silent(now_ns) for rate in rates)

    def adc_is_pre_operational(self, now_ns: int) -> bool:
        """Return whether the ADC board waits to be started."""
        return self._boards["adc"].state(now_ns) == "pre-operational"

    def status(self, now_ns: int) -> Status:
        """Return what is known at ``now_ns``."""
        self._forget_bits(now_ns)
        load = self._bits_in_window / self._bit_rate * 1e9 / WINDOW_NS
        return Status(
            Bus(
                load,
                self._bit_rate,
                self._frames.per_s(now_ns),
                self._frame_count,
                self._error_frames,
                self._last_error_frame,
            ),
            Gateway(self._gateway.state(now_ns), self._syncs.per_s(now_ns), self._commands.per_s(now_ns)),
            {name: board.status(now_ns) for name, board in self._boards.items()},
            Samples(self._samples.per_s(now_ns), self._counter, self._lost, self._damaged),
            {name: self._axis(name, now_ns) for name in self._rig.axes},
            self._own_syncs.per_s(now_ns),
            dict(self._unknown),
            self._hints(now_ns),
        )

    def _receive_sample(self, data: bytes, now_ns: int) -> None:
        self._samples.count(now_ns)
        is_protected = self._rig.adc.protected
        length = codec.TPDO1_ADC_LENGTH if is_protected else codec.TPDO1_ADC_LENGTH - 2
        if len(data) != length:
            self._damaged += 1
            return
        if self._crc is not None and not self._crc.is_right(data):
            self._damaged += 1
            self._other_version = self._crc.other_version(data)
            return
        self._other_version = None
        sample = codec.decode_tpdo1_adc(data if is_protected else data + b"\0\0")
        if is_protected:
            if self._counter is not None:
                self._lost += max(((sample.counter - self._counter) & 0xFF) - 1, 0)
            self._counter = sample.counter
        self._on_sample(sample[:3])
        self._sampled.append((now_ns, sample[:3]))
        while now_ns - self._sampled[0][0] > SPEED_WINDOW_NS:
            self._sampled.popleft()

    def _receive_command(self, data: bytes, now_ns: int) -> None:
        self._commands.count(now_ns)
        if len(data) in (codec.RPDO1_DAC_LENGTH, codec.RPDO1_DAC_LENGTH - 2):
            self._valve_v = codec.decode_rpdo1_dac(data[:6] + b"\0\0")[:3]

    def _axis(self, name: str, now_ns: int) -> Axis:
        axis = self._rig.axes[name]
        pot = axis.potentiometer
        valve_v = None
        if self._valve_v is not None and not self._commands.is_silent(now_ns):
            valve_v = self._valve_v[axis.valve.channel - 1]
        if not self._sampled or self._samples.is_silent(now_ns):
            return Axis(axis.unit, None, None, None, valve_v, is_in_range=True)
        place = pot.channel - 1
        (first_ns, first), (last_ns, last) = self._sampled[0], self._sampled[-1]
        speed = None
        if last_ns > first_ns:
            way = pot.position(last[place]) - pot.position(first[place])
            speed = way * 1e9 / (last_ns - first_ns)
        is_in_range = pot.min_v <= last[place] <= pot.max_v
        return Axis(axis.unit, last[place], pot.position(last[place]), speed, valve_v, is_in_range)

    def _hints(self, now_ns: int) -> list[str]:
        if self._frame_count == 0:
            return ["no frame at all: check cable, termination and bit rate, and that the boards have power"]
        adc = self._boards["adc"].state(now_ns)
        hints = [
            f"no heartbeat of the {name.upper()} board (node 0x{board.node_id:02X}): check its power, its "
            "node id and object 1017h"
            for name, board in self._boards.items()
            if board.state(now_ns) == "silent"
        ]
        if self._other_version is not None:
            hint = version_hint(self._other_version, self._rig.bus.wire_version)
            hints.append(f"the CRC of the samples is wrong: {hint}")
        if self._samples.is_silent(now_ns):
            if self._syncs.is_silent(now_ns) and self._own_syncs.is_silent(now_ns):
                hints.append("no SYNC, so the ADC board sends no samples: start a gateway, or use --sync")
            elif adc != "operational":
                hints.append(f"no samples, because the ADC board is {adc}")
            else:
                hints.append("no samples in spite of SYNC: check objects 1800h and 1A00h of the ADC board")
        return hints

    def _forget_bits(self, now_ns: int) -> None:
        while self._bits and self._bits[0][0] <= now_ns - WINDOW_NS:
            self._bits_in_window -= self._bits.popleft()[1]
