"""Lagoudas' law in one dimension: thermodynamic driving forces with smooth hardening.

Martensite grows while the forward driving force reaches its threshold and shrinks while the reverse one does. In one
dimension, calibrated to transformation temperatures and Clausius-Clapeyron slopes, the two conditions are

    forward   h(xi; n1, n2) = [ (1 - D) sigma H(sigma) + dS sigma^2 / 2 + ds (T - M_s) ] / ( ds (M_f - M_s) )
    reverse   h(xi; n3, n4) = [ (1 + D) sigma L        + dS sigma^2 / 2 + ds (T - A_f) ] / ( ds (A_s - A_f) )

with the hardening h of ``hardening.py``, the difference dS of the phases' compliances, and ds < 0 of their entropies
per volume. Martensite that grows brings the strain of its stress, d(eps_t) = H(sigma) d(xi), and martensite that
shrinks takes its share along, L = eps_t / xi. So the state is the fraction and the transformation strain; it needs no
memory of reversals, and partial loops stay inside the full one.

The state is stored as fractions: eps_t = H_sat xi_s defines the detwinned share. The expansions of the phases may
differ in the strain; in the driving forces their difference, small next to the entropy's part, is left out.

With the default values this is the older law: exponents of 1, H_min = H_sat and a calibration at zero stress make the
polynomial hardening of boyd1996. So a rig with ``model = "lagoudas"`` that gives temperatures, slopes, moduli and the
largest strain alone has that law. hybrid_knee_ankle_orthosis takes it and mixes the moduli, which is ``voigt_share =
1``.

How the phases share the modulus is a choice. Lagoudas mixes compliances (Reuss), E_R = 1 / (S_A + xi dS);
hybrid_knee_ankle_orthosis mixes moduli (Voigt), E_V = E_A + xi (E_M - E_A); ``voigt_share`` w weighs them, E = (1 - w)
E_R + w E_V, a half being Hill's mean. The free energy's elastic part, -sigma^2 / (2 E(xi)), puts sigma^2 / 2 times
d(1/E)/d(xi) into the driving forces. With Reuss that is dS; with Voigt it is (E_A - E_M) / E_V^2, which makes the
conditions implicit in xi and, under large stresses, of more than one root. Its mean over a whole transformation is dS
for every w, since at the ends there is one phase alone, and this mean is used here: strains follow the choice, the
transformation lines do not. With w > 0 a loop that transforms forward under one stress and back under another one
dissipates more or less than the thresholds say, by half the difference of the squared stresses times that of 1/E_R -
1/E at its ends: nothing for a whole transformation, little for a partial one.

The thresholds depend on the stress so that the transformation lines have the slopes C_A and C_M. With C_A above C_M the
lines approach each other, and beyond the stress at which they meet (``crossing_stress``) a threshold is negative, which
the second law forbids: heating and cooling would transform at one temperature, without hysteresis.

Source: lagoudas2012; boyd1996 for the polynomial hardening.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from scipy.optimize import root_scalar

from smajax.numerics.nonsmooth import clip, maximum, minimum
from smajax.parameters import parameter
from smajax.plant.materials.base import AbstractMaterial, Fractions, mix
from smajax.plant.materials.hardening import hardening, inverse_hardening

# A martensite fraction below this counts as none: far above rounding (1e-16), far below what a strain shows.
_NO_MARTENSITE = 1e-12
# A martensite fraction below which its detwinned share does not matter: its strain, 1e-6 of the largest, is below any
# measurement.
_LITTLE_MARTENSITE = 1e-6
# Pa. No stress above this is of interest: rig files take stresses up to 2e9 Pa.
_HIGHEST_STRESS = 1e10
# Value of the hardening that no fraction reaches; its inverse takes no iterations.
_OUT_OF_REACH = 2.0


class Lagoudas(AbstractMaterial):
    """Lagoudas' law: smooth hardening, a transformation strain that grows with the stress (see the module's text)."""

    min_strain_share: jax.Array = parameter(
        "1", "share of the largest strain that low stress makes, H_min / H_sat", 0.0, 1.0, 1.0
    )
    strain_saturation: jax.Array = parameter(
        "1/Pa", "how fast transformation strain saturates with stress, k", 0.0, 1e-5, 1e-8
    )
    critical_stress: jax.Array = parameter("Pa", "stress above which transformation strain grows", 0.0, 1e9, 0.0)
    calibration_stress: jax.Array = parameter(
        "Pa", "stress at which C_A and C_M are the slopes of the transformation lines", 0.0, 2e9, 0.0
    )
    n1: jax.Array = parameter("1", "exponent of hardening at the forward start", 0.01, 1.0, 1.0)
    n2: jax.Array = parameter("1", "exponent of hardening at the forward finish", 0.01, 1.0, 1.0)
    n3: jax.Array = parameter("1", "exponent of hardening at the reverse finish", 0.01, 1.0, 1.0)
    n4: jax.Array = parameter("1", "exponent of hardening at the reverse start", 0.01, 1.0, 1.0)
    voigt_share: jax.Array = parameter(
        "1", "share of the mixture of moduli in Young's modulus; the rest mixes compliances", 0.0, 1.0, 0.0
    )

    def evolve(self, fractions: Fractions, temperature: tuple, stress: tuple) -> Fractions:
        """Advance the fractions over a step, to where the driving forces at its end lead, forward or reverse.

        Args:
            fractions: Fractions at the start.
            temperature: Temperatures in degC at start and end.
            stress: Stresses in Pa at start and end.
        """
        (_, hot), (before, after) = temperature, stress
        old = fractions.martensite
        nonzero_old = jnp.where(old > _NO_MARTENSITE, old, 1.0)
        strain_share = self.max_transformation_strain * fractions.detwinned / nonzero_old
        forward, reverse, slope = self._reached_hardening(hot, after, strain_share)
        fixed_old = clip(jax.lax.stop_gradient(old), 0.0, 1.0)
        grows = forward > hardening(fixed_old, self.n1, self.n2)
        shrinks = (reverse < hardening(fixed_old, self.n3, self.n4)) & (old > _NO_MARTENSITE)
        # Where nothing transforms, a value out of reach saves the inverse its iterations.
        forward_fraction = inverse_hardening(jnp.where(grows | shrinks, forward, _OUT_OF_REACH), self.n1, self.n2)
        growth = jnp.where(grows, maximum(forward_fraction - old, 0.0), 0.0)
        strain = self.current_transformation_strain(0.5 * (before + after))
        detwinned_growth = strain * (1.0 / self.max_transformation_strain) * growth
        # Where the reverse transformation would pass the forward line, the martensite that it consumes grows again at
        # once, under this stress: the strain per martensite rises until both lines hold it in equilibrium, or is all
        # that the stress can make.
        grown = old + growth
        nonzero_grown = jnp.where(grown > _NO_MARTENSITE, grown, 1.0)
        equilibrium = jnp.where(grows, grown, minimum(forward_fraction, old))
        grown_share = self.max_transformation_strain * (fractions.detwinned + detwinned_growth) / nonzero_grown
        reverse = reverse + slope * (grown_share - strain_share)
        missing = hardening(equilibrium, self.n3, self.n4) - reverse
        regrows = shrinks & (missing > 0.0)
        risen_share = clip(
            grown_share + missing / jnp.where(slope > 0.0, slope, 1.0), grown_share, maximum(grown_share, strain)
        ) * (1.0 / self.max_transformation_strain)
        reverse_share = jnp.where(shrinks & ~regrows, reverse, _OUT_OF_REACH)
        reverse_fraction = minimum(inverse_hardening(reverse_share, self.n3, self.n4), grown)
        remaining_share = jnp.where(shrinks, reverse_fraction / nonzero_grown, 1.0)
        detwinned = (fractions.detwinned + detwinned_growth) * remaining_share
        twinned = (fractions.twinned + growth - detwinned_growth) * remaining_share
        return Fractions(
            jnp.where(regrows, risen_share * equilibrium, detwinned),
            jnp.where(regrows, (1.0 - risen_share) * equilibrium, twinned),
        )

    def equilibrium_increment(
        self, fractions: Fractions, temperature: Float[Array, "..."], stress: Float[Array, "..."]
    ) -> Fractions:
        """Compute the change that brings fractions to the law at a temperature and a stress, for kinetics with a rate.

        Continuous in all arguments. A stress raises the forward line, of martensite that grows detwinned, more than the
        reverse one of martensite that is partly twinned. Past both lines, some of it grows while some shrinks, until it
        is detwinned enough.

        Args:
            fractions: The fractions.
            temperature: Temperature in degC.
            stress: Stress in Pa.

        Returns:
            The changes of both fractions.
        """
        old = fractions.martensite
        nonzero_old = maximum(old, _LITTLE_MARTENSITE)
        strain_share = self.max_transformation_strain * fractions.detwinned / nonzero_old
        forward, reverse, _ = self._reached_hardening(temperature, stress, strain_share)
        growth = maximum(inverse_hardening(forward, self.n1, self.n2) - old, 0.0)
        detwinned_growth = self.current_transformation_strain(stress) * (1.0 / self.max_transformation_strain) * growth
        loss = maximum(old - inverse_hardening(reverse, self.n3, self.n4), 0.0) / nonzero_old
        return Fractions(
            detwinned_growth - loss * fractions.detwinned, growth - detwinned_growth - loss * fractions.twinned
        )

    def _reached_hardening(
        self, temperature: jax.Array, stress: jax.Array, strain_share: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        """The right-hand sides of the forward and the reverse condition, and the derivative of the latter by L.

        ``strain_share`` is L, the transformation strain per martensite fraction that vanishing martensite takes along.
        """
        entropy, threshold_share = self.calibration()
        elastic = 0.5 * self._compliance_difference * stress**2
        forward = (
            (1.0 - threshold_share) * stress * self.current_transformation_strain(stress)
            + elastic
            + entropy * (temperature - self.forward_start)
        )
        reverse = (
            (1.0 + threshold_share) * stress * strain_share
            + elastic
            + entropy * (temperature - self.austenite_finish - self.austenite_shift)
        )
        forward = forward * (1.0 / (entropy * (self.martensite_finish - self.martensite_start)))
        reverse_factor = 1.0 / (entropy * (self.austenite_start - self.austenite_finish))
        return forward, reverse * reverse_factor, (1.0 + threshold_share) * stress * reverse_factor

    def current_transformation_strain(self, stress: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the transformation strain of martensite that grows under a stress, H_cur.

        H_cur = H_min + (H_sat - H_min) (1 - exp(-k (sigma - sigma_crit))), H_min below sigma_crit. Source:
        lagoudas2012.
        """
        above = maximum(stress - self.critical_stress, 0.0)
        return self.max_transformation_strain * (
            1.0 - (1.0 - self.min_strain_share) * jnp.exp(-self.strain_saturation * above)
        )

    def crossing_stress(self) -> float:
        """Compute the stress in Pa above which part of the transformation dissipates nothing, or infinity.

        The temperatures at which a fraction of detwinned martensite grows and shrinks differ as at zero stress, plus
        2 D sigma H(sigma) / (-ds), which is negative with C_A above C_M.
        """
        entropy, threshold_share = map(float, self.calibration())
        if threshold_share >= 0.0:
            return math.inf
        fraction = jnp.linspace(0.0, 1.0, 1001)
        forward_width = self.martensite_finish - self.martensite_start
        reverse_width = self.austenite_start - self.austenite_finish
        grows = forward_width * hardening(fraction, self.n1, self.n2) + self.forward_start
        shrinks = reverse_width * hardening(fraction, self.n3, self.n4) + self.austenite_finish
        work = float(jnp.min(shrinks + self.austenite_shift - grows)) * entropy / (2.0 * threshold_share)

        def excess_work(stress: float) -> float:
            return stress * float(self.current_transformation_strain(jnp.asarray(stress))) - work

        if excess_work(_HIGHEST_STRESS) < 0.0:
            return math.inf
        if work <= 0.0:
            return 0.0
        return float(root_scalar(excess_work, bracket=(0.0, _HIGHEST_STRESS)).root)

    def calibration(self) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """Compute what the Clausius-Clapeyron slopes at the calibration stress determine.

        Returns:
            The entropy difference ds per volume in Pa/K, negative, and the share D by which the thresholds depend on
            the stress.
        """
        at, warm, cold = self.calibration_stress, self.clausius_clapeyron_austenite, self.clausius_clapeyron_martensite
        strain, slope = jax.jvp(self.current_transformation_strain, (at,), (jnp.ones_like(at),))
        strain_work = strain + at * slope
        work = strain_work + at * self._compliance_difference
        return -2.0 * cold * warm / (cold + warm) * work, (cold - warm) / (cold + warm) * work / strain_work

    @property
    def _compliance_difference(self) -> jax.Array:
        return 1.0 / self.modulus_martensite - 1.0 / self.modulus_austenite

    def modulus(self, fractions: Fractions) -> Float[Array, "..."]:
        """Compute Young's modulus in Pa between Reuss' (compliances mixed) and Voigt's (moduli mixed)."""
        soft = 1.0 / mix(fractions.martensite, 1.0 / self.modulus_austenite, 1.0 / self.modulus_martensite)
        stiff = mix(fractions.martensite, self.modulus_austenite, self.modulus_martensite)
        return soft + self.voigt_share * (stiff - soft)
