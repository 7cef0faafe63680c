"""The reference motions against the paper's tables, symbolic differentiation, and the rules of the protocol."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pytest
import sympy
from hypothesis import given
from hypothesis import strategies as st

from cablebot_gym.robots import ROBOTS
from cablebot_gym.trajectories import (
    KINDS,
    TRAJECTORIES,
    Dwell,
    Lemniscate,
    PaperCircle,
    PointToPoint,
    Reference,
    SmoothCircle,
    Trajectory,
    find_trajectory,
    trajectory_names,
)

NAMES = list(TRAJECTORIES)
SMOOTH = [name for name in NAMES if not name.startswith("paper")]
ORDERS = ("position", "velocity", "acceleration", "jerk", "snap")
POSE = (0.02, -0.03, 0.12, 0.01, -0.02, 0.03)


def stacked(reference: Reference) -> np.ndarray:
    return np.stack([getattr(reference, order) for order in ORDERS])


# --- the paper's tables -------------------------------------------------------------------------------------------


def table(t: float, radius: float) -> tuple[float, float]:
    """Tables 1 and 3 as printed."""
    if t <= 0.5:
        return radius * np.cos(4 * np.pi * (t**2)), radius * np.sin(4 * np.pi * (t**2))
    return radius * np.cos(4 * np.pi * ((-t + 1) ** 2)), -radius * np.sin(4 * np.pi * ((-t + 1) ** 2))


@pytest.mark.parametrize(
    ("name", "radius", "rest"), [("paper-planar", 0.2165, []), ("paper-spatial", 0.1, [0.1, 0.1, 0.1, 0.1])]
)
def test_paper_circle_is_not_another_curve_than_the_table(name: str, radius: float, rest: list[float]) -> None:
    times = np.linspace(0, 1, 501)
    expected = [[*table(t, radius), *rest] for t in times]
    np.testing.assert_allclose(TRAJECTORIES[name]()(times).position, expected, rtol=0, atol=1e-15)


@given(duration=st.floats(1e-2, 1e2))
def test_second_branch_does_not_hold_at_exactly_half_time(duration: float) -> None:
    """The tangential acceleration at (−R, 0) is along −y while speeding up, along +y while slowing down."""
    motion = PaperCircle(radius=0.3, center=(0.0, 0.0), duration=duration)
    just_after = np.nextafter(duration / 2, duration) * (1 + 1e-15)
    jump = 0.3 * 8 * np.pi / duration**2
    at, after = motion(duration / 2).acceleration[1], motion(just_after).acceleration[1]
    np.testing.assert_allclose([at, after], [-jump, jump], rtol=1e-9)


def test_jump_at_half_time_is_of_acceleration_and_not_of_position_or_velocity() -> None:
    motion = TRAJECTORIES["paper-spatial"]()
    at, after = motion(0.5), motion(np.nextafter(0.5, 1))
    np.testing.assert_allclose(at.position, after.position, atol=1e-12)
    np.testing.assert_allclose(at.velocity, after.velocity, atol=1e-12)
    np.testing.assert_allclose(after.acceleration - at.acceleration, [0, 1.6 * np.pi, 0, 0, 0, 0], atol=1e-9)


# --- the derivatives, against sympy -------------------------------------------------------------------------------

T = sympy.Symbol("t", real=True)
V = sympy.Symbol("v", real=True)


def symbolic_blend(duration: sympy.Expr) -> sympy.Expr:
    """C⁴ with the fewest powers: the integral of v⁴(1 − v)⁴, normalised."""
    rise = sympy.integrate(sympy.expand(V**4 * (1 - V) ** 4), V)
    return (rise / rise.subs(V, 1)).subs(V, T / duration)


def circle(radius: float, center: tuple[float, ...], angle: sympy.Expr) -> list[Any]:
    return [center[0] + radius * sympy.cos(angle), center[1] + radius * sympy.sin(angle), *center[2:]]


DURATION = sympy.Rational(17, 10)
TURN = 2 * sympy.pi * symbolic_blend(DURATION)
END = tuple(-2 * value + 0.1 for value in POSE)
EARLY, LATE = (0.0, 0.85), (0.86, 1.7)
SYMBOLIC: dict[str, tuple[Trajectory, list[Any], tuple[float, float]]] = {
    "paper, first half": (
        PaperCircle(radius=0.3, center=POSE, duration=1.7),
        circle(0.3, POSE, 4 * sympy.pi * (T / DURATION) ** 2),
        EARLY,
    ),
    "paper, second half": (
        PaperCircle(radius=0.3, center=POSE, duration=1.7),
        circle(0.3, POSE, -4 * sympy.pi * (1 - T / DURATION) ** 2),
        LATE,
    ),
    "circle": (SmoothCircle(radius=0.3, center=POSE, duration=1.7), circle(0.3, POSE, TURN), (0.0, 1.7)),
    "dwell": (Dwell(pose=POSE, duration=1.7), list(POSE), (0.0, 1.7)),
    "line": (
        PointToPoint(start=POSE, end=END, duration=1.7),
        [a + (b - a) * symbolic_blend(DURATION) for a, b in zip(POSE, END, strict=True)],
        (0.0, 1.7),
    ),
    "lemniscate": (
        Lemniscate(amplitude=(0.3, 0.2), center=POSE, duration=1.7),
        [POSE[0] + 0.3 * sympy.sin(TURN), POSE[1] + 0.2 * sympy.sin(2 * TURN), *POSE[2:]],
        (0.0, 1.7),
    ),
}


@pytest.mark.parametrize("order", range(5), ids=ORDERS)
@pytest.mark.parametrize("case", SYMBOLIC)
def test_derivatives_are_not_off_from_symbolic_ones(case: str, order: int) -> None:
    motion, formula, (first, last) = SYMBOLIC[case]
    times = np.linspace(first, last, 41)
    expected = [sympy.lambdify(T, sympy.diff(component, T, order) + 0 * T, "numpy")(times) for component in formula]
    expected = np.stack([np.broadcast_to(component, times.shape) for component in expected], axis=-1)
    computed = getattr(motion(times), ORDERS[order])
    np.testing.assert_allclose(computed, expected, rtol=0, atol=1e-10 * max(1.0, np.abs(expected).max()))


@given(duration=st.floats(0.05, 50), fraction=st.floats(0, 1), name=st.sampled_from(NAMES))
def test_duration_does_not_change_the_path_and_scales_each_derivative(
    duration: float, fraction: float, name: str
) -> None:
    unit, stretched = TRAJECTORIES[name](duration=1.0), TRAJECTORIES[name](duration=duration)
    time = fraction * duration
    expected = stacked(unit(time / duration)) / duration ** np.arange(5)[:, None]
    scale = np.abs(stacked(unit(np.linspace(0, 1, 101)))).max(axis=(1, 2)) / duration ** np.arange(5)
    error = np.abs(stacked(stretched(time)) - expected).max(axis=1)
    assert np.all(error <= 1e-9 * scale)


# --- the ends -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SMOOTH)
def test_smooth_motions_have_no_jump_up_to_snap_at_either_end(name: str) -> None:
    motion = TRAJECTORIES[name]()
    peak = np.abs(stacked(motion(np.linspace(0, motion.duration, 201)))).max(axis=(1, 2))
    edge = 1e-6 * motion.duration
    for outside, inside in ((0.0, edge), (2 * motion.duration, motion.duration - edge)):
        jump = np.abs(stacked(motion(inside)) - stacked(motion(outside))).max(axis=1)
        assert np.all(jump <= 1e-4 * peak)
        assert np.all(np.abs(stacked(motion(outside))[1:]) == 0)


@pytest.mark.parametrize(
    ("motion", "first", "last"),
    [
        (SmoothCircle(radius=0.3, center=(0.1, 0.2)), (0.4, 0.2), (0.4, 0.2)),
        (PaperCircle(radius=0.3, center=(0.1, 0.2)), (0.4, 0.2), (0.4, 0.2)),
        (PointToPoint(start=(0.1, 0.2), end=(-0.3, 0.5)), (0.1, 0.2), (-0.3, 0.5)),
        (Lemniscate(amplitude=(0.3, 0.1), center=(0.1, 0.2)), (0.1, 0.2), (0.1, 0.2)),
        (Dwell(pose=(0.1, 0.2)), (0.1, 0.2), (0.1, 0.2)),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_motion_starts_and_ends_nowhere_else(motion: Trajectory, first: tuple[float], last: tuple[float]) -> None:
    np.testing.assert_allclose(motion([0.0, motion.duration]).position, [first, last], atol=1e-12)


def test_smooth_circle_does_not_turn_the_other_way_than_the_papers() -> None:
    for motion in (TRAJECTORIES["circle-planar"](), TRAJECTORIES["paper-planar"]()):
        x, y = motion(motion.duration * np.array([0.35, 0.5, 0.65])).position.T
        assert y[0] > 0 > y[2]
        assert x[1] == pytest.approx(-0.2165)


@pytest.mark.parametrize("name", NAMES)
def test_reference_does_not_move_or_push_after_its_duration(name: str) -> None:
    motion = TRAJECTORIES[name]()
    after = motion([np.nextafter(motion.duration, np.inf), motion.duration + 7.0, np.inf])
    for position in after.position:
        np.testing.assert_array_equal(position, motion(motion.duration).position)
    assert not stacked(after)[1:].any()


def test_last_instant_is_not_already_the_rest_after_it() -> None:
    """The paper's circle still brakes at t = 1 s, with −8π rad/s² at (R, 0)."""
    np.testing.assert_allclose(TRAJECTORIES["paper-planar"]()(1.0).acceleration, [0, -0.2165 * 8 * np.pi], atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_time_before_zero_does_not_extrapolate(name: str) -> None:
    motion = TRAJECTORIES[name]()
    np.testing.assert_array_equal(stacked(motion(-0.3)), stacked(motion(0.0)))


# --- scalars and arrays -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_batches_of_times_do_not_differ_from_single_times(name: str) -> None:
    motion = TRAJECTORIES[name]()
    times = motion.duration * np.array([[-0.5, 0.0, 0.2], [0.5, 1.0, 1.5]])
    batch, listed = stacked(motion(times)), stacked(motion(times.tolist()))
    assert batch.shape == (5, 2, 3, motion.coordinates)
    np.testing.assert_array_equal(batch, listed)
    for index in np.ndindex(times.shape):
        single = stacked(motion(float(times[index])))
        assert single.shape == (5, motion.coordinates)
        np.testing.assert_allclose(batch[:, *index], single, rtol=1e-14, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_writing_into_a_reference_does_not_change_the_motion(name: str) -> None:
    motion = TRAJECTORIES[name]()
    before = stacked(motion(0.1))
    reference = motion(0.1)
    for order in ORDERS:
        getattr(reference, order)[:] = 9.0
    np.testing.assert_array_equal(stacked(motion(0.1)), before)


# --- fields -------------------------------------------------------------------------------------------------------

CHANGES = [
    (PaperCircle(radius=0.1, center=POSE), {"radius": 0.2, "center": END, "duration": 1.5}),
    (SmoothCircle(radius=0.1, center=POSE), {"radius": 0.2, "center": END, "duration": 1.5}),
    (Dwell(pose=POSE), {"pose": END}),
    (PointToPoint(start=POSE, end=END), {"start": POSE[::-1], "end": POSE[::-1], "duration": 1.5}),
    (
        Lemniscate(amplitude=(0.1, 0.1), center=POSE),
        {"amplitude": (0.1, 0.2), "center": END, "duration": 1.5},
    ),
]


@pytest.mark.parametrize(
    ("motion", "field", "value"),
    [(motion, field, value) for motion, changes in CHANGES for field, value in changes.items()],
    ids=lambda value: getattr(value, "name", value) if not isinstance(value, tuple) else "",
)
def test_no_field_is_without_effect(motion: Any, field: str, value: Any) -> None:
    changed = dataclasses.replace(motion, **{field: value})
    assert not np.allclose(changed(0.3).position, motion(0.3).position, atol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_duration_is_not_ignored_when_a_name_is_given_with_one(name: str) -> None:
    assert find_trajectory({"name": name, "duration": 0.37}, TRAJECTORIES[name]().coordinates).duration == 0.37


@pytest.mark.parametrize(("motion", "_"), CHANGES, ids=lambda value: getattr(value, "name", ""))
def test_motions_cannot_be_changed_by_assignment(motion: Any, _: Any) -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        motion.duration = 3.0


# --- the registry -------------------------------------------------------------------------------------------------


def test_registry_has_no_name_missing() -> None:
    kinds = ["paper", "circle", "dwell", "line", "lemniscate", "loop"]
    assert trajectory_names(2) == [f"{kind}-planar" for kind in kinds]
    assert trajectory_names(6) == [f"{kind}-spatial" for kind in kinds]
    assert sorted(trajectory_names()) == sorted(trajectory_names(2) + trajectory_names(6))


@pytest.mark.parametrize("name", NAMES)
def test_registered_object_is_not_under_another_name_or_kind(name: str) -> None:
    motion = TRAJECTORIES[name]()
    assert isinstance(motion, Trajectory)
    assert motion.name == name
    assert name.endswith(KINDS[motion.coordinates])
    assert find_trajectory(name, motion.coordinates) == motion


@pytest.mark.parametrize("name", NAMES)
def test_default_motion_does_not_leave_the_triangle_or_the_workspace(name: str) -> None:
    motion = TRAJECTORIES[name]()
    robot = ROBOTS[KINDS[motion.coordinates]]
    path = motion(np.linspace(0, motion.duration, 201)).position
    assert np.all((path >= robot.pose_bounds[0]) & (path <= robot.pose_bounds[1]))
    corners = np.unique(robot.base[:, :2].round(12), axis=0)
    inradius = np.linalg.norm(corners, axis=1).max() / 2
    assert np.all(path[:, :2] @ -corners.T / (2 * inradius) < inradius - 0.05)  # 5 cm inside each side
    if not robot.planar:
        assert np.all(path[:, 2] >= 0.05)


@pytest.mark.parametrize("name", ["line-planar", "line-spatial"])
def test_no_coordinate_of_the_default_line_stands_still(name: str) -> None:
    motion = TRAJECTORIES[name]()
    first, last = motion([0.0, motion.duration]).position
    assert np.all(np.abs(last - first) >= 0.04)


@pytest.mark.parametrize("name", NAMES)
def test_json_data_do_not_give_another_motion_than_the_fields(name: str) -> None:
    motion: Any = TRAJECTORIES[name](duration=1.25)
    data = json.loads(json.dumps(dataclasses.asdict(motion)))
    assert find_trajectory(data, motion.coordinates) == motion
    assert hash(find_trajectory(data, motion.coordinates)) == hash(motion)


def test_finding_does_not_change_the_callers_dict() -> None:
    data = {"name": "circle-spatial", "duration": 1.5}
    find_trajectory(data, 6)
    assert data == {"name": "circle-spatial", "duration": 1.5}


def test_added_factory_is_not_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TRAJECTORIES, "mine", lambda height=0.2: Dwell(name="mine", pose=(0, 0, height, 0, 0, 0)))
    assert trajectory_names(6)[-1] == "mine"
    assert "mine" not in trajectory_names(2)
    assert find_trajectory({"name": "mine", "height": 0.3}, 6)(0.0).position[2] == 0.3
    with pytest.raises(ValueError, match=r"its fields are height$"):
        find_trajectory({"name": "mine", "hight": 0.3}, 6)


class Drift:
    """A user's motion: no dataclass, no base class."""

    name = "drift"
    coordinates = 2

    def __init__(self, duration: float = 1.0) -> None:
        self.duration = duration

    def __call__(self, times: Any) -> Reference:
        zero = np.zeros((*np.shape(times), 2))
        return Reference(position=zero, velocity=zero, acceleration=zero, jerk=zero, snap=zero)


def test_users_object_is_not_replaced_or_refused() -> None:
    motion = Drift()
    assert find_trajectory(motion, 2) is motion


# --- errors -------------------------------------------------------------------------------------------------------

SPATIAL_CHOICES = (
    "choose one of paper-spatial, circle-spatial, dwell-spatial, line-spatial, lemniscate-spatial, loop-spatial$"
)


@pytest.mark.parametrize(
    ("trajectory", "coordinates", "message"),
    [
        ("fall", 6, f"unknown trajectory 'fall'; {SPATIAL_CHOICES}"),
        ("circle-planar", 6, f"'circle-planar' is not for 6 coordinates; {SPATIAL_CHOICES}"),
        ({"name": "circle-planar", "center": POSE}, 6, f"not for 6 coordinates; {SPATIAL_CHOICES}"),
        (Drift(), 6, f"'drift' has 2 coordinates and the robot has 6; {SPATIAL_CHOICES}"),
        ({"name": "dwell-spatial", "pose": [0, 0]}, 6, f"has 2 coordinates and the robot has 6; {SPATIAL_CHOICES}"),
        ({"name": "circle-spatial", "radios": 1}, 6, "no field 'radios'; its fields are radius, center, duration$"),
        ({"duration": 1.0}, 6, "needs a 'name': one of paper-spatial, "),
        ({"name": ["circle-spatial"]}, 6, "unknown trajectory"),
        (Drift(duration=0.0), 2, "duration must be a finite number greater than 0 in s, not 0.0"),
        ({"name": "line-planar", "duration": -1.0}, 2, "duration must be .* greater than 0"),
        ({"name": "line-planar", "duration": "fast"}, 2, "duration must be .* not 'fast'"),
        ({"name": "line-planar", "duration": float("nan")}, 2, "duration must be .* not nan"),
        ({"name": "line-planar", "duration": float("inf")}, 2, "duration must be .* not inf"),
        ({"name": "line-planar", "duration": True}, 2, "duration must be .* not True"),
        (3.0, 2, "3.0 is not a trajectory; pass one of paper-planar, "),
        (None, 2, "None is not a trajectory"),
        (SmoothCircle, 6, "SmoothCircle'> is not a trajectory"),
        (lambda times: times, 2, "is not a trajectory"),
    ],
)
def test_wrong_request_is_not_taken_or_answered_unclearly(trajectory: Any, coordinates: int, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        find_trajectory(trajectory, coordinates)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("make", "fields", "message"),
    [
        (PaperCircle, {"radius": 0.0, "center": (0, 0)}, "radius must be a finite number greater than 0 in m, not 0.0"),
        (PaperCircle, {"radius": 0.1, "center": (0, 0, 0)}, "center must be .x, y. for a planar or .x, y, z, "),
        (PaperCircle, {"radius": 0.1, "center": (0, 0), "duration": 0}, "duration must be"),
        (SmoothCircle, {"radius": -0.1, "center": (0, 0)}, "radius must be"),
        (SmoothCircle, {"radius": 0.1, "center": (0, float("nan"))}, "center must contain finite numbers"),
        (SmoothCircle, {"radius": 0.1, "center": (0, 0), "duration": 0}, "duration must be"),
        (Dwell, {"pose": 3}, "pose must contain numbers, not 3"),
        (Dwell, {"pose": (0, 0), "duration": 0}, "duration must be"),
        (PointToPoint, {"start": (0,), "end": (0, 0)}, "start must be"),
        (PointToPoint, {"start": (0, 0), "end": ("a", 0)}, "end must contain numbers"),
        (PointToPoint, {"start": (0, 0), "end": POSE}, "start has 2 coordinates and end has 6"),
        (PointToPoint, {"start": (0, 0), "end": (1, 0), "duration": 0}, "duration must be"),
        (Lemniscate, {"amplitude": (0.1, 0.0), "center": (0, 0)}, "amplitude must be two lengths"),
        (Lemniscate, {"amplitude": (0.1,), "center": (0, 0)}, "amplitude must be two lengths"),
        (Lemniscate, {"amplitude": 0.1, "center": (0, 0)}, "amplitude must contain numbers"),
        (Lemniscate, {"amplitude": (0.1, 0.1), "center": ()}, "center must be"),
        (Lemniscate, {"amplitude": (0.1, 0.1), "center": (0, 0), "duration": 0}, "duration must be"),
    ],
)
def test_unphysical_field_is_not_taken(make: Any, fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make(**fields)
