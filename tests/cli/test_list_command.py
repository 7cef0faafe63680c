"""``cablebot list``."""

from collections import defaultdict

import pytest
from oracles.episodes import ROBOTS

from cablebot_gym import ENV_IDS
from cablebot_gym.cli.listing import _trajectory_fields, _uncertainty_fields
from cablebot_gym.motions import TRAJECTORIES, find_trajectory, trajectory_names
from cablebot_gym.policies import policy_entries
from cablebot_gym.robots import robot_names
from cablebot_gym.uncertainty import PARAMETERS, UNCERTAINTIES, find_uncertainty

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


@pytest.mark.parametrize("name", UNCERTAINTIES)
def test_listed_fields_make_the_named_uncertainty(name):
    for env_id in ENV_IDS:
        values = defaultdict(dict)
        for entry in _uncertainty_fields(name):
            if env_id in entry["env_ids"]:
                group, _, key = entry["field"].partition(".")
                if key:
                    values[group][key] = entry["value"]
                else:
                    values[group] = entry["value"]
        robot = ROBOTS[env_id]
        assert find_uncertainty(dict(values), robot) == find_uncertainty(name, robot)
