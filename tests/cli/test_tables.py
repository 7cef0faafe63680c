"""The tables in the terminal against the results that they show."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from scipy.stats import binomtest

from cablebot_gym.cli.compare import _change, print_comparison
from cablebot_gym.cli.dlcc import print_payloads
from cablebot_gym.evaluation import compare_policies, evaluate_dlcc
from cablebot_gym.evaluation.comparison import Estimate

SPATIAL_ID, PLANAR_ID = "CableBot-Spatial-v0", "CableBot-Planar-v0"
HANG = {"name": "dwell-spatial", "duration": 0.05}


def weak(observation):
    return 0.9 * np.ones(6)


def limp(observation):
    return np.zeros(6)


@cache
def payloads(criterion="task"):
    """FL over 60 draws."""
    return evaluate_dlcc(
        "fl",
        SPATIAL_ID,
        criterion=criterion,
        uncertainty="table6",
        draws=60,
        probability=0.9,
        trajectory=HANG,
        payload_max=3.0,
        resolution=0.05,
    )


@cache
def comparison(draws=3):
    """FL and one that lifts too much."""
    return compare_policies(
        ["fl", weak],
        SPATIAL_ID,
        payload=1.25,
        payload_known=False,
        uncertainty="table6" if draws > 1 else None,
        draws=draws,
        trajectory=HANG,
    )


@pytest.fixture
def printed(capsys):
    def run(print_, *arguments):
        print_(*arguments)
        out, err = capsys.readouterr()
        assert err == ""
        return out

    return run


def rows(text):
    """Cells of the table's rows, those that are broken over lines joined again."""
    found = []
    for line in text.splitlines():
        if line.startswith("│"):
            cells = [cell.strip() for cell in line.strip("│").split("│")]
            if cells[1]:
                found.append(cells)
            else:
                found[-1] = [f"{one} {more}".strip() for one, more in zip(found[-1], cells, strict=True)]
    return found


def test_payload_over_draws_is_not_shown_without_draws_probability_and_bound(printed):
    result = dataclasses.replace(
        payloads(),
        payload=1.5,
        total_mass=11.5,
        assured_payload=1.25,
        failures={"position": 7, "slack": 2},
        resolution=0.05,
    )
    text = printed(print_payloads, [result], ["paper"])
    assert text.splitlines()[0].strip() == f"{SPATIAL_ID}, fl, dwell-spatial, payload known, table6, 60 draws"
    task, paper = rows(text)
    assert task[:3] == ["task", "1.500 kg", "11.500 kg"]
    assert task[3] == f"position in 7, slack in 2 of 60 draws; {result.violation_text}"
    assert paper[:2] == ["paper", "n/a"]
    notes = " ".join(text.split())
    for part in (
        "position 10 mm, rotation 10 mrad",
        "resolution 50 g",
        "required success rate: 90% of the draws",
        "task: assured payload 1.25 kg (95%/90% lower tolerance bound)",
    ):
        assert part in notes


def test_payload_that_no_number_of_draws_assures_is_not_passed_over(printed):
    result = dataclasses.replace(payloads(), assured_payload=None)
    text = " ".join(printed(print_payloads, [result], []).split())
    assert "task: no assured payload with 95% confidence from 60 draws" in text


def test_one_draw_is_not_called_draws_nor_given_a_probability(printed):
    result = evaluate_dlcc("fl", SPATIAL_ID, uncertainty={"delay": 1}, trajectory=HANG, payload_max=1.0)
    text = printed(print_payloads, [result], [])
    assert "custom, 1 draw\n" in "\n".join(line.rstrip() for line in text.splitlines()) + "\n"
    assert "of the draws" not in text
    assert "assured" not in text
    assert "the scan ended at 1 kg: try a larger --payload-max" in text


def test_resolution_of_the_second_criterion_is_not_lost_where_the_first_found_no_end(printed):
    ended = dataclasses.replace(payloads(), resolution=0.0)
    found = dataclasses.replace(payloads(), criterion="paper", resolution=0.02)
    assert "resolution 20 g" in printed(print_payloads, [ended, found], [])
    assert "resolution" not in printed(print_payloads, [ended], [])


def test_nothing_carried_is_not_a_payload(printed):
    result = evaluate_dlcc(limp, SPATIAL_ID, uncertainty="table6", draws=3, trajectory={**HANG, "duration": 0.3})
    ((criterion, payload, total, failure, margins),) = rows(printed(print_payloads, [result], []))
    assert (criterion, payload, total) == ("task", "fails unloaded", "–")
    assert "in 3 of 3 draws; " in failure
    assert margins == "–"


def test_comparison_does_not_show_other_numbers_than_it_holds(printed):
    text = printed(print_comparison, comparison())
    assert text.splitlines()[0].strip() == f"{SPATIAL_ID}, payload 1.25 kg, payload unknown, 3 draws of table6"
    table = rows(text)
    assert [row[0] for row in table] == ["fl", "weak"]
    scales = {"mean_error": 1e3, "rms_error": 1e3, "max_error": 1e3, "max_rotation": 1e3, "rms_torque": 1}
    scales |= {"peak_torque": 1, "torque_margin": 100, "least_tension": 1}
    for row, measured in zip(table, comparison().metrics, strict=True):
        exact = binomtest(int(measured.carried.sum()), 3).proportion_ci(0.95, method="exact")
        assert row[1] == f"{measured.carried.mean():.0%} [{exact.low:.0%}, {exact.high:.0%}]"
        for cell, (name, scale) in zip(row[2:], scales.items(), strict=True):
            estimate = measured.estimate(name)
            half = scale * (estimate.high - estimate.low) / 2
            mean, width = (float(number) for number in cell.split(" ± "))
            assert mean == pytest.approx(scale * estimate.mean, rel=6e-3)
            assert width == pytest.approx(half, rel=6e-2)
    fraction = comparison().reduction(1, "max_error")
    assert f"max error {-fraction.mean:+.0%} [{-fraction.high:+.0%}, {-fraction.low:+.0%}]" in text
    assert "weak against fl: mean error +" in text
    assert "95% confidence over draws" in text


def test_one_draw_is_not_given_an_interval(printed):
    text = printed(print_comparison, comparison(1))
    assert "payload unknown, 1 draw of no uncertainty" in text
    for sign in ("±", "[+", "[-", "confidence"):
        assert sign not in text


@pytest.mark.parametrize(
    ("fraction", "text"),
    [
        ((0.655, 0.6, 0.7), "-66% [-70%, -60%]"),
        ((-0.5, -1.0, 0.25), "+50% [-25%, +100%]"),
        ((0.0, 0.0, 0.0), "+0%"),
        ((0.002, -0.002, 0.004), "+0% [+0%, +0%]"),
        ((0.5, 0.5, 0.5), "-50%"),
    ],
)
def test_less_error_is_not_written_as_more(fraction, text):
    mean, low, high = fraction
    assert _change(Estimate(mean=mean, low=low, high=high)) == text


def test_episodes_that_ended_early_are_not_passed_over(printed):
    motion = {"name": "dwell-spatial", "duration": 0.3}
    fallen = compare_policies(["fl", limp], SPATIAL_ID, uncertainty="table6", draws=2, trajectory=motion)
    assert "2 episodes ended early: the remaining steps count with the termination radius as error" in printed(
        print_comparison, fallen
    )
    assert "ended early" not in printed(print_comparison, comparison())


def test_planar_robot_does_not_get_a_rotation_column(printed):
    planar = compare_policies(["fl"], PLANAR_ID, trajectory={"name": "dwell-planar", "duration": 0.02})
    text = printed(print_comparison, planar)
    assert "rotation" not in text
    assert "rotation, max" in printed(print_comparison, comparison())
    assert len(rows(text)[0]) == 9


def test_long_names_are_not_cut_off_nor_read_as_markup(printed):
    names = ["package.module:a_rather_long_name_for_a_policy_" + end for end in ("one", "two", "three")]
    measured = [dataclasses.replace(comparison().metrics[0], policy=name) for name in names]
    table = rows(printed(print_comparison, dataclasses.replace(comparison(), metrics=tuple(measured))))
    assert [row[0].replace(" ", "") for row in table] == names
    odd = dataclasses.replace(comparison().metrics[0], policy="a[/b]:cat:c")
    text = printed(print_comparison, dataclasses.replace(comparison(), metrics=(odd, odd)))
    assert rows(text)[0][0] == "a[/b]:cat:c"
    assert "a[/b]:cat:c against a[/b]:cat:c" in text


def test_name_of_a_policy_is_not_read_as_markup_in_the_table_of_payloads(printed):
    text = printed(print_payloads, [dataclasses.replace(payloads(), policy="a[bold]b")], [])
    assert text.startswith(f"{SPATIAL_ID}, a[bold]b, ")


def test_narrow_terminal_does_not_lose_numbers_or_names(printed, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    text = printed(print_comparison, comparison())
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text
    table = rows(text)
    assert [row[0] for row in table][:2] == ["success rate", "error, mean [mm]"]
    mean = comparison().metrics[0].estimate("mean_error").mean
    assert table[1][1].startswith(f"{1e3 * mean:.3g} ± ")
