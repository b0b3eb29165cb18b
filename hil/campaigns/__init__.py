"""Campaigns: many runs in simulated time, judged by stated criteria.

- ``campaign_file``: the file of a campaign, and its cases by number.
- ``case``: one case: how it runs, and its result.
- ``result_files``: the results on disk, to resume from and to read with other tools.
- ``runner``: runs the cases in processes, in order.
- ``summary``: what the results say, fault by fault.
- ``page``: the HTML page, with the worst cases first.
- ``shipped``: the campaigns ``bus``, ``faults`` and ``robustness``.
"""
