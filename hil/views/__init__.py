"""Presentation of a run: the live display, the summary in the terminal, the plots."""
