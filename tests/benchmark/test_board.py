"""Boards: the hidden motions and the policies are fixed by a commitment; stored promises are tried
again."""

from dataclasses import replace

import pytest

from cablebot_gym.benchmark import board as boards
from cablebot_gym.benchmark import suites
from cablebot_gym.benchmark.cells import PolicyCell, Record
from cablebot_gym.benchmark.engine import local
from cablebot_gym.benchmark.leaderboard import Results
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


def test_secret_has_a_file_of_its_own(tmp_path, policy):
    name = policy("def make(robot): ...\n")
    board = boards.commit(tmp_path, "1", {PLANAR: [name]}, 20)
    public = (tmp_path / boards.BOARD).read_text()
    assert board.secret not in public
    assert board.salt not in public
    assert (tmp_path / boards.SECRET).stat().st_mode & 0o077 == 0
    assert len(board.secret) == 32
    assert boards.read_board(tmp_path) == board
    with pytest.raises(ValueError, match="has a board"):
        boards.commit(tmp_path, "2", {PLANAR: [name]}, 20)
    with pytest.raises(ValueError, match="add --suite ranked"):
        boards.commit(tmp_path / "other", "2", {PLANAR: [name]}, 0)


def test_commitment_binds_every_field(tmp_path, policy):
    name = policy("def make(robot): ...\n")
    board = boards.commit(tmp_path, "1", {PLANAR: [name]}, 20)
    changed_hex = f"{int(board.secret, 16) ^ 1:032x}"
    for changes in (
        {"secret": changed_hex},
        {"salt": changed_hex},
        {"version": "2"},
        {"policies": {name: "0" * 64}},
        {"motions": 19},
        {"entries": {SPATIAL: [name]}},
    ):
        with pytest.raises(ValueError, match="does not match its commitment"):
            replace(board, **changes).check()
    with pytest.raises(ValueError, match="not published"):
        replace(board, secret=None).check()


def test_policy_that_changes_after_the_commitment_is_refused(tmp_path, policy, module):
    name = policy("def make(robot): ...\n")
    board = boards.commit(tmp_path, "1", {PLANAR: [name, "fl"]}, 20)
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
        boards.commit(tmp_path / "other", "1", {PLANAR: ["toy_flat:make"]}, 20)


def test_hidden_motions_depend_on_secret_and_environment(tmp_path):
    board = boards.commit(tmp_path, "1", {}, 20)
    seeds = board.seeds(PLANAR, 20)
    assert len({*seeds, *board.seeds(SPATIAL, 20)}) == 40
    for seed in seeds:
        assert FIRST_HELD_OUT_SEED <= seed < 2**53
    with pytest.raises(ValueError, match="committed with 20 motions, not 2"):
        board.seeds(PLANAR, 2)
    assert boards.commit(tmp_path / "other", "1", {}, 20).seeds(PLANAR, 20) != seeds
    cells = suite_cells(hidden(20), {PLANAR: ("fl",)}, seed=2**127, board=board)
    assert [cell.trajectory["seed"] for cell in cells.values()] == seeds
    assert {cell.seed for cell in cells.values()} == {2**127}
    with pytest.raises(ValueError, match="--commit VERSION"):
        suite_cells(hidden(20), {PLANAR: ("fl",)})


def test_evaluation_seed_is_drawn_once_for_a_folder(tmp_path):
    seed = boards.run_seed(tmp_path)
    assert boards.run_seed(tmp_path) == seed
    assert boards.run_seed(tmp_path / "other") != seed
    assert boards.run_seed(tmp_path, 7) == boards.run_seed(tmp_path) == 7
    (tmp_path / boards.RUN).write_text("{")
    with pytest.raises(ValueError, match="missing or damaged"):
        boards.run_seed(tmp_path)


def test_results_of_other_motions_than_the_board_are_rejected(tmp_path, monkeypatch):
    board = boards.commit(tmp_path, "1", {PLANAR: ["fl"]}, 3)
    suite = hidden(3)
    records = [record(cell) for cell in suite_cells(suite, {PLANAR: ("fl",)}, board=board).values()]
    monkeypatch.setattr(suites, "SUITES", {"s": suite})
    results = Results(suite="s", command="", records=records, board=board)
    results.check_board()
    easy = replace(
        records[0], cell=replace(records[0].cell, trajectory={"name": "loop-planar", "seed": 12345})
    )
    with pytest.raises(ValueError, match="are not those of board"):
        replace(results, records=[easy, *records[1:]]).check_board()
    with pytest.raises(ValueError, match="are not those of board"):
        replace(results, records=records[:2]).check_board()
    for folder, committed in (
        ("policy", {PLANAR: ["fl", "robust"]}),
        ("id", {PLANAR: ["fl"], SPATIAL: ["robust"]}),
    ):
        more = boards.commit(tmp_path / folder, "1", committed, 3)
        with pytest.raises(ValueError, match="differ in robust on"):
            replace(results, board=more).check_board()


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


def rates(*values):
    return [Confirmation(cell=cell(), payload=1.0, success_rate=value) for value in values]


def test_promises_hold_for_18_of_20_cells_and_none_far_below():
    assert broken(rates(*[0.96] * 18, 0.94, 0.931)) == ""
    assert "only 17 of 20" in broken(rates(*[0.96] * 17, 0.94, 0.94, 0.94))
    assert "more than 2% below" in broken(rates(*[0.99] * 19, 0.929))


def test_fresh_draws_tell_a_kept_promise_from_a_broken_one(inline):
    feasible = record(cell(), 0.3)
    too_much = record(cell(policy="fl-tuned"), 2.1)
    unpromised = [
        record(cell(uncertainty=None, draws=1), assured=None),
        record(cell(policy="robust"), None),
        record(cell(seed=1), 9.9, assured=False),
    ]
    confirmations = confirm(
        [feasible, too_much, *unpromised], local(1), cells=20, draws=60, seed=5, say=print
    )
    by_policy = {confirmation.cell.policy: confirmation for confirmation in confirmations}
    assert set(by_policy) == {"fl", "fl-tuned"}
    assert by_policy["fl"].success_rate == 1.0
    assert by_policy["fl-tuned"].success_rate < 0.5
    assert "2.100 kg in at least 95% of all draws" in str(by_policy["fl-tuned"])
    with pytest.raises(ValueError, match="no payload under uncertainty"):
        list(confirm(unpromised, local(1), cells=20, draws=60, seed=5, say=print))


def test_seed_of_the_confirmation_chooses_the_cells():
    records = [record(cell(seed=number)) for number in range(30)]

    def backend(jobs, say, returned):
        yield from ((key, 1.0) for key in jobs)

    def chosen(seed):
        confirmations = confirm(records, backend, cells=20, draws=1024, seed=seed, say=print)
        return [confirmation.cell.seed for confirmation in confirmations]

    assert len(set(chosen(1))) == 20
    assert chosen(1) == chosen(1) != chosen(2)
