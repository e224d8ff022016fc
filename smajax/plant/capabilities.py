"""The words for what a rig can have and show, which effects may need (``AbstractEffect.needs``)."""

from smajax.channels import CHANNELS
from smajax.plant.drive import DRIVES

# Names of the channels of a rig with one wire or two.
CHANNEL_NAMES: tuple[str, ...] = tuple(
    f"{channel}{end}" for channel in CHANNELS if channel != "time" for end in ("", "_1", "_2")
)

RIG_CAPABILITIES: tuple[str, ...] = (
    "clock",  # the recordings have a time column
    "one wire",
    "two wires",
    "spring",  # the mechanism has one
    "drag",  # a stress can oppose the contraction (MechanismEffect.drag)
    "prescribed strain or stress",
    "prescribed temperature",
)

# All words that ``Plant.capabilities`` can return: those above, the electrical input, the coordinate of the mechanism,
# and each channel that the recordings contain, as in "temperature observed" or, for two wires, "current_2 observed".
CAPABILITIES: tuple[str, ...] = (
    *RIG_CAPABILITIES,
    *dict.fromkeys([*DRIVES, *(channel for channel in CHANNELS if channel != "time")]),
    *(f"{channel} observed" for channel in CHANNEL_NAMES),
)
