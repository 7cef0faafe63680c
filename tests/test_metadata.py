"""The metadata of the project agree in all files."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

yaml = pytest.importorskip("yaml")
ROOT = Path(__file__).resolve().parents[1]


def test_citation_has_the_version_and_licence_of_the_package():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert (citation["version"], citation["license"]) == (project["version"], project["license"])
    assert citation["title"] == f"{project['name'].replace('-', '_')}: {project['description']}"


def test_extras_all_and_test_contain_all_extras_but_docs():
    """Only a build of the documentation needs the extra docs."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    names = ",".join(name for name in extras if name not in ("all", "test", "docs"))
    for extra in ("all", "test"):
        [line] = [line for line in extras[extra] if line.startswith("cablebot-gym[")]
        assert sorted(line[len("cablebot-gym[") : -1].split(",")) == sorted(names.split(","))


def test_oldest_tested_versions_are_the_lower_bounds():
    """Otherwise the smoke test would not cover the versions that pip may choose."""
    needed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    pinned = (ROOT / "constraints-oldest.txt").read_text(encoding="utf-8").splitlines()
    bounds = [re.fullmatch(r"([\w-]+)>=([\d.]+),<\d+", line).groups() for line in needed]
    pins = [line.split("==") for line in pinned if not line.startswith("#")]
    assert sorted((name, (whole + ".0.0").split(".")[:3]) for name, whole in bounds) == sorted(
        (name, whole.split(".")) for name, whole in pins
    )
