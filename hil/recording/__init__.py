"""Recordings: one MCAP file a run, written by a process of its own, read back for replay and summaries.

``schemas`` says what is in the file; ``recorder`` is the loop's side, ``recorder_process`` and ``writer`` the
other; ``reader`` reads. Only ``reader`` imports numpy, only ``writer`` and ``reader`` import mcap.
"""
