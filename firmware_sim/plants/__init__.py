"""Plants behind the simulated boards.

- ``plant``: the interface that every plant has; the pneumatic arm (``firmware_sim.arm``) has it too.
- ``linear_plant``: a linear model for each axis, such as eq. (15) of the paper or a user's identified plant.
- ``linear_model``: the transfer function with dead time that a linear plant simulates.
- ``zero_order_hold``: the exact response of a transfer function while its input is constant.
- ``plant_file``: the plant document (``plant.json``) that ``hil design`` reads too.
- ``combined_plant``: several plants, each on board channels of its own.
"""
