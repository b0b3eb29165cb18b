"""The pure part of the gateway: no I/O, no clock, no thread.

It is given frames and the time. It returns frames, events and its next deadline.
"""
