"""``cablebot doctor``."""

import re
from importlib.metadata import EntryPoint, entry_points

import pytest

from cablebot_gym import ENV_IDS
from cablebot_gym.cli import doctor
from cablebot_gym.cli.doctor import Finding, examine
from cablebot_gym.policies import ENTRY_POINT_GROUP


@pytest.fixture
def no_self_tests(monkeypatch):
    """The self-tests of the environments take most of the time."""
    monkeypatch.setattr(doctor, "_statics_test", lambda env_id: [])


def findings():
    return {finding.name: finding for finding in examine()}


@pytest.mark.landing
def test_installation_has_no_fault():
    by_name = findings()
    for finding in by_name.values():
        assert finding.ok is not False, finding  # None: a missing extra
    assert {f"self-test {env_id}" for env_id in ENV_IDS} <= set(by_name)
    assert re.search(r"numba \d.*numpy 2", by_name["requirements"].text)
    assert "torch 2" in by_name["extra sb3"].text
    assert not {"extra all", "extra docs", "extra test", "extra test-all"} & set(by_name)
    names = sorted(point.name for point in entry_points(group=ENTRY_POINT_GROUP))
    assert by_name["policies"].text == f"{len(names)} load: {', '.join(names)}"


@pytest.mark.usefixtures("no_self_tests")
def test_policy_that_fails_to_load_is_a_fault(monkeypatch):
    broken = EntryPoint("broken", "cablebot_baselines.nowhere:POLICY", ENTRY_POINT_GROUP)
    listed = doctor.entry_points
    monkeypatch.setattr(doctor, "entry_points", lambda *, group: [*listed(group=group), broken])
    by_name = findings()
    assert by_name["policy broken"].ok is False
    assert "No module named 'cablebot_baselines.nowhere'" in by_name["policy broken"].text
    assert by_name["policies"].ok


def test_plant_that_moves_under_static_torques_is_a_fault(monkeypatch):
    statics = doctor.static_torque

    def wrong(*arguments, **keywords):
        return 1.000001 * statics(*arguments, **keywords)

    monkeypatch.setattr(doctor, "static_torque", wrong)
    monkeypatch.setattr(doctor, "ENV_IDS", ("CableBot-Spatial-v0", "CableBot-FlexSpatial-v0"))
    for env_id in doctor.ENV_IDS:
        finding = findings()[f"self-test {env_id}"]
        assert finding.ok is False
        assert "moves by" in finding.text


@pytest.mark.parametrize(("good", "status"), [(True, 0), (None, 0), (False, 1)])
def test_exit_status_is_1_for_faults_only(cablebot, monkeypatch, good, status):
    finding = Finding(name="a thing", ok=good, text="as it is")
    monkeypatch.setattr(doctor, "examine", lambda: [finding])
    ended = cablebot("doctor")
    assert ended.status == status
    assert "a thing: as it is" in ended.out
