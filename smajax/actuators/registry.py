"""The actuators by the ``kind`` of their files."""

from collections.abc import Mapping

from smajax.actuators.base import AbstractActuator
from smajax.actuators.flexural import FlexuralActuator
from smajax.actuators.knee import Knee
from smajax.actuators.soft_bending import SoftBending

ACTUATORS: Mapping[str, type[AbstractActuator]] = {
    "flexural": FlexuralActuator,
    "soft-bending": SoftBending,
    "knee": Knee,
}
