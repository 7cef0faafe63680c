"""Seeds of a run, and boards: motions and evaluation seed follow from a commitment and from a public
value that exists only later."""

from __future__ import annotations

import hashlib
import json
import re
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from cablebot_gym.benchmark.cells import canonical
from cablebot_gym.benchmark.policy_source import in_package, policy_source
from cablebot_gym.policies.spec import POLICY_SUFFIXES
from cablebot_gym.trajectories import FIRST_HELD_OUT_SEED
from cablebot_gym.utils.checks import whole
from cablebot_gym.utils.code_hash import file_digest
from cablebot_gym.utils.files import atomic_write_text, read_text
from cablebot_gym.utils.foreign import foreign_json, foreign_object

RUN = "run.json"
"""Name of the file with the evaluation seed in a results folder without a board."""

BOARD, SALT, VALUE = "board.json", "secret.json", "value.json"
"""Names of the files of a board in the results folder: public commitment, its salt, which is secret
until the results are published, and the public value, from the first start on."""

MAX_TEXT = 1024
"""Largest number of characters of the name and of the value of a beacon."""

_BITS = 128
_SEED_BITS = 53
"""Motion seeds have 53 bits, so that every JSON parser reads them exactly."""


def run_seed(out: Path, seed: int | None = None) -> int:
    """Evaluation seed of the runs in a results folder without a board: 128 bits from the operating
    system, drawn once and stored.

    Args:
        out: results folder.
        seed: seed that replaces the stored one; None for the stored one.

    Raises:
        ValueError: if the stored file is damaged.
    """
    path = out / RUN
    if seed is None and path.exists():
        return whole("seed", _read(path).get("seed"))
    seed = secrets.randbits(_BITS) if seed is None else seed
    atomic_write_text(path, json.dumps({"seed": seed}) + "\n")
    return seed


def utc_now() -> datetime:
    """The present time. Tests replace it."""
    return datetime.now(UTC)


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
    beacon: str
    """Name of the public value, such as a round of a randomness beacon."""
    beacon_date: str
    """Time from which the public value exists, ISO 8601."""
    commitment: str
    """SHA-256 of all fields but this one and the public value; published before that value
    exists."""
    salt: str | None = None
    """128 random bits in hexadecimal; None before they are published."""
    beacon_value: str | None = None
    """The public value, see :func:`normalised_value`; None before the first start."""

    def check(self) -> None:
        """Recomputes the commitment from the published salt.

        Raises:
            ValueError: if the salt is not published, or if a field differs from the commitment.
        """
        if self.salt is None:
            raise ValueError(f"the salt of board {self.version!r} is not published")
        if self.digest() != self.commitment:
            raise ValueError(f"board {self.version!r} does not match its commitment")

    def digest(self) -> str:
        """SHA-256 of all fields except for the commitment and the public value."""
        data = asdict(self)
        del data["commitment"], data["beacon_value"]
        return _sha256(canonical(data))

    def check_started(self) -> None:
        """Checks the commitment, and that there is a public value.

        Raises:
            ValueError: see :meth:`check`; if there is no public value, or if it is not normalised.
        """
        self.check()
        if self.beacon_value is None:
            raise ValueError(
                f"board {self.version!r} has no public value yet: when {self.beacon} is public "
                f"(from {self.beacon_date} on), add --beacon-value TEXT"
            )
        if self.beacon_value != normalised_value(str(self.beacon_value)):
            raise ValueError(f"the public value of board {self.version!r} is not normalised")

    @property
    def secret(self) -> str:
        """SHA-256 of the lines public value, salt and commitment. It determines motions and
        evaluation seed.

        Raises:
            ValueError: see :meth:`check_started`.
        """
        self.check_started()
        return _sha256(f"{self.beacon_value}\n{self.salt}\n{self.commitment}\n")

    @property
    def evaluation_seed(self) -> int:
        """Seed of all noise and draws: the first 128 bits of the SHA-256 of the secret and the word
        ``evaluation``.

        Raises:
            ValueError: see :meth:`check_started`.
        """
        return int(_sha256(f"{self.secret}:evaluation")[: _BITS // 4], 16)

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
            ValueError: see :meth:`check_started`; if the board has another number of motions.
        """
        secret = self.secret
        if count != self.motions:
            raise ValueError(
                f"board {self.version!r} was committed with {self.motions} motions, not {count}"
            )
        seeds = []
        for index in range(count):
            digest = int(_sha256(f"{secret}:{env_id}:{index}"), 16)
            seeds.append(FIRST_HELD_OUT_SEED + digest % (2**_SEED_BITS - FIRST_HELD_OUT_SEED))
        return seeds


def commit(
    out: Path,
    version: str,
    policies: Mapping[str, Sequence[str]],
    motions: int,
    *,
    beacon: str,
    beacon_date: str,
    now: datetime,
) -> Board:
    """Draws the salt of a new board, writes it and the public commitment to a folder, and returns
    the board.

    Args:
        out: results folder.
        version: name of the version.
        policies: names of the policies by environment id.
        motions: number of hidden motions of each environment.
        beacon: name of a public value that nobody knows yet.
        beacon_date: date or time from which the value exists, ISO 8601; UTC without a time zone.
        now: the present time.

    Raises:
        ValueError: if the folder has a board, if there are no hidden motions, if the name of the
            value is empty, or if its date is invalid or not in the future.
    """
    if motions < 1:
        raise ValueError("only a suite with hidden motions has a board: add --suite ranked")
    for name in (BOARD, SALT, VALUE):
        if (out / name).exists():
            raise ValueError(f"{str(out)!r} has a board; choose another folder")
    beacon = _line("name of the beacon", beacon)
    time = _beacon_time(beacon_date)
    if time <= now:
        raise ValueError(
            f"--beacon-date {beacon_date} is not in the future, so the public value may be known: "
            "choose a value that exists only later"
        )
    entries = {env_id: list(names) for env_id, names in policies.items()}
    digests = {
        name: policy_digest(name)
        for name in sorted({name for names in entries.values() for name in names})
    }
    board = Board(
        version=version,
        policies=digests,
        entries=entries,
        motions=motions,
        beacon=beacon,
        beacon_date=time.isoformat(),
        commitment="",
        salt=f"{secrets.randbits(_BITS):032x}",
    )
    board = replace(board, commitment=board.digest())
    _write(out, board)
    return board


def _write(out: Path, board: Board) -> None:
    """Writes the public commitment of a board, and its salt to a file of its owner."""
    out.mkdir(parents=True, exist_ok=True)
    (out / SALT).touch(mode=0o600)
    (out / SALT).write_text(json.dumps({"salt": board.salt}) + "\n", encoding="utf-8")
    public = asdict(board)
    del public["salt"], public["beacon_value"]
    atomic_write_text(out / BOARD, json.dumps(public, indent=1) + "\n")


def read_board(out: Path) -> Board:
    """The board that :func:`commit` wrote to a folder, with its salt, and with its public value if
    it has started.

    Raises:
        ValueError: if there is none, or if it does not match its commitment.
    """
    if not (out / BOARD).exists():
        raise ValueError(
            f"{str(out)!r} has no board: commit one first, with the option --commit VERSION"
        )
    value = {}
    if (out / VALUE).exists():
        value = _read(out / VALUE)
    try:
        board = Board(**_read(out / BOARD), **_read(out / SALT), **value)
    except TypeError as error:
        raise ValueError(
            f"the board in {str(out)!r} is damaged or of another version ({error})"
        ) from error
    board.check()
    return board


def start(out: Path, value: str | None, *, now: datetime) -> Board:
    """The board in a folder with its public value, which the first start stores.

    Args:
        out: results folder.
        value: the public value; None for the stored one.
        now: the present time.

    Raises:
        ValueError: see :func:`read_board`; if the board has not started and the value is missing or
            cannot exist yet; if it is another one than the stored one.
    """
    board = read_board(out)
    if value is not None:
        value = normalised_value(value)
        if board.beacon_value is None:
            if now < _beacon_time(board.beacon_date):
                raise ValueError(
                    f"{board.beacon} exists from {board.beacon_date} on: start the board then"
                )
            board = replace(board, beacon_value=value)
            atomic_write_text(out / VALUE, json.dumps({"beacon_value": value}) + "\n")
        if value != board.beacon_value:
            raise ValueError(
                f"board {board.version!r} has started with the public value "
                f"{board.beacon_value!r}, not {value!r}. Leave out --beacon-value to resume. If "
                f"the first is not {board.beacon}, delete {str(out / VALUE)!r} and start again"
            )
    board.check_started()
    return board


def normalised_value(text: str) -> str:
    """A public value as it is hashed: in one line with single spaces; a hexadecimal number in lower
    case.

    Raises:
        ValueError: if it is empty, too long or not printable.
    """
    value = _line("value of the beacon", text)
    if re.fullmatch("(0x)?[0-9a-f]+", value, re.IGNORECASE):
        value = value.lower()
    return value


def policy_digest(policy: str) -> str:
    """SHA-256 of the bytes of all modules and data files of a policy, and of the modules of this
    package they import.

    Raises:
        ValueError: if the policy is a module outside a package, whose data files are unknown.
    """
    modules, data = policy_source(policy)
    if not policy.endswith(POLICY_SUFFIXES) and not any(in_package(module) for module in modules):
        raise ValueError(
            f"the data files of policy {policy!r} are unknown: put its module into a package"
        )
    return file_digest(*modules, data=data)


def _read(path: Path) -> dict[str, Any]:
    try:
        return foreign_object("its content", foreign_json(read_text(path)))
    except (OSError, ValueError) as error:
        raise ValueError(f"{str(path)!r} is missing or damaged ({error}); restore it") from error


def _line(what: str, text: str) -> str:
    """A text in one line with single spaces."""
    line = " ".join(text.split())
    if not line or len(line) > MAX_TEXT or not line.isprintable():
        raise ValueError(
            f"the {what} is invalid: type 1 to {MAX_TEXT} printable characters, as published"
        )
    return line


def _beacon_time(text: str) -> datetime:
    """The time that a text means, UTC."""
    try:
        time = datetime.fromisoformat(text)
        if time.tzinfo is None:
            time = time.replace(tzinfo=UTC)
        return time.astimezone(UTC)
    except (ValueError, OverflowError) as error:
        raise ValueError(
            f"date {text!r} of the beacon is invalid: type one such as 2027-01-04 or "
            "2027-01-04T12:00Z"
        ) from error


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
