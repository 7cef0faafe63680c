"""``cablebot doctor``."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib.metadata import EntryPoint, entry_points

import pytest

from cablebot_gym import ENV_IDS
from cablebot_gym.cli import app as cli
from cablebot_gym.cli import doctor
from cablebot_gym.cli.doctor import Finding, examine
from cablebot_gym.policies import ENTRY_POINT_GROUP


def findings():
    return {finding.name: finding for finding in examine()}


def test_installation_has_no_fault():
    found = findings()
    assert all(finding.ok for finding in found.values())
    assert [name for name in found if name.startswith("self-test")] == [f"self-test {env_id}" for env_id in ENV_IDS]
    assert re.search(r"numba \d.*numpy 2", found["requirements"].text)
    assert "torch 2" in found["extra sb3"].text
    assert not {"extra all", "extra docs", "extra test"} & set(found)
    names = sorted(point.name for point in entry_points(group=ENTRY_POINT_GROUP))
    assert found["policies"].text == f"{len(names)} load: {', '.join(names)}"


def test_policy_that_fails_to_load_is_a_fault(monkeypatch):
    broken = EntryPoint("broken", "cablebot_baselines.nowhere:POLICY", ENTRY_POINT_GROUP)
    listed = doctor.entry_points
    monkeypatch.setattr(doctor, "entry_points", lambda *, group: [*listed(group=group), broken])
    found = findings()
    assert found["policy broken"].ok is False
    assert "No module named 'cablebot_baselines.nowhere'" in found["policy broken"].text
    assert found["policies"].ok


@pytest.mark.slow
def test_folder_that_hides_the_baselines_is_a_fault(tmp_path):
    """All installed policies vanish there."""
    (tmp_path / "cablebot_baselines").mkdir()
    (tmp_path / "cablebot_baselines" / "__init__.py").touch()
    command = [sys.executable, "-m", "cablebot_gym.cli.app", "doctor"]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == 1
    assert f"BAD package cablebot_baselines: {tmp_path.resolve() / 'cablebot_baselines'} hides " in ran.stdout
    assert "BAD policy fl: ModuleNotFoundError" in ran.stdout


def test_missing_package_is_a_fault_unless_it_belongs_to_an_extra(monkeypatch):
    version = doctor._version
    monkeypatch.setattr(doctor, "_version", lambda name: None if name == "casadi" else version(name))
    finding = findings()["extra optimal"]
    assert finding.ok is None
    assert finding.text == "casadi not installed. To install: pip install 'cablebot-gym[optimal]'"
    monkeypatch.setattr(doctor, "_version", lambda name: None if name == "scipy" else version(name))
    text = "scipy not installed. To install: pip install cablebot-gym"
    assert findings()["requirements"] == Finding(name="requirements", ok=False, text=text)


def test_plant_that_moves_under_static_torques_is_a_fault(monkeypatch):
    statics = doctor.static_torque
    monkeypatch.setattr(doctor, "static_torque", lambda *given, **more: 1.000001 * statics(*given, **more))
    wrong = [finding for finding in examine() if finding.ok is False]
    assert [finding.name for finding in wrong if "Spatial" in finding.name] == [
        "self-test CableBot-Spatial-v0",
        "self-test CableBot-FlexSpatial-v0",
    ]
    assert all("moves by" in finding.text for finding in wrong)


@pytest.mark.parametrize(("good", "status"), [(True, 0), (None, 0), (False, 1)])
def test_exit_status_is_1_for_faults_only(monkeypatch, capsys, good, status):
    monkeypatch.setattr("sys.argv", ["cablebot", "doctor"])
    monkeypatch.setattr(doctor, "examine", lambda: [Finding(name="a thing", ok=good, text="as it is")])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert (ended.value.code or 0) == status
    assert "a thing: as it is" in capsys.readouterr().out
