"""``cablebot list``."""

import pytest

from cablebot_gym import ENV_IDS
from cablebot_gym.cli.listing import _trajectory_fields
from cablebot_gym.motions import TRAJECTORIES, find_trajectory, trajectory_names
from cablebot_gym.policies import policy_entries
from cablebot_gym.robots import robot_names
from cablebot_gym.uncertainty import PARAMETERS, UNCERTAINTIES

NAMES = (
    *(ENV_IDS, robot_names(), trajectory_names(), UNCERTAINTIES, PARAMETERS, policy_entries()),
    {parameter.unit for parameter in PARAMETERS.values()},
)


def test_list_has_every_name_and_unit_in_one_piece(cablebot, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    words = set(cablebot("list").out.replace("(", " ").split())
    for names in NAMES:
        assert set(names) <= words


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_listed_defaults_make_the_named_trajectory(name):
    named = TRAJECTORIES[name]()
    defaults = {key: entry["default"] for key, entry in _trajectory_fields(named).items()}
    assert find_trajectory({"name": name, **defaults}, named.coordinates) == named
