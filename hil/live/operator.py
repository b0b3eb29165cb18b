"""Passes the requests of a page to a daemon."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from hil.core.errors import OperationError
from hil.operation.client import Client, connect
from hil.operation.protocol import decode_call

ALLOWED = frozenset({"arm", "disarm", "start", "stop", "reset", "setpoint", "controller", "jog"})
"""Requests that a page may make. Recordings, and the end of the daemon, are not among them."""


class DaemonOperator:
    """A connection to a daemon, whose rules apply. It may be used by several threads."""

    def __init__(self, path: str) -> None:
        """``path``: of the daemon's socket. It is connected with the first request."""
        self._path = Path(path)
        self._client: Client | None = None
        self._lock = threading.Lock()

    def disconnect(self) -> None:
        """Forget the connection to a daemon that has ended; the next request opens another."""
        with self._lock:
            if self._client is not None:
                self._client.close()
            self._client = None

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Make a request of ``hil.operation.protocol`` and return ``accepted`` and ``text``.

        Raises ValueError if it is no request, or one that a page may not make.
        """
        if request.get("request") not in ALLOWED:
            raise ValueError(f"{request.get('request')!r:.60} is not one of {', '.join(sorted(ALLOWED))}")
        if request["request"] == "setpoint" and not str(request.get("setpoint", "")).strip():
            return {"accepted": False, "text": "the setpoint is empty: enter a position, such as 0.05"}
        call = decode_call(msgspec.json.encode(request))
        with self._lock:
            try:
                self._client = self._client or connect(self._path)
                answer = self._client.answer_to(call)
            except OperationError as error:
                self._client = None
                return {"accepted": False, "text": str(error)}
        return {"accepted": answer.accepted, "text": answer.text}
