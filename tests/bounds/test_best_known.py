"""The best known payload: an independent collocation, and a replay in a fresh environment; that of a drawn robot,
against the nominal one and the environment."""

import dataclasses
from contextlib import contextmanager
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from oracles.collocation import largest_payload

from cablebot_gym.bounds import best_known, exact_payload, optimum
from cablebot_gym.bounds.best_known import cached_best_known, find_best_known
from cablebot_gym.bounds.drawn import find_drawn_payload
from cablebot_gym.bounds.optimum import Mesh, find_optimum
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.motions import find_trajectory
from cablebot_gym.planning import Infeasible, MotionProgram
from cablebot_gym.policies.adapters import OpenLoop
from cablebot_gym.robots import FLEX_PLANAR, PLANAR, Motors
from cablebot_gym.task import ErrorBounds

pytest.importorskip("casadi")
pytestmark = pytest.mark.usefixtures("cache")

PLANAR_ID = "CableBot-Planar-v0"
FLEX_ID = "CableBot-FlexPlanar-v0"
POINT_ID = "CableBot-Point-v0"
LARGEST_GAP = 0.003
"""Largest relative difference to the payload of an independent collocation."""
LINE = {"name": "line-planar", "duration": 0.4, "dwell": 0.0}


@contextmanager
def coarse_search():
    """One coarse mesh after the first."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(best_known, "MESH_TOLERANCE", 1.0)
        yield


@pytest.fixture
def quick():
    with coarse_search():
        yield


@pytest.fixture(scope="module")
def line():
    """A short line of the planar robot."""
    with coarse_search():
        return find_best_known(PLANAR_ID, trajectory=LINE, cache=False)


# --- the fast case ----------------------------------------------------------------------------------------------------


def test_replay_verifies_the_actions(line):
    assert line.verified
    assert 0.97 * line.program_payload < line.payload <= line.program_payload
    assert line.total_mass == PLANAR.mass + line.payload
    assert line.payload > exact_payload(PLANAR, find_trajectory(LINE, 2)).payload
    assert line.actions.shape == (200, 3)
    assert np.abs(line.actions).max() <= 1
    coarse, fine = line.replays
    assert fine.substeps == 10 * coarse.substeps
    assert fine.least_tension < coarse.least_tension
    for stored in line.replays:
        verdict = record_rollout(
            OpenLoop(line.actions),
            PLANAR_ID,
            payload=line.payload,
            trajectory=LINE,
            substeps=stored.substeps,
        ).verdict
        assert verdict.carried
        assert stored.violation is None
        steps = f"{stored.substeps} physics steps per control period"
        assert f"{steps}: least tension {stored.least_tension:.3f}" in str(line)
        assert verdict.least_tension == stored.least_tension >= PLANAR.minimum_tension
        assert 0.0097 < verdict.position_peak == stored.position_peak <= 0.01


@pytest.mark.parametrize("failed", [0, 1])
def test_each_replay_has_to_verify(monkeypatch, line, failed):
    """The best motion is returned, as not verified, if none passes the replays."""
    replays = list(line.replays)
    replays[failed] = dataclasses.replace(replays[failed], violation="cable 1 is slack")
    found = best_known._Verified(motion=line.motion, actions=line.actions, replays=tuple(replays))
    mesh = Mesh(intervals=20, program=None, motion=line.motion)
    monkeypatch.setattr(best_known._Search, "_refined", lambda *_: [mesh])
    monkeypatch.setattr(best_known._Search, "_verify", lambda *_: found)
    assert not best_known._Search.of(PLANAR_ID, trajectory=LINE).solve(lambda _: None).verified


@pytest.mark.landing
def test_replay_has_to_hold_at_finer_steps_too(monkeypatch, line):
    case = best_known._Search.of(PLANAR_ID, trajectory=LINE)
    refinements = []
    record = best_known._Search._record

    def fails(self, policy, payload, **keywords):
        refinements.append(keywords.get("substeps"))
        if refinements[-1] == line.replays[1].substeps:
            return record(self, policy, 1.1 * payload, **keywords)
        return record(self, policy, payload, **keywords)

    monkeypatch.setattr(best_known._Search, "_record", fails)
    monkeypatch.setattr(best_known, "_TRIALS", 3)
    assert case._verify(case.program(20), line.motion, lambda _: None) is None
    assert line.replays[1].substeps in refinements
    payloads = iter([1.0, 3.0, 2.0])
    monkeypatch.setattr(
        MotionProgram, "solve", lambda *_, **__: SimpleNamespace(payload=next(payloads))
    )
    assert case.best_of_starts(case.program(20)).payload == 3.0  # the best of several starts


# --- the paper's circle and other robots ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("payloads", "converged"),
    [
        ((0.9, 1.0), False),
        ((0.9995, 1.0), True),  # the last change is small
        ((0.94, 0.99, 1.0), False),  # the further changes of this series are 0.0025
        ((0.946, 0.996, 1.0), True),  # 0.00035
        ((0.98, 0.99, 1.0), False),  # the changes do not decrease
        ((1.05, 0.996, 1.0), True),
    ],
)
def test_refinement_stops_where_further_meshes_change_little(payloads, converged):
    assert best_known.has_converged(payloads) == converged


@pytest.mark.nightly
@pytest.mark.parametrize(("env_id", "nodes"), [(PLANAR_ID, 320), (FLEX_ID, 160), (POINT_ID, 160)])
def test_payload_is_close_to_an_independent_collocation(env_id, nodes):
    """Margins that hold at all times once cost up to 5 % of the payload."""
    case = best_known._Search.of(env_id)
    optimum = largest_payload(
        case.robot,
        case.trajectory,
        case.error_bounds,
        nodes=nodes,
        period=1 / case.control_frequency,
    )
    result = find_best_known(env_id, cache=False)
    assert result.verified
    assert (1 - LARGEST_GAP) * optimum < result.payload < (1 + LARGEST_GAP) * optimum


@pytest.mark.landing
@pytest.mark.usefixtures("quick")
def test_arguments_reach_the_program(line):
    options = {"trajectory": LINE, "cache": False}
    again = find_best_known(PLANAR_ID, **options)
    assert again.to_dict() == line.to_dict()
    np.testing.assert_array_equal(again.actions, line.actions)
    motors = Motors(stall_torque=5.5, free_speed=PLANAR.motors.free_speed)
    options |= {"control_frequency": 200.0, "error_bounds": {"position": 0.12}}
    changed = find_best_known(PLANAR_ID, robot=PLANAR.replace(motors=motors), **options)
    assert changed.verified
    assert len(changed.actions) == 80
    assert changed.payload > 1.05 * line.payload


# --- the cache --------------------------------------------------------------------------------------------------------


@pytest.fixture
def solved(monkeypatch, line):
    """Replaces the search; one entry for every search."""
    calls = []

    def solve(case, _):
        calls.append(case)
        return dataclasses.replace(line, payload=float(len(calls)))

    monkeypatch.setattr(best_known._Search, "solve", solve)
    return calls


@pytest.mark.landing
def test_cached_result_equals_the_computed_one(solved, cache, line):
    assert find_best_known(PLANAR_ID, cache=False).payload == 1.0
    assert cached_best_known(PLANAR_ID) is None
    assert not cache.exists()
    computed = find_best_known(PLANAR_ID)
    cached = find_best_known(PLANAR_ID)
    assert len(solved) == 2
    assert computed.to_json() == cached.to_json() == cached_best_known(PLANAR_ID).to_json()
    assert cached.meshes == line.meshes
    np.testing.assert_array_equal(cached.actions, line.actions)
    np.testing.assert_array_equal(cached.motion(0.3).position, line.motion(0.3).position)


def test_cache_distinguishes_problems(solved, cache):
    problems = [
        {},
        {"env_id": FLEX_ID, "robot": FLEX_PLANAR},
        {"robot": PLANAR.replace(mass=1.01)},
        {"trajectory": {"name": "circle-planar", "duration": 1.1}},
        {"error_bounds": {"position": 0.011}},
        {"control_frequency": 400.0},
    ]
    for problem in problems:
        find_best_known(**({"env_id": PLANAR_ID} | problem))
    assert len(solved) == len(problems) == len(list(cache.iterdir()))
    defaults = {
        "robot": PLANAR,
        "trajectory": "circle-planar",
        "error_bounds": ErrorBounds(),
        "control_frequency": 500,
    }
    find_best_known(PLANAR_ID, **defaults)
    assert len(solved) == len(problems)


# --- bad input --------------------------------------------------------------------------------------------------------


def test_slow_control_is_rejected(cache):
    with pytest.raises(ValueError, match=r"control_frequency must be .* greater than 0.3125 Hz"):
        find_best_known(PLANAR_ID, control_frequency=0.3)
    assert not cache.exists()


@pytest.mark.nightly
@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"robot": PLANAR.replace(mass=5.0)},
            "infeasible even unloaded: at most .* kg of the platform's 5 kg",
        ),
        ({"trajectory": "dwell-planar"}, "nothing limits the payload on 'dwell-planar'"),
        (
            {"error_bounds": {"position": 1e-6}},
            "no motion along 'circle-planar' .* Choose a slower motion, wider error bounds",
        ),
    ],
)
def test_infeasible_problem_names_the_remedy(arguments, message, monkeypatch):
    monkeypatch.setattr(optimum, "_FIRST_MESHES", 1)
    with pytest.raises(ValueError, match=message):
        find_best_known(PLANAR_ID, cache=False, **arguments)


@pytest.mark.landing
def test_optimum_has_the_first_meshes_of_the_best_known_payload(line, cache):
    computed = find_optimum(PLANAR_ID, trajectory=LINE)
    assert computed.meshes == line.meshes[: optimum.MESHES]
    cached = find_optimum(PLANAR_ID, trajectory=LINE)
    assert (cached.meshes, cached.payload) == (computed.meshes, computed.payload)
    np.testing.assert_array_equal(cached.first.poses, computed.first.poses)


# --- a drawn robot ----------------------------------------------------------------------------------------------------

HEAVIER = {"parameters": {"payload": {"low": 0.03, "high": 0.03}}, "sensors": {"position": 1e-3}}


@pytest.fixture
def drawn(monkeypatch, line):
    found = optimum.Optimum(meshes=line.meshes, first=line.motion)
    monkeypatch.setattr("cablebot_gym.bounds.drawn.find_optimum", lambda *_, **__: found)
    return partial(find_drawn_payload, PLANAR_ID, trajectory=LINE, seed=0)


def test_exactly_known_robot_has_the_nominal_payload(drawn):
    assert drawn(uncertainty="none").ratio == pytest.approx(1.0, abs=1e-4)


def test_heavier_payload_of_a_draw_is_counted_by_its_nominal_mass(drawn):
    assert drawn(uncertainty=HEAVIER).ratio == pytest.approx(1 / 1.03, abs=1e-4)


def test_infeasible_draw_counts_as_missing(drawn, monkeypatch):
    def solve(*_, **__):
        raise Infeasible("stop")

    monkeypatch.setattr("cablebot_gym.planning.MotionProgram.solve", solve)
    assert drawn(uncertainty="none").ratio is None
