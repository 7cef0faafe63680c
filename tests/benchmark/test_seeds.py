"""Hidden motions and the evaluation seed follow from a public text."""

import hashlib

from cablebot_gym.benchmark.seeds import evaluation_seed, hidden_seeds
from cablebot_gym.benchmark.suites import Override, Suite, suite_rows
from cablebot_gym.evaluation.survey import motion_seeds
from cablebot_gym.motions import FIRST_HELD_OUT_SEED

PLANAR = "CableBot-Planar-v0"
SPATIAL = "CableBot-Spatial-v0"
TEXT = "A headline of 4 January 2027"
HIDDEN = Suite(
    name="s",
    summary="",
    env_ids=(PLANAR,),
    overrides=(Override(motion="hidden", motions=20),),
    best_known=False,
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
    assert [row.conditions.trajectory["seed"] for row in rows] == seeds
    assert [row.conditions.seed for row in rows] == motion_seeds(2**127, 20)
