"""The best known payload of a drawn robot, against the nominal one and against the environment."""

import pytest

from cablebot_gym.bounds import best_known
from cablebot_gym.bounds.best_known import find_best_known
from cablebot_gym.bounds.drawn import _DrawnCase, find_drawn_best_known

pytest.importorskip("casadi")

PLANAR_ID = "CableBot-Planar-v0"
LINE = {"name": "line-planar", "duration": 0.4, "dwell": 0.0}
HEAVIER = {"parameters": {"payload": {"low": 0.03, "high": 0.03}}, "sensors": {"position": 1e-3}}


def strength(deviation):
    return {"parameters": {"motor_strength": {"low": deviation, "high": deviation}}}


@pytest.fixture(scope="module")
def nominal():
    """The nominal result for a short line, on coarse meshes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(best_known, "has_converged", lambda payloads: True)
        return find_best_known(PLANAR_ID, trajectory=LINE, cache=False)


@pytest.fixture(autouse=True)
def _use_nominal(monkeypatch, nominal):
    monkeypatch.setattr("cablebot_gym.bounds.drawn.find_best_known", lambda *_, **__: nominal)


def drawn(uncertainty, seed=0):
    return find_drawn_best_known(PLANAR_ID, uncertainty=uncertainty, seed=seed, trajectory=LINE)


def test_exactly_known_robot_gives_the_nominal_payload(nominal):
    result = drawn("none")
    assert result.verified
    assert result.ratio == pytest.approx(1.0, abs=0.002)
    assert result.nominal_payload == nominal.payload


@pytest.mark.landing
def test_stronger_motors_carry_more_and_weaker_ones_less():
    assert drawn(strength(-0.03)).ratio < 0.99 < 1.01 < drawn(strength(0.03)).ratio


def test_heavier_payload_of_a_draw_is_counted_by_its_nominal_mass():
    result = drawn(HEAVIER)
    assert result.verified
    assert result.ratio == pytest.approx(1 / 1.03, abs=0.003)


@pytest.mark.landing
def test_delayed_actions_are_sent_earlier():
    """The motion accelerates at once, so the first held steps cost payload."""
    result = drawn({"delay": 1})
    assert result.verified
    assert 0.95 < result.ratio < 1.0


@pytest.mark.landing
def test_hardware_draw_is_verified_in_its_own_draw_only(monkeypatch):
    sent = []
    replay = _DrawnCase._replays

    def replays(case, actions, payload):
        sent.append((case, actions, payload))
        return replay(case, actions, payload)

    monkeypatch.setattr(_DrawnCase, "_replays", replays)
    result = drawn("hardware", seed=1)
    assert result.verified
    assert 0.8 < result.ratio < 1.1
    case, actions, payload = sent[-1]
    assert all(verdict.violation is None for verdict, _ in replay(case, actions, payload))
    other = _DrawnCase.of(best_known._case(PLANAR_ID, trajectory=LINE), "hardware", 2)
    assert any(verdict.violation for verdict, _ in replay(other, actions, payload))
