"""Status codes of a simulation."""

import enum

# degC. Nickel-titanium melts at about 1310 degC: beyond it no equation of the plant holds.
MELTING_TEMPERATURE = 1300.0
# Largest strain beyond the elastic one, as a multiple of the largest transformation strain: that strain itself, and as
# much again for what effects add to it.
MAX_STRAIN_RATIO = 2.0


class SimulationStatus(enum.IntEnum):
    """How a simulation ended; ``hint`` says what to do about it."""

    done = 0
    unsolved = 1
    diverged = 2
    overheated = 3
    overstrained = 4

    @property
    def hint(self) -> str:
        """The meaning and the cure, in one sentence."""
        return {
            SimulationStatus.done: "done",
            SimulationStatus.unsolved: "the balance of heat and forces of a step was not solved: make the step "
            "smaller, or check stiffness and stress",
            SimulationStatus.diverged: "the state became NaN or infinite: h(T) is negative somewhere, or an input or a "
            "parameter is out of scale",
            SimulationStatus.overheated: f"the wire exceeded {MELTING_TEMPERATURE:.0f} degC, where it melts: check the "
            "input's unit, the wire's diameter and h(T)",
            SimulationStatus.overstrained: "a strain exceeded the elastic strain by more than "
            f"{MAX_STRAIN_RATIO:.0f} times material.max_transformation_strain, which no wire has: check that strain, "
            "the thermal expansions and the effects that add strain, and bound them in fit.bounds",
        }[self]
