"""Reset options and constructor keywords: their effects, their duration and their checks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from cablebot_gym.envs import PAPER_ENV_IDS
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL
from cablebot_gym.uncertainty import ParameterDistribution, Uncertainty

ROBOTS = {"planar": PLANAR, "spatial": SPATIAL}
IDS = {"planar": "CableBot-Planar-v0", "spatial": "CableBot-Spatial-v0"}
each_kind = pytest.mark.parametrize("kind", list(ROBOTS))


def make(kind, **keywords):
    """An environment without wrappers."""
    return gym.make(IDS[kind], **keywords).unwrapped


def episode(env, action, steps, **reset):
    """All results of a reset and of some steps with a constant action, by name."""
    observation, info = env.reset(**reset)
    seen = {"reset observation": [observation], "observation": [], "reward": [], "flags": [], "reset info": [info]}
    infos = []
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(np.full(env.action_space.shape, action))
        seen["observation"].append(observation)
        seen["reward"].append(reward)
        seen["flags"].append((terminated, truncated))
        infos.append(info)
    for key in info:
        seen[f"info {key}"] = [one[key] for one in infos]
    return seen


def differing(one, other):
    """Names of the results of two episodes that differ in any bit."""
    return {name for name in one if plain(one[name]) != plain(other[name])}


def plain(values):
    """Arrays, and infos full of arrays, as lists that compare exactly."""
    if isinstance(values, dict):
        return {name: plain(value) for name, value in values.items()}
    if isinstance(values, (list, tuple)):
        return [plain(value) for value in values]
    return values.tolist() if isinstance(values, np.ndarray) else values


def millimetre(kind):
    """Initial error of one millimetre in x."""
    return [0.001] + [0.0] * (ROBOTS[kind].coordinates - 1)


@dataclass(frozen=True)
class Case:
    """A value other than the default, the results that must change with it, and those that must not."""

    value: Any
    """A function of the kind of robot, or the value."""
    changes: tuple[str, ...]
    keeps: tuple[str, ...] = ()
    base: dict[str, Any] = field(default_factory=dict)
    """Keywords of both environments."""
    action: float = 0.3
    steps: int = 2

    def of(self, kind):
        return self.value(kind) if callable(self.value) else self.value


OPTIONS = {
    "payload": Case(2.0, ("reset observation", "observation", "reward", "info payload", "info tracking_error")),
    "payload_known": Case(
        False, ("reset observation", "observation"), ("reward", "info payload", "info tracking_error"), {"payload": 2.0}
    ),
    "model_payload_factor": Case(
        0.5,
        ("reset observation", "observation"),
        ("reward", "info payload", "info tracking_error", "info tensions"),
        {"payload": 2.0},
    ),
    "trajectory": Case(lambda kind: f"line-{kind}", ("reset observation", "observation", "reward", "info tensions")),
    "initial_error": Case(
        millimetre, ("reset observation", "observation", "reward", "info tracking_error", "reset info")
    ),
    "uncertainty": Case(
        {"parameters": {"platform_mass": {"low": 0.1, "high": 0.2}}, "sensors": {"position": 1e-4}, "delay": 1},
        ("reset observation", "observation", "reward", "info commanded_action", "info torques", "info tracking_error"),
        ("info payload", "flags"),
    ),
    "error_bounds": Case(
        {"position": 0.02, "rotation": 0.02},
        ("reward", "info reward_position"),
        ("observation",),
        {"initial_error": 0.0},  # the bound also sets the start pose of spatial robots
    ),
}
KEYWORDS = OPTIONS | {
    "payload_range": Case((1.0, 2.0), ("reset observation", "observation", "info payload")),
    "initial_error_range": Case(millimetre, ("reset observation", "observation", "info tracking_error")),
    "robot": Case(
        lambda kind: ROBOTS[kind].replace(mass=ROBOTS[kind].mass * 1.5).to_dict(),
        ("observation", "info tensions"),
        ("reset observation",),
    ),
    "cable": Case("bilateral", ("observation", "info tensions"), ("reset observation",), action=-0.3),
    "control_frequency": Case(250.0, ("observation", "info time", "info tracking_error")),
    "substeps": Case(7, ("observation",), ("reset observation", "info time"), action=0.5, steps=5),
    "termination_radius": Case(1e-6, ("flags", "reward", "info termination_reason"), ("observation",)),
    "slack_time": Case(0.0, ("flags", "info termination_reason"), ("observation",), action=-0.3),
    "reward_weights": Case({"position": 3.0}, ("reward", "info reward_position"), ("observation", "flags")),
}


@pytest.mark.parametrize("name", sorted(KEYWORDS.keys() - OPTIONS.keys()))
def test_constructor_keyword_has_its_effect(name):
    case = KEYWORDS[name]
    usual = episode(make("planar", **case.base), case.action, case.steps, seed=0)
    changed = episode(make("planar", **case.base, **{name: case.of("planar")}), case.action, case.steps, seed=0)
    found = differing(usual, changed)
    assert set(case.changes) <= found
    assert not set(case.keeps) & found


@each_kind
@pytest.mark.parametrize("name", list(OPTIONS))
def test_option_has_the_effect_of_its_keyword_for_one_episode(kind, name):
    case = OPTIONS[name]
    env = make(kind, **case.base)
    usual = episode(env, case.action, case.steps, seed=0)
    changed = episode(env, case.action, case.steps, seed=0, options={name: case.of(kind)})
    found = differing(usual, changed)
    assert set(case.changes) <= found
    assert not set(case.keeps) & found
    assert differing(usual, episode(env, case.action, case.steps)) == set()
    constructed = episode(make(kind, **case.base, **{name: case.of(kind)}), case.action, case.steps, seed=0)
    assert differing(changed, constructed) == set()


# ------------------------------------------------------------------------------------------------- random starts


def draws(env, count, key="payload"):
    """Payloads or start errors of the next episodes."""
    found = []
    for _ in range(count):
        observation, info = env.reset()
        part = env.layout.split(observation)
        found.append(info["payload"] if key == "payload" else part["pose"] - part["reference_pose"])
    return np.array(found)


def test_payloads_are_uniform_in_their_range_and_independent():
    env = make("planar", payload_range=(2.0, 3.0))
    env.reset(seed=0)
    found = draws(env, 400)
    assert len(set(found)) == 400
    assert 2.0 <= found.min() < 2.02
    assert 2.98 < found.max() <= 3.0
    assert found.mean() == pytest.approx(2.5, abs=4 * np.sqrt(1 / 12 / 400))
    assert abs(np.corrcoef(found[1:], found[:-1])[0, 1]) < 0.2
    assert env.reset(options={"payload": 7.0})[1]["payload"] == 7.0
    assert not set(draws(make("planar", payload_range=(2.0, 3.0)), 4)) & set(found)  # without a seed


def test_start_errors_are_uniform_within_their_half_widths():
    widths = np.array([0.002, 0.0, 0.001, 0.003, 0.0, 0.001])
    env = make("spatial", trajectory="dwell-spatial", initial_error_range=widths)
    env.reset(seed=0)
    lowered = env.task.start_pose - env.task.trajectory(0.0).position
    found = draws(env, 200, "start") - lowered
    assert np.all(np.abs(found) <= widths + 1e-15)
    np.testing.assert_allclose(np.abs(found).max(axis=0), widths, rtol=0.1)
    np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=4 * widths.max() / np.sqrt(3 * 200))
    given = make("spatial", trajectory="dwell-spatial", initial_error_range=widths, initial_error=np.full(6, 0.01))
    given.reset(seed=0)
    np.testing.assert_allclose(draws(given, 5, "start"), found[:5] + 0.01, atol=1e-15)  # in place of the start pose


@pytest.mark.parametrize("trajectory", ["circle", "paper", "loop"])
@pytest.mark.parametrize("env_id", PAPER_ENV_IDS)
def test_episodes_of_all_payloads_start_at_the_start_pose_of_the_task(env_id, trajectory):
    kind = "planar" if "Planar" in env_id else "spatial"
    keywords = {"trajectory": f"{trajectory}-{kind}", "error_bounds": {"position": 0.014}}
    env = gym.make_vec(env_id, 3, payload=[0.0, 2.0, 20.0], uncertainty="table6", **keywords).unwrapped
    env.reset(seed=0)
    np.testing.assert_array_equal(env.pose, [env.tasks[0].start_pose] * 3)
    for initial_error in (None, 0, np.full(env.tasks[0].robot.coordinates, 1e-3)):
        env.reset(options={"initial_error": initial_error})
        first = env.tasks[0].trajectory(0.0).position
        expected = env.tasks[0].start_pose if initial_error is None else first + initial_error
        np.testing.assert_array_equal(env.pose, [expected] * 3)


@pytest.mark.parametrize("env_id", PAPER_ENV_IDS)
def test_torques_after_a_reset_hold_the_true_robot_at_rest(env_id):
    """With the true mass and anchors: in the second environment beyond what the motors can hold."""
    planar = "Planar" in env_id
    motion = {"trajectory": f"dwell-{'planar' if planar else 'spatial'}"}
    payloads = [1.0, 5.0 if planar else 14.0]
    anchors = {"low": -0.01, "high": 0.01, "relative": False}
    uncertainty = {"parameters": {"payload": {"low": 0.2, "high": 0.3}, "base_anchors": anchors}}
    env = gym.make_vec(env_id, 2, payload=payloads, uncertainty=uncertainty, **motion).unwrapped
    _, info = env.reset(seed=0)
    stall = env.settings.robot.stall_torque
    np.testing.assert_allclose(info["torque_margin"], stall - np.abs(info["torques"]), rtol=1e-14)
    assert (info["torque_margin"].min(axis=1) < 0).tolist() == [False, not planar]
    start = env.pose
    for _ in range(20):
        env.step(info["torques"] / stall)
    moved = np.abs(env.pose - start).max(axis=1)
    assert moved[0] < 1e-9
    assert planar or moved[1] > 1e-4


def test_redundant_cables_hold_each_payload_after_a_reset():
    """Torques that environments share, and keep from one reset to the next, are those of the present mass."""
    env = gym.make_vec("CableBot-Point-v0", 2).unwrapped
    robot = env.settings.robot
    for payload in (0.0, 5.0):
        _, info = env.reset(options={"payload": payload})
        minimum = textbook.allocated_minimum(robot)
        torques = textbook.static_torque(robot, robot.mass + payload, env.pose, minimum=minimum)
        np.testing.assert_array_equal(info["torques"], torques)


@pytest.mark.parametrize("payload", [1.0, 14.0])
def test_springs_and_delayed_motors_start_within_the_stall_torque(payload):
    weak = {"motor_strength": {"low": -0.1, "high": -0.05}}
    env = gym.make("CableBot-FlexSpatial-v0", payload=payload, uncertainty={"parameters": weak, "delay": 2}).unwrapped
    observation, info = env.reset(seed=0)
    stall = env.truth["motor_strength"]
    wound = env.layout.split(observation)["motor_angle"] - textbook.pulley_angle(FLEX_SPATIAL, env.pose)
    np.testing.assert_allclose(FLEX_SPATIAL.stiffness * wound, np.minimum(info["torques"], stall), rtol=1e-9)
    assert (info["torques"] > stall).any() == (payload == 14.0)
    for _ in range(2):
        held = env.step(np.zeros(6))[4]["commanded_action"]
        np.testing.assert_allclose(held, np.minimum(info["torques"] / stall, 1.0), rtol=1e-9)
    assert not env.step(np.zeros(6))[4]["commanded_action"].any()


# ------------------------------------------------------------------------------------------- payload and its model


def test_model_payload_factor_applies_to_a_drawn_payload_and_not_to_an_uncertain_one():
    env = make("planar", payload_range=(1.0, 5.0), model_payload_factor=0.9)
    for seed in range(3):
        observation, info = env.reset(seed=seed)
        assert env.task.model_payload == 0.9 * info["payload"]
        assert env.layout.split(observation)["model_payload"][0] == env.task.model_payload
    heavier = {"parameters": {"payload": {"low": 0.5, "high": 0.5}}}
    env = make("planar", payload=2.0, uncertainty=heavier, model_payload_factor=0.9)
    assert (env.reset(seed=0)[1]["payload"], env.task.model_payload) == (3.0, 0.9 * 2.0)


def test_values_per_environment():
    factors, payloads, known = [0.5, 1.0, 2.0, 3.0], [1.0, 2.0, 3.0, 4.0], [True, True, True, False]
    expected = [0.5, 2.0, 6.0, 0.0]
    errors = np.linspace(-0.01, 0.01, 8).reshape(4, 2)
    options = {"payload": payloads, "payload_known": known, "model_payload_factor": factors, "initial_error": errors}
    by_keyword, by_option = several(IDS["planar"], 4, **options), several(IDS["planar"], 4)
    for env, reset in ((by_keyword, {}), (by_option, {"options": options})):
        observation, info = env.reset(seed=0, **reset)
        blocks = env.layout.split(observation)
        assert blocks["model_payload"][:, 0].tolist() == expected
        assert [task.model_payload for task in env.tasks] == expected
        assert info["payload"].tolist() == payloads
        np.testing.assert_allclose(blocks["pose"] - blocks["reference_pose"], errors, atol=1e-15)
    mask = np.array([False, True, False, True])
    by_keyword.reset(options={"reset_mask": mask, "model_payload_factor": 0.25, "payload_known": True})
    assert [task.model_payload for task in by_keyword.tasks] == [0.5, 0.5, 6.0, 1.0]


# --------------------------------------------------------------------------------------------------- physics steps


@pytest.mark.parametrize(("frequency", "substeps"), [(500.0, 2), (333.0, 4), (2000.0, 1)])
def test_default_physics_step_is_at_most_a_millisecond(frequency, substeps):
    env = make("planar", control_frequency=frequency)
    assert env.settings.substeps == substeps
    assert env.settings.physics_step <= 1e-3 * (1 + 1e-9)
    env.reset()
    for step in range(1, 4):
        info = env.step(np.full(3, 0.2))[4]
        assert info["time"] == pytest.approx(step / frequency, rel=1e-12)
        assert info["action_time"] == pytest.approx((step - 1) / frequency, rel=1e-12)


@pytest.mark.parametrize("robot", [FLEX_PLANAR, FLEX_SPATIAL], ids=lambda robot: robot.name)
def test_physics_step_must_suit_the_stiffest_springs(robot):
    """By option, keyword or robot; the default number of substeps is sufficient."""
    env_id = f"CableBot-Flex{'Planar' if robot.planar else 'Spatial'}-v0"
    stiff = {"parameters": {"stiffness": {"low": 0.0, "high": 8000.0}}}
    env = gym.make(env_id).unwrapped
    env.reset(seed=0)
    substeps = env.settings.substeps
    assert gym.make(env_id, uncertainty="table6").unwrapped.settings.substeps == substeps
    with pytest.raises(ValueError, match=f"substeps={substeps} is too small") as caught:
        env.reset(options={"uncertainty": stiff})
    needed = int(str(caught.value).split("at least ")[1].split(",")[0])
    gym.make(env_id, uncertainty=stiff, substeps=needed)
    with pytest.raises(ValueError, match="is too small"):
        gym.make(env_id, uncertainty=stiff, substeps=needed - 1)
    by_default = several(env_id, 2, uncertainty=[None, stiff])
    assert by_default.settings.substeps >= needed
    by_default.reset(seed=0)
    for _ in range(50):
        observation = by_default.step(np.full(by_default.action_space.shape, 0.4))[0]
    assert np.all(np.abs(by_default.layout.split(observation)["motor_speed"]) < 999)


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [("motor_inertia", -0.999, 0.0), ("motor_strength", 0.0, 300.0), ("motor_damping", 0.0, 10.0)],
)
def test_parameters_that_make_motors_too_fast_raise(name, low, high):
    spread = {"low": low, "high": high, "relative": name != "motor_damping"}
    env = gym.make("CableBot-FlexPlanar-v0").unwrapped
    with pytest.raises(ValueError, match="is too small"):
        env.reset(options={"uncertainty": {"parameters": {name: spread}}})


# ----------------------------------------------------------------------------------------------------- bad input


def same_step(env, twin, action):
    ours, theirs = env.step(action), twin.step(action)
    np.testing.assert_array_equal(ours[0], theirs[0])
    assert ours[1:4] == theirs[1:4]
    assert plain(ours[4]) == plain(theirs[4])


def same_reset(env, twin, **reset):
    ours, theirs = env.reset(**reset), twin.reset(**reset)
    np.testing.assert_array_equal(ours[0], theirs[0])
    assert plain(ours[1]) == plain(theirs[1])


MASS_ONLY = Uncertainty(parameters={"platform_mass": ParameterDistribution(low=0.1, high=0.2)})
BAD_OPTIONS = [
    ({"paylaod": 1.0}, "paylaod"),
    ({"payload": [1.0, 2.0]}, "payload"),
    ({"payload_known": 0.5}, "payload_known"),
    ({"model_payload_factor": float("nan")}, "model_payload_factor"),
    ({"trajectory": "paper-planar"}, "paper-planar"),
    ({"initial_error": 0.01}, "initial_error"),
    ({"uncertainty": {"parameters": {"stiffness": {"low": 0, "high": 8000}}}}, "substeps"),
    ({"uncertainty": "table6", "initial_error": [0, 0, -0.1, 0, 0, 0]}, "start pose"),  # no tensions hold it
]


@pytest.mark.parametrize(("options", "named"), BAD_OPTIONS)
def test_bad_option_raises_and_leaves_the_episode(options, named):
    """Truth, task, seed, wrench, delay, noise and random streams."""
    keywords = {"uncertainty": Uncertainty(parameters=MASS_ONLY.parameters, delay=2), "trajectory": "dwell-spatial"}
    keywords |= {"payload_range": (0.0, 2.0), "initial_error_range": [1e-3] * 6}
    env, twin = (gym.make("CableBot-FlexSpatial-v0", **keywords).unwrapped for _ in range(2))
    same_reset(env, twin, seed=0, options={"uncertainty": "table6+sensors"})
    for step in range(12):
        if step % 5 == 0:
            with pytest.raises(ValueError, match=named):
                env.reset(seed=99, options={"error_bounds": {"position": 0.5}} | options)
            assert plain(env.truth) == plain(twin.truth)
            assert env.np_random_seed == 0
            assert env.task.model_payload == twin.task.model_payload
            assert env.task.error_bounds == twin.task.error_bounds
        same_step(env, twin, np.full(6, 0.5 + 0.01 * step))
    same_reset(env, twin)
    same_step(env, twin, np.full(6, 0.5))


@pytest.mark.parametrize("action", [np.zeros(2), np.zeros((1, 3)), 0.5, [0.0, np.nan, 0.0], [0.0, 0.0, 1e308]])
def test_bad_action_raises_and_leaves_the_episode(action):
    env, twin = make("planar"), make("planar")
    same_reset(env, twin, seed=0)
    same_step(env, twin, np.full(3, 0.4))
    with pytest.raises(ValueError, match="action"):
        env.step(action)
    same_step(env, twin, np.full(3, 0.4))
    assert env.step(np.full(3, 9e5))[4]["commanded_action"].tolist() == [9e5] * 3


@pytest.mark.parametrize(
    ("keywords", "named"),
    [
        ({"reward_weights": {"energy": 1.0}}, "energy"),
        ({"cable": "rope"}, "unilateral, bilateral"),
        ({"substeps": 1.5}, "substeps"),
        ({"observation_dtype": "float16"}, "float64, float32"),
        ({"control_frequency": 0.0}, "control_frequency"),
        ({"termination_radius": 0}, "termination_radius"),
        ({"slack_time": -0.1}, "slack_time"),
        ({"payload_range": (2.0, 1.0)}, "payload_range"),
        ({"payload": 1.0, "payload_range": (0.0, 2.0)}, "exclude each other"),
        ({"error_bounds": {"position": 10}}, r"at most 1\.32 m, .* a bound of 10 mm is 0\.01"),
        ({"initial_error_range": [-0.1, 0.0]}, "initial_error_range"),
    ],
)
def test_bad_keyword_raises(keywords, named):
    with pytest.raises(ValueError, match=named):
        CableBotEnv(robot="planar", **keywords)


@pytest.mark.parametrize("make_one", [gym.make, gym.make_vec])
def test_unknown_keyword_raises_the_type_error_that_other_libraries_expect(make_one):
    """TorchRL tries ``frameskip`` first, and looks for Python's own words."""
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'"):
        make_one(IDS["planar"], frameskip=1)
    with pytest.raises(TypeError, match=r"choose one of robot, payload, .*; did you mean 'payload'"):
        make_one(IDS["planar"], paylaod=1.0)


def test_step_before_a_successful_reset_raises():
    env = make("planar")
    with pytest.raises(ValueError, match="paylaod"):
        env.reset(options={"paylaod": 1.0})
    with pytest.raises(gym.error.ResetNeeded, match=r"reset\(\)"):
        env.step(np.zeros(3))


def several(env_id, count, **keywords):
    return gym.make_vec(env_id, num_envs=count, **keywords).unwrapped


def test_uncertainty_per_environment():
    forms = ["table6", None, MASS_ONLY, {"parameters": {"platform_mass": {"low": -0.5, "high": -0.4}}}, "table6"]
    bounds = [(0.9, 1.1), (1.0, 1.0), (1.1, 1.2), (0.5, 0.6), (0.9, 1.1)]
    env = several(IDS["spatial"], 5, uncertainty=forms)
    env.reset(seed=0)
    env.truth["platform_mass"][...] = 99.0  # a copy
    before = env.truth["platform_mass"]
    for mass, (low, high) in zip(before / SPATIAL.mass, bounds, strict=True):
        assert low <= mass <= high
    mask = np.array([False, True, False, False, True])
    env.reset(options={"reset_mask": mask})
    after = env.truth["platform_mass"]
    np.testing.assert_array_equal(after[~mask], before[~mask])
    assert after[1] == SPATIAL.mass
    assert 0.9 * SPATIAL.mass <= after[4] <= 1.1 * SPATIAL.mass
    assert after[4] != before[4]
    single = make("spatial", uncertainty="table6")
    single.reset(seed=4)
    assert single.truth["platform_mass"] == before[4]
