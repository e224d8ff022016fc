"""Black boxes: input-output laws that know nothing of the wire."""

from smajax import precision  # noqa: F401
