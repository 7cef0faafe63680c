"""The attack suite: every policy is refused, harmless or marked, in a process of its
own."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from attacks.suite import (
    ALONE,
    ATTACKS,
    ENV_ID,
    FOLDER,
    LESS,
    SANDBOX,
    SANDBOXED,
    SCORED,
    cheats,
    page,
    policy_name,
    process_cheats,
    run,
    survey_suite,
)

from cablebot_gym.benchmark.records import compute
from cablebot_gym.evaluation import survey
from cablebot_gym.evaluation.evaluator import evaluate_dlcc
from cablebot_gym.isolation.sandbox import sandbox_problem
from cablebot_gym.policies import PolicyError

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the policies use signals and fork")


def descendants():
    """Processes that policies of this suite have left."""
    pids = set()
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            pids |= {path.parent.name} if b"time.sleep(600)" in path.read_bytes() else set()
        except OSError:
            continue
    return pids


@pytest.mark.slow
@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.name)
def test_attack_on_an_isolated_evaluation(attack):
    before = descendants()
    status, out, err = run(attack.name, attack.options)
    assert status == attack.status, err
    assert descendants() <= before
    assert "Traceback" not in err
    if attack.status:
        assert out == ""
        message = err.splitlines()[-1]
        assert message.startswith(f"cablebot: policy '{policy_name(attack.name)}'")
        assert attack.now in message
        assert len(message) < 2000
        return
    (result,) = json.loads(out)
    if attack.now == SCORED:
        assert result["stochastic"] or result["declared"]
        return
    (honest,) = json.loads(run("Law", attack.options)[1])
    payload = result["payload"] or 0.0
    expected = honest["payload"] or 0.0
    tolerance = result["resolution"] + honest["resolution"]
    least, most = expected, expected
    if attack.now == LESS:
        least, most = 0.0, expected / 2
    if attack.now == ALONE:  # random seeds move the payload of the honest policy
        least, most = 0.0, expected + 0.03
    assert least - tolerance <= payload <= most + tolerance


@pytest.mark.slow
@pytest.mark.parametrize("attack", survey_suite.SURVEY_ATTACKS, ids=lambda attack: attack.name)
def test_attack_on_a_survey(attack, monkeypatch):
    """A tenth of the repeated episodes of deterministic policies suffices to refuse them."""
    monkeypatch.chdir(FOLDER)
    monkeypatch.setattr(survey, "REPEATED", 6)
    honest = survey_suite.unprotected("Honest").mean()
    assert honest == pytest.approx(survey_suite.HONEST, abs=survey_suite.TOLERANCE)
    unprotected = survey_suite.unprotected(attack.name).mean()
    tolerance = survey_suite.TOLERANCE + attack.scatter
    assert unprotected == pytest.approx(attack.unprotected, abs=tolerance)
    record = compute(replace(survey_suite.CELL, policy=f"survey_cheats:{attack.name}"))
    if attack.error:
        assert attack.error in record.error
        return
    assert record.error is None
    payload = np.mean(record.result["payloads"])
    assert payload <= honest + survey_suite.TOLERANCE
    if attack.now != survey_suite.AT_MOST:
        assert payload >= honest - survey_suite.TOLERANCE


@pytest.mark.slow
@pytest.mark.skipif(sandbox_problem() != "", reason=sandbox_problem())
@pytest.mark.parametrize("attack", SANDBOXED, ids=lambda attack: attack.name)
def test_attack_on_the_operating_system_fails_in_a_sandbox(attack):
    """Without a sandbox it succeeds, so the attack is one."""
    status, _, err = run(attack.name)
    assert status == attack.status, err
    assert attack.now in err, err
    status, out, err = run(attack.name, SANDBOX)
    assert status == 0, err
    assert json.loads(out)[0]["payload"] == pytest.approx(
        json.loads(run("Law")[1])[0]["payload"], abs=0.02
    )


@pytest.mark.slow
@pytest.mark.skipif(sandbox_problem() != "", reason=sandbox_problem())
@pytest.mark.parametrize("name", ["hidden_daemon", "kills_itself"])
def test_ends_of_processes_are_the_same_in_a_sandbox(name):
    (attack,) = (candidate for candidate in ATTACKS if candidate.name == name)
    before = descendants()
    status, _, err = run(name, SANDBOX)
    assert status == attack.status, err
    assert attack.status == 0 or attack.now in err, err
    assert descendants() <= before


@pytest.mark.parametrize(
    "attack", [attack for attack in ATTACKS if attack.fast], ids=lambda attack: attack.name
)
def test_attack_on_an_evaluation_in_this_process(attack, monkeypatch):
    monkeypatch.chdir(FOLDER)
    settings = {"trajectory": {"name": "dwell-spatial", "duration": 0.05}, "resolution": 0.01}
    if attack.options:
        settings |= {"uncertainty": cheats.NOISE, "draws": 64}
    if attack.status:
        with pytest.raises(
            PolicyError, match=rf"^policy '{policy_name(attack.name)}'.*{re.escape(attack.now)}"
        ):
            evaluate_dlcc(policy_name(attack.name), ENV_ID, **settings)
        return
    result = evaluate_dlcc(policy_name(attack.name), ENV_ID, **settings)
    honest = evaluate_dlcc("cheats:Law", ENV_ID, **settings)
    assert result.payload == honest.payload
    assert result.violation == honest.violation
    assert result.details.margins == honest.details.margins


def test_every_policy_is_in_the_suite_and_on_the_page():
    policies = set()
    for module in (cheats, process_cheats):
        for name, value in vars(module).items():
            is_here = getattr(value, "__module__", "") in ("cheats", "process_cheats")
            if callable(value) and is_here and name.islower() and value.__doc__:
                policies.add(name)
    assert policies - {
        "policy",
        "model_payload",
        "filtered",
        "thresholded",
        "_better_after",
        "_folder",
    } == {attack.name for attack in ATTACKS + SANDBOXED}
    assert (FOLDER.parents[1] / "docs" / "attacks.md").read_text(encoding="utf-8") == page(), (
        "run python tests/attacks/suite.py > docs/attacks.md"
    )
