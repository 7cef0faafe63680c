"""Learned policies without training: network, bundle and batches."""

import dataclasses
import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles.episodes import ROBOTS
from steering import (
    PLANAR_ID,
    bundle_of,
    network_of,
    observations,
    run,
    springs,
    steering_of,
    tasks_of,
)

from cablebot_baselines.learned.base import Base
from cablebot_baselines.learned.bundle import FORMAT, Bundle
from cablebot_baselines.learned.network import Network
from cablebot_baselines.learned.policy import LearnedPolicy
from cablebot_baselines.learned.steering import Shift
from cablebot_gym.benchmark.policy_source import policy_source
from cablebot_gym.benchmark.suites import find_policies
from cablebot_gym.policies import load_policy
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL
from cablebot_gym.task import ErrorBounds
from cablebot_gym.utils.code_hash import source_files


@pytest.fixture
def saved(tmp_path):
    """File of the planar bundle."""
    path = tmp_path / "bundle.zip"
    bundle_of().save(path)
    return path


@pytest.mark.landing
def test_motion_of_a_base_alone_is_the_task_soon():
    """Later for the camera, which starts ten times as far below its motion."""
    camera = Bundle.of_steering("CableBot-Point-v0", steering_of("CableBot-Point-v0")).base_alone
    assert camera.action_mapping.action_period == pytest.approx(0.1**0.5)
    bundle = springs(action_period=1.0)
    assert bundle.base_alone.action_mapping.action_period == pytest.approx(0.1)
    alone = LearnedPolicy(bundle.base_alone, FLEX_SPATIAL)
    law = bundle.base.make(FLEX_SPATIAL)
    rows, tasks = observations(bundle.env_id, 300)
    alone.reset(tasks)
    law.reset(tasks)
    assert_allclose(run(alone, rows)[-50:], run(law, rows)[-50:], rtol=0, atol=1e-9)


def test_zero_network_equals_the_base_law():
    """Of the planar robot, which starts on its reference."""
    bundle = bundle_of(scale=0.0)
    robot = ROBOTS[bundle.env_id]
    rows, tasks = observations(bundle.env_id, 30)
    policy = LearnedPolicy(bundle, robot)
    law = bundle.base.make(robot)
    policy.reset(tasks)
    law.reset(tasks)
    assert_array_equal(run(policy, rows), run(law, rows))


def test_tasks_of_a_batch_have_the_same_error_bounds():
    policy = LearnedPolicy(bundle_of(), PLANAR)
    tasks = [*tasks_of(PLANAR_ID), *tasks_of(PLANAR_ID, error_bounds=ErrorBounds(position=0.02))]
    with pytest.raises(ValueError, match="same error bounds and control frequency"):
        policy.reset(tasks)


def test_saved_bundle_equals_the_bundle(tmp_path):
    bundle = springs()
    path = tmp_path / "made" / "bundle.zip"
    bundle.save(str(path))
    loaded = Bundle.load(str(path))
    for name in ("env_id", "base", "action_mapping", "features", "card"):
        assert getattr(loaded, name) == getattr(bundle, name)
    loaded.save(tmp_path / "again.zip")
    assert (tmp_path / "again.zip").read_bytes() == path.read_bytes()


def test_policy_of_a_file_has_the_given_robot(saved):
    heavier = PLANAR.replace(mass=1.2, name="heavier")
    policy = load_policy(str(saved), heavier)
    assert policy.robot is heavier
    with pytest.raises(ValueError, match="evaluate it on the environment that it was trained on"):
        load_policy(str(saved), SPATIAL)


def test_invalid_bundle_is_rejected(saved):
    """Also one whose arrays would be unpickled, which could execute code."""
    content = saved.read_bytes()
    with np.load(saved) as file:
        arrays = {name: file[name] for name in file.files}
    data = json.loads(str(arrays["bundle"]))
    newer = data | {"format": FORMAT + 1}
    fewer = data | {"observation": data["observation"][1:]}
    for name, array, message in (
        ("bundle", np.array(json.dumps(newer)), "is newer than 1: upgrade"),
        ("bundle", np.array(json.dumps(fewer)), "but its environment has"),
        ("weight0", np.full_like(arrays["weight0"], np.nan), "numbers must be finite"),
        ("mean", np.array([print], object), "allow_pickle=False"),
    ):
        with saved.open("wb") as file:
            np.savez_compressed(file, **arrays | {name: array})
        with pytest.raises(ValueError, match=f"policy bundle '.*' cannot be used: .*{message}"):
            Bundle.load(saved)
    saved.write_bytes(content[: len(content) // 2])
    with pytest.raises(ValueError, match="policy "):
        load_policy(str(saved), PLANAR)


NETWORK = network_of(steering_of())


@pytest.mark.parametrize(
    "make",
    [
        lambda: Shift(action_period=0),
        lambda: Base(gains=(1, -1)),
        lambda: Base(law="motor-pd", gains=(1, 1)),
        lambda: Base(law="composite").make(PLANAR),
        lambda: steering_of(features=("motor_angle",)),
        lambda: dataclasses.replace(NETWORK, biases=NETWORK.biases[::-1]),
        lambda: dataclasses.replace(NETWORK, mean=np.zeros(3)),
        lambda: dataclasses.replace(NETWORK, scale=0 * NETWORK.scale),
    ],
)
def test_invalid_parameters_are_rejected(make):
    words = r"must|unknown|has no|requires|needs|missing|given|inconsistent"
    with pytest.raises(ValueError, match=words):
        make()


def test_network_equals_its_layers():
    draw = np.random.default_rng(0)
    weights = (draw.normal(size=(3, 2)), draw.normal(size=(4, 3)))
    layers = {"weights": weights, "biases": (np.full(3, 0.1), np.full(4, -0.2))}
    layers |= {"mean": np.array([1.0, 2.0]), "scale": np.array([2.0, 1e-9])}
    # The second input has a scale of nearly zero: it is clipped.
    expected = weights[1] @ np.tanh(weights[0] @ [1.0, -10.0] + 0.1) - 0.2
    assert_allclose(Network(**layers)([3.0, 1.0]), expected, rtol=1e-12)


def test_code_of_a_bundle_is_that_of_its_policy(saved):
    """Stored results depend on it."""
    assert find_policies([str(saved)], [PLANAR_ID]) == {PLANAR_ID: (str(saved),)}
    loaders, files = policy_source(str(saved))
    assert files == (saved,)
    modules = source_files(*loaders)
    assert "cablebot_baselines.learned.steering" in modules
    assert "cablebot_baselines.laws.flexible" in modules
    assert "cablebot_baselines.learned.vec_env" not in modules
