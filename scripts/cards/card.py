"""The card of a shipped policy, a JSON file next to its weights."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

from cablebot_baselines.learned.runs import rank
from cablebot_baselines.learned.shipped import SHIPPED, WEIGHTS, stem
from cablebot_gym.envs import PAPER_ENV_IDS, env_robot
from cablebot_gym.robots import find_robot
from cablebot_gym.trajectories import TRAINING_SEEDS, find_trajectory
from cablebot_gym.utils.files import atomic_write_text
from cards.statistics import iqm, iqm_interval, scores

LEAST_SEEDS = 5
"""Minimum number of training seeds of a card."""

HELD_OUT = 20
"""Number of held-out motions."""

COMPARED_LOOPS = 5
"""Number of random loops whose durations tell one family of them from another."""


@dataclass(frozen=True, kw_only=True)
class Condition:
    """Condition of an evaluation on the circle between dwells."""

    payload_known: bool = True
    """Whether the policy's model contains the payload."""


KNOWN, UNKNOWN = Condition(), Condition(payload_known=False)

CONDITIONS = {
    "ppo-circle": (KNOWN, UNKNOWN),
    "planner": (KNOWN, UNKNOWN),
}
"""Conditions of the evaluation of each shipped policy; the first one selects the shipped seed."""


@dataclass(frozen=True, kw_only=True)
class SeedRun:
    """A training run with one seed."""

    seed: int
    command: str
    """Command line that repeats the training, without ``--out``."""
    timesteps: int
    """``ppo``: number of actions over all environments. ``planner``: number of steps of Adam."""
    wall_s: float
    """Wall time [s]."""
    threads: int
    """Number of torch's threads."""
    versions: Mapping[str, str]
    """Versions of Python and of the packages."""
    payloads: tuple[float | None, ...]
    """DLCC of the run's best policy under each of the card's conditions [kg]; None if it fails
    unloaded."""
    curve: tuple[Mapping[str, Any], ...]
    """Evaluations during training: ``timesteps``, ``wall_s`` [s], ``payload_kg``."""
    held_out: tuple[float | None, ...] = ()
    """DLCC of the run's best policy on each held-out motion of the card [kg]; empty if not
    evaluated."""

    @property
    def in_training(self) -> float | None:
        """DLCC of the run's best policy in the evaluations during training, a mean over their
        motions [kg]."""
        return max((row["payload_kg"] for row in self.curve), key=rank, default=None)


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """A motion that was not used in training, under the card's first condition."""

    seed: int
    """Seed of the motion."""
    law_payload: float | None
    """DLCC of the card's reference law [kg]."""
    best_known: float | None
    """Best known payload [kg]; None if it was not searched for, or the search failed."""


@dataclass(frozen=True, kw_only=True)
class Card:
    """Card of a shipped policy in one environment; JSON-able."""

    policy: str
    env_id: str
    algorithm: str
    """Name of the algorithm, as for ``cablebot train --algo``."""
    command: str
    """Command line that makes weights and card."""
    base: Mapping[str, Any]
    """Base law, fields of :class:`~cablebot_baselines.learned.base.Base`."""
    base_text: str
    """Description of the base law with its gains."""
    steering: Mapping[str, Any]
    """Action mapping of the network."""
    features: tuple[str, ...]
    """Names of the network's inputs."""
    parameters: int
    """Number of parameters of the network."""
    motions: Mapping[str, Any]
    """Training motions: ``motions`` of
    :func:`~cablebot_baselines.learned.planner_run.make_planner_config`."""
    evaluation: Mapping[str, Any]
    """Keyword arguments of :func:`cablebot_gym.evaluation.evaluator.evaluate_dlcc` during
    training."""
    planner_output_used: bool
    """Whether the training used a planner's motions."""
    conditions: tuple[Condition, ...]
    """Conditions of the evaluation."""
    shipped_seed: int
    """Training seed with the median payload in training."""
    sha256: str
    """SHA-256 hash of the shipped bundle."""
    base_in_training: float | None
    """DLCC of the base law alone in the evaluations during training [kg]."""
    base_payloads: tuple[float | None, ...]
    """DLCC of the base law alone under each condition [kg]."""
    law: str
    """Classical law for comparison, as on the command line."""
    law_payloads: tuple[float | None, ...]
    """DLCC of this law under each condition [kg]."""
    best_known: float | None
    """Best known payload on the circle [kg]; None if the leaderboard has
    none."""
    seeds: tuple[SeedRun, ...]
    """Training runs, one for each seed."""
    held_out: tuple[HeldOut, ...]
    """Held-out motions."""
    dwell: float
    """Shortest dwell at the ends of the training motions [s]."""
    loop_durations: tuple[float, ...]
    """:func:`loop_durations` when the card was made: the family of its random loops, in training
    and held out."""
    sb3: bool = False
    """Whether ``NAME-KIND-sb3.zip``, the model of Stable-Baselines3 with the same actor, is shipped
    too."""

    @property
    def stem(self) -> str:
        """Name of the policy's files without suffix."""
        return stem(self.policy, self.env_id)

    @property
    def has_present_loops(self) -> bool:
        """Whether its random loops are those that their seeds give today."""
        return self.loop_durations == loop_durations(self.env_id)

    @property
    def shipped(self) -> SeedRun:
        """Training run of the shipped policy."""
        return next(run for run in self.seeds if run.seed == self.shipped_seed)

    @property
    def evaluated_runs(self) -> list[SeedRun]:
        """Training runs that were evaluated on the held-out motions."""
        return [run for run in self.seeds if run.held_out]

    def above_law(self, run: SeedRun) -> int:
        """Number of held-out motions on which a run's policy has a larger DLCC than the law."""
        pairs = zip(run.held_out, self.held_out, strict=True)
        return sum(rank(payload) > rank(motion.law_payload) for payload, motion in pairs)

    def fractions(self, run: SeedRun) -> list[float]:
        """DLCC as a fraction of the best known payload, on the held-out motions that have one."""
        fractions = []
        for payload, motion in zip(run.held_out, self.held_out, strict=True):
            if motion.best_known:
                fractions.append((payload or 0.0) / motion.best_known)
        return fractions

    def payloads(self, index: int) -> list[float]:
        """DLCCs of all seeds under condition ``index`` [kg]; 0 if the policy fails unloaded."""
        return scores([run.payloads[index] for run in self.seeds])

    def summary(self, index: int) -> Summary:
        """Summary of the DLCCs of all seeds under condition ``index``."""
        return summarize(self.payloads(index))

    def to_json(self) -> str:
        """The card as JSON text, including ``summaries``, which :meth:`from_json` ignores."""
        data = asdict(self)
        data["summaries"] = [asdict(self.summary(index)) for index in range(len(self.conditions))]
        lines = []
        for name, value in data.items():
            text = _json(value)
            if isinstance(value, (list, tuple)) and value and isinstance(value[0], dict):
                text = "[\n  " + ",\n  ".join(map(_json, value)) + "\n ]"
            lines.append(f" {_json(name)}: {text}")
        return "{\n" + ",\n".join(lines) + "\n}\n"

    @classmethod
    def from_json(cls, text: str) -> Card:
        """Creates a card from the text of :meth:`to_json`.

        Raises:
            ValueError: if the text is not that of a card.
        """
        try:
            data = json.loads(text)
            data.pop("summaries", None)
            for name in ("features", "base_payloads", "law_payloads", "loop_durations"):
                data[name] = tuple(data[name])
            for run in data["seeds"]:
                for name in ("payloads", "curve", "held_out"):
                    run[name] = tuple(run[name])
            for name, kind in (
                ("seeds", SeedRun),
                ("conditions", Condition),
                ("held_out", HeldOut),
            ):
                data[name] = tuple(kind(**item) for item in data[name])
            return cls(**data)
        except (AttributeError, KeyError, TypeError) as error:
            raise ValueError(
                f"the text is not a card of a policy ({type(error).__name__}: {error})"
            ) from error

    def save(self, folder: Path) -> None:
        """Writes ``NAME-KIND.json`` atomically."""
        atomic_write_text(folder / f"{self.stem}.json", self.to_json())


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def has_loops(motions: Mapping[str, Any]) -> bool:
    """Whether the ``motions`` of a card contain random loops."""
    return "loops" in motions


def loop_durations(env_id: str) -> tuple[float, ...]:
    """Durations with dwells of the first random loops of an environment [s], to 10 ms. Another
    family has other loops for the same seeds, and so other durations."""
    kind = find_robot(env_robot(env_id)).kind
    durations = []
    for seed in TRAINING_SEEDS[:COMPARED_LOOPS]:
        loop = find_trajectory({"name": f"loop-{kind}", "seed": seed}, kind)
        durations.append(round(loop.duration, 2))
    return tuple(durations)


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Summary of payloads over training seeds [kg]."""

    iqm: float
    """Interquartile mean."""
    low: float
    """Lower end of the interval of ``iqm``."""
    high: float
    """Upper end of the interval of ``iqm``."""
    median: float
    """Median."""


def summarize(payloads: Sequence[float]) -> Summary:
    """Summarises payloads over training seeds [kg]."""
    low, high = iqm_interval(payloads)
    return Summary(iqm=float(iqm(payloads)), low=low, high=high, median=median(payloads))


def read_cards(folder: Path = WEIGHTS) -> list[Card]:
    """Reads all cards of a folder.

    Their order is that of :data:`~cablebot_baselines.learned.shipped.SHIPPED` and of the
    environments.

    Raises:
        ValueError: if a card is damaged; the message names its file.
    """
    cards = []
    for name in SHIPPED:
        for env_id in PAPER_ENV_IDS:
            path = folder / f"{stem(name, env_id)}.json"
            if not path.is_file():
                continue
            try:
                cards.append(Card.from_json(path.read_text(encoding="utf-8")))
            except ValueError as error:
                again = f"python scripts/train_shipped.py --policy {name}"
                raise ValueError(
                    f"card {str(path)!r} cannot be read ({error}). Make it again: {again}"
                ) from error
    return cards
