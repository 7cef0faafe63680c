"""Summary of the reproduction: which findings of the paper are reproduced, which are not, and the reasons."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from cablebot_baselines.paper.finding import MissingNumber, Run, as_text, kilograms, relative_difference, short
from cablebot_baselines.paper.published import LOADS
from cablebot_baselines.paper.verdicts import LAYER, LAYERS, is_simulated, nearest, with_published_motor

Row = Mapping[str, Any]
"""One published number or claim with its finding."""

Explanation = Callable[[Run], str]
"""Function that returns the decisive numbers and the cause in one or two sentences."""

HEADINGS = {
    "reproduced": "Reproduced",
    "partly reproduced": "Partly reproduced",
    "not reproduced": "Not reproduced",
    "undecided": "Undecided",
}
"""Headings of the lists of points by verdict."""


def points(run: Run, rows: Sequence[Row]) -> Iterator[tuple[str, str]]:
    """Yields the verdict on each point and the point in Markdown. Points that were not run are omitted."""
    by_key = {row["key"]: row for row in rows}
    for keys, title, explain in POINTS:
        judged = [by_key[key] for key in keys if key in by_key]
        verdicts = {row["verdict"] for row in judged}
        if len(judged) < len(keys) or None in verdicts:
            continue
        try:
            words = explain(run)
        except MissingNumber:
            words = ""  # the interpretation does not allow the numbers; the rows state the reason
        places = ", ".join(dict.fromkeys(row["place"] for row in judged))
        verdict = verdicts.pop() if len(verdicts) == 1 else "partly reproduced"
        yield verdict, f"**{title}** ({places}). {words}".rstrip()


def _of(published: float, load: float | None) -> str:
    return kilograms(load) + ("" if load is None else f" ({relative_difference(load, published)})")


def _motors(run: Run) -> str:
    each = {"planar": "fig10", "spatial": "fig12", "with joint springs (Eqs. 23–25)": "fig15.state_space"}
    keys = {words: f"{stem}{'_' if '.' in stem else '.'}" for words, stem in each.items()}
    texts = (
        f"{words} motor {short(run.number(f'{key}motor'))} at {short(run.number(f'{key}time_s'))} s"
        for words, key in keys.items()
    )
    return f"Published: always motor 2. Ours: {', '.join(texts)}."


def _rigid(run: Run) -> str:
    planar, spatial = (short(run.number(f"{part}.least_tension_N")) for part in ("fig5", "fig6"))
    errors = [short(run.number(f"{part}.peak_error_mm")) for part in ("fig11", "fig13")]
    return (
        f"Smallest tension: {planar} N (planar) and {spatial} N (spatial). At the largest payload, which the law "
        f"knows, the error is at most {errors[0]} mm (planar) and {errors[1]} mm (spatial); R is 10 mm."
    )


def _poles(run: Run) -> str:
    def errors(name: str) -> str:
        each = (as_text(100 * run.number(f"claims.{name}_error_{kind}"), 2) for kind in ("planar", "spatial"))
        return " and ".join(f"{error} %" for error in each)

    return (
        f"Starting with an initial error, the robots follow Eqs. 14 and 19 within {errors('pole')} of this error "
        f"(planar, spatial) at 10 kHz and within {errors('sampled_pole')} at 500 Hz."
    )


def _robust(run: Run) -> str:
    def fractions(prefix: str) -> str:
        return ", ".join(short(100 * run.number(f"fig9.{prefix}_reduction_{layer}")) for layer in LAYERS)

    total, largest = (run.number(f"fig9.flex_{name}_reduction_{LAYER}") for name in ("sum", "max"))
    return (
        f"With joint springs and a boundary layer ε = {LAYER} the sum of the error decreases by {short(100 * total)} % "
        f"and the largest error by {short(100 * largest)} %. The result depends on ε, which the paper does not print: "
        f"for ε = {', '.join(LAYERS)} the sum decreases by {fractions('flex_sum')} % with springs and by "
        f"{fractions('sum')} % without springs."
    )


def _planar_load(run: Run) -> str:
    target, best = LOADS["planar"], run.maybe("scan.planar_best_added_kg")
    turned = (
        "" if best is None else f" The largest added load over all orientations of the triangle is {kilograms(best)}."
    )
    return (
        f"Published: about {target:g} kg. Ours: {_of(target, run.optional('fig10.counted_kg'))}. Total mass of "
        f"platform and load by exact tracking: {_of(target, run.optional('fig10.exact_total_mass_kg'))}.{turned}"
    )


def _spatial_load(run: Run) -> str:
    target, loads = LOADS["spatial"], with_published_motor(run, "spatial")
    near = (
        "" if not loads else f" Closest interpretation with the published limiting motor: {nearest('spatial', loads)}."
    )
    hits, geometries = run.maybe("scan.hits"), run.maybe("scan.geometries")
    many = ""
    second = run.maybe("scan.hits_second_motor")
    if hits is not None and geometries is not None and second is not None:
        many = (
            f" This does not confirm the interpretation: {int(hits)} of {int(geometries)} tested geometries also give "
            f"this payload, {int(second)} of them with motor 2 as the limiting motor."
        )
    return f"Published: about {target:g} kg. Ours: {_of(target, run.optional('fig12.counted_kg'))}.{near}{many}"


def _spring_load(run: Run) -> str:
    target = LOADS["flexible"]
    branches = ""
    if None not in (
        both := [run.maybe(f"interpretations.loop_flex_fl4_{branch}_kg") for branch in ("first", "second")]
    ):
        first, second = (kilograms(load) for load in both)
        branches = (
            f". The payload of `fl4` is {first} with the first branch of Table 3 at 0.5 s and {second} with the second"
        )
    loops = ""
    if is_simulated(run, "fig15"):
        own, law = (run.optional(f"fig15.{name}counted_kg") for name in ("eq22_", ""))
        loops = (
            f" Closed loop with Eq. 22: {kilograms(own)}. Closed loop with the stable law `fl4`: {_of(target, law)}."
        )
    loads = with_published_motor(run, "flexible")
    near = f" Closest interpretation: {nearest('flexible', loads)}." if loads else ""
    return (
        f"Published: {target:g} kg. State space of the paper (Eqs. 23–25), which describes no physical robot: "
        f"{_of(target, run.optional('fig15.state_space_counted_kg'))}.{near}{loops} No robot with joint springs "
        f"follows a jump of the acceleration exactly{branches}."
    )


def _drop(run: Run) -> str:
    space, own = 100 * run.number("fig15.state_space_drop_fraction"), 100 * (1 - LOADS["flexible"] / LOADS["spatial"])
    law = f", {short(100 * run.number('fig15.drop_fraction'))} % with `fl4`" if is_simulated(run, "fig15") else ""
    return (
        f"Published: about 30 %. Ours: {short(space)} % by Eqs. 23–25{law}. The two published payloads differ by "
        f"{short(own)} %."
    )


def _eq22(run: Run) -> str:
    soft, stiff = (short(run.number(f"eq22.max_growth_{name}")) for name in ("K2", "K3"))
    return (
        "The loop has no s³ term, so at least one root is unstable for every stiffness and all gains. The growth rate "
        f"is {soft} 1/s for K = 2 and {stiff} 1/s for K = 3. On the robot the error reaches "
        f"{short(run.number('fig14.eq22_peak_error_mm'))} mm; R is 10 mm. The robust term is a stiffer PD controller "
        "and does not stabilise the loop. Motor friction or other laws stabilise it."
    )


def _ringing(run: Run) -> str:
    before, after, late = (short(run.number(f"fig7.ripple_{when}_Nm")) for when in ("before", "after", "late"))
    return (
        f"By Eqs. 23–25 the RMS ripple is {before} N·m before the input change, {after} N·m after it and {late} N·m in "
        "the last 0.2 s. These equations have no damping."
    )


def _uncontrollable(run: Run) -> str:
    rank, states = (int(run.number(f"eq22.{name}")) for name in ("controllable_states", "states"))
    return f"{rank} of {states} states are controllable, because the torques act on the platform through the springs."


def _algorithm(run: Run) -> str:
    return (
        f"As printed they converge to {short(run.number('eq37.literal_over_true'))} times the payload. The printed τ± "
        "is the torque reserve of the loaded robot; correct is the reserve of the unloaded robot."
    )


def _accuracy(run: Run) -> str:
    known, unknown = (run.optional(f"claims.fl_payload_{name}_paper_kg") for name in ("known", "unknown"))
    return (
        f"DLCC of the law with the spatial robot under the paper criterion: {kilograms(known)} with known payload, "
        f"{kilograms(unknown)} with unknown payload."
    )


def _open_loop(run: Run) -> str:
    def pair(criterion: str) -> str:
        loads = (run.optional(f"claims.{loop}_loop_spatial{criterion}_kg") for loop in ("closed", "open"))
        closed, opened = loads
        return f"{kilograms(closed)} with and {kilograms(opened)} without feedback"

    return (
        "Feedback improves tracking with the uncertainty of Table 6. DLCC of the spatial robot under the task "
        f"criterion, where the errors are the limit: {pair('')}. Under the paper criterion, where the motors are the "
        f"limit: {pair('_paper')}."
    )


def _cables(run: Run) -> str:
    return "Neither the paper nor this project has a model of elastic cables."


POINTS: tuple[tuple[tuple[str, ...], str, Explanation], ...] = (
    (("5.2.1.motor", "5.2.2.motor", "5.2.3.motor"), "Motor that saturates first", _motors),
    (("4.1.tension", "5.2.1.path", "5.2.2.path"), "Positive tensions and errors within R for the rigid robots", _rigid),
    (("3.1.poles", "3.2.poles"), "Poles of the errors of the rigid robots", _poles),
    (("4.4.sum", "4.4.max"), "Error reduction of more than 60 % by the robust term", _robust),
    (("1.controller", "6.open-tracking", "6.open-payload"), "Feedback outperforms open loop", _open_loop),
    (("5.2.1.payload",), "Load capacity of the planar robot", _planar_load),
    (("5.2.2.payload", "5.2.3.rigid"), "Load capacity of the spatial robot", _spatial_load),
    (("5.2.3.payload",), "Load capacity with joint springs", _spring_load),
    (("6.drop",), "Reduction of the payload by joint springs", _drop),
    (("3.3.linear", "3.3.robust", "5.2.3.stable", "5.2.3.path"), "Tracking with joint springs by Eq. 22", _eq22),
    (("4.3.vibration",), "Torques vibrate only when the input changes", _ringing),
    (("3.4.uncontrollable",), "Joint springs make the robot uncontrollable", _uncontrollable),
    (("5.1.answer",), "Eqs. 37–39 give the payload", _algorithm),
    (("5.1.accuracy",), "Accuracy can be neglected in closed loop", _accuracy),
    (("1.elasticity",), "Elastic cables affect the robot", _cables),
)
"""Keys of the findings, their common title, and their explanation."""
