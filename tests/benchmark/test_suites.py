"""Suites: their rows and policies, and the hidden motions that follow from a public text."""

import hashlib
import sys

import pytest
from benchmark.made_rows import PLANAR
from oracles.episodes import ROBOTS

from cablebot_gym.benchmark.policy_source import policy_source
from cablebot_gym.benchmark.seeds import evaluation_seed, hidden_seeds
from cablebot_gym.benchmark.suites import (
    SUITES,
    Override,
    Suite,
    find_env_ids,
    find_policies,
    find_suite,
    suite_rows,
)
from cablebot_gym.envs import PAPER_ENV_IDS
from cablebot_gym.evaluation.survey import motion_seeds
from cablebot_gym.motions import FIRST_HELD_OUT_SEED
from cablebot_gym.policies import policy_entries
from cablebot_gym.uncertainty import find_uncertainty

SPATIAL = "CableBot-Spatial-v0"
TEXT = "A headline of 4 January 2027"


def rows_of(name, names=()):
    """All rows of a suite, with the usual policies or those given."""
    suite = find_suite(name)
    return suite_rows(suite, find_policies(names, suite.env_ids), seed_text=TEXT)


def payload_rows(name, names=()):
    return [row for row in rows_of(name, names) if row.measure == "payload"]


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.landing) for name in sorted(SUITES)]
)
def test_rows_of_a_suite_are_valid(name):
    motions = {}
    optima = set()
    with_score = set()
    draws = set()
    for row in rows_of(name):
        given = row.conditions
        motions[given.env_id, row.motion] = given
        if row.measure == "optimum":
            optima.add(row.motion_key)
        elif row.measure == "payload":
            assert given.env_id in policy_entries()[row.policy].env_ids
            draws.add((given.env_id, given.uncertainty, given.draws))
            if given.criterion == "task" and given.uncertainty is None:
                with_score.add(row.motion_key)
    for given in motions.values():
        assert given.motion.duration > 0
    assert optima == with_score
    for env_id, uncertainty, count in draws:
        assert find_uncertainty(uncertainty, ROBOTS[env_id]).random == (count is not None)


def test_ranked_suite_has_every_policy_on_the_first_hidden_motions():
    env_ids = find_suite("ranked").env_ids
    rows = rows_of("ranked")
    policies = set()
    for entry in policy_entries().values():
        policies |= {(env_id, entry.name) for env_id in entry.env_ids if env_id in env_ids}
    for measure in ("payload", "time"):
        asked = [row for row in rows if row.measure == measure]
        assert {(row.conditions.env_id, row.policy) for row in asked} == policies
    for env_id in env_ids:
        found = {"payload": [], "optimum": [], "best-known": [], "drawn": []}
        for row in rows:
            if row.conditions.env_id == env_id and row.family and row.measure in found:
                found[row.measure].append(row.conditions.trajectory["seed"])
        seeds = hidden_seeds(TEXT, env_id, 20)
        assert set(found["payload"]) == set(found["drawn"]) == set(seeds)
        assert found["optimum"] == seeds
        assert found["best-known"] == seeds[:1]


def test_law_for_known_robots_meets_exactly_known_ones_only():
    conditions = {
        (row.conditions.uncertainty, row.motion[:4]) for row in payload_rows("ranked", ["fl"])
    }
    assert conditions == {(None, "loop"), (None, "circ"), (None, "pape")}


def test_keyword_of_the_environments_is_an_override():
    """``cable = "bilateral"`` ended in a traceback at the import of the suites."""
    suite = Suite(
        name="tiny",
        summary="",
        env_ids=(PLANAR,),
        overrides=(Override.from_dict({"motion": "circle", "cable": "bilateral"}),),
    )
    rows = [row for row in suite_rows(suite, {PLANAR: ("fl",)}) if row.policy]
    assert [row.conditions.keywords()["cable"] for row in rows] == ["bilateral"]


def test_policies_are_assigned_to_their_environments():
    assert find_policies(["fl", "flex-eq22", "fl"], PAPER_ENV_IDS) == {
        PLANAR: ("fl",),
        SPATIAL: ("fl",),
        "CableBot-FlexPlanar-v0": (),
        "CableBot-FlexSpatial-v0": ("flex-eq22",),
    }


@pytest.mark.landing
def test_module_of_another_package_stays_unimported(module):
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
            "from cablebot_gym.policies import PolicyEntry\n"
            "from cablebot_baselines.laws import FL as OURS\n"
            f"MORE = dict(kind='learned', env_ids=('{SPATIAL}',), factory=OURS.factory, summary='')\n"
            "THEIRS, FL = (PolicyEntry(name=name, **MORE) for name in ('theirs', 'fl'))\n",
        ),
    ):
        module(name, text)
    policies = find_policies([], PAPER_ENV_IDS)
    assert "fl" in policies[PLANAR]
    assert "theirs" not in {name for names in policies.values() for name in names}
    policies = find_policies(["theirs"], [PLANAR, SPATIAL])
    assert policies == {PLANAR: (), SPATIAL: ("theirs",)}
    with pytest.raises(ValueError, match="unknown policy 'broken'"):
        find_policies(["broken"], [PLANAR])
    assert policy_source("theirs") == (("toy_other:THEIRS",), ())
    assert policy_source("fl")[0] == ("cablebot_baselines.laws:FL",)
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


# --- hidden motions ---------------------------------------------------------------------------------------------------


HIDDEN = Suite(
    name="s",
    summary="",
    env_ids=(PLANAR,),
    overrides=(Override(motion="hidden", motions=20),),
)


def test_seeds_are_the_hashes_that_the_documentation_gives():
    digest = hashlib.sha256(TEXT.encode()).hexdigest()
    seed = hashlib.sha256(f"{digest}:evaluation".encode()).digest()[:16]
    assert evaluation_seed(TEXT) == int.from_bytes(seed)
    motion = int.from_bytes(hashlib.sha256(f"{digest}:{PLANAR}:1".encode()).digest())
    expected = FIRST_HELD_OUT_SEED + motion % (2**53 - FIRST_HELD_OUT_SEED)
    assert hidden_seeds(TEXT, PLANAR, 2)[1] == expected


def test_hidden_motions_depend_on_text_and_environment():
    seeds = hidden_seeds(TEXT, PLANAR, 20)
    others = hidden_seeds(TEXT, SPATIAL, 20) + hidden_seeds(f"{TEXT}.", PLANAR, 20)
    assert len({*seeds, *others}) == 60
    assert all(FIRST_HELD_OUT_SEED <= seed < 2**53 for seed in seeds)
    rows = suite_rows(HIDDEN, {PLANAR: ("fl",)}, seed=2**127, seed_text=TEXT)
    asked = [row for row in rows if row.policy]
    assert [row.conditions.trajectory["seed"] for row in asked] == seeds
    assert [row.conditions.seed for row in asked] == motion_seeds(2**127, 20)
