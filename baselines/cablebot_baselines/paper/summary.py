"""What a reader should know who reads nothing else: which findings of the paper reproduce, which do not, and why."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from cablebot_baselines.paper.finding import Absent, Run, as_text, kilograms, off, short
from cablebot_baselines.paper.published import LOADS
from cablebot_baselines.paper.verdicts import LAYER, LAYERS, looped, nearest, with_published_motor

Row = Mapping[str, Any]
"""One published number or claim beside its finding."""

Why = Callable[[Run], str]
"""The numbers that decide, and the cause, in one or two sentences."""

HEADINGS = {
    "reproduces": "What reproduces",
    "in part": "What reproduces in part",
    "does not": "What does not",
    "cannot be decided": "What cannot be decided",
}
"""Of the lists of points, by verdict."""


def points(run: Run, rows: Sequence[Row]) -> Iterator[tuple[str, str]]:
    """The verdict on each point, and the point in Markdown; what was not run is left out."""
    found = {row["key"]: row for row in rows}
    for keys, title, why in POINTS:
        judged = [found[key] for key in keys if key in found]
        verdicts = {row["verdict"] for row in judged}
        if len(judged) < len(keys) or None in verdicts:
            continue
        try:
            words = why(run)
        except Absent:
            words = ""  # the readings chosen leave nothing to say; the rows tell why
        places = ", ".join(dict.fromkeys(row["place"] for row in judged))
        verdict = verdicts.pop() if len(verdicts) == 1 else "in part"
        yield verdict, f"**{title}** ({places}). {words}".rstrip()


def _of(published: float, load: float | None) -> str:
    return kilograms(load) + ("" if load is None else f" ({off(load, published)})")


def _motors(run: Run) -> str:
    each = {"planar": "fig10", "spatial": "fig12", "with joint springs by Eqs. 23–25": "fig15.state_space"}
    keys = {words: f"{stem}{'_' if '.' in stem else '.'}" for words, stem in each.items()}
    said = (
        f"{words} motor {short(run.number(f'{key}motor'))} at {short(run.number(f'{key}time_s'))} s"
        for words, key in keys.items()
    )
    return f"Published: the second, each time. Ours: {', '.join(said)}."


def _rigid(run: Run) -> str:
    planar, spatial = (short(run.number(f"{part}.least_tension_N")) for part in ("fig5", "fig6"))
    errors = [short(run.number(f"{part}.peak_error_mm")) for part in ("fig11", "fig13")]
    return (
        f"Least tension {planar} N (planar) and {spatial} N (spatial). At the largest payload, which the law is told, "
        f"the error is at most {errors[0]} mm (planar) and {errors[1]} mm (spatial); R is 10 mm."
    )


def _poles(run: Run) -> str:
    def errors(name: str) -> str:
        each = (as_text(100 * run.number(f"claims.{name}_error_{kind}"), 2) for kind in ("planar", "spatial"))
        return " and ".join(f"{error} %" for error in each)

    return (
        f"Let go beside its reference, a robot follows Eqs. 14 and 19 to {errors('pole')} of the first error (planar, "
        f"spatial) with 10 000 commands a second, to {errors('sampled_pole')} with 500."
    )


def _robust(run: Run) -> str:
    def shares(prefix: str) -> str:
        return ", ".join(short(100 * run.number(f"fig9.{prefix}_reduction_{layer}")) for layer in LAYERS)

    total, largest = (run.number(f"fig9.flex_{name}_reduction_{LAYER}") for name in ("sum", "max"))
    return (
        f"With joint springs and a boundary layer ε = {LAYER} the sum of the error falls by {short(100 * total)} %, "
        f"its largest value by {short(100 * largest)} %. The paper prints no layer, and it decides: at ε = "
        f"{', '.join(LAYERS)} the sum falls by {shares('flex_sum')} %, without springs by {shares('sum')} %."
    )


def _planar_load(run: Run) -> str:
    target, best = LOADS["planar"], run.maybe("scan.planar_best_added_kg")
    turned = "" if best is None else f" However the triangle is turned, no more than {kilograms(best)} can be added so."
    return (
        f"Published: about {target:g} kg. Ours: {_of(target, run.optional('fig10.counted_kg'))}; platform and load "
        f"together, by exact tracking, {_of(target, run.optional('fig10.exact_total_mass_kg'))}.{turned}"
    )


def _spatial_load(run: Run) -> str:
    target, loads = LOADS["spatial"], with_published_motor(run, "spatial")
    near = (
        "" if not loads else f" Of all the readings with the published motor the closest: {nearest('spatial', loads)}."
    )
    hits, geometries = run.maybe("scan.hits"), run.maybe("scan.geometries")
    many = ""
    second = run.maybe("scan.hits_second_motor")
    if hits is not None and geometries is not None and second is not None:
        many = (
            f" That proves none of them: {int(hits)} of {int(geometries)} geometries that were tried give the number "
            f"too, {int(second)} of them with motor 2 first."
        )
    return f"Published: about {target:g} kg. Ours: {_of(target, run.optional('fig12.counted_kg'))}.{near}{many}"


def _spring_load(run: Run) -> str:
    target = LOADS["flexible"]
    branches = ""
    if None not in (both := [run.maybe(f"readings.loop_flex_fl4_{branch}_kg") for branch in ("first", "second")]):
        each = " or ".join(kilograms(load) for load in both)
        branches = f": even which branch of Table 3 holds at 0.5 s sharp moves the payload of `fl4`, {each}"
    loops = ""
    if looped(run, "fig15"):
        own, law = (run.optional(f"fig15.{name}counted_kg") for name in ("eq22_", ""))
        loops = f"; by its law (Eq. 22) on the robot {kilograms(own)}; by `fl4`, a law that works, {_of(target, law)}"
    loads = with_published_motor(run, "flexible")
    near = f" (of all readings the closest: {nearest('flexible', loads)})" if loads else ""
    return (
        f"Published: {target:g} kg. By the paper's state space (Eqs. 23–25), which is the motion of no robot, "
        f"{_of(target, run.optional('fig15.state_space_counted_kg'))}{near}{loops}. No robot with joint springs "
        f"follows a jump of the acceleration exactly{branches}."
    )


def _drop(run: Run) -> str:
    space, own = 100 * run.number("fig15.state_space_drop_share"), 100 * (1 - LOADS["flexible"] / LOADS["spatial"])
    law = f", {short(100 * run.number('fig15.drop_share'))} % with `fl4`" if looped(run, "fig15") else ""
    return (
        f"Published: about 30 %. Ours: {short(space)} % by Eqs. 23–25{law}. The paper's own two loads are {short(own)} "
        "% apart."
    )


def _eq22(run: Run) -> str:
    soft, stiff = (short(run.number(f"eq22.max_growth_{name}")) for name in ("K2", "K3"))
    return (
        "Its loop has no s³ term, so that some root grows for every stiffness and all gains: at "
        f"{soft} 1/s for K = 2, {stiff} 1/s for K = 3. On the robot the error reaches "
        f"{short(run.number('fig14.eq22_peak_error_mm'))} mm; R is 10 mm. The robust term is a stiffer PD and does not "
        "help; friction of the motors does, and so do other laws."
    )


def _ringing(run: Run) -> str:
    before, after, late = (short(run.number(f"fig7.ripple_{when}_Nm")) for when in ("before", "after", "late"))
    return (
        f"By Eqs. 23–25 the ripple is {before} N·m rms before the input changes, {after} N·m after it, and still "
        f"{late} N·m in the last 0.2 s: nothing in these equations damps it."
    )


def _uncontrollable(run: Run) -> str:
    rank, states = (int(run.number(f"eq22.{name}")) for name in ("controllable_states", "states"))
    return f"{rank} of {states} states are controllable: the torques reach the platform through the springs."


def _algorithm(run: Run) -> str:
    return (
        f"As printed they end at {short(run.number('eq37.literal_over_true'))} times the payload: τ± is what the "
        "loaded robot leaves of the torque, and has to be what the empty one leaves."
    )


def _accuracy(run: Run) -> str:
    told, untold = (run.optional(f"claims.fl_{name}_paper_kg") for name in ("told", "untold"))
    return (
        f"Told the load, the law carries {kilograms(told)} with the spatial robot; not told, {kilograms(untold)}, by "
        "the same criterion."
    )


def _open_loop(run: Run) -> str:
    def pair(criterion: str) -> str:
        loads = (run.optional(f"claims.{loop}_loop_spatial{criterion}_kg") for loop in ("closed", "open"))
        closed, opened = loads
        return f"{kilograms(closed)} against {kilograms(opened)}"

    return (
        f"It tracks better under Table 6, and where errors decide, the spatial robot carries {pair('')} in open loop. "
        f"Where motors decide, as in the paper's criterion, it is {pair('_paper')}."
    )


def _cables(run: Run) -> str:
    return "Neither the paper nor this project has a model of elastic cables."


POINTS: tuple[tuple[tuple[str, ...], str, Why], ...] = (
    (("5.2.1.motor", "5.2.2.motor", "5.2.3.motor"), "Which motor saturates first", _motors),
    (("4.1.tension", "5.2.1.path", "5.2.2.path"), "Rigid robots stay taut and within R", _rigid),
    (("3.1.poles", "3.2.poles"), "Poles of the rigid robots' errors", _poles),
    (("4.4.sum", "4.4.max"), "More than 60 % less error with the robust term", _robust),
    (("1.controller", "6.open-tracking", "6.open-payload"), "Feedback is better than open loop", _open_loop),
    (("5.2.1.payload",), "Load capacity of the planar robot", _planar_load),
    (("5.2.2.payload", "5.2.3.rigid"), "Load capacity of the spatial robot", _spatial_load),
    (("5.2.3.payload",), "Load capacity with joint springs", _spring_load),
    (("6.drop",), "Payload that joint springs take away", _drop),
    (("3.3.linear", "3.3.robust", "5.2.3.stable", "5.2.3.path"), "Eq. 22 tracks with joint springs", _eq22),
    (("4.3.vibration",), "Torques vibrate only when the input changes", _ringing),
    (("3.4.uncontrollable",), "Joint springs make the robot uncontrollable", _uncontrollable),
    (("5.1.answer",), "Eqs. 37–39 give the payload", _algorithm),
    (("5.1.accuracy",), "In closed loop accuracy needs no attention", _accuracy),
    (("1.elasticity",), "Elastic cables matter", _cables),
)
"""Keys of the findings, what they say together, and why."""
