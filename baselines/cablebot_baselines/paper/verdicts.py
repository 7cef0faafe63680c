"""Findings on results and claims, from the numbers of the run."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from cablebot_baselines.classical.outer_loop import PAPER_GAINS, RobustPD
from cablebot_baselines.paper.finding import (
    Finder,
    Finding,
    Run,
    Verdict,
    as_text,
    command,
    kilograms,
    listed,
    off,
    reading_words,
    sentence,
    short,
)
from cablebot_baselines.paper.published import ABOUT, LOADS, PUBLISHED, Published, published_value, within
from cablebot_baselines.paper.readings import Readings, Source
from cablebot_gym.task import Limits

LAYERS = ("1e-2", "1e-3", "1e-4")
"""Boundary layers ε of the robust term in the evidence."""

LAYER = f"{RobustPD.boundary_layer:.0e}".replace("e-0", "e-")
"""ε that decides: the law's own."""

AFFINE = 1e-6
"""Largest relative residual of a torque that still counts as affine in the load: rounding."""

Said = tuple[str, float | None, bool | None, str]
"""Our value in words and as a number, whether it holds (None: cannot be decided), and the evidence."""

Say = Callable[[Published, Run], Said]
"""Judges one."""


_OF_PAYLOAD = ("fig10", "fig11", "fig12", "fig13", "fig14", "fig15")
"""Parts on the robots of §5.2."""


def _finder(part: str | tuple[str, ...], say: Say, *readings: str, reading: str = "") -> Finder:
    """A finding that holds or does not.

    Args:
        part: whose numbers it needs.
        say: what is said.
        readings: names of those that change it.
        reading: what else was chosen, in words.
    """
    parts = (part,) if isinstance(part, str) else part
    source: Source = "payload" if parts[0] in _OF_PAYLOAD else "control"

    def make(item: Published, run: Run) -> Finding:
        ours, value, holds, evidence = say(item, run)
        alone = "claims" in parts and not run.readings.plays
        fallback = "motors limited by their own speed, since none have this line" if alone else ""
        verdict: Verdict = "cannot be decided" if holds is None else "reproduces" if holds else "does not"
        return Finding(
            ours=ours,
            value=value,
            reading=", ".join(words for words in (run.used(*readings, source=source), reading, fallback) if words),
            verdict=verdict,
            evidence=evidence,
            command=command(run.readings, *parts),
        )

    return Finder(parts=parts, make=make)


_PAYLOAD_READINGS = {
    "planar": ("payload", "line", "planar_apex", "minimum_tension", "alpha"),
    "spatial": ("payload", "line", "platform_mass", "triangles", "sides", "pulleys"),
    "flexible": ("payload", "line", "platform_mass", "triangles", "sides", "stiffness", "eq24"),
}
"""What decides each payload."""


_COMBINED = {
    "planar": ("planar_apex", "alpha", "minimum_tension", "line"),
    "spatial": ("triangles", "sides", "pulleys", "platform_mass", "line"),
    "flexible": ("eq24", "stiffness", "line"),
}
"""What the part ``readings`` combines, in the order of its numbers' names."""

_OF_PAYLOADS = {"platform_mass": "10", "stiffness": "3"}
"""What "as printed" is in §5.2."""

_NEAR = 0.015
"""How far apart payloads are that no reader of "about 2.56 kg" could tell."""


# --- payloads -------------------------------------------------------------------------------------------------------


SECTIONS = {"planar": "5.2.1", "spatial": "5.2.2", "flexible": "5.2.3"}
"""Where each payload is published."""


def _closest(run: Run, kind: str) -> str:
    """What the combined readings with the published motor come closest with; empty if they were not combined."""
    motor, loads = published_value(f"{SECTIONS[kind]}.motor"), with_published_motor(run, kind)
    if not loads:
        return ""
    said = [f"Of the readings combined, motor {short(int(motor))} first, the closest: {nearest(kind, loads)}"]
    if kind == "planar":
        mass = run.readings.planar.mass
        totals = {name: load + mass for name, load in loads.items()}
        said.append(f"with the platform counted, {nearest(kind, totals)}")
    total, close = run.maybe(f"readings.{kind}_total"), run.maybe(f"readings.{kind}_within_5pct")
    if total is not None and close is not None:
        said.append(f"with any motor, {int(close)} of {int(total)} are within {_percent(ABOUT)}")
    return "; ".join(said) + "."


def with_published_motor(run: Run, kind: str) -> dict[str, float]:
    """Payloads of those combined readings that the published motor limits, by their names [kg]."""
    prefix, motor = f"readings.{kind}_", published_value(f"{SECTIONS[kind]}.motor")
    loads: dict[str, float] = {}
    for key in run.numbers:
        if key.startswith(prefix) and key.endswith("_kg"):
            load, first = run.maybe(key), run.maybe(f"{key[:-3]}_motor")
            if load is not None and first == motor:
                loads[key[len(prefix) : -3]] = load
    return loads


def nearest(kind: str, loads: Mapping[str, float]) -> str:
    """The payloads nearest to the published one, by how much they are off, and their readings.

    All that are within about a percent, for among those a hundredth of a kilogram decides nothing; else the nearest.
    """
    target = LOADS[kind]
    names = sorted(loads, key=lambda name: abs(loads[name] - target))
    near = [name for name in names if abs(loads[name] / target - 1) <= _NEAR] or names[:1]
    return ", or ".join(
        f"{kilograms(loads[name])}{_apart(loads[name], target)} with {_named(kind, name)}" for name in near
    )


def _named(kind: str, words: str) -> str:
    """The readings in a number's name that are not the default."""
    choices, names = words.split("_"), _COMBINED[kind]
    if len(choices) != len(names):
        return ", ".join(choices)
    usual = {name: _OF_PAYLOADS.get(name, str(getattr(Readings(), name))) for name in names}
    other = [reading_words(name, choice) for name, choice in zip(names, choices, strict=True) if choice != usual[name]]
    return ", ".join(other) or "the default readings"


def looped(run: Run, part: str) -> bool:
    """Whether the part's payload is that of a closed loop, and not of exact tracking or of the state space."""
    return run.numbers.get(f"{part}.simulated") is not False


def _ways(run: Run, part: str, target: float) -> str:
    """The payload counted and computed in each way."""
    closed, exact = run.optional(f"{part}.payload_kg"), run.maybe(f"{part}.exact_payload_kg")
    if closed is None and exact is None:
        return "Nothing is carried."
    total = run.maybe(f"{part}.total_mass_kg" if exact is None else f"{part}.exact_total_mass_kg")
    near = total is not None and total < 2 * target
    return listed(
        [
            f"Added in closed loop {kilograms(closed)}, by exact tracking {kilograms(exact)}."
            if looped(run, part)
            else f"Added by exact tracking {kilograms(exact)}; no closed loop can be run under this reading.",
            f"With the platform {kilograms(total)}{_apart(total, target)}." if near else "",
        ]
    )


def _load(kind: str, part: str) -> Say:
    def say(item: Published, run: Run) -> Said:
        counted, target = run.optional(f"{part}.counted_kg"), LOADS[kind]
        evidence = listed([_ways(run, part, target), _closest(run, kind), _geometry(run, kind)])
        if counted is None:
            return "nothing", None, False, evidence
        return f"{kilograms(counted)} ({off(counted, target)})", counted, within(counted, target), evidence

    return say


def _again(say: Say, key: str) -> Say:
    """What the paper says a second time: the same finding without the evidence for it."""

    def again(item: Published, run: Run) -> Said:
        ours, value, holds, _ = say(item, run)
        return ours, value, holds, f"As in {PUBLISHED[key].place}: {PUBLISHED[key].says}."

    return again


def _geometry(run: Run, kind: str) -> str:
    if kind == "planar":
        best = run.maybe("scan.planar_best_added_kg")
        if best is None:
            return ""
        return f"With this line and T_min at most {kilograms(best)} can be added however the triangle is turned."
    hits, geometries = run.maybe("scan.hits"), run.maybe("scan.geometries")
    most = run.maybe("scan.largest_kg")
    if hits is None or geometries is None or most is None:
        return ""
    second = run.maybe("scan.hits_second_motor")
    too = "" if second is None else f", {int(second)} of them with motor 2 first"
    return (
        f"But {int(hits)} of {int(geometries)} geometries that were tried give the number too{too}, and payloads go up "
        f"to {kilograms(most)}: the number alone identifies nothing."
    )


def _when(motor: float, time: float | None) -> str:
    return f"motor {short(int(motor))}" + (f" at {short(time)} s" if time is not None else "")


def _motor(part: str) -> Say:
    def say(item: Published, run: Run) -> Said:
        motor, exact = run.optional(f"{part}.motor"), run.maybe(f"{part}.exact_motor")
        tracked = "" if exact is None else f"Exact tracking: {_when(exact, run.maybe(f'{part}.exact_time_s'))}."
        if motor is None or run.optional(f"{part}.payload_kg") is None:
            nothing = "Nothing is carried, or something other than a motor ends the payload."
            return "no motor", None, False, listed([nothing, tracked])
        words = _when(motor, run.maybe(f"{part}.time_s"))
        return words, motor, motor == published_value(item.key), tracked or "Paper criterion."

    return say


_NO_EXACT = "The reference's acceleration jumps at half time, which no robot with joint springs follows exactly."


def _spring_load(item: Published, run: Run) -> Said:
    counted, target = run.optional("fig15.state_space_counted_kg"), LOADS["flexible"]
    law, own = run.maybe("fig15.counted_kg"), run.maybe("fig15.eq22_counted_kg")
    evidence = listed(
        [
            _NO_EXACT,
            "Eqs. 23–25 may be how the paper came to its number, but they are the motion of no robot.",
            f"On the robot Eq. 22 carries {kilograms(own)}." if "fig15.eq22_counted_kg" in run.numbers else "",
            f"`fl4`, a law that works, carries {kilograms(law)}{_apart(law, target)}; see Readings."
            if "fig15.counted_kg" in run.numbers and looped(run, "fig15")
            else "",
            _closest(run, "flexible"),
        ]
    )
    if counted is None:
        return "nothing", None, False, evidence
    return f"{kilograms(counted)}{_apart(counted, target)}", counted, within(counted, target), evidence


def _apart(ours: float | None, published: float) -> str:
    return "" if ours is None else f" ({off(ours, published)})"


def _spring_motor(item: Published, run: Run) -> Said:
    motor, time = run.optional("fig15.state_space_motor"), run.maybe("fig15.state_space_time_s")
    if motor is None:
        return "no motor", None, False, "No motor is at its limit."
    if not looped(run, "fig15"):
        return (
            _when(motor, time),
            motor,
            motor == published_value(item.key),
            "No closed loop can be run with this line.",
        )
    law = run.maybe("fig15.motor")
    evidence = "`fl4`: another limit comes first." if law is None else f"`fl4`: motor {short(int(law))}."
    return _when(motor, time), motor, motor == published_value(item.key), evidence


def _drops(run: Run) -> tuple[float, str]:
    """Share of the payload that springs take away in the paper's state space, and the payloads in words [%]."""
    drop, law = 100 * run.number("fig15.state_space_drop_share"), None
    loads = {
        "rigid": run.optional("fig15.rigid_exact_counted_kg"),
        "by Eqs. 23–25": run.optional("fig15.state_space_counted_kg"),
    }
    if looped(run, "fig15"):
        law = run.maybe("fig15.drop_share")
        loads["rigid in closed loop"] = run.maybe("fig15.rigid_counted_kg")
        loads["with `fl4`"] = run.maybe("fig15.counted_kg")
    own = 100 * (1 - LOADS["flexible"] / LOADS["spatial"])
    return drop, listed(
        [
            sentence(", ".join(f"{words} {kilograms(load)}" for words, load in loads.items()))
            + ("." if law is None else f" ({short(100 * abs(law))} % {'less' if law >= 0 else 'more'})."),
            f"The paper's own {LOADS['flexible']:g} kg are {short(own)} % less than its {LOADS['spatial']:g} kg.",
        ]
    )


def _drop(item: Published, run: Run) -> Said:
    drop, words = _drops(run)
    return f"{short(drop)} %", drop, within(drop, published_value(item.key)), words


def _less(item: Published, run: Run) -> Said:
    drop, words = _drops(run)
    return f"{short(drop)} % less", drop, drop > 100 * ABOUT, words


# --- the robust term ------------------------------------------------------------------------------------------------


def _reduction(measure: str) -> Say:
    def say(item: Published, run: Run) -> Said:
        def share(name: str, layer: str) -> float:
            return 100 * run.number(f"fig9.{name}_reduction_{layer}")

        springs, rigid = ([share(name, layer) for layer in LAYERS] for name in (f"flex_{measure}", measure))
        ours = share(f"flex_{measure}", LAYER)
        evidence = (
            f"At ε = {', '.join(LAYERS)}: {_percents(springs)} with joint springs, where `composite` stands for the "
            f"unstable Eq. 22; {_percents(rigid)} without springs. The paper prints no ε, ζ and φ, and ε decides."
        )
        return f"{short(ours)} %", ours, ours > published_value(item.key), evidence

    return say


def _percent(share: float) -> str:
    return f"{short(100 * share)} %"


def _percents(shares: list[float]) -> str:
    return ", ".join(f"{short(share)} %" for share in shares)


def _lyapunov_term(item: Published, run: Run) -> Said:
    shares = [100 * run.number(f"fig9.sum_reduction_{layer}") for layer in LAYERS]
    return (
        f"{_percents(shares)} less error",
        min(shares),
        min(shares) > 0,
        f"Rigid robot under Table 6 at ε = {', '.join(LAYERS)}, with the sign that e = z_d − z needs; the printed "
        "minus belongs to e = z − z_d. With joint springs no Δv makes Eq. 22 stable (§3.3).",
    )


# --- tracking -------------------------------------------------------------------------------------------------------


def _bound() -> float:
    """R [mm]."""
    return 1e3 * Limits().position


def _perfect(item: Published, run: Run) -> Said:
    planar, spatial = run.number("fig5.peak_error_mm"), run.number("fig6.peak_error_mm")
    unknown = run.number("claims.closed_loop_spatial_error_mm")
    worst = max(planar, spatial, unknown)
    return (
        f"{short(worst)} mm",
        worst,
        worst <= ABOUT * _bound(),
        f"Under Table 6 the mean of the spatial robot is {short(unknown)} mm; R is {short(_bound())} mm. With "
        f"everything known at most {short(planar)} mm (planar) and {short(spatial)} mm (spatial), from sampling and "
        "the jump at half time.",
    )


def _poles(kind: str) -> tuple[complex, complex]:
    stiffness, damping = PAPER_GAINS[kind]
    low, high = np.roots([1.0, damping, stiffness]).tolist()
    return low, high


def _slowest_sampling(kind: str) -> float:
    """Longest control period with which the sampled loop of these gains is stable [s].

    Ë = −K_P e − K_D ė held over h: z² + (K_P h²/2 + K_D h − 2) z + K_P h²/2 − K_D h + 1 = 0.
    """
    stiffness, damping = PAPER_GAINS[kind]
    return min(2 * damping / stiffness, 2 / damping)


def _stable_gains(item: Published, run: Run) -> Said:
    slowest = max(root.real for kind in PAPER_GAINS for root in _poles(kind))
    growth = run.number("eq22.max_growth_K3")
    return (
        f"real parts ≤ {short(slowest)} 1/s",
        slowest,
        slowest < 0,
        "Poles of both sets of gains, for rigid robots. With joint springs the paper's law does not place them: there "
        f"deviations grow at {short(growth)} 1/s.",
    )


_EQUATIONS = {"planar": "14", "spatial": "19"}


def _placed(kind: str) -> Say:
    def say(item: Published, run: Run) -> Said:
        error, sampled = (100 * run.number(f"claims.{name}_error_{kind}") for name in ("pole", "sampled_pole"))
        return (
            run.text(f"claims.poles_{kind}").replace("-", "−"),
            None,
            error <= 100 * ABOUT,
            f"Let go beside its reference, the robot follows Eq. {_EQUATIONS[kind]} to {as_text(error, 2)} % of the "
            f"first error at 10 kHz, to {as_text(sampled, 2)} % at 500 Hz. But not wherever they are wanted: a command "
            "held for h takes K_P h/2 from K_D, so that these gains are stable for h below "
            f"{short(1e3 * _slowest_sampling(kind))} ms.",
        )

    return say


_OF_FIGURE = {"fig5": "planar", "fig6": "spatial"}


def _taut(*parts: str) -> Say:
    def say(item: Published, run: Run) -> Said:
        least = {part: run.number(f"{part}.least_tension_N") for part in parts}
        slack = any(run.flag(f"{part}.slack") for part in parts)
        each = ", ".join(f"{_OF_FIGURE[part]} {short(tension)} N" for part, tension in least.items())
        value = min(least.values())
        chosen = "" if "fig5" not in parts else " That of the planar robot is the T_min that α is chosen to keep."
        return f"≥ {short(value)} N", value, value > 0 and not slack, f"Least tension: {each}.{chosen}"

    return say


def _inside(part: str) -> Say:
    def say(item: Published, run: Run) -> Said:
        peak, inside = run.number(f"{part}.peak_error_mm"), run.flag(f"{part}.within")
        turned, load = run.maybe(f"{part}.peak_rotation_mrad"), run.maybe(f"{part}.payload_kg")
        words = [
            f"Bound {short(_bound())} mm.",
            "" if load is None else f"With the law's largest payload, {kilograms(load)}, which it is told.",
            "" if turned is None else f"Rotation errors reach {short(turned)} mrad; the paper has no bound for them.",
        ]
        return f"{short(peak)} mm", peak, inside, listed(words)

    return say


def _inside_with_springs(item: Published, run: Run) -> Said:
    """By the paper's own law."""
    peak, inside = run.number("fig14.eq22_peak_error_mm"), run.flag("fig14.eq22_within")
    others = {
        "With the friction of Table 4 on the motors": "fig14.eq22_friction_peak_error_mm",
        "With `fl4`": "fig14.peak_error_mm",
    }
    found = {words: run.maybe(key) for words, key in others.items()}
    words = [f"{words} {short(error)} mm." for words, error in found.items() if error is not None]
    return f"{short(peak)} mm", peak, inside, listed([f"Eq. 22 as printed, bound {short(_bound())} mm.", *words])


def _vibration(item: Published, run: Run) -> Said:
    before, after, late = (run.number(f"fig7.ripple_{when}_Nm") for when in ("before", "after", "late"))
    border = ABOUT * run.number("fig7.rigid_peak_Nm")
    return (
        f"{short(after)} N·m after, {short(late)} N·m at the end",
        late,
        before <= border < after and late <= border,
        f"Torques of Eqs. 23–25 less the rigid ones, rms: {short(before)} N·m in the 0.2 s before the jump, "
        f"{short(after)} N·m in the 0.2 s after it, {short(late)} N·m in the last 0.2 s; more than "
        f"{short(border)} N·m count as much. The jump starts it, and in these equations nothing damps it.",
    )


def _torque_changes(item: Published, run: Run) -> Said:
    after, rigid = run.number("fig7.ripple_after_Nm"), run.number("fig7.rigid_peak_Nm")
    peak = run.number("fig7.flexible_peak_Nm")
    return (
        f"{short(after)} N·m",
        after,
        after > ABOUT * rigid,
        f"Rms difference in the 0.2 s after the jump. Largest torque: {short(peak)} N·m with springs, "
        f"{short(rigid)} N·m without.",
    )


def _uncertain(item: Published, run: Run) -> Said:
    nominal = run.number("claims.flex_composite_error_nominal_mm")
    uncertain = run.number("claims.flex_composite_error_table6_mm")
    others = [run.maybe(f"claims.flex_fl4_error_{name}_mm") for name in ("nominal", "table6")]
    return (
        f"{short(uncertain)} mm",
        uncertain,
        uncertain > (1 + ABOUT) * nominal,
        f"Mean error of `composite` under Table 6, against {short(nominal)} mm with everything known; `fl4`: "
        f"{short(others[1])} against {short(others[0])} mm.",
    )


def _open_tracking(item: Published, run: Run) -> Said:
    errors = {
        kind: [run.number(f"claims.{loop}_loop_{kind}_error_mm") for loop in ("closed", "open")]
        for kind in ("planar", "spatial")
    }
    each = ", ".join(
        f"{kind} {short(closed)} mm against {short(opened)} mm" for kind, (closed, opened) in errors.items()
    )
    return (
        f"{short(errors['spatial'][0])} mm",
        errors["spatial"][0],
        all(closed < opened for closed, opened in errors.values()),
        f"Mean errors under Table 6, with feedback against the torques of exact tracking alone: {each}.",
    )


def _open_loads(run: Run, criterion: str) -> tuple[bool, str]:
    """Whether feedback carries more, and the payloads in words."""
    words, better = [], True
    for kind in ("planar", "spatial"):
        names = (f"claims.{loop}_loop_{kind}{criterion}_kg" for loop in ("closed", "open"))
        closed, opened = (run.optional(name) for name in names)
        better &= closed is not None and (opened is None or closed > opened)
        words.append(f"{kind} {kilograms(closed)} against {kilograms(opened)}")
    return better, ", ".join(words)


_TWO_CRITERIA = (
    "Payloads, nothing unknown, with feedback against open loop: {} where the motors decide (paper criterion), {} "
    "where the errors do (task criterion)."
)


def _open_payload(item: Published, run: Run) -> Said:
    """By the paper's own criterion."""
    (better, paper), (_, task) = (_open_loads(run, criterion) for criterion in ("_paper", ""))
    value = run.optional("claims.closed_loop_spatial_paper_kg")
    return kilograms(value), value, better, _TWO_CRITERIA.format(paper, task)


def _controller(item: Published, run: Run) -> Said:
    """By the task criterion, which asks for accuracy."""
    tracked, _, closer, words = _open_tracking(item, run)
    (_, paper), (better, task) = (_open_loads(run, criterion) for criterion in ("_paper", ""))
    value = run.optional("claims.closed_loop_spatial_kg")
    ours = f"{tracked}, {kilograms(value)}"
    because = 'Judged by the errors, since the paper argues from accuracy ("and so"); §6 has the paper criterion.'
    return ours, value, bool(closer) and better, listed([words, _TWO_CRITERIA.format(paper, task), because])


# --- joint springs --------------------------------------------------------------------------------------------------


def _growth(run: Run) -> tuple[float, str]:
    soft, stiff = run.number("eq22.max_growth_K2"), run.number("eq22.max_growth_K3")
    return max(soft, stiff), f"Small deviations grow at {short(soft)} 1/s for K = 2 and {short(stiff)} 1/s for K = 3."


def _any_stiffness(run: Run) -> str:
    least, friction = run.maybe("eq22.least_growth_any_K"), run.maybe("eq22.friction_needed")
    return listed(
        [
            "" if least is None else f"For no K from 1 to 10⁵ N·m/rad do they grow slower than at {short(least)} 1/s.",
            "" if friction is None else f"It would take motor friction of {short(friction)} N·m·s/rad.",
        ]
    )


def _eq22(item: Published, run: Run) -> Said:
    growth, words = _growth(run)
    lost = run.maybe("fig7.closed_loop_peak_error_mm")
    evidence = listed(
        [
            words,
            _any_stiffness(run),
            "" if lost is None else f"On the robot the error reaches {short(lost)} mm (Fig. 7).",
            "With β̈′ taken from v the loop has no s³ term; measured, β̈′ cancels out.",
        ]
    )
    return f"growth {short(growth)} 1/s", growth, growth < 0, evidence


def _eq25(item: Published, run: Run) -> Said:
    growth, words = _growth(run)
    robot = run.readings.flexible("control")
    divisor = robot.motor_inertia + (1.0 if run.readings.eq24 == "verbatim" else 0.0)
    frequency = float(np.sqrt(robot.stiffness / divisor).max()) / (2 * math.pi)
    return (
        f"growth {short(growth)} 1/s",
        growth,
        growth < 0,
        f"By itself Eq. 25 is an oscillator of {short(frequency)} Hz without damping, in which nothing decays. On "
        f"the robot H depends on β′, for it is the springs that move the platform. {words}",
    )


def _eq22_robust(item: Published, run: Run) -> Said:
    least = run.number("eq22.least_growth_any_K")
    return (
        f"growth ≥ {short(least)} 1/s",
        least,
        least < 0,
        "Inside its layer the robust term is a stiffer PD, and no gains make Eq. 22 stable: its characteristic "
        "polynomial M J′s⁴ + K (M + J′)(s² + K_D s + K_P) has no s³ term, so that the sum of its roots is zero.",
    )


def _stable_springs(item: Published, run: Run) -> Said:
    growth, words = _growth(run)
    return (
        f"growth {short(growth)} 1/s",
        growth,
        growth < 0,
        listed([f"Under Eq. 22. {words}", _any_stiffness(run)]),
    )


def _controllable(item: Published, run: Run) -> Said:
    rank, states = run.number("eq22.controllable_states"), run.number("eq22.states")
    return (
        f"{int(rank)} of {int(states)} states controllable",
        rank,
        rank < states,
        "Rank of the linearised robot's controllability matrix. The torques reach the platform through the springs: "
        "relative degree 4, and `fl4` linearises it. Fewer inputs than degrees of freedom make nothing uncontrollable.",
    )


def _constraint(item: Published, run: Run) -> Said:
    robot = run.readings.flexible("control")
    free = robot.coordinates + robot.cables
    return (
        f"{free} free coordinates",
        float(free),
        free < published_value("2.3.freedom"),
        "A spring exerts a torque and forbids no motion: all the coordinates that Eq. 8 lists stay free.",
    )


def _elasticity(item: Published, run: Run) -> Said:
    evidence = "Neither the paper nor this project has a model of elastic cables; of the joints, §4.3 and §5.2.3 speak."
    return "joints alone", None, None, evidence


# --- the algorithm --------------------------------------------------------------------------------------------------


def _positive_definite(item: Published, run: Run) -> Said:
    definite = run.flag("eq22.lyapunov_printed_definite")
    return (
        "yes" if definite else "none",
        None,
        definite,
        "A has to hold −k_p and −k_d. As printed, with plus signs, it is not stable, and so there is no such P.",
    )


_AFFINE_WORDS = {
    True: "Torques with one, two and three platform masses lie on a line (not through zero: B of Eq. 41).",
    False: "Torques with one, two and three platform masses, second difference over first. S τ is affine, as Eq. 41 "
    "says; τ is not, for the least tensions change over from one pair of cables to another.",
}


def _affine(kind: str) -> Say:
    def say(item: Published, run: Run) -> Said:
        residual = run.number(f"claims.affine_{kind}")
        holds = residual <= AFFINE
        return "affine" if holds else f"{short(100 * residual)} % off", residual, holds, _AFFINE_WORDS[holds]

    return say


def _answer(item: Published, run: Run) -> Said:
    ratio = run.number("eq37.literal_over_true")
    literal, corrected, exact = (run.maybe(f"eq37.{name}_payload_kg") for name in ("literal", "corrected", "exact"))
    evidence = listed(
        [
            f"Spatial robot, as printed {kilograms(literal)}, corrected {kilograms(corrected)}, in closed form "
            f"{kilograms(exact)}. τ± is printed as what the loaded torque leaves; it has to be what no load leaves.",
        ]
    )
    return f"{short(ratio)} times the payload", ratio, within(ratio, 1.0), evidence


def _converges(item: Published, run: Run) -> Said:
    spread, literal = run.number("eq37.literal_spread_kg"), run.number("eq37.literal_payload_kg")
    same = spread <= ABOUT * literal
    what = "the same answer" if same else f"answers {short(spread)} kg apart"
    return (
        f"{kilograms(literal)} from any guess" if same else f"{short(spread)} kg apart",
        literal,
        same and run.flag("eq37.literal_converges"),
        f"Different first guesses end in {what}, near {kilograms(literal)}. Whether that is the payload is another "
        "matter.",
    )


def _no_accuracy(item: Published, run: Run) -> Said:
    told, untold = (run.optional(f"claims.fl_{name}_paper_kg") for name in ("told", "untold"))
    holds = told is not None and untold is not None and untold >= (1 - ABOUT) * told
    task = [f"claims.fl_{name}_kg" for name in ("told", "untold")]
    loads = [run.maybe(key) for key in task]
    evidence = [
        f"Spatial robot, paper criterion: {kilograms(told)} if the law is told the load; if not, the error ends it at "
        f"{kilograms(untold)}.",
        f"Task criterion: {kilograms(loads[0])} and {kilograms(loads[1])}." if set(task) <= set(run.numbers) else "",
        "The claim holds for a load that the law is told, while no motor saturates.",
    ]
    return f"{kilograms(untold)} instead of {kilograms(told)}", untold, holds, listed(evidence)


def finders() -> Iterator[tuple[str, Finder]]:
    """By key."""
    yield "abstract.accuracy", _finder(("fig5", "fig6", "claims"), _perfect)
    yield "abstract.stability", _finder("eq22", _stable_gains)
    yield "1.tension", _finder(("fig5", "fig6"), _taut("fig5", "fig6"), "minimum_tension")
    yield "1.elasticity", _finder("fig7", _elasticity)
    yield "1.controller", _finder("claims", _controller, reading="task criterion")
    yield "2.3.constraint", _finder("fig3", _constraint)
    yield "3.1.poles", _finder("claims", _placed("planar"))
    yield "3.2.poles", _finder("claims", _placed("spatial"))
    yield "3.3.linear", _finder("eq22", _eq22, reading="β̈′ from v")
    yield "3.3.bounded", _finder("eq22", _eq25, "eq24")
    yield "3.3.robust", _finder("eq22", _eq22_robust, reading="β̈′ from v")
    yield "3.4.uncontrollable", _finder("eq22", _controllable, "stiffness")
    yield "3.4.lyapunov", _finder("eq22", _positive_definite, reading="signs as printed")
    yield "3.4.stability", _finder("fig9", _lyapunov_term, reading="sign corrected")
    yield "4.1.tension", _finder("fig5", _taut("fig5"), "minimum_tension")
    yield "4.3.vibration", _finder("fig7", _vibration, "stiffness", "eq24")
    robust = {
        "4.4.sum": _reduction("sum"),
        "4.4.max": _reduction("max"),
        "6.robust": _again(_reduction("sum"), "4.4.sum"),
    }
    for key, say in robust.items():
        yield key, _finder("fig9", say, reading=f"joint springs, ε = {LAYER}, our ζ and φ")
    yield "5.1.linear-spatial", _finder("claims", _affine("spatial"))
    yield "5.1.linear-planar", _finder("claims", _affine("planar"), "minimum_tension", reading="least α")
    yield "5.1.converges", _finder("eq37", _converges, reading="as printed")
    yield "5.1.answer", _finder("eq37", _answer, reading="as printed")
    yield "5.1.accuracy", _finder("claims", _no_accuracy, reading="load not told")
    for kind, part, load in (("planar", "fig10", "5.2.1.payload"), ("spatial", "fig12", "5.2.2.payload")):
        yield load, _finder(part, _load(kind, part), *_PAYLOAD_READINGS[kind])
        yield load.replace("payload", "motor"), _finder(part, _motor(part), *_PAYLOAD_READINGS[kind][1:])
    again = _again(_load("spatial", "fig12"), "5.2.2.payload")
    yield "5.2.3.rigid", _finder("fig12", again, *_PAYLOAD_READINGS["spatial"])
    yield "5.2.1.path", _finder("fig11", _inside("fig11"), "line", "planar_apex", "minimum_tension", "alpha")
    yield "5.2.2.path", _finder("fig13", _inside("fig13"), *_PAYLOAD_READINGS["spatial"][1:])
    yield "5.2.3.stable", _finder("eq22", _stable_springs)
    yield "5.2.3.path", _finder("fig14", _inside_with_springs, "stiffness", "platform_mass", reading="Eq. 22")
    yield "5.2.3.payload", _finder("fig15", _spring_load, *_PAYLOAD_READINGS["flexible"], reading="Eqs. 23–25")
    yield "5.2.3.motor", _finder("fig15", _spring_motor, *_PAYLOAD_READINGS["flexible"][1:], reading="Eqs. 23–25")
    yield "5.2.3.less", _finder("fig15", _less, *_PAYLOAD_READINGS["flexible"], "pulleys", reading="Eqs. 23–25")
    yield "6.torque", _finder("fig7", _torque_changes, "stiffness", "eq24")
    yield "6.drop", _finder("fig15", _drop, *_PAYLOAD_READINGS["flexible"], "pulleys", reading="Eqs. 23–25")
    yield "6.uncertainty", _finder("claims", _uncertain)
    yield "6.open-tracking", _finder("claims", _open_tracking)
    yield "6.open-payload", _finder("claims", _open_payload, reading="paper criterion")
