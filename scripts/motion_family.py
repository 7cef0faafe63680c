"""Measures the random motions that the leaderboard ranks, over training seeds.

For every motion: the largest acceleration, the payload of exact tracking, the payloads that the
motors hold at rest (at the start, and at the worst pose that the error bounds allow), the best
known payload, and the payloads of control laws. Each motion is stored when it is done, and the next
call goes on after it. The page has the requirements, the figures and the number of motions.

python scripts/motion_family.py --motions 30
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from cablebot_gym import ENV_IDS, ErrorBounds, Robot, evaluate_dlcc, find_robot, find_trajectory
from cablebot_gym.bounds.best_known import find_best_known
from cablebot_gym.bounds.closed_form import exact_payload
from cablebot_gym.envs import env_robot
from cablebot_gym.kinematics import Array
from cablebot_gym.physics.statics import feasible_payloads, hold_payload, resting
from cablebot_gym.task import find_error_bounds
from cablebot_gym.trajectories import TRAINING_SEEDS, Trajectory
from cablebot_gym.utils.files import atomic_write_text

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "motions" / "results.json"
PAGE = ROOT / "docs" / "motions.md"

GRAVITY = 9.81
"""Gravitational acceleration [m/s²]."""

LAWS = {"rigid": ("fl", "robust", "adaptive"), "flexible": ("composite", "adaptive-composite")}
"""Control laws by joints of the robot; the first is the paper's."""

STATIC_FRACTION = 0.9
"""Fraction of every static limit below which a payload counts as limited by the dynamics."""

_POSES = 41
"""Number of poses of a motion at which the static limit is computed."""

HEAD = """# Random motions

Measured by `python scripts/motion_family.py` over training seeds, the even ones smooth and the odd
ones with jumps of the acceleration as on the paper's circle. *Dynamic*: the best known payload is
below 90 % of what the motors hold at rest, at the start and at the worst pose within the error
bounds. *Exact*: exact tracking of a rigid robot is possible without payload. *Unloaded*: the
paper's law (`fl`, with joint springs `composite`) carries its platform. *Spread*: largest minus
smallest fraction of the best known payload that the best law carries, in percentage points.
*Wanted* are at least 80 % dynamic, 1 g under gravity, 90 % exact, 80 % unloaded, 30 points.

| environment | motions | dynamic | median peak acceleration [g] | exact | unloaded | spread |
| --- | ---: | ---: | ---: | ---: | ---: | ---: |
"""


@dataclass(frozen=True, kw_only=True)
class MotionRecord:
    """What one random motion asks of the robot of an environment."""

    env_id: str
    """Id of the environment."""
    seed: int
    """Seed of the motion."""
    duration: float
    """Duration without dwells [s]."""
    acceleration: float
    """Largest norm of the acceleration of the position [m/s²]."""
    exact: float | None
    """Payload of exact tracking by a rigid robot [kg]; None if it is infeasible for every mass."""
    exact_least: float | None
    """Least such payload [kg]; positive if the platform needs ballast."""
    held_at_start: float | None
    """Payload that the motors hold at the start pose [kg]; None without gravity."""
    held_at_worst: float | None
    """Payload that the motors hold at the worst pose within the error bounds [kg]; None without
    gravity."""
    best_known: float | None
    """Best known payload [kg]; None if none was found."""
    laws: dict[str, float | None]
    """Payload of each law [kg]; None if it fails unloaded."""

    @property
    def is_dynamic(self) -> bool:
        """Whether the best known payload is below :data:`STATIC_FRACTION` of the static limits."""
        if self.best_known is None:
            return False
        limits = [self.held_at_start, self.held_at_worst]
        return all(limit is None or self.best_known < STATIC_FRACTION * limit for limit in limits)

    @property
    def is_exact(self) -> bool:
        """Whether a rigid robot can track the motion exactly without payload."""
        if self.exact is None or self.exact_least is None:
            return False
        return self.exact_least <= 0 <= self.exact

    @property
    def best_fraction(self) -> float | None:
        """Fraction of the best known payload that the best law carries; None without one."""
        if self.best_known is None:
            return None
        return max(payload or 0.0 for payload in self.laws.values()) / self.best_known


def measured(env_id: str, seed: int) -> MotionRecord:
    """The record of the motion with a seed."""
    robot = find_robot(env_robot(env_id))
    bounds = find_error_bounds(None, robot)
    motion = find_trajectory({"name": f"loop-{robot.kind}", "seed": seed}, robot.kind)
    times = np.linspace(0.0, motion.duration, 2001)
    acceleration = motion(times).acceleration[:, : robot.dimensions]
    exact = exact_payload(robot, motion, minimum_tension=robot.minimum_tension)
    best_known = None
    try:
        best_known = find_best_known(env_id, trajectory=motion, cache=False).payload
    except ValueError as error:
        print(f"{env_id}, seed {seed}: {error}")
    laws = {}
    for law in LAWS[robot.joints]:
        laws[law] = evaluate_dlcc(law, env_id, trajectory=motion).payload
    return MotionRecord(
        env_id=env_id,
        seed=seed,
        duration=motion.motion.duration,
        acceleration=float(np.linalg.norm(acceleration, axis=1).max()),
        exact=_finite(exact.payload),
        exact_least=_finite(exact.lowest),
        held_at_start=_finite(hold_payload(robot, motion, bounds)),
        held_at_worst=_finite(worst_held(robot, motion, bounds)),
        best_known=best_known,
        laws=laws,
    )


def _finite(value: float) -> float | None:
    """The value, or None if it is infinite."""
    if np.isfinite(value):
        return float(value)
    return None


def worst_held(robot: Robot, motion: Trajectory, bounds: ErrorBounds) -> float:
    """Payload that the motors hold at the worst pose of a motion, each pose displaced within the
    error bounds to where they hold most [kg]; ``inf`` without gravity."""
    if robot.weightless:
        return np.inf
    poses = motion(np.linspace(0.0, motion.duration, _POSES)).position
    candidates = np.concatenate([_displaced(robot, pose, bounds) for pose in poses])
    held = feasible_payloads(robot, resting(candidates)).largest
    held = np.nan_to_num(held, nan=-np.inf).reshape(_POSES, -1)
    return float(held.max(axis=1).min())


def _displaced(robot: Robot, pose: Array, bounds: ErrorBounds) -> Array:
    """Displacements of a pose at the error bounds, (k, n): down, or down and inwards, with a
    rotation about each axis."""
    linear = robot.dimensions
    down = np.zeros(linear)
    down[-1] = 1.0
    inwards = -pose[:linear]
    inwards[-1] = 0.0
    inwards = inwards / max(np.linalg.norm(inwards), 1e-9)
    rotations = bounds.rotation * np.eye(robot.coordinates)[linear:]
    candidates = []
    for direction in (down, (down + inwards) / np.linalg.norm(down + inwards)):
        displaced = pose.copy()
        displaced[:linear] += bounds.position * direction
        candidates.append(displaced)
        candidates.extend(displaced + rotations)
        candidates.extend(displaced - rotations)
    return np.stack(candidates)


def page(records: list[MotionRecord]) -> str:
    """The page with one row per environment."""
    rows = []
    for env_id in ENV_IDS:
        rows_of_env = [record for record in records if record.env_id == env_id]
        if rows_of_env:
            rows.append(_row(env_id, rows_of_env))
    return HEAD + "\n".join(rows) + "\n"


def _row(env_id: str, records: list[MotionRecord]) -> str:
    """The row of an environment."""
    joints = find_robot(env_robot(env_id)).joints
    law = LAWS[joints][0]
    dynamic = np.mean([record.is_dynamic for record in records])
    acceleration = np.median([record.acceleration for record in records]) / GRAVITY
    exact = np.mean([record.is_exact for record in records])
    unloaded = np.mean([record.laws[law] is not None for record in records])
    fractions = [record.best_fraction for record in records if record.best_fraction is not None]
    spread = "–"
    if fractions:
        spread = f"{100 * np.ptp(fractions):.0f}"
    return (
        f"| `{env_id}` | {len(records)} | {dynamic:.0%} | {acceleration:.2f} | {exact:.0%} | "
        f"{unloaded:.0%} | {spread} |"
    )


def stored(path: Path) -> list[MotionRecord]:
    """The records in a file; none if there is no file."""
    if not path.exists():
        return []
    names = [field.name for field in fields(MotionRecord)]
    records: list[dict[str, Any]] = json.loads(path.read_text())
    return [MotionRecord(**{name: record[name] for name in names}) for record in records]


def main() -> None:
    """Measures the motions that are not stored yet and writes results and page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--motions", type=int, default=30, help="training seeds per environment")
    parser.add_argument("--env", nargs="+", choices=ENV_IDS, default=list(ENV_IDS))
    options = parser.parse_args()
    records = stored(RESULTS)
    known = {(record.env_id, record.seed) for record in records}
    seeds = TRAINING_SEEDS[: options.motions]
    # Seeds outside: an interrupted run then has about as many motions of each environment.
    todo = [(env, seed) for seed in seeds for env in options.env if (env, seed) not in known]
    RESULTS.parent.mkdir(exist_ok=True)
    start = time.monotonic()
    for number, (env_id, seed) in enumerate(todo, start=1):
        records.append(measured(env_id, seed))
        atomic_write_text(
            RESULTS, json.dumps([asdict(record) for record in records], indent=1) + "\n"
        )
        atomic_write_text(PAGE, page(records))
        left = (time.monotonic() - start) / number * (len(todo) - number)
        print(
            f"{env_id}, seed {seed}: {number} of {len(todo)}, {left / 60:.0f} min left", flush=True
        )


if __name__ == "__main__":
    main()
