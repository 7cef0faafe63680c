"""Misspelt names: the sentence has the valid ones, and the one that was meant."""

from __future__ import annotations

import pytest

from cablebot_gym.envs import env_robot
from cablebot_gym.evaluation.constraints import find_criterion
from cablebot_gym.robots import PLANAR, find_robot
from cablebot_gym.trajectories import find_trajectory
from cablebot_gym.uncertainty import find_uncertainty
from cablebot_gym.utils.checks import unknown_name_error


@pytest.mark.parametrize(
    ("look_up", "meant"),
    [
        (lambda: env_robot("CableBot-Spatial"), "CableBot-Spatial-v0"),
        (lambda: env_robot("cablebot-flexspatial-v0"), "CableBot-FlexSpatial-v0"),
        (lambda: find_trajectory("circle_planar", 2), "circle-planar"),
        (lambda: find_robot("Spatial "), "spatial"),
        (lambda: find_uncertainty("tabel6", PLANAR), "table6"),
        (lambda: find_criterion("tasks"), "task"),
    ],
)
def test_a_misspelt_name_is_not_left_without_the_one_that_was_meant(look_up, meant):
    with pytest.raises(ValueError, match=rf"^unknown \w+ .*; choose one of .*; did you mean '{meant}'\?$") as caught:
        look_up()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["zebra", 3, None, ["zebra"]])
def test_what_is_like_none_of_the_names_gets_no_guess(name):
    assert str(unknown_name_error("motion", name, ("circle", "line"), ", or your own")) == (
        f"unknown motion {name!r}; choose one of circle, line, or your own"
    )
