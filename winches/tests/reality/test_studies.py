"""Studies of synthetic logs, whose results are known."""

import csv
import io
import itertools
from dataclasses import replace
from zipfile import ZipFile

import numpy as np
import pytest
from numpy.testing import assert_allclose
from reality.synthetic import csv_text, sagging
from scipy.spatial.transform import Rotation

from cablebot_gym.physics.textbook import cable_lengths, locked_modes
from cablebot_gym.robots import find_robot
from cablebot_winches.reality import gch_klaus, innopolis, irma, ttk4900
from cablebot_winches.reality.comparison import LogComparison, table

# --- ttk4900 --------------------------------------------------------------------------------------

MASS_CURRENT = 4.0
"""Current of gravity [A]."""

FRICTION = 0.15
"""Friction over gravity."""

PEAK = 3.0
"""Current of the accelerations [A]."""


def lift(rng, speed, *, lifting, winch=1, attempts=((1.0, 3.0),)):
    """A log with one or more runs of a factor of the load and a duration [s], between rests."""
    still = np.zeros(30)
    holding = np.full(30, -MASS_CURRENT)
    ramp = np.linspace(0, 1, 8)
    velocities = [still]
    currents = [holding]
    direction = 1 if lifting else -1
    for load, duration in attempts:
        profile = np.concatenate([ramp, np.ones(int(duration / 0.03)), ramp[::-1]])
        steady = load * MASS_CURRENT * (1 + direction * FRICTION)
        current = np.full(len(profile), -steady)
        current[:10] -= PEAK
        current[-10:] += PEAK
        velocities += [direction * speed * profile, still]
        currents += [current, holding]
    velocity = np.concatenate(velocities)
    samples = len(velocity)
    noise = 0.04 * speed * rng.standard_normal(samples)
    rows = np.full((samples, 13), np.nan)
    rows[:, 0] = 0.03 * np.arange(samples)
    rows[:, 5 + winch] = velocity + noise
    rows[:, 9 + winch] = np.concatenate(currents)
    rows[::50, 9 + winch] = np.nan
    return csv_text(rows, "time" + 12 * ",column")


@pytest.mark.parametrize("speed", [0.5, 4.0])
def test_friction_of_a_synthetic_lift_is_recovered(speed):
    """Neither accelerations nor an earlier attempt with another load count."""
    rng = np.random.default_rng(0)
    currents = []
    for lifting in (True, False):
        log = lift(rng, speed, lifting=lifting, attempts=((0.6, 3.0), (1.0, 2.0)))
        currents.append(ttk4900.steady_current(log, 1, speed, lifting=lifting))
    up, down = currents
    measured = ttk4900.Lift(weight=1, winch=1, speed=speed, up=up, down=down)
    assert measured.friction == pytest.approx(FRICTION, abs=1e-6)
    assert measured.mean == pytest.approx(MASS_CURRENT)


def test_log_without_a_steady_run_is_refused():
    log = lift(np.random.default_rng(0), 2.0, lifting=True)
    with pytest.raises(ValueError, match=r"no steady run at 2\.5 rev/s"):
        ttk4900.steady_current(log, 1, 2.5, lifting=True)


def test_friction_of_the_model_is_that_of_its_winches():
    robot = find_robot("ttk4900")
    speed = 25.0
    weight = 5.0
    gravity_torque = weight * 9.81 * 0.02
    friction = robot.coulomb_friction[0] + robot.damping[0] * speed
    friction += robot.load_friction[0] * gravity_torque
    expected = friction / gravity_torque
    assert ttk4900.model_friction(robot, weight, 0, speed) == pytest.approx(expected, rel=1e-3)


def lifts_of(robot, *, hook=0.0, level=1.0, friction_factor=1.0):
    """Lifts whose currents are in proportion to the masses with a hook [kg]. Winch 3 needs another
    level of currents and has another friction with the large weight."""
    lifts = []
    for weight, winches in ttk4900.WINCHES.items():
        for winch, speed in itertools.product(winches, (3.0, 12.0, 25.0)):
            mass = weight + hook
            friction = ttk4900.model_friction(robot, mass, winch, speed)
            if winch == 3:
                mass *= level
                friction *= friction_factor
            up, down = mass * (1 + friction), mass * (1 - friction)
            lift = ttk4900.Lift(weight=weight, winch=winch, speed=speed, up=up, down=down)
            lifts.append(lift)
    return lifts


@pytest.mark.parametrize(
    ("level", "friction_factor", "is_held"),
    [(1.015, 1.0, True), (1.04, 1.0, False), (1.0, 0.5, False), (1.0, 1.5, False)],
)
def test_winch_is_predicted_from_the_others(level, friction_factor, is_held):
    """The currents hold their goal neither with half nor with one and a half times the friction."""
    robot = find_robot("ttk4900")
    lifts = lifts_of(robot, level=level, friction_factor=friction_factor)
    rows = {item.quantity: item for item in ttk4900.predictions(robot, lifts)}
    friction = rows["friction over gravity, 5 kg, winch 3 from the others"]
    assert friction.deviation == pytest.approx(1 / friction_factor - 1, abs=1e-3)
    current = rows["largest deviation of the currents, 5 kg, winch 3 from the others"]
    assert current.held == is_held
    if friction_factor == 1:
        assert current.robot == pytest.approx(1 - 1 / level, abs=1e-4)


def test_fit_with_the_hook_has_the_friction_of_lifts_with_a_hook():
    """The masses without it make the constant friction too small."""
    robot = find_robot("ttk4900")
    lifts = lifts_of(robot, hook=0.23)
    hook = ttk4900._hook(lifts)
    assert hook == pytest.approx(0.23, abs=1e-3)
    hooked = [replace(lift, hook=hook) for lift in lifts]
    name = "coulomb_friction"
    truth = robot.coulomb_friction[0]
    assert ttk4900.fitted_friction(robot, hooked)[name].value == pytest.approx(truth, rel=0.01)
    assert ttk4900.fitted_friction(robot, lifts)[name].value < 0.9 * truth
    assert "would change by +0.00" in ttk4900._hook_effect(robot, lifts, hooked)


# --- gch-klaus ------------------------------------------------------------------------------------

SHIFT = 1.234
"""Clock shift [s]."""

FRAME = (0.05, -1.2, 0.3)
"""Pose of the frame in the capture."""

CORNERS = [(-0.0656, -0.06), (-0.0656, 0.06), (0.0656, 0.06), (0.0656, -0.06)]
"""Corners of the markers' rectangle [m]."""


def drawn(time):
    """Poses in the frame at times [s]."""
    time = np.maximum(time, 0.0)
    x = 0.7 * np.sin(0.9 * time)
    y = 0.5 * np.sin(0.7 * time + 1)
    angle = 0.1 * np.sin(0.4 * time)
    return np.stack([x, y, angle], axis=1)


def rotated(x, y, angle):
    cosine = np.cos(angle)
    sine = np.sin(angle)
    return cosine * x - sine * y, sine * x + cosine * y


def capture_text(time, pose):
    """An OptiTrack export with z to the right and y up. Some samples exchange names of markers."""
    frame_x, frame_y, frame_angle = FRAME
    x, y, angle = pose.T
    x, y = rotated(x, y, frame_angle)
    columns = [np.arange(len(time)), time]
    for corner_x, corner_y in CORNERS:
        marker_x, marker_y = rotated(corner_x, corner_y, angle + frame_angle)
        right = frame_x + x + marker_x
        up = -(frame_y + y + marker_y)
        columns += [np.zeros(len(time)), up, right]
    rows = np.column_stack(columns)
    rows[5::40, 2:] = np.roll(rows[5::40, 2:], 6, axis=1)
    names = ["", ""]
    for marker in range(1, 5):
        names += 3 * [f"Rigid Body 2_{marker}"]
    head = io.StringIO()
    csv.writer(head).writerows([["Format"], [], ["", ""], names, [], [], []])
    return head.getvalue().encode() + csv_text(rows)


def log_text(position, lengths):
    lines = ["START"]
    for (x, y), row in zip(position, lengths, strict=True):
        cables = "\t|\t".join(f"0 8 {-length:.6f} 0.0" for length in row)
        lines.append(f"2: {x:.6f} {y:.6f} - 0.0 0.0\t|\t{cables}\t|\t0")
    return "\n".join(lines).encode()


def klaus(size=(1.0, 1.0), scale=(1.06, 1.05, 1.07, 1.06)):
    """Results by quantity of a robot whose frame has a relative size, and its cables scales."""
    robot = find_robot("gch-klaus")
    time = 0.01 * np.arange(1600)
    pose = drawn(time)
    base = [tuple(row) for row in robot.base * size]
    lengths = cable_lengths(robot.replace(base_anchors=base), pose)
    logged = scale * lengths + [0.1, -0.2, 0.3, 0.0]
    estimated_position = pose[:, :2] * [1, -1] + [1.4, 1.1]
    capture = np.arange(0, 20, 1 / 120)
    logs = {
        f"{gch_klaus.LOG}.txt": log_text(estimated_position, logged),
        f"{gch_klaus.LOG}.csv": capture_text(capture, drawn(capture - SHIFT)),
    }
    comparisons = gch_klaus.validate(logs).comparisons
    return {item.quantity: item for item in comparisons}


def test_lengths_calibrated_on_one_half_hold_on_the_other():
    """Clock, pose of the frame, and offset and scale of each cable are found."""
    results = klaus()
    assert results["RMS of cable lengths, offset per cable"].robot > 0.01
    calibrated = results["RMS of cable lengths, offset and scale per cable"]
    assert calibrated.robot < 2e-4
    assert calibrated.held


def test_samples_are_judged_by_the_fit_without_them():
    """One that saw them would hide an overfit."""
    halves = []
    for value in (1.0, 2.0):
        error = np.full((250, 4), value)
        halves.append(gch_klaus.Calibration(size=np.ones(2), scale=np.ones(4), error=error))
    judged = gch_klaus.errors_of_unseen_half(halves)
    even = np.arange(250) // 100 % 2 == 0
    assert (judged[even] == 2.0).all()
    assert (judged[~even] == 1.0).all()


def test_other_size_of_the_frame_is_found():
    results = klaus(size=(0.96, 0.93), scale=4 * [1.06])
    assert not results["RMS of cable lengths, offset and scale per cable"].held
    assert results["RMS of cable lengths, the same and size of the frame"].robot < 2e-4
    fitted = [results[f"{side} of the frame, fitted"].robot for side in ("width", "height")]
    sides = np.ptp(find_robot("gch-klaus").base, axis=0)
    assert_allclose(fitted, [0.96, 0.93] * sides, rtol=2e-3)
    assert results["drum radius, fitted"].robot == pytest.approx(0.0127 / 1.06, rel=1e-3)


# --- irma -----------------------------------------------------------------------------------------


def bifilar(turn):
    """Configuration of two horizontal pulleys and a platform below, and a pose, in a turned world
    with z up."""
    actuators = []
    for x in (-0.5, 0.6):
        pulley = {
            "radius": 0.02,
            "pos_OD_glob": turn @ [x, 0.1, 0.5],
            "vers_k": turn @ [np.sign(x), 0.0, 0.0],
        }
        winch = {"pos_PA_loc": [0.3 * x, 0.02, 0.2]}
        actuators.append({"active": True, "pulley": pulley, "winch": winch})
    actuators.insert(1, {"active": False})
    platform = {
        "mass": 2.0,
        "inertia_mat_G_loc": np.diag([0.02, 0.03, 0.04]),
        "pos_PG_loc": [0.01, 0.0, 0.05],
        "gravity_axis": turn @ [0.0, 0.0, 1.0],
    }
    position = turn @ [0.02, 0.0, -0.9]
    attitude = turn @ Rotation.from_euler("XYZ", [0.05, -0.02, 0.1]).as_matrix()
    angles = Rotation.from_matrix(attitude).as_euler("XYZ")
    configuration = {"actuator": actuators, "platform": platform}
    return configuration, np.append(position, angles)


def test_frequencies_do_not_depend_on_the_frame():
    """Frames of motion capture are not level: gravity is along an axis of the configuration."""
    frequencies = []
    for angles in ([0.0, 0.0, 0.0], [0.3, -0.2, 0.4]):
        turn = Rotation.from_euler("XYZ", angles).as_matrix()
        robot = irma.hanging_robot(*bifilar(turn))
        modes, _ = locked_modes(robot, robot.mass, *irma.at_rest(robot))
        frequencies.append(modes)
    level, inclined = frequencies
    assert_allclose(level, inclined, rtol=1e-9)
    pendulum = np.sqrt(9.81 / 1.3) / (2 * np.pi)
    assert_allclose(level[0], pendulum, rtol=0.15)


def test_numbers_of_a_workbook_are_read():
    space = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    rows = '<row><c r="A1"><v>1.5</v></c><c r="B1"><v>-2e-3</v></c></row><row/>'
    workbook = io.BytesIO()
    with ZipFile(workbook, "w") as file:
        file.writestr("xl/worksheets/sheet1.xml", f'<worksheet xmlns="{space}">{rows}</worksheet>')
    assert irma.read_table(workbook.getvalue()) == [[1.5, -2e-3], []]


# --- innopolis ------------------------------------------------------------------------------------


def test_linear_sag_is_recovered_without_copied_rows():
    validation = innopolis.validate(sagging(copied=[3, 7, 20]))
    results = {item.quantity: item.robot for item in validation.comparisons}
    assert results["sag per load, mean"] == pytest.approx(1.5e-3)
    assert results["deviation from a line, RMS over the largest sag"] == pytest.approx(0, abs=1e-9)
    assert results["sag per load with the repeated rows, mean"] < 1.45e-3
    assert validation.notes[0].startswith("3 of the 50 points")


def test_bent_sag_is_not_linear():
    heights = np.array([[1.0, 1.1], [0.95, 1.05], [0.95, 1.05]])
    assert innopolis.fit_line(heights).nonlinearity > innopolis.GOAL


# --- comparison -----------------------------------------------------------------------------------


def test_goal_bounds_the_deviation_or_the_value_itself():
    """Without a value of the model the robot's value is a deviation."""
    near = LogComparison(quantity="a", unit="1", model=0.22, robot=0.2, goal=0.11)
    far = LogComparison(quantity="b", unit="1", model=0.22, robot=0.2, goal=0.09)
    error = LogComparison(quantity="c", unit="m", robot=0.006, goal=0.005)
    shown = LogComparison(quantity="d", unit="m", model=1.0, robot=1.0)
    assert [item.held for item in (near, far, error, shown)] == [True, False, False, None]
    assert table([error])[1] == ["c", "–", "6 mm", "–", "5 mm", "no"]
