"""Controller design: H-infinity loop shaping, fixed structures, searchers, reports.

From a plant model to a controller file that the daemon runs. Never imported by ``hil``.
"""
