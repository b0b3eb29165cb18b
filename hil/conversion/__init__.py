"""Export of recordings to files of other tools, and import of their bus logs.

``output_file`` writes whole files or none. ``signals`` and ``frames`` take ranges out of a recording,
``signal_files`` and ``frame_files`` write them, ``export`` puts them together. ``bus_logs`` reads logs
(``blf_containers`` and ``mf4_process`` guard against damaged ones), ``dbc`` and ``log_periods`` decode their
frames, and ``log_import`` makes a recording. Optional libraries are imported where they are used.
"""
