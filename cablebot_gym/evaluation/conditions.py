"""Conditions of an evaluation: everything but the policy and the payload."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np

from cablebot_gym.envs import check_robot, described
from cablebot_gym.envs.settings import KEYWORDS
from cablebot_gym.evaluation.constraints import Criterion, find_criterion
from cablebot_gym.robots import Robot, private_robot
from cablebot_gym.task import ErrorBounds, find_error_bounds, payload_model_text
from cablebot_gym.uncertainty import Uncertainty, find_uncertainty
from cablebot_gym.utils.checks import UnexpectedKeywordError, check_keywords, whole
from cablebot_gym.utils.results import Printed

_RESERVED = (
    "payload",
    "payload_range",
    "num_envs",
    "threads",
    "max_episode_steps",
    "autoreset_mode",
)
"""Keywords of the environment that an evaluation sets itself or does not support."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Conditions(Printed):
    """Conditions that all episodes of an evaluation share. :meth:`of` makes and checks them."""

    env_id: str
    """One of :data:`cablebot_gym.ENV_IDS`."""
    robot: Robot
    """Nominal robot."""
    criterion: Criterion
    """``task`` (saturated motors; position, rotation, tension) or ``paper`` (|a| ≤ 1, position,
    slack)."""
    error_bounds: ErrorBounds
    """Bounds of the tracking errors."""
    uncertainty: Uncertainty
    """Model errors and disturbances that the policy does not know."""
    uncertainty_name: str | None
    """Name of the uncertainty, ``custom`` for data; None without uncertainty."""
    draws: int | None
    """Number of episodes at each payload. None for
    :data:`~cablebot_gym.evaluation.batch.DEFAULT_DRAWS` if the uncertainty is random or the policy
    declares ``stochastic = True``, and for 1 otherwise."""
    seed: int
    """Seed of the draws and of the payloads of the scan, which all policies therefore share."""
    keywords: Mapping[str, Any]
    """Further keywords of the environment: ``trajectory``, ``payload_known``,
    ``control_frequency``, …"""

    @classmethod
    def of(
        cls,
        env_id: str,
        function: Callable[..., Any] | None = None,
        *,
        robot: str | dict[str, Any] | Robot | None = None,
        criterion: str = "task",
        error_bounds: ErrorBounds | dict[str, float] | None = None,
        uncertainty: Any = None,
        draws: int | None = None,
        seed: int = 0,
        **keywords: Any,
    ) -> Conditions:
        """Checked conditions. None stands for the default of the robot or of the environment.
        Messages about keywords list those of ``function``, which passes them on, too.

        ``keywords`` are those of the environment. Normalised or float32 observations are refused:
        policies read SI units in float64. A Stable-Baselines3 model that was trained on normalised
        observations still receives them.

        Raises:
            ValueError: if an argument is invalid.
        """
        for keyword in _RESERVED:
            if keyword in keywords:
                raise ValueError(f"{keyword} is set by the evaluation: remove it from the keywords")
        valid = [name for name in KEYWORDS if name not in _RESERVED]
        check_keywords(keywords, valid, function or cls.of, cls.of)
        if keywords.get("normalised_observation"):
            raise ValueError(
                "policies are evaluated with observations in SI units: "
                "remove normalised_observation"
            )
        if keywords.get("observation_dtype", np.float64) not in (np.float64, "float64"):
            raise ValueError(
                "policies are evaluated with observations in float64: remove observation_dtype"
            )
        criterion = find_criterion(criterion)
        seed = whole("seed", seed)
        if draws is not None:
            draws = whole("draws", draws, least=1)
        check_robot(env_id, robot)
        # others may change their objects, before and later
        nominal = private_robot(env_id if robot is None else robot)
        bounds = deepcopy(find_error_bounds(error_bounds, nominal))
        name = uncertainty if isinstance(uncertainty, str | None) else "custom"
        return cls(
            env_id=env_id,
            robot=nominal,
            criterion=criterion,
            error_bounds=bounds,
            uncertainty=find_uncertainty(uncertainty, nominal),
            uncertainty_name=name,
            draws=draws,
            seed=seed,
            keywords=deepcopy(keywords),
        )

    @classmethod
    def of_episode(cls, env_id: str, function: Callable[..., Any], **keywords: Any) -> Conditions:
        """Checked conditions of a single episode, as from :meth:`of`.

        Raises:
            ValueError: if an argument is invalid, or the number of ``draws`` is given.
        """
        if "draws" in keywords:
            raise UnexpectedKeywordError(
                "got an unexpected keyword argument 'draws'; "
                f"{function.__name__} runs one episode: seed selects its draw"
            )
        return cls.of(env_id, function, draws=1, **keywords)

    @property
    def payload_known(self) -> bool:
        """Whether the payload is known to the policy."""
        return bool(self.keywords.get("payload_known", True))

    @property
    def model_payload_factor(self) -> float:
        """Ratio of the payload in the policy's model to the nominal payload."""
        return float(self.keywords.get("model_payload_factor", 1.0))

    @property
    def payload_model(self) -> str:
        """Payload model in words: ``payload known``, ``payload unknown`` or
        ``payload model × 0.9``."""
        return payload_model_text(self.payload_known, self.model_payload_factor)

    def __str__(self) -> str:
        robot = described(self.env_id, self.robot.name)
        uncertainty = self.uncertainty_name or "no uncertainty"
        return f"{robot}, {self.criterion} criterion, {self.payload_model}, {uncertainty}"

    def to_dict(self) -> dict[str, Any]:
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
