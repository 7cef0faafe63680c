"""The attack suite: what each policy of cheats.py and process_cheats.py scored before, and what happens to it now.

``python tests/attacks/suite.py > docs/attacks.md`` writes the page.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

FOLDER = Path(__file__).parent
sys.path.append(str(FOLDER))

import cheats  # noqa: E402
import process_cheats  # noqa: E402
import survey_suite  # noqa: E402

ENV_ID = "CableBot-Spatial-v0"
UNKNOWN = ("--payload-unknown",)
NOISE = ("--uncertainty", json.dumps(cheats.NOISE), "--draws", "1")
NOISE_DRAWS = (*NOISE[:-1], "64")
LIGHT = ("--uncertainty", json.dumps(cheats.LIGHT_NOISE), "--draws", "128")
DEADLINE = ("--deadline", "2")
SHORT_DEADLINE = ("--deadline", "0.5")
RESOLUTION = 0.01


@dataclass(frozen=True)
class Attack:
    """A policy of cheats.py or process_cheats.py, and its outcome under ``cablebot dlcc --isolate``."""

    name: str
    now: str = "payload of the honest policy"
    """What the payload is, or words of the error."""
    options: tuple[str, ...] = ()
    before: str = "not tried"
    """What the evaluation did before version 0.1, in this process."""
    fast: bool = False
    """Whether a fast test runs it in this process too."""

    @property
    def status(self):
        """Exit status of the run."""
        return int(self.now not in PAYLOADS)


LESS = "a smaller payload"
ALONE = "at most the payload of the honest policy"
SCORED = "scored, and marked as such"
PRICED = "payload of the honest policy; the leaderboard has its time"
PAYLOADS = (Attack.now, LESS, ALONE, SCORED, PRICED)
ROWS = "depends on the other episodes of its batch"
REPEATS = "is not reproducible"
STATUS_0 = "the run ended with status 0 and no result"
ABORTED = "the run ended with a traceback"

ATTACKS = (
    # leaks
    Attack("row_order", ROWS, UNKNOWN, before="4.03 kg (honest: 0.39 kg)"),
    Attack("batch_mean", ROWS, NOISE_DRAWS, before="4.03 kg (honest: fails unloaded)", fast=True),
    Attack("row_filter", ROWS, NOISE_DRAWS, before="3.98 kg (honest: fails unloaded)"),
    Attack("row_median", now=ALONE, options=LIGHT, before="4.29 kg, assured (honest: 4.11 kg)"),
    Attack(
        "row_filter_threshold",
        now=ALONE,
        options=LIGHT,
        before="4.29 kg, assured (honest: 4.11 kg)",
    ),
    Attack("row_filter_file", ROWS, NOISE_DRAWS, before="3.98 kg (honest: fails unloaded)"),
    Attack("known_seed", options=NOISE, now=LESS, before="4.03 kg (honest: fails unloaded)"),
    Attack("environment_search", before="the run ended with a traceback"),
    Attack("parent_arguments", before="it found the seed"),
    Attack("module_memory", before="4.12 kg (honest: 4.03 kg)"),
    Attack("file_memory", before="4.12 kg (honest: 4.03 kg)"),
    # shared state
    Attack(
        "slope_in_place",
        "it raised ValueError in reset(): output array is read-only",
        before="fails unloaded, and the next policy got other payloads",
        fast=True,
    ),
    Attack("slope_replaced", before="4.03 kg"),
    Attack("wide_bounds", before="4.12 kg (honest: 4.03 kg)", fast=True),
    Attack("short_motion", before="4.12 kg (honest: 4.03 kg)"),
    Attack("cached_motors", before="20 kg for the next, honest `fl`"),
    Attack("false_limits", before="20 kg, also for the next, honest `fl`"),
    Attack("other_judge", before="20 kg, also for the next, honest `fl`"),
    Attack("false_judge", before="20 kg, also for the next, honest `fl`"),
    Attack("false_numpy", before="4.03 kg"),
    Attack("overwritten", before="4.03 kg"),
    # episodes
    Attack("islands", now=LESS, before="3.81 kg"),
    Attack(
        "saturating",
        options=("--criterion", "paper"),
        now=SCORED,
        before="4.59 kg (honest: 1.77 kg)",
    ),
    Attack("booleans", "of type bool instead of real numbers", before="fails unloaded", fast=True),
    Attack("masked", "a masked array instead of real numbers", before="4.40 kg", fast=True),
    Attack("large_actions", before="4.03 kg"),
    Attack("lets_go", before="4.03 kg"),
    Attack("noisy", REPEATS, before="3.92 kg", fast=True),
    Attack("declared_noise", now=SCORED, before="4.01 kg"),
    Attack("fails_sometimes", REPEATS, before="3.94 kg (with 2 %)"),
    Attack("first_row", ROWS, before="fails unloaded", fast=True),
    Attack("slow", now=PRICED, before="4.03 kg"),
    # processes
    Attack(
        "hangs",
        "it used more than 2 s of processor time, the deadline of a call",
        DEADLINE,
        before="the run never ended",
    ),
    Attack(
        "hangs_in_reset",
        "it did not answer within 50 s",
        SHORT_DEADLINE,
        before="the run never ended",
    ),
    Attack(
        "many_processes",
        "it used more than 2 s of processor time, the deadline of a call",
        DEADLINE,
        before="refused by the clock on two processors",
    ),
    Attack("stops_itself", "it did not answer within 20 s", DEADLINE, before="the run never ended"),
    Attack("sys_exit", "it raised SystemExit: 0", before=STATUS_0, fast=True),
    Attack("exit_in_factory", "the factory raised SystemExit: 0", before=STATUS_0, fast=True),
    Attack("os_exit", "its process ended with exit status 0", before=STATUS_0),
    Attack("kills_itself", "its process was ended by SIGKILL", before="the run was killed"),
    Attack("crashes", "its process was ended by SIGSEGV", before="the run crashed"),
    Attack(
        "interrupts",
        "it raised KeyboardInterrupt",
        before="the run was interrupted (status 130)",
    ),
    Attack(
        "long_error",
        "it raised RuntimeError: lost lost",
        before="the run did not end within 25 s",
    ),
    Attack("own_error", "it raised Own", before=ABORTED, fast=True),
    Attack("false_index", "it lost the row", before=ABORTED, fast=True),
    Attack("recursion", "it raised RecursionError", fast=True, before="refused"),
    Attack("memory", "MemoryError"),
    Attack(
        "ten_million",
        "it returned the action 1e+07; actions must be within ± 1e+06",
        before="status 2",
        fast=True,
    ),
    Attack("nan", "it returned NaN or infinity", before="refused", fast=True),
    Attack("wrong_shape", "it returned shape", before="refused", fast=True),
    Attack("strings", "instead of real numbers", before="refused", fast=True),
    Attack("huge", "it returned shape", before="refused"),
    Attack("lazy", "it returned Lazy instead of real numbers", before=STATUS_0, fast=True),
    Attack("forks", before="the process survived"),
    Attack("daemon", before="the process survived"),
    Attack("hidden_daemon", before="the process survived"),
    Attack("threads", before="the run never ended"),
    Attack("prints", before="30 MB on the outputs of the run"),
    Attack("garbage", "its process closed its pipe or sent invalid data"),
    Attack("closes", "its process ended with exit status 0"),
    # callables with state
    Attack("shared_memory", ROWS, before="4.03 kg"),
    Attack("instances"),
)


FOUND = "it raised RuntimeError in reset(): found"
SANDBOX = ("--sandbox",)

SANDBOXED = (
    Attack("user_file", FOUND),
    Attack("other_processes", FOUND),
    Attack("network", FOUND),
    Attack("kept_files", FOUND),
    Attack("kept_keys", FOUND),
)
"""Attacks that need a sandbox, with their outcome without one. In a sandbox the payload is the
honest one."""


def module(name):
    """The module of a policy."""
    if hasattr(cheats, name):
        return cheats
    return process_cheats


def policy_name(name):
    """A policy as on the command line."""
    return f"{module(name).__name__}:{name}"


@cache
def run(name, options=()):
    """Exit status, standard output and standard error of ``cablebot dlcc --isolate`` for a policy
    of the attacks."""
    criterion = () if "--criterion" in options else ("--criterion", "task")
    command = [
        sys.executable,
        "-m",
        "cablebot_gym.cli.app",
        "dlcc",
        ENV_ID,
        "--policy",
        policy_name(name),
        "--isolate",
    ]
    settings = [
        "--json",
        "--payload-max",
        "10",
        "--resolution",
        str(RESOLUTION),
        *criterion,
        *options,
    ]
    with tempfile.TemporaryDirectory() as folder, socket.create_server(("127.0.0.1", 0)) as server:
        Path(folder, "secret.json").write_text("{}", encoding="utf-8")
        ended = subprocess.run(
            [*command, *settings],
            cwd=FOLDER,
            capture_output=True,
            text=True,
            timeout=1200,  # draws alone start a process each
            env=os.environ
            | {"RUN_SEED": "7", "TMPDIR": folder, "LC_ATTACK": str(server.getsockname()[1])},
        )
    return ended.returncode, ended.stdout, ended.stderr


SANDBOX_HEAD = """\
These policies do what only a sandbox closes. Each fails with a message when its attack succeeds.
"""


def _what(attack):
    """What the policy of an attack does, in one line."""
    return " ".join(getattr(module(attack.name), attack.name).__doc__.split())


def page():
    """The page docs/attacks.md."""
    lines = [(FOLDER / "attacks_head.md").read_text(encoding="utf-8")]
    lines += ["| the policy … | before | status | now |", "|---|---|---|---|"]
    for attack in ATTACKS:
        text = f"“{attack.now}”" if attack.status else attack.now
        lines.append(f"| {_what(attack)} | {attack.before} | {attack.status} | {text} |")
    lines += [
        "",
        "## In the sandbox",
        "",
        SANDBOX_HEAD,
        "| the policy … | with `--isolate` | and `--sandbox` |",
    ]
    lines.append("|---|---|---|")
    for attack in SANDBOXED:
        lines.append(f"| {_what(attack)} | “{attack.now}” | {Attack.now} |")
    lines += survey_suite.lines()
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(), end="")
