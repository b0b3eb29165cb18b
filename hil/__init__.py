"""Hardware-in-the-loop gateway for a three-axis pneumatic robot arm.

Floors, imports go down only: 0 ``frames``, ``errors``, ``events``; 1 ``wire``, ``laws``, ``limits``,
``life_cycle``, ``rig``, ``controller_file``, ``setpoints``; 2 ``gateway``; 3 ``links``, ``recording``,
``shells``; 4 ``cli``. Floors 0 to 2 do no I/O and read no clock.
"""

__version__ = "0.2.0"
