"""Making cards from finished training runs, and updating them from the leaderboard."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from cablebot_baselines.classical.flexible import Composite, FourthOrder, MotorPD
from cablebot_baselines.learned.base import Base
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.runs import BEST, LAST
from cablebot_baselines.learned.shipped import Shipped, stem
from cablebot_baselines.learned.steering import action_mapping_to_jsonable
from cablebot_gym.benchmark.cells import BestKnownCell, Cell, PolicyCell, Record
from cablebot_gym.benchmark.leaderboard import Results
from cablebot_gym.benchmark.scores import best_known_payloads, motion_key
from cablebot_gym.envs import FLEXIBLE_ENV_IDS, env_robot
from cablebot_gym.envs.settings import default_trajectory
from cablebot_gym.robots import find_robot
from cablebot_gym.trajectories import held_out_seeds
from cards.card import (
    CONDITIONS,
    DRAWS,
    HELD_OUT,
    KNOWN,
    PROBABILITY,
    Card,
    Condition,
    HeldOut,
    SeedRun,
    has_loops,
)
from cards.statistics import median_seed

Evaluate = Callable[[Mapping[str, Cell]], Sequence[Record]]
"""Function that computes cells, given by key, and returns one record for each."""


def reference_law(env_id: str) -> str:
    """The classical law for comparison."""
    return "composite-tuned" if env_id in FLEXIBLE_ENV_IDS else "fl"


def read_best_known(path: Path) -> dict[str, float]:
    """Reads the best known payloads from a benchmark's ``results.json``.

    Returns:
        Payloads [kg] by :func:`~cablebot_gym.benchmark.scores.motion_key`.

    Raises:
        OSError, ValueError, KeyError: if the file cannot be read.
    """
    return _known(Results.from_json(path.read_text(encoding="utf-8")).records)


def _known(records: Sequence[Record]) -> dict[str, float]:
    return {
        key: best.payload
        for key, best in best_known_payloads(records).items()
        if best.payload is not None
    }


def make_card(
    shipped: Shipped,
    env_id: str,
    runs: Sequence[Path],
    *,
    evaluate: Evaluate,
    best_known: Mapping[str, float],
    command: str,
    draws: int = DRAWS,
    probability: float = PROBABILITY,
    held_out: int = HELD_OUT,
    searched: int = HELD_OUT,
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
        draws: number of fresh draws that confirm a payload under an uncertainty.
        probability: required success rate under an uncertainty.
        held_out: number of held-out motions.
        searched: number of held-out motions with a search for the best known payload, for training
            on random loops.

    Returns:
        The card, and the path of the bundle to ship.

    Raises:
        ValueError: if the runs belong to another policy or to different configurations, or are not
            bundles.
        RuntimeError: if an evaluation failed; the message contains the reason.
    """
    bundles = [Bundle.load(run / BEST) for run in runs]
    records = [Bundle.load(run / LAST).card for run in runs]
    _check_runs(shipped, env_id, runs, records)
    first = bundles[0]
    seeds = [int(card["seed"]) for card in records]
    motions = _motions(records[0]["config"], env_id)
    base = runs[0].parent / f"{stem(shipped.name, env_id)}-base.zip"
    first.base_alone.save(base)
    law = reference_law(env_id)
    conditions = CONDITIONS[shipped.name]

    def cells(policy: str) -> list[PolicyCell]:
        return [_cell(policy, env_id, condition, draws, probability) for condition in conditions]

    policies = [*(str(run / BEST) for run in runs), str(base), law]
    payloads = _payloads([cell for policy in policies for cell in cells(policy)], evaluate)
    count = len(conditions)
    rows = [tuple(payloads[count * index : count * (index + 1)]) for index in range(len(policies))]
    trainings = tuple(_seed_run(card, row) for card, row in zip(records, rows, strict=False))
    chosen = median_seed({run.seed: run.in_training for run in trainings})
    evaluated = (
        seeds if has_loops(motions) else [chosen]
    )  # a policy for one motion is not made for others
    names = {
        seed: str(run / BEST) for seed, run in zip(seeds, runs, strict=True) if seed in evaluated
    }
    unseen, motions_held_out = _held_out(
        names, law, env_id, conditions[0].payload_known, held_out, evaluate
    )
    best = runs[seeds.index(chosen)] / BEST
    card = Card(
        policy=shipped.name,
        env_id=env_id,
        algorithm=shipped.algorithm,
        config=shipped.config,
        command=command,
        base=asdict(first.base),
        base_text=base_text(first.base, env_id),
        steering=action_mapping_to_jsonable(first.action_mapping),
        features=first.features,
        parameters=sum(array.size for array in (*first.network.weights, *first.network.biases)),
        motions=motions,
        evaluation=records[0]["evaluation"],
        planner_output_used=any(card["planner_output_used"] for card in records),
        dwell=min(card["dwell"] for card in records),
        conditions=conditions,
        draws=draws,
        probability=probability,
        shipped_seed=chosen,
        sha256=hashlib.sha256(best.read_bytes()).hexdigest(),
        base_in_training=records[0]["base_payload_kg"],
        base_payloads=rows[-2],
        law=law,
        law_payloads=rows[-1],
        best_known=None,
        seeds=tuple(replace(run, held_out=unseen.get(run.seed, ())) for run in trainings),
        held_out=motions_held_out,
    )
    if searched and has_loops(card.motions):
        best_known = {
            **_search(env_id, min(searched, held_out), best_known, evaluate),
            **best_known,
        }
    return with_best_known(card, best_known), best


def with_best_known(card: Card, best_known: Mapping[str, float]) -> Card:
    """The card with the best known payloads of a leaderboard, from :func:`read_best_known`.

    Held-out motions that are not on the leaderboard keep their best known payload, unless a
    policy's DLCC is larger.
    """
    law, env_id = card.law, card.env_id

    def best(index: int, motion: HeldOut) -> float | None:
        known = best_known.get(motion_key(_best_known_cell(env_id, motion.seed)), motion.best_known)
        payloads = [motion.law_payload, *(run.held_out[index] for run in card.evaluated_runs)]
        return None if known is None else max(known, *(payload or 0.0 for payload in payloads))

    held_out = tuple(
        replace(motion, best_known=best(index, motion))
        for index, motion in enumerate(card.held_out)
    )
    return replace(
        card, best_known=best_known.get(motion_key(_cell(law, env_id, KNOWN))), held_out=held_out
    )


def with_search_results(card: Card, evaluate: Evaluate, best_known: Mapping[str, float]) -> Card:
    """The card after a search for the best known payload on its held-out motions without one.

    Arguments as for :func:`make_card`; needs the extra ``optimal``.

    Raises:
        RuntimeError: if a search failed; the message contains the reason.
    """
    own = {
        motion_key(_best_known_cell(card.env_id, motion.seed)): motion.best_known
        for motion in card.held_out
    }
    known = {key: value for key, value in own.items() if value is not None} | {**best_known}
    return with_best_known(
        card, _search(card.env_id, len(card.held_out), known, evaluate) | {**best_known}
    )


def _best_known_cell(env_id: str, seed: int) -> BestKnownCell:
    return BestKnownCell(env_id=env_id, trajectory=_loop(env_id, seed))


def _search(
    env_id: str, count: int, known: Mapping[str, float], evaluate: Evaluate
) -> dict[str, float]:
    """Searches for the best known payload on held-out motions without one."""
    cells = [_best_known_cell(env_id, seed) for seed in held_out_seeds(count)]
    records = evaluate({cell.key: cell for cell in cells if motion_key(cell) not in known})
    if failed := [record for record in records if record.error is not None and not record.final]:
        raise RuntimeError(
            f"the search for the best known payload on {env_id} failed: {failed[0].error}"
        )
    return _known(records)


def _check_runs(
    shipped: Shipped, env_id: str, runs: Sequence[Path], records: Sequence[Mapping[str, Any]]
) -> None:
    seeds = [card["seed"] for card in records]
    if len({*seeds}) != len(seeds):
        raise ValueError(f"the runs of {shipped.name} must have different seeds, not {seeds}")
    for run, card in zip(runs, records, strict=True):
        if (card["env_id"], card["algorithm"]) != (env_id, shipped.algorithm):
            actual = f"{card['env_id']} by {card['algorithm']}"
            expected = f"{env_id} by {shipped.algorithm}"
            raise ValueError(
                f"run {str(run)!r} is a training on {actual}, not on {expected}: choose another --runs"
            )
        if card["config"] != records[0]["config"]:
            raise ValueError(
                f"runs {str(runs[0])!r} and {str(run)!r} have different configurations: repeat one of them"
            )


def _seed_run(card: Mapping[str, Any], payloads: tuple[float | None, ...]) -> SeedRun:
    names = ("seed", "command", "timesteps", "wall_s", "threads", "versions")
    return SeedRun(
        payloads=payloads, curve=tuple(card["curve"]), **{name: card[name] for name in names}
    )


def _held_out(
    policies: Mapping[int, str],
    law: str,
    env_id: str,
    payload_known: bool,
    count: int,
    evaluate: Evaluate,
) -> tuple[dict[int, tuple[float | None, ...]], tuple[HeldOut, ...]]:
    """DLCCs on held-out motions of ``policies``, by training seed, and of the law."""
    seeds = held_out_seeds(count)
    condition = Condition(payload_known=payload_known)
    names = [*policies.values(), law]
    cells = [
        _cell(name, env_id, condition, motion=_loop(env_id, seed))
        for name in names
        for seed in seeds
    ]
    payloads = _payloads(cells, evaluate)
    rows = [tuple(payloads[count * index : count * (index + 1)]) for index in range(len(names))]
    motions = (
        HeldOut(seed=seed, law_payload=other, best_known=None)
        for seed, other in zip(seeds, rows[-1], strict=True)
    )
    return dict(zip(policies, rows, strict=False)), tuple(motions)


def _loop(env_id: str, seed: int) -> dict[str, Any]:
    return {"name": f"loop-{_kind(env_id)}", "seed": seed}


def _kind(env_id: str) -> str:
    return "planar" if find_robot(env_robot(env_id)).planar else "spatial"


def _cell(
    policy: str,
    env_id: str,
    condition: Condition,
    draws: int = 1,
    probability: float = PROBABILITY,
    motion: Mapping[str, Any] | None = None,
) -> PolicyCell:
    return PolicyCell(
        env_id=env_id,
        trajectory={"name": _default_motion(env_id)} if motion is None else motion,
        policy=policy,
        payload_known=condition.payload_known,
        uncertainty=condition.uncertainty,
        draws=1 if condition.uncertainty is None else draws,
        probability=probability,
    )


def _payloads(cells: Sequence[PolicyCell], evaluate: Evaluate) -> list[float | None]:
    """DLCC of each cell [kg].

    Raises:
        RuntimeError: if an evaluation failed.
    """
    records = {record.cell.key: record for record in evaluate({cell.key: cell for cell in cells})}
    for cell in cells:
        if (error := records[cell.key].error) is not None:
            raise RuntimeError(f"the evaluation of {cell.policy} on {cell.env_id} failed: {error}")
    return [records[cell.key].result["payload"] for cell in cells]


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
    inner = getattr(law, "law", law)
    if base.law == "motor-pd":
        frequency = _default(MotorPD, "frequency") if base.frequency is None else base.frequency
        gains = f"ω = {frequency:g} rad/s, ζ = {_default(MotorPD, 'damping_ratio'):g}"
    elif base.law == "fl4":
        gains = f"poles {', '.join(f'{pole:g}' for pole in _default(FourthOrder, 'poles'))} 1/s"
    else:
        stiffness, damping = inner.outer.gains
        gains = f"K_P = {stiffness:g} 1/s², K_D = {damping:g} 1/s"
        if base.law == "composite":
            gains += f", K_v ≤ {_default(Composite, 'spring_damping'):g} √(K J′)"
    parts = [f"`{base.law}` with {gains}"]
    parts += [f"minimum tension {base.minimum_tension:g} N"] if robot.planar else []
    if base.estimates_payload:
        parts.append(f"payload estimator with prior weight {base.estimator_prior_weight:g} s")
    parts += ["allocation of the available motor torques"] if base.allocates else []
    return ", ".join(parts)


def _default(law: Any, name: str) -> Any:
    return inspect.signature(law).parameters[name].default
