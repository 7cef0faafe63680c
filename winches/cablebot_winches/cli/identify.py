"""``cablebot identify``."""

from __future__ import annotations

import json
import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cablebot_gym.cli.options import Json
from cablebot_gym.utils.console import print_table, say

if TYPE_CHECKING:
    from cablebot_winches.identification import Identification

FILES = ("robot.toml", "uncertainty.json", "identification.json")
"""Files that the command writes, besides figures."""


def identify(
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG...", help="CSV files with the logs of winches.")
    ],
    *,
    robot: Annotated[str, "Robot with geometry and masses: TOML or JSON file, or a name."],
    out: Annotated[
        Path,
        "Folder for robot.toml, uncertainty.json, identification.json and figures; new or empty.",
    ],
    payload: Annotated[float, "Payload of logs with a pose and without a column payload [kg]."] = 0,
    as_json: Json = False,
) -> None:
    """Identify friction, inertia and cable lengths of winches from logs, with confidence intervals.

    The columns time, speed_1 and torque_1 or current_1 are of winch 1, and so on. Either masses hang
    on the cables, with the column load_1, or the pose of the platform is measured, with the columns
    x, y, … The pose with angle_1 gives drum radius and offset of a cable length, and the axial
    stiffness of an elastic cable. Parameters that the logs do not determine keep the values of the
    robot, and the table says why. `cablebot dlcc` takes robot.toml as --robot and uncertainty.json
    as --uncertainty. With the extra plot, torques.png and lengths.png show the residuals.

    Examples:

    cablebot identify 1kg.csv 5kg.csv --robot my.toml --out identified

    cablebot identify motion.csv --robot my.toml --payload 2 --out identified
    """
    from cablebot_gym.robots import find_robot
    from cablebot_gym.task import to_jsonable
    from cablebot_gym.utils.checks import number
    from cablebot_gym.utils.files import atomic_write_text, check_writable_dir
    from cablebot_winches.identification import identify, read_log
    from cablebot_winches.robot_file import to_toml

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
    say(f"wrote {', '.join([*FILES, *_figures(result, out)])} to {out}")


def _figures(result: Identification, folder: Path) -> list[str]:
    """Writes the figures, and returns their names: none without matplotlib."""
    from cablebot_gym.plotting.figures import DPI, import_matplotlib
    from cablebot_gym.utils.files import atomic_write
    from cablebot_winches.identification.figures import draw_identification

    try:
        import_matplotlib()
    except ImportError as error:
        say(f"wrote no figures: {error}")
        return []
    names = []
    for name, figure in draw_identification(result).items():
        names.append(f"{name}.png")
        save = partial(figure.savefig, dpi=DPI, format="png")
        atomic_write(folder / names[-1], save)
    return names


def _json(data: object) -> str:
    return json.dumps(data, indent=1, ensure_ascii=False) + "\n"


def _rows(result: Identification) -> list[list[str]]:
    """Header and rows of the estimates."""
    from cablebot_winches.identification.regression import CONFIDENCE
    from cablebot_winches.identification.result import shown_unit, unit_of

    confidence = f"{100 * CONFIDENCE:g} % interval"
    rows = [["parameter", "motors", "value", confidence, "unit", "determined"]]
    for item in result.estimates:
        unit, factor = shown_unit(unit_of(item.name))
        value = "–"
        interval = "–"
        if not math.isnan(item.value):
            value, low, high = _texts(factor * item.value, factor * item.half_width)
            interval = f"{low} to {high}"
        motors = ", ".join(str(motor + 1) for motor in item.motors)
        determined = "yes"
        if item.reason:
            determined = f"not determined: {item.reason}"
        rows.append([item.name, motors, value, interval, unit, determined])
    return rows


def _texts(value: float, half_width: float) -> tuple[str, str, str]:
    """A value and both ends of its interval with as many decimals as they need: two digits of the
    half width, and at least four of the value."""
    if not math.isfinite(half_width):
        return f"{value:.4g}", "−∞", "∞"
    first = math.floor(math.log10(max(abs(value), half_width, 1e-12)))
    last = first - 3
    if half_width > 0:
        last = min(last, math.floor(math.log10(half_width)) - 1)
    form = f".{max(0, -last)}f"
    if first < -3:
        form = f".{first - last + 1}g"
    return f"{value:{form}}", f"{value - half_width:{form}}", f"{value + half_width:{form}}"


def _residual_lines(result: Identification) -> list[str]:
    """Lines with the residuals."""
    from cablebot_winches.identification.result import shown_unit

    lines = []
    for item in result.responses:
        unit, factor = shown_unit(item.unit)
        text = f"residual   {item.equation}: {factor * item.rms:.3g} {unit} RMS"
        if item.unit != "m":
            text += f", {item.rms / item.measured_rms:.1%} of the measured RMS"
        lines.append(text)
    return lines
