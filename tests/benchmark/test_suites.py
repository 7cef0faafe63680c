"""Suites: their cells and policies."""

import sys
from dataclasses import replace
from itertools import chain

import pytest
from oracles.episodes import ROBOTS

from cablebot_gym.benchmark.cells import (
    BestKnownCell,
    PolicyCell,
    SurveyCell,
    TimingCell,
    canonical,
)
from cablebot_gym.benchmark.policy_source import policy_source
from cablebot_gym.benchmark.seeds import hidden_seeds
from cablebot_gym.benchmark.suites import (
    QUICK_ENV_IDS,
    SUITES,
    find_env_ids,
    find_policies,
    find_suite,
    suite_cells,
    surveyed_motions,
)
from cablebot_gym.envs import PAPER_ENV_IDS
from cablebot_gym.policies import policy_entries
from cablebot_gym.trajectories import find_trajectory, held_out_seeds
from cablebot_gym.uncertainty import find_uncertainty

PLANAR = "CableBot-Planar-v0"
SPATIAL = "CableBot-Spatial-v0"
TEXT = "A headline of 4 January 2027"
SURVEYED = 20
"""Motions of a survey of the suite ``ranked``."""


def cells_of(name, names=()):
    """All cells of a suite, with the usual policies or those given."""
    suite = find_suite(name)
    return list(suite_cells(suite, find_policies(names, suite.env_ids), seed_text=TEXT).values())


def policy_cells(name, names=()):
    return [cell for cell in cells_of(name, names) if isinstance(cell, PolicyCell)]


def parts(cell):
    """The cells of the single motions of a survey; other cells themselves."""
    return cell.parts if isinstance(cell, SurveyCell) else [cell]


SLOW = {
    "errors": pytest.mark.landing,
    "standard": pytest.mark.landing,
    "full": pytest.mark.nightly,
    "ranked": pytest.mark.nightly,
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=SLOW.get(name, ())) for name in sorted(SUITES)]
)
def test_cells_of_a_suite_are_valid(name):
    with_best_known = set()
    with_score = set()
    motions = {}
    draws = set()
    for cell in cells_of(name):
        for part in parts(cell):
            motions[canonical([part.env_id, part.trajectory])] = part
        if isinstance(cell, BestKnownCell):
            with_best_known.add(cell.motion_key)
        elif isinstance(cell, PolicyCell):
            named = chain.from_iterable(block.env_ids for block in find_suite(name).blocks)
            assert cell.env_id in {*policy_entries()[cell.policy].env_ids, *named}
            draws.add((cell.env_id, cell.uncertainty, cell.draws))
            if cell.criterion == "task" and cell.uncertainty is None:
                with_score |= {part.motion_key for part in parts(cell)}
    if name == "ranked":  # the yardstick has more motions than a policy
        assert with_score < with_best_known
    else:
        assert with_best_known == (with_score if find_suite(name).best_known else set())
    for env_id, uncertainty, count in draws:
        assert find_uncertainty(uncertainty, ROBOTS[env_id]).random == (count > 1)
    for cell in motions.values():
        find_trajectory(dict(cell.trajectory), cell.robot.kind)


@pytest.mark.parametrize("name", ["standard", "ranked"])
def test_suite_has_every_fast_policy_on_its_held_out_motions(name):
    env_ids = find_suite(name).env_ids
    fast = set()
    for entry in policy_entries().values():
        if name == "ranked" or not entry.slow:
            fast |= {(env_id, entry.name) for env_id in entry.env_ids if env_id in env_ids}
    evaluated = set()
    seeds = set()
    for cell in policy_cells(name):
        evaluated.add((cell.env_id, cell.policy))
        seeds |= {part.trajectory.get("seed") for part in parts(cell)}
    assert evaluated == fast
    held_out = set(held_out_seeds(3))
    if name == "ranked":
        held_out = {seed for env_id in env_ids for seed in hidden_seeds(TEXT, env_id, SURVEYED)}
    assert seeds == {None, *held_out}
    timed = {(cell.env_id, cell.policy) for cell in cells_of(name) if isinstance(cell, TimingCell)}
    assert timed >= fast


def test_slow_policy_is_evaluated_in_marked_blocks_only(monkeypatch):
    entries = policy_entries()
    assert [name for name, entry in entries.items() if entry.slow] == ["nmpc"]
    assert len(policy_cells("standard", ["fl"])) == 2 * 7
    slow = {"fl": replace(entries["fl"], slow=True)}
    monkeypatch.setattr("cablebot_gym.benchmark.suites.public_entry", slow.get)
    conditions = {
        (cell.uncertainty, cell.trajectory["name"][:4]) for cell in policy_cells("ranked", ["fl"])
    }
    assert conditions == {("hardware", "loop"), (None, "loop"), (None, "circ")}
    assert policy_cells("standard", ["fl"]) == []


def test_planners_and_robots_with_long_searches_have_the_first_motions_only():
    motions = {
        (policy, env_id in QUICK_ENV_IDS): surveyed_motions(policy, env_id, 100)
        for policy in ("trajopt", "fl")
        for env_id in find_suite("ranked").env_ids
    }
    assert motions == {
        ("trajopt", True): 20,
        ("trajopt", False): 20,
        ("fl", True): 100,
        ("fl", False): 20,
    }


def test_policies_of_the_ranked_suite_have_the_first_motions_of_the_yardstick():
    cells = cells_of("ranked", ["fl"])
    for env_id in QUICK_ENV_IDS:
        seeds = hidden_seeds(TEXT, env_id, 100)
        surveys = [cell for cell in cells if isinstance(cell, SurveyCell) and cell.env_id == env_id]
        for survey in surveys:
            assert list(survey.trajectory["seed"]) == seeds[:SURVEYED]
        planned = [
            cell.trajectory.get("seed")
            for cell in cells
            if isinstance(cell, BestKnownCell) and cell.env_id == env_id
        ]
        assert set(planned) == {None, *seeds}


def test_errors_of_an_uncertainty_are_cells_of_their_own():
    """A rigid robot has no stiffness. Without error there is one draw."""
    cells = policy_cells("errors", ["fl"])
    draws = {cell.uncertainty: cell.draws for cell in cells if cell.env_id == PLANAR}
    assert draws.pop(None) == 1
    assert set(draws.values()) == {19}
    names = ["platform_mass", "payload", "motor_strength", "motor_lag", "coulomb_friction"]
    names += ["pulley_inertia", "base_anchors", "damping"]
    names += ["wrench", "sensors", "sensor_bias", "delay"]
    assert list(draws) == [*(f"hardware:{name}" for name in names), "hardware"]


def test_policies_are_assigned_to_their_environments():
    assert find_policies(["fl", "flex-eq22", "fl"], PAPER_ENV_IDS) == {
        PLANAR: ("fl",),
        SPATIAL: ("fl",),
        "CableBot-FlexPlanar-v0": (),
        "CableBot-FlexSpatial-v0": ("flex-eq22",),
    }


@pytest.mark.landing
def test_code_of_another_package_is_not_imported_here(tmp_path, module):
    """Its module once patched the judge when the benchmark read its environment ids. It cannot
    replace `fl` either."""
    for name, text in (
        ("toy_other-1.dist-info/METADATA", "Metadata-Version: 2.1\nName: toy-other\nVersion: 1\n"),
        (
            "toy_other-1.dist-info/entry_points.txt",
            "[cablebot_gym.policies]\ntheirs = toy_other:THEIRS\nfl = toy_other:FL\nbroken = toy_other:NONE\n",
        ),
        (
            "toy_other.py",
            "from pathlib import Path\nfrom cablebot_gym.policies import PolicyEntry\n"
            f"MORE = dict(kind='learned', env_ids=('{SPATIAL}',), factory=None, summary='', files=(Path(__file__),))\n"
            "THEIRS, FL = (PolicyEntry(name=name, slow=True, **MORE) for name in ('theirs', 'fl'))\n",
        ),
    ):
        module(name, text)
    policies = find_policies([], PAPER_ENV_IDS)
    assert [env_id for env_id in PAPER_ENV_IDS if "theirs" in policies[env_id]] == [SPATIAL]
    assert "fl" in policies[PLANAR]
    assert "broken" not in {name for names in policies.values() for name in names}
    assert policy_source("theirs") == (("toy_other",), (tmp_path / "toy_other.py",))
    assert policy_source("fl")[0] == ("cablebot_baselines.classical",)
    slow = suite_cells(find_suite("standard"), {SPATIAL: ("theirs",)}).values()
    assert not [cell for cell in slow if isinstance(cell, PolicyCell)]
    assert "toy_other" not in sys.modules


@pytest.mark.parametrize(
    ("names", "ids", "message"),
    [
        (["nobody"], [], "unknown policy 'nobody'"),
        (
            ["flex-eq22"],
            [PLANAR],
            "policy 'flex-eq22' supports CableBot-FlexSpatial-v0, not CableBot-Planar-v0",
        ),
        (
            [],
            [SPATIAL],
            "unknown environment of suite 'smoke' 'CableBot-Spatial-v0'; choose one of",
        ),
    ],
)
def test_unknown_or_unsuitable_names_raise(names, ids, message):
    with pytest.raises(ValueError, match=message):
        find_policies(names, find_env_ids(find_suite("smoke"), ids))
