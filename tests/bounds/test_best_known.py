"""The best known payload: hand calculation, certificate, every policy, and a replay in a fresh environment."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from cablebot_gym.bounds import best_known, exact_payload
from cablebot_gym.bounds.best_known import BestKnownPayload, find_best_known, replay
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.evaluation.constraints import DLCCMonitor
from cablebot_gym.planning import Infeasible, MotionProgram
from cablebot_gym.robots import FLEX_PLANAR, PLANAR, SPATIAL, Motors
from cablebot_gym.task import ErrorBounds
from cablebot_gym.trajectories import find_trajectory

pytest.importorskip("casadi")
pytestmark = pytest.mark.usefixtures("cache")

PLANAR_ID, SPATIAL_ID, FLEX_ID = "CableBot-Planar-v0", "CableBot-Spatial-v0", "CableBot-FlexPlanar-v0"
LINE = {"name": "line-planar", "duration": 0.4}
HANG = {"name": "dwell-spatial", "duration": 0.1}


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two meshes and no certificate, which has tests of its own."""
    monkeypatch.setattr(best_known, "MESH_TOLERANCE", 1.0)
    upper = {"payload": 99.0, "total_mass": 100.0, "conditions": "none"}
    monkeypatch.setattr(best_known, "planar_certificate", lambda *_: SimpleNamespace(to_dict=lambda: upper))


@pytest.fixture(scope="module")
def circle() -> BestKnownPayload:
    """The paper's circle, planar, with everything."""
    return find_best_known(PLANAR_ID, cache=False)


def environment(
    payload: float, *, env_id: str = PLANAR_ID, trajectory: Any = "paper-planar", **more: Any
) -> DLCCMonitor:
    """As anybody would make it."""
    return DLCCMonitor(gym.make(env_id, payload=payload, trajectory=trajectory, max_episode_steps=10_000, **more))


# --- the paper's circle -----------------------------------------------------------------------------------------------


def test_best_found_on_the_papers_circle_is_verified_and_not_below_what_is_known(circle: BestKnownPayload) -> None:
    assert circle.verified
    assert circle.total_mass > 3.85
    assert circle.total_mass == PLANAR.mass + circle.payload
    assert 0.99 * circle.program_payload < circle.payload <= circle.program_payload
    assert circle.error_bounds == {"position": 0.01, "rotation": None}


def test_best_found_is_not_above_the_certificate(circle: BestKnownPayload) -> None:
    assert circle.upper is not None
    assert circle.program_payload < circle.upper["payload"] < 1.03 * circle.payload
    assert f"{circle.upper['payload']:.3f} kg" in str(circle)


def test_no_policy_carries_more_than_the_best_found(circle: BestKnownPayload) -> None:
    for policy in ("fl", "fl-tuned", "robust-tuned", "adaptive"):
        carried = evaluate_dlcc(policy, PLANAR_ID, payload_known=True, resolution=0.05).payload
        assert 0 < carried < circle.payload
    assert circle.payload > 2 * exact_payload(PLANAR, find_trajectory("paper-planar", 2)).payload


def test_meshes_do_not_end_while_the_payload_still_moves(circle: BestKnownPayload) -> None:
    counts, payloads = zip(*circle.meshes, strict=True)
    assert len(counts) >= 2
    assert np.all(np.array(counts[1:]) == 2 * np.array(counts[:-1]))
    moved = np.abs(np.diff(payloads)) / payloads[1:]
    assert moved[-1] < 0.005
    assert np.all(moved[:-1] > 0.005)
    assert circle.program_payload == payloads[-1]


def test_replay_does_not_need_what_found_the_motion(circle: BestKnownPayload) -> None:
    verdict = replay(environment(circle.payload), circle.actions)
    assert verdict.carried
    assert verdict.complete
    assert 0.0097 < verdict.position_peak <= 0.01
    assert circle.actions.shape == (500, 3)
    assert np.abs(circle.actions).max() <= 1


def test_replay_does_not_pass_whatever_is_replayed(circle: BestKnownPayload) -> None:
    heavier = replay(environment(1.03 * circle.payload), circle.actions)
    weaker = replay(environment(circle.payload), 0.97 * circle.actions)
    late = replay(environment(circle.payload), np.roll(circle.actions, 1, axis=0))
    tighter = replay(environment(circle.payload, error_bounds={"position": 0.0095}), circle.actions)
    for verdict in (heavier, weaker, late, tighter):
        assert not verdict.carried
        assert verdict.violation is not None
    assert not replay(environment(circle.payload), circle.actions[:-2]).carried  # half a motion is none


def test_dict_does_not_lose_or_add_what_is_no_json(circle: BestKnownPayload) -> None:
    data = json.loads(circle.to_json(), parse_constant=pytest.fail)
    assert data == json.loads(json.dumps(circle.to_dict()))
    assert set(data) >= {"env_id", "payload", "total_mass", "error_bounds", "verified", "margins", "meshes", "upper"}
    assert data["environment"]["trajectory"]["name"] == "paper-planar"
    assert data["environment"]["robot"] == json.loads(json.dumps(PLANAR.to_dict()))
    assert not {"motion", "actions"} & set(data)


def test_margins_of_the_replayed_motion_are_not_more_than_a_hundredth_of_the_limits(circle: BestKnownPayload) -> None:
    assert 0 < circle.margins["position"] <= 0.01 * 0.01
    assert 0 < circle.margins["action"] <= 0.01


# --- other robots and limits ------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("quick")
def test_a_hang_in_a_tube_of_hardly_any_width_is_not_off_from_the_static_payload() -> None:
    static = exact_payload(SPATIAL, find_trajectory(HANG, 6)).payload
    tight = find_best_known(SPATIAL_ID, trajectory=HANG, error_bounds={"position": 1e-5, "rotation": 1e-5}, cache=False)
    assert tight.verified
    assert tight.payload == pytest.approx(static, rel=2e-3)
    assert tight.error_bounds == {"position": 1e-5, "rotation": 1e-5}
    assert tight.upper is None
    wide = find_best_known(SPATIAL_ID, trajectory=HANG, error_bounds={"position": 1e-3, "rotation": 1e-3}, cache=False)
    assert wide.verified
    assert wide.payload > 1.02 * static


@pytest.mark.usefixtures("quick")
def test_flexible_joints_do_not_leave_the_replay_behind() -> None:
    found = find_best_known(FLEX_ID, trajectory=LINE, cache=False)
    assert found.verified
    assert 0.97 * found.program_payload < found.payload
    assert found.upper is None
    again = environment(found.payload, env_id=FLEX_ID, trajectory=LINE)
    assert replay(again, found.actions).carried
    heavier = environment(1.05 * found.payload, env_id=FLEX_ID, trajectory=LINE)
    assert not replay(heavier, found.actions).carried
    rigid = find_best_known(PLANAR_ID, trajectory=LINE, cache=False)
    assert found.payload < rigid.payload


@pytest.mark.usefixtures("quick")
def test_control_frequency_and_limits_are_not_read_and_forgotten() -> None:
    told: dict[str, Any] = {"trajectory": LINE, "control_frequency": 200.0, "error_bounds": {"position": 0.02}}
    found = find_best_known(PLANAR_ID, cache=False, **told)
    assert found.verified
    assert len(found.actions) == 80
    assert found.environment["control_frequency"] == 200.0
    assert found.error_bounds["position"] == 0.02
    verdict = replay(environment(found.payload, **told), found.actions)
    assert verdict.carried
    assert 0.019 < verdict.position_peak < 0.02


@pytest.mark.usefixtures("quick")
def test_stronger_motors_of_a_robot_of_ones_own_do_not_carry_less() -> None:
    motors = Motors(stall_torque=5.5, free_speed=PLANAR.motors.free_speed)
    usual, stronger = (
        find_best_known(PLANAR_ID, robot=robot, trajectory=LINE, cache=False)
        for robot in (PLANAR, PLANAR.replace(motors=motors))
    )
    assert stronger.payload > 1.05 * usual.payload
    assert stronger.environment["robot"]["motors"]["stall_torque"] == 5.5


@pytest.mark.usefixtures("quick")
def test_the_same_call_does_not_give_another_number() -> None:
    first, second = (find_best_known(PLANAR_ID, trajectory=LINE, cache=False) for _ in range(2))
    assert first.to_dict() == second.to_dict()
    np.testing.assert_array_equal(first.actions, second.actions)


@pytest.mark.usefixtures("quick")
def test_what_no_replay_carries_is_not_called_verified(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(best_known, "replay", lambda *_: SimpleNamespace(carried=False))
    found = find_best_known(PLANAR_ID, trajectory=LINE, cache=False)
    assert not found.verified
    assert "not verified" in str(found)


@pytest.mark.usefixtures("quick")
def test_progress_is_not_silent_for_any_stage() -> None:
    said: list[str] = []
    find_best_known(PLANAR_ID, trajectory=LINE, cache=False, progress=said.append)
    for word in ("starts", "so far", "replaying", "upper bound"):
        assert any(word in text for text in said)


def test_the_best_of_several_starts_is_not_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    payloads = iter([1.0, 3.0, 2.0])
    monkeypatch.setattr(MotionProgram, "solve", lambda *_, **__: SimpleNamespace(payload=next(payloads)))
    case = best_known._Case(PLANAR_ID, PLANAR, find_trajectory(LINE, 2), ErrorBounds(), 500.0)
    assert case._first(20).payload == 3.0


@pytest.mark.usefixtures("quick")
def test_a_finer_mesh_that_fails_does_not_throw_the_coarser_one_away(monkeypatch: pytest.MonkeyPatch) -> None:
    solve = best_known._Case._solve

    def fails_when_fine(case: Any, intervals: int, start: Any, margins: Any = None) -> Any:
        if intervals > 20:
            raise Infeasible("no finer")
        return solve(case, intervals, start, margins)

    monkeypatch.setattr(best_known._Case, "_solve", fails_when_fine)
    found = find_best_known(PLANAR_ID, trajectory=LINE, cache=False)
    assert [count for count, _ in found.meshes] == [20]
    assert found.verified


@pytest.mark.usefixtures("quick")
def test_a_tube_wider_than_episodes_usually_last_is_not_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_certificate(*_: Any) -> Any:
        raise ValueError("the tube reaches an anchor")

    monkeypatch.setattr(best_known, "planar_certificate", no_certificate)
    found = find_best_known(PLANAR_ID, trajectory=LINE, error_bounds={"position": 0.12}, cache=False)
    assert found.verified
    assert found.payload > 0.99 * found.program_payload
    assert found.upper is None


# --- the cache --------------------------------------------------------------------------------------------------------


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch, circle: BestKnownPayload) -> list[Any]:
    """Stands for the search; one entry for every search."""
    calls: list[Any] = []

    def solve(case: Any, _: Any) -> BestKnownPayload:
        calls.append(case)
        return dataclasses.replace(circle, payload=float(len(calls)))

    monkeypatch.setattr(best_known._Case, "solve", solve)
    return calls


def test_a_kept_result_is_neither_found_twice_nor_another_one(solved: list[Any], circle: BestKnownPayload) -> None:
    first, second = find_best_known(PLANAR_ID), find_best_known(PLANAR_ID)
    assert len(solved) == 1
    assert first.to_json() == second.to_json()
    assert second.meshes == circle.meshes
    np.testing.assert_array_equal(second.actions, circle.actions)
    np.testing.assert_array_equal(second.motion(0.3).position, circle.motion(0.3).position)


def test_without_the_cache_nothing_is_read_or_written(solved: list[Any], cache: Path) -> None:
    find_best_known(PLANAR_ID, cache=False)
    assert not cache.exists()
    assert find_best_known(PLANAR_ID).payload == 2.0
    assert find_best_known(PLANAR_ID, cache=False).payload == 3.0


def test_a_result_is_not_kept_for_another_question(solved: list[Any], cache: Path) -> None:
    motors = Motors(stall_torque=5.1, free_speed=PLANAR.motors.free_speed)
    questions: list[dict[str, Any]] = [
        {},
        {"env_id": FLEX_ID, "robot": FLEX_PLANAR},
        {"robot": PLANAR.replace(motors=motors)},
        {"robot": PLANAR.replace(mass=1.01)},
        {"trajectory": "circle-planar"},
        {"trajectory": {"name": "paper-planar", "duration": 1.1}},
        {"error_bounds": {"position": 0.011}},
        {"control_frequency": 400.0},
    ]
    for question in questions:
        find_best_known(**({"env_id": PLANAR_ID} | question))
    assert len(solved) == len(questions) == len(list(cache.iterdir()))
    find_best_known(
        PLANAR_ID, robot=PLANAR, trajectory="paper-planar", error_bounds=ErrorBounds(), control_frequency=500
    )
    assert len(solved) == len(questions)  # the defaults, written out


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 half"])
def test_a_broken_result_is_not_in_the_way(solved: list[Any], cache: Path, content: bytes) -> None:
    find_best_known(PLANAR_ID)
    (path,) = cache.iterdir()
    path.write_bytes(content)
    assert find_best_known(PLANAR_ID).payload == 2.0
    assert find_best_known(PLANAR_ID).payload == 2.0


def test_a_result_of_another_form_is_not_in_the_way(solved: list[Any], cache: Path) -> None:
    """As an older version may have written it."""
    find_best_known(PLANAR_ID)
    (path,) = cache.iterdir()
    with np.load(path) as file:
        arrays = dict(file)
    arrays["result"] = np.array(json.dumps({"payload": 5.0}))
    np.savez(path, **arrays)
    assert find_best_known(PLANAR_ID).payload == 2.0


def test_a_cache_that_cannot_be_written_does_no_harm(
    solved: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("no folder", encoding="utf-8")
    monkeypatch.setenv("CABLEBOT_CACHE", str(tmp_path / "file"))
    assert find_best_known(PLANAR_ID).payload == 1.0


# --- bad input --------------------------------------------------------------------------------------------------------

WEAK = SPATIAL.replace(motors=Motors(stall_torque=1.0, free_speed=100.0))


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"error_bounds": {"position": 0.0}}, "position must be a number greater than 0"),
        ({"error_bounds": {"positon": 0.1}}, "with the keys position, rotation"),
        ({"env_id": "CableBot-Planar-v1"}, "CableBot-Planar-v0"),
        ({"robot": SPATIAL}, "does not fit CableBot-Planar-v0: use CableBot-Spatial-v0"),
        ({"robot": FLEX_PLANAR}, "does not fit CableBot-Planar-v0: use CableBot-FlexPlanar-v0"),
        ({"trajectory": "paper-spatial"}, "is not for 2 coordinates"),
        ({"trajectory": {"name": "circle-planar", "radius": 0.7}}, r"leaves the workspace of 'planar' at t = .*: x = "),
        (
            {"robot": PLANAR.replace(mass=5.0)},
            "infeasible even unloaded: the platform has 5 kg.* the motors' torque-speed lines",
        ),
        (
            {"env_id": SPATIAL_ID, "robot": WEAK, "trajectory": HANG},
            "infeasible even unloaded: the platform has 10 kg.* the motors' torque-speed lines",
        ),
        ({"trajectory": "dwell-planar"}, "nothing limits the payload on 'dwell-planar'"),
        ({"control_frequency": 0.0}, "control_frequency must give at least one step"),
        ({"control_frequency": float("nan")}, "control_frequency must give at least one step"),
        ({"control_frequency": float("inf")}, "control_frequency must give at least one step"),
        ({"control_frequency": 0.4}, "control_frequency must give at least one step"),
    ],
)
def test_what_cannot_be_found_is_not_searched_or_blamed_on_the_solver(
    arguments: dict[str, Any], message: str, cache: Path
) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        find_best_known(**({"env_id": PLANAR_ID} | arguments))
    assert "\n" not in str(caught.value)
    assert "Infeasible" not in str(caught.value)
    assert not cache.exists()


@pytest.mark.usefixtures("quick")
def test_a_narrow_tube_about_a_jump_is_not_blamed_on_the_motors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(best_known, "_FIRST_MESHES", 1)
    with pytest.raises(ValueError, match="no motion along 'paper-planar'") as caught:
        find_best_known(PLANAR_ID, error_bounds={"position": 1e-6}, cache=False)
    assert "the position bound of 1e-06 m" in str(caught.value)
    assert "motors" not in str(caught.value)


def test_missing_casadi_is_not_found_out_after_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "casadi", None)
    monkeypatch.setattr(best_known._Case, "solve", lambda *_: pytest.fail("searched"))
    with pytest.raises(ImportError, match=r"pip install 'cablebot-gym\[optimal\]'"):
        find_best_known(PLANAR_ID)
