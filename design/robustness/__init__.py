"""Stability margins, the nu-gap, loop shaping and the central controller."""
