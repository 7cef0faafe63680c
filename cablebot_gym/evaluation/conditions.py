"""Conditions of an evaluation: everything but the policy and the payload."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np

from cablebot_gym.envs import check_robot, described
from cablebot_gym.envs.settings import KEYWORDS, default_trajectory
from cablebot_gym.evaluation.judge import CRITERIA
from cablebot_gym.motions import Trajectory, find_trajectory
from cablebot_gym.robots import Robot, private_robot
from cablebot_gym.task import ErrorBounds, find_error_bounds, payload_model_text, to_jsonable
from cablebot_gym.uncertainty import Uncertainty, find_uncertainty
from cablebot_gym.utils.checks import check_keywords, choice, whole
from cablebot_gym.utils.results import Printed

_RESERVED = (
    "payload",
    "payload_range",
    "num_envs",
    "max_episode_steps",
    "autoreset_mode",
)
"""Keywords of the environment that an evaluation sets itself or does not support."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Conditions(Printed):
    """Conditions that all episodes of an evaluation share. :meth:`of` makes and checks them.

    The fields are what was given, such as names, so that conditions can be stored; the properties
    are the objects. Conditions are equal if their stored forms are. None stands for the default of
    the robot or of the environment.
    """

    env_id: str
    """One of :data:`cablebot_gym.ENV_IDS`."""
    robot: Any = None
    """Nominal robot."""
    trajectory: Any = None
    """Reference motion."""
    error_bounds: Any = None
    """Bounds of the tracking errors."""
    control_frequency: float | None = None
    """Control frequency [Hz]."""
    measurement: Any = None
    """Sensors of the policy."""
    criterion: str = "task"
    """One of :data:`~cablebot_gym.evaluation.judge.CRITERIA`."""
    payload_known: bool = True
    """Whether the payload is known to the policy."""
    model_payload_factor: float = 1.0
    """Ratio of the payload in the policy's model to the nominal payload."""
    uncertainty: Any = None
    """Model errors and disturbances that the policy does not know."""
    draws: int | None = None
    """Number of episodes at each payload. None for
    :data:`~cablebot_gym.evaluation.batch.DEFAULT_DRAWS` if the uncertainty is random or the policy
    declares ``stochastic = True``, and for 1 otherwise."""
    seed: int = 0
    """Seed of the draws and of the payloads of the scan, which all policies therefore share."""
    further: Mapping[str, Any] = field(default_factory=dict)
    """Further keywords of the environment."""

    @classmethod
    def of(
        cls, env_id: str, function: Callable[..., Any] | None = None, **keywords: Any
    ) -> Conditions:
        """Checked conditions from the fields of this class and keywords of the environment.
        Messages about keywords list those of ``function``, which passes them on, too.

        Normalised or float32 observations are refused: policies read SI units in float64. A
        Stable-Baselines3 model that was trained on normalised observations still receives them.

        Raises:
            TypeError: if a keyword is unknown.
            ValueError: if an argument is invalid.
        """
        _check_keywords(keywords, function or cls.of)
        given = {}
        for name in _OWN:
            if name in keywords:
                given[name] = keywords.pop(name)
        choice("criterion", given.get("criterion", cls.criterion), CRITERIA)
        given["seed"] = whole("seed", given.get("seed", cls.seed))
        if given.get("draws") is not None:
            given["draws"] = whole("draws", given["draws"], least=1)
        check_robot(env_id, given.get("robot"))
        # others may change their objects, before and later
        conditions = cls(env_id=env_id, further=deepcopy(keywords), **deepcopy(given))
        conditions.bounds, conditions.model_error  # noqa: B018 - checks them
        return conditions

    @cached_property
    def nominal_robot(self) -> Robot:
        """Nominal robot, which shares nothing with other robots of the process."""
        return private_robot(self.env_id if self.robot is None else self.robot)

    @cached_property
    def bounds(self) -> ErrorBounds:
        """Bounds of the tracking errors."""
        return deepcopy(find_error_bounds(self.error_bounds, self.nominal_robot))

    @cached_property
    def motion(self) -> Trajectory:
        """Reference motion."""
        robot = self.nominal_robot
        return find_trajectory(self.trajectory or default_trajectory(robot), robot.kind)

    @cached_property
    def model_error(self) -> Uncertainty:
        """Model errors and disturbances that the policy does not know."""
        return find_uncertainty(self.uncertainty, self.nominal_robot)

    @property
    def uncertainty_name(self) -> str | None:
        """Name of the uncertainty, ``custom`` for data; None without uncertainty."""
        return self.uncertainty if isinstance(self.uncertainty, str | None) else "custom"

    @property
    def payload_model(self) -> str:
        """Payload model in words: ``payload known``, ``payload unknown`` or
        ``payload model × 0.9``."""
        return payload_model_text(self.payload_known, self.model_payload_factor)

    def keywords(self) -> dict[str, Any]:
        """Keywords of an evaluation with these conditions, as they were given; those at their
        defaults are left out."""
        given = dict(self.further)
        for name in _OWN:
            value = getattr(self, name)
            if value != getattr(Conditions, name):
                given[name] = value
        return given

    def env_keywords(self) -> dict[str, Any]:
        """Keywords of the environment: objects for robot, error bounds and uncertainty."""
        given = self.keywords()
        for name in ("criterion", "draws", "seed"):
            given.pop(name, None)
        return given | {
            "robot": self.nominal_robot,
            "error_bounds": self.bounds,
            "uncertainty": self.model_error,
        }

    def to_dict(self) -> dict[str, Any]:
        """The stored form: JSON-able fields that are not at their defaults."""
        data: dict[str, Any] = to_jsonable({"env_id": self.env_id, **self.keywords()})
        if isinstance(self.robot, Robot):
            data["robot"] = self.robot.to_dict()
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Conditions:
        """The conditions whose :meth:`to_dict` returned ``data``; they are not checked."""
        own = {name: value for name, value in data.items() if name in ("env_id", *_OWN)}
        further = {name: value for name, value in data.items() if name not in own}
        return cls(further=further, **own)

    def summary(self) -> dict[str, Any]:
        """JSON-able fields of a result that describe the conditions. ``Details.environment`` has the
        settings of the environment."""
        return {
            "env_id": self.env_id,
            "criterion": self.criterion,
            "payload_known": self.payload_known,
            "model_payload_factor": self.model_payload_factor,
            "uncertainty": self.uncertainty_name,
            "seed": self.seed,
        }

    @cached_property
    def key(self) -> str:
        """The stored form as text, equal for equal conditions."""
        return json.dumps(self.to_dict(), sort_keys=True, default=str)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Conditions) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)

    def __str__(self) -> str:
        robot = described(self.env_id, self.nominal_robot.name)
        uncertainty = self.uncertainty_name or "no uncertainty"
        return f"{robot}, {self.criterion} criterion, {self.payload_model}, {uncertainty}"


_OWN = tuple(item.name for item in fields(Conditions) if item.name not in ("env_id", "further"))
"""Fields of conditions that are keywords."""


def _check_keywords(given: Mapping[str, Any], function: Callable[..., Any]) -> None:
    """Checks the names of keywords, and that observations are in SI units and float64.

    Raises:
        TypeError: if a keyword is unknown.
        ValueError: if a keyword is not for evaluations.
    """
    for keyword in _RESERVED:
        if keyword in given:
            raise ValueError(f"{keyword} is set by the evaluation: remove it from the keywords")
    valid = dict.fromkeys([*_OWN, *KEYWORDS])
    check_keywords(given, [name for name in valid if name not in _RESERVED], function)
    if given.get("normalised_observation"):
        raise ValueError(
            "policies are evaluated with observations in SI units: remove normalised_observation"
        )
    if given.get("observation_dtype", np.float64) not in (np.float64, "float64"):
        raise ValueError(
            "policies are evaluated with observations in float64: remove observation_dtype"
        )
