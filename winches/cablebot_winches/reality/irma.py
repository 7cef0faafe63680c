"""Natural frequencies of a platform that hangs on two, three or four cables, IRMA L@B of the
University of Bologna.

The platform swings with locked motors at many poses. The poses at rest and the geometry of pulleys
and platform give the frequencies of the model; nothing is fitted.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree
from zipfile import ZipFile

import numpy as np
from scipy.io import loadmat
from scipy.optimize import root
from scipy.spatial.transform import Rotation

from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Motors, Robot, Transmission
from cablebot_gym.utils.palette import BLUE, GREEN, GREY, VERMILLION
from cablebot_winches.reality.comparison import LogComparison, Validation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EXPERIMENTS = {2: range(48, 60), 3: range(36, 48), 4: range(36)}
"""Indices of the experiments by the number of cables."""

FREQUENCIES = "data/Robot_Nat_Freq/f_exp_mean.xlsx"
"""Table of the measured frequencies: a row for each experiment."""

MEAN_GOAL = 0.03
"""Largest mean of the relative deviations of the frequencies."""

WORST_GOAL = 0.08
"""Largest relative deviation of a frequency."""

_TURNED = np.diag([1.0, -1.0, -1.0])
"""Rotation from a frame with z up to one with z down."""

# Motors have no effect on modes with locked motors, and cables that end in drums need some.
_MOTORS = Motors(stall_torque=1.0, free_speed=10.0)
_TRANSMISSION = Transmission(pulley_radius=0.02, pulley_inertia=1e-4)


@dataclass(frozen=True, kw_only=True, eq=False)
class Swing:
    """Frequencies of one experiment, each (6 − m,) [Hz]."""

    cables: int
    """Number of cables m."""
    measured: Array
    """Frequencies of the robot."""
    model: Array
    """Frequencies of the model."""
    published: Array
    """Frequencies of the authors' own model."""

    @property
    def deviations(self) -> Array:
        """Relative deviations of the model from the robot, (6 − m,)."""
        return self.model / self.measured - 1


def validate(logs: Mapping[str, bytes]) -> Validation:
    """Compares measured frequencies with those of the model."""
    measured = read_table(logs[FREQUENCIES])
    swings = []
    for cables, experiments in EXPERIMENTS.items():
        geometry = json.loads(logs[f"config/Grab_prototype_{cables}{cables}.json"])
        folder = "apps/natural_frequencies_simulator"
        poses = _cells(logs[f"{folder}/data_pStat_{cables}.mat"], "data_pStat")
        published = _cells(logs[f"{folder}/data_nat_f_{cables}.mat"], "data_nat_f")
        for index in experiments:
            robot = hanging_robot(geometry, poses[index])
            model, _ = textbook.locked_modes(robot, robot.mass, *at_rest(robot))
            swing = Swing(
                cables=cables,
                measured=np.array(measured[index][: len(model)]),
                model=model,
                published=published[index],
            )
            swings.append(swing)
    return Validation(
        comparisons=tuple(_comparisons(swings)),
        notes=(
            f"{len(swings)} poses with {sum(len(swing.model) for swing in swings)} frequencies. "
            "Nothing is fitted.",
        ),
        draw=partial(draw, swings),
    )


def hanging_robot(geometry: Mapping[str, Any], pose: Array) -> Robot:
    """The robot in a frame with z down, at home in a pose.

    Args:
        geometry: data of a configuration file of the source.
        pose: position and Tait–Bryan angles of R = Rx Ry Rz in the frame of the source, (6,)
            [m, rad].
    """
    platform = geometry["platform"]
    up = np.ravel(platform["gravity_axis"])
    upright, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])
    to_frame = _TURNED @ upright.as_matrix()
    attitude = to_frame @ Rotation.from_euler("XYZ", pose[3:]).as_matrix() @ _TURNED
    angles = Rotation.from_matrix(attitude).as_euler("ZYX")[::-1]
    base = []
    axes = []
    radii = []
    ends = []
    for actuator in geometry["actuator"]:
        if not actuator["active"]:
            continue
        pulley = actuator["pulley"]
        base.append(to_frame @ np.ravel(pulley["pos_OD_glob"]))
        axes.append(to_frame @ np.ravel(pulley["vers_k"]))
        radii.append(pulley["radius"])
        ends.append(_TURNED @ np.ravel(actuator["winch"]["pos_PA_loc"]))
    reach = 10.0  # beyond every pose
    return Robot.from_dict(
        {
            "name": "irma",
            "base_anchors": base,
            "platform_anchors": ends,
            "mass": platform["mass"],
            "inertia": _TURNED @ np.array(platform["inertia_mat_G_loc"]) @ _TURNED,
            "center_of_mass": _TURNED @ np.ravel(platform["pos_PG_loc"]),
            "swivel_radius": radii,
            "swivel_axes": axes,
            "home_pose": np.concatenate([to_frame @ pose[:3], angles]),
            "workspace": [(-reach, reach)] * 3 + [(-1.5, 1.5)] * 3,
            "motors": _MOTORS,
            "transmission": _TRANSMISSION,
        }
    )


def at_rest(robot: Robot) -> tuple[Array, Array]:
    """Pose X (n,) and tensions T (m,) [N] at rest, ``h(X) + Sᵀ T = 0``, of a platform that hangs on
    cables with the lengths of the home pose.

    Raises:
        ValueError: if it does not hang on taut cables near home.
    """
    n = robot.coordinates
    lengths = textbook.cable_lengths(robot, robot.home)
    still = np.zeros(n)
    weight = robot.mass * robot.gravity

    def errors(unknowns: Array) -> Array:
        """Unbalanced forces over the weight, and errors of the lengths; T is over the weight."""
        pose, tensions = np.split(unknowns, [n])
        forces = textbook.bias(robot, robot.mass, pose, still) / weight
        forces = forces + textbook.jacobian(robot, pose).T @ tensions
        return np.concatenate([forces, textbook.cable_lengths(robot, pose) - lengths])

    def slopes(unknowns: Array) -> Array:
        pose, tensions = np.split(unknowns, [n])
        structure = textbook.jacobian(robot, pose)
        stiffness = textbook.weight_stiffness(robot, robot.mass, pose) / weight
        stiffness += textbook.tension_stiffness(robot, pose, tensions)
        no_lengths = np.zeros((robot.cables, robot.cables))
        return np.block([[stiffness, structure.T], [structure, no_lengths]])

    forces = textbook.bias(robot, robot.mass, robot.home, still) / weight
    to_forces = -textbook.jacobian(robot, robot.home).T
    near_rest = np.append(robot.home, np.linalg.lstsq(to_forces, forces, rcond=None)[0])
    solution = root(errors, near_rest, jac=slopes, options={"xtol": 1e-13}).x
    pose, tensions = np.split(solution, [n])
    if not np.max(np.abs(errors(solution))) < 1e-9 or tensions.min() <= 0:
        raise ValueError(f"{robot.name}: the platform does not hang on taut cables near its pose")
    return pose, weight * tensions


def read_table(workbook: bytes) -> list[list[float]]:
    """Numbers in the rows of the first sheet of an .xlsx file."""
    with ZipFile(io.BytesIO(workbook)) as file:
        sheet = ElementTree.fromstring(file.read("xl/worksheets/sheet1.xml"))
    space = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"
    rows = []
    for row in sheet.iter(f"{space}row"):
        rows.append([float(value.text or "nan") for value in row.iter(f"{space}v")])
    return rows


def _cells(file: bytes, name: str) -> list[Array]:
    """Vectors in the cells of a MATLAB array, empty where there was no experiment."""
    # SciPy reads open files, too, which its types leave out.
    array = loadmat(io.BytesIO(file))[name]  # type: ignore[arg-type]
    return [np.ravel(cell.item()) for cell in array[0]]


def _comparisons(swings: Sequence[Swing]) -> list[LogComparison]:
    comparisons = []
    for cables in EXPERIMENTS:
        chosen = [swing for swing in swings if swing.cables == cables]
        deviations = np.abs(np.concatenate([swing.deviations for swing in chosen]))
        count = f"{cables} cables, {len(chosen)} poses"
        for text, value, goal in (
            ("mean", deviations.mean(), MEAN_GOAL),
            ("largest", deviations.max(), WORST_GOAL),
        ):
            comparison = LogComparison(
                quantity=f"{text} deviation of the frequencies, {count}",
                unit="1",
                robot=float(value),
                goal=goal,
            )
            comparisons.append(comparison)
    published = np.concatenate([swing.model / swing.published - 1 for swing in swings])
    largest = LogComparison(
        quantity="largest deviation from the authors' own model",
        unit="1",
        robot=float(np.abs(published).max()),
    )
    return [*comparisons, largest]


def draw(swings: Sequence[Swing]) -> Figure:
    """Draws the frequencies of the model over those of the robot, and their deviations."""
    from cablebot_gym.plotting.figures import add_legend, new_figure

    figure = new_figure(4.0)
    frequencies, deviations = figure.subplots(1, 2)
    for cables, colour in zip(EXPERIMENTS, (BLUE, VERMILLION, GREEN), strict=True):
        chosen = [swing for swing in swings if swing.cables == cables]
        measured = np.concatenate([swing.measured for swing in chosen])
        model = np.concatenate([swing.model for swing in chosen])
        frequencies.plot(measured, model, ".", color=colour, label=f"{cables} cables")
        deviations.plot(measured, 100 * (model / measured - 1), ".", color=colour)
    ends = frequencies.get_xlim()
    frequencies.plot(ends, ends, color=GREY, linewidth=0.8)
    frequencies.set(xlabel="robot [Hz]", ylabel="model [Hz]", xlim=ends, ylim=ends)
    for sign in (-1, 1):
        deviations.axhline(100 * sign * WORST_GOAL, color=GREY, linewidth=0.8)
    deviations.set(xlabel="robot [Hz]", ylabel="deviation of the model [%]")
    add_legend(figure, frequencies)
    return figure
