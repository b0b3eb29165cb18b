"""Two serial adapters on one CAN bus: pseudo-terminals that speak the Lawicel protocol."""

import os
import select
import threading
import tty
from collections import deque
from typing import Self


class Adapter:
    """One adapter. ``device`` is the path of its serial line."""

    def __init__(self) -> None:
        self.line = self.slave = -1
        self.plug_in()
        self.on_bus = False
        self.commands: list[bytes] = []
        self.refused: set[bytes] = set()
        self.ignored_lines = 0
        """Number of lines that stay without an answer, as while an Arduino boots."""
        self.incoming = b""
        self.outgoing: deque[bytes] = deque()

    def plug_in(self) -> None:
        """Make a serial line. A new one may have another path."""
        self.line, self.slave = os.openpty()
        tty.setraw(self.slave)
        os.set_blocking(self.line, False)
        self.device = os.ttyname(self.slave)
        self.on_bus = False

    def answer(self, line: bytes) -> bytes:
        """Return the answer that the CAN232 manual gives: CR, BELL, or z and CR. Join or leave the bus."""
        self.commands.append(line)
        name = line[:1]
        if line in self.refused or (name in b"tTrR" and not self.on_bus):
            return b"\a"
        if name in (b"O", b"C"):
            allowed = self.on_bus != (name == b"O")
            self.on_bus = name == b"O"
            return b"\r" if allowed else b"\a"
        return b"z\r" if name in b"tTrR" else b"\r"


class TwoAdapters:
    """The bus and its adapters, which a thread serves until the ``with`` statement ends."""

    def __init__(self) -> None:
        self.one, self.other = self.both = (Adapter(), Adapter())
        self._stop, self._stopping = os.pipe()

    def __enter__(self) -> Self:
        self.resume()
        return self

    def resume(self) -> None:
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def pause(self) -> None:
        os.write(self._stopping, b".")
        self._thread.join()
        os.read(self._stop, 1)

    def __exit__(self, *_: object) -> None:
        self.pause()
        for adapter in self.both:
            for descriptor in (adapter.line, adapter.slave):
                if descriptor >= 0:
                    os.close(descriptor)
        os.close(self._stop)
        os.close(self._stopping)

    def unplug(self, adapter: Adapter) -> None:
        self.pause()
        os.close(adapter.line)
        os.close(adapter.slave)
        adapter.line = adapter.slave = -1
        self.resume()

    def plug_in(self, adapter: Adapter) -> None:
        self.pause()
        adapter.plug_in()
        self.resume()

    def _serve(self) -> None:
        while True:
            lines = [adapter.line for adapter in self.both if adapter.line >= 0]
            full = [adapter.line for adapter in self.both if adapter.line >= 0 and adapter.outgoing]
            readable, writable, _ = select.select([self._stop, *lines], full, [])
            if self._stop in readable:
                return
            for adapter in self.both:
                if adapter.line in readable:
                    self._take(adapter)
                if adapter.line in writable:
                    data = b"".join(adapter.outgoing)
                    adapter.outgoing.clear()
                    if left := data[os.write(adapter.line, data) :]:
                        adapter.outgoing.append(left)

    def _take(self, adapter: Adapter) -> None:
        *lines, adapter.incoming = (adapter.incoming + os.read(adapter.line, 65536)).split(b"\r")
        peer = self.other if adapter is self.one else self.one
        for line in lines:
            if adapter.ignored_lines:
                adapter.ignored_lines -= 1
                continue
            answer = adapter.answer(line)
            adapter.outgoing.append(answer)
            if answer == b"z\r" and peer.on_bus:
                peer.outgoing.append(line + b"\r")
