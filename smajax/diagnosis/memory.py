"""Memory of a diagnosis, which is known before it begins."""

from collections.abc import Sequence

from smajax.fitting.memory import added_states, free_memory, require_memory
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.simulation.inputs import count_steps
from smajax.simulation.padding import padded_length

# Bytes of Python, JAX, and compiling the two programs of one wire with all effects: the peak with 2,000
# rows of ``smajax diagnose`` in its own process, with an empty cache (experiments/fitting/fit_memory.py).
_PROGRAMS = 1_250_000_000
# Bytes for each step of the longest recording and wire: trajectories with the states of all effects, their tangents,
# two searches at a time, and the Jacobians of all candidates. Above the
# peak with 20,000 rows of one step each.
_PER_STEP = 16_000
# Bytes of a number of cells and grains in the trajectory of each of the two searches, with a copy of each.
_NUMBER = 4 * 8
_REMEDY = "cut the recordings into parts, or sample them more coarsely"


def diagnosis_memory(
    plant: Plant, recordings: Sequence[Recording], *, interpolation: str | None = None, step: float | None = None
) -> tuple[int, float]:
    """Compute the steps and the memory of a diagnosis; nothing is simulated.

    Args:
        plant: The plant.
        recordings: Recordings for training, selection and holdout, which are padded to one length.
        interpolation: Electrical inputs between samples: ``hold`` or ``linear``; that of the plant by default.
        step: Longest step in s; the plant's default if not given.

    Returns:
        The steps of a simulation of the longest recording, and the memory in bytes.
    """
    steps = max(count_steps(plant, r, interpolation=interpolation, step=step) for r in recordings)
    per_step = plant.mechanism.wires * _PER_STEP + _NUMBER * added_states(plant)
    return steps, float(_PROGRAMS + per_step * padded_length(steps))


def require_diagnosis_memory(
    plant: Plant, recordings: Sequence[Recording], *, interpolation: str | None = None, free: float | None = None
) -> None:
    """Refuse a diagnosis that does not fit into the free memory.

    Args:
        plant: The plant.
        recordings: Recordings for training, selection and holdout.
        interpolation: Electrical inputs between samples: ``hold`` or ``linear``; that of the plant by default.
        free: Memory in bytes that this process can have; ``free_memory()`` if not given.

    Raises:
        InputError: If it does not fit.
    """
    steps, size = diagnosis_memory(plant, recordings, interpolation=interpolation)
    longest = max(recordings, key=len).name
    require_memory(f"{longest}: this diagnosis", steps, size, free_memory() if free is None else free, _REMEDY)
