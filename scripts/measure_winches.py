"""Measures the payload that laws lose with the sensors of winches, for the page
docs/measurement.md.

Each case is the DLCC of a law on the circle, payload known, task criterion, by bisection. Its row
is kept in docs/measurement/sensors.jsonl: a second call computes the rows that are missing or due.

python scripts/measure_winches.py [--env ID …]
"""

from __future__ import annotations

import argparse
import math
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from scipy.stats import chi2

from cablebot_baselines.observer import Estimated, Expectation, WinchEstimator
from cablebot_baselines.observer.expectation import UNKNOWN_START
from cablebot_gym.benchmark.rows import Row
from cablebot_gym.benchmark.store import Store
from cablebot_gym.benchmark.tables import markdown_table
from cablebot_gym.envs import PAPER_ENV_IDS, env_robot
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.evaluation.batch import versions
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.policies import load_policy
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.uncertainty import find_uncertainty
from cablebot_gym.utils.console import say

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "measurement"

SUITE = "sensors"
"""Name of the rows."""

LAWS = {
    "CableBot-Planar-v0": "fl:gains=tuned",
    "CableBot-Spatial-v0": "fl:gains=400/40",
    "CableBot-FlexPlanar-v0": "composite",
    "CableBot-FlexSpatial-v0": "composite:gains=paper",
}
"""Law of each environment. It reads pose and velocity."""

DRAWS = 64
"""Draws of a case with random errors."""

RESOLUTION = 0.02
"""Resolution of the payloads [kg]."""

SATURATED = 100.0
"""Action at which each motor saturates at any speed; a law far from the true pose asks for more than an
environment takes."""

PAYLOAD = 1.0
"""Payload of the episodes in which the filter is checked [kg]."""

COUNTS = 8192
"""Steps of an encoder per revolution."""

CALIBRATED, UNCALIBRATED = 0.3e-3, 2.5e-3
"""Standard deviations of the zero error of a cable length after and before calibration [m]."""

START = {"start-mocap": (0.2e-3, 0.35e-3), "start": (2e-3, 2e-3)}
"""Half widths of the error of the start pose [m, rad]: with motion capture as in ``hardware``, and
a larger one."""

NAMES = {
    "": "–",
    "encoders": "encoders",
    "calibrated": "encoders, calibrated zero",
    "load-cells": "encoders, calibrated zero, load cells",
    "imu": "encoders, calibrated zero, load cells, IMU",
    "uncalibrated": "encoders, zero before calibration",
}
"""Errors of the sensors, as the table names them."""

DISTURBANCES = {
    "": "–",
    **{name: f"start pose ± {1e3 * p:g} mm, ± {1e3 * r:g} mrad" for name, (p, r) in START.items()},
    **{name: f"robot and forces of `{name}`" for name in ("table6", "hardware")},
}
"""Deviations from the nominal robot and start pose, as the table names them. They concern exact
sensors as well."""


def errors(robot: Robot, case: str) -> dict[str, Any]:
    """Uncertainty of a set of errors: encoder, servo drive, load cells of 1 % bias and 0.2 % noise,
    IMU MTi-300."""
    degree = math.pi / 180
    scale = float(robot.stall_torque.min() / robot.pulley_radius.max())
    noise = {"motor_angle": 1e-4, "motor_speed": 1e-2}
    bias = {}
    if case != "encoders":
        zero = CALIBRATED
        if case == "uncalibrated":
            zero = UNCALIBRATED
        bias["motor_angle"] = zero / float(robot.pulley_radius.min())
    if case in ("load-cells", "imu"):
        noise["tension"], bias["tension"] = 2e-3 * scale, 1e-2 * scale
    if case == "imu":
        bandwidth = math.sqrt(250.0)
        noise |= {
            "angular_rate": 0.01 * degree * bandwidth,
            "specific_force": 60e-6 * 9.81 * bandwidth,
        }
        bias |= {"tilt": 0.2 * degree, "yaw": 1.0 * degree}
    return {"sensors": noise, "sensor_bias": bias}


def cases(env_id: str) -> Iterator[dict[str, str]]:
    """Sensors, estimator, errors and disturbance of each case; the first one of a disturbance
    measures the pose."""

    def case(
        sensors: str, estimator: str = "", errors: str = "", disturbance: str = ""
    ) -> dict[str, str]:
        return {
            "estimator": estimator,
            "sensors": sensors,
            "errors": errors,
            "disturbance": disturbance,
        }

    cells, imu = "winches+tensions", "winches+tensions+imu"
    planar = find_robot(env_robot(env_id)).planar
    yield case("pose")
    for estimator in ("fk", "ekf"):
        yield case("winches", estimator)
        yield case("winches", estimator, "encoders")
    yield case("winches", "ekf", "calibrated")
    yield case("winches", "ekf", "uncalibrated")
    yield case("winches", "ekf-homed", "uncalibrated")
    for estimator in ("ekf", "ekf-homed"):
        yield case(cells, estimator, "load-cells")
        if not planar:
            yield case(imu, estimator, "imu")
    for disturbance in filter(None, DISTURBANCES):
        yield case("pose", disturbance=disturbance)
        if disturbance == "start":
            yield case(cells, "ekf", "load-cells", disturbance)
        if not planar and disturbance == "hardware":
            yield case("winches", "ekf-homed", "calibrated", disturbance)
        yield case(cells, "ekf-homed", "load-cells", disturbance)
        if not planar and disturbance in ("start", "hardware"):
            yield case(imu, "ekf-homed", "imu", disturbance)


def conditions(env_id: str, case: dict[str, str]) -> dict[str, Any]:
    """Keywords of the environment of a case: measurement, uncertainty and error of the start
    pose."""
    robot = find_robot(env_robot(env_id))
    disturbance = case["disturbance"]
    options: dict[str, Any] = {"measurement": {"kind": "pose"}}
    if case["sensors"] != "pose":
        _, *sensors = case["sensors"].split("+")
        measurement = {"kind": "winches", "encoder_resolution": 0.0}
        if case["errors"]:
            measurement["encoder_resolution"] = 2 * math.pi / COUNTS
        options["measurement"] = measurement | dict.fromkeys(sensors, True)
    uncertainty = {}
    if case["errors"]:
        uncertainty = errors(robot, case["errors"])
    if disturbance in START:
        position, rotation = START[disturbance]
        turns = robot.coordinates - robot.dimensions
        options["initial_error_range"] = [position] * robot.dimensions + [rotation] * turns
    elif disturbance:
        named = find_uncertainty(disturbance, robot)
        uncertainty |= {"parameters": named.parameters, "wrench": named.wrench}
    options["uncertainty"] = uncertainty or None
    return options


def estimator(env_id: str, case: dict[str, str]) -> WinchEstimator | None:
    """The filter of a case, which knows the standard deviations of the errors; None for the
    estimator of this name without errors."""
    robot = find_robot(env_robot(env_id))
    if not case["errors"] or not case["estimator"].startswith("ekf"):
        return None
    start = UNKNOWN_START
    if case["estimator"] == "ekf-homed":
        position, rotation = START.get(case["disturbance"], (0.0, 0.0))
        start = position / math.sqrt(3), rotation / math.sqrt(3)
    uncertainty = find_uncertainty(conditions(env_id, case)["uncertainty"], robot)
    return WinchEstimator(robot, Expectation.of(robot, uncertainty, start_spread=start))


def consistency(env_id: str, case: dict[str, str]) -> float | None:
    """Squared errors of the pose by the covariance that the filter states, divided by the number of
    coordinates (NEES/n): mean of the draws and of the motion. None without a filter that knows the
    errors."""
    observing = estimator(env_id, case)
    if observing is None:
        return None
    n = observing.robot.coordinates
    env: Any = gym.make_vec(
        env_id,
        num_envs=DRAWS,
        payload=PAYLOAD,
        max_episode_steps=None,
        **conditions(env_id, case),
    ).unwrapped
    policy = Estimated(load_policy(LAWS[env_id], observing.robot), observing.robot, observing)
    rows, _ = env.reset(seed=0)
    policy.reset(env.tasks)
    state = None
    squares = []
    running = np.full(DRAWS, True)
    for step in range(env.tasks[0].steps):
        actions, state = policy.predict(rows, state)
        if step:  # without a start error the first pose is certain
            # A terminated episode starts anew elsewhere, where the filter does not expect it.
            error = state[0].mean[running, :n] - env.pose[running]
            covariance = state[0].covariance[running, :n, :n]
            weighted = np.linalg.solve(covariance, error[..., None])[..., 0]
            squares.append(np.sum(error * weighted, axis=-1) / n)
        rows, _, terminated, _, _ = env.step(np.clip(actions, -SATURATED, SATURATED))
        running &= ~terminated
    return float(np.mean(np.concatenate(squares)))


def question(env_id: str, case: dict[str, str]) -> Row:
    """The row of a case without result."""
    draws = None
    if case["errors"] or case["disturbance"]:
        draws = DRAWS
    payload_max = 8.0
    if find_robot(env_robot(env_id)).planar:
        payload_max = 4.0
    given = {"env_id": env_id, "draws": draws, **conditions(env_id, case)}
    return Row(
        measure="payload",
        policy="+".join(filter(None, [case["estimator"], LAWS[env_id]])),
        conditions=Conditions.from_dict(given),
        search={"search": "bisection", "payload_max": payload_max, "resolution": RESOLUTION},
    )


def compute(env_id: str, case: dict[str, str]) -> Row:
    """The row of a case: payload [kg], None if it fails unloaded, the limiting violation, and the
    consistency of the filter."""
    row = question(env_id, case)
    robot = find_robot(env_robot(env_id))
    policy: Any = row.policy
    observing = estimator(env_id, case)
    if observing is not None:
        policy = Estimated(load_policy(LAWS[env_id], robot), robot, observing)
    start = time.perf_counter()
    result = evaluate_dlcc(policy, env_id, **row.conditions.keywords(), **row.search)
    violation = None
    if result.violation is not None:
        violation = str(result.violation.kind)
    return replace(
        row,
        result={
            "payload": result.payload,
            "violation": violation,
            "nees": consistency(env_id, case),
        },
        code=row.present_code,
        versions=versions(),
        seconds=time.perf_counter() - start,
    )


def table(rows: Sequence[Row]) -> str:
    """Markdown table of the rows: the payload of each case as a fraction of that with the exact pose,
    and the consistency of the filter."""
    stored = {row.key: row.result for row in rows}
    lines: dict[tuple[str, ...], dict[str, str]] = defaultdict(dict)
    exact: dict[tuple[str, str], float | None] = {}
    for env_id in LAWS:
        for case in cases(env_id):
            result = stored[question(env_id, case).key]
            place = env_id, case["disturbance"]
            if case["sensors"] == "pose":
                exact[place] = result["payload"]
                continue
            sensors, estimator = case["sensors"], case["estimator"]
            names = f"`{sensors}`", f"`{estimator}`", NAMES[case["errors"]]
            line = (*names, DISTURBANCES[case["disturbance"]])
            lines[line][env_id] = _cell(result, exact.get(place))
    head = ["sensors", "estimator", "errors of the sensors", "deviation"]
    head += [f"`{env_id}`, `{law}`" for env_id, law in LAWS.items()]
    body = []
    for line, entries in lines.items():
        body.append([*line, *(entries.get(env_id, "–") for env_id in LAWS)])
    return (
        f"\nWith {DRAWS} draws, 95 % of consistent filters have a NEES at one instant "
        f"between {interval(2, DRAWS)} in a plane, and {interval(6, DRAWS)} in space.\n\n"
        + markdown_table([head, *body])
        + "\n"
    )


def _cell(result: Mapping[str, Any], exact: float | None) -> str:
    """Text of a case, from its result and the payload with the exact pose."""
    payload = result["payload"]
    text = "fails unloaded"
    if exact is None:
        text = "fails unloaded, with the exact pose too"
    elif payload is not None:
        text = f"{payload / exact:.0%}"
    if result.get("nees") is not None:
        text += f" (NEES {result['nees']:.2f})"
    return text


def interval(coordinates: int, draws: int) -> str:
    """95 % interval of the NEES, divided by the number of coordinates."""
    degrees = coordinates * draws
    low, high = (float(chi2.ppf(level, degrees)) / degrees for level in (0.025, 0.975))
    return f"{low:.2f} and {high:.2f}"


def main() -> None:
    """Computes the rows that are missing or due."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument(
        "--env",
        nargs="*",
        default=list(PAPER_ENV_IDS),
        choices=PAPER_ENV_IDS,
        help="environments; all by default",
    )
    arguments = parser.parse_args()
    store = Store(
        FOLDER,
        suite=SUITE,
        command="python scripts/measure_winches.py",
        seed_text=None,
        say=say,
    )
    todo = [(env_id, case) for env_id in arguments.env for case in cases(env_id)]
    for number, (env_id, case) in enumerate(todo, 1):
        if store.find(question(env_id, case)) is None:
            row = compute(env_id, case)
            store.add([row])
            say(f"{number} of {len(todo)}: {row}: {row.result}")
    order = [question(env_id, case).key for env_id in LAWS for case in cases(env_id)]
    store.close(order)


if __name__ == "__main__":
    main()
