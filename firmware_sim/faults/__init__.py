"""The fault library: what can go wrong with frames, bus, boards, sensors, valves and host of a simulated rig.

- ``kinds``: each fault as a typed document, as a scenario file lists it under ``[[faults]]``.
- ``fault_text``: the same fault as a text, such as ``lose:sample,5@2`` (option ``--fault``, Python).
- ``condition``: when a fault begins.
- ``frame_faults``: faults that change frames on their way.
- ``wires``: faults between a board's pins and the plant.
- ``host``: faults of the computer on which the gateway runs.
- ``checks``: what is checked before a fault is armed.

``firmware_sim.faulty_rig.FaultyRig`` applies them, in simulated time and in real time.
"""
