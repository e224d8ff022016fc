"""Lagoudas' law in one dimension: thermodynamic driving forces with smooth hardening.

Martensite grows while the forward driving force reaches its threshold, and shrinks while the reverse one does. In one
dimension, calibrated to transformation temperatures and Clausius-Clapeyron slopes, the two conditions are

    forward   h(xi; n1, n2) = [ (1 - D) sigma H(sigma) + dS sigma^2 / 2 + ds (T - M_s) ] / ( ds (M_f - M_s) )
    reverse   h(xi; n3, n4) = [ (1 + D) sigma L        + dS sigma^2 / 2 + ds (T - A_f) ] / ( ds (A_s - A_f) )

with the hardening h (``smajax.plant.materials.hardening``), the difference dS of the compliances of the phases, and the
difference ds < 0 of their entropies per volume. Growing martensite has the transformation strain of the present stress,
d(eps_t) = H(sigma) d(xi); shrinking martensite loses its share of the strain, L = eps_t / xi. So the state consists of
the fraction and the transformation strain. It needs no memory of reversals, and partial loops stay inside the full one.

The state is stored as fractions: eps_t = H_sat xi_s defines the detwinned share. The thermal expansions of the phases
may differ in the strain; their difference is left out of the driving forces, where it is small compared with ds.

With the default values, exponents of 1, H_min = H_sat and a calibration at zero stress, this is the law with polynomial
hardening of boyd1996. A rig with ``model = "lagoudas"`` that gives only temperatures, slopes, moduli and the largest
strain has that law. hybrid_knee_ankle_orthosis uses it with mixed moduli, ``voigt_share = 1``.

The mixing rule of Young's modulus is a choice. Lagoudas mixes compliances (Reuss), E_R = 1 / (S_A + xi dS);
hybrid_knee_ankle_orthosis mixes moduli (Voigt), E_V = E_A + xi (E_M - E_A). Their weight is ``voigt_share`` w, E =
(1 - w) E_R + w E_V; w = 1/2 is Hill's mean. The elastic part of the free energy, -sigma^2 / (2 E(xi)), contributes
sigma^2 / 2 d(1/E)/d(xi) to the driving forces. With Reuss the derivative is dS. With Voigt it is (E_A - E_M) / E_V^2,
which would make the conditions implicit in xi, with several roots under large stresses. Its mean over a complete
transformation is dS for every w, since both ends have a single phase. This mean is used here: the strain depends on w,
the transformation lines do not. With w > 0, a loop with different stresses in both directions dissipates more or less
than the thresholds, by half the difference of the squared stresses times that of 1/E_R - 1/E at its ends. That is zero
for a complete transformation and small for a partial one.

The thresholds depend on the stress (D) so that the transformation lines have the slopes C_A and C_M. With C_A above C_M
the lines approach each other. Beyond the stress at which they meet (``crossing_stress``) a threshold is negative, which
the second law forbids: heating and cooling would transform at one temperature, without hysteresis.

Source: lagoudas2012; boyd1996 for the polynomial hardening.
"""

import math
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import clip, maximum, minimum
from smajax.parameters import parameter
from smajax.plant.materials.base import AbstractMaterial, Fractions, mix
from smajax.plant.materials.hardening import hardening, inverse_hardening

# A martensite fraction below this counts as 0: far above rounding (1e-16), far below any effect on a strain.
_NO_MARTENSITE = 1e-12
# Martensite fraction below which its detwinned share is irrelevant: its strain, 1e-6 of the largest, is below the
# resolution of any measurement.
_LITTLE_MARTENSITE = 1e-6
# Pa. Upper end of the search for the crossing stress: rig files take stresses up to 2e9 Pa.
_HIGHEST_STRESS = 1e10
# Value of the hardening that no fraction reaches; its inverse takes no iterations.
_OUT_OF_REACH = 2.0


# Standard deviation of linear hardening, whose rate over the progress is 1, over the width of the transformation.
LINEAR_DEVIATION = math.sqrt(1.0 / 12.0)
# As ``COSINE_TANGENT_FACTOR``, for linear hardening, with an error below 3e-3. Smaller exponents n1 to n4 are between.
LINEAR_TANGENT_FACTOR = (0.44744345, 1.12406075, -2.15164251, 0.96579463)


class Lagoudas(AbstractMaterial):
    """Lagoudas' law: smooth hardening, and a transformation strain that increases with the stress.

    The equations are in the text of the module, ``smajax.plant.materials.lagoudas``, those of the hardening in
    ``smajax.plant.materials.hardening``.

    Source: lagoudas2012; boyd1996 for the default values.
    """

    follows_surface = True
    band_deviation: ClassVar[float] = LINEAR_DEVIATION
    tangent_factor: ClassVar[tuple[float, ...]] = LINEAR_TANGENT_FACTOR
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

    def evolve(self, fractions: Fractions, temperature: tuple[Any, ...], stress: tuple[Any, ...]) -> Fractions:
        """Advance the fractions over a step, by the driving forces at its end.

        Args:
            fractions: Fractions at the start.
            temperature: Temperatures at start and end, degC.
            stress: Stresses at start and end, Pa.

        Returns:
            Fractions at the end.
        """
        (_, temperature_end), (before, after) = temperature, stress
        old = fractions.martensite
        nonzero_old = jnp.where(old > _NO_MARTENSITE, old, 1.0)
        strain_share = self.max_transformation_strain * fractions.detwinned / nonzero_old
        forward, reverse, slope = self._reached_hardening(temperature_end, after, strain_share)
        fixed_old = clip(jax.lax.stop_gradient(old), 0.0, 1.0)
        grows = forward > hardening(fixed_old, self.n1, self.n2)
        shrinks = (reverse < hardening(fixed_old, self.n3, self.n4)) & (old > _NO_MARTENSITE)
        # Where nothing transforms, a value out of reach saves the inverse its iterations.
        forward_fraction = inverse_hardening(jnp.where(grows | shrinks, forward, _OUT_OF_REACH), self.n1, self.n2)
        growth = jnp.where(grows, maximum(forward_fraction - old, 0.0), 0.0)
        strain = self.current_transformation_strain(0.5 * (before + after))
        detwinned_growth = strain * (1.0 / self.max_transformation_strain) * growth
        # If the reverse transformation would cross the forward line, the martensite that it consumes grows again at
        # once, under this stress: the strain per martensite rises until both conditions hold, or to its limit under the
        # stress.
        grown = old + growth
        nonzero_grown = jnp.where(grown > _NO_MARTENSITE, grown, 1.0)
        equilibrium = jnp.where(grows, grown, minimum(forward_fraction, old))
        grown_share = self.max_transformation_strain * (fractions.detwinned + detwinned_growth) / nonzero_grown
        reverse = reverse + slope * (grown_share - strain_share)
        deficit = hardening(equilibrium, self.n3, self.n4) - reverse
        retransforms = shrinks & (deficit > 0.0)
        raised_share = clip(
            grown_share + deficit / jnp.where(slope > 0.0, slope, 1.0), grown_share, maximum(grown_share, strain)
        ) * (1.0 / self.max_transformation_strain)
        reverse_share = jnp.where(shrinks & ~retransforms, reverse, _OUT_OF_REACH)
        reverse_fraction = minimum(inverse_hardening(reverse_share, self.n3, self.n4), grown)
        remaining_share = jnp.where(shrinks, reverse_fraction / nonzero_grown, 1.0)
        detwinned = (fractions.detwinned + detwinned_growth) * remaining_share
        twinned = (fractions.twinned + growth - detwinned_growth) * remaining_share
        return Fractions(
            jnp.where(retransforms, raised_share * equilibrium, detwinned),
            jnp.where(retransforms, (1.0 - raised_share) * equilibrium, twinned),
        )

    def equilibrium_increment(
        self, fractions: Fractions, temperature: Float[Array, "..."], stress: Float[Array, "..."]
    ) -> Fractions:
        """Compute the difference between the fractions of the law and present fractions, for kinetics with a rate.

        It is continuous in all arguments. Stress raises the forward line, of martensite that grows detwinned, more than
        the reverse line of martensite that is partly twinned. Between the two, martensite grows and shrinks at the same
        time, until enough of it is detwinned.

        Args:
            fractions: The present fractions.
            temperature: Temperature, degC.
            stress: Stress, Pa.

        Returns:
            The differences of both fractions.
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

        ``strain_share`` is L, the transformation strain per martensite fraction.
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

        H_cur = H_min + (H_sat - H_min) (1 - exp(-k (sigma - sigma_crit))), and H_min below sigma_crit.

        Source: lagoudas2012.
        """
        above = maximum(stress - self.critical_stress, 0.0)
        return self.max_transformation_strain * (
            1.0 - (1.0 - self.min_strain_share) * jnp.exp(-self.strain_saturation * above)
        )

    def crossing_stress(self) -> float:
        """Compute the stress above which part of the transformation has no hysteresis.

        The temperatures at which a fraction of detwinned martensite grows and shrinks differ by their difference at
        zero stress plus 2 D sigma H(sigma) / (-ds), which is negative with C_A above C_M.

        Returns:
            Stress in Pa, or infinity.
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
        from scipy.optimize import root_scalar  # slow to import, and seldom needed

        return float(root_scalar(excess_work, bracket=(0.0, _HIGHEST_STRESS)).root)

    def calibration(self) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """Compute the constants ds and D from the Clausius-Clapeyron slopes at the calibration stress.

            ds = -2 C_A C_M / (C_A + C_M) W        D = (C_M - C_A) / (C_M + C_A) W / (H + sigma H')

        with W = H + sigma H' + sigma dS, and H = H_cur(sigma).

        Returns:
            The entropy difference ds per volume in Pa/K, negative, and the share D by which the thresholds depend on
            the stress.

        Source: lagoudas2012.
        """
        sigma, c_a, c_m = self.calibration_stress, self.clausius_clapeyron_austenite, self.clausius_clapeyron_martensite
        strain, slope = jax.jvp(self.current_transformation_strain, (sigma,), (jnp.ones_like(sigma),))
        strain_work = strain + sigma * slope
        work = strain_work + sigma * self._compliance_difference
        return -2.0 * c_m * c_a / (c_m + c_a) * work, (c_m - c_a) / (c_m + c_a) * work / strain_work

    @property
    def _compliance_difference(self) -> jax.Array:
        return 1.0 / self.modulus_martensite - 1.0 / self.modulus_austenite

    def modulus(self, fractions: Fractions) -> Float[Array, "..."]:
        """Compute Young's modulus in Pa: (1 - w) E_R + w E_V, with mixed compliances (Reuss) and moduli (Voigt)."""
        reuss = 1.0 / mix(fractions.martensite, 1.0 / self.modulus_austenite, 1.0 / self.modulus_martensite)
        voigt = mix(fractions.martensite, self.modulus_austenite, self.modulus_martensite)
        return reuss + self.voigt_share * (voigt - reuss)
