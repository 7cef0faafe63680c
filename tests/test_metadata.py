"""The metadata of the project agree in all files."""

import re
import tomllib
from pathlib import Path

import pytest
import release

ROOT = Path(__file__).resolve().parents[1]


def test_oldest_tested_versions_are_the_lower_bounds():
    """Otherwise the smoke test would not cover the versions that pip may choose."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    bounds = {}
    for line in [*project["dependencies"], *extras["sb3"], *extras["plot"]]:
        name, version = re.fullmatch(r"([\w-]+)>=([\d.]+),<\d+", line).groups()
        bounds[name] = (version + ".0.0").split(".")[:3]
    pins = re.findall(
        r"^([\w-]+)==(\S+)$",
        (ROOT / "constraints/oldest.txt").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    tested = {name: version.split(".") for name, version in pins}
    assert bounds.keys() == tested.keys()
    del bounds["torch"], tested["torch"]
    assert bounds == tested


CHANGES = (
    "# Changelog\n\n## [0.2.0] - 2026-01-31\n\n- A change.\n\n## [0.1.0] - unreleased\n\n- First.\n"
)
ADDRESSES = dict.fromkeys(release.URLS, "https://example.org")


@pytest.mark.parametrize(
    ("tag", "version", "urls", "problem"),
    [
        ("v0.2.0", "0.2.0", ADDRESSES, None),
        ("v0.3.0", "0.2.0", ADDRESSES, "the tag is 'v0.3.0'"),
        ("v0.1.0", "0.1.0", ADDRESSES, "no date"),
        ("v0.1", "0.1", ADDRESSES, "no section"),
        ("v0.2.0", "0.2.0", ADDRESSES | {"Issues": ""}, "lacks Issues"),
    ],
)
def test_release_requires_tag_changelog_and_addresses(tag, version, urls, problem):
    problems = release.problems(tag, version, CHANGES, urls)
    assert len(problems) == (problem is not None)
    assert problem is None or problem in problems[0]
