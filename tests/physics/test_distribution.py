"""Tensions of redundant cables against linear and quadratic programs, and the proofs that none exist."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog, lsq_linear
from scipy.sparse import block_diag
from scipy.spatial.transform import Rotation

from cablebot_gym.physics import textbook
from cablebot_gym.physics.distribution import HELD, INFEASIBLE, SINGULAR, feasible, largest_scale, least_norm
from cablebot_gym.physics.distribution import least_largest_action as least_action
from cablebot_gym.robots import PLANAR

COGIRO = (
    (
        (-7.1775, -5.4361, 5.3911), (-7.4594, -5.1504, 5.3999), (-7.3911, 5.1940, 5.3976), (-7.1026, 5.4753, 5.4094),
        (7.2398, 5.3759, 5.4093), (7.5208, 5.0851, 5.4200), (7.4461, -5.2539, 5.3874), (7.1608, -5.5342, 5.3973),
    ),
    (
        (0.5032, -0.4928, 0.0), (-0.5097, 0.3508, 0.9976), (-0.5032, -0.2700, 0.0), (0.4960, 0.3561, 0.9996),
        (-0.5032, 0.4928, 0.0), (0.4998, -0.3404, 0.9991), (0.5021, 0.2750, -0.0007), (-0.5045, -0.3463, 0.9976),
    ),
)  # fmt: skip
"""Suspended robot, base and platform anchors, z up [m]."""

IPANEMA = (
    (
        (-8.544, 5.463, 3.202), (8.184, 5.692, 3.236), (8.224, -5.492, 3.25), (-8.491, -5.322, 3.221),
        (-8.192, 5.648, -0.589), (7.208, 5.463, -0.548), (7.869, -5.557, -0.527), (-8.27, -5.545, -0.582),
    ),
    (
        (-0.07, 0.648, -0.26), (0.06, 0.648, -0.262), (0.06, -0.651, -0.262), (-0.07, -0.651, -0.26),
        (-0.085, 0.748, 0.261), (0.095, 0.749, 0.26), (0.095, -0.745, 0.26), (-0.085, -0.746, 0.261),
    ),
)  # fmt: skip
"""Fully constrained robot, z up [m]."""

CAMERA = (((-8.0, -5.0, 6.0), (8.0, -5.5, 6.5), (7.5, 5.0, 6.0), (-8.0, 5.0, 5.5)), ((0.0, 0.0, 0.0),) * 4)
PLATE = (
    ((-0.756, -0.4181), (0.756, -0.4181), (0.756, 0.4181), (-0.756, 0.4181)),
    ((-0.075, 0.025), (0.075, 0.025), (0.075, -0.025), (-0.075, -0.025)),
)


def structure_of(robot, position, angles):
    """Structure Jacobian for the wrench (force, moment); only the force if all platform anchors are at the origin."""
    base, platform = (np.array(anchors) for anchors in robot)
    if base.shape[1] == 2:
        turn = Rotation.from_euler("z", angles[..., 2:]).as_matrix()[..., :2, :2]
    else:
        turn = Rotation.from_euler("xyz", angles).as_matrix()
    arm = np.einsum("...ij,cj->...ci", turn, platform)
    cable = position[..., None, :] + arm - base
    u = cable / np.linalg.norm(cable, axis=-1, keepdims=True)
    if not platform.any():
        return u
    if base.shape[1] == 2:
        return np.concatenate([u, (arm[..., :1] * u[..., 1:] - arm[..., 1:] * u[..., :1])], axis=-1)
    return np.concatenate([u, np.cross(arm, u)], axis=-1)


def random_items(kind, count, seed=5):
    """Structure, load and bounds. Some of the loads are infeasible."""
    rng = np.random.default_rng(seed)
    if isinstance(kind, str):
        m, n = (int(number) for number in kind.split("/"))
        structure = rng.normal(size=(count, m, n))
        structure[:, :, : min(n, 3)] /= np.linalg.norm(structure[:, :, : min(n, 3)], axis=-1, keepdims=True)
        inside = rng.uniform(0, 700, (count, m))
        load = -np.einsum("kci,kc->ki", structure, inside) + rng.normal(size=(count, n)) * 100
        return structure, load, rng.uniform(5, 100, (count, m)), rng.uniform(400, 1000, (count, m))
    base = np.array(kind[0])
    middle, reach = base.mean(axis=0), 0.35 * np.ptp(base, axis=0)
    if base.shape[1] == 3 and base[:, 2].min() > 1:  # suspended
        middle, reach = middle - np.array([0, 0, 3.5]), reach + np.array([0, 0, 1.0])
    position = middle + rng.uniform(-reach, reach, (count, len(middle)))
    structure = structure_of(kind, position, rng.uniform(-0.3, 0.3, (count, 3)))
    mass = rng.uniform(50, 300, count)
    load = mass[:, None] * rng.normal(size=(count, structure.shape[2])) * 1.5
    load[:, len(middle) :] *= 0.2 if len(middle) == 3 else 0.03
    load[:, len(middle) - 1] += mass * 9.81  # z is up in these anchors
    shape = structure.shape[:2]
    return structure, load, rng.uniform(5, 100, shape), rng.uniform(1500, 4000, shape)


KINDS = {
    "CoGiRo": COGIRO,
    "IPAnema": IPANEMA,
    "camera": CAMERA,
    "plate": PLATE,
    **{kind: kind for kind in ("10/6", "7/6", "3/2", "6/2", "6/6")},
}

each_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
counts = pytest.mark.parametrize("count", [60, pytest.param(18_000, marks=pytest.mark.slow)])
"""9 kinds: 540 draws daily; 162,000 in the slow tests, more than 100,000 of them feasible."""


def inner_items(kind, count):
    """Items whose load is held with 1e-3 N to spare, so that tolerances of an oracle do not decide."""
    structure, load, lower, upper = random_items(kind, count)
    held = feasible(structure, load, lower + 1e-3, upper - 1e-3).status == HELD
    assert 0.05 < held.mean() < 0.999
    return structure[held], load[held], lower[held], upper[held]


def separate_linear_programs(cost, equal, equal_to, less, less_than, bounds, blocks=100):
    """Solutions of many small linear programs of equal shape, solved in blocks as one."""
    found = []
    for start in range(0, len(equal), blocks):
        part = slice(start, start + blocks)
        size = len(equal[part])
        result = linprog(
            np.broadcast_to(cost, (len(equal), equal.shape[2]))[part].ravel(),
            A_eq=block_diag(equal[part], format="csr"),
            b_eq=equal_to[part].ravel(),
            A_ub=block_diag(less[part], format="csr") if less.shape[1] else None,
            b_ub=less_than[part].ravel() if less.shape[1] else None,
            bounds=np.reshape(bounds[part], (-1, 2)),
            method="highs",
        )
        assert result.status == 0
        found.append(result.x.reshape(size, -1))
    return np.concatenate(found)


@each_kind
@counts
def test_least_largest_action_is_that_of_a_linear_program(kind, count):
    structure, load, lower, upper = inner_items(kind, count)
    rng = np.random.default_rng(6)
    items, m, _ = structure.shape
    slope = rng.uniform(0.5, 1.5, (items, m)) * rng.choice([-1, 1], (items, m)) / 1000
    offset = rng.uniform(-0.3, 0.3, (items, m))
    zeros, ones = np.zeros((items, structure.shape[2], 1)), -np.ones((items, m, 1))
    steep = slope[:, :, None] * np.eye(m)
    best = separate_linear_programs(
        np.eye(m + 1)[m],
        np.concatenate([-np.swapaxes(structure, 1, 2), zeros], axis=2),
        load,
        np.concatenate([np.concatenate([sign * steep, ones], axis=2) for sign in (1, -1)], axis=1),
        np.concatenate([-offset, offset], axis=1),
        np.concatenate([np.stack([lower, upper], axis=-1), np.tile([[[0.0, np.inf]]], (items, 1, 1))], axis=1),
    )[:, -1]
    for smoothing in (1e-6, 1e-2):
        found = least_action(structure, load, lower, slope, offset, upper, smoothing=smoothing)
        assert np.all(found.status == HELD)
        np.testing.assert_allclose(found.missing, 0, atol=1e-7)
        assert np.all((found.tensions >= lower) & (found.tensions <= upper))
        largest = np.abs(slope * found.tensions + offset).max(axis=1)
        bound = np.sqrt((1 + smoothing * m) / (1 + smoothing))
        assert np.all(largest >= best * (1 - 1e-7) - 1e-9)
        assert np.all(largest <= best * bound * (1 + 1e-7) + 1e-9)


@each_kind
@counts
def test_least_norm_is_that_of_a_quadratic_program(kind, count):
    casadi = pytest.importorskip("casadi")
    structure, load, lower, upper = inner_items(kind, count)
    _, m, n = structure.shape
    reference = np.random.default_rng(7).uniform(0, 2000, lower.shape)
    found = least_norm(structure, load, lower, upper, reference)
    assert np.all(found.status == HELD)
    np.testing.assert_allclose(found.missing, 0, atol=1e-7)
    assert np.all((found.tensions >= lower) & (found.tensions <= upper))
    shapes = {"h": casadi.Sparsity.diag(m), "a": casadi.Sparsity.dense(n, m)}
    solve = casadi.conic("oracle", "qpoases", shapes, {"printLevel": "none"})
    for s, w, low, high, near, tensions in zip(structure, load, lower, upper, reference, found.tensions, strict=True):
        best = solve(h=casadi.DM.eye(m), g=-near, a=-s.T, lba=w, uba=w, lbx=low, ubx=high)["x"]
        np.testing.assert_allclose(tensions, np.array(best)[:, 0], rtol=0, atol=2e-5)


@each_kind
@counts
def test_every_load_is_held_or_proved_infeasible(kind, count):
    """Both are checked by arithmetic alone: the tensions hold the load, or a combination of cables excludes it."""
    structure, load, lower, upper = random_items(kind, count)
    proof, held = feasible(structure, load, lower, upper), least_norm(structure, load, lower, upper)
    np.testing.assert_array_equal(proof.status, held.status)
    fails = proof.status == INFEASIBLE
    assert np.all(fails | (proof.status == HELD))
    assert 0.001 < fails.mean() < 0.95
    assert np.abs(held.missing[~fails]).max() < 1e-6
    assert np.all((held.tensions >= lower) & (held.tensions <= upper))
    g = proof.coefficients[fails]
    np.testing.assert_allclose(-np.einsum("kci,ki->kc", structure[fails], proof.direction[fails]), g, atol=1e-9)
    needed = np.sum(proof.direction[fails] * load[fails], axis=1)
    most = np.sum(np.where(g > 0, g * upper[fails], g * lower[fails]), axis=1)
    np.testing.assert_allclose(proof.excess[fails], needed - most, rtol=1e-7, atol=1e-6)
    assert np.all(proof.excess[fails] > 0)
    assert np.all(np.count_nonzero(g, axis=1) <= g.shape[1] - load.shape[1] + 1)
    assert not proof.excess[~fails].any()
    assert not proof.coefficients[~fails].any()


@each_kind
@counts
def test_largest_scale_is_that_of_a_linear_program(kind, count):
    """With bounds that depend on the scale."""
    structure, load, lower, upper = inner_items(kind, count)
    rng = np.random.default_rng(8)
    items, m, n = structure.shape
    unit = rng.normal(size=(items, n))
    unit_lower, unit_upper = rng.uniform(-0.01, 0.01, (2, items, m))
    found = largest_scale(
        structure, load, unit, lower, upper, 1e3, least=-1e3, unit_lower=unit_lower, unit_upper=unit_upper
    )
    assert np.all(found.status == HELD)
    equal = np.concatenate([-np.swapaxes(structure, 1, 2), -unit[:, :, None]], axis=2)
    one = np.broadcast_to(np.eye(m), (items, m, m))
    less = np.concatenate([np.dstack([-one, unit_lower]), np.dstack([one, -unit_upper])], axis=1)
    less_than = np.concatenate([-lower, upper], axis=1)
    bounds = np.tile([*[[-np.inf, np.inf]] * m, [-1e3, 1e3]], (items, 1, 1))
    for sign, end in ((1, found.least), (-1, found.largest)):
        best = separate_linear_programs(sign * np.eye(m + 1)[m], equal, load, less, less_than, bounds)[:, -1]
        np.testing.assert_allclose(end, best, rtol=1e-6, atol=1e-6)
    # just above the end, the cables at the end prove that no tensions hold the load
    beyond = found.largest + 1e-3
    low, high = lower + beyond[:, None] * unit_lower, upper + beyond[:, None] * unit_upper
    g, y = found.coefficients, feasible(structure, load + beyond[:, None] * unit, low, high)
    inside = found.largest < 1e3
    assert inside.any()
    assert np.all(y.status[inside] == INFEASIBLE)
    spread = np.sum(g * np.where(g > 0, high, low), axis=1)
    needed = np.sum(-np.linalg.pinv(structure) @ g[..., None] * (load + beyond[:, None] * unit)[..., None], axis=(1, 2))
    assert np.all((needed > spread)[inside])


def motion(rate):
    """Structure and load of CoGiRo on a smooth motion of 8 s, sampled at a rate [Hz]."""
    phase = np.arange(0, 8, 1 / rate)[:, None] * np.pi / 2
    position = [0, 0, 2] + [2.5, 2.5, 0.8] * np.sin(phase * [1.0, 1.7, 1.3] + [1.6, 0.2, 0])
    load = np.zeros((len(phase), 6))
    load[:, :3] = 200 * ([0, 0, 9.81] - 3 * np.sin(phase * [1.0, 1.7, 1.3]))
    return structure_of(COGIRO, position, 0.1 * np.sin(phase * [1.0, 1.7, 0.6])), load


@pytest.mark.parametrize(
    "allocate",
    [
        lambda structure, load: least_norm(structure, load, 300.0, 1500.0),
        lambda structure, load: least_action(structure, load, 50.0, 2e-4, 0.0, 5000.0),
    ],
    ids=["least norm", "least largest action"],
)
def test_tensions_are_continuous_along_a_motion(allocate):
    """The exact least largest action jumps on this motion, by the same amount at every rate."""
    changes = []
    for rate in (1000, 4000):
        found = allocate(*motion(rate))
        changes.append(np.abs(np.diff(found.tensions, axis=0)).max())
    assert changes[1] < 0.3 * changes[0]


def test_three_planar_cables_have_their_least_tensions():
    """The least α minimises every tension, so all rules agree with the textbook's pairs."""
    rng = np.random.default_rng(9)
    structure = textbook.jacobian(PLANAR, rng.uniform(-0.1, 0.1, (200, 2)))
    load = rng.uniform(-20, 20, (200, 2))
    expected = textbook.tension_distribution(structure, load, 5.0)
    for found in (least_norm(structure, load, 5.0), least_action(structure, load, 5.0, 0.01, 0.0)):
        np.testing.assert_allclose(found.tensions, expected, rtol=0, atol=1e-11)


def test_infeasible_load_gets_the_least_wrench_error():
    structure, load, lower, upper = random_items(COGIRO, 100)
    weights = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
    for found in (
        least_norm(structure, load, lower, upper, weights=weights),
        least_action(structure, load, lower, 1e-3, 0.0, upper, weights=weights),
    ):
        fails = np.flatnonzero(found.status == INFEASIBLE)
        assert len(fails) > 5
        for k in fails:
            best = lsq_linear(-weights[:, None] * structure[k].T, weights * load[k], (lower[k], upper[k]), "bvls")
            error = np.sum((weights * found.missing[k]) ** 2) / 2
            assert best.cost * (1 - 1e-9) <= error <= best.cost * (1 + 1e-4) + 1e-4


def test_crossed_bounds_and_singular_structures_have_finite_tensions():
    structure, load, lower, upper = random_items(COGIRO, 3)
    structure[0, :, 3] = structure[0, :, 0]
    load[0, 3] = load[0, 0] + 10.0
    upper[1, 2] = lower[1, 2] - 7.0
    lower[2], upper[2] = 0.0, 1e5
    for found in (least_norm(structure, load, lower, upper), least_action(structure, load, lower, 1e-3, 0.0, upper)):
        assert found.status.tolist() == [SINGULAR, INFEASIBLE, HELD]
        assert np.all(np.isfinite(found.tensions))
        assert np.all(found.tensions >= lower)
    proof = feasible(structure, load, lower, upper)
    assert proof.status.tolist() == [SINGULAR, INFEASIBLE, HELD]
    np.testing.assert_allclose(proof.direction[0], [-1, 0, 0, 1, 0, 0], atol=1e-9)
    np.testing.assert_allclose(proof.excess[:2], [10.0, 7.0])
    assert np.isnan(largest_scale(structure[0], load[0], load[0], 0.0, 1.0, 1.0).largest)


def test_square_structure_gives_the_unique_tensions():
    structure, load, *_ = random_items("6/6", 50)
    expected = -np.linalg.solve(np.swapaxes(structure, 1, 2), load[..., None])[..., 0]
    for found in (
        least_norm(structure, load, -np.inf),
        least_action(structure, load, -np.inf, 1e-3, 0.1),
    ):
        assert np.all(found.status == HELD)
        np.testing.assert_allclose(found.tensions, expected, rtol=1e-9, atol=1e-7)
    proof = feasible(structure, load, 0.0)
    fails = np.flatnonzero(proof.status == INFEASIBLE)
    cable = np.abs(proof.coefficients).argmax(axis=1)
    np.testing.assert_allclose(proof.excess[fails], -expected[fails, cable[fails]], rtol=1e-7)


def test_arguments_broadcast():
    """A scale or a bound per item must not be read as one per cable."""
    structure, load, lower, _ = random_items(CAMERA, 6)
    whole = least_norm(structure.reshape(2, 3, 4, 3), load.reshape(2, 3, 3), lower[0], 2000.0)
    assert (whole.tensions.shape, whole.status.shape, whole.missing.shape) == ((2, 3, 4), (2, 3), (2, 3, 3))
    one = least_norm(structure[4], load[4], lower[0], 2000.0)
    np.testing.assert_array_equal(one.tensions, whole.tensions[1, 1])
    most = largest_scale(structure[:1], [0, 0, 0], [0, 0, 9.81], 0.0, 2000.0, np.array([1.0, 2.0, 1e4]))
    np.testing.assert_allclose(most.largest[:2], [1, 2])
    with pytest.raises(ValueError, match="do not match"):
        feasible(structure, load[:, :2], 0.0)
