"""Reset options and constructor keywords: each has an effect, lasts as long as it should, and is refused in words."""

from __future__ import annotations

import inspect
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import cablebot_gym
from cablebot_baselines.classical import FeedbackLinearization
from cablebot_gym.envs.outcome import REWARD_TERMS
from cablebot_gym.envs.settings import DEFAULT_WEIGHTS, FOREIGN_OPTIONS, check_options, make_settings
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.envs.vector import CableBotVectorEnv
from cablebot_gym.kinematics import structure_jacobian
from cablebot_gym.physics.textbook import fastest_motor_rate, highest_frequency
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL
from cablebot_gym.task import ErrorBounds
from cablebot_gym.trajectories import Reference
from cablebot_gym.uncertainty import PARAMETERS, ParameterDistribution, Uncertainty

ROBOTS = {"planar": PLANAR, "spatial": SPATIAL}
IDS = {"planar": "CableBot-Planar-v0", "spatial": "CableBot-Spatial-v0"}
each_kind = pytest.mark.parametrize("kind", list(ROBOTS))


def make(kind, **keywords):
    """A bare environment; a longer name would stand in every line."""
    return gym.make(IDS[kind], **keywords).unwrapped


def episode(env, action, steps, **reset):
    """Everything that a reset and some steps under one command return, by where it came from."""
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
    """A start error of one millimetre in x."""
    return [0.001] + [0.0] * (ROBOTS[kind].coordinates - 1)


@dataclass(frozen=True)
class Case:
    """A value other than the default, what has to change with it, and what must not."""

    value: Any
    """Callable: of the robot's kind."""
    changes: tuple[str, ...]
    keeps: tuple[str, ...] = ()
    base: dict[str, Any] = field(default_factory=dict)
    """Keywords of both environments."""
    action: float = 0.3
    steps: int = 2

    def of(self, kind):
        return self.value(kind) if callable(self.value) else self.value


# A new option or keyword without a case here fails the two completeness tests.
OPTIONS = {
    "payload": Case(2.0, ("reset observation", "observation", "reward", "info payload", "info tracking_error")),
    "payload_known": Case(
        False, ("reset observation", "observation"), ("reward", "info payload", "info tracking_error"), {"payload": 2.0}
    ),
    "model_payload_factor": Case(
        0.5, ("reset observation", "observation"), ("reward", "info payload", "info tracking_error"), {"payload": 2.0}
    ),
    "trajectory": Case(lambda kind: f"line-{kind}", ("reset observation", "observation", "reward", "info tensions")),
    "initial_error": Case(
        millimetre, ("reset observation", "observation", "reward", "info tracking_error", "reset info")
    ),
    "uncertainty": Case(
        {"parameters": {"platform_mass": {"low": 0.1, "high": 0.2}}, "sensors": {"position": 1e-4}, "delay": 1},
        ("reset observation", "observation", "reward", "info commanded_action", "info torques", "info tracking_error"),
        ("info payload", "flags", "reset info"),
    ),
    "error_bounds": Case({"position": 0.02, "rotation": 0.02}, ("reward", "info reward_position"), ("observation",)),
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
    "slack_time": Case(0.0, ("flags", "reward", "info termination_reason"), ("observation",), action=-0.3),
    "reward_weights": Case({"position": 3.0}, ("reward", "info reward_position"), ("observation", "flags")),
}


def test_every_reset_option_has_a_case():
    with pytest.raises(ValueError, match="the options are") as caught:
        check_options({"?": 0}, PLANAR, 1)
    known = str(caught.value).split("the options are ")[1].split(", ")
    assert set(known) == set(OPTIONS)


def test_every_constructor_keyword_has_a_case():
    assert set(inspect.signature(make_settings).parameters) - {"count"} == set(KEYWORDS)
    vector = {
        name
        for name, parameter in inspect.signature(CableBotVectorEnv).parameters.items()
        if parameter.kind is parameter.KEYWORD_ONLY
    }
    assert vector == {"robot", "num_envs", "max_episode_steps", "autoreset_mode", "render_mode"}  # see test_vector.py


@each_kind
@pytest.mark.parametrize("name", list(KEYWORDS))
def test_no_constructor_keyword_is_without_effect(kind, name):
    case = KEYWORDS[name]
    usual = episode(make(kind, **case.base), case.action, case.steps, seed=0)
    changed = episode(make(kind, **case.base, **{name: case.of(kind)}), case.action, case.steps, seed=0)
    found = differing(usual, changed)
    assert set(case.changes) <= found
    assert not set(case.keeps) & found


@each_kind
@pytest.mark.parametrize("name", list(OPTIONS))
def test_no_option_is_discarded_and_none_outlives_its_episode(kind, name):
    case = OPTIONS[name]
    env = make(kind, **case.base)
    usual = episode(env, case.action, case.steps, seed=0)
    changed = episode(env, case.action, case.steps, seed=0, options={name: case.of(kind)})
    found = differing(usual, changed)
    assert set(case.changes) <= found
    assert not set(case.keeps) & found
    assert differing(usual, episode(env, case.action, case.steps)) == set()  # the next episode
    constructed = episode(make(kind, **case.base, **{name: case.of(kind)}), case.action, case.steps, seed=0)
    assert differing(changed, constructed) == set()  # an option does what the keyword of its name does


@each_kind
def test_constructor_defaults_outlast_an_episode_of_options(kind):
    env = make(
        kind,
        payload=1.5,
        payload_known=False,
        trajectory=f"line-{kind}",
        initial_error=millimetre(kind),
        error_bounds={"position": 0.05},
    )
    others = {"payload": 0.5, "payload_known": True, "trajectory": f"dwell-{kind}", "error_bounds": {"position": 0.001}}
    usual = episode(env, 0.3, 3, seed=0)
    assert usual["info payload"][0] == 1.5
    assert {"reset observation", "reward", "info payload"} <= differing(usual, episode(env, 0.3, 3, options=others))
    for _ in range(3):
        assert differing(usual, episode(env, 0.3, 3)) == set()


@each_kind
def test_an_option_spares_what_it_does_not_name(kind):
    env = make(kind, payload=1.5, error_bounds={"position": 0.05})
    _, info = env.reset(options={"trajectory": f"line-{kind}"})
    assert info["payload"] == 1.5
    assert env.task.error_bounds.position == 0.05
    assert env.task.trajectory.name == f"line-{kind}"


@each_kind
def test_foreign_options_pass_and_change_nothing(kind):
    usual = episode(make(kind), 0.3, 3, seed=0)
    options = {"minari_autoseed": True, "reset_mask": np.array([True])}
    assert set(options) == set(FOREIGN_OPTIONS)
    assert differing(usual, episode(make(kind), 0.3, 3, seed=0, options=options)) == set()


def test_options_and_keyword_values_are_read_and_never_changed():
    options = {"payload": np.array([1.0]), "error_bounds": {"position": 0.02}, "trajectory": {"name": "dwell-planar"}}
    before = {key: np.copy(value) for key, value in options.items()}
    env = make("planar")
    env.reset(options=options)
    assert list(options) == list(before)
    assert options["payload"] == before["payload"]
    assert options["trajectory"] == {"name": "dwell-planar"}


# ------------------------------------------------------------------------------------------------------- sampler


def draws(env, count, key="payload"):
    """Payloads, or start errors, of the next episodes."""
    found = []
    for _ in range(count):
        observation, info = env.reset()
        part = env.layout.split(observation)
        found.append(info["payload"] if key == "payload" else part["pose"] - part["reference_pose"])
    return np.array(found)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(low=st.floats(0, 10), width=st.floats(0, 10), seed=st.integers(0, 2**40))
def test_payload_draws_stay_in_the_range_and_follow_the_seed(low, width, seed):
    ends = (low, low + width)
    env, again = (make("planar", payload_range=ends) for _ in range(2))
    env.reset(seed=seed)
    again.reset(seed=seed)
    found = draws(env, 10)
    assert np.all((found >= low) & (found <= ends[1]))
    np.testing.assert_array_equal(found, draws(again, 10))
    if width > 1e-6:
        again.reset(seed=seed + 1)
        assert not np.array_equal(found, draws(again, 10))


def test_payload_draws_fill_the_range_instead_of_repeating():
    env = make("planar", payload_range=(2.0, 3.0))
    env.reset(seed=0)
    found = draws(env, 400)
    assert len(set(found)) == 400
    assert found.min() < 2.02
    assert found.max() > 2.98
    assert found.mean() == pytest.approx(2.5, abs=4 * np.sqrt(1 / 12 / 400))
    assert abs(np.corrcoef(found[1:], found[:-1])[0, 1]) < 0.2  # episode number alone does not order them


@pytest.mark.parametrize("payload", [0.0, 2.5, 1e-300, 1 / 3])
def test_a_range_of_one_point_gives_that_point(payload):
    env = make("planar", payload_range=(payload, payload))
    env.reset(seed=0)
    assert set(draws(env, 5)) == {payload}


@each_kind
def test_drawn_payloads_do_not_compound_over_resets(kind):
    env = make(kind, payload_range=(1.0, 1.0), initial_error_range=np.zeros(ROBOTS[kind].coordinates))
    first = episode(env, 0.3, 3, seed=0)
    for _ in range(50):
        env.reset()
    assert differing(first, episode(env, 0.3, 3)) == set()
    assert set(episode(make(kind, payload=1.0), 0.3, 3, seed=0)["info payload"]) == {1.0}
    assert differing(first, episode(make(kind, payload=1.0), 0.3, 3, seed=0)) == set()


def test_draws_do_not_depend_on_how_long_an_episode_was():
    widths = [0.001, 0.002]
    patient, hasty = (make("planar", payload_range=(0.0, 5.0), initial_error_range=widths) for _ in range(2))
    for number in range(6):
        reset = {"seed": 9} if number == 0 else {}
        one, other = patient.reset(**reset), hasty.reset(**reset)
        np.testing.assert_array_equal(one[0], other[0])
        assert one[1]["payload"] == other[1]["payload"]
        for _ in range(7 * number):
            patient.step(np.full(3, 0.2))


@pytest.mark.parametrize(("key", "name"), [("payload", "payload_range"), ("start", "initial_error_range")])
def test_switching_one_sampler_on_leaves_the_other_purposes_draws(key, name):
    keywords = {"payload_range": (0.0, 5.0), "initial_error_range": [0.001, 0.002]}
    alone, both = make("planar", **{name: keywords[name]}), make("planar", **keywords)
    alone.reset(seed=5)
    both.reset(seed=5)
    np.testing.assert_array_equal(draws(alone, 6, key), draws(both, 6, key))


def test_purposes_do_not_share_a_stream():
    env = make("planar", payload_range=(-0.0, 1.0), initial_error_range=[0.01, 0.01])
    env.reset(seed=5)
    payloads, starts = [], []
    for _ in range(20):
        observation, info = env.reset()
        part = env.layout.split(observation)
        payloads.append(info["payload"])
        starts.append((part["pose"] - part["reference_pose"]) / 0.01)
    uniform = (np.array(starts) + 1) / 2
    assert np.abs(uniform - np.array(payloads)[:, None]).min(axis=0).min() > 1e-6
    assert abs(np.corrcoef(uniform[:, 0], payloads)[0, 1]) < 0.7


def test_an_episode_with_a_payload_of_its_own_leaves_the_later_draws():
    env, twin = (make("planar", payload_range=(0.0, 5.0)) for _ in range(2))
    env.reset(seed=5)
    twin.reset(seed=5)
    _, info = env.reset(options={"payload": 7.0})
    assert info["payload"] == 7.0  # the option beats the range
    twin.reset()
    np.testing.assert_array_equal(draws(env, 5), draws(twin, 5))


def test_the_first_episode_of_a_seed_does_not_depend_on_what_was_before():
    env = make("planar", payload_range=(0.0, 5.0))
    _, first = env.reset(seed=5)
    draws(env, 3)
    _, again = env.reset(seed=5)
    assert first["payload"] == again["payload"]
    following = draws(env, 3)
    fresh = make("planar", payload_range=(0.0, 5.0))
    fresh.reset(seed=5)
    np.testing.assert_array_equal(following, draws(fresh, 3))


def test_unseeded_environments_and_their_episodes_differ():
    env, other = (make("planar", payload_range=(0.0, 5.0)) for _ in range(2))
    assert len({*draws(env, 4), *draws(other, 4)}) == 8


@each_kind
def test_start_errors_are_drawn_symmetrically_within_their_half_widths(kind):
    n = ROBOTS[kind].coordinates
    widths = np.array([0.002, 0.0, 0.001, 0.003, 0.0, 0.001])[:n]
    env = make(kind, trajectory=f"dwell-{kind}", initial_error_range=widths)
    env.reset(seed=0)
    found = draws(env, 200, "start")
    assert np.all(np.abs(found) <= widths + 1e-15)
    np.testing.assert_allclose(np.abs(found).max(axis=0), widths, rtol=0.1)
    np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=4 * widths.max() / np.sqrt(3 * 200))
    given = make(kind, trajectory=f"dwell-{kind}", initial_error_range=widths, initial_error=np.full(n, 0.01))
    given.reset(seed=0)
    np.testing.assert_allclose(draws(given, 5, "start"), found[:5] + 0.01, atol=1e-15)  # added to initial_error


# ------------------------------------------------------------------------------------------------------- physics


@settings(max_examples=20, deadline=None, derandomize=True)
@given(payload=st.floats(0, 10))
def test_payload_is_mass_in_the_plants_equations(payload):
    """Let go from rest with taut cables of no torque: (M + payload + Σ J/r² s²) z̈ = (M + payload) g, by symmetry."""
    frequency = 1e4
    env = make("spatial", payload=payload, trajectory="dwell-spatial", control_frequency=frequency, cable="bilateral")
    observation, info = env.reset()
    observation, _, _, _, info = env.step(np.zeros(6))
    column = structure_jacobian(SPATIAL.base, SPATIAL.platform, SPATIAL.home)[:, 2]
    mass = SPATIAL.mass + payload
    reflected = np.sum(SPATIAL.pulley_inertia / SPATIAL.pulley_radius**2 * column**2)
    expected = mass * SPATIAL.gravity / (mass + reflected)
    falls = env.layout.split(observation)["velocity"][2] * frequency
    assert falls == pytest.approx(expected, rel=1e-4)
    assert info["payload"] == payload


@each_kind
def test_a_heavier_load_answers_the_same_pull_more_slowly(kind):
    speeds = []
    for payload in (0.0, 1.0, 5.0):
        env = make(kind, trajectory=f"dwell-{kind}")
        env.reset(options={"payload": payload})
        pull = np.full(env.action_space.shape, 0.9)
        pull[0] = 0.2
        speeds.append(np.abs(env.layout.split(env.step(pull)[0])["velocity"][:2]).max())
    assert speeds[0] > 1.02 * speeds[1] > 1.02**2 * speeds[2]


def test_a_heavier_load_needs_more_torque_to_hang():
    torques = []
    for payload in (0.0, 3.0):
        env = make("spatial", trajectory="dwell-spatial", payload=payload)
        policy = FeedbackLinearization(SPATIAL)
        observation, _ = env.reset()
        for _ in range(5):
            observation, _, _, _, info = env.step(policy.predict(observation)[0])
        assert info["tracking_error"] < 1e-9
        torques.append(info["torques"])
    np.testing.assert_allclose(torques[1] / torques[0], 13 / 10, rtol=1e-6)


def test_an_untold_payload_makes_the_controller_sag():
    errors = {}
    for known in (True, False):
        env = make("spatial", trajectory="dwell-spatial", payload=3.0, payload_known=known)
        policy = FeedbackLinearization(SPATIAL)
        observation, _ = env.reset()
        for _ in range(50):
            observation, _, _, _, info = env.step(policy.predict(observation)[0])
        errors[known] = info["tracking_error"]
    assert errors[True] < 1e-9
    assert errors[False] > 1e-3


# ------------------------------------------------------------------------------------------- payload of the model


def observed_payload(env, observation):
    """Blocks model_payload and payload_known."""
    blocks = env.layout.split(observation)
    return blocks["model_payload"][..., 0].tolist(), blocks["payload_known"][..., 0].tolist()


@each_kind
@pytest.mark.parametrize("factor", [0.0, 0.9, 1.0, 1.5])
def test_model_payload_factor_scales_the_model_payload_and_not_the_true_one(kind, factor):
    env = make(kind, payload=2.0, model_payload_factor=factor)
    observation, info = env.reset(seed=0)
    assert observed_payload(env, observation) == (2.0 * factor, 1.0)
    assert env.task.model_payload == 2.0 * factor
    assert env.task.payload_known
    assert info["payload"] == 2.0
    observation, _, _, _, info = env.step(np.zeros(env.action_space.shape))
    assert observed_payload(env, observation) == (2.0 * factor, 1.0)
    assert info["payload"] == 2.0


@each_kind
def test_model_payload_factor_leaves_the_true_motion(kind):
    """Except for what the observation says of the model payload, two episodes are equal to the last bit."""
    usual = episode(make(kind, payload=2.0), 0.3, 5, seed=0)
    changed = episode(make(kind, payload=2.0, model_payload_factor=0.9), 0.3, 5, seed=0)
    assert differing(usual, changed) == {"reset observation", "observation"}
    where = make(kind).layout.slices()["model_payload"]
    for name in ("reset observation", "observation"):
        unequal = np.array(usual[name]) != np.array(changed[name])
        assert np.all(unequal[:, where])
        assert np.count_nonzero(unequal) == len(unequal)


@each_kind
def test_model_payload_factor_has_no_effect_if_the_payload_is_unknown(kind):
    usual = episode(make(kind, payload=2.0, payload_known=False), 0.3, 3, seed=0)
    env = make(kind, payload=2.0, payload_known=False, model_payload_factor=0.9)
    assert differing(usual, episode(env, 0.3, 3, seed=0)) == set()
    assert env.task.model_payload == 0.0
    assert not env.task.payload_known


def test_model_payload_factor_applies_to_a_drawn_payload_and_not_to_an_uncertain_one():
    env = make("planar", payload_range=(1.0, 5.0), model_payload_factor=0.9)
    for seed in range(5):
        observation, info = env.reset(seed=seed)
        assert env.task.model_payload == 0.9 * info["payload"]
        assert observed_payload(env, observation) == (env.task.model_payload, 1.0)
    heavier = {"parameters": {"payload": {"low": 0.5, "high": 0.5}}}
    env = make("planar", payload=2.0, uncertainty=heavier, model_payload_factor=0.9)
    _, info = env.reset(seed=0)
    assert info["payload"] == 3.0
    assert env.task.model_payload == 0.9 * 2.0


def test_model_payload_factor_as_an_option_holds_for_one_episode():
    env = make("planar", payload=2.0, model_payload_factor=0.5)
    env.reset(seed=0, options={"model_payload_factor": 2.0})
    assert env.task.model_payload == 4.0
    env.reset(options={"payload": 3.0})
    assert env.task.model_payload == 1.5
    env.reset()
    assert env.task.model_payload == 1.0


def test_model_payload_factor_per_environment():
    factors, payloads, known = [0.5, 1.0, 2.0, 3.0], [1.0, 2.0, 3.0, 4.0], [True, True, True, False]
    expected = [0.5, 2.0, 6.0, 0.0]
    options = {"payload": payloads, "payload_known": known, "model_payload_factor": factors}
    by_keyword, by_option = several(IDS["planar"], 4, **options), several(IDS["planar"], 4)
    for env, reset in ((by_keyword, {}), (by_option, {"options": options})):
        observation, info = env.reset(seed=0, **reset)
        assert observed_payload(env, observation)[0] == expected
        assert [task.model_payload for task in env.tasks] == expected
        assert info["payload"].tolist() == payloads
    mask = np.array([False, True, False, True])
    observation, _ = by_keyword.reset(options={"reset_mask": mask, "model_payload_factor": 0.25, "payload_known": True})
    assert observed_payload(by_keyword, observation)[0] == [0.5, 0.5, 6.0, 1.0]
    assert [task.model_payload for task in by_keyword.tasks] == [0.5, 0.5, 6.0, 1.0]
    with pytest.raises(ValueError, match=r"model_payload_factor .*4 numbers, one for each environment.*\(3,\)"):
        by_keyword.reset(options={"model_payload_factor": [1.0] * 3})
    with pytest.raises(ValueError, match=r"model_payload_factor must be finite and at least 0, not \[1.0, 1.0, -1.0"):
        several(IDS["planar"], 4, model_payload_factor=[1.0, 1.0, -1.0, 1.0])


# --------------------------------------------------------------------------------------------------- physics steps


@settings(max_examples=30, deadline=None, derandomize=True)
@given(error=st.lists(st.floats(-0.04, 0.04), min_size=6, max_size=6), spatial=st.booleans())
def test_initial_error_displaces_the_start_by_exactly_that(error, spatial):
    kind = "spatial" if spatial else "planar"
    error = np.array(error[: ROBOTS[kind].coordinates])
    env = make(kind, trajectory=f"dwell-{kind}")
    observation, info = env.reset(options={"initial_error": error})
    home = np.array(env.task.trajectory.pose)
    np.testing.assert_array_equal(env.layout.split(observation)["pose"], home + error)
    assert info["tracking_error"] == pytest.approx(np.linalg.norm(error[:3]), abs=1e-15)
    assert info["tracking_error_peak"] == info["tracking_error"]
    assert not env.layout.split(observation)["velocity"].any()


@pytest.mark.parametrize(
    ("frequency", "substeps"), [(500.0, 2), (1000.0, 1), (100.0, 10), (333.0, 4), (2000.0, 1), (1500, 1)]
)
def test_default_physics_step_is_never_coarser_than_a_millisecond(frequency, substeps):
    env = make("planar", control_frequency=frequency)
    assert env.settings.substeps == substeps
    assert env.settings.physics_step <= 1e-3 * (1 + 1e-9)
    env.reset()
    for step in range(1, 4):
        info = env.step(np.full(3, 0.2))[4]
        assert info["time"] == pytest.approx(step / frequency, rel=1e-12)
        assert info["action_time"] == pytest.approx((step - 1) / frequency, rel=1e-12)


@each_kind
def test_two_physics_steps_a_period_are_as_good_as_twenty(kind):
    """Closed loop over the paper's whole circle. Measured: 5e-12 m, 2e-10 m/s; one step alone is 16 times worse."""
    paths = {}
    for substeps in (1, 2, 20):
        env = make(kind, substeps=substeps)
        policy = FeedbackLinearization(ROBOTS[kind])
        observation, _ = env.reset()
        path = []
        for _ in range(500):
            observation = env.step(policy.predict(observation)[0])[0]
            path.append(observation)
        paths[substeps] = env.layout.split(np.array(path))
    error = {s: {k: np.abs(paths[s][k] - paths[20][k]).max() for k in ("pose", "velocity")} for s in (1, 2)}
    assert error[2]["pose"] < 5e-11
    assert error[2]["velocity"] < 2e-9
    assert 10 < error[1]["pose"] / error[2]["pose"] < 25  # fourth order, and the keyword reaches the plant


# ----------------------------------------------------------------------------------------------------- bad input

ALL_OPTIONS = (
    "payload",
    "payload_known",
    "model_payload_factor",
    "trajectory",
    "initial_error",
    "uncertainty",
    "error_bounds",
)

BAD_OPTIONS: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    "unknown key": ({"paylaod": 1.0}, ("paylaod", *ALL_OPTIONS)),
    "unknown key beside a good one": ({"payload": 1.0, "seed": 3}, ("seed", *ALL_OPTIONS)),
    "negative payload": ({"payload": -0.1}, ("payload", "at least 0", "-0.1")),
    "NaN payload": ({"payload": float("nan")}, ("payload", "finite")),
    "infinite payload": ({"payload": float("inf")}, ("payload", "finite")),
    "payload array of the wrong length": ({"payload": [1.0, 2.0]}, ("payload", "(2,)")),
    "payload in words": ({"payload": "heavy"}, ("payload", "numbers", "heavy")),
    "payload missing": ({"payload": None}, ("payload", "None")),
    "payload_known as a number": ({"payload_known": 0.5}, ("payload_known", "True or False")),
    "payload_known of the wrong length": ({"payload_known": [True, False]}, ("payload_known",)),
    "negative model_payload_factor": ({"model_payload_factor": -0.1}, ("model_payload_factor", "at least 0", "-0.1")),
    "NaN model_payload_factor": ({"model_payload_factor": float("nan")}, ("model_payload_factor", "finite")),
    "infinite model_payload_factor": ({"model_payload_factor": float("inf")}, ("model_payload_factor", "finite")),
    "model_payload_factor in words": ({"model_payload_factor": "half"}, ("model_payload_factor", "numbers", "half")),
    "model_payload_factor of the wrong length": (
        {"model_payload_factor": [1.0, 2.0]},
        ("model_payload_factor", "(2,)"),
    ),
    "unknown trajectory": ({"trajectory": "spiral"}, ("spiral", "paper-planar", "line-planar", "lemniscate-planar")),
    "trajectory of the other robot": ({"trajectory": "paper-spatial"}, ("paper-spatial", "paper-planar")),
    "unknown trajectory field": ({"trajectory": {"name": "dwell-planar", "speed": 1}}, ("speed", "pose", "duration")),
    "trajectory without a duration": ({"trajectory": {"name": "dwell-planar", "duration": 0}}, ("duration", "0")),
    "trajectory of the wrong type": ({"trajectory": 3}, ("3", "paper-planar")),
    "error bounds of zero": ({"error_bounds": {"position": 0.0}}, ("error_bounds", "position", "greater than 0")),
    "NaN error bounds": ({"error_bounds": {"rotation": float("nan")}}, ("error_bounds", "rotation")),
    "unknown error bound": ({"error_bounds": {"force": 1.0}}, ("error_bounds", "position", "rotation", "force")),
    "error bounds as a number": ({"error_bounds": 0.01}, ("error_bounds", "position", "rotation")),
    "start error of the wrong length": ({"initial_error": [0.0, 0.0, 0.0]}, ("initial_error", "2", "(3,)")),
    "start error as one number": ({"initial_error": 0.01}, ("initial_error", "2")),
    "NaN in the start error": ({"initial_error": [0.0, float("nan")]}, ("initial_error", "finite")),
    "unknown uncertainty": ({"uncertainty": "table7"}, ("table7", "table6", "sensors")),
    "unknown uncertain parameter": ({"uncertainty": {"parameters": {"colour": {"low": 0, "high": 1}}}}, ("colour",)),
    "parameter of another robot": (
        {"uncertainty": {"parameters": {"stiffness": {"low": 0, "high": 1}}}},
        ("planar", "stiffness"),
    ),
    "uncertain mass that can reach zero": (
        {"uncertainty": {"parameters": {"platform_mass": {"low": -1, "high": 1}}}},
        ("platform_mass", "greater than 0"),
    ),
    "uncertainties of the wrong number": ({"uncertainty": ["table6", "sensors"]}, ("uncertainty", "2")),
    "no uncertainties in a list": ({"uncertainty": []}, ("uncertainty", "0")),
    "uncertainty as a number": ({"uncertainty": 6}, ("6", "table6", "parameters")),
    "half a step of delay": ({"uncertainty": {"delay": 0.5}}, ("delay", "whole", "0.5")),
}

BAD_ACTIONS = {
    "too few": (np.zeros(2), ("(3,)", "(2,)")),
    "a batch": (np.zeros((1, 3)), ("(3,)", "(1, 3)")),
    "a number": (0.5, ("(3,)", "()")),
    "NaN": (np.array([0.0, np.nan, 0.0]), ("finite", "NaN")),
    "infinity": (np.array([0.0, 0.0, -np.inf]), ("finite", "infinity")),
}

BAD_KEYWORDS: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    **{name: (options, words) for name, (options, words) in BAD_OPTIONS.items() if not name.startswith("unknown key")},
    "weights in a list": ({"reward_weights": [1.0]}, ("reward_weights", "dict", "position")),
    "unknown cable": ({"cable": "rope"}, ("rope", "unilateral", "bilateral")),
    "no substeps": ({"substeps": 0}, ("substeps", "at least 1", "0")),
    "half a substep": ({"substeps": 1.5}, ("substeps", "whole", "1.5")),
    "True substeps": ({"substeps": True}, ("substeps", "whole")),
    "no control frequency": ({"control_frequency": 0.0}, ("control_frequency", "greater than 0")),
    "negative control frequency": ({"control_frequency": -500}, ("control_frequency", "-500")),
    "NaN control frequency": ({"control_frequency": float("nan")}, ("control_frequency", "finite")),
    "control frequency in words": ({"control_frequency": "fast"}, ("control_frequency", "fast")),
    "no termination radius": ({"termination_radius": 0}, ("termination_radius", "greater than 0")),
    "negative slack time": ({"slack_time": -0.1}, ("slack_time", "at least 0")),
    "unknown reward term": ({"reward_weights": {"energy": 1.0}}, ("energy", *REWARD_TERMS)),
    "NaN reward weight": ({"reward_weights": {"slack": float("nan")}}, ("reward_weights", "finite")),
    "reward weight in words": ({"reward_weights": {"slack": "much"}}, ("reward_weights", "much")),
    "unknown robot": ({"robot": "delta"}, ("delta", "planar", "spatial")),
    "robot field unknown": ({"robot": {**PLANAR.to_dict(), "colour": "red"}}, ("colour", "mass")),
    "robot not physical": ({"robot": {**PLANAR.to_dict(), "mass": -1.0}}, ("mass", "greater than 0")),
    "payload range upside down": ({"payload_range": (2.0, 1.0)}, ("payload_range", "low", "high")),
    "payload range below zero": ({"payload_range": (-1.0, 1.0)}, ("payload_range", "0")),
    "payload range of one end": ({"payload_range": 3.0}, ("payload_range", "low", "high")),
    "NaN payload range": ({"payload_range": (0.0, float("nan"))}, ("payload_range",)),
    "negative half widths": ({"initial_error_range": [-0.1, 0.0]}, ("initial_error_range", "half widths")),
    "half widths of the wrong length": ({"initial_error_range": [0.1]}, ("initial_error_range", "2")),
    "render mode": ({"render_mode": "hologram"}, ("render_mode", "hologram")),
}


def check_message(error, words):
    """A short message in one line that names the valid choices."""
    message = str(error)
    for word in words:
        assert word in message
    assert "\n" not in message
    assert len(message) < 320  # the longest lists every trajectory


@pytest.mark.parametrize("name", list(BAD_OPTIONS))
def test_a_bad_option_is_named_and_the_episode_goes_on_to_the_last_bit(name):
    options, words = BAD_OPTIONS[name]
    keywords = {"payload_range": (0.0, 2.0), "initial_error_range": [0.01, 0.01], "uncertainty": "table6+sensors"}
    env, twin = make("planar", **keywords), make("planar", **keywords)
    rng = np.random.default_rng(0)
    env.reset(seed=4)
    twin.reset(seed=4)
    for step in range(12):
        if step in (0, 6):
            with pytest.raises(ValueError, match=r"\w") as caught:
                env.reset(options=options)
            check_message(caught.value, words)
            assert env.task.model_payload == twin.task.model_payload
        action = rng.uniform(-1, 1, 3)
        same_step(env, twin, action)
    same_reset(env, twin)  # the streams stand where they stood
    same_step(env, twin, action)


def test_motion_of_more_steps_than_memory_holds_is_not_begun():
    make("planar", control_frequency=5e5).reset(seed=0)
    with pytest.raises(ValueError, match=r"more than 1,000,000") as caught:
        make("planar", control_frequency=5e6).reset(seed=0)
    check_message(caught.value, ("5,000,001", "1 s at 5e+06 Hz", "lower control_frequency"))
    with pytest.raises(ValueError, match=r"lasts 10000.0 s: its duration must be > 0 and at most 1000 s"):
        make("planar", trajectory={"name": "dwell-planar", "duration": 1e4}).reset(seed=0)


def same_step(env, twin, action):
    ours, theirs = env.step(action), twin.step(action)
    np.testing.assert_array_equal(ours[0], theirs[0])
    assert ours[1:4] == theirs[1:4]
    assert plain(ours[4]) == plain(theirs[4])


def same_reset(env, twin, **reset):
    ours, theirs = env.reset(**reset), twin.reset(**reset)
    np.testing.assert_array_equal(ours[0], theirs[0])
    assert plain(ours[1]) == plain(theirs[1])


@pytest.mark.parametrize("option", [{"payload": -1.0}, {"paylaod": 1.0}])
def test_a_refused_reset_does_not_take_its_seed(option):
    env, twin = make("planar", payload_range=(0.0, 5.0)), make("planar", payload_range=(0.0, 5.0))
    env.reset(seed=4)
    twin.reset(seed=4)
    with pytest.raises(ValueError, match=r"pay(load|laod)"):
        env.reset(seed=99, options=option)
    same_reset(env, twin)


class NotVectorised:
    """A motion of one's own that works for one time and not for an array of times, as they are often written."""

    name, duration, coordinates = "not vectorised", 1.0, 2

    def __call__(self, times):
        position = np.array([0.05, 0.0]) if times < 0.5 else np.array([0.0, 0.05])
        zero = np.zeros(2)
        return Reference(position=position, velocity=zero, acceleration=zero, jerk=zero, snap=zero)


def test_a_motion_that_fails_for_an_array_of_times_leaves_the_episode_as_it_was():
    env, twin = make("planar"), make("planar")
    same_reset(env, twin, seed=0)
    same_step(env, twin, np.full(3, 0.4))
    with pytest.raises(ValueError, match=r"\w"):
        env.reset(options={"trajectory": NotVectorised(), "payload": 3.0, "error_bounds": {"position": 0.5}})
    assert env.task.trajectory.name == "paper-planar"
    assert env.task.model_payload == 0.0
    same_step(env, twin, np.full(3, 0.4))


@pytest.mark.parametrize("name", list(BAD_ACTIONS))
def test_a_bad_action_is_named_and_the_episode_goes_on_to_the_last_bit(name):
    action, words = BAD_ACTIONS[name]
    env, twin = make("planar"), make("planar")
    same_reset(env, twin, seed=0)
    same_step(env, twin, np.full(3, 0.4))
    with pytest.raises(ValueError, match="action") as caught:
        env.step(action)
    check_message(caught.value, words)
    same_step(env, twin, np.full(3, 0.4))


def test_a_large_action_is_recorded_and_one_that_would_make_info_infinite_is_refused():
    env = make("planar")
    env.reset()
    _, reward, _, _, info = env.step(np.full(3, 9e5))
    assert info["commanded_action"].tolist() == [9e5] * 3
    assert np.isfinite(reward)
    several = gym.make_vec("CableBot-Planar-v0", num_envs=2)
    several.reset()
    for call, action in ((env.step, [0.0, 0.0, 1e308]), (several.step, [[0.0] * 3, [0.0, 0.0, 1e308]])):
        with pytest.raises(ValueError, match="each component within"):
            call(np.array(action))


@pytest.mark.parametrize("name", list(BAD_KEYWORDS))
def test_a_bad_keyword_is_named_together_with_what_would_do(name):
    keywords, words = BAD_KEYWORDS[name]
    with pytest.raises(ValueError, match=r"\w") as caught:
        from_class(**keywords)
    check_message(caught.value, words)


def from_class(robot="planar", **keywords):
    """Without gym.make, which has words of its own about a render mode."""
    return CableBotEnv(robot=robot, **keywords)


@pytest.mark.parametrize("options", [3, "payload", [("payload", 1.0)]])
def test_options_that_are_no_dict_are_refused_with_the_keys_of_one(options):
    with pytest.raises(ValueError, match="options must be a dict with the keys payload, ") as caught:
        make("planar").reset(options=options)
    check_message(caught.value, tuple(ALL_OPTIONS))


def test_a_misspelt_keyword_does_not_pass_in_silence():
    with pytest.raises(ValueError, match="paylaod"):
        from_class(paylaod=1.0)


def test_step_before_reset_says_what_to_do():
    env = make("planar")
    with pytest.raises(gym.error.ResetNeeded, match=r"reset\(\)"):
        env.step(np.zeros(3))
    with pytest.raises(ValueError, match="paylaod"):
        env.reset(options={"paylaod": 1.0})
    with pytest.raises(gym.error.ResetNeeded, match=r"reset\(\)"):  # a refused reset starts nothing
        env.step(np.zeros(3))


def test_limits_objects_and_arrays_are_welcome_too():
    env = make("planar", error_bounds=ErrorBounds(position=0.02))
    assert env.task.error_bounds == ErrorBounds(position=0.02, rotation=0.01)
    env.reset(options={"error_bounds": {"position": 0.03}, "payload": np.float32(1.5), "payload_known": np.True_})
    assert env.task.error_bounds.position == 0.03
    assert env.task.model_payload == 1.5


# ---------------------------------------------------------------------------------------------------- uncertainty

MASS_ONLY = Uncertainty(parameters={"platform_mass": ParameterDistribution(low=0.1, high=0.2)})
FLEX = {"FlexPlanar": FLEX_PLANAR, "FlexSpatial": FLEX_SPATIAL}
each_flexible = pytest.mark.parametrize("flexible", list(FLEX))


def several(env_id, count, **keywords):
    return gym.make_vec(env_id, num_envs=count, **keywords).unwrapped


@each_kind
def test_an_uncertain_option_holds_for_its_episode_alone_and_replaces_the_keyword(kind):
    env, nominal = make(kind, uncertainty="table6"), ROBOTS[kind].mass
    env.reset(seed=0)
    assert env.truth["platform_mass"] != nominal
    env.reset(options={"uncertainty": None})
    assert env.truth["platform_mass"] == nominal
    env.reset(options={"uncertainty": MASS_ONLY})
    assert 1.1 * nominal <= env.truth["platform_mass"] <= 1.2 * nominal
    env.reset()
    assert 0.9 * nominal <= env.truth["platform_mass"] <= 1.1 * nominal
    assert env.settings.uncertainty[0].wrench is not None


def test_each_environment_of_a_batch_may_have_its_own_uncertainty():
    forms = ["table6", None, MASS_ONLY, {"parameters": {"platform_mass": {"low": -0.5, "high": -0.4}}}, "table6"]
    bounds = [(0.9, 1.1), (1.0, 1.0), (1.1, 1.2), (0.5, 0.6), (0.9, 1.1)]
    by_keyword, by_option = several(IDS["spatial"], 5, uncertainty=forms), several(IDS["spatial"], 5)
    by_keyword.reset(seed=0)
    by_option.reset(seed=0, options={"uncertainty": forms})
    for env in (by_keyword, by_option):
        for mass, (low, high) in zip(env.truth["platform_mass"] / SPATIAL.mass, bounds, strict=True):
            assert low <= mass <= high
    np.testing.assert_array_equal(by_keyword.truth["platform_mass"], by_option.truth["platform_mass"])
    mask = np.array([False, True, False, False, True])
    before = by_keyword.truth["platform_mass"]
    by_keyword.reset(options={"reset_mask": mask})  # each lane its own, not the first ones of the list
    after = by_keyword.truth["platform_mass"]
    np.testing.assert_array_equal(after[~mask], before[~mask])
    assert after[1] == SPATIAL.mass
    assert 0.9 * SPATIAL.mass <= after[4] <= 1.1 * SPATIAL.mass
    assert after[4] != before[4]
    single = make("spatial", uncertainty="table6")  # nor does a list change what a lane draws
    single.reset(seed=4)
    assert single.truth["platform_mass"] == before[4]


@pytest.mark.parametrize("forms", [["table6"] * 2, ["table6"] * 4, []])
def test_as_many_uncertainties_as_environments_are_needed(forms):
    words = ("uncertainty", "3", str(len(forms)))
    env, twin = (several(IDS["planar"], 3, uncertainty="table6") for _ in range(2))
    env.reset(seed=0)
    twin.reset(seed=0)
    with pytest.raises(ValueError, match="uncertainty") as caught:
        env.reset(seed=8, options={"uncertainty": forms})
    check_message(caught.value, words)
    with pytest.raises(ValueError, match="uncertainty") as caught:
        several(IDS["planar"], 3, uncertainty=forms)
    check_message(caught.value, words)
    np.testing.assert_array_equal(env.reset()[0], twin.reset()[0])  # neither seed nor episode was taken
    np.testing.assert_array_equal(env.truth["platform_mass"], twin.truth["platform_mass"])


@pytest.mark.parametrize(
    "option",
    [
        {"uncertainty": {"parameters": {"stiffness": {"low": 0, "high": 8000}}}},  # too stiff for the substeps
        {"uncertainty": "table6", "initial_error": [0, 0, -0.1, 0, 0, 0]},  # cables in one plane: nothing holds it
        {"uncertainty": {"delay": 9}, "payload": -1.0},
    ],
)
def test_a_refused_reset_leaves_truth_streams_wrench_delay_and_noise(option):
    keywords = {"uncertainty": Uncertainty(parameters=MASS_ONLY.parameters, delay=2), "trajectory": "dwell-spatial"}
    env, twin = (gym.make("CableBot-FlexSpatial-v0", **keywords).unwrapped for _ in range(2))
    same_reset(env, twin, seed=0, options={"uncertainty": "table6+sensors", "payload": 1.0})
    for step in range(12):
        if step % 3 == 0:
            with pytest.raises(ValueError, match=r"\w"):
                env.reset(seed=99, options={"error_bounds": {"position": 0.5}, **option})
            assert {name: value.tolist() for name, value in env.truth.items()} == {
                name: value.tolist() for name, value in twin.truth.items()
            }
            assert env.task.model_payload == 1.0
            assert env.task.error_bounds == twin.task.error_bounds
        same_step(env, twin, np.full(6, 0.5 + 0.01 * step))
    same_reset(env, twin)
    same_step(env, twin, np.full(6, 0.5))


def test_a_start_that_no_tensions_hold_is_refused_in_words_where_it_has_to_be_held():
    flat = {"initial_error": [0, 0, -0.1, 0, 0, 0], "trajectory": "dwell-spatial"}
    for env, options in (
        (gym.make("CableBot-FlexSpatial-v0").unwrapped, flat),
        (make("spatial"), flat | {"uncertainty": {"delay": 1}}),
    ):
        with pytest.raises(ValueError, match="start pose") as caught:
            env.reset(options=options)
        check_message(caught.value, ("no tensions",))


def rate(robot):
    """Fastest rate of a robot [rad/s]."""
    return max(highest_frequency(robot), fastest_motor_rate(robot))


@each_flexible
def test_springs_too_stiff_for_the_substeps_are_refused_with_frequency_and_substeps(flexible):
    """By option, by keyword with explicit substeps; a default chooses substeps that do."""
    stiff = {"parameters": {"stiffness": {"low": 0.0, "high": 8000.0}}}
    env_id = f"CableBot-{flexible}-v0"
    env = gym.make(env_id).unwrapped
    env.reset(seed=0)
    robot = FLEX[flexible]
    transmission = robot.transmission
    hard = robot.replace(transmission=type(transmission)(**vars(transmission) | {"stiffness": 8001 * 3.0}))
    for call in (
        lambda: env.reset(options={"uncertainty": stiff}),
        lambda: gym.make(env_id, uncertainty=stiff, substeps=env.settings.substeps),
        lambda: several(env_id, 2, uncertainty=[None, stiff], substeps=env.settings.substeps),
        lambda: gym.make(env_id, robot=hard, substeps=env.settings.substeps),
    ):
        with pytest.raises(ValueError, match="motors oscillate or settle at") as caught:
            call()
        message = str(caught.value)
        check_message(
            caught.value, (f"substeps={env.settings.substeps} ", "Hz", "omit substeps when you make the environment")
        )
        assert float(message.split(" at ")[1].split(" Hz")[0]) == pytest.approx(rate(hard) / (2 * np.pi), rel=0.01)
        needed = int(message.split("use at least ")[1].split(",")[0])
        gym.make(env_id, uncertainty=stiff, substeps=needed)
        with pytest.raises(ValueError, match="motors oscillate or settle at"):
            gym.make(env_id, uncertainty=stiff, substeps=needed - 1)
    for by_default in (
        gym.make(env_id, uncertainty=stiff).unwrapped,
        several(env_id, 2, uncertainty=[None, stiff]),
    ):
        assert by_default.settings.substeps >= needed
        by_default.reset(seed=0)
        for _ in range(50):
            observation = by_default.step(np.full(by_default.action_space.shape, 0.4))[0]
        assert np.all(np.abs(by_default.layout.split(observation)["motor_speed"]) < 999)  # it has not blown up


@each_flexible
@pytest.mark.parametrize(
    ("name", "low", "high"),
    [("motor_inertia", -0.999, 0.0), ("motor_strength", 0.0, 300.0), ("motor_damping", 0.0, 10.0)],
)
def test_other_parameters_that_make_motors_too_fast_are_refused_too(flexible, name, low, high):
    spread = {"low": low, "high": high, "relative": name != "motor_damping"}
    env = gym.make(f"CableBot-{flexible}-v0").unwrapped
    with pytest.raises(ValueError, match="motors oscillate or settle at"):
        env.reset(options={"uncertainty": {"parameters": {name: spread}}})


@each_flexible
def test_a_small_uncertainty_does_not_make_the_default_physics_step_finer(flexible):
    steps = [gym.make(f"CableBot-{flexible}-v0", uncertainty=form).unwrapped for form in (None, "table6", "sensors")]
    assert len({env.settings.substeps for env in steps}) == 1


@pytest.mark.parametrize("env_id", cablebot_gym.ENV_IDS)
def test_every_parameter_as_an_option_changes_the_next_steps(env_id):
    """As data, and the next episode is nominal again."""
    env = gym.make(env_id, payload=1.0).unwrapped
    robot = env.settings.robot
    usual = episode(env, 0.5, 12, seed=0)
    for name, parameter in PARAMETERS.items():
        if (parameter.flexible and not robot.flexible) or (parameter.spatial and robot.planar):
            continue
        spread = {"low": 0.2, "high": 0.3, "each": name != "platform_inertia"}
        if parameter.position or "damping" in name:
            spread |= {"low": 0.002, "high": 0.003, "relative": False}
        option = {"uncertainty": {"parameters": {name: spread}}}
        found = differing(usual, episode(env, 0.5, 12, seed=0, options=option))
        assert {"observation", "info tensions"} <= found, name
        assert ("info payload" in found) == (name == "payload")
        assert differing(usual, episode(env, 0.5, 12)) == set(), name


def test_default_weights_are_those_of_every_term():
    assert list(DEFAULT_WEIGHTS) == list(REWARD_TERMS)
    assert make("planar", reward_weights={}).settings.weights.tolist() == list(DEFAULT_WEIGHTS.values())
    assert cablebot_gym.ENV_IDS[:2] == tuple(IDS.values())
