"""Recordings: one MCAP file a run, written by a process of its own, read back for replay and summaries.

``schemas`` says what is in the file. Writing: ``recorder`` (the loop's side), ``pipe``, ``handover`` (what
crosses), ``recorder_process``, ``mcap_writer``. Reading: ``reader``, ``mcap_reader``. Only the readers import
numpy; the loop's side imports neither numpy nor mcap.
"""
