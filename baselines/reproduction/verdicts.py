"""Findings on results and claims, from the numbers of the run."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from baselines.classical.outer_loop import PAPER_GAINS, RobustPD
from baselines.reproduction.finding import (
    Finder,
    Finding,
    Run,
    Verdict,
    as_text,
    command,
    flexible,
    kilograms,
    listed,
    off,
    sentence,
)
from baselines.reproduction.published import ABOUT, LOADS, Published, published_value, within
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


def _finder(part: str | tuple[str, ...], say: Say, *readings: str, reading: str = "") -> Finder:
    """A finding that holds or does not.

    Args:
        part: whose numbers it needs.
        say: what is said.
        readings: names of those that change it.
        reading: what else was chosen, in words.
    """
    parts = (part,) if isinstance(part, str) else part

    def make(item: Published, run: Run) -> Finding:
        ours, value, holds, evidence = say(item, run)
        verdict: Verdict = "cannot be decided" if holds is None else "reproduces" if holds else "does not"
        return Finding(
            ours=ours,
            value=value,
            reading=", ".join(words for words in (run.used(*readings), reading) if words),
            verdict=verdict,
            evidence=evidence,
            command=command(run.readings, *parts),
        )

    return Finder(parts=parts, make=make)


_PAYLOAD_READINGS = {
    "planar": ("payload", "line", "planar_apex", "minimum_tension"),
    "spatial": ("payload", "line", "platform_mass", "triangles", "sides", "pulleys"),
    "flexible": ("payload", "line", "platform_mass", "stiffness", "eq24"),
}
"""What decides each payload."""


_COMBINED = {
    "planar": ("planar apex", "alpha", "minimum tension", "line"),
    "spatial": ("triangles", "sides", "pulleys", "platform mass", "line"),
    "flexible": ("eq24", "stiffness", "line"),
}
"""What the part ``readings`` combines, in the order of its numbers' names."""


# --- payloads -------------------------------------------------------------------------------------------------------


_SECTIONS = {"planar": "5.2.1", "spatial": "5.2.2", "flexible": "5.2.3"}
"""Where each payload is published."""


def _closest(run: Run, kind: str) -> str:
    """What the combined readings with the published motor come closest with; empty if they were not combined."""
    prefix, motor = f"readings.{kind}_", published_value(f"{_SECTIONS[kind]}.motor")
    loads: dict[str, float] = {}
    for key in run.numbers:
        if key.startswith(prefix) and key.endswith("_kg"):
            load, first = run.maybe(key), run.maybe(f"{key[:-3]}_motor")
            if load is not None and first == motor:
                loads[key[len(prefix) : -3]] = load
    if not loads:
        return ""
    said = [f"Of the readings combined with motor {as_text(int(motor))} first, the closest: {_nearest(kind, loads)}"]
    if kind == "planar":
        mass = run.readings.planar.mass
        totals = {name: load + mass for name, load in loads.items()}
        said.append(f"with the platform counted, {_nearest(kind, totals)}")
    total, close = run.maybe(f"readings.{kind}_total"), run.maybe(f"readings.{kind}_within_5pct")
    if total is not None and close is not None:
        said.append(f"with any motor, {int(close)} of {int(total)} are within {_percent(ABOUT)}")
    return "; ".join(said) + "."


def _nearest(kind: str, loads: Mapping[str, float]) -> str:
    """The load nearest to the published one, by how much it is off, and its readings."""
    name = min(loads, key=lambda name: abs(loads[name] - LOADS[kind]))
    return f"{kilograms(loads[name])}{_apart(loads[name], LOADS[kind])} with {_named(kind, name)}"


def _named(kind: str, words: str) -> str:
    """The readings in a number's name, told apart."""
    choices = words.split("_")
    names = _COMBINED[kind] if len(choices) == len(_COMBINED[kind]) else [""] * len(choices)
    return ", ".join(f"{name} {choice}".strip() for name, choice in zip(names, choices, strict=True))


def _ways(run: Run, part: str, target: float) -> str:
    """The payload counted and computed in each way, the closest named."""
    ways = {
        "added, closed loop": run.optional(f"{part}.payload_kg"),
        "added, exact tracking": run.maybe(f"{part}.exact_payload_kg"),
        "total mass, closed loop": run.maybe(f"{part}.total_mass_kg"),
        "total mass, exact tracking": run.maybe(f"{part}.exact_total_mass_kg"),
    }
    known = {words: load for words, load in ways.items() if load is not None}
    if not known:
        return "Nothing is carried."
    nearest = min(known, key=lambda words: abs(known[words] - target))
    each = ", ".join(f"{words} {kilograms(load)}" for words, load in known.items())
    return f"{sentence(each)}; closest: {nearest}{_apart(known[nearest], target)}."


def _load(kind: str, part: str) -> Say:
    def say(item: Published, run: Run) -> Said:
        counted, target = run.optional(f"{part}.counted_kg"), LOADS[kind]
        evidence = listed([_ways(run, part, target), _closest(run, kind), _geometry(run, kind)])
        if counted is None:
            return "nothing", None, False, evidence
        return f"{kilograms(counted)} ({off(counted, target)})", counted, within(counted, target), evidence

    return say


def _geometry(run: Run, kind: str) -> str:
    if kind == "planar":
        best = run.maybe("scan.planar_best_added_kg")
        return "" if best is None else f"However the triangle is turned, at most {kilograms(best)} can be added."
    hits, geometries = run.maybe("scan.hits"), run.maybe("scan.geometries")
    least, most = run.maybe("scan.least_kg"), run.maybe("scan.largest_kg")
    if hits is None or geometries is None or least is None or most is None:
        return ""
    return (
        f"{int(hits)} of {int(geometries)} geometries that can be meant give it, among payloads from {as_text(least)} "
        f"to {kilograms(most)}: the number identifies none of them."
    )


def _when(motor: float, time: float | None) -> str:
    return f"motor {as_text(int(motor))}" + (f" at {as_text(time)} s" if time is not None else "")


def _motor(part: str) -> Say:
    def say(item: Published, run: Run) -> Said:
        motor, exact = run.optional(f"{part}.motor"), run.maybe(f"{part}.exact_motor")
        tracked = "" if exact is None else f"Exact tracking: {_when(exact, run.maybe(f'{part}.exact_time_s'))}."
        if motor is None:
            return "no motor", None, False, listed(["Something other than a motor ends the payload.", tracked])
        words = _when(motor, run.maybe(f"{part}.time_s"))
        return words, motor, motor == published_value(item.key), tracked or "Paper criterion."

    return say


_NO_EXACT = "The reference's acceleration jumps, and with joint springs no payload follows that exactly."


def _spring_load(item: Published, run: Run) -> Said:
    counted, target = run.optional("fig15.state_space_counted_kg"), LOADS["flexible"]
    law, own = run.maybe("fig15.counted_kg"), run.maybe("fig15.eq22_counted_kg")
    evidence = listed(
        [
            _NO_EXACT,
            "Eqs. 23–25 are how the paper can have come to its number; they move no robot.",
            f"On the robot its law (Eq. 22) carries {kilograms(own)}."
            if "fig15.eq22_counted_kg" in run.numbers
            else "",
            f"`fl4`, a law that works, carries {kilograms(law)} under the paper criterion{_apart(law, target)}."
            if "fig15.counted_kg" in run.numbers
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
    law = run.maybe("fig15.motor")
    evidence = "`fl4`: another limit comes first." if law is None else f"`fl4`: motor {as_text(int(law))}."
    return _when(motor, time), motor, motor == published_value(item.key), evidence


def _drops(run: Run) -> tuple[float, str]:
    """Share of the payload that springs take away in the paper's state space, and the payloads in words [%]."""
    drop, law = 100 * run.number("fig15.state_space_drop_share"), run.maybe("fig15.drop_share")
    loads = {
        "rigid": run.optional("fig15.rigid_exact_counted_kg"),
        "by Eqs. 23–25": run.optional("fig15.state_space_counted_kg"),
        "rigid in closed loop": run.maybe("fig15.rigid_counted_kg"),
        "with `fl4`": run.maybe("fig15.counted_kg"),
    }
    own = 100 * (1 - LOADS["flexible"] / LOADS["spatial"])
    return drop, listed(
        [
            sentence(", ".join(f"{words} {kilograms(load)}" for words, load in loads.items())) + ".",
            "" if law is None else f"`fl4` loses {as_text(100 * law)} %.",
            f"The paper's own {LOADS['spatial']:g} and {LOADS['flexible']:g} kg are {as_text(own)} % apart.",
        ]
    )


def _drop(item: Published, run: Run) -> Said:
    drop, words = _drops(run)
    return f"{as_text(drop)} %", drop, within(drop, published_value(item.key)), words


def _less(item: Published, run: Run) -> Said:
    drop, words = _drops(run)
    return f"{as_text(drop)} % less", drop, drop > 100 * ABOUT, words


# --- the robust term ------------------------------------------------------------------------------------------------


def _reduction(measure: str) -> Say:
    def say(item: Published, run: Run) -> Said:
        def share(name: str, layer: str) -> float:
            return 100 * run.number(f"fig9.{name}_reduction_{layer}")

        springs, rigid = ([share(name, layer) for layer in LAYERS] for name in (f"flex_{measure}", measure))
        ours = share(f"flex_{measure}", LAYER)
        evidence = (
            f"Less error at ε = {', '.join(LAYERS)}: {_percents(springs)} with joint springs (`robust-composite` "
            f"against `composite`), {_percents(rigid)} without. Eq. 34 prints no layer and would chatter; the gain "
            "depends on it."
        )
        return f"{as_text(ours)} %", ours, ours > published_value(item.key), evidence

    return say


def _percent(share: float) -> str:
    return f"{as_text(100 * share)} %"


def _percents(shares: list[float]) -> str:
    return ", ".join(f"{as_text(share)} %" for share in shares)


def _lyapunov_term(item: Published, run: Run) -> Said:
    shares = [100 * run.number(f"fig9.sum_reduction_{layer}") for layer in LAYERS]
    return (
        f"{_percents(shares)} less error",
        min(shares),
        min(shares) > 0,
        f"Rigid robot under Table 6 at ε = {', '.join(LAYERS)}, with the sign that e = z_d − z needs. The minus of "
        "Eq. 34 belongs to e = z − z_d, which no other equation of the paper has.",
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
        f"{as_text(worst)} mm",
        worst,
        worst <= ABOUT * _bound(),
        f"With everything known at most {as_text(planar)} mm (planar) and {as_text(spatial)} mm (spatial), from "
        f"sampled drives and the jump at half time; under Table 6, spatial, {as_text(unknown)} mm on average. R is "
        f"{as_text(_bound())} mm.",
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
        f"real parts ≤ {as_text(slowest)} 1/s",
        slowest,
        slowest < 0,
        "Poles of both sets of gains, for rigid robots. With joint springs the paper's law does not place them: there "
        f"deviations grow with {as_text(growth)} 1/s.",
    )


def _placed(kind: str) -> Say:
    def say(item: Published, run: Run) -> Said:
        error = 100 * run.number(f"claims.pole_error_{kind}")
        return (
            run.text(f"claims.poles_{kind}").replace("-", "−"),
            None,
            error <= 100 * ABOUT,
            f"Let go beside its reference, the robot is at most {as_text(error)} % of the first error away from what "
            f"the poles say at 10 kHz, and {_percent(run.number(f'claims.sampled_pole_error_{kind}'))} at 500 Hz. A "
            "command held for h takes K_P h/2 from K_D, so that not every pole can be had: these gains are stable with "
            f"h below {as_text(1e3 * _slowest_sampling(kind))} ms.",
        )

    return say


_OF_FIGURE = {"fig5": "planar", "fig6": "spatial"}


def _taut(*parts: str) -> Say:
    def say(item: Published, run: Run) -> Said:
        least = {part: run.number(f"{part}.least_tension_N") for part in parts}
        slack = any(run.flag(f"{part}.slack") for part in parts)
        each = ", ".join(f"{_OF_FIGURE[part]} {as_text(tension)} N" for part, tension in least.items())
        value = min(least.values())
        return f"≥ {as_text(value)} N", value, value > 0 and not slack, f"Least tension: {each}."

    return say


def _inside(part: str) -> Say:
    def say(item: Published, run: Run) -> Said:
        peak, inside = run.number(f"{part}.peak_error_mm"), run.flag(f"{part}.within")
        turned, load = run.maybe(f"{part}.peak_rotation_mrad"), run.maybe(f"{part}.payload_kg")
        words = [
            f"Bound {as_text(_bound())} mm.",
            "" if load is None else f"With the largest payload of the law, {kilograms(load)}, which it is told.",
            "" if turned is None else f"Rotation errors reach {as_text(turned)} mrad; the paper has no bound for them.",
        ]
        return f"{as_text(peak)} mm", peak, inside, listed(words)

    return say


def _inside_with_springs(item: Published, run: Run) -> Said:
    """By the paper's own law."""
    peak, inside = run.number("fig14.eq22_peak_error_mm"), run.flag("fig14.eq22_within")
    others = {
        "With the friction of Table 4 on the motors": "fig14.eq22_friction_peak_error_mm",
        "With `fl4`": "fig14.peak_error_mm",
    }
    found = {words: run.maybe(key) for words, key in others.items()}
    words = [f"{words} {as_text(error)} mm." for words, error in found.items() if error is not None]
    return f"{as_text(peak)} mm", peak, inside, listed([f"Eq. 22 as printed, bound {as_text(_bound())} mm.", *words])


def _vibration(item: Published, run: Run) -> Said:
    before, after, late = (run.number(f"fig7.ripple_{when}_Nm") for when in ("before", "after", "late"))
    border = ABOUT * run.number("fig7.rigid_peak_Nm")
    return (
        f"{as_text(after)} N·m after, {as_text(late)} N·m at the end",
        late,
        before <= border < after and late <= border,
        f"Torques of Eqs. 23–25 less the rigid ones, rms: {as_text(before)} N·m in the 0.2 s before the jump, "
        f"{as_text(after)} N·m in the 0.2 s after it, {as_text(late)} N·m in the last 0.2 s; more than "
        f"{as_text(border)} N·m count as much. The jump starts it, and in these equations nothing damps it.",
    )


def _torque_changes(item: Published, run: Run) -> Said:
    after, rigid = run.number("fig7.ripple_after_Nm"), run.number("fig7.rigid_peak_Nm")
    peak = run.number("fig7.flexible_peak_Nm")
    return (
        f"{as_text(after)} N·m",
        after,
        after > ABOUT * rigid,
        f"Rms difference in the 0.2 s after the jump. Largest torque: {as_text(peak)} N·m with springs, "
        f"{as_text(rigid)} N·m without.",
    )


def _uncertain(item: Published, run: Run) -> Said:
    nominal = run.number("claims.flex_composite_error_nominal_mm")
    uncertain = run.number("claims.flex_composite_error_table6_mm")
    others = [run.maybe(f"claims.flex_fl4_error_{name}_mm") for name in ("nominal", "table6")]
    return (
        f"{as_text(uncertain)} mm",
        uncertain,
        uncertain > (1 + ABOUT) * nominal,
        f"Mean error of `composite` under Table 6, against {as_text(nominal)} mm with everything known; `fl4`: "
        f"{as_text(others[1])} against {as_text(others[0])} mm.",
    )


def _open_tracking(item: Published, run: Run) -> Said:
    errors = {
        kind: [run.number(f"claims.{loop}_loop_{kind}_error_mm") for loop in ("closed", "open")]
        for kind in ("planar", "spatial")
    }
    each = "; ".join(f"{kind} {as_text(closed)} mm, {as_text(opened)} mm" for kind, (closed, opened) in errors.items())
    return (
        f"{as_text(errors['spatial'][0])} mm",
        errors["spatial"][0],
        all(closed < opened for closed, opened in errors.values()),
        f"Mean errors under Table 6 with feedback and by the torques of exact tracking alone: {each}.",
    )


def _open_loads(run: Run, criterion: str) -> tuple[bool, str]:
    """Whether feedback carries more, and the payloads in words."""
    words, better = [], True
    for kind in ("planar", "spatial"):
        names = (f"claims.{loop}_loop_{kind}{criterion}_kg" for loop in ("closed", "open"))
        closed, opened = (run.optional(name) for name in names)
        better &= closed is not None and (opened is None or closed > opened)
        words.append(f"{kind} {kilograms(closed)}, {kilograms(opened)}")
    return better, "; ".join(words)


_TWO_CRITERIA = "With feedback and in open loop, nothing unknown: paper criterion {}; task criterion {}."


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
    return ours, value, bool(closer) and better, listed([words, _TWO_CRITERIA.format(paper, task)])


# --- joint springs --------------------------------------------------------------------------------------------------


def _growth(run: Run) -> tuple[float, str]:
    soft, stiff = run.number("eq22.max_growth_K2"), run.number("eq22.max_growth_K3")
    return max(soft, stiff), f"Deviations grow with {as_text(soft)} 1/s at K = 2 and {as_text(stiff)} 1/s at K = 3."


def _any_stiffness(run: Run) -> str:
    least, friction = run.maybe("eq22.least_growth_any_K"), run.maybe("eq22.friction_needed")
    return listed(
        [
            "" if least is None else f"Over K from 1 to 10⁵ N·m/rad never slower than with {as_text(least)} 1/s.",
            "" if friction is None else f"Motor friction of {as_text(friction)} N·m·s/rad would be needed.",
        ]
    )


def _eq22(item: Published, run: Run) -> Said:
    growth, words = _growth(run)
    lost = run.maybe("fig7.closed_loop_peak_error_mm")
    evidence = listed(
        [
            words,
            _any_stiffness(run),
            "" if lost is None else f"On the robot the error reaches {as_text(lost)} mm (Fig. 7).",
            "With β̈′ taken from v the loop has no s³ term, measured it cancels the motor.",
        ]
    )
    return f"growth {as_text(growth)} 1/s", growth, growth < 0, evidence


def _eq25(item: Published, run: Run) -> Said:
    growth, words = _growth(run)
    robot = flexible(run.readings, "control")
    divisor = robot.motor_inertia + (1.0 if run.readings.eq24 == "verbatim" else 0.0)
    frequency = float(np.sqrt(robot.stiffness / divisor).max()) / (2 * math.pi)
    return (
        f"growth {as_text(growth)} 1/s",
        growth,
        growth < 0,
        f"By itself Eq. 25 is an oscillator of {as_text(frequency)} Hz without damping, in which nothing decays. On "
        f"the robot H depends on β′, for it is the springs that move the platform. {words}",
    )


def _eq22_robust(item: Published, run: Run) -> Said:
    least = run.number("eq22.least_growth_any_K")
    return (
        f"growth ≥ {as_text(least)} 1/s",
        least,
        least < 0,
        "Inside its layer the robust term is a stiffer PD, and no gains make Eq. 22 stable: its characteristic "
        "polynomial M J′s⁴ + K (M + J′)(s² + K_D s + K_P) has no s³ term, so that the sum of its roots is zero.",
    )


def _stable_springs(item: Published, run: Run) -> Said:
    growth, words = _growth(run)
    return (
        f"growth {as_text(growth)} 1/s",
        growth,
        growth < 0,
        listed([f"Small deviations under Eq. 22. {words}", _any_stiffness(run)]),
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
    robot = flexible(run.readings, "control")
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
    "spatial": "Torques with one, two and three platform masses lie on a line (not through zero: B of Eq. 41).",
    "planar": "Torques with one, two and three platform masses, second difference over first. S τ is affine, as Eq. 41 "
    "says, but the least tensions have kinks where they turn to another pair of cables.",
}


def _affine(kind: str) -> Say:
    def say(item: Published, run: Run) -> Said:
        residual = run.number(f"claims.affine_{kind}")
        holds = residual <= AFFINE
        return "affine" if holds else f"{as_text(100 * residual)} % off", residual, holds, _AFFINE_WORDS[kind]

    return say


def _answer(item: Published, run: Run) -> Said:
    ratio = run.number("eq37.literal_over_true")
    literal, corrected, exact = (run.maybe(f"eq37.{name}_payload_kg") for name in ("literal", "corrected", "exact"))
    evidence = listed(
        [
            f"As printed {kilograms(literal)}, corrected {kilograms(corrected)}, in closed form {kilograms(exact)}.",
            "Printed, τ± is taken from the loaded torque, so that the guess repeats itself at half the true load.",
        ]
    )
    return f"{as_text(ratio)} of the payload", ratio, within(ratio, 1.0), evidence


def _converges(item: Published, run: Run) -> Said:
    spread, literal = run.number("eq37.literal_spread_kg"), run.number("eq37.literal_payload_kg")
    same = spread <= ABOUT * literal
    what = "the same answer" if same else f"answers {as_text(spread)} kg apart"
    return (
        f"{kilograms(literal)} from any guess" if same else f"{as_text(spread)} kg apart",
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
        f"Spatial robot, paper criterion: {kilograms(told)} if the law is told the load, {kilograms(untold)} if not: "
        "then it is the error that ends it.",
        f"Task criterion: {kilograms(loads[0])} and {kilograms(loads[1])}." if set(task) <= set(run.numbers) else "",
        "True for a load that the law is told, with motors that do not saturate.",
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
    for key, measure in (("4.4.sum", "sum"), ("4.4.max", "max"), ("6.robust", "sum")):
        yield key, _finder("fig9", _reduction(measure), reading=f"ε = {LAYER}, with joint springs")
    yield "5.1.linear-spatial", _finder("claims", _affine("spatial"))
    yield "5.1.linear-planar", _finder("claims", _affine("planar"), "minimum_tension", "alpha")
    yield "5.1.converges", _finder("eq37", _converges, reading="as printed")
    yield "5.1.answer", _finder("eq37", _answer, reading="as printed")
    yield "5.1.accuracy", _finder("claims", _no_accuracy, reading="load not told")
    for kind, part, load in (("planar", "fig10", "5.2.1.payload"), ("spatial", "fig12", "5.2.2.payload")):
        yield load, _finder(part, _load(kind, part), *_PAYLOAD_READINGS[kind])
        yield load.replace("payload", "motor"), _finder(part, _motor(part), *_PAYLOAD_READINGS[kind][1:])
    yield "5.2.3.rigid", _finder("fig12", _load("spatial", "fig12"), *_PAYLOAD_READINGS["spatial"])
    yield "5.2.1.path", _finder("fig11", _inside("fig11"), "planar_apex", "minimum_tension")
    yield "5.2.2.path", _finder("fig13", _inside("fig13"), "platform_mass", "triangles", "sides")
    yield "5.2.3.stable", _finder("eq22", _stable_springs)
    yield "5.2.3.path", _finder("fig14", _inside_with_springs, "stiffness", "platform_mass", reading="Eq. 22")
    yield "5.2.3.payload", _finder("fig15", _spring_load, *_PAYLOAD_READINGS["flexible"], reading="Eqs. 23–25")
    yield "5.2.3.motor", _finder("fig15", _spring_motor, *_PAYLOAD_READINGS["flexible"][1:], reading="Eqs. 23–25")
    yield "5.2.3.less", _finder("fig15", _less, *_PAYLOAD_READINGS["flexible"][1:], reading="Eqs. 23–25")
    yield "6.torque", _finder("fig7", _torque_changes, "stiffness", "eq24")
    yield "6.drop", _finder("fig15", _drop, *_PAYLOAD_READINGS["flexible"][1:], reading="Eqs. 23–25")
    yield "6.uncertainty", _finder("claims", _uncertain)
    yield "6.open-tracking", _finder("claims", _open_tracking)
    yield "6.open-payload", _finder("claims", _open_payload, reading="paper criterion")
