"""Finished training runs for the tests of cards and of the script that makes them."""

import json
from dataclasses import replace
from pathlib import Path

import train_shipped as script
from cards.card import read_cards
from cards.making import Protocol

from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.planner import Planning
from cablebot_baselines.learned.planner_run import ALGORITHM
from cablebot_baselines.learned.runs import BEST, LAST, read_yaml
from cablebot_baselines.learned.shipped import SHIPPED
from cablebot_gym import ENV_IDS
from cablebot_gym.benchmark.cells import BestKnownCell

ROOT = Path(__file__).parents[2]
PLANAR_ID, _, FLEX_PLANAR_ID = ENV_IDS[:3]
PLANNER = SHIPPED["planner"]

BEST_KNOWN = {
    BestKnownCell(env_id=PLANAR_ID, trajectory=trajectory).motion_key: payload
    for trajectory, payload in (
        ({"name": "circle-planar"}, 2.875),
        *(({"name": "loop-planar", "seed": 10_000 + index}, 4.0) for index in range(3)),
    )
}
"""Best known payloads of a leaderboard with the circle and three held-out loops [kg]."""

SEARCHED = {10_003: (5.0, True), 10_004: (1.0, True), 10_005: (6.0, False)}
"""Payload that the search finds for the loop of each seed [kg], and whether it is verified."""

PAYLOADS = {0: 2.0, 1: None, 2: 2.8, 3: 2.4, 4: 2.6}
"""Payload of each seed if the payload is known; 1 kg less if it is unknown."""

IN_TRAINING = {0: 2.0, 1: None, 2: 2.9, 3: 2.7, 4: 2.5}
"""Payload of each seed in its evaluations during training; the median belongs to another seed than
in PAYLOADS."""


def save_run(folder, seed=0, env_id=PLANAR_ID, **changes):
    """Writes a finished run of ``planner`` whose network outputs nearly zero; ``changes`` are of
    its card."""
    plain = read_yaml(env_id, Path(ALGORITHM))
    untrained = Bundle.of_planning(env_id, Planning())
    untrained.network.biases[0][:] = 1e-9 * seed
    card = {
        "command": f"cablebot train {env_id} --algo planner --seed {seed} --threads 1",
        "env_id": env_id,
        "algorithm": ALGORITHM,
        "config": json.loads(json.dumps(plain)),
        "seed": seed,
        "timesteps": 700 + seed,
        "wall_s": 60.0 + seed,
        "threads": 1,
        "versions": {"python": "3.11", "torch": "2"},
        "planner_output_used": False,
        "dwell": 0.3,
        "evaluation": {"criterion": "task", "resolution": 0.05},
        "curve": [{"timesteps": 350, "wall_s": 60.0, "payload_kg": IN_TRAINING.get(seed)}],
        "base_payload_kg": 1.4,
    }
    bundle = replace(untrained, card=card | changes)
    bundle.save(folder / BEST)
    bundle.save(folder / LAST)
    return folder


def ship(runs, weights):
    """Ships ``planner`` on the planar robot and returns its card."""
    script.ship_all(
        [(PLANNER, PLANAR_ID)],
        seeds=5,
        runs=runs,
        weights=weights,
        protocol=Protocol(held_out=7, searched=6),
    )
    (card,) = read_cards(weights)
    return card
