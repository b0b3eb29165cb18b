"""A bus inside this process: python-can's virtual bus with a bounded queue that ``select`` can wait for."""

from __future__ import annotations

import os
import queue
from typing import Final

from can import Message
from can.interfaces.virtual import VirtualBus, channels_lock

_QUEUE_FRAMES: Final = 4096
"""Number of frames that wait for one link before others are refused."""


class InProcessBus(VirtualBus):
    """A bus of all links in this process that use the same name."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        with channels_lock:
            self.channel.remove(self.queue)
            self.queue: _SignallingQueue = _SignallingQueue(_QUEUE_FRAMES)
            self.channel.append(self.queue)

    def send(self, msg: Message, timeout: float | None = None) -> None:
        """Deliver ``msg`` to every other link. A full queue refuses it at once."""
        super().send(msg, timeout=0)

    def fileno(self) -> int:
        """Return a descriptor that is readable while frames wait."""
        return self.queue.descriptor

    def shutdown(self) -> None:
        """Leave the bus. Leaving twice is no error."""
        was_open = self._open
        super().shutdown()
        if was_open:
            os.close(self.queue.descriptor)


class _SignallingQueue(queue.Queue[Message]):
    """A queue with an eventfd whose count equals the number of waiting messages."""

    def __init__(self, maxsize: int) -> None:
        super().__init__(maxsize)
        self.descriptor = os.eventfd(0, os.EFD_SEMAPHORE | os.EFD_CLOEXEC)

    def _put(self, item: Message) -> None:
        super()._put(item)
        os.eventfd_write(self.descriptor, 1)

    def _get(self) -> Message:
        os.eventfd_read(self.descriptor)
        return super()._get()
