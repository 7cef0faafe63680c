"""Measures the payload that laws lose with the sensors of winches, for the page docs/measurement.md.

Each case is the DLCC of a law on the circle, payload known, task criterion, by bisection. The results are kept in
docs/measurement/results.json after every case: a second call computes the missing ones.

python scripts/measure_winches.py [--env ID …]
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cablebot_gym.envs import PAPER_ENV_IDS, env_robot
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.evaluation.batch import versions
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.utils.console import notes_console
from cablebot_gym.utils.files import atomic_write_text

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "measurement"

LAWS = {
    "CableBot-Planar-v0": "fl",
    "CableBot-Spatial-v0": "fl",
    "CableBot-FlexPlanar-v0": "composite-tuned",
    "CableBot-FlexSpatial-v0": "composite",
}
"""Law of each environment. It reads pose and velocity."""

DRAWS = 64
"""Draws of a case with random errors."""

RESOLUTION = 0.02
"""Resolution of the payloads [kg]."""

COUNTS = 8192
"""Steps of an encoder per revolution."""

CALIBRATED, UNCALIBRATED = 0.3e-3, 2.5e-3
"""Standard deviations of the zero error of a cable length after and before calibration [m]."""

CASES = ("encoders", "calibrated", "load-cells", "imu", "uncalibrated")
"""Sets of errors; each has those of the encoders."""


def errors(robot: Robot, case: str) -> dict[str, Any]:
    """Uncertainty of a set of errors: encoder, servo drive, load cells of 1 % bias and 0.2 % noise, IMU MTi-300."""
    degree, scale = math.pi / 180, float(robot.stall_torque.min() / robot.pulley_radius.max())
    noise, bias = {"motor_angle": 1e-4, "motor_speed": 1e-2}, {}
    if case != "encoders":
        zero = UNCALIBRATED if case == "uncalibrated" else CALIBRATED
        bias["motor_angle"] = zero / float(robot.pulley_radius.min())
    if case in ("load-cells", "imu"):
        noise["tension"], bias["tension"] = 2e-3 * scale, 1e-2 * scale
    if case == "imu":
        bandwidth = math.sqrt(250.0)
        noise |= {"angular_rate": 0.01 * degree * bandwidth, "specific_force": 60e-6 * 9.81 * bandwidth}
        bias |= {"tilt": 0.2 * degree, "yaw": 1.0 * degree}
    return {"sensors": noise, "sensor_bias": bias}


def cases(env_id: str) -> Iterator[dict[str, Any]]:
    """Estimator, sensors and errors of each case; the first one measures the pose."""
    robot = find_robot(env_robot(env_id))
    yield {"estimator": "", "sensors": "pose", "errors": ""}
    for estimator in ("fk", "ekf"):
        yield {"estimator": estimator, "sensors": "winches", "errors": ""}
        yield {"estimator": estimator, "sensors": "winches", "errors": "encoders"}
    yield {"estimator": "ekf", "sensors": "winches", "errors": "calibrated"}
    yield {"estimator": "ekf", "sensors": "winches+tensions", "errors": "load-cells"}
    if not robot.planar:
        for estimator in ("ekf", "ekf-homed"):
            yield {"estimator": estimator, "sensors": "winches+tensions+imu", "errors": "imu"}
    yield {"estimator": "ekf-homed", "sensors": "winches+tensions", "errors": "load-cells"}
    yield {"estimator": "ekf", "sensors": "winches", "errors": "uncalibrated"}
    yield {"estimator": "ekf-homed", "sensors": "winches", "errors": "uncalibrated"}


def payload(env_id: str, case: dict[str, Any]) -> dict[str, Any]:
    """The result of a case: payload [kg], None if it fails unloaded, and the limiting violation."""
    robot = find_robot(env_robot(env_id))
    policy = "+".join(filter(None, [case["estimator"], LAWS[env_id]]))
    measurement: dict[str, Any] = {"kind": "pose"}
    if case["sensors"] != "pose":
        _, *sensors = case["sensors"].split("+")
        resolution = 2 * math.pi / COUNTS if case["errors"] else 0.0
        measurement = {"kind": "winches", "encoder_resolution": resolution} | dict.fromkeys(sensors, True)
    result = evaluate_dlcc(
        policy,
        env_id,
        measurement=measurement,
        uncertainty=errors(robot, case["errors"]) if case["errors"] else None,
        draws=DRAWS if case["errors"] else None,
        search="bisection",
        payload_max=4.0 if robot.planar else 8.0,
        resolution=RESOLUTION,
    )
    violation = None if result.violation is None else str(result.violation.kind)
    return {"payload": result.payload, "violation": violation}


def table(data: dict[str, Any]) -> str:
    """Markdown table of the stored results: payload of each case, and its fraction of that with the pose."""
    names = {
        "encoders": "encoders",
        "calibrated": "encoders, calibrated zero",
        "load-cells": "encoders, calibrated zero, load cells",
    }
    names |= {
        "imu": "encoders, calibrated zero, load cells, IMU",
        "uncalibrated": "encoders, zero before calibration",
        "": "–",
    }
    env_ids = [env_id for env_id in PAPER_ENV_IDS if any(one["env_id"] == env_id for one in data["cases"])]
    rows: dict[tuple[str, str, str], dict[str, str]] = {}
    for one in data["cases"]:
        key = (one["sensors"], one["estimator"], one["errors"])
        (full,) = (o["payload"] for o in data["cases"] if o["env_id"] == one["env_id"] and o["sensors"] == "pose")
        own = one["payload"]
        text = (
            "fails unloaded" if own is None else f"{own:.2f} kg" + (f", {own / full:.0%}" if one["estimator"] else "")
        )
        rows.setdefault(key, {})[one["env_id"]] = text
    head = ["sensors", "estimator", "errors", *(f"`{env_id}`, `{LAWS[env_id]}`" for env_id in env_ids)]
    lines = [head, ["---"] * len(head)]
    for (sensors, estimator, error), entries in rows.items():
        known = f"`{estimator}`" if estimator else "–"
        lines.append([f"`{sensors}`", known, names[error], *(entries.get(env_id, "–") for env_id in env_ids)])
    return "\n" + "".join(f"| {' | '.join(line)} |\n" for line in lines) + "\n"


def main() -> None:
    """Computes the missing cases."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--env", nargs="*", default=list(PAPER_ENV_IDS), choices=PAPER_ENV_IDS, help="environments; all by default"
    )
    parser.add_argument("--out", type=Path, default=FOLDER / "results.json", help="file of the results")
    arguments = parser.parse_args()
    data: dict[str, Any] = {"draws": DRAWS, "resolution": RESOLUTION, "versions": versions(), "cases": []}
    if arguments.out.is_file():
        data["cases"] = json.loads(arguments.out.read_text(encoding="utf-8"))["cases"]
    arguments.out.parent.mkdir(exist_ok=True)
    known = {(one["env_id"], one["estimator"], one["sensors"], one["errors"]) for one in data["cases"]}
    todo = [(env_id, case) for env_id in arguments.env for case in cases(env_id)]
    for number, (env_id, case) in enumerate(todo, 1):
        if (env_id, *case.values()) in known:
            continue
        data["cases"].append({"env_id": env_id, **case, **payload(env_id, case)})
        text = json.dumps(data, indent=1, ensure_ascii=False)
        atomic_write_text(arguments.out, text + "\n")
        notes_console().print(f"{number} of {len(todo)}: {data['cases'][-1]}")


if __name__ == "__main__":
    main()
