"""Reproduction of the paper: every printed figure and statement beside the computed one."""
