"""``cablebot identify``."""

from __future__ import annotations

import math
from collections.abc import Sequence
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
    same_winches: Annotated[
        bool, "All winches have the same friction and inertia, also those without a log."
    ] = False,
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
    from cablebot_gym.utils.files import atomic_write_text, check_writable_dir, json_text
    from cablebot_winches.identification import identify, read_log
    from cablebot_winches.identification.regression import CONFIDENCE
    from cablebot_winches.identification.result import motors_text
    from cablebot_winches.robot_file import to_toml

    nominal = find_robot(robot)
    number("--payload", payload, least=0, unit="kg")
    if any((out / name).exists() for name in FILES):
        raise ValueError(f"{str(out)!r} has files of an identification: choose another --out")
    result = identify(
        nominal,
        [read_log(path, nominal) for path in logs],
        payload=payload,
        same_winches=same_winches,
    )
    check_writable_dir(out)
    uncertainty = json_text(to_jsonable(result.uncertainty))
    texts = (to_toml(result.robot), uncertainty, result.to_json())
    for name, text in zip(FILES, texts, strict=True):
        atomic_write_text(out / name, text)
    if as_json:
        print(result.to_json(), end="")
    else:
        rows, notes = _rows(result)
        confidence = f"{100 * CONFIDENCE:g} % intervals"
        print_table(f"{nominal.name}: identified parameters, {confidence}", rows)
        print("\n".join([*notes, *_residual_lines(result)]))
    if result.unknown_motors:
        remedy = "they keep the values of the robot. If the winches are equal, add --same-winches"
        say(f"{motors_text(result.unknown_motors)}: no log; {remedy}")
    for question in result.questions:
        say(f"question: {question}")
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


def _rows(result: Identification) -> tuple[list[list[str]], list[str]]:
    """Header and rows of the estimates, one line each, and the notes to which they refer."""
    from cablebot_winches.identification.result import shown_unit, unit_of

    rows = [["parameter", "motor", "value", "±", "unit", "determined"]]
    notes: dict[str, int] = {}
    for item in result.estimates:
        unit, factor = shown_unit(unit_of(item.name))
        value = half_width = "–"
        if not math.isnan(item.value):
            value, half_width = _texts(factor * item.value, factor * item.half_width)
        determined = "yes"
        note = item.reason
        if item.reason:
            determined = "no"
        elif item.given:
            determined = "given"
            note = f"given {item.given}"
        if note:
            determined += f" ({notes.setdefault(note, len(notes) + 1)})"
        rows.append([item.name, _motors(item.motors), value, half_width, unit, determined])
    return rows, [f"({number}) {note}" for note, number in notes.items()]


def _motors(motors: Sequence[int]) -> str:
    """Numbers of motors, such as ``1–4`` or ``1, 3``."""
    first, last = motors[0] + 1, motors[-1] + 1
    if last - first == len(motors) - 1 > 0:
        return f"{first}–{last}"
    return ", ".join(str(motor + 1) for motor in motors)


def _texts(value: float, half_width: float) -> tuple[str, str]:
    """A value and the half width of its interval with as many decimals as they need: two digits of
    the half width, and at least four of the value."""
    if not math.isfinite(half_width):
        return f"{value:.4g}", "∞"
    first = math.floor(math.log10(max(abs(value), half_width, 1e-12)))
    last = first - 3
    if half_width > 0:
        last = min(last, math.floor(math.log10(half_width)) - 1)
    form = f".{max(0, -last)}f"
    if first < -3:
        form = f".{first - last + 1}g"
    return f"{value:{form}}", f"{half_width:.2g}"


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
