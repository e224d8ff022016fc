"""Analysis of closed loops: step responses, margins, instability of rollouts, and the range that a rig reaches.

``step_response`` and ``instability`` evaluate arrays of a rollout; ``margins`` linearises a loop along a rollout;
``members`` simulates a loop around several plants at once; ``reachable_range`` computes the range of a channel that a
rig can reach with any controller; ``closed_loop_checks`` combines these for one set of gains, and for samples of
uncertain parameters.
"""
