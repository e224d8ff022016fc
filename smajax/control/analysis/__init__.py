"""Analysis of closed loops: step responses, margins, instability of rollouts, and the range that a rig reaches.

``step_response`` and ``instability`` read arrays of a rollout; ``margins`` linearises a loop along one; ``members``
simulates a loop around several plants at once; ``reachable_range`` asks what a rig reaches whatever controls it;
``closed_loop_checks`` puts these together for one set of gains, and for samples of uncertain parameters.
"""
