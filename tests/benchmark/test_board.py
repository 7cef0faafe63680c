"""Boards: the hidden motions and the policies are fixed by a commitment; stored promises are tried
again."""

import hashlib
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from cablebot_gym.benchmark import board as boards
from cablebot_gym.benchmark.cells import PolicyCell
from cablebot_gym.benchmark.engine import local
from cablebot_gym.benchmark.leaderboard import Results, markdown
from cablebot_gym.benchmark.records import Record
from cablebot_gym.benchmark.store import Store
from cablebot_gym.benchmark.suites import Block, Suite, suite_cells
from cablebot_gym.benchmark.verification import Confirmation, broken, confirm
from cablebot_gym.trajectories import FIRST_HELD_OUT_SEED

PLANAR = "CableBot-Planar-v0"
SPATIAL = "CableBot-Spatial-v0"


@pytest.fixture
def policy(module):
    """A policy in a package; the function writes it again."""

    def write(text):
        for name, content in (("__init__.py", ""), ("law.py", text), ("weights.bin", text)):
            module(f"toy_board/{name}", content)
        return "toy_board.law:make"

    return write


def hidden(motions):
    """A suite of hidden motions."""
    return Suite(
        name="s",
        summary="",
        env_ids=(PLANAR,),
        blocks=(Block(motion="hidden", motions=motions),),
        best_known=False,
    )


NOW = datetime(2027, 1, 1, tzinfo=UTC)
LATER = datetime(2027, 1, 4, 12, 0, tzinfo=UTC)
VALUE = "8f3c02"


def commit(folder, policies, motions=3, **changes):
    """A board that is committed before its public value exists."""
    beacon = {"beacon": "drand quicknet round 7", "beacon_date": "2027-01-04T12:00Z", "now": NOW}
    return boards.commit(folder, "1", policies, motions, **(beacon | changes))


def started(folder, policies, motions=3, value=VALUE):
    """A board that is committed and started."""
    commit(folder, policies, motions)
    return boards.start(folder, value, now=LATER)


def test_salt_has_a_file_of_its_own(tmp_path, policy):
    name = policy("def make(robot): ...\n")
    board = commit(tmp_path, {PLANAR: [name]})
    assert board.salt not in (tmp_path / boards.BOARD).read_text()
    assert (tmp_path / boards.SALT).stat().st_mode & 0o077 == 0
    assert len(board.salt) == 32
    assert boards.read_board(tmp_path) == board
    with pytest.raises(ValueError, match="has a board"):
        commit(tmp_path, {PLANAR: [name]})
    with pytest.raises(ValueError, match="add --suite ranked"):
        commit(tmp_path / "other", {PLANAR: [name]}, motions=0)


def test_commitment_binds_every_field(tmp_path, policy):
    name = policy("def make(robot): ...\n")
    board = commit(tmp_path, {PLANAR: [name]})
    for changes in (
        {"salt": f"{int(board.salt, 16) ^ 1:032x}"},
        {"version": "2"},
        {"policies": {name: "0" * 64}},
        {"motions": 19},
        {"entries": {SPATIAL: [name]}},
        {"beacon": "drand quicknet round 8"},
        {"beacon_date": "2027-01-05T00:00:00+00:00"},
    ):
        with pytest.raises(ValueError, match="does not match its commitment"):
            replace(board, **changes).check()
    with pytest.raises(ValueError, match="not published"):
        replace(board, salt=None).check()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"beacon_date": "2027-01-01"}, "not in the future"),
        ({"beacon_date": "2026-12-31T23:00-00:30"}, "not in the future"),
        ({"beacon_date": "next week"}, "type one such as"),
        ({"beacon_date": "9999-12-31T23:59-10:00"}, "type one such as"),
        ({"beacon": "  "}, "name of the beacon is invalid"),
        ({"beacon": "x" * 2000}, "name of the beacon is invalid"),
    ],
)
def test_commitment_needs_a_public_value_of_the_future(tmp_path, changes, words):
    with pytest.raises(ValueError, match=words):
        commit(tmp_path, {}, **changes)
    assert not (tmp_path / boards.BOARD).exists()


def test_board_starts_with_one_public_value_that_exists(tmp_path):
    commit(tmp_path, {})
    with pytest.raises(ValueError, match="when drand quicknet round 7 is public"):
        boards.start(tmp_path, None, now=LATER)
    with pytest.raises(ValueError, match="start the board then"):
        boards.start(tmp_path, VALUE, now=NOW)
    for invalid in ("", " \n", "x" * 2000, "a\0b"):
        with pytest.raises(ValueError, match="value of the beacon is invalid"):
            boards.start(tmp_path, invalid, now=LATER)
    assert not (tmp_path / boards.VALUE).exists()
    board = boards.start(tmp_path, " 8F3C02\n", now=LATER)
    assert board.beacon_value == VALUE
    assert boards.start(tmp_path, VALUE, now=LATER) == board
    assert boards.start(tmp_path, None, now=LATER) == board
    with pytest.raises(ValueError, match="Leave out --beacon-value to resume"):
        boards.start(tmp_path, "8f3c03", now=LATER)


def test_secret_is_the_hash_that_the_documentation_gives(tmp_path):
    board = started(tmp_path, {})
    lines = "".join(f"{line}\n" for line in (VALUE, board.salt, board.commitment))
    secret = hashlib.sha256(lines.encode()).hexdigest()
    assert board.secret == secret
    seed = hashlib.sha256(f"{secret}:evaluation".encode()).digest()[:16]
    assert board.evaluation_seed == int.from_bytes(seed)


def test_public_value_keeps_the_case_of_words():
    assert boards.normalised_value(" 6 aus 49:\t3  7\n") == "6 aus 49: 3 7"
    assert boards.normalised_value("0xAB") == "0xab"


def test_policy_that_changes_after_the_commitment_is_refused(tmp_path, policy, module):
    name = policy("def make(robot): ...\n")
    board = commit(tmp_path, {PLANAR: [name, "fl"]})
    board.check_policies([name, "fl"])
    policy('"""The gains are here, in a docstring: 1, 2."""\ndef make(robot): ...\n')
    with pytest.raises(ValueError, match=r"without the present toy_board\.law:make"):
        board.check_policies([name, "fl"])
    policy("def make(robot): ...\n")
    board.check_policies([name, "fl"])
    module("toy_board/weights.bin", "other weights")
    with pytest.raises(ValueError, match=r"without the present toy_board\.law:make"):
        board.check_policies([name])
    with pytest.raises(ValueError, match="without the present adaptive"):
        board.check_policies(["adaptive"])
    module("toy_flat.py", "def make(robot): ...  # weights.bin\n")
    module("weights.bin", "weights")
    with pytest.raises(ValueError, match="put its module into a package"):
        commit(tmp_path / "other", {PLANAR: ["toy_flat:make"]})


def test_hidden_motions_depend_on_secret_and_environment(tmp_path):
    board = started(tmp_path, {}, 20)
    seeds = board.seeds(PLANAR, 20)
    assert len({*seeds, *board.seeds(SPATIAL, 20)}) == 40
    for seed in seeds:
        assert FIRST_HELD_OUT_SEED <= seed < 2**53
    with pytest.raises(ValueError, match="committed with 20 motions, not 2"):
        board.seeds(PLANAR, 2)
    for other in (started(tmp_path / "salt", {}, 20), replace(board, beacon_value="8f3c03")):
        assert not set(other.seeds(PLANAR, 20)) & set(seeds)
        assert other.evaluation_seed != board.evaluation_seed
    cells = suite_cells(hidden(20), {PLANAR: ("fl",)}, seed=2**127, board=board)
    assert [cell.trajectory["seed"] for cell in cells.values()] == seeds
    assert {cell.seed for cell in cells.values()} == {2**127}
    with pytest.raises(ValueError, match="--commit VERSION"):
        suite_cells(hidden(20), {PLANAR: ("fl",)})


def test_evaluation_seed_of_a_folder_is_drawn_once(tmp_path):
    seed = boards.run_seed(tmp_path)
    assert boards.run_seed(tmp_path) == seed
    assert boards.run_seed(tmp_path / "other") != seed
    assert boards.run_seed(tmp_path, 7) == boards.run_seed(tmp_path) == 7
    (tmp_path / boards.RUN).write_text("{")
    with pytest.raises(ValueError, match="missing or damaged"):
        boards.run_seed(tmp_path)


def results_of(board, seed=None, motions_of=None):
    """Results of ``fl`` on a board, with its own evaluation seed and motions by default."""
    seed = board.evaluation_seed if seed is None else seed
    cells = suite_cells(hidden(3), {PLANAR: ("fl",)}, seed=seed, board=motions_of or board)
    records = [record(cell) for cell in cells.values()]
    return Results(suite="s", command="", records=records, board=board)


def redrawn_seed(board, folder):
    results_of(board, seed=board.evaluation_seed + 1).check_board()


def ground_secret(board, folder):
    pleasant = started(folder / "pleasant", {PLANAR: ["fl"]})
    results_of(board, board.evaluation_seed, pleasant).check_board()


def changed_salt(board, folder):
    honest = results_of(board)
    replace(honest, board=replace(board, salt="0" * 32)).check_board()


def changed_value(board, folder):
    honest = results_of(board)
    replace(honest, board=replace(board, beacon_value="0")).check_board()


def value_of_no_source(board, folder):
    results_of(replace(board, beacon_value="0")).check_board(VALUE)


def rewritten_cell(board, folder):
    first, *_ = results_of(board).records
    honest = replace(first, source=first.cell.source)
    messages = []
    Store(folder, say=messages.append, key=board.salt).add(honest)
    forged = replace(honest, result={"payload": 9.0})
    Store(folder, say=messages.append).add(forged)  # whoever has no salt
    assert Store(folder, say=messages.append, key=board.salt).find(honest.cell) is None
    raise ValueError(*messages)


def easier_motion(board, folder):
    first, *others = results_of(board).records
    trajectory = {"name": "loop-planar", "seed": 12345}
    easy = replace(first, cell=replace(first.cell, trajectory=trajectory))
    replace(results_of(board), records=[easy, *others]).check_board()


def omitted_motion(board, folder):
    replace(results_of(board), records=results_of(board).records[:2]).check_board()


def omitted_policy(board, folder):
    more = started(folder / "more", {PLANAR: ["fl", "robust"]})
    results_of(more).check_board()


@pytest.mark.parametrize(
    ("fraud", "words"),
    [
        (redrawn_seed, "the evaluation seed of fl on CableBot-Planar-v0 is not that of board"),
        (ground_secret, "the motions of fl on CableBot-Planar-v0 are not those of board"),
        (changed_salt, "does not match its commitment"),
        (changed_value, "the evaluation seed of fl on CableBot-Planar-v0 is not that of board"),
        (value_of_no_source, "has the public value '0', not '8f3c02'"),
        (rewritten_cell, "is damaged; its cell is computed again"),
        (easier_motion, "are not those of board"),
        (omitted_motion, "are not those of board"),
        (omitted_policy, "differ in robust on CableBot-Planar-v0"),
    ],
)
def test_dishonest_board_is_refused(tmp_path, fraud, words):
    board = started(tmp_path, {PLANAR: ["fl"]})
    results_of(board).check_board(VALUE)
    with pytest.raises(ValueError, match=words):
        fraud(board, tmp_path)


def test_environments_that_are_due_are_named(tmp_path):
    board = started(tmp_path, {PLANAR: ["fl"], SPATIAL: ["robust"]})
    results = results_of(board)
    results.check_board(VALUE)
    assert results.due == [SPATIAL]
    assert f"not computed yet: `{SPATIAL}`" in markdown(replace(results, suite="ranked"))


def test_honest_cell_of_a_board_is_found_again(tmp_path):
    board = started(tmp_path, {PLANAR: ["fl"]})
    honest, *_ = results_of(board).records
    store = Store(tmp_path, say=pytest.fail, key=board.salt)
    store.add(replace(honest, source=honest.cell.source))
    assert store.find(honest.cell).result == honest.result


# --- fresh draws ------------------------------------------------------------------------------------------------------


def record(cell, payload=1.0, **result):
    outcome = {"payload": payload, "assured": True, **result}
    return Record(cell=cell, source="a", versions={}, result=outcome, seconds=0.0)


def cell(**more):
    conditions = {
        "env_id": PLANAR,
        "trajectory": {"name": "circle-planar"},
        "policy": "fl",
        "uncertainty": "table6",
    }
    return PolicyCell(**(conditions | {"draws": 512} | more))


def rates(*values, is_surveyed=False):
    return [
        Confirmation(
            cell=cell(draws=19),
            payload=1.0,
            success_rate=value,
            draws=1024,
            is_surveyed=is_surveyed,
        )
        for value in values
    ]


def test_promises_hold_for_18_of_20_cells_and_none_far_below():
    assert broken(rates(*[0.96] * 18, 0.94, 0.931)) == ""
    assert "only 17 of 20" in broken(rates(*[0.96] * 17, 0.94, 0.94, 0.94))
    assert "more than 2% below" in broken(rates(*[0.99] * 19, 0.929))


@pytest.mark.parametrize(("motions", "excess"), [(2, 0.4), (20, 0.08)])
def test_surveyed_payloads_keep_their_promise_on_the_mean(motions, excess):
    """The weakest of 19 robots just carries them: single motions may be far below 95 %, and two of
    them together as well."""
    rng = np.random.default_rng(0)
    probabilities = rng.beta(19, 1, (1000, motions))
    measured = rng.binomial(1024, probabilities) / 1024
    alarms = [broken(rates(*board, is_surveyed=True)) for board in measured]
    assert sum(map(bool, alarms)) <= 5
    too_heavy = broken(rates(*(measured[0] - excess), is_surveyed=True))
    assert "on the mean; honest ones are so rarely in" in too_heavy


def test_fresh_draws_tell_a_kept_promise_from_a_broken_one(inline):
    feasible = record(cell(), 0.3)
    too_much = record(cell(policy="fl:gains=tuned"), 2.1)
    unpromised = [
        record(cell(uncertainty=None, draws=1), assured=None),
        record(cell(policy="robust"), None),
        record(cell(seed=1), 9.9, assured=False),
    ]
    confirmations = confirm(
        [feasible, too_much, *unpromised], local(1), cells=20, draws=60, seed=5, say=print
    )
    by_policy = {confirmation.cell.policy: confirmation for confirmation in confirmations}
    assert set(by_policy) == {"fl", "fl:gains=tuned"}
    assert by_policy["fl"].success_rate == 1.0
    assert by_policy["fl:gains=tuned"].success_rate < 0.5
    assert "2.100 kg in at least 95% of all draws" in str(by_policy["fl:gains=tuned"])
    with pytest.raises(ValueError, match="no payload under uncertainty"):
        list(confirm(unpromised, local(1), cells=20, draws=60, seed=5, say=print))


def test_verification_names_policies_that_left_the_product_and_tries_the_others():
    """A stored board keeps their rows."""
    messages = []
    records = [record(cell(), 0.3), record(cell(policy="bygone"), 0.3)]

    def backend(jobs, say, returned):
        yield from ((key, 1.0) for key in jobs)

    confirmations = confirm(records, backend, cells=20, draws=60, seed=5, say=messages.append)
    assert [confirmation.cell.policy for confirmation in confirmations] == ["fl"]
    assert messages == ["not tried, because they are not installed: bygone"]


def test_seed_of_the_confirmation_chooses_the_cells():
    records = [record(cell(seed=number)) for number in range(30)]

    def backend(jobs, say, returned):
        yield from ((key, 1.0) for key in jobs)

    def chosen(seed):
        confirmations = confirm(records, backend, cells=20, draws=1024, seed=seed, say=print)
        return [confirmation.cell.seed for confirmation in confirmations]

    assert len(set(chosen(1))) == 20
    assert chosen(1) == chosen(1) != chosen(2)
