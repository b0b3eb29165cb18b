"""Closed loops: step responses, their readings, and the specifications on them."""
