"""Codec of every frame in ``arm.dbc``: identifiers, lengths, signals in physical units.

Written by ``python -m hil.core.wire.compile_dbc``; do not edit. Out-of-range values raise struct.error.
"""

from __future__ import annotations

from struct import Struct
from typing import NamedTuple

NMT = 0x000
NMT_LENGTH = 2
_NMT = Struct("<BB")


class Nmt(NamedTuple):
    """Signals of a frame NMT."""

    command: int
    node_id: int


def decode_nmt(data: bytes) -> Nmt:
    """Return the signals of a frame NMT. ``data`` must have its full length."""
    command, node_id = _NMT.unpack(data)
    return Nmt(command, node_id)


def encode_nmt(command: int, node_id: int) -> bytes:
    """Return the data of a frame NMT."""
    return _NMT.pack(command, node_id)


SYNC = 0x080
SYNC_LENGTH = 0

EMCY_ADC = 0x090
EMCY_ADC_LENGTH = 8
_EMCY_ADC = Struct("<HBBI")


class EmcyAdc(NamedTuple):
    """Signals of a frame EMCY_ADC."""

    error_code: int
    error_register: int
    vendor_code: int
    vendor_value: int


def decode_emcy_adc(data: bytes) -> EmcyAdc:
    """Return the signals of a frame EMCY_ADC. ``data`` must have its full length."""
    error_code, error_register, vendor_code, vendor_value = _EMCY_ADC.unpack(data)
    return EmcyAdc(error_code, error_register, vendor_code, vendor_value)


def encode_emcy_adc(error_code: int, error_register: int, vendor_code: int, vendor_value: int) -> bytes:
    """Return the data of a frame EMCY_ADC."""
    return _EMCY_ADC.pack(error_code, error_register, vendor_code, vendor_value)


EMCY_DAC = 0x0A0
EMCY_DAC_LENGTH = 8
_EMCY_DAC = Struct("<HBBI")


class EmcyDac(NamedTuple):
    """Signals of a frame EMCY_DAC."""

    error_code: int
    error_register: int
    vendor_code: int
    vendor_value: int


def decode_emcy_dac(data: bytes) -> EmcyDac:
    """Return the signals of a frame EMCY_DAC. ``data`` must have its full length."""
    error_code, error_register, vendor_code, vendor_value = _EMCY_DAC.unpack(data)
    return EmcyDac(error_code, error_register, vendor_code, vendor_value)


def encode_emcy_dac(error_code: int, error_register: int, vendor_code: int, vendor_value: int) -> bytes:
    """Return the data of a frame EMCY_DAC."""
    return _EMCY_DAC.pack(error_code, error_register, vendor_code, vendor_value)


TPDO1_ADC = 0x190
TPDO1_ADC_LENGTH = 8
_TPDO1_ADC = Struct("<hhhBB")


class Tpdo1Adc(NamedTuple):
    """Signals of a frame TPDO1_ADC, in V."""

    potentiometer1: float
    potentiometer2: float
    potentiometer3: float
    counter: int
    crc8: int


def decode_tpdo1_adc(data: bytes) -> Tpdo1Adc:
    """Return the signals of a frame TPDO1_ADC. ``data`` must have its full length."""
    potentiometer1, potentiometer2, potentiometer3, counter, crc8 = _TPDO1_ADC.unpack(data)
    return Tpdo1Adc(
        potentiometer1 * 0.00030517578125,
        potentiometer2 * 0.00030517578125,
        potentiometer3 * 0.00030517578125,
        counter,
        crc8,
    )


def encode_tpdo1_adc(
    potentiometer1: float, potentiometer2: float, potentiometer3: float, counter: int, crc8: int
) -> bytes:
    """Return the data of a frame TPDO1_ADC."""
    return _TPDO1_ADC.pack(
        round(potentiometer1 / 0.00030517578125),
        round(potentiometer2 / 0.00030517578125),
        round(potentiometer3 / 0.00030517578125),
        counter,
        crc8,
    )


TPDO1_DAC = 0x1A0
TPDO1_DAC_LENGTH = 8
_TPDO1_DAC = Struct("<hhhBB")


class Tpdo1Dac(NamedTuple):
    """Signals of a frame TPDO1_DAC, in V."""

    valve1: float
    valve2: float
    valve3: float
    counter: int
    crc8: int


def decode_tpdo1_dac(data: bytes) -> Tpdo1Dac:
    """Return the signals of a frame TPDO1_DAC. ``data`` must have its full length."""
    valve1, valve2, valve3, counter, crc8 = _TPDO1_DAC.unpack(data)
    return Tpdo1Dac(
        valve1 * 0.00030517578125, valve2 * 0.00030517578125, valve3 * 0.00030517578125, counter, crc8
    )


def encode_tpdo1_dac(valve1: float, valve2: float, valve3: float, counter: int, crc8: int) -> bytes:
    """Return the data of a frame TPDO1_DAC."""
    return _TPDO1_DAC.pack(
        round(valve1 / 0.00030517578125),
        round(valve2 / 0.00030517578125),
        round(valve3 / 0.00030517578125),
        counter,
        crc8,
    )


RPDO1_DAC = 0x220
RPDO1_DAC_LENGTH = 8
_RPDO1_DAC = Struct("<hhhBB")


class Rpdo1Dac(NamedTuple):
    """Signals of a frame RPDO1_DAC, in V."""

    valve1: float
    valve2: float
    valve3: float
    counter: int
    crc8: int


def decode_rpdo1_dac(data: bytes) -> Rpdo1Dac:
    """Return the signals of a frame RPDO1_DAC. ``data`` must have its full length."""
    valve1, valve2, valve3, counter, crc8 = _RPDO1_DAC.unpack(data)
    return Rpdo1Dac(
        valve1 * 0.00030517578125, valve2 * 0.00030517578125, valve3 * 0.00030517578125, counter, crc8
    )


def encode_rpdo1_dac(valve1: float, valve2: float, valve3: float, counter: int, crc8: int) -> bytes:
    """Return the data of a frame RPDO1_DAC."""
    return _RPDO1_DAC.pack(
        round(valve1 / 0.00030517578125),
        round(valve2 / 0.00030517578125),
        round(valve3 / 0.00030517578125),
        counter,
        crc8,
    )


TPDO2_ADC = 0x290
TPDO2_ADC_LENGTH = 3
_TPDO2_ADC = Struct("<BBB")


class Tpdo2Adc(NamedTuple):
    """Signals of a frame TPDO2_ADC."""

    inputs: int
    counter: int
    crc8: int


def decode_tpdo2_adc(data: bytes) -> Tpdo2Adc:
    """Return the signals of a frame TPDO2_ADC. ``data`` must have its full length."""
    inputs, counter, crc8 = _TPDO2_ADC.unpack(data)
    return Tpdo2Adc(inputs, counter, crc8)


def encode_tpdo2_adc(inputs: int, counter: int, crc8: int) -> bytes:
    """Return the data of a frame TPDO2_ADC."""
    return _TPDO2_ADC.pack(inputs, counter, crc8)


HEARTBEAT_GATEWAY = 0x701
HEARTBEAT_GATEWAY_LENGTH = 1
_HEARTBEAT_GATEWAY = Struct("<B")


class HeartbeatGateway(NamedTuple):
    """Signals of a frame HEARTBEAT_GATEWAY."""

    state: int


def decode_heartbeat_gateway(data: bytes) -> HeartbeatGateway:
    """Return the signals of a frame HEARTBEAT_GATEWAY. ``data`` must have its full length."""
    (state,) = _HEARTBEAT_GATEWAY.unpack(data)
    return HeartbeatGateway(state)


def encode_heartbeat_gateway(state: int) -> bytes:
    """Return the data of a frame HEARTBEAT_GATEWAY."""
    return _HEARTBEAT_GATEWAY.pack(state)


HEARTBEAT_ADC = 0x710
HEARTBEAT_ADC_LENGTH = 1
_HEARTBEAT_ADC = Struct("<B")


class HeartbeatAdc(NamedTuple):
    """Signals of a frame HEARTBEAT_ADC."""

    state: int


def decode_heartbeat_adc(data: bytes) -> HeartbeatAdc:
    """Return the signals of a frame HEARTBEAT_ADC. ``data`` must have its full length."""
    (state,) = _HEARTBEAT_ADC.unpack(data)
    return HeartbeatAdc(state)


def encode_heartbeat_adc(state: int) -> bytes:
    """Return the data of a frame HEARTBEAT_ADC."""
    return _HEARTBEAT_ADC.pack(state)


HEARTBEAT_DAC = 0x720
HEARTBEAT_DAC_LENGTH = 1
_HEARTBEAT_DAC = Struct("<B")


class HeartbeatDac(NamedTuple):
    """Signals of a frame HEARTBEAT_DAC."""

    state: int


def decode_heartbeat_dac(data: bytes) -> HeartbeatDac:
    """Return the signals of a frame HEARTBEAT_DAC. ``data`` must have its full length."""
    (state,) = _HEARTBEAT_DAC.unpack(data)
    return HeartbeatDac(state)


def encode_heartbeat_dac(state: int) -> bytes:
    """Return the data of a frame HEARTBEAT_DAC."""
    return _HEARTBEAT_DAC.pack(state)
