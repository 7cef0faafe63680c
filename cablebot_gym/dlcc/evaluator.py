"""The largest payload that a policy carries: all payloads as one batch, then ever finer around the first failure."""

from __future__ import annotations

import math
import platform
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from cablebot_gym.dlcc.monitor import Criterion, Judge, Limit, Verdict, find_criterion
from cablebot_gym.dlcc.result import DLCCResult, History
from cablebot_gym.envs import check_robot
from cablebot_gym.kinematics import Array
from cablebot_gym.policies import Policy, PolicyError, as_policy, begin, commands, load_policy, name_of
from cablebot_gym.task import Limits, Task, as_plain, find_limits

SCAN_POINTS = 64
"""Payloads of the first scan, both ends included, and of every refinement."""

PAYLOAD_MAX = {"planar": 10.0, "spatial": 20.0}
"""Default end of the scan [kg]."""

DEFAULT_RESOLUTION = 1e-3
"""Default width of the gap between carried and not carried [kg]."""

_TOLD_ELSEWHERE = ("robot", "trajectory", "payload_known")
"""Keywords that the result names in other places."""

Progress = Callable[[int, int], None]
"""Called after every control step with the steps done and the steps expected."""


def evaluate_dlcc(
    policy: Any,
    env_id: str,
    *,
    criterion: str = "task",
    limits: Limits | dict[str, float] | None = None,
    payload_max: float | None = None,
    resolution: float = DEFAULT_RESOLUTION,
    seed: int = 0,
    name: str | None = None,
    progress: Progress | None = None,
    **keywords: Any,
) -> DLCCResult:
    """The largest payload in the feasible interval that contains zero.

    Payloads are tried on :data:`SCAN_POINTS` points of [0, payload_max] at once; then the gap below the first failure
    is divided again and again until it is no wider than ``resolution``.

    Args:
        policy: an object with ``predict``, a callable ``observation -> action``, or a name as on the command line.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        criterion: ``task`` (motors clip; position, rotation, slack) or ``paper`` (|a| ≤ 1, position, slack).
        limits: bounds of the errors; None for 10 mm and 10 mrad.
        payload_max: end of the scan [kg]; None for 20 spatial, 10 planar.
        resolution: [kg].
        seed: of the environments.
        name: of the policy, in the result; None for its own.
        progress: called after every control step.
        keywords: for the environment: ``trajectory``, ``payload_known``, ``control_frequency``, ``robot``, …

    Raises:
        ValueError: if an argument is not valid, or ``paper`` is asked of a policy that does not declare ``unclipped``.
        cablebot_gym.policies.PolicyError: if the policy raises or returns anything but finite drive commands.
    """
    criterion_ = find_criterion(criterion)
    check_robot(env_id, keywords.get("robot"))
    if not 0 < resolution < math.inf:
        raise ValueError(f"resolution must be greater than 0 kg, not {resolution}")
    limits = find_limits(limits)
    if taken := {"payload", "payload_range", "num_envs", "max_episode_steps", "autoreset_mode"} & set(keywords):
        raise ValueError(f"{sorted(taken)[0]} is set by the evaluation itself: leave it out")
    for key, most in (("payload_known", 0), ("initial_error", 1)):
        if np.ndim(keywords.get(key, 0)) > most:
            raise ValueError(f"{key} is one for all payloads here, not one for each environment")
    # A wide tube must not be cut short by the environment's own end of an episode.
    keywords.setdefault("termination_radius", max(0.1, 2 * limits.position))
    env = gym.make_vec(env_id, num_envs=SCAN_POINTS, limits=limits, max_episode_steps=None, **keywords)
    try:
        task: Task = _first_task(env, seed)
        task.check_steps()
        loaded = load_policy(policy, task.robot) if isinstance(policy, str) else as_policy(policy)
        label = name or name_of(policy)
        if criterion_ == "paper" and not getattr(loaded, "unclipped", False):
            raise ValueError(
                f"the paper criterion says nothing of {label!r}, which does not declare unclipped = True: "
                "a policy that clips its own commands would pass it for nothing; use criterion='task'"
            )
        top = PAYLOAD_MAX["planar" if task.robot.planar else "spatial"] if payload_max is None else payload_max
        seed, top = int(seed), float(top)
        if not 0 < top < math.inf:
            raise ValueError(f"payload_max must be greater than 0 kg, not {top}")
        rounds = 2 + max(0, math.ceil(math.log(top / (SCAN_POINTS - 1) / resolution) / math.log(SCAN_POINTS + 1)))
        run = _Run(env, loaded, label, criterion_, limits, task, seed, rounds, progress, keywords)
        return _search(run, top, resolution, payload_known=bool(task.payload_known))
    finally:
        env.close()


def _first_task(env: gym.vector.VectorEnv[Any, Any, Any], seed: int) -> Task:
    env.reset(seed=seed)
    tasks: tuple[Task, ...] = env.unwrapped.tasks  # type: ignore[attr-defined]
    return tasks[0]


class _Run:
    """Rolls batches of payloads out with one policy in one vector environment."""

    def __init__(
        self,
        env: gym.vector.VectorEnv[Any, Any, Any],
        policy: Policy,
        name: str,
        criterion: Criterion,
        limits: Limits,
        task: Task,
        seed: int,
        rounds: int,
        progress: Progress | None,
        keywords: dict[str, Any],
    ) -> None:
        self.keywords = keywords
        self.env, self.policy, self.name, self.criterion = env, policy, name, criterion
        self.limits, self.task, self.seed = limits, task, seed
        self._done, self._expected, self._progress = 0, rounds * task.steps, progress

    def __call__(self, payloads: Array, history: History | None = None) -> list[Verdict]:
        """Verdicts for at most :data:`SCAN_POINTS` payloads; fills ``history`` with the first one's episode."""
        batch = np.append(payloads, np.full(SCAN_POINTS - len(payloads), payloads[-1]))
        observation, info = self.env.reset(seed=[self.seed] * SCAN_POINTS, options={"payload": batch})  # type: ignore[arg-type]
        judge = Judge(self.criterion, self.limits, self.task.robot.stall_torque, SCAN_POINTS)
        judge.begin(info)
        begin(self.policy, self.name, self.env.unwrapped.tasks)  # type: ignore[attr-defined]
        state, start = None, np.ones(SCAN_POINTS, np.bool_)
        for step in range(self.task.steps):
            action, state = commands(
                self.policy,
                self.name,
                observation,
                state,
                start,
                cables=self.task.robot.cables,
                payloads=batch,
                time=step / self.task.control_frequency,
                ignored=judge.failed,
            )
            observation, _, terminated, _, info = self.env.step(action)
            judge.observe(info, terminated)
            if history is not None:
                history.append(info, self.env.unwrapped.pose[0])  # type: ignore[attr-defined]
            start = terminated  # the environment starts these anew, though nobody judges them any more
            self._done += 1
            if self._progress is not None:
                self._progress(self._done, max(self._expected, self._done))
            if judge.failed.all():
                break
        return [judge.verdict(lane, complete=not judge.failed[lane]) for lane in range(len(payloads))]


def _search(run: _Run, top: float, resolution: float, *, payload_known: bool) -> DLCCResult:
    payloads = np.linspace(0.0, top, SCAN_POINTS)
    verdicts = run(payloads)
    carried = np.array([verdict.carried for verdict in verdicts])
    intervals = _intervals(payloads, carried)
    best: Verdict | None = None
    limit: Limit | None = Limit(kind="scan_end", index=None, time=None, excess=None)
    gap = 0.0
    if not carried[0]:
        limit = verdicts[0].limit
    elif carried.all():
        best = verdicts[-1]
    else:
        first = int(np.argmin(carried))
        below, above = verdicts[first - 1], verdicts[first]
        while above.payload - below.payload > resolution:
            payloads = np.linspace(below.payload, above.payload, SCAN_POINTS + 2)[1:-1]
            if payloads[0] <= below.payload or payloads[-1] >= above.payload:
                break  # the floats end here
            inner = [below, *run(payloads), above]
            first = next(place for place, verdict in enumerate(inner) if not verdict.carried)
            below, above = inner[first - 1], inner[first]
        best, limit, gap = below, above.limit, above.payload - below.payload
        intervals[0] = (0.0, best.payload)
    history = History()
    again = run(np.array([0.0 if best is None else best.payload]), history)[0]
    if again.carried != (best is not None):
        raise PolicyError(
            f"policy {run.name!r} is not reproducible: at {again.payload:g} kg it was first "
            f"{'carried' if best else 'not carried'}, then {'carried' if again.carried else 'not carried'}"
        )
    task, robot = run.task, run.task.robot
    assert limit is not None
    rotates = run.criterion == "task" and not robot.planar
    bounds = {"position": run.limits.position, "rotation": run.limits.rotation if rotates else None}
    return DLCCResult(
        env_id=run.env.spec.id if run.env.spec else "",
        policy=run.name,
        criterion=run.criterion,
        payload=None if best is None else best.payload,
        total_mass=None if best is None else best.payload + robot.mass,
        resolution=gap,
        limit=limit,
        margins=_margins(best, bounds) if best else {},
        feasible=tuple(intervals),
        payload_max=top,
        limits=bounds,
        payload_known=payload_known,
        seed=run.seed,
        environment={
            "robot": robot.to_dict(),
            "trajectory": as_plain(task.trajectory),
            "control_frequency": task.control_frequency,
            "substeps": run.env.unwrapped.settings.substeps,  # type: ignore[attr-defined]
            "cable": task.cable,
            **{name: as_plain(value) for name, value in run.keywords.items() if name not in _TOLD_ELSEWHERE},
        },
        versions={
            "python": platform.python_version(),
            **{package: version(package) for package in ("cablebot-gym", "gymnasium", "numpy", "numba")},
        },
        task=task,
        history=history.closed(),
    )


def _intervals(payloads: Array, carried: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Runs of carried payloads on the scan's points."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], carried.astype(int), [0]])))
    return [(float(payloads[low]), float(payloads[high - 1])) for low, high in edges.reshape(-1, 2)]


def _margins(verdict: Verdict, bounds: dict[str, float | None]) -> dict[str, float]:
    """What was left of each limit at the payload found, as a share of it; tension in N."""
    margins = {"torque": 1 - max(verdict.peak_demand), "tension": verdict.least_tension}
    for name, peak in (("position", verdict.position_peak), ("rotation", verdict.rotation_peak)):
        bound = bounds[name]
        if bound is not None:
            margins[name] = 1 - peak / bound
    return margins
