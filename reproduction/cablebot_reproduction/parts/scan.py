"""Scan of geometries: number of geometries that give the published payloads."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cablebot_gym.bounds import exact_payload
from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.figures import add_legend, new_figure, set_title
from cablebot_gym.robots import SPATIAL
from cablebot_gym.utils.palette import BLUE, GREY, VERMILLION
from cablebot_reproduction.exact import COARSE, exact_limit, paper_circle
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.part import Jobs, Outcome, Results, job
from cablebot_reproduction.published import LOADS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROUNDING = 0.06
"""Maximum difference from the published payload that counts as a match [kg]."""

SIZES = {
    "half side": 1.0,
    "circumradius": np.sqrt(3) / 2,
    "inradius": np.sqrt(3),
    "half altitude": 2 / np.sqrt(3),
}
"""Possible meanings of "half of the triangle", with the resulting size of the triangle relative to
the first."""

BASE_TURNS = np.radians(np.arange(0, 120, 10))
"""Rotations of the base triangle about z [rad]. Larger angles give the same shapes with other motor
numbers."""

PLATFORM_TURNS = np.radians(np.arange(-60, 60, 5))
"""Rotations of the platform triangle relative to the inverted base triangle [rad]."""

PLANAR_TURNS = np.radians(np.arange(0, 121, 2))
"""Rotations of the planar triangle [rad]. Larger angles give the same triangles with other motor
numbers."""


class Geometry(NamedTuple):
    """Largest payload of exact tracking and limiting motor of one geometry."""

    payload: float
    """Mass added to 10 kg [kg]; -inf if the platform alone does not keep all cables taut."""
    motor: int


def geometries(*, interpretation: Interpretation, base_size: str) -> list[Geometry]:
    """All geometries with one base size. Geometries without equilibrium in the home pose are
    omitted."""
    results = []
    trajectory = paper_circle(SPATIAL)
    for platform_size, base_turn, platform_turn in product(SIZES, BASE_TURNS, PLATFORM_TURNS):
        try:
            robot = SPATIAL.replace(
                base_anchors=SIZES[base_size] * _turned(SPATIAL.base, base_turn),
                platform_anchors=SIZES[platform_size]
                * _turned(SPATIAL.platform, base_turn + platform_turn),
            )
        except ValueError:
            continue
        limit = exact_payload(
            robot, trajectory, line_speed=interpretation.line_speed(robot), grid=COARSE
        )
        payload = -np.inf
        if limit.lowest <= 0:
            payload = limit.payload
        results.append(Geometry(payload, limit.motor or 0))
    return results


def planar_turns(*, interpretation: Interpretation) -> list[float]:
    """Largest payload of exact tracking for each rotation of the planar triangle [kg]."""
    robot = interpretation.planar
    payloads = []
    for turn in PLANAR_TURNS:
        turned = robot.replace(base_anchors=_turned(robot.base, turn))
        payloads.append(exact_limit(interpretation, turned).payload)
    return payloads


def _turned(points: Array, angle: float) -> Array:
    """Points rotated about z."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turned = points.copy()
    turned[:, :2] = points[:, :2] @ np.array([[cosine, sine], [-sine, cosine]])
    return turned


def jobs(interpretation: Interpretation) -> Jobs:
    """The scan for each base size, and of the planar robot."""
    # All other options are scanned or have no effect.
    line = Interpretation(line=interpretation.line)
    jobs = {f"base {size}": job(geometries, interpretation=line, base_size=size) for size in SIZES}
    jobs["planar"] = job(planar_turns, interpretation=interpretation.replace(alpha="least"))
    return jobs


def _geometries(results: Results) -> tuple[Array, Array]:
    """Payloads and limiting motors of all geometries."""
    rows = [geometry for size in SIZES for geometry in results[f"base {size}"]]
    columns = np.array(rows).reshape(-1, 2)
    return columns[:, 0], columns[:, 1]


def outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Counts of geometries, and extreme payloads."""
    payload, motor = _geometries(results)
    positive = payload[payload > 0]
    is_hit = np.abs(payload - LOADS["spatial"]) <= ROUNDING
    planar = np.array(results["planar"])
    least = largest = None
    if len(positive):
        least, largest = float(positive.min()), float(positive.max())
    return Outcome(
        numbers={
            "geometries": len(SIZES) ** 2 * len(BASE_TURNS) * len(PLATFORM_TURNS),
            "with_equilibrium": len(payload),
            "with_positive_payload": len(positive),
            "hits": int(is_hit.sum()),
            "hits_second_motor": int((is_hit & (motor == 2)).sum()),
            "least_kg": least,
            "largest_kg": largest,
            "planar_best_added_kg": float(planar.max()),
            "planar_best_turn_deg": float(np.degrees(PLANAR_TURNS[planar.argmax()])),
        }
    )


def draw(interpretation: Interpretation, results: Results) -> Figure:
    """Histogram of the spatial payloads, and planar payload versus rotation."""
    figure = new_figure(4.4)
    spatial, planar = figure.subplots(1, 2)
    payload, _ = _geometries(results)
    _draw_spatial(spatial, payload)
    _draw_planar(planar, np.array(results["planar"]), interpretation.planar.mass)
    add_legend(figure, spatial)
    line = f"line = {interpretation.line}"
    set_title(figure, f"Geometries that give the published payloads; exact tracking, {line}")
    return figure


_PUBLISHED: dict[str, Any] = {"color": VERMILLION, "alpha": 0.5, "linewidth": 0}
"""Style of the published payload."""


def _draw_spatial(axes: Axes, payload: Array) -> None:
    bins = np.arange(0, payload.max(initial=0.25) + 0.25, 0.25).tolist()
    axes.hist(
        payload[payload > 0], bins=bins, color=BLUE, label="geometries with a positive payload"
    )
    load = LOADS["spatial"]
    label = f"published: {load:g} ± {ROUNDING:g} kg"
    axes.axvspan(load - ROUNDING, load + ROUNDING, label=label, **_PUBLISHED)
    axes.set(xlabel="payload of exact tracking [kg]", ylabel="geometries")
    axes.set_title("spatial: sizes and rotations of both triangles")


def _draw_planar(axes: Axes, payload: Array, platform: float) -> None:
    degrees = np.degrees(PLANAR_TURNS)
    axes.plot(degrees, payload, color=BLUE, label="added to the platform")
    axes.plot(
        degrees, payload + platform, "--", color=GREY, label="total mass of platform and load"
    )
    load = LOADS["planar"]
    axes.axhspan(0.95 * load, 1.05 * load, label=f"published: {load:g} kg ± 5 %", **_PUBLISHED)
    axes.set(
        xlabel="rotation of the planar triangle [°]",
        ylabel="mass [kg]",
        xlim=(0, 120),
        ylim=(0, None),
    )
    axes.set_title("planar: rotation of the triangle")
    axes.legend(loc="lower right", fontsize=9)
