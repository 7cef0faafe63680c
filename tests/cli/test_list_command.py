"""``cablebot list``."""

import subprocess
import sys
from collections import defaultdict

import pytest

from cablebot_gym import ENV_IDS
from cablebot_gym.envs import env_robot
from cablebot_gym.policies import policy_entries
from cablebot_gym.robots import find_robot, robot_names
from cablebot_gym.trajectories import TRAJECTORIES, find_trajectory, trajectory_names
from cablebot_gym.uncertainty import PARAMETERS, UNCERTAINTIES, find_uncertainty


@pytest.fixture
def data(cablebot):
    return cablebot("list --json").data


NAMES = {
    "env_ids": ENV_IDS,
    "robots": robot_names(),
    "trajectories": trajectory_names(),
    "uncertainties": UNCERTAINTIES,
    "uncertain_parameters": PARAMETERS,
    "policies": policy_entries(),
}


def test_json_and_text_have_every_name_and_unit(cablebot, data):
    words = set(cablebot("list").out.replace("(", " ").split())
    for key, names in NAMES.items():
        listed = [item["name"] if isinstance(item, dict) else item for item in data[key]]
        assert listed == list(names)
        assert set(names) <= words
    law = {
        "name": "flex-eq22",
        "kind": "classical",
        "env_ids": ["CableBot-FlexSpatial-v0"],
        "known_robot": True,
    }
    assert law in data["policies"]
    assert {parameter.unit for parameter in PARAMETERS.values()} <= words


def test_listed_defaults_make_the_named_trajectory(data):
    for name, entries in data["trajectory_fields"].items():
        defaults = {key: entry["default"] for key, entry in entries.items()}
        named = TRAJECTORIES[name]()
        assert find_trajectory({"name": name, **defaults}, named.coordinates) == named


def test_listed_fields_make_the_named_uncertainty(data):
    for name, entries in data["uncertainty_fields"].items():
        for env_id in ENV_IDS:
            values = defaultdict(dict)
            for entry in entries:
                if env_id in entry["env_ids"]:
                    group, _, key = entry["field"].partition(".")
                    if key:
                        values[group][key] = entry["value"]
                    else:
                        values[group] = entry["value"]
            robot = find_robot(env_robot(env_id))
            assert find_uncertainty(dict(values), robot) == find_uncertainty(name, robot)


def test_file_in_the_current_folder_hides_no_package(tmp_path):
    (tmp_path / "numpy.py").write_text("raise RuntimeError('hidden')\n")
    command = [sys.executable, "-P", "-c", "from cablebot_gym.cli.app import main; main()", "list"]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == 0
    assert "hidden" not in ran.stderr
