"""Export of recordings to files of other tools, and import of their bus logs.

``output_file`` writes whole files or none. ``signals`` and ``frames`` take blocks out of a recording,
``signal_files`` and ``frame_files`` write them, ``bus_logs`` reads logs, and ``log_import`` makes a recording
of them. Libraries that not everybody has are imported where they are used.
"""
