"""What an evaluation found, drawn: torques against U± as in the paper's Figs. 10 and 12, paths as in Figs. 11 and 13.

Needs the extra ``plot``. Figures belong to no window and no global state; show them in a notebook, or save them.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from cablebot_gym.envs import described
from cablebot_gym.evaluation.result import DLCCResult
from cablebot_gym.evaluation.statistics import lower_bound
from cablebot_gym.kinematics import Array
from cablebot_gym.trajectories import Trajectory
from cablebot_gym.utils.files import write_whole
from cablebot_gym.utils.palette import BLUE, GREY, SHADE, SKY, VERMILLION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase

DPI = 150
"""Of saved figures, dots per inch."""

_WIDTH = 9.6
"""Of every figure [inch]."""

LETTERS = 112
"""Of a title's line: what fits that width."""

_HANDLE = 6
"""What a line in a legend takes [letters]."""

_FEW = 20
"""Steps of an episode up to which each one gets a dot: a line would not be seen."""


def import_matplotlib() -> ModuleType:
    """``matplotlib.figure``; a command calls this before its work, not to fail after it.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    try:
        from matplotlib import figure
    except ImportError as error:
        raise ImportError("drawing needs matplotlib: pip install 'cablebot-gym[plot]'") from error
    return figure


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueProfile:
    """Torques over time and their limits: what :func:`torque_panels` shows."""

    times: Array
    """(K,) [s]."""
    torques: Array
    """(K, m) [N·m]."""
    lower: Array
    """U⁻, (K, m) [N·m]."""
    upper: Array
    """U⁺, (K, m) [N·m]."""
    demanded: Array | None = None
    """What was asked for before it was clipped, (K, m) [N·m]; None where nothing clips."""
    end: float
    """Of the time axis [s]."""
    name: str = "applied torque"
    """In the legend."""


@dataclass(frozen=True, kw_only=True)
class Mark:
    """An instant to mark in a :class:`TorqueProfile`."""

    step: int
    """Its place in ``times``."""
    motor: int
    """Counted from 0."""
    name: str
    """In the legend."""
    note: str
    """Behind the time."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Travelled:
    """A motion and its errors: what :func:`path_panels` shows."""

    times: Array
    """(K,) [s]."""
    pose: Array
    """(K, n)."""
    position_error: Array
    """(K,) [m]."""
    rotation_error: Array | None
    """(K,) [rad]; None in the plane."""
    name: str = "travelled"
    """In the legend."""
    color: str = BLUE
    """Of its curves."""
    style: str = "-"
    """Of its curves."""

    @property
    def line(self) -> dict[str, Any]:
        """How matplotlib draws its curves."""
        return {"color": self.color, "linestyle": self.style, "linewidth": 1.8, "marker": _marker(self.times)}


def draw_torques(result: DLCCResult) -> Figure:
    """Each motor's torque against its limits U±, and the tightest instant of the episode.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    figure = new_figure(torques_height(result.task.robot.cables))
    _torques(figure, result)
    _entitle(figure, result)
    return figure


def draw_path(result: DLCCResult) -> Figure:
    """The path against the tube around its reference, and the tracking errors against their bounds.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    figure = new_figure(_PATH_HEIGHT)
    _path(figure, result)
    _entitle(figure, result)
    return figure


def draw_result(result: DLCCResult) -> Figure:
    """Torques and path in one figure.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    heights = [torques_height(result.task.robot.cables), _PATH_HEIGHT]
    figure = new_figure(sum(heights))
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=heights)[:, 0]
    _torques(above, result)
    _path(below, result)
    _entitle(figure, result)
    return figure


def draw_success(result: DLCCResult) -> Figure:
    """Share of the draws that carry each payload tried, with its lower bound, the payload found and the assured one.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
        ValueError: if the result is of one draw.
    """
    if result.probability is None or result.confidence is None:
        raise ValueError("one draw is carried or not: evaluate with an uncertainty and several draws")
    figure = new_figure(_SUCCESS_HEIGHT)
    axes = figure.subplots()
    payload, share = np.array(result.success).T
    bound = lower_bound(np.round(share * result.draws).astype(int), result.draws, result.confidence)
    axes.plot(payload, share, color=BLUE, linewidth=1.8, marker="o", markersize=3, label="share of draws that carry it")
    axes.plot(payload, bound, "--", color=BLUE, linewidth=1.2, label=f"lower bound, {result.confidence:.0%} confidence")
    axes.axhline(result.probability, color="black", linewidth=1.0, label=f"asked for: {result.probability:.0%}")
    marks = ((result.payload, "payload", "-"), (result.assured_payload, "assured", "--"))
    for found, name, style in marks:
        if found is not None:
            axes.axvline(found, color=VERMILLION, linestyle=style, linewidth=1.2, label=f"{name}: {found:.2f} kg")
    most = payload[np.flatnonzero(share > 0)[-1]] if share.any() else 0.0
    axes.set(xlim=(0, min(result.payload_max, 1.25 * most + 0.02 * result.payload_max)), ylim=(0, 1.02))
    axes.set(xlabel="payload [kg]", ylabel="share of draws")
    add_legend(figure, axes)
    _entitle(figure, result, one=False)
    return figure


def save_figures(result: DLCCResult, folder: Path) -> list[Path]:
    """Writes ``torques-<criterion>.png``, ``path-<criterion>.png`` and, over draws, ``success-<criterion>.png``.

    An interrupt leaves no half-written file.

    Args:
        result: what to draw.
        folder: where to; made if it does not exist.

    Returns:
        The files.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    figures = {"torques": draw_torques(result), "path": draw_path(result)}
    if result.probability is not None:
        figures["success"] = draw_success(result)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in figures.items():
        paths.append(folder / f"{name}-{result.criterion}.png")
        write_whole(paths[-1], partial(figure.savefig, dpi=DPI, format="png"))
    return paths


def tightest(result: DLCCResult) -> tuple[int, int]:
    """Step and motor, both from 0, where least of the torque was left: the first largest |a| of the episode."""
    demand = np.abs(result.history["drive_demand"])
    step, motor = np.unravel_index(np.argmax(demand), demand.shape)
    return int(step), int(motor)


def torque_limits(result: DLCCResult) -> tuple[Array, Array]:
    """U⁻ and U⁺ at the motor speeds of the episode (Eq. 37), each (steps, m) [N·m]."""
    stall, drop = result.history["stall_torque"], _slope(result) * result.history["motor_speeds"]
    return -stall - drop, stall - drop


def demanded_torque(result: DLCCResult) -> Array:
    """``τ_s a − (τ_s/ω_n) β̇``, what the policy asked for, (steps, m) [N·m]; beyond U± where |a| > 1."""
    history = result.history
    return np.asarray(history["stall_torque"] * history["drive_demand"] - _slope(result) * history["motor_speeds"])


def _slope(result: DLCCResult) -> Array:
    """True τ_s/ω_n: a motor's strength leaves its free speed as it is."""
    robot = result.task.robot
    slope: Array = robot.speed_slope * (result.history["stall_torque"] / robot.stall_torque)
    return slope


_PATH_HEIGHT, _SUCCESS_HEIGHT = 4.4, 4.4


def torques_height(cables: int) -> float:
    """What :func:`torque_panels` needs with a title and a legend [inch]."""
    return 1.4 + 2.0 * math.ceil(cables / 3)


def new_figure(height: float) -> Figure:
    """An empty figure of a height [inch] and the width of all.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    return import_matplotlib().Figure(figsize=(_WIDTH, height), layout="constrained")


def entitle(figure: FigureBase, *lines: str) -> None:
    """Gives a figure a title of some lines, each broken where it is too long."""
    # Not matplotlib's wrap, which takes dollar signs for mathematics.
    title = "\n".join(textwrap.fill(line, LETTERS) for line in lines)
    figure.suptitle(title, fontsize=11, parse_math=False)


def _entitle(figure: FigureBase, result: DLCCResult, *, one: bool = True) -> None:
    """The result in words; ``one``: the figure shows one of the draws."""
    if result.payload is None:
        found = f"not even zero payload is carried (drawn: zero payload): {result.limit}"
    else:
        found = (
            f"payload {result.payload:.3f} kg, total mass {result.total_mass:.3f} kg; "
            f"first limit above it: {result.limit}"
        )
    head = f"{described(result.env_id, result.task.robot.name)}, policy {result.policy}, {result.criterion} criterion"
    drawn = []
    if result.probability is not None:
        draws = f"{result.draws} draws of {result.uncertainty or 'the start'}"
        if result.payload is not None:
            shown = ", the first that carries it is shown" if one else ""
            drawn = [f"carried in at least {result.probability:.0%} of {draws}{shown}"]
        else:
            drawn = [f"{draws}, the one of this limit is shown" if one else draws]
    entitle(figure, head, *drawn, found)


def _torques(figure: FigureBase, result: DLCCResult) -> None:
    history, (lower, upper), (step, motor) = result.history, torque_limits(result), tightest(result)
    demand = abs(history["drive_demand"][step, motor])
    profile = TorqueProfile(
        times=history["command_time"],
        torques=history["torques"],
        lower=lower,
        upper=upper,
        demanded=demanded_torque(result),
        end=_end(result),
    )
    left = f"{demand - 1:.1%} beyond" if demand > 1 else f"{1 - demand:.1%} left"
    torque_panels(figure, profile, Mark(step=step, motor=motor, name="tightest instant", note=left))


def torque_panels(figure: FigureBase, profile: TorqueProfile, mark: Mark | None = None) -> None:
    """A panel of the figure for each motor, its torque against its limits, and a legend; in one, an instant marked."""
    time, cables = profile.times, profile.torques.shape[1]
    columns = min(3, cables)
    grid = figure.subplots(math.ceil(cables / columns), columns, sharex=True, sharey=True, squeeze=False)
    for axes in grid.flat[cables:]:
        axes.remove()
    (low, high), marker = _torque_range(profile), _marker(time)
    for motor, axes in enumerate(grid.flat[:cables]):
        axes.set_title(f"motor {motor + 1}", fontsize=11)
        shade: dict[str, Any] = {"color": SHADE, "linewidth": 0}
        upper, lower, ends = profile.upper[:, motor], profile.lower[:, motor], time[[0, *range(len(time)), -1]]
        axes.fill(ends, np.concatenate([[high], upper, [high]]), label="infeasible", **shade)
        axes.fill(ends, np.concatenate([[low], lower, [low]]), **shade)
        axes.plot(time, upper, color="black", linewidth=1.0, marker=marker, label="limits U±")
        axes.plot(time, lower, color="black", linewidth=1.0, marker=marker)
        if profile.demanded is not None:
            # The same as the applied torque, and hidden behind it, wherever |a| ≤ 1.
            demanded = profile.demanded[:, motor]
            axes.plot(time, demanded, "--", color=VERMILLION, linewidth=1.4, label="demanded, where beyond")
        axes.plot(time, profile.torques[:, motor], color=BLUE, linewidth=1.8, marker=marker, label=profile.name)
        axes.set(xlim=_span(time, profile.end), ylim=(low, high))
        below = motor + columns >= cables
        axes.tick_params(labelbottom=below)
        axes.locator_params(axis="x", nbins=5, prune="upper")  # the last label would touch the next panel's first
        if below:
            axes.set_xlabel("time [s]")
        if motor % columns == 0:
            axes.set_ylabel("torque [N·m]")
    if mark is not None:
        _mark(grid.flat[mark.motor], profile, mark)
    add_legend(figure, grid.flat[0 if mark is None else mark.motor])


def _end(result: DLCCResult) -> float:
    """When the last step of the episode ends [s]."""
    return float(result.history["command_time"][-1] + 1 / result.task.control_frequency)


def _span(times: Array, end: float) -> tuple[float, float]:
    """What to show of the time [s]: the episode, which a failure at zero payload cuts short."""
    return (-0.1 * end, 1.1 * end) if _is_short(times) else (0.0, end)


def _marker(times: Array) -> str:
    return "." if _is_short(times) else ""


def _is_short(times: Array) -> bool:
    return len(times) <= _FEW


def _torque_range(profile: TorqueProfile) -> tuple[float, float]:
    """What to show of the torques: the limits, and demands beyond them up to half as far again."""
    lower, upper = profile.lower, profile.upper
    demand = profile.torques if profile.demanded is None else profile.demanded
    stall = float((upper - lower).max()) / 2
    low = max(min(lower.min(), demand.min()), lower.min() - stall / 2)
    high = min(max(upper.max(), demand.max()), upper.max() + stall / 2)
    return float(low - 0.15 * stall), float(high + 0.15 * stall)


def _mark(axes: Axes, profile: TorqueProfile, mark: Mark) -> None:
    time, torques = profile.times[mark.step], profile.torques[:, mark.motor]
    lower, upper = profile.lower[:, mark.motor], profile.upper[:, mark.motor]
    torque, early = torques[mark.step], time < sum(_span(profile.times, profile.end)) / 2
    # Between the motor's torque and the limit on the other side.
    positive = 2 * torque > lower[mark.step] + upper[mark.step]
    free = (lower.max(), torques.min()) if positive else (torques.max(), upper.min())
    axes.plot(time, torque, "o", color=VERMILLION, markeredgecolor="black", markersize=7, label=mark.name)
    axes.annotate(
        f"t = {round(float(time), 7):.3f} s: {mark.note}",  # a half is rounded as in a result's own words
        (time, torque),
        xytext=(0.96 if early else 0.04, sum(free) / 2),
        textcoords=axes.get_yaxis_transform(),
        horizontalalignment="right" if early else "left",
        verticalalignment="center",
        arrowprops={"arrowstyle": "-", "color": GREY, "linewidth": 0.8, "shrinkB": 4},
        bbox={"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": GREY, "linewidth": 0.6},
    )


def add_legend(figure: FigureBase, axes: Axes) -> None:
    """A legend of what ``axes`` shows below the figure."""
    handles, labels = axes.get_legend_handles_labels()
    labels = [textwrap.fill(label.strip(), LETTERS - _HANDLE) for label in labels]
    room = sum(len(label) + _HANDLE for label in labels)
    columns = len(labels) if room <= LETTERS else max(1, LETTERS // (max(map(len, labels)) + _HANDLE))
    legend = figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)
    for text in legend.get_texts():
        text.set_parse_math(False)


def _path(figure: FigureBase, result: DLCCResult) -> None:
    history = result.history
    travelled = Travelled(
        times=history["command_time"] + 1 / result.task.control_frequency,
        pose=history["pose"],
        position_error=history["tracking_error"],
        rotation_error=None if result.task.robot.planar else history["rotation_error"],
    )
    path_panels(figure, result.task.trajectory, [travelled], **result.limits)


def path_panels(
    figure: FigureBase,
    trajectory: Trajectory,
    travelled: Sequence[Travelled],
    *,
    position: float | None,
    rotation: float | None,
) -> None:
    """Paths against the tube around their reference, errors against their bounds, and a legend.

    Args:
        figure: empty.
        trajectory: the reference.
        travelled: at least one motion.
        position: bound [m], the tube's radius; None for none.
        rotation: bound [rad]; None for none.
    """
    rotates = any(one.rotation_error is not None for one in travelled)
    grid = figure.add_gridspec(2 if rotates else 1, 2, width_ratios=[1, 1.25])
    plane, last = figure.add_subplot(grid[:, 0]), figure.add_subplot(grid[0, 1])
    draw_plane(plane, trajectory, travelled, position or 0.0)
    _error(last, travelled, [one.position_error for one in travelled], position, "position", "mm")
    if rotates:
        last.tick_params(labelbottom=False)
        last = figure.add_subplot(grid[1, 1], sharex=last)
        _error(last, travelled, [one.rotation_error for one in travelled], rotation, "rotation", "mrad")
    last.set_xlabel("time [s]")
    add_legend(figure, plane)


def draw_plane(axes: Axes, trajectory: Trajectory, travelled: Sequence[Travelled], radius: float) -> None:
    """Paths in the x–y plane, and the tube of that radius [m] around their reference."""
    from matplotlib.collections import EllipseCollection

    reference = trajectory(np.linspace(0.0, trajectory.duration, 1001)).position[:, :2]
    # Discs rather than offset curves: right for a reference that stays, stops or turns on the spot as well.
    discs: dict[str, Any] = {"units": "xy", "offsets": reference, "offset_transform": axes.transData}
    tube = EllipseCollection(2 * radius, 2 * radius, 0, color=SKY, linewidth=0, zorder=0, **discs)
    axes.add_collection(tube, autolim=False)
    axes.fill([], [], color=SKY, label=f"tube, R = {radius * 1e3:g} mm")  # legends do not know such collections
    seen = [reference - radius, reference + radius]
    for one in travelled:
        seen.append(one.pose[:, :2])
        axes.plot(*seen[-1].T, label=one.name, **one.line)
    axes.plot(*reference.T, "--", color="black", linewidth=1.0, label="reference")
    low, high = np.concatenate(seen).min(axis=0), np.concatenate(seen).max(axis=0)
    pad = 0.06 * (high - low).max()
    axes.set(xlim=(low[0] - pad, high[0] + pad), ylim=(low[1] - pad, high[1] + pad))
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")


def _error(
    axes: Axes,
    travelled: Sequence[Travelled],
    errors: Sequence[Array | None],
    bound: float | None,
    name: str,
    unit: str,
) -> None:
    """Errors against their bound; ``unit`` is a thousandth of the SI unit."""
    axes.locator_params(axis="x", nbins=6)
    longest = max((one.times for one in travelled), key=len)
    top = 0.0
    for one, error in zip(travelled, errors, strict=True):
        if error is not None:
            axes.plot(one.times, 1e3 * error, **one.line)
            top = max(top, 1e3 * float(error.max()))
    if bound is not None:
        mark_bound(axes, bound, unit)
        top = max(top, 1e3 * bound)
    else:
        axes.set_title("no bound under this criterion", fontsize=10, loc="right", color=GREY)
    span = _span(longest, float(longest[-1]))
    axes.set(xlim=span, ylim=(0, 1.2 * top or 1.0), ylabel=f"{name} error [{unit}]")


def mark_bound(axes: Axes, bound: float, unit: str, *, side: Literal["left", "right"] = "right") -> None:
    """A line at an error's bound, labelled on one side; ``unit`` is a thousandth of the SI unit."""
    axes.axhline(1e3 * bound, color="black", linewidth=1.0)
    axes.annotate(
        f"bound {1e3 * bound:g} {unit}",
        (0.99 if side == "right" else 0.01, 1e3 * bound),
        xycoords=("axes fraction", "data"),
        xytext=(0, 4),
        textcoords="offset points",
        horizontalalignment=side,
        verticalalignment="bottom",
        bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.85},
    )
