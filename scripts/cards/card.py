"""Everything known about a policy that ships, as it is kept beside its weights."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

from cablebot_baselines.learned.runs import rank
from cablebot_baselines.learned.shipped import SHIPPED, WEIGHTS, Condition, stem
from cablebot_gym.envs import ENV_IDS
from cablebot_gym.utils.files import write_text_whole
from cards.statistics import iqm, iqm_interval, scores

LEAST_SEEDS = 5
"""Training seeds of a card."""

DRAWS = 256
"""Episodes at each payload under an uncertainty."""

PROBABILITY = 0.95
"""Share of the draws that has to carry a payload."""

HELD_OUT = 20
"""Held-out motions."""


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
    held_out: tuple[float | None, ...] = ()
    """Of the run's best policy on the card's held-out motions [kg]; empty if it was not judged on them."""

    @property
    def in_training(self) -> float | None:
        """What the run's best policy carried in these evaluations, a mean over their motions [kg]."""
        return max((one["payload_kg"] for one in self.curve), key=rank, default=None)


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """A motion that no training saw, under the card's first condition."""

    seed: int
    """Of the motion."""
    law_payload: float | None
    """Of the card's reference law [kg]."""
    best_found: float | None
    """[kg]; None if it was not searched for, or in vain."""


@dataclass(frozen=True, kw_only=True)
class Card:
    """A policy that ships, in one environment. JSON-able.

    Raises:
        ValueError: if its parts do not fit each other.
    """

    policy: str
    env_id: str
    algorithm: str
    """As ``cablebot train --algo`` has it."""
    config: str | None
    """Name of the file of hyperparameters; None for the one that the algorithm reads anyway."""
    command: str
    """Makes weights and card."""
    base: Mapping[str, Any]
    """The law that is steered, fields of :class:`~cablebot_baselines.learned.base.Base`."""
    base_text: str
    """The same in words, with its gains."""
    steering: Mapping[str, Any]
    """How the network's actions steer it."""
    features: tuple[str, ...]
    """What the network reads."""
    parameters: int
    """Of the network."""
    motions: Any
    """Trained on: ``motions`` of :func:`~cablebot_baselines.learned.gradient_run.make_gradient_config`, or an environment's
    ``trajectory``."""
    evaluation: Mapping[str, Any]
    """Conditions of the evaluations while training, keywords of :func:`cablebot_gym.evaluation.evaluate_dlcc`."""
    planner_output_used: bool
    """Whether a planner's motions went into the training."""
    conditions: tuple[Condition, ...]
    """Under which the payloads were found."""
    draws: int
    """Episodes at each payload under an uncertainty."""
    probability: float
    """Share of the draws that has to carry a payload."""
    shipped_seed: int
    """The one with the median payload in training."""
    sha256: str
    """Of the bundle that ships."""
    base_in_training: float | None
    """What the base law alone carried in the evaluations while training [kg]."""
    base_payloads: tuple[float | None, ...]
    """Of the base law alone, the network saying zero, under each condition [kg]."""
    law: str
    """A classical law to compare with, as on the command line."""
    law_payloads: tuple[float | None, ...]
    """Of it under each condition [kg]."""
    best_found: float | None
    """On the paper's circle without uncertainty [kg]; None if the leaderboard does not know it."""
    seeds: tuple[SeedRun, ...]
    """What each training seed came to."""
    held_out: tuple[HeldOut, ...]
    """What is carried along motions that were not trained on."""
    sb3: bool = False
    """Whether ``NAME-KIND-sb3.zip`` ships too: the model of Stable-Baselines3 with this policy's actor."""

    def __post_init__(self) -> None:
        numbers = [len(self.base_payloads), len(self.law_payloads), *(len(run.payloads) for run in self.seeds)]
        if not self.conditions or set(numbers) != {len(self.conditions)}:
            raise ValueError("a card needs a payload for each of its conditions")
        seeds = [run.seed for run in self.seeds]
        if len({*seeds}) != len(seeds) or self.shipped_seed not in seeds:
            raise ValueError(f"a card needs different seeds and the one that ships among them, not {seeds}")

        places = {len(run.held_out) for run in self.seeds if run.held_out or run is self.shipped}
        if places != {len(self.held_out)}:
            raise ValueError("a card needs a payload on each held-out motion, of the run that ships at least")

    @property
    def stem(self) -> str:
        """Name of its files."""
        return stem(self.policy, self.env_id)

    @property
    def shipped(self) -> SeedRun:
        """The training whose policy ships."""
        return next(run for run in self.seeds if run.seed == self.shipped_seed)

    @property
    def judged(self) -> list[SeedRun]:
        """The trainings whose policies met the held-out motions."""
        return [run for run in self.seeds if run.held_out]

    def above_law(self, run: SeedRun) -> int:
        """On how many held-out motions the policy of a training carries more than the law."""
        pairs = zip(run.held_out, self.held_out, strict=True)
        return sum(rank(payload) > rank(motion.law_payload) for payload, motion in pairs)

    def shares(self, run: SeedRun) -> list[float]:
        """Of the best found, on the held-out motions where it is known."""
        pairs = zip(run.held_out, self.held_out, strict=True)
        return [(payload or 0.0) / motion.best_found for payload, motion in pairs if motion.best_found]

    def carried(self, place: int) -> list[float]:
        """Payloads of all seeds under the condition of this place [kg], 0 where not even zero is carried."""
        return scores([run.payloads[place] for run in self.seeds])

    def summary(self, place: int) -> Summary:
        """The payloads of all seeds under the condition of this place."""
        return summed_up(self.carried(place))

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
        """A card from the text that :meth:`to_json` wrote.

        Raises:
            ValueError: if it is no card's.
        """
        try:
            data = {name: value for name, value in json.loads(text).items() if name != "summaries"}
            runs = [
                SeedRun(**{**run, **{name: tuple(run[name]) for name in ("payloads", "curve", "held_out")}})
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
        write_text_whole(path, text)
        return path


def has_loops(motions: Any) -> bool:
    """Whether random loops are among the ``motions`` of a card."""
    return isinstance(motions, Mapping) and "loops" in motions


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
    """The middle one."""


def summed_up(payloads: Sequence[float]) -> Summary:
    """Payloads over training seeds [kg]."""
    low, high = iqm_interval([payloads])
    return Summary(iqm=float(iqm(payloads)), low=low, high=high, median=median(payloads))


def read_cards(folder: Path = WEIGHTS) -> list[Card]:
    """All cards of a folder, in the order of :data:`~cablebot_baselines.learned.shipped.SHIPPED` and of the environments.

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
