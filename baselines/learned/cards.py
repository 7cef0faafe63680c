"""Cards of the learned policies that ship: what every training seed carries, with intervals, and how it was trained.

A policy is trained with several seeds. What they carry is summed up by the interquartile mean and a stratified
bootstrap interval, as rliable has them (Agarwal et al., *Deep Reinforcement Learning at the Edge of the Statistical
Precipice*, 2021). The seed with the median payload ships. Making a card needs torch; reading and rendering does not.
"""

from __future__ import annotations

import hashlib
import inspect
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from baselines.classical.flexible import Composite, FourthOrder, MotorPD
from baselines.classical.law import Array
from baselines.learned.base import Base
from baselines.learned.bundle import Bundle
from baselines.learned.shipped import SHIPPED, TOLD, WEIGHTS, Condition, Shipped, stem
from baselines.learned.steering import way_to_plain
from cablebot_gym.benchmark.cells import Cell, PolicyCell, Record
from cablebot_gym.benchmark.leaderboard import read_results
from cablebot_gym.benchmark.score import Column, find_bests, motion_key
from cablebot_gym.benchmark.tables import heading
from cablebot_gym.dlcc.figures import BLUE, GREY, VERMILLION, add_legend, entitle, new_figure
from cablebot_gym.envs import ENV_IDS, FLEXIBLE_ENV_IDS, env_robot
from cablebot_gym.files import write_whole
from cablebot_gym.robots import find_robot
from cablebot_gym.trajectories import FIRST_HELD_OUT_SEED, held_out_seeds

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEAST_SEEDS = 5
"""Training seeds of a card."""

DRAWS = 256
"""Episodes at each payload under an uncertainty."""

PROBABILITY = 0.95
"""Share of the draws that has to carry a payload."""

HELD_OUT = 20
"""Held-out motions."""

CONFIDENCE = 0.95
"""Of intervals."""

RESAMPLES = 10_000
"""Of the bootstrap."""

Evaluate = Callable[[Mapping[str, Cell]], Sequence[Record]]
"""Computes cells given by key; a record of each."""


# ---------------------------------------------------------------------------------------------------------- statistics


def iqm(values: ArrayLike) -> Array:
    """Interquartile mean along the last axis: a quarter of the values, rounded down, is left out at either end.

    Args:
        values: (..., N).
    """
    ordered = np.sort(np.asarray(values, float), axis=-1)
    cut = ordered.shape[-1] // 4
    mean: Array = ordered[..., cut : ordered.shape[-1] - cut].mean(axis=-1)
    return mean


def iqm_interval(
    strata: Sequence[ArrayLike], *, resamples: int = RESAMPLES, confidence: float = CONFIDENCE, seed: int = 0
) -> tuple[float, float]:
    """Percentile bootstrap interval (low, high) of the interquartile mean of all values together.

    Args:
        strata: values by task, each (seeds,); values are drawn anew within each.
        resamples: how many.
        confidence: of the interval.
        seed: of the draws, which are the same with every version of numpy.
    """
    drawn = []
    for place, values in enumerate(np.asarray(stratum, float) for stratum in strata):
        # Raw bits: of these alone numpy promises that they stay the same.
        bits = np.random.Philox(np.random.SeedSequence([seed, place])).random_raw(resamples * len(values))
        index = ((bits >> np.uint64(11)) * 2.0**-53 * len(values)).astype(int)
        drawn.append(values[index.reshape(resamples, len(values))])
    ends = np.quantile(iqm(np.concatenate(drawn, axis=1)), [(1 - confidence) / 2, (1 + confidence) / 2])
    return float(ends[0]), float(ends[1])


def typical(payloads: Mapping[int, float | None]) -> int:
    """The seed with the median payload; of two in the middle the one that carries less, of equal ones the smallest.

    Args:
        payloads: by seed [kg]; None where not even zero is carried.
    """
    ordered = sorted(payloads, key=lambda seed: (_rank(payloads[seed]), seed))
    return ordered[(len(ordered) - 1) // 2]


def _rank(payload: float | None) -> float:
    return -1.0 if payload is None else payload


def _scores(payloads: Sequence[float | None]) -> list[float]:
    """Payloads [kg], 0 where not even zero is carried."""
    return [payload or 0.0 for payload in payloads]


# --------------------------------------------------------------------------------------------------------------- cards


@dataclass(frozen=True, kw_only=True)
class SeedRun:
    """A training with one seed."""

    seed: int
    command: str
    """What to type for the same training, but for ``--out``."""
    timesteps: int
    """Of PPO actions over all environments, of training by gradients evaluations of the objective."""
    wall_s: float
    """[s]"""
    threads: int
    """Of torch."""
    versions: Mapping[str, str]
    """Of Python and of the packages that trained."""
    payloads: tuple[float | None, ...]
    """Of the run's best policy under each of the card's conditions [kg]; None where not even zero is carried."""
    curve: tuple[Mapping[str, Any], ...]
    """Evaluations while training: ``timesteps``, ``wall_s`` [s], ``payload_kg``."""


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """A motion that no training saw, under the card's first condition."""

    seed: int
    """Of the motion."""
    payload: float | None
    """Of the policy that ships [kg]; None where not even zero is carried."""
    law_payload: float | None
    """Of the card's reference law [kg]."""
    best_found: float | None
    """[kg]; None if the leaderboard does not know it."""


@dataclass(frozen=True, kw_only=True)
class Card:
    """A policy that ships, in one environment. JSON-able.

    Raises:
        ValueError: if its parts do not fit each other.
    """

    policy: str
    env_id: str
    algorithm: str
    config: str | None
    """Name of the file of hyperparameters; None for the one that the algorithm reads anyway."""
    command: str
    """Makes weights and card."""
    base: Mapping[str, Any]
    """The law that is steered, fields of :class:`~baselines.learned.base.Base`."""
    base_text: str
    """The same in words, with its gains."""
    steering: Mapping[str, Any]
    """How the network's actions steer it."""
    features: tuple[str, ...]
    """What the network reads."""
    parameters: int
    """Of the network."""
    motions: Any
    """Trained on: ``paper``, ``{"loops": N}`` for the training seeds 0 to N − 1, or an environment's ``trajectory``."""
    evaluation: Mapping[str, Any]
    """Conditions of the evaluations while training, keywords of :func:`cablebot_gym.dlcc.evaluate_dlcc`."""
    planner_output_used: bool
    """Whether a planner's motions went into the training."""
    conditions: tuple[Condition, ...]
    draws: int
    """Episodes at each payload under an uncertainty."""
    probability: float
    """Share of the draws that has to carry a payload."""
    shipped_seed: int
    """The one with the median payload under the first condition."""
    sha256: str
    """Of the bundle that ships."""
    base_payloads: tuple[float | None, ...]
    """Of the base law alone, the network saying zero, under each condition [kg]."""
    law: str
    """A classical law to compare with, as on the command line."""
    law_payloads: tuple[float | None, ...]
    """Of it under each condition [kg]."""
    best_found: float | None
    """On the paper's circle without uncertainty [kg]; None if the leaderboard does not know it."""
    seeds: tuple[SeedRun, ...]
    held_out: tuple[HeldOut, ...]
    sb3: bool = False
    """Whether ``NAME-KIND-sb3.zip`` ships too: the model of Stable-Baselines3 with this policy's actor."""

    def __post_init__(self) -> None:
        numbers = [len(self.base_payloads), len(self.law_payloads), *(len(run.payloads) for run in self.seeds)]
        if not self.conditions or set(numbers) != {len(self.conditions)}:
            raise ValueError("a card needs a payload for each of its conditions")
        seeds = [run.seed for run in self.seeds]
        if len({*seeds}) != len(seeds) or self.shipped_seed not in seeds:
            raise ValueError(f"a card needs different seeds and the one that ships among them, not {seeds}")

    @property
    def stem(self) -> str:
        """Name of its files."""
        return stem(self.policy, self.env_id)

    @property
    def shipped(self) -> SeedRun:
        """The training whose policy ships."""
        return next(run for run in self.seeds if run.seed == self.shipped_seed)

    def carried(self, place: int) -> list[float]:
        """Payloads of all seeds under a condition [kg], 0 where not even zero is carried."""
        return _scores([run.payloads[place] for run in self.seeds])

    def summary(self, place: int) -> Summary:
        """The payloads of all seeds under a condition."""
        payloads = self.carried(place)
        low, high = iqm_interval([payloads])
        return Summary(iqm=float(iqm(payloads)), low=low, high=high, median=median(payloads))

    def to_json(self) -> str:
        """The card; for its readers with ``summaries``, which follow from the rest."""
        summaries = [asdict(self.summary(place)) for place in range(len(self.conditions))]
        lines = []
        for name, value in (asdict(self) | {"summaries": summaries}).items():
            text = json.dumps(value, ensure_ascii=False, allow_nan=False)
            if isinstance(value, (list, tuple)) and value and isinstance(value[0], dict):
                rows = (json.dumps(row, ensure_ascii=False, allow_nan=False) for row in value)
                text = "[\n  " + ",\n  ".join(rows) + "\n ]"
            lines.append(f" {json.dumps(name)}: {text}")
        return "{\n" + ",\n".join(lines) + "\n}\n"

    @classmethod
    def from_json(cls, text: str) -> Card:
        """What :meth:`to_json` wrote.

        Raises:
            ValueError: if it is no card's.
        """
        try:
            data = {name: value for name, value in json.loads(text).items() if name != "summaries"}
            runs = [
                SeedRun(**{**run, "payloads": tuple(run["payloads"]), "curve": tuple(run["curve"])})
                for run in data.pop("seeds")
            ]
            for name in ("features", "base_payloads", "law_payloads"):
                data[name] = tuple(data[name])
            conditions = tuple(Condition(**condition) for condition in data.pop("conditions"))
            held_out = tuple(HeldOut(**motion) for motion in data.pop("held_out"))
            return cls(seeds=tuple(runs), conditions=conditions, held_out=held_out, **data)
        except (AttributeError, KeyError, TypeError) as error:
            raise ValueError(f"this is no card of a policy ({type(error).__name__}: {error})") from error

    def save(self, folder: Path) -> Path:
        """Writes ``NAME-KIND.json``, whole or not at all."""
        path, text = folder / f"{self.stem}.json", self.to_json()
        write_whole(path, lambda temporary: _write(temporary, text))
        return path


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Payloads over training seeds [kg]."""

    iqm: float
    """Interquartile mean."""
    low: float
    """Lower end of its interval."""
    high: float
    """Upper end."""
    median: float


def read_cards(folder: Path = WEIGHTS) -> list[Card]:
    """All cards of a folder, in the order of :data:`~baselines.learned.shipped.SHIPPED` and of the environments.

    Raises:
        ValueError: if one is damaged, naming its file.
    """
    cards = []
    for name in SHIPPED:
        for path in (folder / f"{stem(name, env_id)}.json" for env_id in ENV_IDS):
            if not path.is_file():
                continue
            try:
                cards.append(Card.from_json(path.read_text(encoding="utf-8")))
            except ValueError as error:
                again = f"python scripts/train_shipped.py --policy {name}"
                raise ValueError(f"card {str(path)!r} cannot be read ({error}): make it anew, {again}") from error
    return cards


def reference_law(env_id: str) -> str:
    """The classical law to compare with."""
    return "composite-tuned" if env_id in FLEXIBLE_ENV_IDS else "fl"


def read_bests(path: Path) -> dict[str, float]:
    """The best found [kg] by :func:`~cablebot_gym.benchmark.score.motion_key`, of a benchmark's ``results.json``.

    Raises:
        OSError, ValueError, KeyError: if the file cannot be read.
    """
    bests = find_bests(read_results(path.read_text(encoding="utf-8"))[2])
    return {key: best.payload for key, best in bests.items() if best.payload is not None}


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
) -> tuple[Card, Path]:
    """Judges the policies of finished runs, one for each training seed.

    The base law alone is put into ``NAME-KIND-base.zip`` beside the runs, to be judged as they are.

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

    Returns:
        The card, and the bundle that is to ship.

    Raises:
        ValueError: if the runs are not of this policy, or not of one configuration, or no bundles.
        RuntimeError: if an evaluation failed, with its reason.
    """
    from baselines.learned.export import silent_network  # these need torch
    from baselines.learned.runs import BEST, LAST

    bundles = [Bundle.load(run / BEST) for run in runs]
    trained = [Bundle.load(run / LAST).card for run in runs]
    _check_runs(shipped, env_id, runs, trained)
    first, seeds = bundles[0], [int(card["seed"]) for card in trained]
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
    chosen = typical({seed: row[0] for seed, row in zip(seeds, rows, strict=False)})
    place = seeds.index(chosen)
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
        motions=_motions(trained[0]["config"]),
        evaluation=trained[0]["evaluation"],
        planner_output_used=any(card["planner_output_used"] for card in trained),
        conditions=shipped.conditions,
        draws=draws,
        probability=probability,
        shipped_seed=chosen,
        sha256=hashlib.sha256(best.read_bytes()).hexdigest(),
        base_payloads=rows[-2],
        law=law,
        law_payloads=rows[-1],
        best_found=None,
        seeds=tuple(_seed_run(card, row) for card, row in zip(trained, rows, strict=False)),
        held_out=_held_out(str(best), law, env_id, shipped.conditions[0].told, held_out, evaluate),
    )
    return with_bests(card, bests), best


def with_bests(card: Card, bests: Mapping[str, float]) -> Card:
    """The card with the best found as a leaderboard has it now, from :func:`read_bests`."""
    law, env_id = card.law, card.env_id
    held_out = tuple(
        replace(one, best_found=bests.get(motion_key(_cell(law, env_id, TOLD, motion=_loop(env_id, one.seed)))))
        for one in card.held_out
    )
    return replace(card, best_found=bests.get(motion_key(_cell(law, env_id, TOLD))), held_out=held_out)


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


def _held_out(policy: str, law: str, env_id: str, told: bool, count: int, evaluate: Evaluate) -> tuple[HeldOut, ...]:
    seeds, condition = held_out_seeds(count), Condition(told=told)
    cells = [_cell(name, env_id, condition, motion=_loop(env_id, seed)) for name in (policy, law) for seed in seeds]
    payloads = _payloads(cells, evaluate)
    pairs = zip(seeds, payloads[:count], payloads[count:], strict=True)
    return tuple(HeldOut(seed=seed, payload=own, law_payload=other, best_found=None) for seed, own, other in pairs)


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


# ------------------------------------------------------------------------------------------------------------ the page

_HEAD = """# Learned policies

What ships in `baselines/learned/weights/`, each under a name for `cablebot dlcc --policy NAME` and for
`cablebot benchmark`: plain arrays, which run without torch and are never unpickled. `python scripts/train_shipped.py`
trains, judges and writes all of it, this page too.

A learned policy steers a classical law: its network shifts the law's reference, or adds to its commands. Each was
trained with several seeds, all of which count here. The one that ships has the median payload under the first
condition: it is typical, not the luckiest.

* Payloads in kg, the largest that is carried on the paper's circle by the task criterion, as on the
  [leaderboard](../LEADERBOARD.md){drawn}. None, where not even zero is carried, counts as 0.
* IQM: interquartile mean over the training seeds; in brackets its {confidence:.0%} interval from {resamples} resamples
  of a stratified bootstrap, whose strata are environments.
* base alone: the law underneath, while the network says zero. law: one of the laws of `baselines/classical/`.
* best found: the leaderboard's, without uncertainty; a lower bound of what is possible.
* held-out: motions with seeds from {held_out} on, which no training and no choice of a policy has seen. On how many the
  policy that ships carries more than the law, both under the first condition; and its median share of the best found,
  where the leaderboard knows that.
* training: wall time of one seed, the median.

"""

_COLUMNS = (
    *("policy", "id", "condition", "seeds", "IQM", "median", "base alone", "law", "IQM of best found"),
    *("held-out: above law", "held-out: of best found", "training"),
)


def card_markdown(cards: Sequence[Card]) -> str:
    """The page: one table of all, then each policy's command, base law, versions and seeds.

    Args:
        cards: in the order of the page, at least one.
    """
    draws = sorted({card.draws for card in cards if any(one.uncertainty for one in card.conditions)})
    drawn = ""
    if draws:
        several = " or ".join(map(str, draws))
        drawn = f"; `table6` and `sensors` with {several} draws, {cards[0].probability:.0%} of which have to carry"
    text = _HEAD.format(drawn=drawn, confidence=CONFIDENCE, resamples=RESAMPLES, held_out=FIRST_HELD_OUT_SEED)
    text += _table([_COLUMNS, *(row for card in cards for row in _rows(card))], left=3)
    text += "\n![Payload against wall time while training](learned.png)\n"
    for name in dict.fromkeys(card.policy for card in cards):
        text += _section([card for card in cards if card.policy == name])
    return text


def _rows(card: Card) -> list[list[str]]:
    rows = []
    for place, condition in enumerate(card.conditions):
        summary = card.summary(place)
        rows.append(
            [
                f"`{card.policy}`" if place == 0 else "",
                _short(card.env_id) if place == 0 else "",
                _title(condition),
                str(len(card.seeds)),
                f"{summary.iqm:.2f} [{summary.low:.2f}, {summary.high:.2f}]",
                f"{summary.median:.2f}",
                _kg(card.base_payloads[place]),
                f"`{card.law}` {_kg(card.law_payloads[place])}",
                "–" if not card.best_found else f"{summary.iqm / card.best_found:.0%} of {card.best_found:.2f}",
                *(_held_out_cells(card) if place == 0 else ("", "")),
                _time(median(run.wall_s for run in card.seeds)) if place == 0 else "",
            ]
        )
    return rows


def _held_out_cells(card: Card) -> tuple[str, str]:
    above = sum(_rank(motion.payload) > _rank(motion.law_payload) for motion in card.held_out)
    shares = [(motion.payload or 0.0) / motion.best_found for motion in card.held_out if motion.best_found]
    share = f"{median(shares):.0%} on {len(shares)}" if shares else "–"
    return f"{above} of {len(card.held_out)}", share


def _section(cards: Sequence[Card]) -> str:
    first = cards[0]
    text = f"\n## `{first.policy}`\n\n{_sentence(SHIPPED[first.policy].summary)}.\n\n```sh\n"
    text += "".join(f"{card.command}\n" for card in cards) + "```\n"
    known = [(card, card.best_found) for card in cards if card.best_found]
    if len(known) > 1 and len(known) == len(cards):
        shares = [np.array(card.carried(0)) / best for card, best in known]
        low, high = iqm_interval(shares)
        mean = float(iqm(np.concatenate(shares)))
        condition = _title(first.conditions[0])
        text += f"\nOver its {len(cards)} environments, {condition}, the IQM of the shares of the best found is "
        text += f"{mean:.1%} [{low:.1%}, {high:.1%}].\n"
    return text + "".join(_details(card) for card in cards)


def _details(card: Card) -> str:
    versions = "; ".join(
        dict.fromkeys(", ".join(f"{name} {number}" for name, number in run.versions.items()) for run in card.seeds)
    )
    planner = "A planner's output was used in training." if card.planner_output_used else "No planner was used."
    text = f"\n### {_short(card.env_id)}\n\n"
    text += f"* Base: {card.base_text}.\n"
    text += f"* Steering: {_steering(card.steering)}. Network: {card.parameters} parameters, reads "
    text += f"{', '.join(card.features)}.\n"
    text += f"* Trained on {_trained_on(card.motions)}. {planner}\n"
    text += f"* What ships, seed {card.shipped_seed}: `{card.shipped.command}`\n"
    if card.sb3:
        text += (
            f"* `{card.stem}-sb3.zip` is the same actor as a model of Stable-Baselines3, to go on training with. It "
        )
        text += "reads the features as the bundle's `mean` and `scale` normalise them, cut at ±10.\n"
    text += f"* {versions}\n\n"
    rows = [["seed", "steps", "wall time", *map(_title, card.conditions), ""]]
    for run in card.seeds:
        ships = "ships" if run.seed == card.shipped_seed else ""
        rows.append([str(run.seed), str(run.timesteps), _time(run.wall_s), *map(_kg, run.payloads), ships])
    return text + _table(rows, left=0)


def _steering(way: Mapping[str, Any]) -> str:
    numbers = {name: value for name, value in way.items() if name != "kind" and (value or name != "lead")}
    units = {"hold": " s", "lead": " s"}
    return f"{way['kind']}, " + ", ".join(f"{name} {value:g}{units.get(name, '')}" for name, value in numbers.items())


def _trained_on(motions: Any) -> str:
    if motions == "paper":
        return "the paper's circle"
    if isinstance(motions, Mapping) and "loops" in motions:
        return f"random loops, training seeds 0 to {motions['loops'] - 1}"
    return f"`{json.dumps(motions)}`"


def _title(condition: Condition) -> str:
    information = "told" if condition.told else "untold"
    return heading(
        Column(information=information, uncertainty=condition.uncertainty, criterion="task", draws=1),
    )


def _short(env_id: str) -> str:
    return env_id.removeprefix("CableBot-").removesuffix("-v0")


def _kg(payload: float | None) -> str:
    return "none" if payload is None else f"{payload:.2f}"


def _time(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:]


def _table(rows: Sequence[Sequence[str]], *, left: int) -> str:
    """Markdown; the first ``left`` columns begin at the left, the others end at the right."""
    rule = ["---" if place < left else "---:" for place in range(len(rows[0]))]
    return "".join(f"| {' | '.join(row)} |\n" for row in (rows[0], rule, *rows[1:]))


# ---------------------------------------------------------------------------------------------------------- the figure


def draw_curves(cards: Sequence[Card]) -> Figure:
    """Payload against wall time while training: all seeds, a panel for each policy and environment.

    Args:
        cards: in the order of the panels, at least one.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    columns = min(3, len(cards))
    rows = -(-len(cards) // columns)
    figure = new_figure(1.2 + 2.6 * rows)
    panels = figure.subplots(rows, columns, squeeze=False).flat
    for card, axes in zip(cards, panels, strict=False):
        _curves(axes, card)
    for axes in list(panels)[len(cards) :]:
        axes.set_axis_off()
    shown = next((place for place, card in enumerate(cards) if card.motions == "paper" and card.best_found), 0)
    add_legend(figure, figure.axes[shown])
    entitle(figure, "Payload of the policy in training, on the motions that choose the best of its run")
    return figure


def _curves(axes: Axes, card: Card) -> None:
    others = [run for run in card.seeds if run.seed != card.shipped_seed]
    for place, run in enumerate([*others, card.shipped]):  # that one on top
        ships = run.seed == card.shipped_seed
        axes.plot(
            [row["wall_s"] for row in run.curve],
            _scores([row["payload_kg"] for row in run.curve]),
            marker=".",
            color=VERMILLION if ships else BLUE,
            linewidth=1.8 if ships else 1.0,
            label="seed that ships" if ships else "_" if place else "other seeds",
        )
    where = "circle"
    if card.motions == "paper":
        if card.best_found:
            axes.axhline(card.best_found, color="black", linestyle="--", linewidth=1.0, label="best found")
        known, uncertainty = card.evaluation.get("payload_known", True), card.evaluation.get("uncertainty")
        if (same := Condition(told=known, uncertainty=uncertainty)) in card.conditions:
            place = card.conditions.index(same)
            law, base = _scores([card.law_payloads[place], card.base_payloads[place]])
            axes.axhline(law, color=GREY, linestyle="-.", linewidth=1.0, label="classical law")
            axes.axhline(base, color=GREY, linestyle=":", linewidth=1.0, label="base alone")
    else:
        where = "loops, mean"
    axes.set_title(f"{card.policy}, {_short(card.env_id)}: {where}", fontsize=10)
    axes.set_ylim(bottom=0)
    axes.set_xlim(left=0)
    axes.set(xlabel="wall time [s]", ylabel="payload [kg]")


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
