"""Making cards from finished training runs, and updating them from the leaderboard."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from cablebot_baselines.classical.flexible import Composite, MotorPD
from cablebot_baselines.learned.base import Base
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.runs import BEST, LAST
from cablebot_baselines.learned.shipped import Shipped, stem
from cablebot_baselines.learned.steering import action_mapping_to_jsonable
from cablebot_gym.benchmark.cells import BestKnownCell, Cell, PolicyCell, SurveyCell
from cablebot_gym.benchmark.leaderboard import Results
from cablebot_gym.benchmark.records import Record, single_records
from cablebot_gym.benchmark.scores import best_known_payloads
from cablebot_gym.envs import FLEXIBLE_ENV_IDS, env_robot
from cablebot_gym.envs.settings import default_trajectory
from cablebot_gym.robots import find_robot
from cablebot_gym.trajectories import held_out_seeds
from cards.card import (
    CONDITIONS,
    HELD_OUT,
    KNOWN,
    Card,
    Condition,
    HeldOut,
    SeedRun,
    has_loops,
    loop_durations,
)
from cards.statistics import median_seed

PLANNER_BASE = "feedback linearization behind the observer of `observing`"
"""Description of the law that moves the platform as a planning network says."""

Evaluate = Callable[[Mapping[str, Cell]], Sequence[Record]]
"""Function that computes cells, given by key, and returns one record for each."""


def reference_law(env_id: str) -> str:
    """The classical law for comparison."""
    return "composite" if env_id in FLEXIBLE_ENV_IDS else "fl"


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """Sizes of the evaluation of a card."""

    held_out: int = HELD_OUT
    """Number of held-out motions."""
    searched: int = HELD_OUT
    """Number of held-out motions with a search for the best known payload, for training on random
    loops."""


STANDARD = Protocol()
"""Sizes of the evaluation of the shipped cards."""


def read_best_known(path: Path) -> dict[str, float]:
    """Reads the best known payloads from a benchmark's ``results.json``.

    Returns:
        Payloads [kg] by :attr:`~cablebot_gym.benchmark.cells.Setting.motion_key`.

    Raises:
        OSError, ValueError, KeyError: if the file cannot be read.
    """
    return _best_known(Results.from_json(path.read_text(encoding="utf-8")).records)


def _best_known(records: Sequence[Record]) -> dict[str, float]:
    payloads = {}
    for key, best in best_known_payloads(records).items():
        if best.payload is not None:
            payloads[key] = best.payload
    return payloads


def make_card(
    shipped: Shipped,
    env_id: str,
    runs: Sequence[Path],
    *,
    evaluate: Evaluate,
    best_known: Mapping[str, float],
    command: str,
    protocol: Protocol = STANDARD,
) -> tuple[Card, Path]:
    """Evaluates the policies of finished runs, one run for each training seed, and makes a card.

    The base law alone is written to ``NAME-KIND-base.zip`` next to the runs, and evaluated in the
    same way. If the policy was trained on random loops, the best known payload is searched for on
    the held-out motions without an entry in ``best_known``; this needs the extra ``optimal``.

    Args:
        shipped: policy of the runs.
        env_id: id of the environment.
        runs: folders with ``best.zip``, which is evaluated, and ``last.zip``, which holds the
            training record.
        evaluate: function that computes cells.
        best_known: best known payloads from :func:`read_best_known`.
        command: command line that makes the card.
        protocol: sizes of the evaluation.

    Returns:
        The card, and the path of the bundle to ship.

    Raises:
        ValueError: if the runs are not bundles.
        RuntimeError: if an evaluation failed; the message contains the reason.
    """
    bundle, *_ = [Bundle.load(run / BEST) for run in runs]
    records = [Bundle.load(run / LAST).card for run in runs]
    policies = {record["seed"]: run / BEST for record, run in zip(records, runs, strict=True)}
    base = runs[0].parent / f"{stem(shipped.name, env_id)}-base.zip"
    bundle.base_alone.save(base)
    laws = (str(base), reference_law(env_id))
    card = _evaluated_card(shipped, bundle, policies, laws, records, evaluate)
    card = _with_held_out(replace(card, command=command), policies, protocol.held_out, evaluate)
    if protocol.searched and has_loops(card.motions):
        count = min(protocol.searched, protocol.held_out)
        best_known = _search(env_id, count, best_known, evaluate) | {**best_known}
    return with_best_known(card, best_known), policies[card.shipped_seed]


def _evaluated_card(
    shipped: Shipped,
    bundle: Bundle,
    policies: Mapping[int, Path],
    laws: tuple[str, str],
    records: Sequence[Mapping[str, Any]],
    evaluate: Evaluate,
) -> Card:
    """The card without held-out motions, best known payloads and command.

    Args:
        shipped: policy of the runs.
        bundle: policy of one run.
        policies: policies of all runs by seed.
        laws: the base law alone and the reference law.
        records: training records of the runs.
        evaluate: function that computes cells.
    """
    env_id = bundle.env_id
    law = laws[1]
    conditions = CONDITIONS[shipped.name]
    cells = [_cell(law, env_id, condition) for condition in conditions]
    names = [*map(str, policies.values()), *laws]
    *payloads, base_payloads, law_payloads = _payload_rows(names, cells, evaluate)
    seed_runs = tuple(map(_seed_run, records, payloads))
    shipped_seed = median_seed({run.seed: run.in_training for run in seed_runs})
    return Card(
        policy=shipped.name,
        env_id=env_id,
        algorithm=shipped.algorithm,
        command="",
        base=asdict(bundle.base) if bundle.base else {},
        base_text=base_text(bundle.base, env_id) if bundle.base else PLANNER_BASE,
        steering=action_mapping_to_jsonable(bundle.action_mapping),
        features=bundle.features,
        parameters=sum(array.size for array in (*bundle.network.weights, *bundle.network.biases)),
        motions=_motions(records[0]["config"], env_id),
        evaluation=records[0]["evaluation"],
        planner_output_used=any(record["planner_output_used"] for record in records),
        dwell=min(record["dwell"] for record in records),
        loop_durations=loop_durations(env_id),
        conditions=conditions,
        shipped_seed=shipped_seed,
        sha256=hashlib.sha256(policies[shipped_seed].read_bytes()).hexdigest(),
        base_in_training=records[0]["base_payload_kg"],
        base_payloads=base_payloads,
        law=law,
        law_payloads=law_payloads,
        best_known=None,
        seeds=seed_runs,
        held_out=(),
    )


def _with_held_out(
    card: Card, policies: Mapping[int, Path], count: int, evaluate: Evaluate
) -> Card:
    """The card with DLCCs of the law and of its policies, by seed, on held-out motions."""
    if not has_loops(card.motions):  # a policy for one motion is not made for others
        policies = {card.shipped_seed: policies[card.shipped_seed]}
    motion_seeds = list(held_out_seeds(count))
    cell = SurveyCell(
        env_id=card.env_id,
        trajectory=_loop(card.env_id, motion_seeds),
        policy=card.law,
        payload_known=card.conditions[0].payload_known,
    )
    *rows, law_payloads = _payload_rows([*map(str, policies.values()), card.law], [cell], evaluate)
    payloads = dict(zip(policies, rows, strict=True))
    motions = []
    for seed, payload in zip(motion_seeds, law_payloads, strict=True):
        motions.append(HeldOut(seed=seed, law_payload=payload, best_known=None))
    runs = (replace(run, held_out=payloads.get(run.seed, ())) for run in card.seeds)
    return replace(card, seeds=tuple(runs), held_out=tuple(motions))


def with_best_known(card: Card, best_known: Mapping[str, float]) -> Card:
    """The card with the best known payloads of a leaderboard, from :func:`read_best_known`.

    Motions that are not on the leaderboard keep their best known payload, held-out ones unless a
    policy's DLCC is larger. So do random loops of an earlier family.
    """
    law, env_id = card.law, card.env_id
    has_present_loops = card.has_present_loops

    def best(index: int, motion: HeldOut) -> float | None:
        known = motion.best_known
        if has_present_loops:
            known = best_known.get(_best_known_cell(env_id, motion.seed).motion_key, known)
        payloads = [motion.law_payload, *(run.held_out[index] for run in card.evaluated_runs)]
        return None if known is None else max(known, *(payload or 0.0 for payload in payloads))

    held_out = tuple(
        replace(motion, best_known=best(index, motion))
        for index, motion in enumerate(card.held_out)
    )
    on_circle = best_known.get(_cell(law, env_id, KNOWN).motion_key, card.best_known)
    return replace(card, best_known=on_circle, held_out=held_out)


def _best_known_cell(env_id: str, seed: int) -> BestKnownCell:
    return BestKnownCell(env_id=env_id, trajectory=_loop(env_id, seed))


def known_on_held_out(cards: Sequence[Card]) -> dict[str, float]:
    """Best known payloads on the held-out motions of cards, as :func:`read_best_known` returns
    them [kg]."""
    payloads: dict[str, float] = {}
    for card in cards:
        for motion in card.held_out if card.has_present_loops else ():
            if motion.best_known is not None:
                key = _best_known_cell(card.env_id, motion.seed).motion_key
                payloads[key] = max(motion.best_known, payloads.get(key, 0.0))
    return payloads


def _search(
    env_id: str, count: int, known: Mapping[str, float], evaluate: Evaluate
) -> dict[str, float]:
    """Searches for the best known payload on held-out motions without one."""
    cells: dict[str, Cell] = {}
    for seed in held_out_seeds(count):
        cell = _best_known_cell(env_id, seed)
        if cell.motion_key not in known:
            cells[cell.key] = cell
    records = evaluate(cells)
    for record in records:
        if record.error is not None and not record.final:
            raise RuntimeError(
                f"the search for the best known payload on {env_id} failed: {record.error}"
            )
    return _best_known(records)


def _seed_run(card: Mapping[str, Any], payloads: tuple[float | None, ...]) -> SeedRun:
    return SeedRun(
        seed=card["seed"],
        command=card["command"],
        timesteps=card["timesteps"],
        wall_s=card["wall_s"],
        threads=card["threads"],
        versions=card["versions"],
        payloads=payloads,
        curve=tuple(card["curve"]),
    )


def _loop(env_id: str, seed: int | Sequence[int]) -> dict[str, Any]:
    return {"name": f"loop-{find_robot(env_robot(env_id)).kind}", "seed": seed}


def _cell(policy: str, env_id: str, condition: Condition) -> PolicyCell:
    return PolicyCell(
        env_id=env_id,
        trajectory={"name": _default_motion(env_id)},
        policy=policy,
        payload_known=condition.payload_known,
    )


def _payload_rows(
    policies: Sequence[str], cells: Sequence[PolicyCell], evaluate: Evaluate
) -> list[tuple[float | None, ...]]:
    """DLCC of each policy in each cell, and on each motion of a survey [kg]; the policies of
    ``cells`` do not count.

    Raises:
        RuntimeError: if an evaluation failed.
    """
    rows = [[replace(cell, policy=policy) for cell in cells] for policy in policies]
    records = {}
    for record in evaluate({cell.key: cell for row in rows for cell in row}):
        records[record.cell.key] = record
    payloads = []
    for row in rows:
        row_records = [records[cell.key] for cell in row]
        for record in row_records:
            if record.error is not None:
                raise RuntimeError(
                    f"the evaluation of {row[0].policy} on {row[0].env_id} failed: {record.error}"
                )
        payloads.append(tuple(record.result["payload"] for record in single_records(row_records)))
    return payloads


def _motions(config: Mapping[str, Any], env_id: str) -> Mapping[str, Any]:
    """Training motions of a configuration of either kind."""
    default = config.get("env_kwargs", {}).get("trajectory", _default_motion(env_id))
    motions: Mapping[str, Any] = config.get("motions", {"named": [default]})
    return motions


def _default_motion(env_id: str) -> str:
    return default_trajectory(find_robot(env_robot(env_id)))


def base_text(base: Base, env_id: str) -> str:
    """Describes a base law with all its gains."""
    robot = find_robot(env_robot(env_id))
    law: Any = base.make(robot)
    if base.law == "motor-pd":
        gains = f"ω = {_default(MotorPD, 'frequency'):g} rad/s, ζ = {_default(MotorPD, 'damping_ratio'):g}"
    else:
        stiffness, damping = law.outer.gains
        gains = f"K_P = {stiffness:g} 1/s², K_D = {damping:g} 1/s"
        if base.law == "composite":
            gains += f", K_v ≤ {_default(Composite, 'spring_damping'):g} √(K J′)"
    text = f"`{base.law}` with {gains}"
    if robot.planar:
        text += f", minimum tension {law.minimum_tension:g} N"
    return text


def _default(law: Any, name: str) -> Any:
    return inspect.signature(law).parameters[name].default
