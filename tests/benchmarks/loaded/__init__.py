"""Parts of ``bench_loaded.py``: the loads, the witness beside a run, and the causes of what was late."""
