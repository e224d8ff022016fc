"""Lagoudas' law in one dimension: thermodynamic driving forces with smooth hardening.

Martensite grows while the forward driving force meets its threshold and shrinks while the reverse one does (Lagoudas, Hartl, Chemisky,
Machado, Popov 2012). In one dimension, calibrated to transformation temperatures and slopes, the two conditions are

    forward   h(xi; n1, n2) = [ (1 - D) sigma H(sigma) + dS sigma^2 / 2 + ds (T - M_s) ] / ( ds (M_f - M_s) )
    reverse   h(xi; n3, n4) = [ (1 + D) sigma L        + dS sigma^2 / 2 + ds (T - A_f) ] / ( ds (A_s - A_f) )

with the hardening h of ``hardening.py``, the difference of the phases' compliances dS, and of their entropies per volume ds < 0. Whatever
grows brings the strain that its stress makes, d(eps_t) = H(sigma) d(xi), and what shrinks takes its share along, L = eps_t / xi. So the
state is the fraction and the transformation strain; it needs no memory of reversals, and partial loops stay inside the full one.

The state is kept as fractions: eps_t = H_sat xi_s defines the detwinned share. The expansions of the phases may differ in the strain; in
the driving forces their difference, small beside the entropy's part, is left out.

The older law is the one that the defaults give: exponents of 1, H_min = H_sat and a calibration at no stress, which leave the polynomial
hardening of Boyd and Lagoudas (1996). So a rig with ``model = "lagoudas"`` that gives temperatures, slopes, moduli and the largest strain
alone has it. The knee-ankle paper takes this law and mixes the moduli: that is ``voigt_share = 1``.

How the phases share the modulus is a choice. Lagoudas mixes compliances (Reuss), E_R = 1 / (S_A + xi dS); the paper mixes moduli (Voigt),
E_V = E_A + xi (E_M - E_A); ``voigt_share`` w weighs them, E = (1 - w) E_R + w E_V, a half being Hill's mean. The free energy's elastic
part, -sigma^2 / (2 E(xi)), puts sigma^2 / 2 times d(1/E)/d(xi) into the driving forces. With Reuss that is dS; with Voigt it is
(E_A - E_M) / E_V^2, which makes the conditions implicit in xi and, under large stresses, of more than one root. Its mean over a whole
transformation is dS for every w, since at the ends there is one phase alone, and this mean is what is taken here: strains follow the
choice, the lines of transformation do not. With w > 0 a loop that transforms forward under one stress and back under another one
dissipates more or less than the thresholds say by half the difference of the squared stresses times that of 1/E_R - 1/E at its ends:
nothing for a whole transformation, little for a partial one.

The thresholds follow the stress so that the lines of transformation have the slopes C_A and C_M. With C_A above C_M the lines approach each
other, and beyond the stress at which they meet (``crossing``) a threshold is negative, which the second law forbids: heating and cooling
would transform at one temperature, without hysteresis.
"""

import math

import jax
import jax.numpy as jnp
from scipy.optimize import root_scalar

from smajax.kinks import larger, smaller, within
from smajax.parameters import parameter
from smajax.plant.material.base import AbstractMaterial, Fractions, mix
from smajax.plant.material.hardening import hardened, hardening

_NONE = 1e-12  # a fraction that is none
_FEW = 1e-6  # one of which it does not matter how much of it is detwinned
_HIGHEST = 1e10  # Pa, above which no stress is of interest


class Lagoudas(AbstractMaterial):
    """Lagoudas' law with smooth hardening and a transformation strain that grows with the stress (see the module's text)."""

    min_strain_share: jax.Array = parameter("1", "share of the largest strain that low stress makes, H_min / H_sat", 0.0, 1.0, 1.0)
    strain_saturation: jax.Array = parameter("1/Pa", "how fast transformation strain saturates with stress, k", 0.0, 1e-5, 1e-8)
    critical_stress: jax.Array = parameter("Pa", "stress above which transformation strain grows", 0.0, 1e9, 0.0)
    calibration_stress: jax.Array = parameter("Pa", "stress at which C_A and C_M are the slopes of the transformation lines", 0.0, 2e9, 0.0)
    n1: jax.Array = parameter("1", "exponent of hardening at the forward start", 0.01, 1.0, 1.0)
    n2: jax.Array = parameter("1", "exponent of hardening at the forward finish", 0.01, 1.0, 1.0)
    n3: jax.Array = parameter("1", "exponent of hardening at the reverse finish", 0.01, 1.0, 1.0)
    n4: jax.Array = parameter("1", "exponent of hardening at the reverse start", 0.01, 1.0, 1.0)
    voigt_share: jax.Array = parameter("1", "share of the mixture of moduli in Young's modulus, beside that of compliances", 0.0, 1.0, 0.0)

    def evolve(self, fractions: Fractions, temperature: tuple, stress: tuple) -> Fractions:
        """See ``AbstractMaterial.evolve``: as far as the driving force at the end reaches, forward or reverse."""
        (_, hot), (before, after) = temperature, stress
        old = fractions.martensite
        some = jnp.where(old > _NONE, old, 1.0)
        taken = self.max_strain * fractions.detwinned / some
        forward, reverse, slope = self._shares(hot, after, taken)
        known = within(jax.lax.stop_gradient(old), 0.0, 1.0)
        grows = forward > hardening(known, self.n1, self.n2)
        shrinks = (reverse < hardening(known, self.n3, self.n4)) & (old > _NONE)
        # Where nothing transforms, a share out of reach spares the inverse its work.
        reached = hardened(jnp.where(grows | shrinks, forward, 2.0), self.n1, self.n2)
        grown = jnp.where(grows, larger(reached - old, 0.0), 0.0)
        strain = self.grown_strain(0.5 * (before + after))
        brought = strain * (1.0 / self.max_strain) * grown
        # Where the reverse transformation would go on past the forward line, what it takes grows again at once, under this stress: the
        # transformation strain rises until the two are at rest beside each other, or it is all that the stress can make.
        now = old + grown
        whole = jnp.where(now > _NONE, now, 1.0)
        between = jnp.where(grows, now, smaller(reached, old))
        held = self.max_strain * (fractions.detwinned + brought) / whole
        reverse = reverse + slope * (held - taken)
        lacking = hardening(between, self.n3, self.n4) - reverse
        again = shrinks & (lacking > 0.0)
        risen = within(held + lacking / jnp.where(slope > 0.0, slope, 1.0), held, larger(held, strain)) * (1.0 / self.max_strain)
        left = smaller(hardened(jnp.where(shrinks & ~again, reverse, 2.0), self.n3, self.n4), now)
        kept = jnp.where(shrinks, left / whole, 1.0)
        detwinned = jnp.where(again, risen * between, (fractions.detwinned + brought) * kept)
        return Fractions(detwinned, jnp.where(again, (1.0 - risen) * between, (fractions.twinned + grown - brought) * kept))

    def due(self, fractions: Fractions, temperature: jax.Array, stress: jax.Array) -> Fractions:
        """The change that brings fractions to the law at a temperature and a stress: what kinetics of their own go after.

        Continuous in all three. A stress raises the forward line, of martensite that grows detwinned, more than the reverse one of what is
        partly twinned. Past both, some of it grows while some shrinks, until what there is is detwinned enough.
        """
        old = fractions.martensite
        some = larger(old, _FEW)
        forward, reverse, _ = self._shares(temperature, stress, self.max_strain * fractions.detwinned / some)
        grown = larger(hardened(forward, self.n1, self.n2) - old, 0.0)
        brought = self.grown_strain(stress) * (1.0 / self.max_strain) * grown
        lost = larger(old - hardened(reverse, self.n3, self.n4), 0.0) / some
        return Fractions(brought - lost * fractions.detwinned, grown - brought - lost * fractions.twinned)

    def _shares(self, temperature: jax.Array, stress: jax.Array, taken: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """What the driving forces, forward and reverse, reach of the hardening, and how the latter goes with ``taken``.

        ``taken`` is the strain that vanishing martensite takes along.
        """
        entropy, gap = self._calibrated()
        elastic = 0.5 * self._compliance_difference * stress**2
        forward = (1.0 - gap) * stress * self.grown_strain(stress) + elastic + entropy * (temperature - self.forward_start)
        reverse = (1.0 + gap) * stress * taken + elastic + entropy * (temperature - self.austenite_finish - self.austenite_shift)
        forward = forward * (1.0 / (entropy * (self.martensite_finish - self.martensite_start)))
        reached = 1.0 / (entropy * (self.austenite_start - self.austenite_finish))
        return forward, reverse * reached, (1.0 + gap) * stress * reached

    def grown_strain(self, stress: jax.Array) -> jax.Array:
        """Transformation strain of martensite that grows under a stress, H_cur."""
        above = larger(stress - self.critical_stress, 0.0)
        return self.max_strain * (1.0 - (1.0 - self.min_strain_share) * jnp.exp(-self.strain_saturation * above))

    def crossing(self) -> float:
        """Stress (Pa) above which some of the transformation dissipates nothing; infinite where there is none.

        The temperatures at which a fraction of detwinned martensite grows and shrinks lie as far apart as at no stress, and by
        2 D sigma H(sigma) / (-ds) beside, which with C_A above C_M is negative.
        """
        entropy, share = map(float, self._calibrated())
        if share >= 0.0:
            return math.inf
        fraction = jnp.linspace(0.0, 1.0, 1001)
        grows = (self.martensite_finish - self.martensite_start) * hardening(fraction, self.n1, self.n2) + self.forward_start
        shrinks = (self.austenite_start - self.austenite_finish) * hardening(fraction, self.n3, self.n4) + self.austenite_finish
        work = float(jnp.min(shrinks + self.austenite_shift - grows)) * entropy / (2.0 * share)

        def over(stress: float) -> float:
            return stress * float(self.grown_strain(jnp.asarray(stress))) - work

        return math.inf if over(_HIGHEST) < 0.0 else float(root_scalar(over, bracket=(0.0, _HIGHEST)).root) if work > 0.0 else 0.0

    def _calibrated(self) -> tuple[jax.Array, jax.Array]:
        """Entropy difference per volume (Pa/K, negative) and the share D by which the threshold follows the stress."""
        at, warm, cold = self.calibration_stress, self.clausius_clapeyron_austenite, self.clausius_clapeyron_martensite
        strain, slope = jax.jvp(self.grown_strain, (at,), (jnp.ones_like(at),))
        work = strain + at * slope
        whole = work + at * self._compliance_difference
        return -2.0 * cold * warm / (cold + warm) * whole, (cold - warm) / (cold + warm) * whole / work

    @property
    def _compliance_difference(self) -> jax.Array:
        return 1.0 / self.modulus_martensite - 1.0 / self.modulus_austenite

    def modulus(self, fractions: Fractions) -> jax.Array:
        """Young's modulus between Reuss' (its reciprocal linear in the martensite fraction) and Voigt's (itself linear), Pa."""
        soft = 1.0 / mix(fractions.martensite, 1.0 / self.modulus_austenite, 1.0 / self.modulus_martensite)
        stiff = mix(fractions.martensite, self.modulus_austenite, self.modulus_martensite)
        return soft + self.voigt_share * (stiff - soft)
