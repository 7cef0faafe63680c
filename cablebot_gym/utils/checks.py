"""Checks of arguments. Each check returns the value in one type, or raises a ValueError that names
the argument."""

from __future__ import annotations

import dataclasses
import inspect
import math
from collections.abc import Callable, Collection, Iterable, Mapping
from difflib import get_close_matches
from numbers import Integral, Real
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

_T = TypeVar("_T")

INF = math.inf


def number(
    name: str,
    value: Any,
    *,
    above: float = -INF,
    least: float = -INF,
    below: float = INF,
    most: float = INF,
    unit: str = "",
) -> float:
    """A finite number within bounds.

    Args:
        name: name of the argument in the message.
        value: the argument.
        above: lower bound, excluded.
        least: lower bound, included.
        below: upper bound, excluded.
        most: upper bound, included.
        unit: unit of the bounds in the message, such as ``kg``.

    Raises:
        ValueError: if the value is not such a number.
    """
    try:
        real = isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # an integer beyond the largest float
        real = False
    if not (real and above < value < below and least <= value <= most):
        bounds = _bounds_text(above, least, below, most, unit)
        raise ValueError(f"{name} must be a finite number{bounds}, not {value!r}")
    return float(value)


def whole(name: str, value: Any, *, least: int = 0, most: float = INF) -> int:
    """An integer from ``least`` to ``most``.

    Args:
        name: name of the argument in the message.
        value: the argument.
        least: smallest valid integer.
        most: largest valid integer.

    Raises:
        ValueError: if the value is not such an integer.
    """
    if (
        not isinstance(value, Integral)
        or isinstance(value, bool)
        or not least <= int(value) <= most
    ):
        raise ValueError(
            f"{name} must be an integer of{_bounds_text(-INF, least, INF, most, '')}, not {value!r}"
        )
    return int(value)


def numbers(
    name: str,
    value: Any,
    *,
    shapes: Collection[tuple[int, ...]] = (),
    form: str = "",
    above: float = -INF,
    least: float = -INF,
    unit: str = "",
) -> NDArray[np.float64]:
    """Finite numbers as a new array of floats.

    Args:
        name: name of the argument in the message.
        value: the argument: a number, a sequence or an array.
        shapes: valid shapes; every shape is valid if empty.
        form: valid forms in words, such as ``one number or one per motor``; the shapes if empty.
        above: lower bound of each number, excluded.
        least: lower bound of each number, included.
        unit: unit of the bounds in the message.

    Raises:
        ValueError: if the value does not consist of numbers, or a shape, a number or a bound is
            wrong.
    """
    try:
        array = np.array(value)
    except ValueError:  # rows of different lengths
        array = np.array(None)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{name} must be {form or 'numbers'}, not {value!r}")
    if shapes and array.shape not in shapes:
        valid = form or "an array of shape " + " or ".join(map(str, shapes))
        raise ValueError(f"{name} must be {valid}, not an array of shape {array.shape}")
    if not np.all(np.isfinite(array) & (above < array) & (least <= array)):
        bounds = _bounds_text(above, least, INF, INF, unit)
        raise ValueError(f"{name} must be finite{bounds and ' and'}{bounds}, not {value!r}")
    return array.astype(np.float64)


def all_finite(name: str, values: Any) -> None:
    """Checks that all numbers are finite. It costs a microsecond or two, for functions that run in
    every control step.

    Args:
        name: name of the argument in the message.
        values: numbers of any shape. Other objects, such as symbols, pass.

    Raises:
        ValueError: if a number is not finite.
    """
    array = np.asarray(values)
    if array.dtype != object and not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, without NaN and infinity")


def mapping(name: str, value: Any, keys: Iterable[str]) -> dict[str, Any]:
    """A mapping whose keys are all valid, as a new dict.

    Args:
        name: name of the argument in the message.
        value: the argument.
        keys: the valid keys.

    Raises:
        ValueError: if the value is not a mapping, or a key is unknown.
    """
    keys = list(keys)
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a dict with the keys {', '.join(keys)}, not {value!r}")
    for key in value:
        choice(f"key of {name}", key, keys)
    return dict(value)


def record(name: str, kind: type[_T], value: Any) -> _T:
    """An instance of a dataclass from a mapping of its fields. An instance is returned unchanged.

    Args:
        name: name of the argument in the message.
        kind: the dataclass.
        value: the argument.

    Raises:
        ValueError: if a field is unknown, missing or invalid.
    """
    if isinstance(value, kind):
        return value
    known = dataclasses.fields(kind)  # type: ignore[arg-type]  # mypy has no type for the classes of dataclasses
    values = mapping(name, value, [field.name for field in known])
    for field in known:
        is_required = field.default is field.default_factory is dataclasses.MISSING
        if is_required and field.name not in values:
            raise ValueError(f"{name} needs the key {field.name!r}")
    return kind(**values)


def choice(kind: str, value: Any, valid: Iterable[str], otherwise: str = "") -> str:
    """One of the valid names.

    Args:
        kind: kind of the named thing, such as ``environment``.
        value: the argument.
        valid: the valid names.
        otherwise: other valid input, such as ``, or pass a Robot``.

    Raises:
        ValueError: if the name is unknown, see :func:`unknown_name_error`.
    """
    valid = list(valid)
    if value not in valid:
        raise unknown_name_error(kind, value, valid, otherwise)
    return str(value)


def unknown_name_error(
    kind: str, name: object, names: Iterable[str], otherwise: str = ""
) -> ValueError:
    """The error to raise for an unknown name. Its message lists the valid names and suggests the
    closest one.

    Args:
        kind: kind of the named thing, such as ``environment``.
        name: the unknown name, as the user gave it.
        names: the valid names.
        otherwise: other valid input, such as ``, or pass a Robot``.
    """
    return ValueError(f"unknown {kind} {name!r}; {_choices_text(name, names, otherwise)}")


class UnexpectedKeywordError(TypeError, ValueError):
    """Unknown keyword argument: a TypeError as Python raises it, and a ValueError as the other
    errors of arguments."""


def check_keywords(
    given: Iterable[str], valid: Collection[str], *functions: Callable[..., Any]
) -> None:
    """Checks keywords that functions pass on.

    Args:
        given: the keywords.
        valid: the valid ones.
        functions: the functions, whose own keywords the message lists, too.

    Raises:
        UnexpectedKeywordError: if a keyword is unknown; in Python's own words, for which other
            libraries look.
    """
    for name in given:
        if name not in valid:
            names = []
            for function in functions:
                parameters = inspect.signature(function).parameters.values()
                names += [own.name for own in parameters if own.kind is own.KEYWORD_ONLY]
            raise UnexpectedKeywordError(
                f"got an unexpected keyword argument {name!r}; {_choices_text(name, [*names, *valid], '')}"
            )


def _choices_text(name: object, names: Iterable[str], otherwise: str) -> str:
    known = {valid.lower(): valid for valid in names}
    text = f"choose one of {', '.join(known.values())}{otherwise}"
    for close in get_close_matches(str(name).strip().lower(), known, 1):
        text += f"; did you mean {known[close]!r}?"
    return text


def _bounds_text(above: float, least: float, below: float, most: float, unit: str) -> str:
    bounds = []
    if above > -INF:
        bounds.append(f"greater than {above:g}")
    elif least > -INF:
        bounds.append(f"at least {least:g}")
    if below < INF:
        bounds.append(f"less than {below:g}")
    elif most < INF:
        bounds.append(f"at most {most:g}")
    if not bounds:
        return ""
    return f" {' and '.join(bounds)} {unit}".rstrip()
