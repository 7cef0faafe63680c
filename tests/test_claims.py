"""Statements of pages, help and docstrings: wrong ones do not return, and what can be compared with
the code is."""

from cablebot_gym import ENV_IDS
from cablebot_gym.cli.listing import tables
from cablebot_gym.envs import ENV_ROBOTS
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.robots import COORDINATE_NAMES, find_robot


def test_manual_names_the_coordinates_of_every_id():
    for robot in map(find_robot, ENV_ROBOTS.values()):
        assert f"({', '.join(COORDINATE_NAMES[robot.kind])})" in CableBotEnv.__doc__


def test_list_says_what_is_elastic():
    rows = {row[0]: row[-1] for key, _, rows in tables() for row in rows if key == "ids"}
    assert rows.pop("id") == "transmission"
    assert set(rows) == set(ENV_IDS)
    for env_id, text in rows.items():
        robot = find_robot(ENV_ROBOTS[env_id])
        assert ("joint springs" in text) == robot.jointed
        assert ("elastic cables" in text) == robot.elastic
