"""smajax: differentiable models of shape-memory-alloy actuators for estimation, diagnosis and control."""

__version__ = "0.2.0"
