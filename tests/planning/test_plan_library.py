"""The cache of plans on disk: its keys, and broken files and folders."""

import pytest
from oracles.episodes import check_equal

from cablebot_gym.motions import PointToPoint, find_trajectory
from cablebot_gym.planning import Margins, MotionProgram, library
from cablebot_gym.planning.library import cache_folder, cached_plan, fingerprint
from cablebot_gym.robots import PLANAR, Motors
from cablebot_gym.task import ErrorBounds

pytest.importorskip("casadi")
pytestmark = pytest.mark.usefixtures("cache")

LINE = find_trajectory({"name": "line-planar", "duration": 0.4}, 2)
BOUNDS = ErrorBounds(position=0.01)


def plan(robot=PLANAR, trajectory=LINE, error_bounds=BOUNDS, intervals=8, **options):
    settings = {"error_bounds": error_bounds, "intervals": intervals, **options}
    program = MotionProgram(robot, trajectory, **settings)
    return cached_plan(
        "cablebot_gym.planning.program", robot, trajectory, program.solve, **settings
    )


def test_stored_plan_is_read_in_place_of_a_solution(cache, monkeypatch):
    solution = plan(lightest=0.1)
    monkeypatch.setattr(MotionProgram, "solve", lambda *_: pytest.fail("solved again"))
    stored = plan(lightest=0.1)
    check_equal(stored.to_arrays(), solution.to_arrays())
    assert [path.suffix for path in cache.iterdir()] == [".npz"]


def test_every_setting_makes_another_plan(monkeypatch):
    motors = Motors(stall_torque=5.1, free_speed=PLANAR.motors.free_speed)
    changed_settings = [
        {"robot": PLANAR.replace(motors=motors)},
        {"trajectory": find_trajectory({"name": "line-planar", "duration": 0.41}, 2)},
        {
            "trajectory": PointToPoint(
                name="line-planar", start=(-0.1, -0.1), end=(0.1, 0.16), duration=0.4
            )
        },
        {"error_bounds": ErrorBounds(position=0.011)},
        {"intervals": 9},
        {"margins": Margins(action=0.1)},
        {"lightest": 0.0},
        {"period": 0.002},
    ]
    example = plan()
    monkeypatch.setattr(MotionProgram, "solve", lambda program: example)
    for changes in changed_settings + changed_settings:
        plan(**changes)
    assert len(list(cache_folder().iterdir())) == len(changed_settings) + 1


def test_fingerprint_depends_on_code_and_solver(monkeypatch):
    def key(module="cablebot_gym.planning.program", frequency=500.0):
        return fingerprint(module, PLANAR, LINE, control_frequency=frequency, error_bounds=BOUNDS)

    expected_key = key()
    assert expected_key == key()
    keys = [expected_key, key("cablebot_gym.bounds.best_known"), key(frequency=250.0)]
    monkeypatch.setattr(library, "version", lambda _: "0")
    keys.append(key())
    monkeypatch.setattr(library, "source_hash", lambda _: "another code")
    keys.append(key())
    assert len(set(keys)) == len(keys)


def test_plan_without_a_usable_folder_is_solved(tmp_path, monkeypatch):
    file = tmp_path / "file"
    file.write_text("no folder", encoding="utf-8")
    monkeypatch.setenv("CABLEBOT_CACHE", str(file / "cache"))
    assert plan().payload > 0
