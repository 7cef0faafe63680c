"""The attacks on surveys: what each policy of survey_cheats.py gets without and with the protection
of a benchmark cell."""

from __future__ import annotations

import inspect
import tempfile
from dataclasses import dataclass
from unittest import mock

import survey_cheats

from cablebot_gym.benchmark.cells import SurveyCell
from cablebot_gym.evaluation.survey import _Search, survey
from cablebot_gym.trajectories import find_trajectory

CELL = SurveyCell(
    env_id="CableBot-Planar-v0",
    policy="survey_cheats:Honest",
    trajectory={"name": "loop-planar", "seed": [0, 1, 2]},
    payload_known=False,
    uncertainty="hardware",
    draws=19,
    seed=5,
)
"""The cell of all attacks, with the policy that they compare with."""

HONEST = 1.90
"""Mean payload of the honest policy [kg]."""

TOLERANCE = 0.02
"""Largest difference of a mean payload from that of the page, by rounding on other machines [kg]."""

HEAD = f"""\
The policies of this table attack a [survey](dlcc.md#how-a-survey-works) of three motions with 19 random robots each,
`hardware`, payload unknown, `{CELL.env_id}`. Each is an adaptive law, except for what the table says. The honest one
has {HONEST:.2f} kg on the mean over the motions. *Unprotected* is the payload in the process of the evaluation, without
repeated episodes and without robots alone; ± is by the secret order of the rows. Even there, none of them gains more
than some hundredths of a kilogram. A failed payload bounds a motion's payload from above for good, so a policy that
remembered its failures could not undo them.
"""


@dataclass(frozen=True)
class SurveyAttack:
    """A policy of survey_cheats.py, and its outcome in a cell of the benchmark."""

    name: str
    unprotected: float
    """Mean payload without protection [kg]."""
    error: str = ""
    """Words of the error of the cell; empty if it has payloads."""
    now: str = "payload of the honest policy"
    """What the payload of the cell is."""
    scatter: float = 0.0
    """Largest difference of the unprotected payload, which depends on the secret order of rows [kg]."""


ROWS = "depends on the other episodes of its batch"
AT_MOST = "at most the payload of the honest policy"

SURVEY_ATTACKS = (
    SurveyAttack("pooled_estimates", 1.93, ROWS),
    SurveyAttack("pooled_threshold", 1.79, now=AT_MOST),
    SurveyAttack("copied_actions", 1.3, ROWS, scatter=0.5),
    SurveyAttack("helped_weakest", 1.91, ROWS),
    SurveyAttack("expected_payload", 1.9),
    SurveyAttack("counted_batches", 1.76),
)


def unprotected(name):
    """Payloads of a policy in this process, without repeated episodes and without robots alone."""
    kind = CELL.robot.kind
    motions = [find_trajectory(dict(part.trajectory), kind) for part in CELL.parts]
    nothing = mock.Mock(return_value=None)
    with (
        tempfile.TemporaryDirectory() as folder,
        mock.patch.object(tempfile, "tempdir", folder),
        mock.patch.multiple(_Search, _repeat=nothing, _confirm_alone=nothing),
    ):
        return survey(
            getattr(survey_cheats, name),
            CELL.env_id,
            motions,
            robots=CELL.draws,
            payload_known=CELL.payload_known,
            uncertainty=CELL.uncertainty,
            seed=CELL.seed,
        ).payloads


def lines():
    """The section of the page docs/attacks.md."""
    text = [
        "",
        "## Surveys",
        "",
        HEAD,
        "| the policy … | unprotected | in a cell |",
        "|---|---|---|",
    ]
    for attack in SURVEY_ATTACKS:
        what = " ".join(inspect.getdoc(getattr(survey_cheats, attack.name)).split())
        now = f"“{attack.error}”" if attack.error else attack.now
        payload = f"{attack.unprotected:.2f}"
        if attack.scatter:
            payload += f" ± {attack.scatter:.2f}"
        text.append(f"| {what} | {payload} kg | {now} |")
    return text
