"""Random loops: curves from seeds, smooth, at rest at the ends, within their bounds and
feasible."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from cablebot_gym.bounds.closed_form import exact_payload
from cablebot_gym.robots import PLANAR, SPATIAL
from cablebot_gym.task import to_jsonable
from cablebot_gym.trajectories import (
    FIRST_HELD_OUT_SEED,
    TRAINING_SEEDS,
    TRAJECTORIES,
    BetweenDwells,
    find_trajectory,
    held_out_seeds,
)

GROUPS = {2: [[0, 1]], 3: [[0, 1], [2]], 6: [[0, 1], [2], [3, 4, 5]]}

names = st.sampled_from(["loop-planar", "loop-spatial", "loop-point"])
seeds = st.integers(0, 2 * FIRST_HELD_OUT_SEED) | st.integers(0, 10**40)


@settings(max_examples=20)
@given(name=names, seed=seeds)
def test_curve_is_closed_and_within_its_bounds(name, seed):
    """Each group uses its reach, and one of them its acceleration."""
    motion = loop(name, seed)
    reach = np.array(motion.reach)
    limit = np.array(motion.acceleration)
    path = motion(np.linspace(0, motion.duration, 1501))
    assert_allclose(path.position[0], path.position[-1], rtol=0, atol=1e-12)
    away = norms(motion, path.position - np.array(motion.center)).max(axis=0)
    assert np.all((away <= 1.001 * reach) & (away >= 0.25 * reach))
    assert np.all(np.ptp(path.position, axis=0) > 0)
    assert 0.58 <= (norms(motion, path.acceleration).max(axis=0) / limit).max() <= 1.001
    speed = norms(motion, path.velocity).max(axis=0)
    assert np.all(speed <= np.sqrt(2.002 * reach * limit))  # Landau
    assert motion.duration == round(motion.duration, 2)
    between = find_trajectory(json.loads(json.dumps(to_jsonable(motion))), motion.coordinates)
    assert between == BetweenDwells(motion=motion)


def loop(name, seed, **fields):
    """A named loop without its dwells."""
    return TRAJECTORIES[name](seed=seed, **fields).motion


def norms(motion, values):
    """Norms by groups, (..., groups)."""
    groups = GROUPS[motion.coordinates]
    return np.stack([np.linalg.norm(values[..., group], axis=-1) for group in groups], axis=-1)


# --- one seed, one curve ------------------------------------------------------------------------------------------

GOLDEN = [
    ("loop-planar", 0, 1.78, [0.020319727845268427, -0.03715468184376407]),
    ("loop-planar", 10000, 1.61, [-0.052613588669482375, -0.06707021055852484]),
    (
        "loop-spatial",
        10000,
        2.09,
        [
            -0.07597230559126,
            0.01431028872318,
            0.09068707051714,
            0.08946581209068,
            0.11304240397265,
            0.09547381370340,
        ],
    ),
]


@pytest.mark.parametrize(("name", "seed", "duration", "pose"), GOLDEN)
def test_seed_gives_the_recorded_curve(name, seed, duration, pose):
    motion = loop(name, seed)
    assert motion.duration == duration
    assert_allclose(motion(0.4 * duration).position, pose, rtol=0, atol=1e-13)


# --- shape --------------------------------------------------------------------------------------------------------


def test_seeds_and_fields_determine_the_curve():
    assert [*TRAINING_SEEDS[:2], *held_out_seeds(2)] == [0, 1, 10000, 10001]
    seeds = (0, 1, 9999, 10000, 10001, 2**64, 2**128, 2**200)
    fields = {
        "center": (0, 0, 0.2, 0, 0, 0),
        "reach": (0.05, 0.02, 0.01),
        "acceleration": (5, 1, 1),
        "duration": 1.5,
    }
    motions = [loop("loop-spatial", seed) for seed in seeds]
    motions += [loop("loop-spatial", 0, **{field: value}) for field, value in fields.items()]
    poses = np.array([motion(0.5).position for motion in motions])
    assert len(np.unique(poses.round(4), axis=0)) == len(poses)


# --- possible -----------------------------------------------------------------------------------------------------

SAMPLE = [*range(0, 4), *held_out_seeds(4), 1066, 1290, 10425, 10674, 11355, 11476]
"""The first of both sets, and the hardest that were met among 4000."""


@pytest.mark.parametrize("robot", [PLANAR, SPATIAL], ids=lambda robot: robot.name)
def test_rigid_robots_of_the_paper_can_follow_the_loops(robot):
    name = f"loop-{robot.name}"
    payloads = []
    for seed in SAMPLE:
        motion = loop(name, seed)
        result = exact_payload(robot, motion, minimum_tension=5.0, grid=250)
        payloads.append(result.payload)
        assert result.lowest <= -0.3
        assert 0.8 <= motion.duration <= 3.5
    assert min(payloads) >= 0.3
    assert np.percentile(payloads, 90) > 1.5 * np.percentile(payloads, 10)
    assert max(payloads) <= 10


# --- errors -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [True, -1, 3.0])
def test_invalid_seed_or_count_raises(value):
    with pytest.raises(ValueError, match=r"seed must be an integer of at least 0, not "):
        find_trajectory({"name": "loop-planar", "seed": value}, 2)
    with pytest.raises(ValueError, match="count must be an integer of at least 1"):
        held_out_seeds(value)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"reach": [0.1]}, "reach must be 3 numbers"),
        (
            {"acceleration": [1, -1, 1]},
            "acceleration must be finite and greater than 0",
        ),
        ({"duration": 0}, "duration must be"),
        ({"speed": 2}, "speed"),
    ],
)
def test_unphysical_field_raises(fields, message):
    with pytest.raises(ValueError, match=message):
        find_trajectory({"name": "loop-spatial", **fields}, 6)
