"""How the evaluation resists careless and cheating policies. tests/attacks has the policies
themselves."""

from dataclasses import replace

import numpy as np
import pytest
from clock import Clock
from evaluation.conftest import Dropping, Law, verdict_of

from cablebot_gym.evaluation import PolicyError, evaluate_dlcc, time_actions, timing
from cablebot_gym.evaluation.batch import ALONE, RISK, STOCHASTIC_ALONE, Batch
from cablebot_gym.evaluation.judge import Violation
from cablebot_gym.evaluation.motion_search import SCAN_POINTS
from cablebot_gym.evaluation.repetition import first_difference
from cablebot_gym.evaluation.search import FINER, SEARCH_DRAWS
from cablebot_gym.evaluation.statistics import plausible_successes
from cablebot_gym.evaluation.timing import WARM_UP
from cablebot_gym.robots import SPATIAL
from cablebot_gym.task import ErrorBounds

SPATIAL_ID = "CableBot-Spatial-v0"
HANG = {"name": "dwell-spatial", "duration": 0.05}


def evaluated(policy, **keywords):
    return evaluate_dlcc(policy, SPATIAL_ID, **{"trajectory": HANG, "resolution": 0.01} | keywords)


# --- random actions and the check alone -------------------------------------------------------------------------------


class FailsAlone(Law):
    """Fails with more than a payload without other episodes in its batch, and declares random
    actions."""

    stochastic = True

    def __init__(self, heaviest):
        super().__init__()
        self.heaviest = heaviest

    def reset(self, tasks):
        self.payloads = np.array([task.model_payload for task in tasks])

    def act(self, observation):
        fails = (self.payloads > self.heaviest) & (len(observation) == 1)
        return super().act(observation) * ~fails[:, None]


@pytest.mark.landing
@pytest.mark.parametrize("uncertainty", [None, "sensors"])
def test_random_policy_must_not_need_other_episodes(uncertainty):
    with pytest.raises(
        PolicyError, match=r"depends on the other.* in 0 of \d+ draws alone, in 60 of 60 together"
    ):
        evaluated(FailsAlone(-1.0), uncertainty=uncertainty, draws=60)


@pytest.mark.landing
def test_stochastic_policy_is_tried_in_more_draws_alone(batches):
    result = evaluated(FailsAlone(20.0), draws=60)
    assert "stochastic policy" in str(result)
    assert str(result).endswith("(95/95 lower tolerance bound, 60 draws)")
    needed_draws = plausible_successes(60, 60, STOCHASTIC_ALONE, RISK)
    assert sum(len(seeds) == 1 for seeds in batches) == needed_draws > ALONE


CARRIED = verdict_of()
SLACK = verdict_of(Violation(kind="slack", index=1, time=0.1, excess=None))


@pytest.mark.parametrize(
    ("original", "change"),
    [
        (CARRIED, {"position_peak": 0.00501}),
        (CARRIED, {"rotation_peak": 0.0101}),
        (CARRIED, {"peak_action": (0.5, 0.501)}),
        (SLACK, {"violation": replace(SLACK.violation, time=0.102)}),
    ],
)
def test_repetition_with_another_value_is_a_difference(original, change):
    """Excludes a comparison of one motor only, or of kinds of violations without their times."""
    bounds = ErrorBounds(position=0.01, rotation=0.02)
    assert first_difference([original], [original], bounds) is None
    assert first_difference([original], [replace(original, **change)], bounds) is not None


# --- one process ------------------------------------------------------------------------------------------------------


class WidensItsTasks(Law):
    """Alters the tasks that it gets, and their robots."""

    def reset(self, tasks):
        for task in tasks:
            object.__setattr__(task.error_bounds, "position", 10.0)
            object.__setattr__(task.robot, "minimum_tension", -1e9)
            object.__setattr__(task.robot.motors, "stall_torque", 1e6)


def test_policy_gets_copies_of_tasks_and_robots():
    result = evaluated(WidensItsTasks())
    honest = evaluated(Law())
    assert result.payload == honest.payload
    assert result.details.margins == honest.details.margins
    assert (SPATIAL.minimum_tension, SPATIAL.motors.stall_torque) == (1.0, 10.0)


@pytest.fixture
def batches(monkeypatch):
    """Seeds of the rows of each batch without an observer."""
    seeds_of_batches = []
    honest = Batch.run

    def run(self, rows, **keywords):
        if "observer" not in keywords:
            seeds_of_batches.append([row.seed for row in rows])
        return honest(self, rows, **keywords)

    monkeypatch.setattr(Batch, "run", run)
    return seeds_of_batches


@pytest.mark.landing
def test_draws_of_the_check_alone_are_fresh(batches):
    result = evaluated(Law(), uncertainty="sensors", draws=60)
    alone = [seeds[0] for seeds in batches if len(seeds) == 1]
    needed_draws = plausible_successes(60, 60, ALONE, RISK)
    assert len({*alone} - {*result.draw_seeds}) == len(alone) == needed_draws > 0


# --- options and declarations -----------------------------------------------------------------------------------------


def test_normalised_observations_are_refused():
    with pytest.raises(ValueError, match="observations in SI units: remove normalised_observation"):
        evaluated(Law(), normalised_observation=True)
    assert evaluated(Law(), normalised_observation=False).payload > 0


def test_name_of_an_object_does_not_hide_its_declaration():
    class Installed(Law):
        name = spec = "fl"

    assert evaluated(Installed(), criterion="paper", resolution=1.0).details.declared


# --- islands ----------------------------------------------------------------------------------------------------------


@pytest.mark.landing
@pytest.mark.parametrize("uncertainty", [{}, {"uncertainty": "sensors", "draws": 60}])
def test_dense_check_finds_an_island_of_failures(uncertainty):
    """The narrow gap of failures lies between two payloads of the scan, below the first other
    failure."""
    scanned = []

    def spy(payload):
        scanned.append(np.unique(payload))
        return payload > 3

    evaluated(Dropping(spy), **uncertainty)
    grid = scanned[0]
    widest = 2 + int(np.diff(grid[2:9]).argmax())
    low = grid[widest] + 1e-3
    high = grid[widest + 1] - 1e-3
    assert high - low > 0.25
    result = evaluated(
        Dropping(lambda payload: ((payload > low) & (payload < high)) | (payload > 3)),
        **uncertainty,
    )
    assert low - 0.011 <= result.payload <= low
    assert result.details.feasible[0] == (0.0, result.payload)


def test_seed_moves_the_payloads_of_the_scan():
    grids = []
    for seed in (0, 1):
        scanned = []
        evaluated(
            Dropping(lambda payload, scanned=scanned: scanned.append(payload) or payload > 9),
            seed=seed,
        )
        grids.append(scanned[0])
    first, other = grids
    assert np.all(first[1:-1] != other[1:-1])
    assert (other[0], other[-1]) == (0, 20)
    assert np.diff(other).max() <= 1.5 * 20 / (SCAN_POINTS - 1)


def test_scan_has_other_draws_than_the_confirmation(batches):
    result = evaluated(Dropping(lambda payload: payload > 9), uncertainty="table6", draws=60)
    assert len(batches[0]) == SCAN_POINTS * SEARCH_DRAWS
    assert len({*batches[0]}) == SEARCH_DRAWS
    assert len({*result.draw_seeds}) == 60
    assert not {*batches[0]} & {*result.draw_seeds}
    assert {*batches[2]} <= {*result.draw_seeds}


# --- discretisation ---------------------------------------------------------------------------------------------------


def test_discretisation_compares_finer_physics_steps():
    fine = evaluated(Law())
    assert fine.details.discretisation == 0.0
    assert fine.resolution == pytest.approx(fine.failed_payload - fine.payload)
    assert evaluated(Law(), uncertainty="table6", draws=2).details.discretisation is None


@pytest.mark.parametrize("heavier", [0.05, -0.05])
def test_resolution_includes_the_discretisation(heavier, monkeypatch):
    honest = Batch.run

    def other_with_finer_steps(self, rows, *, refinement=1, **keywords):
        shift = heavier if refinement == FINER else 0.0
        shifted = [row._replace(payload=max(0.0, row.payload + shift)) for row in rows]
        return honest(self, shifted, refinement=refinement, **keywords)

    monkeypatch.setattr(Batch, "run", other_with_finer_steps)
    result = evaluated(Law())
    assert 0.05 <= result.details.discretisation <= 4 * 0.06
    assert result.resolution == result.details.discretisation
    assert result.failed_payload - result.payload <= 0.01


# --- time -------------------------------------------------------------------------------------------------------------


class Slow(Law):
    """Needs 1 s for the reset, 1 ms for an action, and 5 ms for every fourth one."""

    def __init__(self, clock):
        super().__init__()
        self.clock = clock
        self.calls = 0

    def reset(self, tasks):
        self.clock.sleep(1.0)

    def act(self, observation):
        self.calls += 1
        self.clock.sleep(0.005 if self.calls % 4 == 0 else 0.001)
        return super().act(observation)


@pytest.mark.parametrize("payload", [0.0, 19.0])
def test_times_of_actions(monkeypatch, payload):
    """Also of those after a violation, which the larger payload causes at once."""
    clock = Clock()
    monkeypatch.setattr(timing, "time", clock)
    times = time_actions(Slow(clock), SPATIAL_ID, payload=payload, trajectory=HANG)
    late = [
        calls % 4 == 0 for calls in range(WARM_UP + 1, round(HANG["duration"] / times.period) + 1)
    ]
    assert times.period == 0.002
    assert times.missed == np.mean(late)
    assert (times.median, times.p99) == pytest.approx((0.001, 0.005))
    assert times.start == pytest.approx(1.0 + 0.001 * 8 + 0.005 * 2)
