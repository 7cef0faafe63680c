"""The functions that Python calls, compiled once for each form of robots."""

from __future__ import annotations

from functools import cache, partial
from typing import Any, NamedTuple

from cablebot_gym.physics.compiling import entry_point
from cablebot_gym.physics.kernel.integrate import advance_tiles
from cablebot_gym.physics.kernel.inverse import demanded_tiles, required_tiles
from cablebot_gym.physics.kernel.locate import locate_tiles
from cablebot_gym.physics.kernel.rows import Form


class Compiled(NamedTuple):
    """Functions for one form of robots, each an
    :class:`~cablebot_gym.physics.compiling.python_first.EntryPoint`.

    Shapes: parameters (tiles, parameter_rows·lanes), record (tiles, record_rows·lanes), w
    (scratch_rows·lanes,), paths (trajectories, lines, n): reference poses at physics steps, ends
    (trajectories,): last line of each path, path and step (tiles·lanes,): index of its path and
    control step of each lane. Of the inverse dynamics: parameters (parameter_rows,) of one robot, p
    (parameter_rows·lanes,) for a tile of copies, mass (N,), motion (3, N, n) = (X, Ẋ, Ẍ), structure
    (N, m, n), load and y (N, n).
    """

    advance: Any
    """``(unilateral, lags, rubs, parameters, record, w, paths, ends, path, step, substeps, h)``:
    one control period; changes ``record`` and ``step``. ``lags`` and ``rubs``: whether some motor
    has a lag or Coulomb friction; without them the code is faster."""
    required: Any
    """``(parameters, minimum, p, w, mass, motion, results)``: tensions, torques, pulley speeds and
    pulley accelerations (4, N, m), in the order of TENSIONS to PULLEY_ACCELERATIONS. As many cables as
    coordinates: the unique tensions; more cables, only of point masses in a plane: the smallest
    tensions of at least ``minimum``, one for each motion."""
    demanded: Any
    """``(parameters, p, w, mass, motion, structure, load, y, results)``: what a tension distribution
    needs, ``−Sᵀ T = load``, and pulley speeds and pulley accelerations (2, N, m). The coordinates
    of S and load are those of y."""
    locate: Any
    """``(parameters, tolerance, p, w, lengths, pose)``: poses (N, n), which are the guesses before, of
    cable lengths (N, m). ``parameters`` have mass and inertia for the damping, no gravity, and J/r² =
    1."""


STEPS_TO_LOCATE = 8
"""Usual number of steps of the forward kinematics."""


@cache
def compiled(form: Form, lanes: int) -> Compiled:
    """The functions for a form: one source, compiled for one lane and for a tile, for each kind and
    each number of cables, whose loops are unrolled. Numba compiles for the form because the
    functions close over it."""

    compile_form = partial(entry_point, flat=True)
    # the layout of a record depends on the lanes, unlike that of motions
    compile_motion = partial(compile_form, in_python={"lanes": 1})
    # estimated time of Python for one stage of the integration of one robot [s]
    stage = 1e-5 + 1.5e-6 * form.cables * form.coordinates**2

    def seconds_to_advance(*arguments: Any) -> float:
        step, substeps = arguments[9:11]
        return 4 * stage * len(step) * substeps

    @compile_form(seconds=seconds_to_advance)
    def advance(
        unilateral, lags, rubs, parameters, record, w, paths, ends, path, step, substeps, h
    ):
        advance_tiles(
            form,
            lanes,
            unilateral,
            lags,
            rubs,
            parameters,
            record,
            w,
            paths,
            ends,
            path,
            step,
            substeps,
            h,
        )

    @compile_motion(seconds=lambda parameters, minimum, p, w, mass, *_: stage * len(mass))
    def required(parameters, minimum, p, w, mass, motion, results):
        required_tiles(form, lanes, parameters, minimum, p, w, mass, motion, results)

    @compile_motion(seconds=lambda parameters, p, w, mass, *_: stage * len(mass))
    def demanded(parameters, p, w, mass, motion, structure, load, y, results):
        demanded_tiles(form, lanes, parameters, p, w, mass, motion, structure, load, y, results)

    @compile_motion(seconds=lambda *arguments: STEPS_TO_LOCATE * stage * len(arguments[4]))
    def locate(parameters, tolerance, p, w, lengths, pose):
        locate_tiles(form, lanes, parameters, tolerance, p, w, lengths, pose)

    return Compiled(advance, required, demanded, locate)
