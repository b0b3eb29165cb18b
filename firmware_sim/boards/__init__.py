"""The simulated boards: CANopen state machines without I/O, and the serial adapter that can carry them.

- ``canopen_slave``: NMT states, boot-up message, heartbeat and EMCY, shared by both boards.
- ``adc``: the potentiometer board, node 0x10.
- ``dac``: the valve board, node 0x20.
- ``codec``: frame layouts and converters, written independently of ``hil.core.wire``.
- ``faults``: what a test can break on a board.
- ``lawicel``: a serial CAN adapter (slcan).
"""
