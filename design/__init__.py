"""Controller design by H-infinity loop shaping with fixed structures: from plant model to controller file.

``hil`` never imports this package. Importing it imports nothing else; scipy, control and matplotlib are
imported where they are used.

The whole of ``hil design`` from Python::

    from pathlib import Path
    from design.models.plant import paper_plant
    from design.output.results import write_design
    from design.synthesis.design_file import DesignFile
    from design.synthesis.procedure import design_controller

    plant = paper_plant()                             # or read_plant(text, source)
    design = design_controller(DesignFile(), plant)   # or read_design(text, source)
    written = write_design(design, Path("designs/paper"))
    print(round(design.eps, 4), written.controller, written.recommendation.action)

Its two searches alone::

    from design.models.sampling import Sampling
    from design.synthesis.fixed_structure import synthesise
    from design.synthesis.structures import STRUCTURES
    from design.synthesis.weight_selection import select_weight

    sampling = Sampling(0.0112, delay_samples=1)      # None: the continuous loop, as in the paper
    weight = select_weight(plant, sampling=sampling)  # eqs. (8), (9)
    pid = synthesise(plant, weight.weight, STRUCTURES["pid"], sampling=sampling)  # eqs. (13), (14)
    law = pid.structure.law(pid.values, sampling.period_s)                        # what the gateway runs

==================  ==================================================================================
mathematics         batched polynomials, peaks of rational functions, matrix exponential
models              plants and their documents, realisations, controllers as polynomials, measured records
identification      plant models from recorded experiments
robustness          stability margin ε and classical margins, ν-gap, loop shaping (Appendices A and B)
closed_loop         loops, step responses and their readings, specifications, comparison of controllers
search              the searcher interface, differential evolution, genetic algorithm, random search, bounds
synthesis           structures, design file, weight selection, synthesis, the whole procedure, recommendation
output              report, figures, controller files, terminal output, progress
paper               the reproduction of the paper
inputs, cli         reading files, and the command ``hil design``
python_control      plants and controllers to and from python-control
==================  ==================================================================================

Conventions: negative feedback. Polynomials are arrays (..., n + 1) of coefficients in falling powers, and the
leading axes are candidates. A sampled loop is computed in the bilinear plane (see ``design.models.plant``),
in which Tustin's rule leaves the coefficients of a controller as they are, and all norms are those of the
sampled loop.
"""
