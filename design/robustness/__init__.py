"""Stability margins, the ν-gap between plants, loop shaping, and the central controller."""
