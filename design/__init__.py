"""Controller design for an identified plant: H-infinity loop shaping with a fixed controller structure.

This package leads from a plant model to a controller file that the daemon runs. ``hil`` never imports it.
Importing it imports nothing else; scipy, control and matplotlib are imported where they are used.

A design as one program::

    from design.models.plant import paper_plant
    from design.models.sampling import Sampling
    from design.synthesis.structures import STRUCTURES
    from design.synthesis.fixed_structure import synthesise
    from design.synthesis.weight_selection import select_weight

    plant = paper_plant()                             # or plant.read_plant(text, source)
    sampling = Sampling(0.0112, delay_samples=1)      # None: the continuous loop, as in the paper
    weight = select_weight(plant, sampling=sampling)  # eqs. (8), (9)
    design = synthesise(plant, weight.weight, STRUCTURES["pid"], sampling=sampling)  # eqs. (13), (14)
    law = design.structure.law(design.values, sampling.period_s)                     # what the daemon runs

==============  ==========================================================================================
mathematics     batched polynomials, the largest value of a frequency response, the matrix exponential
models          plant documents, sampling with hold and delay, controllers, realisations, measured records
robustness      the stability margin ε, classical margins, the ν-gap, loop shaping, the central controller
closed_loop     step responses and their readings, specifications (9), the assessment of candidates
search          the interface of searchers, three of them, and the search bounds of parameters
synthesis       structures, weight selection (8), synthesis (13), baselines, design file and procedure
output          report, figures, controller files and terminal text
paper           the reproduction of the paper
python_control  plants and finished laws, to and from python-control
==============  ==========================================================================================

Conventions: feedback is negative. A polynomial is an array (..., n + 1) in falling powers, and its leading
axes count candidates. A sampled loop is computed in the bilinear plane (see :mod:`design.models.sampling`),
where Tustin's rule leaves a controller's coefficients as they are, and all norms are those of the sampled
loop.
"""
