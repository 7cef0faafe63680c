"""Policies side by side: every number against single episodes, the intervals against SciPy's, and the figure."""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from functools import cache

import gymnasium as gym
import numpy as np
import pytest
from scipy import stats

import cablebot_gym
from cablebot_baselines.classical import FeedbackLinearization
from cablebot_gym.evaluation import DLCCMonitor, ErrorBounds, PolicyError, compare_policies
from cablebot_gym.evaluation.comparison import QUANTITIES, REDUCTION_QUANTITIES, Estimate
from cablebot_gym.robots import PLANAR, SPATIAL

SPATIAL_ID, PLANAR_ID = "CableBot-Spatial-v0", "CableBot-Planar-v0"
HANG = {"name": "dwell-spatial", "duration": 0.06}
MOVE = {"name": "line-spatial", "duration": 0.4}
UNKNOWN = {
    "parameters": {"platform_mass": {"low": -0.1, "high": 0.1}},
    "wrench": {"force_mean": 0.5, "force_std": 0.4},
    "sensors": {"position": 1e-4},
}


def draw_seeds(seed, draws):
    """The seeds of the draws, as documented: from the comparison's seed alone."""
    return [int(one) >> 11 for one in np.random.SeedSequence(seed).generate_state(draws, np.uint64)]


class Scaled(FeedbackLinearization):
    """FL whose commands are a little too large or too small."""

    def __init__(self, factor, robot=SPATIAL):
        super().__init__(robot)
        self.factor = factor

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = super().predict(observation, state)
        return self.factor * action, state


def limp(observation):
    return np.zeros(6)


class LetsGo(Scaled):
    """FL that lets go for good where it measures that it stands a little too low or high at the third step."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, _ = super().predict(observation)
        count, gone = (0, np.zeros(len(observation), bool)) if state is None else state
        if count == 2:
            gone = observation[:, 0] > 0  # the noisy x of the pose
        return np.where(gone[:, None], 0.0, action), (count + 1, gone)


def refuse(constant):
    raise AssertionError(f"{constant} is no JSON")


@cache
def compared():
    """Two policies over five draws."""
    return compare_policies(
        [Scaled(1.0), Scaled(0.9)],
        SPATIAL_ID,
        names=["plain", "weak"],
        payload=1.5,
        uncertainty=UNKNOWN,
        draws=5,
        seed=3,
        trajectory=MOVE,
        error_bounds={"position": 0.005},
    )


def episode(policy, seed, *, payload=1.5, trajectory=MOVE, uncertainty=UNKNOWN, position=0.005):
    """One episode in a single environment, summed up by hand."""
    env = DLCCMonitor(
        gym.make(SPATIAL_ID, payload=payload, trajectory=trajectory, uncertainty=uncertainty, max_episode_steps=-1),
        error_bounds={"position": position},
    )
    observation, _ = env.reset(seed=seed)
    infos, state, terminated = [], None, False
    while len(infos) < round(500 * trajectory["duration"]) and not terminated:
        action, state = policy.predict(observation[None], state=state)
        observation, _, terminated, _, info = env.step(action[0])
        infos.append(info)
    series = {name: np.array([info[name] for info in infos]) for name in infos[0] if name != "termination_reason"}
    carried = env.verdict.carried
    env.close()
    error, steps = series["tracking_error"], round(500 * trajectory["duration"])
    lost = max(error[-1], 0.1)  # after an early end
    rest, peak = steps - len(error), series["tracking_error_peak"].max()
    return {
        "mean_error": (error.sum() + rest * lost) / steps,
        "rms_error": math.sqrt(((error**2).sum() + rest * lost**2) / steps),
        "max_error": max(peak, lost) if terminated else peak,
        "max_rotation": series["rotation_error_peak"].max(),
        "rms_torque": math.sqrt((series["torques"] ** 2).mean()),
        "peak_torque": np.abs(series["torques"]).max(),
        "torque_margin": 1 - np.abs(series["commanded_action"]).max(),
        "least_tension": series["tensions"].min(),
        "carried": carried,
        "ended": bool(terminated),
        "error": error,
        "rotation": series["rotation_error"],
    }


# --- numbers ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("place", "factor"), [(0, 1.0), (1, 0.9)])
def test_no_number_differs_from_single_episodes_with_the_same_seeds(place, factor):
    measured = compared().metrics[place]
    for draw, seed in enumerate(draw_seeds(3, 5)):
        by_hand = episode(Scaled(factor), seed)
        for name, value in by_hand.items():
            ours = getattr(measured, name)[..., draw]
            np.testing.assert_allclose(ours, value, rtol=0, atol=1e-12, err_msg=name)
    assert np.all(np.ptp([getattr(measured, name) for name in QUANTITIES], axis=1) > 0), "draws differ in everything"
    assert set(QUANTITIES) == set(by_hand) - {"carried", "ended", "error", "rotation"}


def test_carried_is_not_the_same_for_every_draw_by_mistake():
    plain, weak = compared().metrics
    assert plain.carried.dtype == bool
    assert plain.carried.sum() > weak.carried.sum() == 0
    np.testing.assert_array_equal(plain.carried, plain.max_error <= 0.005)


def test_draws_do_not_differ_between_policies():
    one = compare_policies([Scaled(1.0)] * 2, SPATIAL_ID, names="ab", uncertainty=UNKNOWN, draws=4, trajectory=HANG)
    for name in (*QUANTITIES, "error", "rotation"):
        np.testing.assert_array_equal(getattr(one.metrics[0], name), getattr(one.metrics[1], name))
    for quantity in REDUCTION_QUANTITIES:
        assert one.reduction(1, quantity) == Estimate(mean=0.0, low=0.0, high=0.0)


@pytest.mark.parametrize("uncertainty", [None, UNKNOWN], ids=["nominal", "one draw"])
def test_one_draw_is_not_another_episode_than_the_environments_own_nor_given_an_interval(uncertainty):
    comparison = compare_policies(
        [Scaled(1.0), Scaled(0.9)], SPATIAL_ID, names="ab", uncertainty=uncertainty, draws=1, seed=7, trajectory=HANG
    )
    by_hand = episode(Scaled(1.0), 7, payload=0.0, trajectory=HANG, uncertainty=uncertainty)
    assert comparison.draws == 1
    for name in QUANTITIES:
        estimate = comparison.metrics[0].estimate(name)
        assert estimate.mean == pytest.approx(by_hand[name], abs=1e-12)
        assert estimate.low == estimate.mean == estimate.high
    fraction = comparison.reduction(1, "mean_error")
    assert fraction.low == fraction.mean == fraction.high
    assert fraction.mean < 0, "the weak one is worse"


@pytest.mark.parametrize("draws", [None, 1, 3])
def test_episode_that_the_environment_ends_is_not_counted_beyond_its_end(draws):
    motion = {"name": "dwell-spatial", "duration": 0.4}
    comparison = compare_policies(
        [limp, Scaled(1.0)],
        SPATIAL_ID,
        names=["limp", "plain"],
        uncertainty=UNKNOWN if draws else None,
        draws=draws,
        trajectory=motion,
    )
    fallen, kept = comparison.metrics
    assert fallen.ended.tolist() == [True] * (draws or 1)
    assert kept.ended.tolist() == [False] * (draws or 1)
    assert len(fallen.error) < 200 == len(kept.error)
    assert np.nanmax(fallen.error) < 0.11, "not the next episode, which starts where this one did"
    assert np.all(fallen.max_error > 0.1)
    json.loads(comparison.to_json(), parse_constant=refuse)


def test_some_ended_draws_do_not_spoil_the_others():
    motion = {"name": "dwell-spatial", "duration": 0.3}
    keywords = {"uncertainty": "sensors", "draws": 6, "trajectory": motion, "seed": 2}
    comparison = compare_policies([LetsGo(1.0)], SPATIAL_ID, **keywords)
    (measured,) = comparison.metrics
    assert 0 < measured.ended.sum() < 6
    for draw, seed in enumerate(draw_seeds(2, 6)):
        by_hand = episode(LetsGo(1.0), seed, payload=0.0, trajectory=motion, uncertainty="sensors", position=0.01)
        for name in (*QUANTITIES, "carried", "ended"):
            assert getattr(measured, name)[draw] == pytest.approx(by_hand[name], abs=1e-12), name
        lasted = len(by_hand["error"])
        assert np.isnan(measured.error[lasted:, draw]).all()
        assert not np.isnan(measured.error[:lasted, draw]).any()
    data = json.loads(comparison.to_json(), parse_constant=refuse)
    assert data["policies"][0]["per_draw"]["ended"] == measured.ended.tolist()


def test_policy_is_not_left_alone_after_a_limit_has_given_way():
    # Beyond the bound it is judged, but still commanded: the error stays where the law puts it.
    comparison = compare_policies(
        [Scaled(0.9)],
        SPATIAL_ID,
        trajectory={"name": "dwell-spatial", "duration": 0.5},
        error_bounds={"position": 1e-3},
    )
    (measured,) = comparison.metrics
    assert not measured.carried[0]
    assert not measured.ended[0]
    assert measured.max_error[0] < 0.04, "without commands it falls by a metre"


def test_seed_does_not_give_another_comparison_the_second_time():
    keywords = {"uncertainty": UNKNOWN, "draws": 3, "trajectory": HANG}
    texts = [compare_policies(["fl"], SPATIAL_ID, seed=seed, **keywords).to_json() for seed in (4, 4, 5)]
    assert texts[0] == texts[1]
    one, other = (json.loads(text)["policies"][0]["per_draw"]["mean_error"] for text in texts[1:])
    assert all(a != b for a, b in zip(one, other, strict=True))


def test_planar_robot_does_not_turn():
    comparison = compare_policies(
        ["fl"], PLANAR_ID, uncertainty="table6", draws=2, trajectory={"name": "dwell-planar", "duration": 0.05}
    )
    assert comparison.metrics[0].max_rotation.tolist() == [0, 0]
    assert comparison.metrics[0].peak_torque.min() > 0


# --- intervals --------------------------------------------------------------------------------------------------------


def made(*mean_errors):
    """A comparison with given mean errors for each policy."""
    measured = []
    for place, errors in enumerate(mean_errors):
        one = compared().metrics[0]
        measured.append(dataclasses.replace(one, policy=f"p{place}", mean_error=np.array(errors, float)))
    return dataclasses.replace(compared(), metrics=tuple(measured), draws=len(mean_errors[0]))


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_interval_is_not_another_than_students(quantity):
    values = getattr(compared().metrics[1], quantity)
    low, high = stats.t.interval(0.95, 4, loc=values.mean(), scale=stats.sem(values))
    estimate = compared().metrics[1].estimate(quantity)
    assert (estimate.mean, estimate.low, estimate.high) == pytest.approx((values.mean(), low, high), rel=1e-12)
    assert estimate.low < estimate.mean < estimate.high


def test_reduction_is_not_a_mean_of_ratios():
    # Of (1, 3) against (1, 1): 1 − 2/4. Resampled: none of it, half of it, or 1 − 1/3.
    fraction = made((1, 3), (1, 1)).reduction(1, "mean_error")
    assert (fraction.mean, fraction.low, fraction.high) == pytest.approx((0.5, 0.0, 2 / 3))


def test_draws_of_a_reduction_are_not_resampled_apart_from_each_other():
    fraction = made((1, 2, 3, 10), (0.25, 0.5, 0.75, 2.5)).reduction(1, "mean_error")
    assert (fraction.mean, fraction.low, fraction.high) == pytest.approx((0.75, 0.75, 0.75), abs=1e-12)
    fraction = made((1, 2, 3, 10), (2, 4, 6, 20)).reduction(1, "mean_error")
    assert (fraction.mean, fraction.low, fraction.high) == pytest.approx((-1, -1, -1), abs=1e-12)


def test_reduction_is_not_against_another_policy_than_the_first():
    comparison = made((2, 4), (1, 2), (0.5, 1))
    assert [comparison.reduction(place, "mean_error").mean for place in range(3)] == pytest.approx([0, 0.5, 0.75])


def test_interval_of_a_reduction_is_neither_random_nor_of_another_confidence():
    random = np.random.default_rng(0)
    base = random.uniform(1, 2, 40)
    comparison = made(base, base * random.uniform(0.3, 0.7, 40))
    fraction = comparison.reduction(1, "mean_error")
    assert fraction == comparison.reduction(1, "mean_error")
    both = (comparison.metrics[0].mean_error, comparison.metrics[1].mean_error)
    reference = stats.bootstrap(
        both,
        lambda one, other, axis: 1 - other.mean(axis=axis) / one.mean(axis=axis),
        paired=True,
        vectorized=True,
        method="percentile",
        confidence_level=0.95,
        n_resamples=20000,
        rng=np.random.default_rng(1),
    ).confidence_interval
    width = reference.high - reference.low
    assert fraction.low == pytest.approx(reference.low, abs=0.1 * width)
    assert fraction.high == pytest.approx(reference.high, abs=0.1 * width)


# --- what it says -----------------------------------------------------------------------------------------------------


def test_json_is_neither_invalid_nor_without_the_draws_own_values():
    comparison = compared()
    data = json.loads(comparison.to_json(), parse_constant=refuse)
    assert (data["env_id"], data["payload"], data["payload_known"]) == (SPATIAL_ID, 1.5, True)
    assert (data["uncertainty"], data["draws"], data["seed"], data["confidence"]) == ("custom", 5, 3, 0.95)
    assert data["error_bounds"] == {"position": 0.005, "rotation": 0.01}
    assert data["versions"]["cablebot-gym"] == cablebot_gym.__version__
    assert data["environment"]["trajectory"]["name"] == "line-spatial"
    assert data["environment"]["uncertainty"]["parameters"]["platform_mass"]["high"] == 0.1
    assert [policy["policy"] for policy in data["policies"]] == ["plain", "weak"]
    for place, policy in enumerate(data["policies"]):
        measured = comparison.metrics[place]
        assert set(policy["estimates"]) == set(QUANTITIES)
        assert policy["estimates"]["rms_error"] == vars(measured.estimate("rms_error"))
        for name in (*QUANTITIES, "carried", "ended"):
            assert policy["per_draw"][name] == getattr(measured, name).tolist()
    assert data["policies"][0]["reductions"] == {}
    expected = {name: vars(comparison.reduction(1, name)) for name in REDUCTION_QUANTITIES}
    assert data["policies"][1]["reductions"] == expected
    assert set(REDUCTION_QUANTITIES) == {"mean_error", "rms_error", "max_error"}


def test_printed_comparison_does_not_keep_the_essentials_to_itself():
    lines = str(compared()).splitlines()
    assert lines[0] == "CableBot-Spatial-v0, 1.5 kg, 5 draws of custom"
    for line, measured in zip(lines[1:], compared().metrics, strict=True):
        mean, most = 1e3 * measured.mean_error.mean(), 1e3 * measured.max_error.mean()
        assert line.startswith(f"{measured.policy}: error {mean:.3g} mm mean, {most:.3g} mm max")
        assert line.endswith(f"; carried in {measured.carried.mean():.0%}")
    fraction = 1 - compared().metrics[1].mean_error.mean() / compared().metrics[0].mean_error.mean()
    assert fraction < 0
    assert f"({-fraction:.0%} more and " in lines[2]


def test_progress_does_not_run_backwards_or_stop_before_its_end():
    seen = []
    compare_policies(
        [limp, Scaled(1.0)],
        SPATIAL_ID,
        names="ab",
        uncertainty=UNKNOWN,
        draws=2,
        trajectory={"name": "dwell-spatial", "duration": 0.3},
        progress=lambda done, expected: seen.append((done, expected)),
    )
    done, expected = zip(*seen, strict=True)
    assert list(done) == sorted(done)
    assert set(expected) == {300}
    assert done[-1] == 300
    assert 150 in done, "the first policy's end, though its episodes ended early"


def test_payload_that_is_not_told_is_not_told():
    known, unknown = (
        compare_policies(["fl"], SPATIAL_ID, payload=3.0, payload_known=known, trajectory=HANG)
        for known in (True, False)
    )
    assert (known.payload_known, unknown.payload_known) == (True, False)
    assert unknown.metrics[0].max_error[0] > 10 * known.metrics[0].max_error[0]


def test_names_of_the_policies_are_not_lost():
    def own(observation):
        return np.zeros(6)

    keywords = {"trajectory": HANG}
    found = compare_policies(["fl", Scaled(1.0), own], SPATIAL_ID, **keywords).metrics
    assert [one.policy for one in found] == ["fl", "Scaled", "own"]


# --- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("policies", "arguments", "message"),
    [
        ([], {}, "no policy to compare: give at least one policy"),
        (["fl", "fl"], {}, "every policy needs its own name, but the names are fl, fl"),
        (["fl", "fl"], {"names": ["a"]}, "every policy needs its own name"),
        (["fl"], {"names": ["a", "b"]}, "every policy needs its own name"),
        (["fl", "lqr"], {}, "unknown policy 'lqr'; choose one of"),
        (["fl"], {"payload": -1.0}, "payload must be a finite number of at least 0 kg"),
        (["fl"], {"payload": math.nan}, "payload must be a finite number of at least 0 kg"),
        (["fl"], {"draws": 0}, "draws must be an integer of at least 1, not 0"),
        (["fl"], {"draws": 2, "uncertainty": None}, "all 2 draws would be equal"),
        (["fl"], {"error_bounds": {"position": 0.0}}, "error_bounds: position must be a number greater than 0"),
        (["fl"], {"uncertainty": ["table6", "table6"]}, "uncertainty must be one value for all episodes"),
        (["fl"], {"uncertainty": "table5"}, "unknown uncertainty 'table5'"),
        (["fl"], {"payload_range": (0, 1)}, "payload_range is set by the evaluation"),
        (["fl"], {"trajectory": "spiral"}, "unknown trajectory 'spiral'"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_bad_argument_is_not_accepted(policies, arguments, message):
    with pytest.raises(ValueError, match=message) as caught:
        compare_policies(policies, SPATIAL_ID, **{"trajectory": HANG, "uncertainty": "table6", "draws": 2} | arguments)
    assert "\n" not in str(caught.value)


def test_error_of_a_policy_does_not_lack_its_name():
    def broken(observation):
        raise RuntimeError("lost")

    with pytest.raises(PolicyError, match=r"policy 'second' failed at t = 0\.000 s with a payload of 0\.5 kg: .*lost"):
        compare_policies(["fl", broken], SPATIAL_ID, names=["first", "second"], payload=0.5, trajectory=HANG)


def test_interrupt_does_not_leave_an_environment_open(monkeypatch):
    made_vec, opened, closed = gym.make_vec, [], []

    def make_vec(*arguments, **keywords):
        env = made_vec(*arguments, **keywords)
        opened.append(1)
        close = env.close
        env.close = lambda *_, **__: (closed.append(1), close())
        return env

    def progress(done, expected):
        if done > 40:
            raise KeyboardInterrupt

    monkeypatch.setattr(gym, "make_vec", make_vec)
    with pytest.raises(KeyboardInterrupt):
        compare_policies([Scaled(1.0)] * 2, SPATIAL_ID, names="ab", trajectory=HANG, progress=progress)
    assert len(opened) == len(closed) == 2


# --- the figure -------------------------------------------------------------------------------------------------------

figure_module = pytest.importorskip("matplotlib.figure")
from cablebot_gym.plotting.comparison import draw_comparison, save_comparison  # noqa: E402


def lines(axes):
    """Curves of the policies, and the lines at the bound."""
    drawn = axes.get_lines()
    return [line for line in drawn if line.get_color() != "black"], [
        line for line in drawn if line.get_color() == "black"
    ]


def test_curves_are_not_those_of_another_policy_or_shifted_by_a_step():
    comparison = compared()
    over_position, peaks_position, over_rotation, peaks_rotation = draw_comparison(comparison).axes
    for axes, series in ((over_position, "error"), (over_rotation, "rotation")):
        curves, _ = lines(axes)
        assert len(curves) == 2
        for curve, measured in zip(curves, comparison.metrics, strict=True):
            np.testing.assert_allclose(curve.get_xdata(), np.arange(1, 201) / 500)
            np.testing.assert_allclose(curve.get_ydata(), 1e3 * getattr(measured, series).mean(axis=1))
        for band, measured in zip(axes.collections, comparison.metrics, strict=True):
            values = 1e3 * getattr(measured, series)
            corners = band.get_paths()[0].vertices
            assert corners[:, 1].max() == pytest.approx(np.quantile(values, 0.95, axis=1).max())
    for axes, peak in ((peaks_position, "max_error"), (peaks_rotation, "max_rotation")):
        curves, _ = lines(axes)
        for curve, measured in zip(curves, comparison.metrics, strict=True):
            x, y = curve.get_data()
            np.testing.assert_allclose(np.sort(x[1:]), np.sort(1e3 * getattr(measured, peak)))
            assert (y[0], y[-1]) == (0, 1)
    styles = {(curve.get_color(), curve.get_linestyle()) for curve in lines(over_position)[0]}
    assert len(styles) == 2
    assert len({style for _, style in styles}) == 2, "not by colour alone"


def test_bounds_are_not_others_than_the_comparisons_nor_out_of_sight():
    axes = draw_comparison(compared()).axes
    (level,) = lines(axes[0])[1]
    (upright,) = lines(axes[1])[1]
    assert set(level.get_ydata()) == set(upright.get_xdata()) == {5.0}
    assert axes[0].get_ylim()[0] == 0
    assert axes[0].get_ylim()[1] > 5
    assert axes[0].get_title(loc="right") == "bound 5 mm: black line"
    # The rotation hardly moves: a line at its bound would flatten the curves, but it is named.
    assert lines(axes[2])[1] == lines(axes[3])[1] == []
    assert axes[2].get_ylim()[1] < 10
    assert axes[2].get_title(loc="right") == "bound 10 mrad: above the plotted range"


def test_labels_do_not_hide_what_was_compared():
    figure = draw_comparison(compared())
    title = figure.get_suptitle()
    for part in (SPATIAL_ID, "payload 1.5 kg, payload known", "5 draws of custom", "5th to the 95th percentile"):
        assert part in title
    labels = [(axes.get_xlabel(), axes.get_ylabel()) for axes in figure.axes]
    assert labels == [
        ("", "position error [mm]"),
        ("largest position error [mm]", "fraction of draws"),
        ("time [s]", "rotation error [mrad]"),
        ("largest rotation error [mrad]", "fraction of draws"),
    ]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["plain", "weak"]


def test_planar_robot_does_not_get_a_rotation_row_nor_one_draw_a_band():
    motion = {"name": "dwell-planar", "duration": 0.05}
    figure = draw_comparison(compare_policies([Scaled(0.9, PLANAR)], PLANAR_ID, trajectory=motion))
    assert [axes.get_ylabel() for axes in figure.axes] == ["position error [mm]", "fraction of draws"]
    assert list(figure.axes[0].collections) == []
    assert "percentile" not in figure.get_suptitle()
    assert "no uncertainty" in figure.get_suptitle()


@pytest.mark.parametrize("count", [1, 5, 9])
def test_many_policies_with_long_names_do_not_push_the_panels_out_or_look_alike(tmp_path, count):
    names = [f"_package.module_{place}:$a_{{$long" + "_name" * 6 * (place % 3) for place in range(count)]
    measured = [dataclasses.replace(compared().metrics[0], policy=name) for name in names]
    comparison = dataclasses.replace(compared(), metrics=tuple(measured))
    figure = draw_comparison(comparison)
    figure.savefig(tmp_path / "figure.png")  # a warning that the panels collapsed would be an error
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == names
    inside = legend.get_window_extent()
    assert inside.x0 >= 0
    assert inside.x1 <= figure.bbox.width
    assert all(axes.get_window_extent().height > 100 for axes in figure.axes)
    curves, _ = lines(figure.axes[0])
    blacks = [line for line in figure.axes[0].get_lines() if line.get_color() == "#000000"]
    assert len({(line.get_color(), line.get_linestyle()) for line in (*curves, *blacks)}) >= count


@pytest.mark.parametrize("factor", [1.0, 1e-9], ids=["small errors", "hardly any"])
def test_error_far_below_its_bound_does_not_collapse_the_panels(tmp_path, factor):
    one = compared().metrics[0]
    changed = {name: getattr(one, name) * 1e-2 * factor for name in ("error", "max_error", "rotation", "max_rotation")}
    comparison = dataclasses.replace(compared(), metrics=(dataclasses.replace(one, **changed),))
    figure = draw_comparison(comparison)
    figure.savefig(tmp_path / "figure.png")
    assert all(axes.get_window_extent().height > 100 for axes in figure.axes)
    assert figure.axes[0].get_ylim()[1] == pytest.approx(1.05e3 * changed["max_error"].max())


def test_draws_that_ended_early_do_not_spoil_the_figure(tmp_path):
    comparison = compare_policies(
        [LetsGo(1.0), limp],
        SPATIAL_ID,
        names="ab",
        uncertainty="sensors",
        draws=6,
        seed=2,
        trajectory={"name": "dwell-spatial", "duration": 0.3},
    )
    figure = draw_comparison(comparison)
    figure.savefig(tmp_path / "figure.png")
    curves, _ = lines(figure.axes[0])
    assert not any(np.isnan(curve.get_ydata()).any() for curve in curves)
    assert curves[1].get_xdata()[-1] < 0.2 < curves[0].get_xdata()[-1]


@pytest.mark.parametrize("before", [None, b"old"], ids=["new", "replaced"])
def test_interrupt_does_not_leave_half_a_figure(tmp_path, monkeypatch, before):
    path = tmp_path / "comparison.png"
    if before is not None:
        path.write_bytes(before)

    def savefig(self, target, **keywords):
        target.write_bytes(b"\x89PNG half")
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(figure_module.Figure, "savefig", savefig)
        with pytest.raises(KeyboardInterrupt):
            save_comparison(compared(), tmp_path)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == ({path.name: before} if before else {})
    assert save_comparison(compared(), tmp_path) == path
    assert path.read_bytes().endswith(b"IEND\xaeB`\x82")


def test_missing_matplotlib_does_not_go_without_the_command_that_installs_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r"pip install 'cablebot-gym\[plot\]'"):
        draw_comparison(compared())


def test_comparison_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        compared().payload = 9.0
    assert compared().error_bounds == ErrorBounds(position=0.005)
