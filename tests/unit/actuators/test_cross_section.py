"""The cooling cross-section against series solutions, an independent finite-element program, and finite differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from smajax.actuators.cooling_curve import CoolingCurve
from smajax.actuators.cross_section import Cooling, CrossSection, Layer, SectionWire
from smajax.actuators.section_grid import EvenWires, SpacedWires, graded_widths
from smajax.actuators.wire_shares import circle_shares
from smajax.numerics.block_tridiagonal import FivePointMatrix, invert_positive_definite
from tests.reference import cross_section as reference

CELLS = 10
TAPE, SILICONE = (2430.0, 1000.0, 2.2), (1070.0, 1050.0, 0.2)


def section(
    diameter: float = 300e-6,
    placement=None,
    cells: int = CELLS,
    width: float = 22e-3,
    offset: float = 0.0,
    materials=(TAPE, SILICONE),
    **cooling: float,
) -> CrossSection:
    """The section of dauksher2021 (Table 1); ``materials`` are (density, heat capacity, conductivity) of tape, silicone and, if given, wire."""
    tape, silicone, *wire = materials
    return CrossSection(
        Layer(0.5e-3, *tape), Layer(0.6e-3, *silicone), SectionWire(diameter, *(wire[0] if wire else (6450.0, 837.4, 18.0)), offset),
        placement or EvenWires(2.0), Cooling(**cooling), width, cells,
    )  # fmt: skip


@eqx.filter_jit
def _cool(section: CrossSection, duration: jax.Array) -> tuple[CoolingCurve, jax.Array, jax.Array]:
    curve = section.cool(duration)
    return curve, curve.time_to_reach(55.0), curve.temperature_at(0.4 * duration)


def cool(section: CrossSection, duration: float = 5.0) -> tuple[CoolingCurve, float, float]:
    """The curve, the time at which it reaches 55 degC, and the temperature at 0.4 of the duration."""
    curve, cooled, later = _cool(section, jnp.asarray(duration))
    return curve, float(cooled), float(later)


def test_squares_hold_the_circle_and_gaps_are_filled():
    for cells in (8, 12):
        shares = circle_shares(cells)
        assert shares.area.sum() * 4 / cells**2 == pytest.approx(np.pi, rel=1e-14)
        assert np.all(shares.area >= 0.0) and np.all(shares.area <= 1.0)
        for half in (shares.left, shares.right, shares.lower, shares.upper):
            assert half.mean() == pytest.approx(np.pi / 4, rel=2e-3)
    for length in (5e-3, 3e-4, 5e-5):
        widths = np.array(graded_widths(jnp.asarray(25e-6), jnp.asarray(length), 12))
        assert widths.sum() == pytest.approx(length, rel=1e-14)
        ratio = widths[1:] / widths[:-1]
        assert np.ptp(ratio) < 1e-12 and widths[0] / 25e-6 == pytest.approx(ratio[0], rel=1e-12)
    slope = jax.grad(lambda length: graded_widths(jnp.asarray(25e-6), length, 12)[0])(jnp.asarray(5e-3))
    ends = [graded_widths(jnp.asarray(25e-6), jnp.asarray(5e-3 + s * 1e-6), 12)[0] for s in (1, -1)]
    assert float(slope) == pytest.approx(float(ends[0] - ends[1]) / 2e-6, rel=1e-6)


@pytest.mark.slow
def test_a_slab_cools_as_its_series_says():
    """One material, uniformly warm: a plane wall with convection on both sides. The error falls with the square of the cells' size."""
    h, k, density, heat, thickness = 300.0, 0.5, 1500.0, 1200.0, 1.6e-3
    alpha, biot = k / density / heat, h * thickness / 2 / k
    roots = [
        scipy.optimize.brentq(lambda z: z * np.sin(z) - biot * np.cos(z), n * np.pi + 1e-9, n * np.pi + np.pi / 2)
        for n in range(40)
    ]
    errors = []
    for cells in (6, 12):
        slab = section(
            materials=[(density, heat, k)] * 3, cells=cells, convection=h, wire_start=70.0, elastomer_start=70.0
        )
        curve, *_ = cool(slab, 4.0)
        heights = np.array(slab.grid()[1])
        level = np.cumsum(heights) - heights / 2 - thickness / 2
        worst = 0.0
        for time, field in zip(np.array(curve.stage_ends)[5:], np.array(curve.temperatures)[5:], strict=True):
            wall = sum(
                4
                * np.sin(z)
                / (2 * z + np.sin(2 * z))
                * np.exp(-(z**2) * alpha * time / (thickness / 2) ** 2)
                * np.cos(z * level / (thickness / 2))
                for z in roots
            )
            assert np.ptp(field, axis=0).max() < 1e-9  # nothing happens across the width
            worst = max(worst, np.max(np.abs(field[0] - 20.0 - 50.0 * wall)))
        errors.append(worst)
    assert errors[1] < 0.05 and errors[0] / errors[1] > 2.0**1.8


def test_a_hot_cylinder_spreads_as_gauss_says():
    """One material, a hot core, before the heat reaches a face: T(0, t) = T_0 + (T_1 - T_0) (1 - exp(-R^2 / (4 a t)))."""
    material, radius = (1500.0, 1200.0, 0.5), 150e-6
    alpha = material[2] / material[0] / material[1]
    errors = []
    for cells in (6, 12):
        curve, *_ = cool(section(materials=[material] * 3, cells=cells, convection=0.0), 0.25)
        time = np.array(curve.time)[12:]
        errors.append(
            np.max(np.abs(np.array(curve.hottest)[12:] - 50.0 - 30.0 * (1 - np.exp(-(radius**2) / 4 / alpha / time))))
        )
    assert errors[1] < 0.35 and errors[0] / errors[1] > 2.0**1.8


def test_heat_is_neither_made_nor_lost():
    for variant in (
        section(),
        section(convection=500.0, offset=1e-4),
        section(convection=0.0),
        section(placement=SpacedWires(3, 0.8e-3), width=6e-3, cells=6),
    ):
        curve, *_ = cool(variant)
        held = np.array(curve.stored + curve.lost)
        assert np.max(np.abs(held / held[0] - 1.0)) < 1e-11
        assert np.all(np.diff(curve.lost) >= 0.0) and (float(variant.cooling.convection) == 0.0) == (
            float(curve.lost[-1]) == 0.0
        )
        wire, pitch = np.pi / 4 * 9e-8, 22e-3 / 2
        if isinstance(variant.placement, EvenWires):
            whole = wire * 6450 * 837.4 * 60 + ((pitch * 0.6e-3 - wire) * 1070 * 1050 + pitch * 1e-3 * 2430 * 1000) * 30
            assert held[0] == pytest.approx(whole / 2, rel=1e-12)


def test_narrow_gaps_keep_the_heat():
    """Wires that nearly touch each other or the tape: no cell is so small that rounding adds heat, and results stay continuous."""
    times = []
    for variant in [section(placement=SpacedWires(5, pitch)) for pitch in (0.33e-3, 0.31e-3, 0.3001e-3)] + [
        section(diameter=5.5e-4, placement=EvenWires(39.0)),
        section(diameter=5.99e-4),
    ]:
        curve, cooled, _ = cool(variant, 60.0)
        held = np.array(curve.stored + curve.lost)
        assert np.max(np.abs(held / held[0] - 1.0)) < 1e-7
        times.append(cooled)
    assert np.isnan(cool(section(placement=SpacedWires(5, 0.1 * 3e-3)), 60.0)[1])  # 5e-20 m more than the diameter
    np.testing.assert_allclose(times[1:3], times[0], rtol=0.02)

    def gap(length: jax.Array) -> jax.Array:
        return graded_widths(jnp.asarray(25e-6), length, 12)

    for length in (3e-5, 1e-6):
        widths, slopes = (np.array(f(jnp.asarray(length))) for f in (gap, jax.jacfwd(gap)))
        assert widths.sum() == pytest.approx(length, rel=1e-14) and widths.min() > 1e-4 * length
        above, below = (np.array(gap(jnp.asarray(length * (1.0 + s)))) for s in (1e-6, -1e-6))
        np.testing.assert_allclose(slopes, (above - below) / (2e-6 * length), rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "cells"),
    [
        ({}, CELLS),
        ({"diameter": 5e-4}, CELLS),
        ({"diameter": 6e-5}, CELLS),
        ({"diameter": 1e-4, "materials": (TAPE, (1070.0, 1050.0, 2.0), (6450.0, 837.4, 18.0))}, CELLS),
        ({"offset": 1e-4}, CELLS),
        ({"count": 3, "pitch": 0.8e-3, "width": 6e-3}, 6),
        ({"count": 4, "pitch": 0.7e-3, "width": 4e-3}, 6),
    ],
)
def test_finite_elements_say_the_same(changes: dict, cells: int):
    ours = dict(changes)
    if "pitch" in ours:
        ours |= {"placement": SpacedWires(ours.pop("count"), ours.pop("pitch"))}
    _, cooled, later = cool(section(cells=cells, **ours))
    time, temperature = reference.cool(reference.Section(**changes), 2.0, rings=5)
    assert later == pytest.approx(temperature[-1], abs=0.05)
    if temperature[-1] < 55.0:
        assert cooled == pytest.approx(reference.cooled(time, temperature), rel=0.01 if cells == CELLS else 0.03)


def test_published_trends():
    """Diameter, number of wires and sensitivities, as an independent finite-volume program on finer grids gave them."""
    for diameter, seconds in ((100, 0.118), (125, 0.179), (200, 0.376), (300, 0.64), (400, 0.859), (500, 1.03)):
        assert cool(section(diameter * 1e-6))[1] == pytest.approx(seconds, rel=0.05)
    assert cool(section())[1] == pytest.approx(0.64, abs=0.03)
    counts = {
        2: 50.87,
        3: 50.87,
        4: 50.87,
        5: 50.89,
        6: 50.94,
        7: 51.03,
        8: 51.14,
        10: 51.40,
        12: 51.68,
        15: 52.10,
        20: 52.81,
        25: 53.51,
    }
    for count, temperature in counts.items():
        assert cool(section(placement=EvenWires(float(count))))[2] == pytest.approx(temperature, abs=0.1)
    base = cool(section())[1]
    for changes, ratio in (
        ({"convection": 0.0}, 0.635 / 0.630),
        ({"convection": 50.0}, 0.612 / 0.630),
        ({"materials": (TAPE, (1070.0, 1050.0, 0.15))}, 0.816 / 0.630),
        ({"materials": (TAPE, (1070.0, 1050.0, 0.3))}, 0.440 / 0.630),
        ({"materials": (TAPE, SILICONE, (6450.0, 450.0, 18.0))}, 0.324 / 0.630),
        ({"offset": 1e-4}, 0.525 / 0.630),
    ):
        assert cool(section(**changes))[1] / base == pytest.approx(ratio, rel=0.02)


def test_wires_side_by_side_are_those_of_the_whole_section():
    """Half a share of the width, against half the section with its three wires and its open side."""
    share = cool(section(placement=EvenWires(3.0), width=6e-3, cells=6))
    whole = cool(section(placement=SpacedWires(3, 2e-3), width=6e-3, cells=6))
    assert share[1] == pytest.approx(whole[1], rel=2e-3) and share[2] == pytest.approx(whole[2], abs=0.02)


@pytest.mark.slow
def test_gradients_forward_and_reverse():
    """In diameter, count, conductivity, convection, offset, thickness and target temperature."""

    def figures(p: jax.Array) -> jax.Array:
        at = section(
            cells=6,
            placement=EvenWires(p[1]),
            diameter=p[0],
            offset=p[4],
            convection=p[3],
            materials=(TAPE, (1070.0, 1050.0, p[2])),
        )
        at = eqx.tree_at(lambda s: s.silicone.thickness, at, p[5])
        curve = at.cool(5.0)
        return jnp.stack([curve.time_to_reach(p[6]), curve.temperature_at(2.0)])

    start, along = np.array([3e-4, 11.0, 0.2, 10.0, 1e-5, 6e-4, 55.0]), np.array([1.0, -0.3])

    @jax.jit
    @jax.vmap
    def moved(point: jax.Array, direction: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """The results, their derivative in a direction, and the gradient of their weighted sum."""
        value, push = jax.linearize(figures, point)
        return value, push(direction), jax.linear_transpose(push, point)(jnp.asarray(along))[0]

    steps = np.diag(1e-4 * start)
    points = np.concatenate([start + 0.0 * steps, start + steps, start - steps])
    values, pushed, gradients = map(np.array, moved(points, np.tile(np.eye(len(start)), (3, 1))))
    slopes = pushed[: len(start)].T
    np.testing.assert_allclose(along @ slopes, gradients[0], rtol=1e-8, atol=1e-8 * np.abs(slopes).max())
    _, above, below = np.split(values, 3)
    np.testing.assert_allclose(slopes * np.diag(steps), (above - below).T / 2, rtol=1e-5, atol=1e-9)
    alone = section(cells=6, placement=EvenWires(11.0), offset=1e-5, convection=10.0 * (1.0 + 1e-4))
    np.testing.assert_allclose(above[3], cool(alone)[1:], rtol=1e-12)  # in a batch as alone


@pytest.mark.slow
def test_gradient_in_the_spacing():
    """Of wires that lie within a section with open sides, where their number stays."""

    def later(spacing: jax.Array) -> jax.Array:
        at = section(cells=6, placement=SpacedWires(3, 0.8e-3), width=6e-3)
        return (
            eqx.tree_at(lambda s: (s.placement.pitch, s.width), at, (spacing[0], spacing[1]))
            .cool(5.0)
            .temperature_at(2.0)
        )

    at, sides = np.array([0.8e-3, 6e-3]), np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    ends, gradients = map(np.array, jax.jit(jax.vmap(jax.value_and_grad(later)))(at * (1.0 + 1e-4 * sides)))
    slopes = gradients[0]
    np.testing.assert_allclose(slopes * 1e-4 * at, (ends[1:3] - ends[3:]) / 2, rtol=1e-5)
    assert slopes[0] < -100.0 * abs(slopes[1])  # further apart they get colder; the section ends far from them


def test_ends_of_the_course():
    warm, never, _ = cool(section(), 0.1)
    assert never == np.inf and float(warm.hottest[0]) == 80.0
    assert cool(section(wire_start=54.0))[1] == 0.0
    for misfit in (
        section(7e-4),
        section(placement=EvenWires(80.0)),
    ):  # thicker than the silicone; wider than the section
        assert np.all(np.isnan(cool(misfit)[1:]))
    with pytest.raises(ValueError, match="7 cells across a wire are not an even number"):
        section(cells=7)


@pytest.mark.parametrize("count", [3, 20])
def test_many_right_hand_sides_are_solved_as_each_alone(count: int):
    """Few vectors are multiplied one by one, many as a product of matrices: both agree with the dense solution."""
    rng = np.random.default_rng(count)
    matrix = FivePointMatrix(*map(jnp.asarray, (5.0 + rng.random((4, 6)), rng.random((4, 5)), rng.random((3, 6)))))
    right = rng.standard_normal((count, 4, 6))
    dense = np.stack([np.asarray(matrix.apply(jnp.asarray(e.reshape(4, 6)))).ravel() for e in np.eye(24)], axis=1)
    solution = jax.vmap(lambda b: matrix.solve(matrix.factor(), b))(jnp.asarray(right))
    np.testing.assert_allclose(
        np.asarray(solution).reshape(count, 24),
        np.linalg.solve(dense, right.reshape(count, 24).T).T,
        rtol=1e-12,
        atol=1e-14,
    )


def test_an_inverse_by_sweeps_calls_no_lapack():
    """LAPACK's threads wait for each other on a busy machine: a section with twelve wires took minutes instead of a second."""
    root = np.random.default_rng(1).standard_normal((40, 40))
    positive = root @ root.T + 40.0 * np.eye(40)
    np.testing.assert_allclose(
        np.asarray(invert_positive_definite(jnp.asarray(positive))) @ positive, np.eye(40), atol=1e-12
    )
    lowered = jax.jit(lambda section: section.cool(1.0).hottest).lower(section())
    assert "lapack" not in lowered.as_text()
