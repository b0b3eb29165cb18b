"""Closed loops: step responses, what is read off them, specifications, and the comparison of controllers."""
