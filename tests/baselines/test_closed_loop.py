"""Policies in closed loop: the platform that they carry, and the payloads of independent runs."""

import numpy as np
import pytest
from oracles.episodes import ROBOTS

from cablebot_baselines.laws import Composite, MotorPD, make_robust
from cablebot_gym.envs import PAPER_ENV_IDS, fitting_env_id
from cablebot_gym.evaluation import compare_policies, evaluate_dlcc
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.motions import FIRST_HELD_OUT_SEED, random_loop
from cablebot_gym.policies import policy_entries
from cablebot_gym.robots import FLEX_SPATIAL, SPATIAL

ENTRIES = policy_entries().values()
PLANNERS = ("trajopt", "learned-plan", "refined-plan")
LARGE = ("composite", "flex-eq22", "motor-pd", "nmpc", "observing", "ppo", *PLANNERS)
"""Policies that estimate or plan, and those with the short physics steps of joint springs."""


def cases():
    """Each policy in each of its environments. The motions of real robots are long; plans, which
    take minutes, are tried in one environment."""
    for entry in ENTRIES:
        for env_id in entry.env_ids[:1] if entry.name in PLANNERS[::2] else entry.env_ids:
            if env_id not in PAPER_ENV_IDS:
                marks = [pytest.mark.nightly]
            elif entry.name in LARGE:
                marks = [pytest.mark.landing]
            else:
                marks = []
            yield pytest.param(entry.name, env_id, marks=marks)


@pytest.mark.parametrize(("name", "env_id"), list(cases()))
def test_platform_is_carried_in_all_environments(name, env_id):
    """On the default motion of an exactly known robot; of a policy that is trained on random loops, on
    one that it has not seen. The paper's law for joint springs is unstable without friction."""
    motion = None
    if name == "ppo":
        motion = random_loop(ROBOTS[env_id].kind, FIRST_HELD_OUT_SEED)
    verdict = record_rollout(name, env_id, payload=0.0, trajectory=motion).verdict
    assert verdict.carried == (name != "flex-eq22")


@pytest.mark.nightly
@pytest.mark.parametrize(
    # Policies that plan rehearse on such robots themselves.
    "entry",
    [entry for entry in ENTRIES if entry.kind == "classical" or entry.name == "nmpc"],
    ids=lambda entry: entry.name,
)
def test_only_laws_for_a_known_robot_fail_unloaded_on_others(entry):
    """16 robots of ``hardware`` carry their platform along two random loops, payload unknown. A law
    for a known robot has an environment on which one fails: the mark is no excuse for a law that
    needs none."""
    carried = {}
    for env_id in entry.env_ids:
        kind = ROBOTS[env_id].kind
        results = []
        for seed in (1, 2):
            compared = compare_policies(
                [entry.name],
                env_id,
                payload=0.0,
                payload_known=False,
                trajectory={"name": f"loop-{kind}", "seed": seed},
                uncertainty="hardware",
                draws=16,
                seed=1,
            )
            results.append(compared.metrics[0].carried)
        carried[env_id] = bool(np.all(results))
    assert all(carried.values()) == (not entry.known_robot), carried


def bare(robot):
    """The robot with tensions above 0."""
    return robot.replace(minimum_tension=1e-9)


BARE_FLEX_SPATIAL = bare(FLEX_SPATIAL)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("law", "robot", "payload_known", "payload", "tolerance"),
    [
        ("fl:gains=tuned", bare(SPATIAL), False, 4.15, 0.04),
        (make_robust(SPATIAL, zeta=0.5, phi=5.0), SPATIAL, False, 4.58, 0.05),
        (Composite(BARE_FLEX_SPATIAL), BARE_FLEX_SPATIAL, True, 4.54, 0.04),
        (MotorPD(BARE_FLEX_SPATIAL, minimum_tension=5.0), BARE_FLEX_SPATIAL, True, 4.10, 0.04),
    ],
)
def test_dlcc_is_that_of_independent_runs(law, robot, payload_known, payload, tolerance):
    """On the circle as printed; the runs of motor-pd allocated at least 5 N."""
    result = evaluate_dlcc(
        law,
        fitting_env_id(robot),
        payload_known=payload_known,
        robot=robot,
        trajectory=f"paper-{robot.kind}",
        resolution=0.02,
    )
    assert result.payload == pytest.approx(payload, abs=tolerance)
