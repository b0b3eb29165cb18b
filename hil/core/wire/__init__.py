"""Frames on the bus: ``arm.dbc`` describes each of them, and the codec is compiled from it."""
