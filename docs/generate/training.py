"""Learning curves of the shipped policies, from the cards beside their weights."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import bootstrap, trim_mean

from cablebot_baselines.learned.shipped import WEIGHTS
from cablebot_gym import ENV_IDS
from cablebot_gym.benchmark.tables import markdown_table
from cablebot_gym.plotting.figures import DPI
from generate.pages import Pages


def write(pages: Pages) -> None:
    """Writes a table and a figure for each kind of network."""
    for kind, label, time in (
        ("plan", "payload as a fraction of the optimum", "processor time"),
        ("ppo", "ceiling of the payloads / exact tracking", "time"),
    ):
        cards = cards_of(kind)
        picture = f"training-{kind}.png"
        curves(cards, label, time).savefig(pages.path(picture), dpi=DPI)
        text = f"{table(cards)}\n![{label} over training time](/generated/{picture})\n"
        pages.write(f"training-{kind}.inc", text)


def cards_of(kind: str) -> dict[str, Any]:
    """Cards by the id of the environment."""
    paths = {env_id: WEIGHTS / f"{kind}-{env_id}.json" for env_id in ENV_IDS}
    return {
        env_id: json.loads(path.read_text(encoding="utf-8"))
        for env_id, path in paths.items()
        if path.exists()
    }


def table(cards: dict[str, Any]) -> str:
    """Payloads of all seeds, and the command of the one that ships."""
    rows = [
        [
            "",
            "seeds",
            "minutes",
            "IQM [95 %]",
            "of each seed",
            "payload of each seed [kg]",
            "shipped",
        ]
    ]
    for env_id, card in cards.items():
        runs = card["runs"].values()
        values: Any = np.concatenate([run["last"] for run in runs])
        interval = bootstrap([values], interquartile_mean, rng=0).confidence_interval
        middle = f"{interquartile_mean(values):.3f} [{interval.low:.3f}, {interval.high:.3f}]"
        minutes = np.median([run["minutes"][-1] for run in runs])
        means = ", ".join(f"{np.mean(run['last']):.3f}" for run in runs)
        payloads = ", ".join(f"{run['mean']:.3f}" for run in runs if "mean" in run)
        cells = [env_id, ", ".join(card["runs"]), f"{minutes:.0f}", middle, means, payloads]
        rows.append([*cells, f"`{card['command']}`"])
    if not payloads:  # those of `ppo` are in payloads of exact tracking
        rows = [row[:-2] + row[-1:] for row in rows]
    return markdown_table(rows)


def interquartile_mean(values: Any, axis: int = -1) -> Any:
    """Mean of the middle half."""
    return trim_mean(values, 0.25, axis=axis)


def curves(cards: dict[str, Any], label: str, time: str) -> Figure:
    """Payload over time, a line for each seed."""
    figure = Figure(figsize=(9.6, 3.6), layout="constrained")
    axes = figure.subplots()
    for index, (env_id, card) in enumerate(cards.items()):
        for run in card["runs"].values():
            axes.plot(run["minutes"], run["payload"], f"C{index}", lw=1.2, label=env_id)
            env_id = f"_{env_id}"  # one entry of the legend
    axes.set_xlabel(f"{time} [min]")
    axes.set_ylabel(label)
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", fontsize="small")
    return figure
