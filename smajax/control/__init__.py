"""Sampled controllers of SMA actuators: closed-loop rollouts, state estimation, analysis, tuning and export.

- ``controllers``: PID with anti-windup, BPID, PPID, adaptive PID, PID with hysteresis feedforward.
- ``sensors``, ``estimators``: sensor models, dropouts; thermal observer, extended and ensemble Kalman filters.
- ``sampled_plant``, ``pulse_width``: the plant from one sample to the next, and its pulse-width modulator.
- ``loop``: allocation to the wires, temperature limiter, the closed loop and its rollout.
- ``controller_file``: the reader of controller.toml.
- ``analysis``, ``tuning``: step response, margins, reachable range; the search for gains.
- ``export``: a controller as C header, JSON document or FMU.
"""
