"""How much of the tracking error the paper's robust term takes away, against the boundary layer that it does not print.

Reduction = 1 − (mean over draws of the robust law)/(mean over draws of the plain one), for the error's mean and maximum
over time, with table6 and the payload told. Example: python scripts/robust_curve.py --out results
"""

from __future__ import annotations

import argparse
import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from baselines.classical import Composite, FeedbackLinearization, Robust, RobustComposite
from cablebot_gym.dlcc import compare_policies
from cablebot_gym.dlcc.comparison import CONFIDENCE
from cablebot_gym.dlcc.figures import DPI, import_matplotlib
from cablebot_gym.files import usable_folder, write_whole
from cablebot_gym.robots import FLEX_SPATIAL, SPATIAL

LAYERS = np.logspace(-2, -4, 9)
"""ε of the curve."""

PUBLISHED = 0.6
"""The paper's "more than 60 %" (§4.4)."""

PAIRS = {
    "CableBot-Spatial-v0": (FeedbackLinearization(SPATIAL), partial(Robust, SPATIAL)),
    "CableBot-FlexSpatial-v0": (Composite(FLEX_SPATIAL), partial(RobustComposite, FLEX_SPATIAL)),
}
"""Plain law and maker of the robust one, ζ and φ at their defaults."""


def curve(env_id: str, payload: float, draws: int) -> list[dict[str, Any]]:
    """One point for each ε: reductions with their intervals."""
    plain, make = PAIRS[env_id]
    points = []
    for layer in track(LAYERS, env_id, console=Console(stderr=True), transient=True):
        found = compare_policies(
            [plain, make(boundary_layer=float(layer))],
            env_id,
            payload=payload,
            uncertainty="table6",
            draws=draws,
            names=["plain", "robust"],
        )
        reductions = {name: vars(found.reduction(1, name)) for name in ("mean_error", "max_error")}
        points.append({"layer": float(layer), **reductions})
    return points


def draw(curves: dict[str, list[dict[str, Any]]]) -> Any:
    """The curves as a figure."""
    figure = import_matplotlib().Figure(figsize=(9.6, 4.2), layout="constrained")
    panels = figure.subplots(1, len(curves), sharey=True, squeeze=False)[0]
    for axes, (env_id, points) in zip(panels, curves.items(), strict=True):
        layers = [point["layer"] for point in points]
        for name, colour, style in (("mean_error", "#0072B2", "-"), ("max_error", "#D55E00", "--")):
            low, mean, high = ([100 * point[name][end] for point in points] for end in ("low", "mean", "high"))
            axes.fill_between(layers, low, high, color=colour, alpha=0.2, linewidth=0)
            axes.plot(layers, mean, style, marker="o", color=colour, label=name.replace("_", " "))
        axes.axhline(100 * PUBLISHED, color="black", linewidth=1.0)
        axes.set(xscale="log", xlabel="boundary layer ε", title=env_id)
        axes.invert_xaxis()
    panels[0].set(ylabel="less error than without the robust term [%]", ylim=(0, 100))
    panels[0].annotate("the paper: more than 60 %", (layers[0], 61), verticalalignment="bottom")
    panels[0].legend(loc="lower right", frameon=False)
    return figure


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--payload", type=float, default=1.0, help="[kg] (default 1)")
    parser.add_argument("--draws", type=int, default=200, help="of table6 (default 200)")
    parser.add_argument("--out", type=Path, help="folder for robust-curve.json and robust-curve.png")
    arguments = parser.parse_args()
    if arguments.out is not None:
        import_matplotlib()
        usable_folder(arguments.out)
    curves = {env_id: curve(env_id, arguments.payload, arguments.draws) for env_id in PAIRS}
    for env_id, points in curves.items():
        print(f"{env_id}: error less than without the robust term, {CONFIDENCE:.0%} intervals")
        for point in points:
            mean, most = point["mean_error"], point["max_error"]
            texts = [f"{x['mean']:6.1%} [{x['low']:.1%}, {x['high']:.1%}]" for x in (mean, most)]
            print(f"  ε = {point['layer']:.2e}: mean {texts[0]}, max {texts[1]}")
    if arguments.out is not None:
        data = {"payload": arguments.payload, "draws": arguments.draws, "curves": curves}
        write_whole(arguments.out / "robust-curve.json", lambda path: _write(path, json.dumps(data, indent=2) + "\n"))
        write_whole(arguments.out / "robust-curve.png", partial(draw(curves).savefig, dpi=DPI, format="png"))


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
