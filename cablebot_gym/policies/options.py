"""Options of installed policies, and the kinds of robots that they support.

``fl:gains=900/60,minimum_tension=3`` names the policy ``fl`` with two options. They are keyword
arguments of the factory.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable
from typing import Any

from cablebot_gym.envs import fitting_env_id
from cablebot_gym.policies.protocol import PolicyEntry
from cablebot_gym.robots import KIND_TEXTS, Robot
from cablebot_gym.utils.checks import unknown_name_error

_WITH_OPTIONS = re.compile(r"([\w.-]+):(\w+=.*)")

_BOOLEANS = {"true": True, "false": False}


def split_options(name: str) -> tuple[str, str]:
    """The name of a policy before its options, and the text of these; empty if there are none."""
    match = _WITH_OPTIONS.fullmatch(name)
    if match is None:
        return name, ""
    return match[1], match[2]


def parse_options(entry: PolicyEntry, text: str) -> dict[str, Any]:
    """The options of a policy from their text.

    A value is a number, ``true`` or ``false``, numbers with ``/`` between them, or a word.

    Raises:
        ValueError: if the policy does not have an option, or the text has another form. The message
            lists the valid options.
    """
    if not text:
        return {}
    valid = option_parameters(entry)
    if not valid:
        raise ValueError(f"policy {entry.name!r} has no options: leave {text!r} out")
    options: dict[str, Any] = {}
    for item in text.split(","):
        name, _, value_text = item.partition("=")
        if name not in valid:
            form = f", such as {entry.name}:{next(iter(valid))}=VALUE"
            raise unknown_name_error(f"{entry.name} option", name, valid, form)
        value = _value(value_text)
        if isinstance(valid[name].default, bool) and not isinstance(value, bool):
            raise ValueError(f"{name} must be true or false, not {value_text!r}")
        options[name] = value
    return options


def option_parameters(entry: PolicyEntry) -> dict[str, inspect.Parameter]:
    """The options of a policy by name: the keyword-only parameters of its factory."""
    parameters = inspect.signature(entry.factory).parameters
    return {
        name: parameter
        for name, parameter in parameters.items()
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY
    }


def _value(text: str) -> Any:
    """The value of an option from its text."""
    if text in _BOOLEANS:
        return _BOOLEANS[text]
    try:
        numbers = tuple(float(number) for number in text.split("/"))
    except ValueError:
        return text
    if len(numbers) == 1:
        return numbers[0]
    return numbers


def supports(entry: PolicyEntry, robot: Robot) -> bool:
    """Whether a policy supports robots of this kind: one of its environments has such a robot.

    Raises:
        ValueError: if no environment has robots of this kind.
    """
    return fitting_env_id(robot) in entry.env_ids


def unsupported_error(
    entry: PolicyEntry, robot: Robot, entries: Iterable[PolicyEntry]
) -> ValueError:
    """The error to raise for a robot of a kind that a policy does not support. Its message names
    those of ``entries`` that support it."""
    fitting = [other.name for other in entries if supports(other, robot)]
    return ValueError(
        f"policy {entry.name!r} does not support robot {robot.name!r} ({KIND_TEXTS[robot.kind]}, "
        f"{robot.springs}): use one of {', '.join(fitting)}"
    )
