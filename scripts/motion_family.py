"""Measures the random motions that the leaderboard ranks, over training seeds.

* ``measure``: largest acceleration, payload of exact tracking, payloads that the motors hold at
  rest (at the start, and at the worst pose that the error bounds allow), and best known payload.
  The last is that of one coarse mesh without replays, which takes a second instead of minutes.
* ``laws``: payloads of control laws, by surveys over many motions at once.

Both go on where they were interrupted, and write the page with all figures.

python scripts/motion_family.py measure --motions 200
python scripts/motion_family.py laws --motions 200
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np

from cablebot_gym import ENV_IDS, ErrorBounds, Robot, find_robot, find_trajectory
from cablebot_gym.bounds.best_known import INTERVALS_PER_SECOND, MIN_INTERVALS
from cablebot_gym.bounds.closed_form import exact_payload
from cablebot_gym.envs import env_robot
from cablebot_gym.evaluation.survey import survey
from cablebot_gym.kinematics import Array
from cablebot_gym.physics.statics import feasible_payloads, hold_payload, resting
from cablebot_gym.planning import Infeasible, MotionProgram
from cablebot_gym.policies import policy_entries
from cablebot_gym.task import find_error_bounds
from cablebot_gym.trajectories import TRAINING_SEEDS, Trajectory
from cablebot_gym.utils.files import atomic_write_text

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "motions" / "results.json"
LAW_RESULTS = ROOT / "docs" / "motions" / "laws.json"
PAGE = ROOT / "docs" / "motions.md"

GRAVITY = 9.81
"""Gravitational acceleration [m/s²]."""

RIGID_LAWS = ("fl", "robust", "adaptive")
FLEXIBLE_LAWS = ("composite", "adaptive")
LAWS = tuple(dict.fromkeys([*RIGID_LAWS, *FLEXIBLE_LAWS]))
"""Control laws."""

STATIC_FRACTION = 0.9
"""Fraction of every static limit below which a payload counts as limited by the dynamics."""

MOST_INTERVALS = 60
"""Largest number of intervals of the mesh."""

CONTROL_PERIOD = 0.002
"""Period over which torques are constant [s]."""

ORDER = (
    "CableBot-Spatial-v0",
    "CableBot-FlexSpatial-v0",
    "CableBot-Planar-v0",
    "CableBot-FlexPlanar-v0",
    "CableBot-Point-v0",
    "CableBot-PlanarPlatform-v0",
    "CableBot-FlexPoint-v0",
    "CableBot-FlexPlanarPlatform-v0",
)
"""Environments in the order of the measurements."""

LAW_RESOLUTION = 0.002
"""Gap of the payload of a law to the least failed one, as a fraction of the end of the scan."""

BLOCK = 50
"""Number of motions of a survey, after which its payloads are stored."""

_POSES = 41
"""Number of poses of a motion at which the static limit is computed."""

WANTED_DYNAMIC = 0.8
"""Least fraction of motions whose payload the dynamics limit."""

WANTED_ACCELERATION = 1.0
"""Least median of the largest acceleration [9.81 m/s²], of robots that hang under gravity."""

WANTED_EXACT = 0.9
"""Least fraction of motions that can be tracked exactly."""

WANTED_UNLOADED = 0.8
"""Least fraction of motions on which the first law carries its platform."""

WANTED_RANGE = 0.3
"""Least difference between the largest and the smallest fraction of the best law."""

HEAD = f"""# Random motions

Measured by `python scripts/motion_family.py` over training seeds. Even seeds are smooth; on odd seeds the acceleration
jumps as on the paper's circle. Bold entries miss the value that was wanted.

* *Dynamic*: the dynamics limit the payload. The best known payload is below {STATIC_FRACTION:g} of the payloads that
  the motors hold at rest, at the start and at the worst pose within the error bounds. Robots without gravity have no
  such static limit. The best known payload of this page is that of one coarse mesh without replays. It is usually a
  little smaller than that of `cablebot best-known`.
* *Acceleration*: median of the largest acceleration of the position, in units of 9.81 m/s².
* *Exact*: a rigid robot can track the motion exactly without payload.
* *Unloaded*: the first law carries its platform. That is `fl`, and with springs `composite`.
* *Any law*: one of the laws carries its platform. They are {", ".join(f"`{law}`" for law in LAWS)}.
* *Law fraction*: payload of the best of these laws over the best known payload.

Robots with springs have the motions of the rigid ones. Faster motions would raise *dynamic* where it is too small, and
lower *exact* and *unloaded* of the rigid robot.

| environment | motions | dynamic | acceleration | exact | unloaded | any law | law fraction, range |
| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |
| *wanted* | 200 | {WANTED_DYNAMIC:.0%} | {WANTED_ACCELERATION:g} under gravity | {WANTED_EXACT:.0%} | \
{WANTED_UNLOADED:.0%} | | {100 * WANTED_RANGE:.0f} points wide |
"""


@dataclass(frozen=True, kw_only=True)
class MotionRecord:
    """What one random motion asks of the robot of an environment."""

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
    """Best known payload on one coarse mesh [kg]; None if none was found."""

    @property
    def static_fraction(self) -> float:
        """Best known payload over the least static limit; 0 without gravity, ``inf`` without a best
        known payload."""
        if self.best_known is None:
            return math.inf
        if self.held_at_start is None or self.held_at_worst is None:
            return 0.0
        return self.best_known / min(self.held_at_start, self.held_at_worst)

    @property
    def is_exact(self) -> bool:
        """Whether a rigid robot can track the motion exactly without payload."""
        if self.exact is None or self.exact_least is None:
            return False
        return self.exact_least <= 0 <= self.exact


Records = dict[str, list[MotionRecord]]
"""Records by environment, in the order of the seeds."""

LawPayloads = dict[str, dict[str, list[float | None]]]
"""Payloads by environment and law, in the order of the seeds [kg]; None if the law fails unloaded."""


def random_motion(env_id: str, seed: int) -> Trajectory:
    """The motion of an environment with a seed."""
    kind = find_robot(env_robot(env_id)).kind
    return find_trajectory({"name": f"loop-{kind}", "seed": seed}, kind)


def measured(env_id: str, seed: int) -> MotionRecord:
    """The record of the motion with a seed."""
    robot = find_robot(env_robot(env_id))
    bounds = find_error_bounds(None, robot)
    motion = random_motion(env_id, seed)
    times = np.linspace(0.0, motion.duration, 2001)
    acceleration = motion(times).acceleration[:, : robot.dimensions]
    exact = exact_payload(robot, motion, minimum_tension=robot.minimum_tension)
    return MotionRecord(
        duration=motion.motion.duration,
        acceleration=short(np.linalg.norm(acceleration, axis=1).max()),
        exact=short(exact.payload),
        exact_least=short(exact.lowest),
        held_at_start=short(hold_payload(robot, motion, bounds)),
        held_at_worst=short(worst_held(robot, motion, bounds)),
        best_known=short(coarse_best_known(robot, motion, bounds)),
    )


def short(value: float | None) -> float | None:
    """The value with four digits, or None if it is infinite."""
    if value is None or not np.isfinite(value):
        return None
    return float(f"{value:.4g}")


def coarse_best_known(robot: Robot, motion: Trajectory, bounds: ErrorBounds) -> float | None:
    """Payload of the nonlinear program on one coarse mesh [kg]; None if it is infeasible."""
    intervals = math.ceil(INTERVALS_PER_SECOND * motion.duration)
    intervals = min(max(MIN_INTERVALS, intervals), MOST_INTERVALS)
    program = MotionProgram(robot, motion, bounds, intervals=intervals, period=CONTROL_PERIOD)
    lowered = np.zeros(robot.coordinates)
    lowered[min(2, robot.coordinates - 1)] = 0.7
    for shift in (np.zeros(robot.coordinates), lowered):
        with suppress(Infeasible):
            return program.solve(shift=shift).payload
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


def page(records: Records, laws: LawPayloads) -> str:
    """The page with one row per environment."""
    rows = []
    for env_id in ENV_IDS:
        if records.get(env_id):
            rows.append(row(env_id, records[env_id], laws.get(env_id, {})))
    return HEAD + "\n".join(rows) + "\n"


def row(
    env_id: str, records: Sequence[MotionRecord], laws: Mapping[str, Sequence[float | None]]
) -> str:
    """The row of an environment."""
    static = "no static limit"
    hangs = records[0].held_at_start is not None
    if hangs:
        is_dynamic = [record.static_fraction < STATIC_FRACTION for record in records]
        static = marked_share(is_dynamic, WANTED_DYNAMIC)
    median = np.median([record.acceleration for record in records]) / GRAVITY
    acceleration = marked(f"{median:.2f}", median >= WANTED_ACCELERATION or not hangs)
    exact = marked_share([record.is_exact for record in records], WANTED_EXACT)
    cells = [f"`{env_id}`", str(len(records)), static, acceleration, exact]
    return f"| {' | '.join([*cells, *law_cells(records, laws)])} |"


def law_cells(
    records: Sequence[MotionRecord], laws: Mapping[str, Sequence[float | None]]
) -> tuple[str, str, str]:
    """Fractions of motions on which the first law and any law carry their platforms, and range of
    the fraction of the best known payload that the best law carries."""
    if not laws:
        return "–", "–", "–"
    count = min(len(records), *(len(payloads) for payloads in laws.values()))
    of_motions = list(zip(*(payloads[:count] for payloads in laws.values()), strict=True))
    is_carried = [payloads[0] is not None for payloads in of_motions]
    unloaded = f"{marked_share(is_carried, WANTED_UNLOADED)} of {count}"
    by_any_law = np.mean([any(payload is not None for payload in row) for row in of_motions])
    fractions = []
    for record, payloads in zip(records[:count], of_motions, strict=True):
        if record.best_known is not None and record.best_known > 0:
            fractions.append(max(payload or 0.0 for payload in payloads) / record.best_known)
    spread = "–"
    if fractions:
        low, high = min(fractions), max(fractions)
        spread = marked(f"{low:.0%} to {high:.0%}", high - low >= WANTED_RANGE)
    return unloaded, f"{by_any_law:.0%}", spread


def marked_share(holds: Sequence[bool], wanted: float) -> str:
    """The fraction of motions for which something holds, bold if it is smaller than wanted."""
    share = float(np.mean(holds))
    return marked(f"{share:.0%}", share >= wanted)


def marked(text: str, is_met: bool) -> str:
    """The text, bold unless the wanted value is met."""
    return text if is_met else f"**{text}**"


def stored_records() -> Records:
    """The records in the file; none if there is no file."""
    if not RESULTS.exists():
        return {}
    names = [field.name for field in fields(MotionRecord)]
    records: Records = {}
    for env_id, rows in json.loads(RESULTS.read_text()).items():
        records[env_id] = []
        for values in rows:
            records[env_id].append(MotionRecord(**dict(zip(names, values, strict=True))))
    return records


def stored_laws() -> LawPayloads:
    """The payloads of laws in the file; none if there is no file."""
    if not LAW_RESULTS.exists():
        return {}
    payloads: LawPayloads = json.loads(LAW_RESULTS.read_text())
    return payloads


def laws_of(env_id: str) -> tuple[str, ...]:
    """The laws that support the robot of an environment, which is exactly known."""
    laws = RIGID_LAWS
    if find_robot(env_robot(env_id)).flexible:
        laws = FLEXIBLE_LAWS
    entries = policy_entries()
    return tuple(law for law in laws if env_id in entries[law].env_ids)


def store_records(records: Records) -> None:
    """Writes the records, a line per environment and no names, because the file must stay small."""
    lines = []
    for env_id, records_of_env in records.items():
        rows = json.dumps([astuple(record) for record in records_of_env], separators=(",", ":"))
        lines.append(f"{json.dumps(env_id)}: {rows}")
    RESULTS.parent.mkdir(exist_ok=True)
    atomic_write_text(RESULTS, "{\n" + ",\n".join(lines) + "\n}\n")


def measure(env_ids: Sequence[str], motions: int) -> None:
    """Measures the motions that are not stored yet. Seeds are outside, so that an interrupted run
    has about as many motions of each environment."""
    records = stored_records()
    todo = []
    for seed in TRAINING_SEEDS[:motions]:
        todo += [(env_id, seed) for env_id in env_ids if seed >= len(records.get(env_id, []))]
    start = time.monotonic()
    for number, (env_id, seed) in enumerate(todo, start=1):
        records.setdefault(env_id, []).append(measured(env_id, seed))
        store_records(records)
        left = (time.monotonic() - start) / number * (len(todo) - number)
        print(
            f"{env_id}, seed {seed}: {number} of {len(todo)}, {left / 60:.0f} min left", flush=True
        )


def measure_laws(env_ids: Sequence[str], motions: int) -> None:
    """Surveys the laws on the motions that are not stored yet, a block of motions after the
    other."""
    laws = stored_laws()
    for begin in range(0, motions, BLOCK):
        for env_id in env_ids:
            payloads = laws.setdefault(env_id, {})
            for law in laws_of(env_id):
                known = payloads.setdefault(law, [])
                seeds = TRAINING_SEEDS[len(known) : min(begin + BLOCK, motions)]
                if not seeds:
                    continue
                block = [random_motion(env_id, seed) for seed in seeds]
                result = survey(law, env_id, block, resolution=LAW_RESOLUTION)
                known += [short(motion.payload) for motion in result.motions]
                text = json.dumps(laws, separators=(",", ":")).replace("},", "},\n")
                atomic_write_text(LAW_RESULTS, text + "\n")
                print(f"{env_id}, {law}: {len(known)} of {motions} motions", flush=True)


def main() -> None:
    """Measures motions or laws, and writes the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["measure", "laws", "page"])
    parser.add_argument("--motions", type=int, default=200, help="training seeds per environment")
    parser.add_argument("--env", nargs="+", choices=ENV_IDS, default=ORDER)
    options = parser.parse_args()
    if options.what == "measure":
        measure(options.env, options.motions)
    elif options.what == "laws":
        measure_laws(options.env, options.motions)
    atomic_write_text(PAGE, page(stored_records(), stored_laws()))


if __name__ == "__main__":
    main()
