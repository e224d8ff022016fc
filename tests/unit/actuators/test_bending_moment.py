"""Bending of a wire that yields, against adaptive quadrature over its fibres; and the cantilever that measures its work."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from smajax.actuators.bending_moment import BilinearStressStrain, cap_moment
from smajax.actuators.cantilever import Cantilever
from smajax.plant.materials.brinson import Brinson

LAW = {"modulus": 67e9, "tangent_modulus": 0.88e9, "yield_stress": 462e6}
# Diameter in um, moment in N mm at a curvature of 60 1/m, and the elastic share of it: computed by an independent script from eqs. 2 and 3.
TABLE = [
    (100, 0.0197, 1.0),
    (125, 0.0482, 1.0),
    (200, 0.316, 1.0),
    (250, 0.768, 0.905),
    (300, 1.528, 0.638),
    (375, 3.350, 0.400),
    (400, 4.168, 0.349),
    (500, 8.690, 0.219),
]


def stress(strain: float, modulus: float, tangent_modulus: float, yield_stress: float) -> float:
    beyond = max(abs(strain) - yield_stress / modulus, 0.0)
    return np.sign(strain) * (modulus * (abs(strain) - beyond) + tangent_modulus * beyond)


def by_fibres(diameter: float, curvature: float, law: dict[str, float]) -> tuple[float, float, float, float]:
    """Moment, its elastic and its plastic share, and the plastic work per length, summed fibre by fibre."""
    radius, limit = diameter / 2, law["yield_stress"] / law["modulus"]
    edge = min(limit / abs(curvature), radius)

    def integral(of, low: float, high: float) -> float:
        # The width of a chord in terms of the angle has no root at the surface.
        return quad(
            lambda a: of(radius * np.sin(a)) * 4 * (radius * np.cos(a)) ** 2,
            np.arcsin(low / radius),
            np.arcsin(high / radius),
            epsabs=0,
            epsrel=1e-13,
        )[0]

    def fibre(y: float) -> float:
        return stress(curvature * y, **law) * y

    def lost(y: float) -> float:
        strain = abs(curvature) * y
        loading = quad(lambda e: stress(e, **law), 0, strain, points=[limit], epsrel=1e-13)[0]
        return loading - stress(strain, **law) ** 2 / (2 * law["modulus"])

    elastic = integral(fibre, 0.0, edge)
    plastic, work = (integral(of, edge, radius) if edge < radius else 0.0 for of in (fibre, lost))
    return elastic + plastic, elastic, plastic, work


def test_moment_and_work_are_those_of_the_fibres():
    laws = [
        LAW,
        LAW | {"tangent_modulus": 0.0},
        LAW | {"modulus": 26.3e9, "tangent_modulus": 5e9, "yield_stress": 150e6},
    ]
    cases = [(d, k, law) for d, k, law in itertools.product((1e-4, 2.3e-4, 3e-4, 5e-4), (20.0, 60.0, -120.0), laws)]
    law = BilinearStressStrain(*(jnp.array([case[2][key] for case in cases]) for key in LAW))
    diameter, curvature = (jnp.array([case[i] for case in cases]) for i in (0, 1))
    expected = np.array([by_fibres(*case) for case in cases])
    computed = np.array([f(diameter, curvature) for f in (law.moment, law.elastic_moment, law.plastic_moment)]).T
    np.testing.assert_allclose(computed, expected[:, :3], rtol=1e-12, atol=1e-18)
    # The work of a wire that hardly yields is a small difference of large numbers in the sum over the fibres.
    np.testing.assert_allclose(law.plastic_work(diameter, curvature), expected[:, 3], rtol=1e-8, atol=1e-13)
    assert np.sum(expected[:, 2] == 0.0) > 5 and np.sum(expected[:, 2] > 0.0) > 5


def test_table_of_diameters():
    law = BilinearStressStrain(**LAW)
    for diameter, moment, share in TABLE:
        whole = float(law.moment(diameter * 1e-6, 60.0))
        assert whole * 1e3 == pytest.approx(moment, rel=2e-3)
        assert float(law.elastic_moment(diameter * 1e-6, 60.0)) / whole == pytest.approx(share, abs=1e-3)
    assert float(law.yield_diameter(60.0)) == pytest.approx(230e-6, rel=1e-3)


def test_limits():
    radius, curvature = 150e-6, 60.0
    hinge = 4 / 3 * LAW["yield_stress"] * radius**3
    # A plastic hinge: it yields at once, which is beyond the bounds of the modulus, and does not harden.
    rigid = eqx.tree_at(
        lambda law: (law.modulus, law.tangent_modulus),
        BilinearStressStrain(**LAW),
        (jnp.asarray(LAW["yield_stress"] / 6e-6), jnp.zeros(())),
    )
    assert float(rigid.moment(2 * radius, curvature)) == pytest.approx(hinge, rel=1e-6)
    straight = BilinearStressStrain(67e9, 67e9, 462e6)
    assert float(straight.moment(2 * radius, curvature)) == pytest.approx(
        np.pi / 4 * 67e9 * radius**4 * curvature, rel=1e-14
    )
    law = BilinearStressStrain(**LAW)
    onset = float(law.yield_diameter(curvature))
    near = [float(law.moment(onset * (1 + s), curvature)) / onset**4 / (1 + s) ** 4 for s in (-1e-9, 0.0, 1e-9)]
    assert max(near) / min(near) - 1 < 1e-12
    assert float(law.moment(2 * radius, 0.0)) == 0.0 and float(law.moment(2 * radius, -60.0)) == -float(
        law.moment(2 * radius, 60.0)
    )


def test_yield_of_a_superelastic_wire():
    """Brinson's wire at 60 degC, from its transformation stresses."""
    material = Brinson(
        martensite_start=18.4,
        martensite_finish=9.0,
        austenite_start=34.5,
        austenite_finish=49.0,
        clausius_clapeyron_austenite=13.8e6,
        clausius_clapeyron_martensite=8e6,
        modulus_austenite=67e9,
        modulus_martensite=26.3e9,
        max_transformation_strain=0.067,
        detwinning_start_stress=100e6,
        detwinning_finish_stress=170e6,
    )
    law = BilinearStressStrain.from_brinson(material, 60.0)
    assert float(law.yield_stress) == pytest.approx(432.8e6, rel=1e-12)
    assert float(law.tangent_modulus) == pytest.approx(879e6, rel=1e-3)
    assert float(law.yield_diameter(60.0)) == pytest.approx(215e-6, rel=3e-3)


def test_gradients_are_finite_everywhere_and_right():
    def figures(d, k, e, b, s):
        law = BilinearStressStrain(e, b, s)
        return jnp.stack([law.moment(d, k), law.elastic_moment(d, k), law.plastic_moment(d, k), law.plastic_work(d, k)])

    forward, reverse = jax.jit(jax.jacfwd(figures, argnums=range(5))), jax.jit(jax.jacrev(figures, argnums=range(5)))
    for diameter in (1e-4, float(BilinearStressStrain(**LAW).yield_diameter(60.0)), 2.5e-4, 4e-4):
        at = (diameter, 60.0, *LAW.values())
        slopes = np.array(forward(*at))
        assert np.all(np.isfinite(slopes))
        np.testing.assert_allclose(slopes, np.array(reverse(*at)), rtol=1e-12)
        for i, step in enumerate(1e-5 * np.array(at)):
            ends = [np.array(figures(*(x + s * step * (j == i) for j, x in enumerate(at)))) for s in (1, -1)]
            # At the edge of yield the slopes of the two shares are continuous, but not those of the slopes.
            components = [0, 3] if 2.2e-4 < diameter < 2.4e-4 else [0, 1, 2, 3]
            np.testing.assert_allclose(
                (slopes[i] * step)[components],
                ((ends[0] - ends[1]) / 2)[components],
                rtol=1e-6,
                atol=2e-14 if len(components) == 2 else 1e-17,
            )
    assert np.all(np.isfinite(forward(2e-4, 0.0, *LAW.values())))
    assert float(jax.grad(lambda u: cap_moment(2, u))(1.0)) == 0.0


def test_cantilever_and_its_published_work():
    """Deflections of tip and force, and Table 2 of dauksher2021; its beam length is not printed, and 0.296 m gives its rows."""
    bench = Cantilever(0.991e-3, 0.296, 0.1092)
    assert float(bench.rigidity) == pytest.approx(9.942e-3, rel=1e-4)
    tip = bench.tip_deflection(0.1)
    assert float(tip) == pytest.approx(15.568120e-3, rel=1e-6)
    assert 0.1 / float(bench.stiffness) == pytest.approx(4.365790e-3, rel=1e-6)
    assert float(bench.force(tip)) == pytest.approx(0.1, rel=1e-14)
    for place, deflection, printed, true in (
        (0.1092, 22e-3, 1.559e-3, 0.438e-3),
        (0.1575, 30e-3, 1.470e-3, 0.629e-3),
        (0.0889, 18e-3, 1.536e-3, 0.343e-3),
    ):
        bench = Cantilever(0.991e-3, 0.296, place)
        assert float(bench.work_as_printed(deflection)) == pytest.approx(printed, rel=0.01)
        assert float(bench.work(deflection)) == pytest.approx(true, rel=0.02)
        assert float(bench.work(deflection) / bench.work_as_printed(deflection)) == pytest.approx(
            2 * place / (3 * 0.296 - place), rel=1e-12
        )
