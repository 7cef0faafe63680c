"""Cards made of finished trainings, and brought up to date with the leaderboard."""

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
from cablebot_baselines.learned.shipped import TOLD, Condition, Shipped, stem
from cablebot_baselines.learned.steering import way_to_plain
from cablebot_gym.benchmark.cells import BestCell, Cell, PolicyCell, Record
from cablebot_gym.benchmark.leaderboard import read_results
from cablebot_gym.benchmark.scores import find_bests, motion_key
from cablebot_gym.envs import FLEXIBLE_ENV_IDS, env_robot
from cablebot_gym.robots import find_robot
from cablebot_gym.trajectories import held_out_seeds
from cards.card import DRAWS, HELD_OUT, PROBABILITY, Card, HeldOut, SeedRun, has_loops
from cards.statistics import typical

Evaluate = Callable[[Mapping[str, Cell]], Sequence[Record]]
"""Computes cells given by key; a record of each."""


def reference_law(env_id: str) -> str:
    """The classical law to compare with."""
    return "composite-tuned" if env_id in FLEXIBLE_ENV_IDS else "fl"


def read_bests(path: Path) -> dict[str, float]:
    """The best found [kg] by :func:`~cablebot_gym.benchmark.scores.motion_key`, of a benchmark's ``results.json``.

    Raises:
        OSError, ValueError, KeyError: if the file cannot be read.
    """
    return _known(read_results(path.read_text(encoding="utf-8"))[2])


def _known(records: Sequence[Record]) -> dict[str, float]:
    return {key: best.payload for key, best in find_bests(records).items() if best.payload is not None}


def make_card(
    shipped: Shipped,
    env_id: str,
    runs: Sequence[Path],
    *,
    evaluate: Evaluate,
    bests: Mapping[str, float],
    command: str,
    draws: int = DRAWS,
    probability: float = PROBABILITY,
    held_out: int = HELD_OUT,
    searched: int = HELD_OUT,
) -> tuple[Card, Path]:
    """Judges the policies of finished runs, one for each training seed.

    The base law alone is put into ``NAME-KIND-base.zip`` beside the runs, to be judged as they are. Where random loops
    were trained on, the best found is searched for on held-out motions on which ``bests`` has none, which needs the
    extra ``optimal``.

    Args:
        shipped: what they are runs of.
        env_id: where.
        runs: folders, each with ``best.zip``, which is judged, and ``last.zip``, whose card has the whole training.
        evaluate: computes the cells.
        bests: from :func:`read_bests`.
        command: that makes the card.
        draws: episodes at each payload under an uncertainty.
        probability: share of the draws that has to carry a payload.
        held_out: number of held-out motions.
        searched: on how many of these the best found is searched for, if random loops were trained on.

    Returns:
        The card, and the bundle that is to ship.

    Raises:
        ValueError: if the runs are not of this policy, or not of one configuration, or no bundles.
        RuntimeError: if an evaluation failed, with its reason.
    """
    from cablebot_baselines.learned.export import silent_network  # these need torch
    from cablebot_baselines.learned.runs import BEST, LAST

    bundles = [Bundle.load(run / BEST) for run in runs]
    trained = [Bundle.load(run / LAST).card for run in runs]
    _check_runs(shipped, env_id, runs, trained)
    first, seeds = bundles[0], [int(card["seed"]) for card in trained]
    motions = _motions(trained[0]["config"])
    base = runs[0].parent / f"{stem(shipped.name, env_id)}-base.zip"
    silent = silent_network(first.network.inputs, first.network.outputs)
    replace(first, network=silent, card={"note": "the base law alone"}).save(base)
    law = reference_law(env_id)

    def asked(policy: str) -> list[PolicyCell]:
        return [_cell(policy, env_id, condition, draws, probability) for condition in shipped.conditions]

    policies = [*(str(run / BEST) for run in runs), str(base), law]
    payloads = _payloads([cell for policy in policies for cell in asked(policy)], evaluate)
    many = len(shipped.conditions)
    rows = [tuple(payloads[many * place : many * (place + 1)]) for place in range(len(policies))]
    trainings = tuple(_seed_run(card, row) for card, row in zip(trained, rows, strict=False))
    chosen = typical({run.seed: run.in_training for run in trainings})
    place = seeds.index(chosen)
    judged = seeds if has_loops(motions) else [chosen]  # what knows one motion alone is not made for others
    names = {seed: str(run / BEST) for seed, run in zip(seeds, runs, strict=True) if seed in judged}
    unseen, motions_held_out = _held_out(names, law, env_id, shipped.conditions[0].told, held_out, evaluate)
    best = runs[place] / BEST
    card = Card(
        policy=shipped.name,
        env_id=env_id,
        algorithm=shipped.algorithm,
        config=shipped.config,
        command=command,
        base=asdict(first.base),
        base_text=base_text(first.base, env_id),
        steering=way_to_plain(first.way),
        features=first.features,
        parameters=sum(array.size for array in (*first.network.weights, *first.network.biases)),
        motions=motions,
        evaluation=trained[0]["evaluation"],
        planner_output_used=any(card["planner_output_used"] for card in trained),
        conditions=shipped.conditions,
        draws=draws,
        probability=probability,
        shipped_seed=chosen,
        sha256=hashlib.sha256(best.read_bytes()).hexdigest(),
        base_in_training=trained[0]["base_payload_kg"],
        base_payloads=rows[-2],
        law=law,
        law_payloads=rows[-1],
        best_found=None,
        seeds=tuple(replace(run, held_out=unseen.get(run.seed, ())) for run in trainings),
        held_out=motions_held_out,
    )
    if searched and has_loops(card.motions):
        bests = {**_searched(env_id, min(searched, held_out), bests, evaluate), **bests}
    return with_bests(card, bests), best


def with_bests(card: Card, bests: Mapping[str, float]) -> Card:
    """The card with the best found as a leaderboard has it now, from :func:`read_bests`.

    What the leaderboard does not know of held-out motions stays, but for what a policy carries that is more.
    """
    law, env_id = card.law, card.env_id

    def best(place: int, one: HeldOut) -> float | None:
        known = bests.get(motion_key(_best_cell(env_id, one.seed)), one.best_found)
        carried = [one.law_payload, *(run.held_out[place] for run in card.judged)]
        return None if known is None else max(known, *(payload or 0.0 for payload in carried))

    held_out = tuple(replace(one, best_found=best(place, one)) for place, one in enumerate(card.held_out))
    return replace(card, best_found=bests.get(motion_key(_cell(law, env_id, TOLD))), held_out=held_out)


def with_searched(card: Card, evaluate: Evaluate, bests: Mapping[str, float]) -> Card:
    """The card with the best found searched for on those of its held-out motions on which none is known.

    Arguments as of :func:`make_card`; needs the extra ``optimal``.

    Raises:
        RuntimeError: if a search failed, with its reason.
    """
    own = {motion_key(_best_cell(card.env_id, one.seed)): one.best_found for one in card.held_out}
    known = {key: value for key, value in own.items() if value is not None} | {**bests}
    return with_bests(card, _searched(card.env_id, len(card.held_out), known, evaluate) | {**bests})


def _best_cell(env_id: str, seed: int) -> BestCell:
    return BestCell(env_id=env_id, trajectory=_loop(env_id, seed))


def _searched(env_id: str, count: int, bests: Mapping[str, float], evaluate: Evaluate) -> dict[str, float]:
    """The best found on held-out motions on which none is known."""
    cells = [_best_cell(env_id, seed) for seed in held_out_seeds(count)]
    records = evaluate({cell.key: cell for cell in cells if motion_key(cell) not in bests})
    if lost := [record for record in records if record.error is not None and not record.final]:
        raise RuntimeError(f"the best found on {env_id} could not be searched for: {lost[0].error}")
    return _known(records)


def _check_runs(shipped: Shipped, env_id: str, runs: Sequence[Path], trained: Sequence[Mapping[str, Any]]) -> None:
    seeds = [card["seed"] for card in trained]
    if len({*seeds}) != len(seeds):
        raise ValueError(f"the runs of {shipped.name} must have different seeds, not {seeds}")
    for run, card in zip(runs, trained, strict=True):
        found = (card["env_id"], card["algorithm"])
        if found != (env_id, shipped.algorithm):
            wanted = f"{env_id} by {shipped.algorithm}"
            raise ValueError(f"run {str(run)!r} is of {found[0]} by {found[1]}, not of {wanted}: choose another --runs")
        if card["config"] != trained[0]["config"]:
            raise ValueError(f"runs {str(runs[0])!r} and {str(run)!r} have different configurations: train one anew")


def _seed_run(card: Mapping[str, Any], payloads: tuple[float | None, ...]) -> SeedRun:
    names = ("seed", "command", "timesteps", "wall_s", "threads", "versions")
    return SeedRun(payloads=payloads, curve=tuple(card["curve"]), **{name: card[name] for name in names})


def _held_out(
    policies: Mapping[int, str], law: str, env_id: str, told: bool, count: int, evaluate: Evaluate
) -> tuple[dict[int, tuple[float | None, ...]], tuple[HeldOut, ...]]:
    """What each of the ``policies``, by training seed, carries on held-out motions; and the law."""
    seeds, condition = held_out_seeds(count), Condition(told=told)
    names = [*policies.values(), law]
    cells = [_cell(name, env_id, condition, motion=_loop(env_id, seed)) for name in names for seed in seeds]
    payloads = _payloads(cells, evaluate)
    rows = [tuple(payloads[count * place : count * (place + 1)]) for place in range(len(names))]
    motions = (
        HeldOut(seed=seed, law_payload=other, best_found=None) for seed, other in zip(seeds, rows[-1], strict=True)
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
        trajectory={"name": f"paper-{_kind(env_id)}"} if motion is None else motion,
        policy=policy,
        information="told" if condition.told else "untold",
        uncertainty=condition.uncertainty,
        draws=1 if condition.uncertainty is None else draws,
        probability=probability,
    )


def _payloads(cells: Sequence[PolicyCell], evaluate: Evaluate) -> list[float | None]:
    """Of each cell [kg].

    Raises:
        RuntimeError: if one failed.
    """
    found = {record.cell.key: record for record in evaluate({cell.key: cell for cell in cells})}
    for cell in cells:
        if (error := found[cell.key].error) is not None:
            raise RuntimeError(f"{cell.policy} could not be judged on {cell.env_id}: {error}")
    return [found[cell.key].result["payload"] for cell in cells]


def _motions(config: Mapping[str, Any]) -> Any:
    """What a configuration of either kind trains on."""
    return config.get("motions", config.get("env_kwargs", {}).get("trajectory", "paper"))


def base_text(base: Base, env_id: str) -> str:
    """A base law in words, with all its gains."""
    robot = find_robot(env_robot(env_id))
    made: Any = base.made(robot)
    inner = getattr(made, "law", made)
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
    parts += [f"tensions of at least {base.minimum_tension:g} N"] if robot.planar else []
    parts += [f"on its own estimate of the payload (prior {base.prior:g} s)"] if base.weighs else []
    parts += ["sharing out what the motors can give"] if base.allocates else []
    return ", ".join(parts)


def _default(made: Any, name: str) -> Any:
    return inspect.signature(made).parameters[name].default
