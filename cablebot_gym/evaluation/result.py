"""What an evaluation found: prints itself, saves itself, draws itself."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np

from cablebot_gym.envs import described
from cablebot_gym.evaluation.constraints import Criterion, Limit
from cablebot_gym.kinematics import Array
from cablebot_gym.task import Task


class History:
    """One episode, step by step; arrays after :meth:`closed`, with the control steps as first axis."""

    NAMES = ("command_time", "drive_demand", "torques", "tensions", "motor_speeds", "tracking_error", "rotation_error")

    def __init__(self) -> None:
        self._rows: list[dict[str, Any]] = []
        self.stall_torque: Array | None = None
        """True τ_s of the episode (m,) [N·m]; to be set before :meth:`closed`."""

    def append(self, info: dict[str, Any], pose: Array, lane: int) -> None:
        """Adds one step of one lane of a batch: its info, and its row of poses (N, n)."""
        self._rows.append({name: np.array(info[name][lane]) for name in self.NAMES} | {"pose": np.array(pose[lane])})

    def closed(self) -> dict[str, Array]:
        """Everything as arrays by name; ``pose`` and the errors are those at the end of each step.

        ``stall_torque`` (m,) has no axis of time.
        """
        arrays = {name: np.array([row[name] for row in self._rows]) for name in (*self.NAMES, "pose")}
        return arrays | {"stall_torque": np.array(self.stall_torque)}


@dataclass(frozen=True, kw_only=True, eq=False)
class DLCCResult:
    """The dynamic load carrying capacity of a policy in an environment. ``print(result)`` gives the essentials."""

    env_id: str
    """Environment."""
    policy: str
    """Policy."""
    criterion: Criterion
    """``task`` or ``paper``."""
    payload: float | None
    """Largest payload in the feasible interval that contains zero [kg]; None if not even zero is carried. Over draws,
    a payload is carried if at least the share ``probability`` of them is."""
    total_mass: float | None
    """Platform and payload [kg]."""
    resolution: float
    """Gap to the least payload above that failed [kg]; 0 if none was searched."""
    limit: Limit
    """What gives way first beyond the payload, or at zero if that is not carried; over draws, the earliest failure of
    the commonest kind."""
    margins: dict[str, float]
    """What is left at the payload: shares of torque, position and rotation bounds, least tension [N]; over draws, in
    the tightest one that carries it."""
    feasible: tuple[tuple[float, float], ...]
    """Every interval of payloads carried on the scan's points; the first one's end is refined [kg]."""
    payload_max: float
    """End of the scan [kg]."""
    limits: dict[str, float | None]
    """Bounds of position [m] and rotation [rad]; None where the criterion or the robot has none."""
    payload_known: bool
    """Whether the policy was told the payload."""
    uncertainty: str | None
    """Name of what the policy did not know, ``custom`` for data; None for nothing."""
    draws: int
    """Episodes at each payload."""
    probability: float | None
    """Share of the draws that has to carry a payload; None for one draw."""
    confidence: float | None
    """Of ``assured_payload``; None for one draw."""
    assured_payload: float | None
    """Lower bound: at every payload tried up to here the success probability is at least ``probability`` with this
    confidence, one-sided, by Clopper and Pearson [kg]; exact for the whole interval where no draw carries more than
    one that it does not. None if there is none, or too few draws for one."""
    failures: dict[str, int]
    """Draws that fail beyond the payload (at zero if that is not carried), by kind; empty for one draw."""
    draw_seeds: tuple[int, ...]
    """Seed of each draw: ``env.reset(seed=…)``, or ``cablebot rollout --seed``, repeats it."""
    limit_seed: int | None
    """Seed of the draw to which ``limit`` happened, at ``payload + resolution``; None for ``scan_end``."""
    success: tuple[tuple[float, float], ...]
    """(payload [kg], share of draws that carry it) for every payload tried; empty for one draw."""
    seed: int
    """Of the environments; the draws follow from it."""
    environment: dict[str, Any]
    """Robot, trajectory, control frequency and cable mode, as plain data."""
    versions: dict[str, str]
    """Of Python and of the packages that make the number."""
    task: Task = field(repr=False)
    """The public task, for drawing."""
    history: dict[str, Array] = field(repr=False)
    """The episode at the payload (at zero if none is carried), see :class:`History`; over draws, the first one that
    carries it, or the one of ``limit`` if none is carried."""

    @property
    def score(self) -> float:
        """The payload, or 0 if not even zero is carried [kg]."""
        return self.payload or 0.0

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data; without the history."""
        skipped = {"task", "history"}
        data = {item.name: getattr(self, item.name) for item in fields(self) if item.name not in skipped}
        pairs = {name: [list(pair) for pair in getattr(self, name)] for name in ("feasible", "success")}
        seeds = {"draw_seeds": list(self.draw_seeds)}
        return data | {"limit": asdict(self.limit)} | pairs | seeds

    def to_json(self) -> str:
        """The result as JSON, indented."""
        return json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)

    def __str__(self) -> str:
        head = f"{described(self.env_id, self.task.robot.name)}, {self.policy}, {self.criterion} criterion"
        told = "payload told" if self.payload_known else "payload not told"
        if self.payload is None:
            others = "; it does carry " + ", ".join(f"{low:.3f} to {high:.3f} kg" for low, high in self.feasible)
            text = f"not even zero payload is carried: {self.limit}{others if self.feasible else ''}"
        else:
            text = f"{self.payload:.3f} kg (total {self.total_mass:.3f} kg){self._share()}, then {self.limit}"
        unknown = "" if self.uncertainty is None else f", {self.uncertainty}"
        return f"{head}, {told}{unknown}: {text}"

    def _share(self) -> str:
        if self.probability is None or self.confidence is None:
            return ""
        assured = "no payload" if self.assured_payload is None else f"{self.assured_payload:.3f} kg"
        return (
            f" in at least {self.probability:.0%} of {self.draws} draws, {assured} assured with "
            f"{self.confidence:.0%} confidence"
        )
