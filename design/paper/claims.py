"""Check every figure and statement of the paper against the computed ones.

The experiments, Figs 13 to 15, need an arm and are not checked here. Where the paper leaves open how a figure
is to be read, the claim's explanation says how it is read here.
"""

from __future__ import annotations

from design.paper.checked_claim import CheckedClaim
from design.paper.design_claims import check_loop_shaping, check_model, check_synthesis, check_weight
from design.paper.evidence import Evidence
from design.paper.response_claims import check_responses, check_robustness

_CHECKS = (
    check_model,
    check_weight,
    check_loop_shaping,
    check_synthesis,
    check_responses,
    check_robustness,
)


def check_claims(evidence: Evidence) -> tuple[CheckedClaim, ...]:
    """Check every claim, in the paper's order."""
    return tuple(claim for check in _CHECKS for claim in check(evidence))
