"""Limits of a simulated state beyond which it describes no wire: melting, and strains that no alloy recovers.

A search may pass such states. Everything that is reported is checked: a simulation that exceeds a limit is a failure
with the code ``overheated`` or ``overstrained``, and its numbers from there on are left out.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from smajax.plant.plant import Plant
from smajax.plant.state import State
from smajax.simulation.status import MAX_STRAIN_RATIO, MELTING_TEMPERATURE, SimulationStatus

# 1/K. Thermal strain that is allowed in addition, for wires with little transformation strain: twice the expansion of
# austenite (dynalloy).
_ALLOWED_EXPANSION = 2.2e-5


def within_limits(plant: Plant, states: State) -> tuple[Bool[Array, " samples"], Bool[Array, " samples"]]:
    """Check the temperatures and the strains of a simulation.

    Args:
        plant: The plant.
        states: States at the samples, each leaf with a leading axis of ``samples``.

    Returns:
        Whether the temperatures, and whether the strains are within the limits at each sample; false for NaN.
    """
    return jax.vmap(lambda state: _state_within_limits(plant, state))(states)


def _state_within_limits(plant: Plant, state: State) -> tuple[Bool[Array, ""], Bool[Array, ""]]:
    material = plant.effective_material
    strain = plant._strain(plant._wire_state(state), state.memory)
    # The softer phase: the elastic strain of a mixture is at most that.
    elastic = state.stress / jnp.minimum(material.modulus_austenite, material.modulus_martensite)
    warming = jnp.max(jnp.abs(state.temperature - plant.environment.ambient))
    allowed = MAX_STRAIN_RATIO * material.max_transformation_strain + _ALLOWED_EXPANSION * warming
    strain_holds = jnp.all((strain <= jnp.maximum(elastic, 0.0) + allowed) & (strain >= -allowed))
    return jnp.all(state.temperature <= MELTING_TEMPERATURE), strain_holds


def status_with_limits(status: Int[Array, ""], strain_holds: Bool[Array, " samples"]) -> Int[Array, ""]:
    """Return the status of a simulation, ``overstrained`` in place of ``done`` if a strain exceeds its limit.

    Args:
        status: Status code of the simulation.
        strain_holds: Whether the strains are within the limit at each sample.
    """
    is_overstrained = (status == SimulationStatus.done) & ~jnp.all(strain_holds)
    return jnp.where(is_overstrained, SimulationStatus.overstrained, status)


def without_impossible_rows(
    channels: dict[str, Float[np.ndarray, " samples"]], possible: Bool[np.ndarray, " samples"]
) -> dict[str, Float[np.ndarray, " samples"]]:
    """Return channels with NaN from the first row on at which a state was impossible.

    Args:
        channels: Channels by name.
        possible: Whether the state is within the limits at each row.
    """
    rows = np.logical_and.accumulate(possible)
    return channels if np.all(rows) else {c: np.where(rows, v, np.nan) for c, v in channels.items()}
