"""``cablebot identify``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cablebot_gym.cli.options import Json
from cablebot_gym.utils.console import print_table, say

if TYPE_CHECKING:
    from cablebot_gym.identification import Identification

FILES = ("robot.toml", "uncertainty.json", "identification.json")
"""Files that the command writes."""


def identify(
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG...", help="CSV files with the logs of winches.")
    ],
    *,
    robot: Annotated[str, "Robot with geometry and masses: TOML or JSON file, or a name."],
    out: Annotated[
        Path, "Folder for robot.toml, uncertainty.json and identification.json; new or empty."
    ],
    payload: Annotated[float, "Payload of logs with a pose and without a column payload [kg]."] = 0,
    as_json: Json = False,
) -> None:
    """Identify friction and inertia of winches from logs, with confidence intervals.

    The columns time, speed_1 and torque_1 or current_1 are of winch 1, and so on. Either masses hang
    on the cables, with the column load_1, or the pose of the platform is measured, with the columns
    x, y, … Parameters that the logs do not determine keep the values of the robot, and the table
    says why. `cablebot dlcc` takes robot.toml as --robot and uncertainty.json as --uncertainty.

    Examples:

    cablebot identify 1kg.csv 5kg.csv --robot my.toml --out identified

    cablebot identify motion.csv --robot my.toml --payload 2 --out identified
    """
    from cablebot_gym.identification import identify, read_log
    from cablebot_gym.robots import find_robot
    from cablebot_gym.robots.writing import to_toml
    from cablebot_gym.task import to_jsonable
    from cablebot_gym.utils.checks import number
    from cablebot_gym.utils.files import atomic_write_text, check_writable_dir

    nominal = find_robot(robot)
    number("--payload", payload, least=0, unit="kg")
    if any((out / name).exists() for name in FILES):
        raise ValueError(f"{str(out)!r} has files of an identification: choose another --out")
    result = identify(nominal, [read_log(path, nominal) for path in logs], payload=payload)
    data = result.to_dict()
    check_writable_dir(out)
    texts = (to_toml(result.robot), _json(to_jsonable(result.uncertainty)), _json(data))
    for name, text in zip(FILES, texts, strict=True):
        atomic_write_text(out / name, text)
    if as_json:
        print(_json(data), end="")
    else:
        print_table(f"{nominal.name}: identified parameters", _rows(result))
        print("\n".join(_residual_lines(result)))
    say(f"wrote {', '.join(FILES)} to {out}")


def _json(data: object) -> str:
    return json.dumps(data, indent=1, ensure_ascii=False) + "\n"


def _rows(result: Identification) -> list[list[str]]:
    """Header and rows of the estimates."""
    from cablebot_gym.identification.regression import CONFIDENCE
    from cablebot_gym.identification.result import unit_of

    confidence = f"{100 * CONFIDENCE:g} % interval"
    rows = [["parameter", "motors", "value", confidence, "unit", "determined"]]
    for item in result.estimates:
        value, interval = "–", "–"
        if item.value == item.value:  # not NaN
            low, high = item.value - item.half_width, item.value + item.half_width
            value, interval = f"{item.value:.4g}", f"{low:.4g} to {high:.4g}"
        motors = ", ".join(str(motor + 1) for motor in item.motors)
        determined = "yes"
        if item.reason:
            determined = f"not determined: {item.reason}"
        rows.append([item.name, motors, value, interval, unit_of(item.name), determined])
    return rows


def _residual_lines(result: Identification) -> list[str]:
    """Lines with the residuals."""
    lines = []
    for item in result.residuals:
        name = "platform"
        if item.motor >= 0:
            name = f"motor {item.motor + 1}"
        fraction = item.rms / item.response
        lines.append(f"residual   {name}: {item.rms:.3g} RMS, {fraction:.1%} of the response")
    return lines
