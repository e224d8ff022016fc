"""smajax: differentiable models of shape-memory-alloy actuators, fitted, questioned and steered by their own gradients."""

__version__ = "0.1.0"
