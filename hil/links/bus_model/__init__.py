"""A model of a CAN bus in simulated time. It does no I/O, reads no clock, and has no randomness of its own.

- ``controller``: one node's CAN controller, with its transmit queue and its error counters.
- ``bus``: the bus between controllers: arbitration, bit times, acknowledgement, error frames.
- ``rig_bus``: the bus of a rig, with the gateway, both boards and foreign nodes, and with its faults.

The model follows ISO 11898-1 for what decides when a frame arrives. It leaves out:

- the propagation delay, the sample point, and overload frames;
- errors that one receiver detects before the others, for which its counter would rise by 8: all receivers
  detect an error at the same bit, and count 1;
- the collision of two nodes that send the same identifier within one bit time: the one that joined the bus
  first sends first.
"""
