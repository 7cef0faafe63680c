"""The flexible transmission: the paper's values, its frequencies, and the number of physics steps
that they need."""

import re

import gymnasium as gym
import numpy as np
import pytest
from oracles.plants import (
    State,
    advance,
    flexible_robots,
    free_motors,
    holding_state,
    loaded_plant,
    state_of,
    with_transmission,
)

from cablebot_gym.envs.settings import make_settings
from cablebot_gym.physics import textbook
from cablebot_gym.robots import (
    FLEX_PLANAR,
    FLEX_SPATIAL,
    PLANAR,
    SPATIAL,
    Transmission,
)


@pytest.mark.parametrize(("flexible", "rigid"), [(FLEX_PLANAR, PLANAR), (FLEX_SPATIAL, SPATIAL)])
def test_flexible_robots_have_the_values_of_table_5(flexible, rigid):
    """J = J′ = 4e-4, half of the rigid robot's each; K = 3 of §5.2.3; Eq. 4 has no damping."""
    assert flexible.transmission == Transmission(
        pulley_radius=0.05,
        pulley_inertia=4e-4,
        damping=0.0,
        stiffness=3.0,
        motor_inertia=4e-4,
        motor_damping=0.0,
    )
    assert flexible.replace(name=rigid.name, transmission=rigid.transmission) == rigid
    with pytest.raises(ValueError, match="has a transmission without motor_damping"):
        _ = rigid.motor_damping


@pytest.mark.parametrize(
    ("robot", "changes", "message"),
    [
        (PLANAR, {"stiffness": 3.0}, "needs stiffness and motor_inertia"),
        (PLANAR, {"motor_damping": 0.01}, "has no motor_damping"),
        (
            FLEX_PLANAR,
            {"motor_inertia": None},
            "needs stiffness and motor_inertia",
        ),
        (FLEX_PLANAR, {"stiffness": (3.0, 3.0, 0.0)}, "stiffness must be"),
        (FLEX_PLANAR, {"motor_inertia": np.inf}, "motor_inertia must be"),
        (FLEX_PLANAR, {"motor_damping": -0.01}, "motor_damping must be"),
    ],
)
def test_unphysical_transmission_raises(robot, changes, message):
    with pytest.raises(ValueError, match=message):
        with_transmission(robot, **changes)


# --- frequencies --------------------------------------------------------------------------------------------------


@flexible_robots
def test_highest_frequency_is_that_of_the_linearised_kernel(robot):
    """Within 1 %, which the pretension of the cables takes: the formula leaves it out."""
    robot = free_motors(with_transmission(robot, damping=0.0, motor_damping=0.0))
    period = 2e-3
    nudge = 1e-5
    state, torques = holding_state(robot, robot.home)
    middle = np.concatenate([value[0] for value in vars(state).values()])
    nudges = nudge * np.eye(len(middle))
    sizes = np.cumsum([robot.coordinates, robot.coordinates, robot.cables])
    plant = loaded_plant(
        robot,
        State(
            *np.split(
                np.concatenate([middle + nudges, middle - nudges]),
                sizes,
                axis=1,
            )
        ),
    )
    advance(plant, torques, period, 20)
    ahead, behind = np.split(np.concatenate(list(vars(state_of(plant)).values()), axis=1), 2)
    rates = np.log(np.linalg.eigvals((ahead - behind).T / (2 * nudge)).astype(complex)) / period
    assert np.abs(rates.imag).max() == pytest.approx(textbook.highest_frequency(robot), rel=0.01)


# --- physics steps ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "changes",
    [{"stiffness": 3e4}, {"motor_inertia": 1e-6}],
    ids=["stiff", "light"],
)
def test_springs_too_stiff_for_the_substeps_raise(changes):
    """The message names the number of substeps that suffices; one less does not."""
    robot = with_transmission(FLEX_SPATIAL, **changes)
    with pytest.raises(ValueError, match="use at least") as refusal:
        gym.make_vec("CableBot-FlexSpatial-v0", num_envs=2, robot=robot, substeps=1)
    least = int(re.findall(r"at least (\d+)", str(refusal.value))[0])
    make_settings(robot=robot, count=1, substeps=least)
    with pytest.raises(ValueError, match=f"use at least {least}"):
        make_settings(robot=robot, count=1, substeps=least - 1)
    assert make_settings(robot=robot, count=1).substeps >= least
    with pytest.raises(ValueError, match="physics steps in a control period"):
        make_settings(robot=with_transmission(robot, motor_inertia=1e-12), count=1)


def test_least_substeps_are_stable_and_larger_steps_are_not():
    """At home under holding torques a nudge stays small with the substeps that the error names."""
    stiff = free_motors(with_transmission(FLEX_SPATIAL, stiffness=3e4))
    with pytest.raises(ValueError, match="use at least") as refusal:
        make_settings(robot=stiff, count=1, substeps=1)
    least = int(re.findall(r"at least (\d+)", str(refusal.value))[0])
    state, torques = holding_state(stiff, stiff.home)
    growth = []
    for step in (1 / (500 * least), 2.9 / textbook.highest_frequency(stiff)):
        plant = loaded_plant(
            stiff,
            State(state.pose, state.velocity, state.angle + 1e-9, state.speed),
        )
        for _ in range(50):
            advance(plant, torques, 20 * step, 20)
        growth.append(np.abs(plant.motor_angle - state.angle).max())
    assert growth[0] < 1e-6
    assert not growth[1] < 1e-3
