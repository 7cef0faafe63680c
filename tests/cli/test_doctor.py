"""`cablebot doctor`: what is wrong is found, and nothing else is."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib.metadata import EntryPoint, entry_points

import pytest

from cablebot_gym import ENV_IDS
from cablebot_gym.cli import app as cli
from cablebot_gym.cli import doctor
from cablebot_gym.cli.doctor import Finding, examine, print_findings
from cablebot_gym.policies import ENTRY_POINT_GROUP


def findings():
    return {finding.name: finding for finding in examine()}


def test_nothing_is_wrong_here():
    found = findings()
    assert all(finding.ok for finding in found.values())
    assert [name for name in found if name.startswith("self-test")] == [f"self-test {env_id}" for env_id in ENV_IDS]
    assert re.search(r"numba \d.*numpy 2", found["requirements"].text)
    assert "torch 2" in found["extra sb3"].text
    assert not {"extra all", "extra docs", "extra test"} & set(found)


def test_every_installed_policy_is_loaded():
    names = sorted(point.name for point in entry_points(group=ENTRY_POINT_GROUP))
    assert findings()["policies"].text == f"{len(names)} load: {', '.join(names)}"


def test_policy_that_fails_to_load_is_a_fault(monkeypatch):
    broken = EntryPoint("broken", "cablebot_baselines.nowhere:POLICY", ENTRY_POINT_GROUP)
    listed = doctor.entry_points
    monkeypatch.setattr(doctor, "entry_points", lambda *, group: [*listed(group=group), broken])
    found = findings()
    assert found["policy broken"].ok is False
    assert "No module named 'cablebot_baselines.nowhere'" in found["policy broken"].text
    assert found["policies"].ok


def test_folder_that_hides_the_baselines_is_named(tmp_path):
    """All installed policies vanish there."""
    (tmp_path / "cablebot_baselines").mkdir()
    (tmp_path / "cablebot_baselines" / "__init__.py").touch()
    command = [sys.executable, "-m", "cablebot_gym.cli.app", "doctor"]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == 1
    assert f"BAD package cablebot_baselines: {tmp_path.resolve() / 'cablebot_baselines'} hides " in ran.stdout
    assert "BAD policy fl: ModuleNotFoundError" in ran.stdout


def test_missing_extra_is_no_fault_and_comes_with_its_command(monkeypatch):
    version = doctor._version
    monkeypatch.setattr(doctor, "_version", lambda name: None if name == "casadi" else version(name))
    finding = findings()["extra optimal"]
    assert finding.ok is None
    assert finding.text == "casadi not installed. To install: pip install 'cablebot-gym[optimal]'"


def test_package_that_is_always_needed_is_a_fault(monkeypatch):
    version = doctor._version
    monkeypatch.setattr(doctor, "_version", lambda name: None if name == "scipy" else version(name))
    assert findings()["requirements"] == Finding(
        name="requirements", ok=False, text="scipy not installed. To install: pip install cablebot-gym"
    )


def test_plant_that_does_not_obey_statics_is_a_fault(monkeypatch):
    statics = doctor.static_torque
    monkeypatch.setattr(doctor, "static_torque", lambda *given, **more: 1.000001 * statics(*given, **more))
    wrong = [finding for finding in examine() if finding.ok is False]
    assert [finding.name for finding in wrong if "Spatial" in finding.name] == [
        "self-test CableBot-Spatial-v0",
        "self-test CableBot-FlexSpatial-v0",
    ]
    assert all("moves by" in finding.text for finding in wrong)


def test_plant_that_cannot_be_run_is_a_fault_and_the_others_are_looked_at(monkeypatch):
    make = doctor.gym.make

    def broken(env_id, **keywords):
        if env_id == ENV_IDS[0]:
            raise RuntimeError("no kernel")
        return make(env_id, **keywords)

    monkeypatch.setattr(doctor.gym, "make", broken)
    found = findings()
    assert found[f"self-test {ENV_IDS[0]}"].text == "RuntimeError: no kernel"
    assert [found[f"self-test {env_id}"].ok for env_id in ENV_IDS] == [False, True, True, True]


def test_cache_that_cannot_be_written_is_a_fault(monkeypatch, tmp_path):
    monkeypatch.setenv("CABLEBOT_CACHE", str(tmp_path / "kept"))
    monkeypatch.setattr(doctor.os, "access", lambda path, mode: path != tmp_path)
    finding = findings()["plans and best known payloads"]
    assert finding.ok is False
    assert str(tmp_path / "kept") in finding.text


@pytest.mark.parametrize(("good", "status"), [(True, 0), (None, 0), (False, 1)])
def test_exit_status_tells_faults_alone(monkeypatch, capsys, good, status):
    monkeypatch.setattr("sys.argv", ["cablebot", "doctor"])
    monkeypatch.setattr(doctor, "examine", lambda: [Finding(name="a thing", ok=good, text="as it is")])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert (ended.value.code or 0) == status
    assert "a thing: as it is" in capsys.readouterr().out


def test_each_finding_is_printed_as_it_comes(capsys):
    def slow():
        yield Finding(name="first", ok=True, text="there")
        assert "first: there" in capsys.readouterr().out
        yield Finding(name="second", ok=False, text="bad")

    assert not print_findings(slow())
