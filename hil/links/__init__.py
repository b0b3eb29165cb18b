"""Links to buses: SocketCAN, serial adapters, UDP multicast inside this host, and buses inside a process.

``open_link("vcan0")`` opens a bus by its name; ``BUS_FORMS`` lists the forms of names. All buses are those of
python-can or derived from them. python-can is imported when the first link is opened, not with this package.
"""

from hil.links.link import Link, Received, open_link
from hil.links.opening import BUS_FORMS, Origin

__all__ = ["BUS_FORMS", "Link", "Origin", "Received", "open_link"]
