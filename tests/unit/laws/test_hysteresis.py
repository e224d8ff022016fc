"""Bouc-Wen and Prandtl-Ishlinskii operators: their maps, their memory, their inverse, and their derivatives."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from smajax.errors import InputError
from smajax.laws.bouc_wen import BoucWen
from smajax.laws.prandtl_ishlinskii import Envelope, PrandtlIshlinskii
from smajax.laws.prandtl_ishlinskii_inverse import inverse_operator
from smajax.laws.response import compute_response
from tests.reference import prandtl_ishlinskii as reference

SEVEN = {"alpha": 0.3, "k": 2.0, "d": 1.5, "a": 1.2, "beta": 0.8, "gamma": -0.1, "n": 1.7}
TIME = np.linspace(0.0, 20.0, 400)
INPUT = np.sin(TIME) * (1.0 + 0.3 * np.sin(0.37 * TIME))
follow = eqx.filter_jit(compute_response)
# One envelope, two that lie side by side, and two of other slopes, the unloading one above wherever the input comes.
UNLOADING = [None, (1.0, 2.0, 0.3, 0.12), (1.1, 1.6, 0.5, 0.4)]


def envelope(*values: float) -> Envelope:
    return Envelope(*(jnp.asarray(v) for v in values))


def operator(unloading: Envelope | None = None, count: int = 10) -> PrandtlIshlinskii:
    thresholds, densities = jnp.linspace(0.1, 1.0, count), jnp.linspace(0.3, 0.05, count)
    return PrandtlIshlinskii(jnp.asarray(0.5), thresholds, densities, envelope(1.0, 2.0, 0.2, 0.1), unloading)


def original(seven: dict, values: np.ndarray) -> np.ndarray:
    """The older form as printed, by an adaptive solver, leg by leg."""
    p = seven
    z, out = 0.0, []
    for k, x in enumerate(values):
        if k:
            change = x - values[k - 1]

            def rate(_, z, change=change):
                size = np.abs(z)
                lost = p["beta"] * abs(change) * size ** (p["n"] - 1) * z + p["gamma"] * change * size ** p["n"]
                return (p["a"] * change - lost) / p["d"]

            z = solve_ivp(rate, (0.0, 1.0), [z], rtol=1e-11, atol=1e-13).y[0, -1]
        out.append(p["alpha"] * p["k"] * x + (1 - p["alpha"]) * p["d"] * p["k"] * z)
    return np.array(out)


def test_the_normalised_form_is_the_seven_parameter_one():
    law = BoucWen.from_seven_parameters(**SEVEN)
    exact = original(SEVEN, INPUT)
    np.testing.assert_allclose(follow(law, jnp.asarray(TIME), jnp.asarray(INPUT)), exact, atol=1e-6)
    back = BoucWen.from_seven_parameters(**{k: float(v) for k, v in law.to_seven_parameters(d=0.7, a=3.0).items()})
    for entry, other in zip(jax.tree.leaves(law), jax.tree.leaves(back), strict=True):
        assert float(entry) == pytest.approx(float(other), rel=1e-12)


@pytest.mark.parametrize("exponent", [1.05, 1.7, 10.0])
def test_the_path_lengths_have_converged(exponent, monkeypatch):
    """Four points in a piece of the curve give the output of forty."""
    law = dataclasses.replace(BoucWen.from_seven_parameters(**SEVEN), n=jnp.asarray(exponent))
    output = compute_response(law, jnp.asarray(TIME), jnp.asarray(INPUT))
    monkeypatch.setattr("smajax.laws.response._QUADRATURE_POINTS", 40)
    finer = compute_response(law, jnp.asarray(TIME), jnp.asarray(INPUT))
    np.testing.assert_allclose(output, finer, rtol=0.0, atol=1e-12 * float(jnp.max(jnp.abs(finer))))


def test_a_normalised_form_without_a_seven_parameter_one_is_refused():
    law = BoucWen(*(jnp.asarray(v) for v in (-1.0, 2.0, 0.5, 0.6, 1.5)))
    assert float(law.to_seven_parameters(a=2.0)["k"]) == pytest.approx(-0.5)
    with pytest.raises(InputError, match="choose another a"):
        law.to_seven_parameters(d=1.0, a=1.0)


@pytest.mark.parametrize(
    "wrong", [{"gamma": -SEVEN["beta"]}, {"beta": -0.05, "gamma": 0.9}, {"a": -SEVEN["a"]}, {"d": 0.0}, {"n": 0.5}]
)
def test_seven_parameters_without_a_normalised_form_are_refused(wrong):
    """They would give NaN, or a model that diverges."""
    with pytest.raises(InputError, match="of one sign, and n of at least 1"):
        BoucWen.from_seven_parameters(**(SEVEN | wrong))


@pytest.mark.parametrize("name", SEVEN)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_seven_parameters_that_are_no_numbers_are_refused(name, value):
    with pytest.raises(InputError, match="one of the seven parameters is not a finite number"):
        BoucWen.from_seven_parameters(**(SEVEN | {name: value}))


def test_bouc_wen_does_not_know_the_rate_and_stays_within_its_bound():
    law = BoucWen.from_seven_parameters(**SEVEN)
    slow = follow(law, jnp.asarray(TIME), jnp.asarray(INPUT))
    fast = follow(law, jnp.asarray(TIME**2), jnp.asarray(INPUT))
    np.testing.assert_array_equal(slow, fast)
    w = (slow - law.kx * INPUT) / law.kw
    assert float(jnp.max(jnp.abs(w))) <= 1.0 + 1e-9
    far = follow(law, jnp.asarray(TIME), jnp.asarray(np.linspace(0.0, 40.0, 400)))
    assert float((far[-1] - law.kx * 40.0) / law.kw) == pytest.approx(1.0, abs=1e-6)


STEPS = np.array([0.0, 1.0, 0.0, 1.0, 0.3, 0.8, 0.75, 0.0, 1.0, 0.98])  # each in a single row


def stored(rho: float, sigma: float, n: float, values: np.ndarray) -> np.ndarray:
    """w by SciPy, leg by leg."""
    w, computed = 0.0, [0.0]
    for change in np.diff(values):

        def rate(_, w, change=change):
            power = np.abs(w) ** (n - 1)
            return rho * (change - sigma * abs(change) * power * w + (sigma - 1) * change * power * np.abs(w))

        w = solve_ivp(rate, (0.0, 1.0), [w], method="LSODA", rtol=1e-10, atol=1e-13).y[0, -1]
        computed.append(w)
    return np.array(computed)


steepness = eqx.filter_jit(jax.grad(lambda law, time, values: jnp.sum(compute_response(law, time, values) ** 2)))


@pytest.mark.parametrize("rho", [1.0, 10.0, 100.0])
@pytest.mark.parametrize(("sigma", "n"), [(0.6, 1.0), (0.6, 2.0), (2.0, 1.3), (5.0, 6.0), (1.0, 6.0)])
def test_a_step_of_the_input_is_as_exact_as_a_slow_rise(rho, sigma, n):
    law = BoucWen(*(jnp.asarray(v) for v in (0.0, 1.0, rho, sigma, n)))
    rows = np.arange(10 * (len(STEPS) - 1) + 1) / 10.0
    sudden = np.asarray(follow(law, jnp.asarray(rows), jnp.asarray(np.repeat(STEPS, 10)[9:])))
    np.testing.assert_allclose(sudden[::10], stored(rho, sigma, n, STEPS), atol=1e-6)
    assert np.max(np.abs(sudden)) <= 1.0
    slow = np.asarray(follow(law, jnp.asarray(rows), jnp.asarray(np.interp(rows, np.arange(len(STEPS)), STEPS))))
    np.testing.assert_allclose(slow[::10], sudden[::10], atol=1e-6)
    slopes = steepness(law, jnp.asarray(rows), jnp.asarray(np.repeat(STEPS, 10)[9:]))
    assert all(np.isfinite(float(leaf)) for leaf in jax.tree.leaves(slopes))


@pytest.mark.parametrize("n", [1.0, 1.7, 3.0])
def test_derivatives_of_bouc_wen(n):
    law = BoucWen.from_seven_parameters(**(SEVEN | {"n": n}))
    time, values = jnp.asarray(TIME[:120]), jnp.asarray(INPUT[:120])
    leaves, form = jax.tree.flatten(law)

    @jax.jit
    def mean(leaves):
        return jnp.mean(compute_response(jax.tree.unflatten(form, leaves), time, values) ** 2)

    point = jnp.stack(leaves)
    forward, reverse = (np.asarray(jax.jit(mode(mean))(point)) for mode in (jax.jacfwd, jax.grad))
    np.testing.assert_allclose(reverse, forward, rtol=1e-6)
    for k in range(6):
        step = 1e-6 * jnp.eye(6)[k]
        ends = [float(mean(point + side * step)) for side in ((1, -1) if n > 1.0 else (1, 0))]
        assert forward[k] == pytest.approx((ends[0] - ends[1]) / (1e-6 * (2 if n > 1.0 else 1)), rel=1e-3, abs=1e-7)


def test_batches_of_bouc_wens_derivatives_are_single_ones():
    leaves, form = jax.tree.flatten(BoucWen.from_seven_parameters(**SEVEN))
    time, values = jnp.asarray(TIME[:120]), jnp.asarray(INPUT[:120])
    points = jnp.stack(leaves)[None, :] * jnp.asarray(np.random.default_rng(1).uniform(0.9, 1.1, (3, 6)))

    def response(point):
        return compute_response(jax.tree.unflatten(form, point), time, values)

    forward, reverse = jax.jit(jax.vmap(jax.jacfwd(response)))(points), jax.jit(jax.vmap(jax.jacrev(response)))(points)
    np.testing.assert_allclose(reverse, forward, atol=1e-11)
    single = jax.jit(jax.jacfwd(response))
    for point, slopes in zip(points, forward, strict=True):
        np.testing.assert_allclose(single(point), slopes, atol=1e-12)


@pytest.mark.parametrize("count", [1, 10, 20])
@pytest.mark.parametrize("unloading", [None, (1.0, 2.0, 0.3, 0.12), (0.9, 1.6, 0.5, 0.1), (1.0, 0.4, 0.1, 0.0)])
def test_the_inverse_gives_the_input_back(count, unloading):
    law, time = operator(unloading and envelope(*unloading), count=count), jnp.asarray(TIME)
    output = follow(law, time, jnp.asarray(INPUT))
    np.testing.assert_allclose(follow(inverse_operator(law), time, output), INPUT, atol=1e-9)


def falling(law: PrandtlIshlinskii) -> PrandtlIshlinskii:
    """The operator with the negated output."""

    def turned(top: Envelope) -> Envelope:
        return dataclasses.replace(top, height=-top.height, middle=-top.middle)

    return dataclasses.replace(law, loading=turned(law.loading), unloading=law.unloading and turned(law.unloading))


@pytest.mark.parametrize("unloading", UNLOADING)
def test_an_output_that_falls_with_its_input_has_falling_envelopes(unloading):
    rising, time = operator(unloading and envelope(*unloading)), jnp.asarray(TIME)
    law = falling(rising)
    output = follow(law, time, jnp.asarray(INPUT))
    np.testing.assert_allclose(output, -follow(rising, time, jnp.asarray(INPUT)), atol=1e-14)
    np.testing.assert_allclose(follow(inverse_operator(law), time, output), INPUT, atol=1e-9)


def test_envelopes_that_go_opposite_ways_have_no_inverse():
    law = operator(envelope(-1.0, 2.0, 0.3, 0.12))
    with pytest.raises(InputError, match="one envelope rises and the other falls"):
        inverse_operator(law)


@pytest.mark.parametrize("unloading", [None, (1.0, 2.0, 0.3, 0.12)])
def test_without_a_direct_part_there_is_no_inverse(unloading):
    law = dataclasses.replace(operator(unloading and envelope(*unloading)), direct=jnp.asarray(0.0))
    with pytest.raises(InputError, match="has no inverse, since its direct part p_0 is 0"):
        inverse_operator(law)


def test_a_law_that_need_not_rise_has_no_inverse():
    law = operator()
    for name in ("densities", "thresholds"):
        with pytest.raises(InputError, match=f"some of its {name} are negative"):
            inverse_operator(dataclasses.replace(law, **{name: getattr(law, name).at[0].set(-0.1)}))


def test_derivatives_of_the_inverse_of_two_envelopes():
    law, time = operator(envelope(1.0, 2.0, 0.3, 0.12)), jnp.asarray(TIME)
    output = follow(law, time, jnp.asarray(INPUT))

    def mean(direct):
        return jnp.mean(follow(inverse_operator(dataclasses.replace(law, direct=direct)), time, output) ** 2)

    at, step = law.direct, 1e-6
    central = (mean(at + step) - mean(at - step)) / (2.0 * step)
    assert float(jax.jacfwd(mean)(at)) == pytest.approx(float(central), rel=1e-5)


def plays(law: PrandtlIshlinskii, values: list[float]) -> np.ndarray:
    state = law.init(jnp.asarray(values[0]))
    for before, after in zip(values[:-1], values[1:], strict=True):
        state = law.step(state, jnp.asarray(before), jnp.asarray(after), jnp.asarray(1.0))
    return np.asarray(state)


@pytest.mark.slow
@pytest.mark.parametrize("count", [10, 20])
@pytest.mark.parametrize("unloading", UNLOADING)
@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=8), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_return_points_are_remembered_and_small_loops_wiped_out(unloading, count, history, inner, outer):
    law = operator(unloading and envelope(*unloading), count)
    last, before = history[-1], plays(law, history)
    # A closed loop leaves no memory; going beyond the last reversal erases the inner ones.
    turn = min(max(inner, min(history[-2], last)), max(history[-2], last))
    np.testing.assert_allclose(plays(law, [*history, turn, last]), before, atol=1e-12)
    beyond = 1.5 if outer >= last else -1.5
    np.testing.assert_allclose(plays(law, [*history, turn, last, beyond]), plays(law, [*history, beyond]), atol=1e-12)
    # The memory of a history consists of the reversals that no later ones enclose.
    np.testing.assert_allclose(plays(law, reference.essential(history)), before, atol=1e-12)


@pytest.mark.parametrize("count", [10, 20])
@pytest.mark.parametrize("unloading", UNLOADING)
def test_the_operator_is_the_definition_play_by_play(unloading, count):
    law, walk = operator(unloading and envelope(*unloading), count), np.random.default_rng(4).uniform(-1.4, 1.4, 300)
    values = np.concatenate([INPUT, walk, np.repeat(walk[:20], 2)])
    sides = [reference.Envelope(*side) for side in ((1.0, 2.0, 0.2, 0.1), unloading or (1.0, 2.0, 0.2, 0.1))]
    exact = reference.respond(
        0.5, list(np.linspace(0.1, 1.0, count)), list(np.linspace(0.3, 0.05, count)), *sides, list(values)
    )
    np.testing.assert_allclose(follow(law, jnp.arange(len(values)) * 1.0, jnp.asarray(values)), exact, atol=1e-12)


def test_one_operator_is_the_textbook_play():
    law = PrandtlIshlinskii(jnp.asarray(0.0), jnp.asarray([0.3]), jnp.asarray([1.0]), envelope(1e6, 1e-6, 0.0, 0.0))
    state, expected = 0.0, []
    for value in INPUT:
        state = max(value - 0.3, min(value + 0.3, state))
        expected.append(state)
    np.testing.assert_allclose(follow(law, jnp.asarray(TIME), jnp.asarray(INPUT)), expected, atol=1e-9)


@pytest.mark.slow
def test_batches_and_derivatives_of_the_operator():
    law, time, values = operator(envelope(1.0, 1.8, 0.4, 0.1)), jnp.asarray(TIME[:150]), jnp.asarray(INPUT[:150])
    batch = jax.vmap(lambda d: follow(eqx.tree_at(lambda o: o.direct, law, d), time, values))(jnp.array([0.4, 0.5]))
    np.testing.assert_allclose(batch[1], follow(law, time, values), atol=1e-14)
    leaves, form = jax.tree.flatten(law)

    def mean(*leaves):
        return jnp.mean(compute_response(jax.tree.unflatten(form, leaves), time, values) ** 2)

    slopes = jax.grad(mean, argnums=tuple(range(len(leaves))))(*leaves)
    for k, leaf in enumerate(leaves):
        at = tuple(0 for _ in leaf.shape)
        ends = [
            float(mean(*(v.at[at].add(side * 1e-6) if i == k else v for i, v in enumerate(leaves)))) for side in (1, -1)
        ]
        assert float(slopes[k][at]) == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-4, abs=1e-8)
