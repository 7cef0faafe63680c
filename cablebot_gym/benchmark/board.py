"""Seeds of a run, and boards: hidden motions that are committed together with the policies before
they are drawn."""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from cablebot_gym.benchmark.cells import canonical
from cablebot_gym.benchmark.policy_source import in_package, policy_source
from cablebot_gym.policies.entry import is_entry
from cablebot_gym.trajectories import FIRST_HELD_OUT_SEED
from cablebot_gym.utils.code_hash import file_digest
from cablebot_gym.utils.files import atomic_write_text, read_text

RUN, BOARD, SECRET = "run.json", "board.json", "secret.json"
"""Names of the files in the results folder: evaluation seed, public commitment, and secret of the
hidden motions."""

_BITS = 128
_SEED_BITS = 53
"""Motion seeds have 53 bits, so that every JSON parser reads them exactly."""


def run_seed(out: Path, seed: int | None = None) -> int:
    """Evaluation seed of the runs in a results folder: 128 bits from the operating system, drawn
    once and stored.

    Args:
        out: results folder.
        seed: seed that replaces the stored one; None for the stored one.

    Raises:
        ValueError: if the stored file is damaged.
    """
    path = out / RUN
    if seed is None and path.exists():
        return int(_read(path)["seed"])
    seed = secrets.randbits(_BITS) if seed is None else seed
    atomic_write_text(path, json.dumps({"seed": seed}) + "\n")
    return seed


@dataclass(frozen=True, kw_only=True)
class Board:
    """A version of the leaderboard with hidden motions."""

    version: str
    """Name of the version."""
    policies: Mapping[str, str]
    """SHA-256 of the code and weights of each policy, by name."""
    entries: Mapping[str, Sequence[str]]
    """Names of the policies that are evaluated on each environment, by environment id."""
    motions: int
    """Number of hidden motions of each environment."""
    commitment: str
    """SHA-256 of all other fields; published before the motions are drawn."""
    secret: str | None = None
    """128 random bits that determine the hidden motions, in hexadecimal; None before they are
    published."""
    salt: str | None = None
    """128 further random bits of the commitment, in hexadecimal; None before they are published."""

    def check(self) -> None:
        """Recomputes the commitment from the published secret.

        Raises:
            ValueError: if the secret is not published, or if a field differs from the commitment.
        """
        if self.secret is None or self.salt is None:
            raise ValueError(f"the secret of board {self.version!r} is not published")
        if self.digest() != self.commitment:
            raise ValueError(f"board {self.version!r} does not match its commitment")

    def digest(self) -> str:
        """SHA-256 of all fields except for the commitment."""
        data = {name: value for name, value in asdict(self).items() if name != "commitment"}
        return hashlib.sha256(canonical(data).encode()).hexdigest()

    def check_policies(self, names: Sequence[str]) -> None:
        """Checks that policies are those of the commitment, with the present bytes of their files.

        Raises:
            ValueError: if a policy is missing in the commitment, or if its code or weights have
                changed.
        """
        changed = [name for name in names if self.policies.get(name) != policy_digest(name)]
        if changed:
            raise ValueError(
                f"board {self.version!r} was committed without the present {', '.join(changed)}: choose other policies "
                "or commit a new board in another folder"
            )

    def seeds(self, env_id: str, count: int) -> list[int]:
        """Seeds of the hidden motions of an environment: all of them are held out, and none
        repeats.

        Raises:
            ValueError: see :meth:`check`; if the board has another number of motions.
        """
        self.check()
        if count != self.motions:
            raise ValueError(
                f"board {self.version!r} was committed with {self.motions} motions, not {count}"
            )
        words = (f"{self.secret}:{self.salt}:{env_id}:{index}" for index in range(count))
        digests = (int.from_bytes(hashlib.sha256(word.encode()).digest()) for word in words)
        return [
            FIRST_HELD_OUT_SEED + digest % (2**_SEED_BITS - FIRST_HELD_OUT_SEED)
            for digest in digests
        ]


def commit(out: Path, version: str, policies: Mapping[str, Sequence[str]], motions: int) -> Board:
    """Draws the secret of a new board, writes it and the public commitment to a folder, and returns
    the board.

    Args:
        out: results folder.
        version: name of the version.
        policies: names of the policies by environment id.
        motions: number of hidden motions of each environment.

    Raises:
        ValueError: if the folder has a board, or if there are no hidden motions.
    """
    if motions < 1:
        raise ValueError("only a suite with hidden motions has a board: add --suite ranked")
    for name in (BOARD, SECRET):
        if (out / name).exists():
            raise ValueError(f"{str(out)!r} has a board; choose another folder")
    entries = {env_id: list(names) for env_id, names in policies.items()}
    digests = {
        name: policy_digest(name)
        for name in sorted({name for names in entries.values() for name in names})
    }
    secret, salt = (f"{secrets.randbits(_BITS):032x}" for _ in range(2))
    board = Board(
        version=version,
        policies=digests,
        entries=entries,
        motions=motions,
        commitment="",
        secret=secret,
        salt=salt,
    )
    board = replace(board, commitment=board.digest())
    out.mkdir(parents=True, exist_ok=True)
    (out / SECRET).touch(mode=0o600)
    (out / SECRET).write_text(
        json.dumps({"secret": secret, "salt": salt}, indent=1) + "\n", encoding="utf-8"
    )
    public = {
        name: value for name, value in asdict(board).items() if name not in ("secret", "salt")
    }
    atomic_write_text(out / BOARD, json.dumps(public, indent=1) + "\n")
    return board


def read_board(out: Path) -> Board:
    """The board that :func:`commit` wrote to a folder, with its secret.

    Raises:
        ValueError: if there is none, or if it does not match its commitment.
    """
    if not (out / BOARD).exists():
        raise ValueError(
            f"{str(out)!r} has no board: commit one first, with the option --commit VERSION"
        )
    try:
        board = Board(**_read(out / BOARD), **_read(out / SECRET))
    except TypeError as error:
        raise ValueError(
            f"the board in {str(out)!r} is damaged or of another version ({error})"
        ) from error
    board.check()
    return board


def policy_digest(policy: str) -> str:
    """SHA-256 of the bytes of all modules and data files of a policy, and of the modules of this
    package they import.

    Raises:
        ValueError: if the policy is a module outside a package, whose data files are unknown.
    """
    modules, data = policy_source(policy)
    if (
        not policy.endswith(".zip")
        and not is_entry(policy)
        and not any(in_package(module) for module in modules)
    ):
        raise ValueError(
            f"the data files of policy {policy!r} are unknown: put its module into a package"
        )
    return file_digest(*modules, data=data)


def _read(path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(read_text(path)))
    except (OSError, ValueError, TypeError) as error:
        raise ValueError(f"{str(path)!r} is missing or damaged ({error}); restore it") from error
