"""The words for what a rig can have and show, which effects may need (``AbstractEffect.needs``)."""

from smajax.channels import CHANNELS
from smajax.plant.drive import DRIVES

_WIRES = (1, 2)

RIG_CAPABILITIES: tuple[str, ...] = (
    "clock",  # the recordings have a time column
    "one wire",
    "two wires",
    "spring",  # the mechanism has one
    "drag",  # a stress can oppose the contraction (MechanismEffect.drag)
    "prescribed strain or stress",
)

# All words that ``Plant.capabilities`` can return: those above, the electrical input, the coordinate of the mechanism,
# and each channel that the recordings contain, as in "temperature observed" or, for two wires, "current_2 observed".
CAPABILITIES: tuple[str, ...] = tuple(
    dict.fromkeys(
        [
            *RIG_CAPABILITIES,
            *DRIVES,
            *(channel for channel in CHANNELS if channel != "time"),
            *(f"{channel}{end} observed" for channel in CHANNELS for end in ("", *(f"_{i}" for i in _WIRES))),
        ]
    )
)
