"""Random loops: curves from seeds, smooth or with jumps, at rest at the ends, and within their
bounds."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from cablebot_gym.motions import (
    FIRST_HELD_OUT_SEED,
    TRAINING_SEEDS,
    TRAJECTORIES,
    held_out_seeds,
)

GROUPS = {2: [[0, 1]], 3: [[0, 1], [2]], 6: [[0, 1], [2], [3, 4, 5]]}

names = st.sampled_from(["loop-planar", "loop-spatial", "loop-point"])
seeds = st.integers(0, 2 * FIRST_HELD_OUT_SEED) | st.integers(0, 10**40)


@settings(max_examples=20)
@given(name=names, seed=seeds)
def test_curve_is_closed_and_within_its_bounds(name, seed):
    """Each group uses its reach, and one of them its acceleration. It starts near its start. Of odd
    seeds, the acceleration jumps half way and at the ends."""
    motion = loop(name, seed)
    reach = np.array(motion.reach)
    limit = np.array(motion.acceleration)
    path = motion(np.linspace(0, motion.duration, 1501))
    assert_allclose(path.position[0], path.position[-1], rtol=0, atol=1e-12)
    away = norms(motion, path.position - np.array(motion.center)).max(axis=0)
    assert np.all((away <= 1.001 * reach) & (away >= 0.25 * reach))
    assert np.all(np.ptp(path.position, axis=0) > 0)
    assert 0.78 <= (norms(motion, path.acceleration).max(axis=0) / limit).max() <= 1.001
    speed = norms(motion, path.velocity).max(axis=0)
    assert np.all(speed <= np.sqrt(2.002 * reach * limit))  # Landau
    assert motion.duration == round(motion.duration, 2)
    to_start = np.sum((norms(motion, path.position - np.array(motion.start)) / reach) ** 2, axis=1)
    assert to_start[0] <= to_start.min() + 1e-3
    half = motion.duration / 2
    before, after = motion([half, half + 1e-9]).acceleration
    assert motion.jumps == (seed % 2 == 1)
    assert (np.linalg.norm(after - before) > 0.01 * limit.max()) == motion.jumps
    assert_allclose(path.velocity[[0, -1]], 0, atol=1e-12)
    assert (np.abs(path.acceleration[[0, -1]]).max() > 1e-6) == motion.jumps


def loop(name, seed, **fields):
    """A named loop without its dwells."""
    return TRAJECTORIES[name](seed=seed, **fields).motion


def norms(motion, values):
    """Norms by groups, (..., groups)."""
    groups = GROUPS[motion.coordinates]
    return np.stack([np.linalg.norm(values[..., group], axis=-1) for group in groups], axis=-1)


# --- one seed, one curve ------------------------------------------------------------------------------------------


def test_seed_gives_the_recorded_curve():
    """Excludes another motion under a seed of stored results."""
    motion = loop("loop-spatial", 10000)
    assert motion.duration == 0.97
    position = [-0.04840323138804, -0.01451561751411, 0.11035072218125]
    angles = [-0.00131438505111, 0.00636161934725, 0.00585017770195]
    pose = motion(0.4 * motion.duration).position
    assert_allclose(pose, position + angles, rtol=0, atol=1e-13)


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
