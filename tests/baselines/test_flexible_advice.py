"""Advice for laws on robots with springs: laws for rigid robots name those that work, and the page
agrees."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from cablebot_gym.policies import load_policy
from cablebot_gym.robots import FLEX_SPATIAL, SPATIAL, find_robot

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", ["fl", "fl-tuned", "robust", "robust-tuned"])
@pytest.mark.parametrize("robot", ["flex-spatial", "flex-ttk4900"])
def test_rigid_law_on_a_flexible_robot_logs_an_advice(name, robot, caplog):
    with caplog.at_level(logging.WARNING, logger="cablebot_gym"):
        load_policy(name, find_robot(robot))
    (record,) = caplog.records
    springs = "joint springs" if robot == "flex-spatial" else "elastic cables"
    assert record.getMessage().endswith(
        f"robot '{robot}' has {springs}. Use composite-tuned or adaptive-composite."
    )


@pytest.mark.parametrize(
    ("name", "robot"),
    [
        ("fl", SPATIAL),
        ("composite-tuned", FLEX_SPATIAL),
        ("adaptive", FLEX_SPATIAL),
        ("adaptive-composite", FLEX_SPATIAL),
    ],
)
def test_law_on_its_kind_of_robot_is_silent(name, robot, caplog):
    load_policy(name, robot)
    assert caplog.records == []
