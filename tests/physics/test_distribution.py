"""Tensions of redundant cables against linear and quadratic programs, and the proofs that none
exist."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles.platforms import CAMERA
from oracles.programs import least_largest_action
from scipy.optimize import lsq_linear

from cablebot_gym.motions import find_trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.physics.tensions.distribution import (
    BARRIER,
    HELD,
    INFEASIBLE,
    SINGULAR,
    largest_scale,
    least_norm,
    unchecked_central,
)
from cablebot_gym.physics.tensions.distribution import (
    unchecked_least_largest_action as least_action,
)
from cablebot_gym.robots import find_robot

COGIRO = find_robot("cogiro")
ROBOTS = {
    "CoGiRo": COGIRO,
    "IPAnema": find_robot("ipanema-3"),
    "camera": CAMERA,
    "plate": find_robot("ttk4900"),
}
KINDS = ROBOTS | {kind: kind for kind in ("10/6", "7/6", "3/2", "6/2", "6/6")}
"""Robots, or random structures of so many cables and coordinates."""

each_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
counts = pytest.mark.parametrize("count", [60, pytest.param(2000, marks=pytest.mark.nightly)])


def random_structures(kind, count, rng):
    cables, coordinates = (int(number) for number in kind.split("/"))
    structure = rng.normal(size=(count, cables, coordinates))
    directions = structure[:, :, :3]
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return structure


def random_items(kind, count):
    """Structure, load and bounds. Some of the loads are infeasible."""
    rng = np.random.default_rng(5)
    if isinstance(kind, str):
        structure = random_structures(kind, count, rng)
        spread = 100.0
    else:
        reach = kind.home + 0.5 * (kind.pose_bounds - kind.home)
        pose = rng.uniform(*reach, (count, kind.coordinates))
        turns = np.arange(kind.coordinates) >= kind.dimensions
        pose[:, turns] = rng.uniform(-0.3, 0.3, pose[:, turns].shape)
        structure = textbook.jacobian(kind, pose)
        spread = np.where(turns, 60.0, 300.0)
    shape = structure.shape[:2]
    load = -np.einsum("kci,kc->ki", structure, rng.uniform(0, 700, shape))
    load += rng.normal(size=load.shape) * spread
    return structure, load, rng.uniform(5, 100, shape), rng.uniform(400, 1000, shape)


def feasible(structure, load, lower, upper):
    """Whether tensions hold the load, or which cables exclude it."""
    return largest_scale(structure, load, np.zeros_like(load), lower, upper, 0.0)


def held_items(kind, count):
    """Items whose load is held with 1e-3 N to spare, so that tolerances of an oracle do not
    decide."""
    structure, load, lower, upper = random_items(kind, count)
    held = feasible(structure, load, lower + 1e-3, upper - 1e-3).status == HELD
    assert 0.05 < held.mean() < 0.999
    return structure[held], load[held], lower[held], upper[held]


def missing(structure, load, tensions):
    """The part of the load that tensions do not hold."""
    return load + np.einsum("kci,kc->ki", structure, tensions)


def check_tensions(structure, load, tensions, lower, upper):
    assert np.all(tensions.status == HELD)
    assert_allclose(missing(structure, load, tensions.tensions), 0, atol=1e-7)
    assert np.all((tensions.tensions >= lower) & (tensions.tensions <= upper))


@each_kind
@counts
def test_least_largest_action_is_that_of_a_linear_program(kind, count):
    structure, load, lower, upper = held_items(kind, count)
    shape = lower.shape
    rng = np.random.default_rng(6)
    slope = rng.uniform(0.5, 1.5, shape) * rng.choice([-1, 1], shape) / 1000
    offset = rng.uniform(-0.3, 0.3, shape)
    items = zip(structure, load, lower, upper, slope, offset, strict=True)
    largest = np.array([least_largest_action(*item) for item in items])
    cables = shape[1]
    for smoothing in (1e-6, 1e-2):
        solution = least_action(structure, load, lower, slope, offset, upper, smoothing=smoothing)
        check_tensions(structure, load, solution, lower, upper)
        actions = np.abs(slope * solution.tensions + offset).max(axis=1)
        bound = np.sqrt((1 + smoothing * cables) / (1 + smoothing))
        assert np.all(actions >= largest * (1 - 1e-7) - 1e-9)
        assert np.all(actions <= largest * bound * (1 + 1e-7) + 1e-9)


@each_kind
@counts
def test_least_norm_is_that_of_a_quadratic_program(kind, count):
    casadi = pytest.importorskip("casadi")
    structure, load, lower, upper = held_items(kind, count)
    _, cables, coordinates = structure.shape
    reference = np.random.default_rng(7).uniform(0, 2000, lower.shape)
    solution = least_norm(structure, load, lower, upper, reference)
    check_tensions(structure, load, solution, lower, upper)
    diagonal = casadi.Sparsity.diag(cables)
    shapes = {"h": diagonal, "a": casadi.Sparsity.dense(coordinates, cables)}
    solve = casadi.conic("oracle", "qpoases", shapes, {"printLevel": "none"})
    for k, tensions in enumerate(solution.tensions):
        limits = {"lba": load[k], "uba": load[k], "lbx": lower[k], "ubx": upper[k]}
        hessian = casadi.DM.eye(cables)
        best = solve(h=hessian, g=-reference[k], a=-structure[k].T, **limits)["x"]
        assert_allclose(tensions, np.array(best)[:, 0], rtol=0, atol=2e-5)


@each_kind
@counts
def test_every_load_is_held_or_proved_infeasible(kind, count):
    """Both are checked by arithmetic alone: the tensions hold the load, or a combination of cables
    excludes it. Then the wrench error is least."""
    structure, load, lower, upper = random_items(kind, count)
    proof = feasible(structure, load, lower, upper)
    weights = np.linspace(1, 2, load.shape[1])
    held = least_norm(structure, load, lower, upper)
    assert_array_equal(proof.status, held.status)
    fails = proof.status == INFEASIBLE
    nearest = least_action(structure, load, lower, 1e-3, 0.0, upper, weights=weights)
    for k in np.flatnonzero(fails)[:10]:
        matrix = -weights[:, None] * structure[k].T
        best = lsq_linear(matrix, weights * load[k], (lower[k], upper[k]), "bvls").cost
        error = missing(structure, load, nearest.tensions)[k]
        assert np.sum((weights * error) ** 2) / 2 == pytest.approx(best, rel=1e-4, abs=1e-4)
    assert 0.001 < fails.mean() < 0.95
    assert np.all(fails | (proof.status == HELD))
    assert np.abs(missing(structure, load, held.tensions)[~fails]).max() < 1e-6
    assert np.all((held.tensions >= lower) & (held.tensions <= upper))
    pulls = proof.coefficients
    most = np.sum(pulls * np.where(pulls > 0, upper, lower), axis=1)
    for k in np.flatnonzero(fails):  # g = −S y, and all tensions that hold the load have g·T = y·w
        direction, *_ = np.linalg.lstsq(-structure[k], pulls[k])
        assert_allclose(-structure[k] @ direction, pulls[k], atol=1e-9)
        assert direction @ load[k] > most[k]
    assert np.all(np.count_nonzero(pulls, axis=1) <= pulls.shape[1] - load.shape[1] + 1)
    assert not pulls[~fails].any()


def test_tensions_are_continuous_along_a_motion():
    """The exact least largest action jumps on this motion, by the same amount at every rate."""
    fields = {"reach": [3.0, 0.8, 0.15], "acceleration": [3.0, 3.0, 1.0]}
    loop = find_trajectory({"name": "loop-spatial", "seed": 4, **fields}, 6)
    changes = []
    for rate in (500, 2000):
        shift = loop(np.arange(0, loop.duration, 1 / rate))
        motion = COGIRO.home + shift.position, shift.velocity, shift.acceleration
        structure = textbook.jacobian(COGIRO, motion[0])
        load = textbook.load(COGIRO, 200.0, *motion)
        tensions = least_action(structure, load, 50.0, 2e-4, 0.0, 5000.0).tensions
        changes.append(np.abs(np.diff(tensions, axis=0)).max())
    assert changes[1] < 0.3 * changes[0]


@each_kind
def test_central_tensions_are_the_least_of_their_function(kind):
    """By its gradient along the tensions that hold the load. Excludes a barrier of another weight,
    and a search that stops early."""
    structure, load, lower, upper = held_items(kind, 60)
    slope = 1 / upper
    tensions = unchecked_central(structure, load, lower, slope, 0.05)
    assert_allclose(load + np.einsum("kci,kc->ki", structure, tensions), 0, atol=1e-6)
    actions = slope * tensions + 0.05
    gradient = slope * actions
    for sign, distance in ((-1, actions - slope * lower - 0.05), (1, 1 - actions)):
        least = 0.1 * BARRIER
        inside = 1 / np.maximum(distance, least)
        outside = (2 - distance / least) / least
        gradient += sign * BARRIER * slope * np.where(distance > least, inside, outside)
    for k, rows in enumerate(structure):
        balance, *_ = np.linalg.lstsq(rows, gradient[k], rcond=None)
        assert_allclose(rows @ balance, gradient[k], atol=1e-7 * np.abs(gradient[k]).max())


def test_impossible_structures_have_finite_tensions():
    structure, _, lower, upper = random_items(COGIRO, 3)
    load = -np.einsum("kci,kc->ki", structure, (lower + upper) / 2)
    structure[0, :, 3] = structure[0, :, 0]
    load[0, 3] = load[0, 0] + 10.0
    upper[1, 2] = lower[1, 2] - 7.0
    for solution in (
        least_norm(structure, load, lower, upper),
        least_action(structure, load, lower, 1e-3, 0.0, upper),
    ):
        assert solution.status.tolist() == [SINGULAR, INFEASIBLE, HELD]
        assert np.all(np.isfinite(solution.tensions))
        assert np.all(solution.tensions >= lower)
    proof = feasible(structure, load, lower, upper)
    assert proof.status.tolist() == [SINGULAR, INFEASIBLE, HELD]
    assert np.isnan(largest_scale(structure[0], load[0], load[0], 0.0, 1.0, 1.0).largest)
