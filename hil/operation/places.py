"""The places of the clients that are served at the same time, shared fairly among their processes.

A process may hold every place, as long as nobody else wants one. When no place is free, the process with the
most places gives one to a process with fewer: the one that has been idle for longest. So a program that opens
connections without end cannot keep an operator from `hil stop`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable


class Place:
    """The place of one client. Times are monotonic seconds."""

    def __init__(self, process_id: int, now_s: float, evict: Callable[[], None]) -> None:
        """``evict`` disconnects the client."""
        self.process_id = process_id
        self.evict = evict
        self.active_s = now_s
        """Time of the client's last request, or of its connection before the first one."""


class Places:
    """At most ``number`` places."""

    def __init__(self, number: int) -> None:
        self._number = number
        self._taken: list[Place] = []

    def take(self, process_id: int, now_s: float, evict: Callable[[], None]) -> Place | None:
        """Return a place for a client of a process; None if that process must give up one of its own first.

        ``evict`` is called if the place is given to another process later.
        """
        if len(self._taken) >= self._number and not self._make_room(process_id):
            return None
        place = Place(process_id, now_s, evict)
        self._taken.append(place)
        return place

    def release(self, place: Place) -> None:
        """Give a place back. A place that was evicted is gone already."""
        if place in self._taken:
            self._taken.remove(place)

    def _make_room(self, process_id: int) -> bool:
        """Evict a place of the process with the most places, unless ``process_id`` has as many."""
        held = Counter(place.process_id for place in self._taken)
        most = max(held.values())
        if held[process_id] >= most:
            return False
        longest_idle = min(
            (place for place in self._taken if held[place.process_id] == most),
            key=lambda place: place.active_s,
        )
        self._taken.remove(longest_idle)
        longest_idle.evict()
        return True
