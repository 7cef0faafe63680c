"""Best known payload of a drawn robot: what a planner reaches that knows the draw of an uncertainty.

It is what anybody can hope for under the uncertainty, and like
:func:`~cablebot_gym.bounds.best_known.find_best_known` a lower bound that replays verify. Needs the
extra ``optimal``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np

from cablebot_gym.bounds.best_known import (
    BestKnownPayload,
    BestKnownReplay,
    _case,
    _Problem,
    find_best_known,
)
from cablebot_gym.bounds.tightening import Tightening
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.kinematics import Array
from cablebot_gym.planning import Follower, Infeasible, Margins, MotionProgram, PlannedMotion, State
from cablebot_gym.robots import Robot
from cablebot_gym.uncertainty import PARAMETERS, Uncertainty, find_uncertainty, scaled_tensor
from cablebot_gym.utils.checks import whole

COARSE = 0.012
"""Largest relative difference of the nominal payload on a coarse mesh from that on the finest one.
The drawn robot is planned on the coarsest such mesh, and compared with the nominal payload there."""

_SCALES = {"rigid": (4.0, 20.0), "flexible": (20.0, 80.0)}
"""Factors of the least margins of the replayed motions by joints of the robot; the next one follows
where no replay succeeds. Springs oscillate about the plan, because the motors lag."""

_LARGEST_GROWTH = 0.02
"""Largest growth of a margin of the actions in one trial."""

_FLEXIBLE_GAINS = (25.0, 5.0)
"""Gains (K_P, K_D) of the controller of flexible robots [1/s², 1/s]. A lag of the motors makes larger
ones oscillate."""

_MOTOR_FREQUENCY = 100.0
"""Frequency of the motor loop of flexible robots in that controller [rad/s]."""

_TENSION_PERIODS = 2.5
"""Control periods about an instant within which the controller keeps the margin to the minimum
tension: an action that lags behind changes the tensions of the next periods."""


@dataclass(frozen=True, kw_only=True)
class DrawnPayload:
    """Best known payload of one draw of an uncertainty."""

    payload: float | None
    """Best known payload as the judge counts it, the nominal one [kg]; None if none was found."""
    verified: bool
    """Whether all replays of the inputs carry the payload in the environment with this draw."""
    replays: tuple[BestKnownReplay, ...]
    """Replays with the environment's physics step and with a tenth of it."""
    intervals: int
    """Intervals of the mesh."""
    nominal_payload: float
    """Best known payload of the nominal robot [kg]."""
    reference: float
    """Best known payload of the nominal robot on the mesh of the draw [kg]: the nominal payload,
    reduced as the payload of the program is between the finest mesh and this one."""

    @property
    def ratio(self) -> float | None:
        """Payload of the draw as a fraction of the nominal one on the same mesh; None unless it is
        verified."""
        if self.payload is None or not self.verified or self.reference <= 0:
            return None
        return self.payload / self.reference


def find_drawn_best_known(
    env_id: str, *, uncertainty: str, seed: int, cache: bool = True, **options: Any
) -> DrawnPayload:
    """Computes the best known payload of one draw of an uncertainty, for a planner that knows it.

    The environment makes the draw. The plan is that of the nominal robot, moved to the drawn one on
    a coarse mesh and from one start, so it takes a fraction of the time of
    :func:`~cablebot_gym.bounds.best_known.find_best_known`. The following enters it:

    * The plan knows mass, inertia, anchors, pulleys, friction, damping, stiffness and motor strength
      of the drawn robot, and the factor of its payload.
    * The controller that computes the inputs knows the lag of the motors and the delay: it acts
      earlier. It sees the true state, and thus answers the wrench with feedback. Where this exceeds
      a limit, the plan keeps a margin.
    * Noise and bias of the sensors have no effect, because the inputs are replayed without feedback.

    The wrench of a draw is that of the reset with its seed for all payloads. An evaluation has
    another one of the same distribution at each payload.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        uncertainty: uncertainty, as for :func:`~cablebot_gym.uncertainty.find_uncertainty`.
        seed: seed of the draw.
        cache: whether to read the nominal result from the disk cache and to store it there.
        options: ``robot``, ``trajectory``, ``error_bounds`` and ``control_frequency`` of
            :func:`~cablebot_gym.bounds.best_known.find_best_known`.

    Raises:
        ImportError: if CasADi is missing; the message names the command that installs it.
        ValueError: if an argument is invalid, or if no motion of the nominal robot is found.
    """
    nominal = find_best_known(env_id, cache=cache, **options)
    case = _DrawnCase.of(_case(env_id, **options), uncertainty, whole("seed", seed))
    intervals, mesh_payload = _coarse_mesh(nominal)
    verified = case.verified(intervals, nominal.motion)
    payload = None
    replays: tuple[BestKnownReplay, ...] = ()
    if verified is not None:
        payload = case.nominal_payload(verified.motion.payload)
        replays = verified.replays
    return DrawnPayload(
        payload=payload,
        verified=verified is not None and nominal.verified,
        replays=replays,
        intervals=intervals,
        nominal_payload=nominal.payload,
        reference=nominal.payload * mesh_payload / nominal.program_payload,
    )


def drawn_robot(robot: Robot, truth: Mapping[str, Array]) -> Robot:
    """The nominal robot with the true parameters of an episode, without its payload.

    Args:
        robot: nominal robot.
        truth: true parameters by name, as ``env.unwrapped.truth``.
    """
    values = {PARAMETERS[name].attribute: value for name, value in truth.items()}
    motors = robot.motors.replace(stall_torque=values["stall_torque"], lag=values["motor_lag"])
    names = set(values) & set(vars(robot.transmission))
    transmission = robot.transmission.replace(**{name: values[name] for name in names})
    changes: dict[str, Any] = {"base_anchors": values["base"], "mass": float(values["mass"])}
    if not robot.point_mass:
        changes["platform_anchors"] = values["platform"]
        changes["inertia"] = values["moments"]
        if not robot.planar:
            (changes["inertia"],) = scaled_tensor(robot, values["moments"][None])
    return robot.replace(motors=motors, transmission=transmission, **changes)


def _coarse_mesh(nominal: BestKnownPayload) -> tuple[int, float]:
    """Number of intervals and payload [kg] of the coarsest mesh that is close to the finest one."""
    for intervals, payload in nominal.meshes:
        if payload >= (1 - COARSE) * nominal.program_payload:
            return intervals, payload
    return nominal.meshes[-1]


@dataclass(frozen=True, kw_only=True)
class _Draw:
    """A draw of an uncertainty."""

    nominal: Robot
    """Nominal robot."""
    uncertainty: Uncertainty
    """The uncertainty."""
    seed: int
    """Seed of the draw."""
    env: CableBotEnv
    """Environment with the uncertainty."""
    lag: float
    """Mean time constant of the motors [s]."""
    scale: float = 1.0
    """Factor of the least margins."""

    def reset(self, payload: float) -> Mapping[str, Array]:
        """Starts an episode of the draw with a nominal payload [kg]; its true parameters."""
        self.env.reset(seed=self.seed, options={"payload": payload})
        return self.env.truth


@dataclass(frozen=True)
class _DrawnCase(_Problem):
    """The problem of a drawn robot. ``robot`` is the drawn one without lag, and all payloads are
    true ones."""

    draw: _Draw

    @classmethod
    def of(cls, case: _Problem, uncertainty: str, seed: int) -> _DrawnCase:
        """The problem of a draw of the robot of a case.

        Raises:
            ValueError: if the uncertainty is unknown or impossible for the robot.
        """
        nominal = case.robot
        checked = find_uncertainty(uncertainty, nominal)
        env = gym.make(
            case.env_id,
            uncertainty=checked,
            max_episode_steps=None,
            **case.conditions,
        ).unwrapped
        assert isinstance(env, CableBotEnv)
        env.reset(seed=seed)
        true = drawn_robot(nominal, env.truth)
        lag = float(true.motor_lag.mean())
        draw = _Draw(nominal=nominal, uncertainty=checked, seed=seed, env=env, lag=lag)
        planned = true.replace(motors=true.motors.replace(lag=0.0))
        fields = {name: value for name, value in vars(case).items() if name != "robot"}
        return cls(robot=planned, draw=draw, **fields)

    def verified(self, intervals: int, start: PlannedMotion) -> Any:
        """The motion from a start whose inputs pass all replays; None if there is none."""
        start = self._without_friction(intervals, start)
        for scale in _SCALES[self.robot.joints]:
            case = replace(self, draw=replace(self.draw, scale=scale))
            result = case._verify(case._program(intervals), start, lambda _: None)
            if result is not None:
                return result
        return None

    def _without_friction(self, intervals: int, start: PlannedMotion) -> PlannedMotion:
        """The motion of the drawn robot without Coulomb and load friction, which is smooth and therefore
        takes a third of the iterations; the start if there is none."""
        transmission = self.robot.transmission.replace(coulomb_friction=0.0, load_friction=0.0)
        case = replace(self, robot=self.robot.replace(transmission=transmission))
        try:
            return case._program(intervals).solve(start)
        except Infeasible:
            return start

    def nominal_payload(self, payload: float) -> float:
        """Nominal payload of a true payload [kg]. The true one is affine in the nominal one."""
        low = self.draw.nominal.mass
        high = 2 * self.draw.nominal.mass
        true_low, true_high = (float(self.draw.reset(mass)["payload"]) for mass in (low, high))
        return low + (payload - true_low) * (high - low) / (true_high - true_low)

    @property
    def conditions(self) -> dict[str, Any]:
        """Those of the nominal robot with the uncertainty that draws this one."""
        draw = self.draw
        return super().conditions | {"robot": draw.nominal, "uncertainty": draw.uncertainty}

    @property
    def follower(self) -> Follower:
        if not self.robot.flexible:
            return super().follower
        gains = _FLEXIBLE_GAINS
        frequency = _MOTOR_FREQUENCY
        return Follower(robot=self.robot, gains=gains, motor_frequency=frequency)

    @property
    def tension_reach(self) -> float:
        return _TENSION_PERIODS / self.control_frequency

    @property
    def tightening(self) -> Tightening:
        return replace(
            super().tightening,
            scale=self.draw.scale,
            largest_growth=_LARGEST_GROWTH,
        )

    def _first_motion(
        self, program: MotionProgram, start: PlannedMotion, margins: Margins
    ) -> PlannedMotion:
        program.set_margins(margins)
        try:
            return program.solve(start, near=True)
        except Infeasible:  # the draw can be too far from the nominal robot
            return super()._first_motion(program, start, margins)

    def _state_of_action(self, motion: PlannedMotion, state: State) -> State:
        """The state after the lag: the plan moves on, and the errors stay."""
        later = state.time + self.draw.lag
        now = motion(state.time)
        then = motion(later)
        ahead = replace(
            state,
            time=later,
            pose=state.pose + then.position - now.position,
            velocity=state.velocity + then.velocity - now.velocity,
        )
        if state.motor_angle is None or state.motor_speed is None:
            return ahead
        angle, speed, _ = motion.motor_motion(state.time, motion.payload)
        later_angle, later_speed, _ = motion.motor_motion(later, motion.payload)
        return replace(
            ahead,
            motor_angle=state.motor_angle + later_angle - angle,
            motor_speed=state.motor_speed + later_speed - speed,
        )

    def _record(self, policy: Any, payload: float, **keywords: Any) -> Rollout:
        """Records the episode of this seed."""
        return super()._record(
            policy,
            self.nominal_payload(payload),
            seed=self.draw.seed,
            noise_seed=self.draw.seed,
            **keywords,
        )

    def _record_tracking(self, policy: Callable[[Array], Array], payload: float) -> Rollout:
        """The episode without delay and with exact measurements, in which the first actions are those
        that hold the robot while the others are delayed."""
        prompt = replace(self.draw.uncertainty, delay=0, sensors=None, sensor_bias=None)
        holding = iter(self._holding_actions(payload))

        def track(observation: Array) -> Array:
            action = policy(observation)
            return next(holding, action)

        return self._record(track, payload, uncertainty=prompt)

    def _replays(self, actions: Array, payload: float) -> Iterator[tuple[BestKnownReplay, Rollout]]:
        """Replays of the actions, which are sent earlier by the delay."""
        delay = len(self._holding_actions(payload))
        last = np.repeat(actions[-1:], delay, axis=0)
        return super()._replays(np.concatenate([actions[delay:], last]), payload)

    def _holding_actions(self, payload: float) -> list[Array]:
        """Actions that the environment applies until the first delayed one arrives, (delay, m)."""
        self.draw.reset(self.nominal_payload(payload))
        sent = np.full(self.robot.cables, 0.123)  # unlike any action that holds a robot
        holding: list[Array] = []
        while True:
            *_, info = self.draw.env.step(sent)
            if np.array_equal(info["commanded_action"], sent):
                return holding
            holding.append(np.array(info["commanded_action"]))
