"""Checks of arguments: an error names the argument."""

import dataclasses
import math

import pytest

from cablebot_gym.utils.checks import choice, mapping, number, numbers, record, whole


@dataclasses.dataclass
class Point:
    x: float
    y: float = 0.0


@pytest.mark.parametrize(
    ("check", "message"),
    [
        (lambda: number("x", "3"), "x must be a finite number, not '3'"),
        (
            lambda: number("x", math.nan, above=0, unit="kg"),
            "x must be a finite number greater than 0 kg, not nan",
        ),
        (
            lambda: number("x", 2, least=0, below=2),
            "x must be a finite number at least 0 and less than 2, not 2",
        ),
        (lambda: whole("x", 1.0), "x must be an integer of at least 0, not 1.0"),
        (
            lambda: whole("x", 4, least=1, most=3),
            "x must be an integer of at least 1 and at most 3, not 4",
        ),
        (lambda: numbers("x", [1, [2]]), "x must be numbers, not [1, [2]]"),
        (
            lambda: numbers("x", 1.0, shapes=[(2,)]),
            "x must be an array of shape (2,), not an array of shape ()",
        ),
        (lambda: numbers("x", [1, math.inf]), "x must be finite, not [1, inf]"),
        (lambda: mapping("x", 3, ["a", "b"]), "x must be a dict with the keys a, b, not 3"),
        (lambda: mapping("x", {"c": 1}, ["a"]), "unknown key of x 'c'; choose one of a"),
        (
            lambda: choice("robot", "Spatial ", ["spatial"]),
            "unknown robot 'Spatial '; choose one of spatial; did you mean 'spatial'?",
        ),
        (lambda: record("point", Point, {"y": 1.0}), "point needs the key 'x'"),
    ],
)
def test_invalid_value_raises_with_the_name_of_the_argument(check, message):
    with pytest.raises(ValueError, match=r".") as caught:
        check()
    assert str(caught.value) == message
