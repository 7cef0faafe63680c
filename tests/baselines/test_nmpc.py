"""The receding-horizon controller: its plans, its state, and its behaviour without a plan."""

import logging
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from driving import drive, keeps_limits
from numpy.testing import assert_allclose, assert_array_equal

pytest.importorskip("casadi")

from cablebot_baselines.planners.horizon import ExpectedRobots, HorizonProgram, Target
from cablebot_baselines.planners.horizon_tuning import TUNING
from cablebot_baselines.planners.nmpc import NMPC, NonlinearMPC
from cablebot_gym.env_ids import ENV_ROBOTS
from cablebot_gym.physics import textbook
from cablebot_gym.planning.stage_functions import TENSION
from cablebot_gym.robots import PLANAR, SPATIAL, find_robot
from cablebot_gym.task import ErrorBounds

PLANAR_ID = "CableBot-Planar-v0"
SPATIAL_ID = "CableBot-Spatial-v0"
ROBOTS = {PLANAR_ID: PLANAR, SPATIAL_ID: SPATIAL}


@pytest.fixture(scope="module")
def policies():
    return {env_id: NMPC.factory(robot) for env_id, robot in ROBOTS.items()}


def rollout(policy, env, *, steps=None):
    """Whether each episode kept its limits, largest position errors, all actions, and the last
    state."""
    is_within = np.ones(env.num_envs, np.bool_)
    peak = np.zeros(env.num_envs)
    actions = []
    for step in drive(policy, env, steps):
        actions.append(step.action)
        peak = np.maximum(peak, step.info["tracking_error_peak"])
        is_within &= keeps_limits(step.info)
    return is_within, peak, np.array(actions), step.state


def vector(env_id, count, **keywords):
    return gym.make_vec(env_id, num_envs=count, max_episode_steps=None, **keywords)


# --- payload and error bounds -----------------------------------------------------------------------------------------


@pytest.mark.landing
@pytest.mark.parametrize(("env_id", "payload"), [(PLANAR_ID, 2.6), (SPATIAL_ID, 6.4)])
def test_payload_far_beyond_that_of_the_reference_is_carried(policies, env_id, payload):
    """Laws that follow the reference exactly carry 1.9 kg and 5.0 kg."""
    env = vector(
        env_id, 3, payload=np.array([0.0, payload, payload]), payload_known=[False, True, False]
    )
    is_within, _, actions, _ = rollout(policies[env_id], env)
    assert is_within.all()
    assert policies[env_id].fallbacks == 0
    assert np.abs(actions).max() < 1.5


@pytest.mark.landing
@pytest.mark.parametrize(
    ("env_id", "seed", "payload"),
    [
        ("CableBot-FlexPlanar-v0", 61, 2.6),
        ("CableBot-Point-v0", 60, 60.0),
        ("CableBot-PlanarPlatform-v0", 60, 1.0),
    ],
)
def test_random_robots_carry_more_than_with_observing(env_id, seed, payload):
    """``observing`` carries 2.0, 55 and 0.7 kg on these motions. With a plan that starts from the platform,
    springs swing; with a horizon of 0.2 s a slow robot turns back too late; with the margins of the
    paper's robot, the cables of a light one take its motors' torque."""
    robot = find_robot(ENV_ROBOTS[env_id])
    trajectory = {"name": f"loop-{robot.kind}", "seed": seed}
    options = {"payload": np.repeat([0.0, payload], 3), "uncertainty": "hardware"}
    env = vector(env_id, 6, trajectory=trajectory, payload_known=False, **options)
    steps = drive(NMPC.factory(robot), env)
    assert not np.any([step.info["violated"] for step in steps])


@pytest.mark.landing
def test_plan_uses_the_error_bounds_of_the_task(policies):
    env = vector(PLANAR_ID, 1, payload=1.5, error_bounds={"position": 0.002})
    _, peak, *_ = rollout(policies[PLANAR_ID], env, steps=450)
    assert peak[0] < 0.002


def expected(robot):
    """One robot of 8 kg, as it is."""
    return ExpectedRobots(
        mass=np.array([8.0]),
        strength=np.ones((1, robot.cables)),
        disturbance=np.zeros((1, robot.coordinates)),
    )


# --- the program ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", ROBOTS)
def test_linearisation_has_the_slopes_of_the_textbook(policies, env_id):
    """Of tensions that balance the forces, and of the actions for them."""
    program = policies[env_id].program
    robot = program.robot
    m = robot.cables
    wave = 0.02 * np.sin(20 * program.instants)[:, None]
    plan = program._fit @ (np.array(robot.home) + wave)
    change = 1e-5 * np.random.default_rng(0).normal(size=plan.shape)
    linear = program.linearised(plan[None], expected(robot))[0]
    values = linear.values + linear.slope @ change.ravel()
    tensions = TENSION * values[:, m:]
    motion = program.basis(program.instants)[:3] @ (plan + change)
    pull = np.einsum("kmn,km->kn", textbook.jacobian(robot, motion[0]), tensions)
    load = textbook.load(robot, 8.0, *motion)
    assert_allclose(pull, -load, atol=1e-5 * np.abs(load).max())
    torques = textbook.required_torques(robot, tensions, *motion)
    speeds = textbook.pulley_speed(robot, *motion[:2])
    actions = textbook.normalised_action(robot, torques, speeds)
    assert_allclose(values[:, :m], actions, atol=1e-5)


@pytest.mark.parametrize("name", ["planar", "spatial", "flex-planar"])
def test_start_of_the_last_part_counts_as_if_known_before(name):
    """To first order, where the objective is quadratic in the actions."""
    robot = find_robot(name)
    tuning = replace(TUNING[robot.joints][robot.kind], action_exponent=2.0)
    program = HorizonProgram(robot, tuning)
    home = np.array(program.robot.home)
    zero = np.zeros_like(home)
    reference = np.tile(home, (len(program.instants), 1))
    target = Target(reference=reference[None], last_velocity=zero[None], error_bounds=ErrorBounds())
    start = np.tile(zero, (1, program.given, 1))
    start[:, 0] = home + 1e-4
    start[:, 1] = 1e-3
    still = (program._fit @ reference)[None]
    plans = []
    for plan in (still, program._with_start(still, start)):
        part = program.assembled(program.linearised(plan, expected(program.robot)), target)
        solved, reason = program.solved(part, start)
        assert reason == ""
        plans.append(solved)
    assert_allclose(plans[0], plans[1], atol=1e-5)


def test_program_of_a_batch_equals_that_alone(policies):
    """Rounding that depends on the batch grows where a robot swings, and the judge finds other
    episodes."""
    program = policies[SPATIAL_ID].program
    home = np.array(program.robot.home)
    random = np.random.default_rng(0)
    plans = home + 1e-3 * random.normal(size=(7, program.points, len(home)))
    reference = np.tile(home, (7, len(program.instants), 1))
    target = Target(
        reference=reference, last_velocity=np.zeros((7, len(home))), error_bounds=ErrorBounds()
    )
    robots = expected(program.robot)[np.zeros(7, int)]
    linear = program.linearised(plans, robots)
    together = program.assembled(linear, target)
    for row in range(7):
        alone = program.assembled(linear[[row]], target[[row]])
        assert_array_equal(together.gradient[row], alone.gradient[0])


# --- fallbacks --------------------------------------------------------------------------------------------------------


@pytest.fixture
def failing(monkeypatch):
    """Makes a policy whose plans number ``earliest`` to ``latest`` fail in CasADi."""

    def make(earliest, latest=10**9):
        policy = NMPC.factory(PLANAR)
        number = iter(range(10**9))
        quadratic = policy.program._quadratic
        evaluate = quadratic._evaluate

        def sometimes(*arguments):
            if earliest <= next(number) <= latest:
                raise RuntimeError("made to fail")
            return evaluate(*arguments)

        monkeypatch.setattr(quadratic, "_evaluate", sometimes)
        return policy

    return make


@pytest.mark.landing
def test_fallback_tracks_the_reference_when_all_plans_fail(failing, caplog):
    policy = failing(0)
    with caplog.at_level(logging.WARNING, logger="cablebot_gym"):
        is_within, *_ = rollout(policy, vector(PLANAR_ID, 2, payload=1.0))
    assert is_within.all()
    assert policy.fallbacks == 2 * 160
    assert len(caplog.records) == 1
    assert "made to fail" in caplog.text
    policy.reset(vector(PLANAR_ID, 2).unwrapped.tasks)
    assert policy.fallbacks == 0


@pytest.mark.landing
def test_last_plan_bridges_failures_until_its_end(failing):
    """With a payload that the reference itself does not allow."""
    policy = failing(20, 24)
    is_within, *_ = rollout(policy, vector(PLANAR_ID, 1, payload=2.5), steps=250)
    assert is_within.all()
    assert policy.fallbacks == 5
    policy = failing(1)
    state = rollout(policy, vector(PLANAR_ID, 1), steps=110)[3]
    assert np.isnan(state.memory.plan).all()


# --- invalid input ----------------------------------------------------------------------------------------------------


def test_motors_with_a_lag_and_elastic_cables_raise():
    with pytest.raises(ValueError, match="motors without lag"):
        NonlinearMPC(PLANAR.replace(motors=PLANAR.motors.replace(lag=0.01)))
    with pytest.raises(ValueError, match="rigid cables"):
        NonlinearMPC(find_robot("flex-stadium-camera"))
