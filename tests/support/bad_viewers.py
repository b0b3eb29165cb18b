"""Viewers that behave badly: they read nothing, send garbage, or never finish their request."""

from __future__ import annotations

import contextlib
import os
import socket
import struct
from urllib.parse import urlsplit

KEY = "dGhlIHNhbXBsZSBub25jZQ=="
DEEP = b"[" * 50_000
"""JSON that is nested too deeply for a reader that calls itself."""


def silent(address: str, path: str = "/stream", protocol: str = "") -> socket.socket:
    """Connect a viewer that reads no more than the answer to its request."""
    parts = urlsplit(address)
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    sock.settimeout(30.0)
    sock.connect((parts.hostname or "", parts.port or 0))
    last = f"Sec-WebSocket-Protocol: {protocol}\r\n" if protocol else ""
    sock.sendall(
        f"GET {path}?{parts.query} HTTP/1.1\r\nHost: {parts.netloc}\r\nUpgrade: websocket\r\n"
        f"Connection: Upgrade\r\nSec-WebSocket-Key: {KEY}\r\nSec-WebSocket-Version: 13\r\n{last}\r\n".encode()
    )
    answer = b""
    while b"\r\n\r\n" not in answer:
        answer += sock.recv(1)
    assert answer.startswith(b"HTTP/1.1 101"), answer
    return sock


def half_open(address: str, begin: bytes = b"") -> socket.socket:
    """Connect, and send only the begin of a request."""
    parts = urlsplit(address)
    sock = socket.create_connection((parts.hostname or "", parts.port or 0), 30.0)
    sock.sendall(begin)
    return sock


def frame(opcode: int, payload: bytes, *, is_masked: bool = True) -> bytes:
    """Return a WebSocket frame (RFC 6455, section 5.2) with a mask of zeros."""
    mask = 0x80 if is_masked else 0
    if len(payload) < 126:
        head = struct.pack("!BB", 0x80 | opcode, mask | len(payload))
    elif len(payload) < 65536:
        head = struct.pack("!BBH", 0x80 | opcode, mask | 126, len(payload))
    else:
        head = struct.pack("!BBQ", 0x80 | opcode, mask | 127, len(payload))
    return head + (bytes(4) if is_masked else b"") + payload


GARBAGE = {
    "no JSON": frame(1, b"{"),
    "a list": frame(1, b"[1, 2]"),
    "a number too large for a float": frame(1, b'{"speed": 1' + b"0" * 400 + b"}"),
    "nested too deeply": frame(1, DEEP),
    "no UTF-8": frame(1, b"\xff\xfe\xfd"),
    "binary": frame(2, os.urandom(1000)),
    "a request that is not one": frame(1, b'{"request": ["stop"], "id": 1e400}'),
    "longer than the limit": frame(1, b"x" * 10_000_000),
    "a length of 2^63": struct.pack("!BBQ", 0x81, 0xFF, 2**63),
    "a reserved opcode": frame(7, b"x"),
    "a long control frame": frame(9, b"x" * 1000),
    "random bytes": os.urandom(5000),
    "a part that never ends": b"\x01\x84" + bytes(4) + b"part",
    "the end of the connection": frame(8, struct.pack("!H", 1001)),
}
"""What a viewer may send after its request, by what it is."""


def send(sock: socket.socket, data: bytes) -> None:
    """Send, or see that the server has closed the connection."""
    with contextlib.suppress(BrokenPipeError, ConnectionResetError):
        sock.sendall(data)
