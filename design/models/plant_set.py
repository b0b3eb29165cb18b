"""One plant or several, as a design takes them: the models that the loop sees, and what limits them."""

from __future__ import annotations

from collections.abc import Sequence

from design.errors import DesignError
from design.models.plant import Plant
from design.models.plant_limits import hidden_mode_message, hidden_unstable_mode, performance_limits
from design.models.sampling import Sampling
from design.models.transfer_function import TransferFunction


def loop_models(plants: Plant | Sequence[Plant], sampling: Sampling | None) -> list[TransferFunction]:
    """Return what the loop sees of each plant; see :meth:`Plant.transfer_function`.

    Raises DesignError for a plant that hides an unstable mode.
    """
    several = _as_list(plants)
    for plant in several:
        hidden = hidden_unstable_mode(*plant.rational_part)
        if hidden is not None:
            raise DesignError(f"plant {plant.name}: {hidden_mode_message(hidden)}")
    return [plant.transfer_function(sampling) for plant in several]


def limit_notes(plants: Plant | Sequence[Plant], sampling: Sampling | None, wanted_rad_s: float = 0.0) -> str:
    """Return what makes these plants hard to control, as lines to follow an error message; often empty.

    ``wanted_rad_s`` is the crossover that is specified, or 0.
    """
    several = _as_list(plants)
    notes = []
    for plant in several:
        delay_s = 0.0 if sampling is None else plant.loop_delay_s(sampling) + 0.5 * sampling.period_s
        for limit in performance_limits(*plant.rational_part, delay_s, wanted_rad_s):
            notes.append(limit if len(several) == 1 else f"{plant.name}: {limit}")
    signs = {plant.name: plant.gain_sign for plant in several}
    if len(set(signs.values())) > 1:
        reversed_ones = ", ".join(name for name, sign in signs.items() if sign < 0.0)
        notes.append(
            f"of these plants {reversed_ones} moves against its input, the others with it: hardly any "
            "controller can stabilise them all"
        )
    return "".join(f"\nNote: {note}" for note in notes)


def _as_list(plants: Plant | Sequence[Plant]) -> list[Plant]:
    return [plants] if isinstance(plants, Plant) else list(plants)
