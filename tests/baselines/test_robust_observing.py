"""Robust control with computed gains: margins, bounds and tensions by independent calculations."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from driving import drive
from numpy.testing import assert_allclose
from oracles.episodes import ROBOTS
from scipy.linalg import solve_continuous_lyapunov
from tasks import tasks_of

from cablebot_baselines.laws import BoundedRobustPD, Observing
from cablebot_baselines.laws.robust_design import RobustDesign
from cablebot_baselines.observer.expectation import Expectation
from cablebot_gym.uncertainty import find_uncertainty

PERIOD = 2e-3


def design(env_id, payload=2.0, **changes):
    robot = ROBOTS[env_id]
    expectation = Expectation.of(robot, find_uncertainty("hardware", robot))
    task, _ = tasks_of(env_id)
    return RobustDesign(
        expectation=replace(expectation, **changes), task=task, largest_payload=payload
    )


@pytest.mark.parametrize("env_id", ["CableBot-Spatial-v0", "CableBot-FlexSpatial-v0"])
def test_open_loop_has_its_margins(env_id):
    """Over all frequencies, to the accuracy of the formulas; gain and resonance are those of
    springs."""
    made = design(env_id)
    shortest, longest = made.expectation.effect_times(PERIOD)
    dead = (longest - shortest) / 2 + PERIOD / 2
    stiffness, damping = made.outer.gains
    s = 1j * np.linspace(1.0, 1000.0, 200_000)
    loop = (damping * s + stiffness) / s**2 * np.exp(-s * dead)
    if made.robot.flexible:
        omega = made.spring_frequency
        loop /= (s / omega) ** 2 + made.spring_damping * s / omega + 1
        assert np.abs(loop[np.argmin(np.abs(s - 1j * omega))]) == pytest.approx(0.5, rel=0.02)
    phase = np.unwrap(np.angle(loop))
    assert 55 < np.degrees(np.pi + phase[np.abs(loop) > 1][-1]) < 65
    assert np.abs(loop[np.argmax(phase < -np.pi)]) < 0.6


@pytest.mark.parametrize(
    ("field", "bound"),
    [
        ("mass_spread", "zeta"),
        ("payload_spread", "zeta"),
        ("strength_spread", "phi"),
        ("friction_spread", "phi"),
        ("wrench_spread", "phi"),
        ("strength_spread", "minimum_tension"),
        ("inertia_spread", "minimum_tension"),
        ("damping_spread", "minimum_tension"),
    ],
)
def test_larger_uncertainty_has_larger_bounds(field, bound):
    env_id = "CableBot-Planar-v0"
    made = design(env_id)
    wider = design(env_id, **{field: 3 * getattr(made.expectation, field)})
    assert np.all(np.asarray(getattr(wider, bound)) >= getattr(made, bound))
    assert np.max(getattr(wider, bound)) > np.max(getattr(made, bound))


def test_bounds_contain_the_masses_of_all_payloads():
    made = design("CableBot-Planar-v0", payload=6.0)
    masses = made.robot.mass + np.linspace(0.0, 6.0, 7)
    assert np.all(np.abs(masses / made.mass - 1) <= made.zeta)


def loop_and_errors(size, mass_error):
    """Outer loop, and blocks with errors of a size on robots in space."""
    outer = BoundedRobustPD(
        stiffness=20.0, zeta=mass_error, phi=(2.0, 3.0), gravity=np.array([0.0, 0.0, 9.81])
    )
    rng = np.random.default_rng(0)
    names = ("reference_pose", "reference_velocity", "reference_acceleration")
    blocks = {name: size * rng.normal(size=(200, 6)) for name in names}
    return outer, blocks | {"pose": np.zeros((200, 6)), "velocity": np.zeros((200, 6))}


def test_law_inside_the_layer_is_pd_of_the_largest_stiffness():
    outer, blocks = loop_and_errors(1e-4, 0.3)
    stiffness, damping = outer.gains
    expected = blocks["reference_acceleration"] + stiffness * blocks["reference_pose"]
    assert_allclose(outer(blocks), expected + damping * blocks["reference_velocity"], rtol=1e-9)


def test_lyapunov_function_decreases_outside_the_layer_for_the_worst_errors():
    """Eq. 35 by SciPy. The masses are at both ends of the bound, and the forces of size φ push
    along the errors. Platforms much heavier than their model need ζ > 1."""
    for zeta in (0.3, 1.5):
        outer, blocks = loop_and_errors(3.0, zeta)
        soft = outer.stiffness / 2
        slope = (outer.stiffness + soft) / 2
        system = np.array([[0.0, 1.0], [-(soft**2), -2 * soft]])
        q = np.diag([2 * soft**2 * slope, 4 * soft - 2 * slope])
        p = solve_continuous_lyapunov(system.T, -q)
        assert_allclose(p[1], [slope, 1.0])
        errors = np.stack([blocks["reference_pose"], blocks["reference_velocity"]], axis=-1)[:, :3]
        s = errors @ p[1]
        direction = s / np.linalg.norm(s, axis=-1, keepdims=True)
        requested = outer(blocks)[:, :3]
        for ratio in (max(1 - zeta, 0.01), 1 + zeta):  # m/m̂
            force = -outer.phi[0] * direction
            true = (requested - outer.gravity + force) / ratio + outer.gravity
            second = blocks["reference_acceleration"][:, :3] - true
            rates = np.stack([errors[..., 1], second], axis=-1)
            decrease = 2 * np.sum(errors * (rates @ p), axis=(-2, -1))
            assert np.all(decrease <= -np.sum(errors * (errors @ q), axis=(-2, -1)) + 1e-9)


def test_task_of_one_motion_serves_all_episodes_of_a_batch():
    law = Observing(ROBOTS["CableBot-Planar-v0"])
    tasks = tasks_of("CableBot-Planar-v0")
    observation, _ = gym.make("CableBot-Planar-v0").reset(seed=0)
    law.reset(tasks[:1])
    alone, _ = law.predict(observation)
    actions, _ = law.predict(np.stack([observation, observation]))
    assert_allclose(actions, [alone, alone])


def test_saturated_row_has_the_bounds_of_its_own_motion():
    robot = ROBOTS["CableBot-Planar-v0"]
    tasks, observations = [], []
    for seed in (0, 5):
        env = gym.make("CableBot-Planar-v0", trajectory={"name": "loop-planar", "seed": seed})
        observations.append(env.reset(seed=0)[0])
        tasks.append(env.unwrapped.task)
    observations[1][:2] += 0.3  # far from its reference
    law = Observing(robot)
    law.reset(tasks)
    together, state = law.predict(np.stack(observations))
    assert (np.abs(state.requested) > 1).any(axis=1).tolist() == [False, True]
    law.reset(tasks[1:])
    alone, _ = law.predict(observations[1])
    assert_allclose(together[1], alone, atol=1e-12)


def test_robot_that_holds_every_payload_can_be_prepared():
    """At rest in a horizontal plane no payload is the largest one."""
    Observing(ROBOTS["CableBot-Planar-v0"]).reset(
        tasks_of("CableBot-Planar-v0", trajectory="dwell-planar")
    )


# --- robots that are far lighter than the law expects -----------------------------------------------------------------


def unloaded(env_id, seed, **keywords):
    """Random robots without payload, which is unknown, on a random loop."""
    robot = ROBOTS[env_id]
    return gym.make_vec(
        env_id,
        num_envs=19,
        payload_known=False,
        uncertainty="hardware",
        trajectory={"name": f"loop-{robot.kind}", "seed": seed},
        **keywords,
    )


@pytest.mark.parametrize(
    ("env_id", "seed"), [("CableBot-Point-v0", 61), ("CableBot-FlexPlanarPlatform-v0", 62)]
)
def test_light_platform_on_redundant_cables_starts_taut(env_id, seed):
    """A law that expects half of the largest payload lifts it, and the stop slackens the cables."""
    steps = drive(Observing(ROBOTS[env_id]), unloaded(env_id, seed), steps=8)
    assert not np.any([step.info["violated"] for step in steps])


@pytest.mark.landing
@pytest.mark.parametrize("env_id", ["CableBot-PlanarPlatform-v0", "CableBot-FlexPlanarPlatform-v0"])
def test_light_platform_keeps_its_pose_with_errors_of_motors(env_id):
    """Within a boundary layer for the whole delay, friction turns it by half of the bound. On springs, an
    outer loop makes it swing."""
    steps = drive(Observing(ROBOTS[env_id]), unloaded(env_id, 60))
    assert not np.any([step.info["violated"] for step in steps])
