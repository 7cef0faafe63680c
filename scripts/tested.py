"""Runs parts of the tests whose code has changed since they last passed.

    python scripts/tested.py [PART …] [--always] [--check]

``tests/tested.json`` records, for each part, the hash of the code that last passed: the modules that
the part checks with all their imports, its tests, and its stored results. A part with the recorded
hash is not run again.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from cablebot_gym.utils.code_hash import source_hash
from cablebot_gym.utils.files import atomic_write_text

ROOT = Path(__file__).resolve().parents[1]
RECORD = ROOT / "tests" / "tested.json"

STORED = (".json", ".jsonl", ".toml", ".zip", ".csv", ".svg")
"""Suffixes of stored results, weights and data."""


@dataclass(frozen=True, kw_only=True)
class Part:
    """Tests that are run together."""

    sources: dict[str, str]
    """Folder of the source of each package that the tests check."""
    folders: tuple[str, ...]
    """Folders of tests, stored results and data."""
    pytest: tuple[str, ...]
    """Arguments of pytest."""
    mark: str = ""
    """Mark of its tests among those of the core; empty for none."""

    def files(self) -> list[Path]:
        """Tests, stored results and data."""
        paths = [path for folder in self.folders for path in sorted((ROOT / folder).rglob("*"))]
        if self.mark:
            for path in sorted((ROOT / "tests").rglob("*.py")):
                if f"mark.{self.mark}" in path.read_text(encoding="utf-8"):
                    paths.append(path)
        return [path for path in paths if path.suffix in (".py", *STORED)]

    def code(self) -> str:
        """Hash of all that the result of the tests depends on."""
        modules = []
        for folder, package in self.sources.items():
            for path in sorted((ROOT / folder / package).rglob("*.py")):
                name = ".".join(path.relative_to(ROOT / folder).with_suffix("").parts)
                modules.append(name.removesuffix(".__init__"))
        digest = hashlib.sha256(source_hash(*modules).encode())
        for path in self.files():
            digest.update(path.relative_to(ROOT).as_posix().encode())
            digest.update(path.read_bytes())
        return digest.hexdigest()[:16]


PARTS = {
    "evidence": Part(
        sources={".": "cablebot_gym", "baselines": "cablebot_baselines"},
        folders=("docs", "cablebot_gym/library", "baselines/cablebot_baselines/learned/weights"),
        pytest=("-m", "evidence", "tests"),
        mark="evidence",
    ),
    "winches": Part(
        sources={"winches": "cablebot_winches"},
        folders=("winches",),
        pytest=("-m", "", "winches/tests"),
    ),
    "reproduction": Part(
        sources={"reproduction": "cablebot_reproduction"},
        folders=("reproduction",),
        pytest=("-m", "", "reproduction/tests"),
    ),
}


def read_record() -> dict[str, str]:
    """Hash of the code of each part that passed."""
    if not RECORD.is_file():
        return {}
    return json.loads(RECORD.read_text(encoding="utf-8"))


def changed(names: list[str]) -> list[str]:
    """Parts whose code is not the recorded one."""
    record = read_record()
    return [name for name in names if record.get(name) != PARTS[name].code()]


def run(name: str) -> bool:
    """Runs the tests of a part; records the hash of its code if they pass."""
    code = PARTS[name].code()
    command = [sys.executable, "-m", "pytest", "-n", "2", *PARTS[name].pytest]
    if subprocess.run(command, cwd=ROOT, check=False).returncode:
        return False
    record = read_record() | {name: code}
    atomic_write_text(RECORD, json.dumps(record, indent=2, sort_keys=True) + "\n")
    return True


def main() -> int:
    """Exit status 1 if a part fails, or with ``--check`` if its present code has not passed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"default: {' '.join(PARTS)}")
    parser.add_argument("--always", action="store_true", help="run unchanged parts too")
    parser.add_argument("--check", action="store_true", help="run nothing, list what has changed")
    arguments = parser.parse_args()
    names = arguments.parts or list(PARTS)
    for name in names:
        if name not in PARTS:
            parser.error(f"unknown part {name!r}: choose from {', '.join(PARTS)}")
    due = names if arguments.always else changed(names)
    for name in names:
        if name not in due:
            print(f"{name}: its present code has passed")
    if arguments.check:
        for name in due:
            print(f"{name}: changed since it passed: run python scripts/tested.py {name}")
        return bool(due)
    return not all([run(name) for name in due])


if __name__ == "__main__":
    sys.exit(main())
