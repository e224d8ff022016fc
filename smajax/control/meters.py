"""What a rig hears of its wires: voltage, current and temperature as its meters tell them, with their noise, steps and delays.

A temperature is a thermocouple's, which follows its wire with a first-order lag: T_heard' = (T - T_heard) / lag. A power is heard with the
errors of voltage and current, P V_heard I_heard / (V I): their own product would not do where they are means over pulses.
"""

import itertools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.control.sensing import Sensing
from smajax.kinks import larger
from smajax.parameters import parameter
from smajax.units import channel_of


class Heard(NamedTuple):
    """By channel: the values on their way, and where the thermocouples are, degC; the sensor's latest draws, newest first."""

    waiting: dict[str, jax.Array]
    probes: dict[str, jax.Array]
    draws: jax.Array


class Meters(eqx.Module):
    """Meters by kind of channel, such as ``voltage``, ``current`` and ``temperature``, one for each wire; other channels are heard as they
    are. ``lag`` in s is the thermocouples'.

    A sample's draw is the noise of the first meter one sample later, of the second one two samples later, and so on: at each sample
    they are independent of each other and of the controller's own sensor.
    """

    each: dict[str, Sensing]
    period: float = eqx.field(static=True)
    lag: jax.Array = parameter("s", "time constant of the thermocouples", 0.0, default=0.0)

    def reset(self, seen: dict[str, jax.Array]) -> Heard:
        """At rest; ``seen`` are the plant's channels, scalars by name."""
        names = self._metered(seen)
        waiting = {n: sensing.reset(seen[n]) for n, sensing in names.items()}
        return Heard(waiting, {n: seen[n] for n in names if channel_of(n) == "temperature"}, jnp.zeros(len(names)))

    def step(self, state: Heard, seen: dict[str, jax.Array], draw: jax.Array) -> tuple[Heard, dict[str, jax.Array]]:
        """The state after a sample, and the channels as they are heard; ``draw`` is a standard normal number."""
        waiting, heard = {}, dict(seen)
        probes = {n: probed(shown, seen[n], self.lag, self.period) for n, shown in state.probes.items()}
        for (name, sensing), noise in zip(self._metered(seen).items(), state.draws, strict=True):
            waiting[name], heard[name] = sensing.step(state.waiting[name], probes.get(name, seen[name]), noise)
        if self.each.keys() & {"voltage", "current"}:
            for name in [n for n in seen if channel_of(n) == "power"]:
                pair = [f"{kind}{name.removeprefix('power')}" for kind in ("voltage", "current")]
                true = seen[pair[0]] * seen[pair[1]]
                flows = true > 0.0
                heard[name] = jnp.where(flows, seen[name] / jnp.where(flows, true, 1.0), 1.0) * heard[pair[0]] * heard[pair[1]]
        return Heard(waiting, probes, jnp.append(draw, state.draws)[: len(state.draws)]), heard

    def _metered(self, seen: dict[str, jax.Array]) -> dict[str, Sensing]:
        return {name: self.each[kind] for kind, name in itertools.product(sorted(self.each), seen) if channel_of(name) == kind}


def probed(shown: jax.Array, temperature: jax.Array, lag: jax.Array, period: float) -> jax.Array:
    """What a thermocouple with a time constant ``lag`` shows a period after ``shown``, its wire being at ``temperature`` by then."""
    return shown - jnp.expm1(-period / larger(lag, 1e-9)) * (temperature - shown)
