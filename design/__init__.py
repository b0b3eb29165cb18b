"""Controller design: H-infinity loop shaping, fixed structures, searchers, reports.

From a plant model to a controller file that the daemon runs. Never imported by ``hil``. Importing this
package imports nothing else; scipy, control and matplotlib are imported where they are used.

The way through it, as one program::

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

=====================  ==============================================================================
polynomials, peaks     batched polynomials; the largest value of a ratio over all frequencies, exactly
plant                  plant documents, zero-order hold and delay, the bilinear plane and z; what a plant
                       forbids any controller is in ``plant_limits``
margins                stability margin ε, gain and phase margin, crossover, bandwidth, disturbance peak
nu_gap                 chordal distance, Vinnicombe's ν-gap
loop_shaping           Appendices A and B, McFarlane-Glover synthesis by Riccati equations, one plant
central_controller     the same, batched, by interpolation
boxes                  parameters, their boxes and codings
structures             controller and weight structures, and the laws they become
realisation            state space and polynomials, s (bilinear plane) and z, back and forth
verification           the law as the daemon realises it, back as polynomials: what is verified runs
responses, loops       batched step responses (``matrix_exponential``); all that can be read off loops
step_course            a step followed until it is at rest, however slow; ``step_readings`` what it reads
specifications         eqs. (8), (9): limits on readings, each with its name and its violation
search                 ask, tell, stop, and recorded convergence; ``differential_evolution`` (the
                       default), ``genetic_algorithm`` (the paper's) and ``random_search`` are searchers
weight_selection       eqs. (8), (9)
synthesis              eqs. (13), (14), over one plant or the worst of several
procedure, advice      all steps of a design, from its file; what is said of the result
python_control         plants and finished laws, to and from python-control
=====================  ==============================================================================

Conventions: negative feedback; polynomials are arrays (..., n + 1) in falling powers, leading axes are
candidates; a sampled loop is computed in the bilinear plane (``plant``), where Tustin's rule leaves a
controller's coefficients as they are and all norms are those of the sampled loop.
"""
