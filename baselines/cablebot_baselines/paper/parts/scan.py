"""Scan of geometries: number of geometries that give the published payloads."""

from __future__ import annotations

from functools import partial
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cablebot_baselines.paper.exact import COARSE, exact_limit, paper_circle
from cablebot_baselines.paper.finding import option_text
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.part import Cell, CellResults, Outcome, Part
from cablebot_baselines.paper.published import LOADS
from cablebot_gym.bounds import exact_payload
from cablebot_gym.kinematics import Array
from cablebot_gym.plotting.figures import add_legend, new_figure, set_title
from cablebot_gym.robots import SPATIAL
from cablebot_gym.utils.palette import BLUE, GREY, VERMILLION

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROUNDING = 0.06
"""Maximum difference from the published payload that counts as a match [kg]."""

SIZES = {"half side": 1.0, "circumradius": np.sqrt(3) / 2, "inradius": np.sqrt(3), "half altitude": 2 / np.sqrt(3)}
"""Possible meanings of "half of the triangle", with the resulting size of the triangle relative to the first."""

BASE_TURNS = np.radians(np.arange(0, 120, 10))
"""Rotations of the base triangle about z [rad]. Larger angles give the same shapes with other motor numbers."""

PLATFORM_TURNS = np.radians(np.arange(-60, 60, 5))
"""Rotations of the platform triangle relative to the inverted base triangle [rad]."""

PLANAR_TURNS = np.radians(np.arange(0, 121, 2))
"""Rotations of the planar triangle [rad]. Larger angles give the same triangles with other motor numbers."""


class Geometry(NamedTuple):
    """Largest payload of exact tracking and limiting motor of one geometry."""

    payload: float
    """Mass added to 10 kg [kg]; -inf if the platform alone does not keep all cables taut."""
    motor: int


def geometries(*, interpretation: Interpretation, base_size: str) -> list[Geometry]:
    """All geometries with one base size. Geometries without equilibrium in the home pose are omitted."""
    results = []
    trajectory = paper_circle(SPATIAL)
    for platform_size, base_turn, platform_turn in product(SIZES, BASE_TURNS, PLATFORM_TURNS):
        try:
            robot = SPATIAL.replace(
                base_anchors=SIZES[base_size] * _turned(SPATIAL.base, base_turn),
                platform_anchors=SIZES[platform_size] * _turned(SPATIAL.platform, base_turn + platform_turn),
            )
        except ValueError:
            continue
        limit = exact_payload(robot, trajectory, line_speed=interpretation.line_speed(robot), grid=COARSE)
        results.append(Geometry(limit.payload if limit.lowest <= 0 else -np.inf, limit.motor or 0))
    return results


def planar_turns(*, interpretation: Interpretation) -> list[float]:
    """Largest payload of exact tracking for each rotation of the planar triangle [kg]."""
    robot, results = interpretation.planar, []
    for turn in PLANAR_TURNS:
        results.append(exact_limit(interpretation, robot.replace(base_anchors=_turned(robot.base, turn))).payload)
    return results


def _turned(points: Array, angle: float) -> Array:
    """Points rotated about z."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turned = points.copy()
    turned[:, :2] = points[:, :2] @ np.array([[cosine, sine], [-sine, cosine]])
    return turned


def _cells(interpretation: Interpretation) -> dict[str, Cell]:
    line = Interpretation(line=interpretation.line)  # all other options are scanned or have no effect
    cells: dict[str, Cell] = {
        f"base {size}": partial(geometries, interpretation=line, base_size=size) for size in SIZES
    }
    return cells | {"planar": partial(planar_turns, interpretation=interpretation.replace(alpha="least"))}


def _payloads(results: CellResults) -> Array:
    return np.array([item.payload for size in SIZES for item in results[f"base {size}"]])


def _outcome(interpretation: Interpretation, results: CellResults) -> Outcome:
    all_geometries = [item for size in SIZES for item in results[f"base {size}"]]
    payload, target = _payloads(results), LOADS["spatial"]
    positive = payload > 0
    hit = np.abs(payload - target) <= ROUNDING
    second = np.array([item.motor == 2 for item in all_geometries])
    planar = np.array(results["planar"])
    return Outcome(
        numbers={
            "geometries": len(SIZES) ** 2 * len(BASE_TURNS) * len(PLATFORM_TURNS),
            "with_equilibrium": len(all_geometries),
            "with_positive_payload": int(positive.sum()),
            "hits": int(hit.sum()),
            "hits_second_motor": int((hit & second).sum()),
            "least_kg": float(payload[positive].min()) if positive.any() else None,
            "largest_kg": float(payload.max()) if positive.any() else None,
            "planar_best_added_kg": float(planar.max()),
            "planar_best_turn_deg": float(np.degrees(PLANAR_TURNS[planar.argmax()])),
        }
    )


def _draw(interpretation: Interpretation, results: CellResults) -> Figure:
    figure = new_figure(4.4)
    left, right = figure.subplots(1, 2)
    payload = _payloads(results)
    positive = payload[payload > 0]
    left.hist(
        positive,
        bins=np.arange(0, positive.max(initial=0.25) + 0.25, 0.25),
        color=BLUE,
        label="geometries with a positive payload",
    )
    target = LOADS["spatial"]
    left.axvspan(
        target - ROUNDING,
        target + ROUNDING,
        color=VERMILLION,
        alpha=0.6,
        linewidth=0,
        label=f"published: {target:g} ± {ROUNDING:g} kg",
    )
    left.set(
        xlabel="payload of exact tracking [kg]",
        ylabel="geometries",
        title="spatial: sizes and rotations of both triangles",
    )
    degrees, planar = np.degrees(PLANAR_TURNS), np.array(results["planar"])
    mass = interpretation.planar.mass
    right.plot(degrees, planar, color=BLUE, label="added to the platform")
    right.plot(degrees, planar + mass, "--", color=GREY, label="total mass of platform and load")
    low, high = 0.95 * LOADS["planar"], 1.05 * LOADS["planar"]
    right.axhspan(low, high, color=VERMILLION, alpha=0.3, linewidth=0, label=f"published: {LOADS['planar']:g} kg ± 5 %")
    right.set(
        xlabel="rotation of the planar triangle [°]",
        ylabel="mass [kg]",
        title="planar: rotation of the triangle",
        xlim=(0, 120),
        ylim=(0, None),
    )
    add_legend(figure, left)
    right.legend(loc="lower right", fontsize=9)
    set_title(
        figure,
        f"Geometries that give the published payloads; exact tracking, {option_text('line', interpretation.line)}",
    )
    return figure


PARTS: tuple[Part, ...] = (
    Part(
        name="scan",
        title="Does a payload of 2.56 kg identify the geometry?",
        text=(
            "The paper prints a and b, but does not state which length of a triangle they are, nor how the triangles "
            "are oriented. "
            f"All {len(SIZES) ** 2 * len(BASE_TURNS) * len(PLATFORM_TURNS)} combinations of four meanings for each "
            f"length, {len(BASE_TURNS)} rotations of the base and {len(PLATFORM_TURNS)} of the platform are evaluated "
            "for exact tracking with the pulleys of Table 4 and 10 kg. Many different geometries give the published "
            "payload, so the payload alone does not identify the geometry, and a geometry that is chosen to match it "
            "proves nothing. The section *Interpretations* lists the interpretations of the paper that come close. For "
            "the planar robot the triangle is rotated about its centre, starting from the chosen interpretation."
        ),
        cells=_cells,
        outcome=_outcome,
        draw=_draw,
    ),
)
