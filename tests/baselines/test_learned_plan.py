"""Networks that plan motions: what a plan promises, its training and its policies."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch
from driving import drive
from numpy.testing import assert_allclose
from oracles.plants import each_of

from cablebot_baselines.learned import plan_training
from cablebot_baselines.learned.learned_plan import learned_plan
from cablebot_baselines.learned.network_program import NetworkProgram
from cablebot_baselines.learned.plan_network import PlanNetwork, control_points, no_moves
from cablebot_baselines.learned.plan_space import PlanSpace
from cablebot_baselines.learned.refinement import refined
from cablebot_baselines.learned.shipped import weights_of
from cablebot_baselines.learned.shipped_plans import LEARNED_PLAN
from cablebot_baselines.planners.trajopt import exact_margins
from cablebot_gym.envs import env_robot
from cablebot_gym.motions import find_trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.planning import MarginProfile, Margins
from cablebot_gym.policies import load_policy
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, find_robot
from cablebot_gym.task import find_error_bounds

pytestmark = pytest.mark.usefixtures("one_thread")

IDS = {find_robot(env_robot(env_id)): env_id for env_id in LEARNED_PLAN.env_ids}
MARGINS = Margins(position=5e-4, rotation=5e-4, action=0.02, tension=2.0)


SEED = 50_000
"""Seed of a motion that no network was trained on."""


def loop(robot):
    return find_trajectory({"name": f"loop-{robot.kind}", "seed": SEED}, robot.kind)


def space_of(robot):
    return PlanSpace(robot, find_error_bounds(None, robot))


def network_of(robot, space):
    """The shipped network."""
    return PlanNetwork.of_weights(space, torch.load(weights_of(robot, "plan"), weights_only=True))


def plan_of(robot, margins=MARGINS):
    space = space_of(robot)
    network = network_of(robot, space)
    return NetworkProgram(network, space, loop(robot), margins=margins, lightest=0.0).solve()


@each_of(*IDS)
def test_spline_follows_the_reference_from_the_start_of_the_task(robot):
    space = space_of(robot)
    margins = space.node_margins(Margins(), None, loop(robot).duration)
    payloads = torch.tensor([[0.0, 1.0]], dtype=torch.float64)
    query = space.query(space.problem(loop(robot)), payloads, margins)
    points = control_points(space, query, no_moves(query))
    assert space.error_excess(query, space.errors.poses(points)).max() < 0.0
    pose, velocity, *_ = space.stages.orders(
        points[..., : robot.coordinates], query.problem.duration
    )
    reference = loop(robot)(space.stages.instants * query.problem.duration.item())
    later = space.stages.instants > 0.2
    assert_allclose(pose[0, later].numpy(), reference.position[later], atol=2e-3)
    assert_allclose(velocity[0, later].numpy(), reference.velocity[later], atol=0.1)


def test_margins_over_time_count_where_they_are():
    space = space_of(SPATIAL)
    times = np.linspace(0.0, 1.0, 101)
    profile = MarginProfile.zeros(times, SPATIAL.cables)
    profile = replace(profile, action=profile.action + (times == 0.5)[:, None] * 0.1)
    margins = space.node_margins(MARGINS, profile, 1.0)[0].numpy()
    near = np.abs(space.nodes - 0.5) < 0.01
    assert_allclose(margins[near, 3:], 0.12)
    assert_allclose(margins[np.abs(space.nodes - 0.5) > 0.05, 3:], 0.02)
    assert_allclose(margins[:, 2], 2.0 / space.tension)
    assert_allclose(margins[:, 0], 5e-4 / space.error_bounds.position)


@pytest.mark.usefixtures("exact_plans_only")
@pytest.mark.landing
@each_of(*IDS)
def test_plan_keeps_its_limits_on_an_exactly_known_robot(robot):
    """With its payload and without, on a motion that the network was not trained on."""
    margins = exact_margins(robot, find_error_bounds(None, robot))
    plan = plan_of(robot, margins)
    policy = learned_plan(robot, weights_of(robot, "plan"))
    motion = {"name": f"loop-{robot.kind}", "seed": SEED}
    payload = np.array([0.0, plan.payload])
    env = gym.make_vec(IDS[robot], num_envs=2, payload=payload, trajectory=motion)
    assert not np.any([step.info["violated"] for step in drive(policy, env)])
    assert policy.fallbacks == 0


@pytest.mark.landing
def test_light_platform_keeps_its_pose_with_errors_of_motors():
    """Whose payload is unknown, and much heavier than itself."""
    robot = find_robot("ttk4900")
    policy = learned_plan(robot, weights_of(robot, "plan"))
    env = gym.make_vec(
        IDS[robot],
        num_envs=4,
        payload=np.array([0.0, 0.0, 1.2, 1.2]),
        payload_known=False,
        uncertainty="hardware",
        trajectory={"name": f"loop-{robot.kind}", "seed": SEED},
    )
    assert not np.any([step.info["violated"] for step in drive(policy, env)])
    assert policy.fallbacks == 0


@pytest.mark.landing
@each_of(FLEX_PLANAR, FLEX_SPATIAL)
def test_motor_angles_balance_the_platform_along_the_plan(robot):
    plan = plan_of(robot, Margins())
    times = np.linspace(0.2, plan.duration - 0.2, 50)
    planned = plan(times)
    pulley = textbook.pulley_angle(robot, planned.position)
    for payload in (0.0, plan.payload):
        angle, *_ = plan.motor_motion(times, np.full(50, payload))
        derivatives = planned.position, planned.velocity, planned.acceleration
        speed, second = (
            textbook.pulley_speed(robot, *derivatives[:2]),
            textbook.pulley_acceleration(robot, *derivatives),
        )
        friction = textbook.motor_torques(robot, np.zeros((50, robot.cables)), speed, second)
        tensions = (robot.stiffness * (angle - pulley) - friction) / robot.pulley_radius
        wrench = -np.einsum("tmn,tm->tn", textbook.jacobian(robot, planned.position), tensions)
        load = textbook.load(robot, np.full(50, robot.mass + payload), *derivatives)
        assert np.abs(wrench - load).max() < 0.02 * np.abs(load).max()


@pytest.mark.landing
def test_refinement_removes_violations_and_keeps_the_start():
    """Of a payload that is a little too heavy for the network alone."""
    space = space_of(PLANAR)
    payload = 1.02 * plan_of(PLANAR).payload
    margins = space.node_margins(MARGINS, None, loop(PLANAR).duration)
    payloads = torch.tensor([[0.0, payload]], dtype=torch.float64)
    query = space.query(space.problem(loop(PLANAR)), payloads, margins)
    points, _ = network_of(PLANAR, space).plan(query)
    after = refined(space, query, points)
    sizes = [max(map(torch.max, space.violations(query, x, space.checks))) for x in (points, after)]
    assert sizes[1] < 0.5 * sizes[0]
    assert torch.equal(after[:, : space.fixed], points[:, : space.fixed])


def test_file_of_a_training_is_a_policy():
    """Files of torch and of Stable-Baselines3 end in .zip."""
    policy = load_policy(str(weights_of(PLANAR, "plan")), PLANAR)
    assert policy.planner.name == "learned-plan"


def test_robot_with_two_redundant_cables_raises():
    with pytest.raises(ValueError, match="a network plans for at most one"):
        space_of(find_robot("cogiro"))


@pytest.fixture
def few_motions(monkeypatch):
    monkeypatch.setattr(plan_training, "MOTIONS", 4)
    monkeypatch.setattr(plan_training, "BATCH", 2)
    monkeypatch.setattr(plan_training, "HELD_OUT", range(10_000, 10_001))
    monkeypatch.setattr(plan_training, "PARTS", 2)


@pytest.mark.usefixtures("few_motions")
@pytest.mark.landing
def test_continued_training_gives_the_weights_of_a_single_run(tmp_path):
    env_id = IDS[PLANAR]
    payloads = plan_training.train_plans(env_id, out=tmp_path / "whole", steps=2)
    part = plan_training.PlanTraining(space_of(PLANAR), steps=2, seed=0)
    part.learn()
    (tmp_path / "broken").mkdir()
    part.save(tmp_path / "broken")
    plan_training.train_plans(env_id, out=tmp_path / "broken", steps=2)
    whole, broken = (
        torch.load(tmp_path / name / "plan.zip", weights_only=True) for name in ("whole", "broken")
    )
    for name, values in whole.items():
        assert torch.equal(values, broken[name])
    rows = np.loadtxt(tmp_path / "whole" / "progress.csv", delimiter=",", skiprows=1)
    assert rows[0, 0] == 1
    assert rows[-1, 2:].tolist() == payloads
    for other in ({"env_id": IDS[SPATIAL]}, {"seed": 1}, {"steps": 3}):
        settings = {"env_id": env_id, "steps": 2} | other
        with pytest.raises(ValueError, match="'planar', seed 0 and 2 steps: choose another --out"):
            plan_training.train_plans(**settings, out=tmp_path / "whole")


@pytest.mark.usefixtures("few_motions")
@pytest.mark.landing
def test_training_raises_payloads(monkeypatch):
    monkeypatch.setattr(plan_training, "MOTIONS", 16)
    monkeypatch.setattr(plan_training, "BATCH", 8)
    training = plan_training.PlanTraining(space_of(PLANAR), steps=150, seed=0)
    before = np.median(training.curve())
    for _ in range(150):
        training.learn()
    assert np.median(training.curve()) > 1.2 * before
