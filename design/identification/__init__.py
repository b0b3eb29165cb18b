"""Identification: from records of an experiment to a model with its uncertainty and its weaknesses.

This package is numerical. It takes arrays and returns values; it reads no files and prints nothing.

    from design.identification.identify import identify

    found = identify(u, y, sample_time_s=0.0112)  # RecordRefusedError if the record allows no model
    found.discrete, found.continuous              # the sampled model, and the continuous one behind the hold
    found.fit_percent                             # of a free run on data that were not fitted
    found.properties.modes                        # natural frequencies and damping, with their deviations
    found.findings                                # what speaks against record and model, and what to do

======================  =================================================================================
``identify``            the whole way: checks, fit, validation, residual tests, findings
``order_search``        many structures side by side: AIC, BIC and the fit on validation data
``records``             an experiment: samples, gaps, weights, transport delay; rows with time stamps
``models``              structures; sampled and continuous models; zero-order hold and its inverse
``estimators``          output error, continuous poles, ARX, ARMAX, Box-Jenkins; covariance
``analysis``            simulation and fit, residual tests, intervals, measured frequency responses
``checks``, ``findings``  what is wrong with a record or a model, as typed findings
======================  =================================================================================

How the estimators work. For given poles the best numerator, the initial state of each stretch of data, and
the offset and drift of each experiment follow from linear least squares (``simulation_error``); the
unknowns of a stretch are eliminated where they occur, so that many gaps cost little (``elimination``). What
remains is a search over the poles alone, in logarithms of continuous quantities (``pole_sections``), from
start values that a grid gives (``pole_search``). The residuals are reduced to a few rows before the search
sees them, so a million samples cost one filter run and one triangularisation a step.

Conventions: u[k] is held from sample k to sample k + 1. NaN is a missing sample, which is masked and never
filled in. Polynomials of a sampled model are in rising powers of z^-1, those of a continuous one in falling
powers of s. A dead time counts all periods between input and output beyond the one that the hold needs; the
part of it that is the rig's own transport delay is stated beside it (``contains_delay_samples``).
"""
