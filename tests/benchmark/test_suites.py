"""Suites: which cells they have, of which policies."""

from __future__ import annotations

import sys
from dataclasses import replace

import pytest

from cablebot_gym import ENV_IDS
from cablebot_gym.benchmark.cells import BestKnownCell, PolicyCell, canonical
from cablebot_gym.benchmark.maps import AXES, varied_axes
from cablebot_gym.benchmark.scores import motion_key
from cablebot_gym.benchmark.suites import SUITES, find_env_ids, find_policies, find_suite, suite_cells
from cablebot_gym.envs import FLEXIBLE_ENV_IDS, env_robot
from cablebot_gym.policies import policy_entries
from cablebot_gym.robots import find_robot
from cablebot_gym.trajectories import find_trajectory, held_out_seeds
from cablebot_gym.uncertainty import find_uncertainty

PLANAR, SPATIAL = "CableBot-Planar-v0", "CableBot-Spatial-v0"


def cells(name, names=()):
    suite = find_suite(name)
    return list(suite_cells(suite, find_policies(names, suite.env_ids)).values())


@pytest.mark.parametrize("name", SUITES)
def test_every_cell_can_be_asked_and_has_a_best_known_payload(name):
    some = cells(name)
    best = {motion_key(cell) for cell in some if isinstance(cell, BestKnownCell)}
    assert best == {motion_key(cell) for cell in some if isinstance(cell, PolicyCell)}
    motions = {canonical([cell.env_id, dict(cell.trajectory)]): cell for cell in some}
    for cell in motions.values():
        find_trajectory(dict(cell.trajectory), find_robot(env_robot(cell.env_id)).coordinates)
    for cell in some:
        assert cell.stiffness is None or cell.env_id in FLEXIBLE_ENV_IDS
    conditions = {(cell.env_id, cell.uncertainty, cell.draws) for cell in some if isinstance(cell, PolicyCell)}
    for env_id, uncertainty, draws in conditions:
        assert find_uncertainty(uncertainty, find_robot(env_robot(env_id))).random == (draws > 1)
    for env_id, policy in {(cell.env_id, cell.policy) for cell in some if isinstance(cell, PolicyCell)}:
        assert env_id in policy_entries()[policy].env_ids


@pytest.mark.parametrize("name", ["standard", "full"])
def test_no_policy_environment_or_condition_is_missing(name):
    some = [cell for cell in cells(name) if isinstance(cell, PolicyCell)]
    assert {(cell.env_id, cell.policy) for cell in some} == {
        (env_id, entry.name) for entry in policy_entries().values() for env_id in entry.env_ids
    }
    for env_id in ENV_IDS:
        asked = {
            (cell.payload_model, cell.uncertainty, cell.criterion, str(cell.trajectory["name"]).startswith("paper-"))
            for cell in some
            if cell.env_id == env_id
        }
        for payload_model in ("payload known", "payload unknown"):
            for uncertainty, circle in ((None, True), (None, False), ("table6", True)):
                assert (payload_model, uncertainty, "task", circle) in asked
        assert ("payload unknown", "sensors", "task", True) in asked
        assert {
            ("payload known", None, "paper", True),
            ("payload model × 0.9", None, "task", True),
            ("payload model × 1.1", None, "task", True),
        } < asked
    seeds = {cell.trajectory["seed"] for cell in some if "seed" in cell.trajectory}
    assert seeds == set(held_out_seeds(len(seeds)))
    assert len(seeds) >= 2


def test_policy_that_takes_minutes_a_cell_is_not_asked_everywhere(monkeypatch):
    slow = {name: replace(entry, slow=name == "fl") for name, entry in policy_entries().items()}
    monkeypatch.setattr("cablebot_gym.benchmark.suites.policy_entries", lambda: slow)
    fl = [cell for cell in cells("standard", ["fl"]) if isinstance(cell, PolicyCell)]
    assert {(cell.payload_model, cell.uncertainty, cell.trajectory["name"][:5]) for cell in fl} == {
        ("payload known", None, "paper"),
        ("payload unknown", None, "paper"),
    }
    monkeypatch.undo()
    assert len(cells("standard", ["fl"])) > len(fl) + 16
    assert [name for name, entry in policy_entries().items() if entry.slow] == ["nmpc"]


def test_smoke_is_small():
    assert len(cells("smoke", ["fl"])) == 6


def test_policies_that_are_asked_for_are_those_that_are_asked():
    assert find_policies(["fl", "motor-pd", "fl"], ENV_IDS) == {
        PLANAR: ("fl",),
        SPATIAL: ("fl",),
        "CableBot-FlexPlanar-v0": ("motor-pd",),
        "CableBot-FlexSpatial-v0": ("motor-pd",),
    }


def test_factory_that_is_for_some_robots_takes_part_and_one_for_none_is_refused(tmp_path, monkeypatch):
    (tmp_path / "toy_suites.py").write_text(
        "def planar(robot):\n    assert robot.planar\n    return lambda observation: 0\n"
        "def none(robot):\n    raise RuntimeError('not today')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert find_policies(["toy_suites:planar"], [PLANAR, SPATIAL])[SPATIAL] == ("toy_suites:planar",)
    with pytest.raises(ValueError, match="not today"):
        find_policies(["toy_suites:none"], [PLANAR, SPATIAL])
    sys.modules.pop("toy_suites")


@pytest.mark.parametrize(
    ("names", "ids", "message"),
    [
        (["nobody"], [], "unknown policy 'nobody'; choose one of"),
        (["fl4"], [PLANAR], "policy 'fl4' supports CableBot-FlexSpatial-v0, not for CableBot-Planar-v0"),
        ([], ["CableBot-Round-v0"], "unknown environment 'CableBot-Round-v0'"),
        ([], [SPATIAL], "suite 'smoke' does not contain CableBot-Spatial-v0; it contains CableBot-Planar-v0"),
    ],
)
def test_bad_choice_is_one_sentence(names, ids, message):
    with pytest.raises(ValueError, match=message):
        find_policies(names, find_env_ids(find_suite("smoke"), ids))


def test_maps_vary_one_number_at_a_time_around_the_usual_task():
    some = [cell for cell in cells("maps") if isinstance(cell, PolicyCell)]
    for env_id in ENV_IDS:
        own = [cell for cell in some if cell.env_id == env_id and cell.policy == "apg-loops"]
        asked = {
            axis.name: {axis.value(cell) for cell in own if varied_axes(cell) in ((), (name,))}
            for name, axis in AXES.items()
        }
        springs = set(AXES["stiffness"].values) if "Flex" in env_id else {float("inf")}
        assert asked == {name: set(axis.values) for name, axis in AXES.items()} | {"stiffness": springs}
    assert all(len(varied_axes(cell)) <= 1 for cell in some)


def test_usual_number_of_a_map_is_the_very_cell_of_the_other_suites():
    shared = {cell.key for cell in cells("maps")} & {cell.key for cell in cells("standard")}
    assert len({cell_key for cell_key in shared if '"policy":"apg-loops"' in cell_key}) == len(ENV_IDS)


def test_unknown_suite_names_the_known_ones():
    with pytest.raises(ValueError, match="unknown suite 'huge'; choose one of smoke, standard, full"):
        find_suite("huge")
