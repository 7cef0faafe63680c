"""Compares the model with public logs of real robots, for the page winches/docs/reality.md.

Writes the results of ``cablebot validate`` to winches/docs/reality/results.json, and a figure of
each study.

PYTHONPATH=scripts python winches/scripts/real_robots.py [--logs FOLDER]
"""

from __future__ import annotations

import argparse
import json
from functools import partial
from pathlib import Path
from typing import Any

from matplotlib import rc_context

from cablebot_gym.benchmark.tables import markdown_table
from cablebot_gym.utils.files import atomic_write, atomic_write_text
from cablebot_winches.reality import STUDIES
from cablebot_winches.reality.comparison import LogComparison, table
from cablebot_winches.reality.sources import SOURCES, read_logs

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "reality"

RESULTS = FOLDER / "results.json"


def results(logs: Path | None) -> dict[str, Any]:
    """Results of all studies by name. Writes their figures."""
    studies = {}
    for name, study in STUDIES.items():
        source = SOURCES[name]
        result = study(read_logs(source, logs))
        studies[name] = result.to_dict(name, source)
        # The same numbers give the same file.
        with rc_context({"svg.hashsalt": name}):
            save = partial(result.draw().savefig, format="svg", metadata={"Date": None})
            atomic_write(FOLDER / f"{name}.svg", save)
    return studies


def study_text(name: str) -> str:
    """Source, table and notes of a stored study in Markdown."""
    study = json.loads(RESULTS.read_text(encoding="utf-8"))[name]
    comparisons = []
    for stored in study["comparisons"]:
        del stored["deviation"], stored["held"]
        comparisons.append(LogComparison(**stored))
    address = f"https://github.com/{study['repository']}/tree/{study['commit']}"
    text = f"\nSource: [{study['repository']}]({address}), license {study['license']}. "
    text += f"Files: {len(study['files'])}. Command: `{study['command']}`.\n\n"
    text += markdown_table(table(comparisons))
    return text + "\n" + "".join(f"* {note}\n" for note in study["notes"]) + "\n"


def main() -> None:
    """Computes all studies."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--logs", type=Path, help="folder with the files; downloaded by default")
    text = json.dumps(results(parser.parse_args().logs), indent=1, ensure_ascii=False)
    atomic_write_text(RESULTS, text + "\n")


if __name__ == "__main__":
    main()
