"""Simulated firmware: the valve and potentiometer boards of the rig, and the plants behind them.

A :class:`~firmware_sim.simulated_rig.SimulatedRig` is both boards with a plant on their pins, as a state
machine: it is given frames and the time, and it returns frames. ``firmware-sim`` runs it on a bus in real
time, ``hil run --lockstep`` runs it in simulated time. From Python:

    rig = read_rig(text, "rig.toml")
    plant = Arm(shipped_arm(), seed=1, wiring=wiring(rig))  # or LinearPlant(rig), or any Plant
    boards = SimulatedRig(rig, plant)
    frames = boards.start(now_ns=0)                         # the boot-up messages
    frames = boards.receive(Frame(0x080), now_ns=1000)      # SYNC, and what the boards answer

- ``boards``: both boards, and the faults that a test can put on them.
- ``arm``: the pneumatic arm, its parameters and its events.
- ``plants``: the plant interface, and linear plants such as a user's identified plant.
- ``scenario``, ``scenarios``: experiments on the arm.
- ``simulated_rig``, ``realtime``, ``serial_device``, ``cli``, ``watch``: the command ``firmware-sim``.
- ``plant_options``, ``plant_files``, ``simulated_plant``: the plant that command-line options choose.
"""
