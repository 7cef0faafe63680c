"""Whether the published payloads tell the geometry: how many geometries give them."""

from __future__ import annotations

from functools import partial
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cablebot_baselines.paper.exact import COARSE, exact_limit, paper_circle
from cablebot_baselines.paper.finding import reading_words
from cablebot_baselines.paper.part import Cell, Found, Outcome, Part
from cablebot_baselines.paper.published import LOADS
from cablebot_baselines.paper.readings import Readings
from cablebot_gym.bounds import exact_payload
from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.figures import add_legend, entitle, new_figure
from cablebot_gym.robots import SPATIAL
from cablebot_gym.utils.palette import BLUE, GREY, VERMILLION

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROUNDING = 0.06
"""How far from the published load a geometry still counts as giving it [kg]."""

SIZES = {"half side": 1.0, "circumradius": np.sqrt(3) / 2, "inradius": np.sqrt(3), "half altitude": 2 / np.sqrt(3)}
"""What "half of the triangle" can measure, and the triangle's size then, in multiples of the first."""

BASE_TURNS = np.radians(np.arange(0, 120, 10))
"""Turns of the base triangle about z [rad]; further on, the same shapes come again with other numbers."""

PLATFORM_TURNS = np.radians(np.arange(-60, 60, 5))
"""Turns of the platform's triangle against the base's inverse [rad]."""

PLANAR_TURNS = np.radians(np.arange(0, 121, 2))
"""Turns of the planar robot's triangle [rad]; further on, the same again with other motors."""


class Geometry(NamedTuple):
    """One geometry, its largest payload of exact tracking and the motor that limits it."""

    payload: float
    """Added to 10 kg [kg]; -inf where the platform alone does not keep all cables taut."""
    motor: int


def geometries(*, readings: Readings, base_size: str) -> list[Geometry]:
    """All geometries with one size of the base; those that cannot even hang at home are left out."""
    found = []
    trajectory = paper_circle(SPATIAL)
    for platform_size, base_turn, platform_turn in product(SIZES, BASE_TURNS, PLATFORM_TURNS):
        try:
            robot = SPATIAL.replace(
                base_anchors=SIZES[base_size] * _turned(SPATIAL.base, base_turn),
                platform_anchors=SIZES[platform_size] * _turned(SPATIAL.platform, base_turn + platform_turn),
            )
        except ValueError:
            continue
        limit = exact_payload(robot, trajectory, line_speed=readings.line_speed(robot), grid=COARSE)
        found.append(Geometry(limit.payload if limit.lowest <= 0 else -np.inf, limit.motor or 0))
    return found


def planar_turns(*, readings: Readings) -> list[float]:
    """Largest payload of exact tracking for each turn of the planar triangle [kg]."""
    robot, found = readings.planar, []
    for turn in PLANAR_TURNS:
        found.append(exact_limit(readings, robot.replace(base_anchors=_turned(robot.base, turn))).payload)
    return found


def _turned(points: Array, angle: float) -> Array:
    """Points turned about z."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turned = points.copy()
    turned[:, :2] = points[:, :2] @ np.array([[cosine, sine], [-sine, cosine]])
    return turned


def _cells(readings: Readings) -> dict[str, Cell]:
    line = Readings(line=readings.line)  # all else is scanned, or has no part in it
    cells: dict[str, Cell] = {f"base {size}": partial(geometries, readings=line, base_size=size) for size in SIZES}
    return cells | {"planar": partial(planar_turns, readings=readings.replace(alpha="least"))}


def _payloads(found: Found) -> Array:
    return np.array([item.payload for size in SIZES for item in found[f"base {size}"]])


def _outcome(readings: Readings, found: Found) -> Outcome:
    everything = [item for size in SIZES for item in found[f"base {size}"]]
    payload, target = _payloads(found), LOADS["spatial"]
    carries = payload > 0
    hit = np.abs(payload - target) <= ROUNDING
    second = np.array([item.motor == 2 for item in everything])
    planar = np.array(found["planar"])
    return Outcome(
        numbers={
            "geometries": len(SIZES) ** 2 * len(BASE_TURNS) * len(PLATFORM_TURNS),
            "hang": len(everything),
            "carry": int(carries.sum()),
            "hits": int(hit.sum()),
            "hits_second_motor": int((hit & second).sum()),
            "least_kg": float(payload[carries].min()) if carries.any() else None,
            "largest_kg": float(payload.max()) if carries.any() else None,
            "planar_best_added_kg": float(planar.max()),
            "planar_best_turn_deg": float(np.degrees(PLANAR_TURNS[planar.argmax()])),
        }
    )


def _draw(readings: Readings, found: Found) -> Figure:
    figure = new_figure(4.4)
    left, right = figure.subplots(1, 2)
    payload = _payloads(found)
    carried = payload[payload > 0]
    left.hist(
        carried,
        bins=np.arange(0, carried.max(initial=0.25) + 0.25, 0.25),
        color=BLUE,
        label="geometries that carry a load",
    )
    target = LOADS["spatial"]
    left.axvspan(
        target - ROUNDING,
        target + ROUNDING,
        color=VERMILLION,
        alpha=0.6,
        linewidth=0,
        label=f"as published, {target:g} ± {ROUNDING:g} kg",
    )
    left.set(
        xlabel="payload of exact tracking [kg]", ylabel="geometries", title="spatial: size and turn of both triangles"
    )
    degrees, planar = np.degrees(PLANAR_TURNS), np.array(found["planar"])
    mass = readings.planar.mass
    right.plot(degrees, planar, color=BLUE, label="added to the platform")
    right.plot(degrees, planar + mass, "--", color=GREY, label="platform and load")
    low, high = 0.95 * LOADS["planar"], 1.05 * LOADS["planar"]
    right.axhspan(
        low, high, color=VERMILLION, alpha=0.3, linewidth=0, label=f"as published, {LOADS['planar']:g} kg ± 5 %"
    )
    right.set(
        xlabel="turn of the planar triangle [°]",
        ylabel="mass [kg]",
        title="planar: turn of the triangle",
        xlim=(0, 120),
        ylim=(0, None),
    )
    add_legend(figure, left)
    right.legend(loc="lower right", fontsize=9)
    entitle(
        figure, f"Geometries that give the published payloads; exact tracking, {reading_words('line', readings.line)}"
    )
    return figure


PARTS: tuple[Part, ...] = (
    Part(
        name="scan",
        title="Does a payload of 2.56 kg tell the geometry?",
        text=(
            "The paper gives a and b, but neither which length of a triangle they are nor how the triangles stand. "
            f"All {len(SIZES) ** 2 * len(BASE_TURNS) * len(PLATFORM_TURNS)} combinations of four meanings for each, of "
            f"{len(BASE_TURNS)} turns of the base and {len(PLATFORM_TURNS)} of the platform are tried for exact "
            "tracking, with Table 4's pulleys and 10 kg. Many different robots carry what the paper publishes, so that "
            "the number alone identifies none; a geometry chosen because it gives the number would prove nothing. "
            "*Readings* has the few readings of the paper's own words that come close. For the planar robot the "
            "triangle is turned about its centre, from the reading chosen."
        ),
        cells=_cells,
        outcome=_outcome,
        draw=_draw,
    ),
)
