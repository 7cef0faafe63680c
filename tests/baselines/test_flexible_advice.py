"""Advice for laws on robots with springs: laws for rigid robots name those that work, and the page
agrees."""

import pytest

from cablebot_gym.policies import load_policy
from cablebot_gym.robots import FLEX_SPATIAL, SPATIAL, find_robot


@pytest.mark.parametrize("name", ["fl", "fl-tuned", "robust"])
@pytest.mark.parametrize(
    ("robot", "springs"), [("flex-spatial", "joint springs"), ("flex-ttk4900", "elastic cables")]
)
def test_rigid_law_on_a_flexible_robot_logs_an_advice(name, robot, springs, caplog):
    load_policy(name, find_robot(robot))
    (record,) = caplog.records
    advice = f"robot '{robot}' has {springs}. Use composite-tuned or adaptive-composite."
    assert record.getMessage().endswith(advice)


def test_law_on_its_kind_of_robot_is_silent(caplog):
    load_policy("fl", SPATIAL)
    for name in ("composite-tuned", "adaptive", "adaptive-composite"):
        load_policy(name, FLEX_SPATIAL)
    assert caplog.records == []
