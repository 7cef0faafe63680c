"""Findings on results and claims from the numbers of the run."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from cablebot_baselines.classical.outer_loop import PAPER_GAINS, RobustPD
from cablebot_baselines.paper.finding import (
    Finding,
    FindingRule,
    Run,
    Verdict,
    as_text,
    command,
    join_sentences,
    kilograms,
    option_text,
    relative_difference,
    short,
)
from cablebot_baselines.paper.interpretation import Interpretation, Source
from cablebot_baselines.paper.published import ABOUT, LOADS, PUBLISHED, Published, published_value, within
from cablebot_gym.task import ErrorBounds

LAYERS = ("1e-2", "1e-3", "1e-4")
"""Boundary layers ε of the robust term in the evidence."""

LAYER = f"{RobustPD.boundary_layer:.0e}".replace("e-0", "e-")
"""Default ε of the robust law, which determines the verdict."""

AFFINE = 1e-6
"""Maximum relative residual of a torque that counts as affine in the load (rounding error)."""

Statement = tuple[str, float | None, bool | None, str]
"""Our value as text and as a number, whether the published item is reproduced (None: undecided), and the evidence."""

StatementFunction = Callable[[Published, Run], Statement]
"""Function that evaluates one published item."""


_PAYLOAD_PARTS = ("fig10", "fig11", "fig12", "fig13", "fig14", "fig15")
"""Parts that use the robots of §5.2."""


def _rule(part: str | tuple[str, ...], state: StatementFunction, *options: str, note: str = "") -> FindingRule:
    """Rule for a result or claim.

    Args:
        part: part or parts that compute the required numbers.
        state: function that evaluates the published item.
        *options: names of the options that affect the finding.
        note: text on further choices.
    """
    parts = (part,) if isinstance(part, str) else part
    source: Source = "payload" if parts[0] in _PAYLOAD_PARTS else "control"

    def evaluate(item: Published, run: Run) -> Finding:
        ours, value, holds, evidence = state(item, run)
        no_loop = "claims" in parts and not run.interpretation.closed_loop_possible
        fallback = "torque limits from the motor speed, because no motor can have this line" if no_loop else ""
        verdict: Verdict = "undecided" if holds is None else "reproduced" if holds else "not reproduced"
        return Finding(
            ours=ours,
            value=value,
            interpretation=", ".join(
                words for words in (run.options_text(*options, source=source), note, fallback) if words
            ),
            verdict=verdict,
            evidence=evidence,
            command=command(run.interpretation, *parts),
        )

    return FindingRule(parts=parts, evaluate=evaluate)


_PAYLOAD_OPTIONS = {
    "planar": ("payload", "line", "planar_apex", "minimum_tension", "alpha"),
    "spatial": ("payload", "line", "platform_mass", "triangles", "sides", "pulleys"),
    "flexible": ("payload", "line", "platform_mass", "triangles", "sides", "stiffness", "eq24"),
}
"""Options that affect each payload."""


_COMBINED = {
    "planar": ("planar_apex", "alpha", "minimum_tension", "line"),
    "spatial": ("triangles", "sides", "pulleys", "platform_mass", "line"),
    "flexible": ("eq24", "stiffness", "line"),
}
"""Options that the part ``interpretations`` combines, in the order of the names of its numbers."""

_PAYLOAD_VALUES = {"platform_mass": "10", "stiffness": "3"}
"""Values of "as-printed" in §5.2."""

_NEAR = 0.015
"""Relative difference below which a payload matches "about 2.56 kg"."""


# --- payloads -------------------------------------------------------------------------------------------------------


SECTIONS = {"planar": "5.2.1", "spatial": "5.2.2", "flexible": "5.2.3"}
"""Section of each published payload."""


def _closest(run: Run, kind: str) -> str:
    """Closest payload of all combinations of options with the published motor; empty without the combinations."""
    motor, loads = published_value(f"{SECTIONS[kind]}.motor"), with_published_motor(run, kind)
    if not loads:
        return ""
    sentences = [
        f"Closest combination of options with motor {short(int(motor))} as the limiting motor: {nearest(kind, loads)}."
    ]
    if kind == "planar":
        mass = run.interpretation.planar.mass
        totals = {name: load + mass for name, load in loads.items()}
        sentences.append(f"Closest total mass of platform and load: {nearest(kind, totals)}.")
    total, close = run.maybe(f"interpretations.{kind}_total"), run.maybe(f"interpretations.{kind}_within_5pct")
    if total is not None and close is not None:
        sentences.append(
            f"{int(close)} of {int(total)} combinations are within {_percent(ABOUT)}, for any limiting motor."
        )
    return " ".join(sentences)


def with_published_motor(run: Run, kind: str) -> dict[str, float]:
    """Payloads of all combinations of options whose limiting motor is the published one, by name [kg]."""
    prefix, motor = f"interpretations.{kind}_", published_value(f"{SECTIONS[kind]}.motor")
    loads: dict[str, float] = {}
    for key in run.numbers:
        if key.startswith(prefix) and key.endswith("_kg"):
            load, first = run.maybe(key), run.maybe(f"{key[:-3]}_motor")
            if load is not None and first == motor:
                loads[key[len(prefix) : -3]] = load
    return loads


def nearest(kind: str, loads: Mapping[str, float]) -> str:
    """Text of the payloads closest to the published one, with their relative difference and options.

    The text lists all payloads that match within rounding, or only the closest payload if none matches.
    """
    target = LOADS[kind]
    names = sorted(loads, key=lambda name: abs(loads[name] - target))
    near = [name for name in names if abs(loads[name] / target - 1) <= _NEAR] or names[:1]
    return ", or ".join(
        f"{kilograms(loads[name])}{_difference_text(loads[name], target)} with {_named(kind, name)}" for name in near
    )


def _named(kind: str, words: str) -> str:
    """Options in the name of a number that differ from the default."""
    choices, names = words.split("_"), _COMBINED[kind]
    if len(choices) != len(names):
        return ", ".join(choices)
    defaults = {name: _PAYLOAD_VALUES.get(name, str(getattr(Interpretation(), name))) for name in names}
    texts = [option_text(name, choice) for name, choice in zip(names, choices, strict=True) if choice != defaults[name]]
    return ", ".join(texts) or "the default interpretation"


def is_simulated(run: Run, part: str) -> bool:
    """Whether the payload of the part comes from a closed loop, not from exact tracking or the state space."""
    return run.numbers.get(f"{part}.simulated") is not False


def _payload_variants(run: Run, part: str, target: float) -> str:
    """Payload by each method and definition."""
    closed, exact = run.optional(f"{part}.payload_kg"), run.maybe(f"{part}.exact_payload_kg")
    if closed is None and exact is None:
        return "The robot fails unloaded."
    total = run.maybe(f"{part}.total_mass_kg" if exact is None else f"{part}.exact_total_mass_kg")
    near = total is not None and total < 2 * target
    return join_sentences(
        [
            f"Added load: {kilograms(closed)} in closed loop, {kilograms(exact)} by exact tracking."
            if is_simulated(run, part)
            else f"Added load by exact tracking: {kilograms(exact)}. This interpretation allows no closed loop.",
            f"Total mass with the platform: {kilograms(total)}{_difference_text(total, target)}." if near else "",
        ]
    )


def _load(kind: str, part: str) -> StatementFunction:
    def state(item: Published, run: Run) -> Statement:
        counted, target = run.optional(f"{part}.counted_kg"), LOADS[kind]
        evidence = join_sentences([_payload_variants(run, part, target), _closest(run, kind), _geometry(run, kind)])
        if counted is None:
            return "fails unloaded", None, False, evidence
        return (
            f"{kilograms(counted)} ({relative_difference(counted, target)})",
            counted,
            within(counted, target),
            evidence,
        )

    return state


def _repeated(state: StatementFunction, key: str) -> StatementFunction:
    """Finding on a repeated statement, with a reference in place of the evidence."""

    def again(item: Published, run: Run) -> Statement:
        ours, value, holds, _ = state(item, run)
        return ours, value, holds, f"See {PUBLISHED[key].place}: {PUBLISHED[key].statement}."

    return again


def _geometry(run: Run, kind: str) -> str:
    if kind == "planar":
        best = run.maybe("scan.planar_best_added_kg")
        if best is None:
            return ""
        largest = kilograms(best)
        return f"With this line and T_min the largest added load over all orientations of the triangle is {largest}."
    hits, geometries = run.maybe("scan.hits"), run.maybe("scan.geometries")
    most = run.maybe("scan.largest_kg")
    if hits is None or geometries is None or most is None:
        return ""
    second = run.maybe("scan.hits_second_motor")
    motor_text = "" if second is None else f", {int(second)} of them with motor 2 as the limiting motor"
    return (
        f"However, {int(hits)} of {int(geometries)} tested geometries also give this payload{motor_text}, and payloads "
        f"reach {kilograms(most)}. The payload alone does not identify the geometry."
    )


def _motor_and_time(motor: float, time: float | None) -> str:
    return f"motor {short(int(motor))}" + (f" at {short(time)} s" if time is not None else "")


def _motor(part: str) -> StatementFunction:
    def state(item: Published, run: Run) -> Statement:
        motor, exact = run.optional(f"{part}.motor"), run.maybe(f"{part}.exact_motor")
        exact_text = (
            "" if exact is None else f"Exact tracking: {_motor_and_time(exact, run.maybe(f'{part}.exact_time_s'))}."
        )
        if motor is None or run.optional(f"{part}.payload_kg") is None:
            reason = "The robot fails unloaded, or the limiting violation is not a motor torque."
            return "no motor", None, False, join_sentences([reason, exact_text])
        words = _motor_and_time(motor, run.maybe(f"{part}.time_s"))
        return words, motor, motor == published_value(item.key), exact_text or "Paper criterion."

    return state


_NO_EXACT = "The reference acceleration jumps at half time. No robot with joint springs can follow this jump exactly."


def _spring_load(item: Published, run: Run) -> Statement:
    counted, target = run.optional("fig15.state_space_counted_kg"), LOADS["flexible"]
    law, own = run.maybe("fig15.counted_kg"), run.maybe("fig15.eq22_counted_kg")
    evidence = join_sentences(
        [
            _NO_EXACT,
            "The paper may have computed its number from Eqs. 23–25, but no physical robot moves like this.",
            f"DLCC of Eq. 22 on the robot: {kilograms(own)}." if "fig15.eq22_counted_kg" in run.numbers else "",
            f"DLCC of the stable law `fl4`: {kilograms(law)}{_difference_text(law, target)}; see Interpretations."
            if "fig15.counted_kg" in run.numbers and is_simulated(run, "fig15")
            else "",
            _closest(run, "flexible"),
        ]
    )
    if counted is None:
        return "fails unloaded", None, False, evidence
    return f"{kilograms(counted)}{_difference_text(counted, target)}", counted, within(counted, target), evidence


def _difference_text(ours: float | None, published: float) -> str:
    return "" if ours is None else f" ({relative_difference(ours, published)})"


def _spring_motor(item: Published, run: Run) -> Statement:
    motor, time = run.optional("fig15.state_space_motor"), run.maybe("fig15.state_space_time_s")
    if motor is None:
        return "no motor", None, False, "No motor reaches its limit."
    if not is_simulated(run, "fig15"):
        return (
            _motor_and_time(motor, time),
            motor,
            motor == published_value(item.key),
            "No motor can have this torque-speed line in closed loop.",
        )
    law = run.maybe("fig15.motor")
    evidence = (
        "`fl4`: the limiting violation is not a motor torque." if law is None else f"`fl4`: motor {short(int(law))}."
    )
    return _motor_and_time(motor, time), motor, motor == published_value(item.key), evidence


def _drops(run: Run) -> tuple[float, str]:
    """Payload reduction by the springs in the state space of the paper [%], and a text of all payloads."""
    drop, law = 100 * run.number("fig15.state_space_drop_fraction"), None
    loads = {
        "rigid by exact tracking": run.optional("fig15.rigid_exact_counted_kg"),
        "with springs by Eqs. 23–25": run.optional("fig15.state_space_counted_kg"),
    }
    if is_simulated(run, "fig15"):
        law = run.maybe("fig15.drop_fraction")
        loads["rigid in closed loop"] = run.maybe("fig15.rigid_counted_kg")
        loads["with springs and `fl4`"] = run.maybe("fig15.counted_kg")
    own = 100 * (1 - LOADS["flexible"] / LOADS["spatial"])
    return drop, join_sentences(
        [
            "Payloads: "
            + ", ".join(f"{words} {kilograms(load)}" for words, load in loads.items())
            + ("." if law is None else f" ({short(100 * abs(law))} % {'less' if law >= 0 else 'more'})."),
            f"The published {LOADS['flexible']:g} kg are {short(own)} % less than the published {LOADS['spatial']:g} "
            "kg.",
        ]
    )


def _drop(item: Published, run: Run) -> Statement:
    drop, words = _drops(run)
    return f"{short(drop)} %", drop, within(drop, published_value(item.key)), words


def _less(item: Published, run: Run) -> Statement:
    drop, words = _drops(run)
    return f"{short(drop)} % less", drop, drop > 100 * ABOUT, words


# --- the robust term ------------------------------------------------------------------------------------------------


def _reduction(measure: str) -> StatementFunction:
    def state(item: Published, run: Run) -> Statement:
        def fraction(name: str, layer: str) -> float:
            return 100 * run.number(f"fig9.{name}_reduction_{layer}")

        springs, rigid = ([fraction(name, layer) for layer in LAYERS] for name in (f"flex_{measure}", measure))
        ours = fraction(f"flex_{measure}", LAYER)
        evidence = (
            f"For ε = {', '.join(LAYERS)} the reduction is {_percents(springs)} with joint springs, where `composite` "
            f"replaces the unstable Eq. 22, and {_percents(rigid)} without springs. The paper does not print ε, ζ and "
            "φ. The reduction depends mainly on ε."
        )
        return f"{short(ours)} %", ours, ours > published_value(item.key), evidence

    return state


def _percent(fraction: float) -> str:
    return f"{short(100 * fraction)} %"


def _percents(fractions: list[float]) -> str:
    return ", ".join(f"{short(fraction)} %" for fraction in fractions)


def _lyapunov_term(item: Published, run: Run) -> Statement:
    fractions = [100 * run.number(f"fig9.sum_reduction_{layer}") for layer in LAYERS]
    return (
        f"error reduction {_percents(fractions)}",
        min(fractions),
        min(fractions) > 0,
        f"Rigid robot with the uncertainty of Table 6 for ε = {', '.join(LAYERS)}. The sign is correct for e = z_d − "
        "z; the printed minus is correct for e = z − z_d. With joint springs no Δv stabilises Eq. 22 (§3.3).",
    )


# --- tracking -------------------------------------------------------------------------------------------------------


def _bound() -> float:
    """Position error bound R [mm]."""
    return 1e3 * ErrorBounds().position


def _perfect(item: Published, run: Run) -> Statement:
    planar, spatial = run.number("fig5.peak_error_mm"), run.number("fig6.peak_error_mm")
    unknown = run.number("claims.closed_loop_spatial_error_mm")
    worst = max(planar, spatial, unknown)
    return (
        f"{short(worst)} mm",
        worst,
        worst <= ABOUT * _bound(),
        f"Mean error of the spatial robot with the uncertainty of Table 6: {short(unknown)} mm; R is {short(_bound())} "
        f"mm. Without uncertainty the error is at most {short(planar)} mm (planar) and {short(spatial)} mm (spatial). "
        "Its causes are sampling and the jump at half time.",
    )


def _poles(kind: str) -> tuple[complex, complex]:
    stiffness, damping = PAPER_GAINS[kind]
    low, high = np.roots([1.0, damping, stiffness]).tolist()
    return low, high


def _slowest_sampling(kind: str) -> float:
    """Longest control period with a stable sampled loop for these gains [s].

    With ë = −K_P e − K_D ė constant over h: z² + (K_P h²/2 + K_D h − 2) z + K_P h²/2 − K_D h + 1 = 0.
    """
    stiffness, damping = PAPER_GAINS[kind]
    return min(2 * damping / stiffness, 2 / damping)


def _stable_gains(item: Published, run: Run) -> Statement:
    slowest = max(root.real for kind in PAPER_GAINS for root in _poles(kind))
    growth = run.number("eq22.max_growth_K3")
    return (
        f"real parts ≤ {short(slowest)} 1/s",
        slowest,
        slowest < 0,
        "Poles of both sets of gains for the rigid robots. With joint springs the law of the paper does not place the "
        f"poles; deviations grow at {short(growth)} 1/s.",
    )


_EQUATIONS = {"planar": "14", "spatial": "19"}


def _poles_match(kind: str) -> StatementFunction:
    def state(item: Published, run: Run) -> Statement:
        error, sampled = (100 * run.number(f"claims.{name}_error_{kind}") for name in ("pole", "sampled_pole"))
        return (
            run.text(f"claims.poles_{kind}").replace("-", "−"),
            None,
            error <= 100 * ABOUT,
            f"Starting with an initial error, the robot follows Eq. {_EQUATIONS[kind]} within {as_text(error, 2)} % of "
            f"this error at 10 kHz and within {as_text(sampled, 2)} % at 500 Hz. However, sampling limits the "
            "placement: a zero-order hold of duration h reduces K_D by K_P h/2, so these gains are stable only for h "
            f"below {short(1e3 * _slowest_sampling(kind))} ms.",
        )

    return state


_OF_FIGURE = {"fig5": "planar", "fig6": "spatial"}


def _taut(*parts: str) -> StatementFunction:
    def state(item: Published, run: Run) -> Statement:
        least = {part: run.number(f"{part}.least_tension_N") for part in parts}
        slack = any(run.flag(f"{part}.slack") for part in parts)
        each = ", ".join(f"{_OF_FIGURE[part]} {short(tension)} N" for part, tension in least.items())
        value = min(least.values())
        note = (
            "" if "fig5" not in parts else " For the planar robot this is T_min, because α keeps the tensions above it."
        )
        return f"≥ {short(value)} N", value, value > 0 and not slack, f"Smallest tension: {each}.{note}"

    return state


def _inside(part: str) -> StatementFunction:
    def state(item: Published, run: Run) -> Statement:
        peak, inside = run.number(f"{part}.peak_error_mm"), run.flag(f"{part}.within")
        turned, load = run.maybe(f"{part}.peak_rotation_mrad"), run.maybe(f"{part}.payload_kg")
        words = [
            f"Bound {short(_bound())} mm.",
            "" if load is None else f"Largest payload of the law: {kilograms(load)}; the law knows the payload.",
            ""
            if turned is None
            else f"Rotation errors reach {short(turned)} mrad; the paper defines no bound for them.",
        ]
        return f"{short(peak)} mm", peak, inside, join_sentences(words)

    return state


def _inside_with_springs(item: Published, run: Run) -> Statement:
    """Evaluates the law of the paper."""
    peak, inside = run.number("fig14.eq22_peak_error_mm"), run.flag("fig14.eq22_within")
    others = {
        "With the friction of Table 4 at the motors:": "fig14.eq22_friction_peak_error_mm",
        "With `fl4`:": "fig14.peak_error_mm",
    }
    peaks = {words: run.maybe(key) for words, key in others.items()}
    words = [f"{words} {short(error)} mm." for words, error in peaks.items() if error is not None]
    return (
        f"{short(peak)} mm",
        peak,
        inside,
        join_sentences([f"Eq. 22 as printed; bound {short(_bound())} mm.", *words]),
    )


def _vibration(item: Published, run: Run) -> Statement:
    before, after, late = (run.number(f"fig7.ripple_{when}_Nm") for when in ("before", "after", "late"))
    border = ABOUT * run.number("fig7.rigid_peak_Nm")
    return (
        f"{short(after)} N·m after the change, {short(late)} N·m at the end",
        late,
        before <= border < after and late <= border,
        f"RMS difference between the torques of Eqs. 23–25 and the rigid torques: {short(before)} N·m in the 0.2 s "
        f"before the jump, {short(after)} N·m in the 0.2 s after it, {short(late)} N·m in the last 0.2 s. The "
        f"threshold of a strong vibration is {short(border)} N·m. The jump excites the vibration, and these equations "
        "have no damping.",
    )


def _torque_changes(item: Published, run: Run) -> Statement:
    after, rigid = run.number("fig7.ripple_after_Nm"), run.number("fig7.rigid_peak_Nm")
    peak = run.number("fig7.flexible_peak_Nm")
    return (
        f"{short(after)} N·m",
        after,
        after > ABOUT * rigid,
        f"RMS difference in the 0.2 s after the jump. Largest torque: {short(peak)} N·m with springs, "
        f"{short(rigid)} N·m without springs.",
    )


def _uncertain(item: Published, run: Run) -> Statement:
    nominal = run.number("claims.flex_composite_error_nominal_mm")
    uncertain = run.number("claims.flex_composite_error_table6_mm")
    others = [run.maybe(f"claims.flex_fl4_error_{name}_mm") for name in ("nominal", "table6")]
    return (
        f"{short(uncertain)} mm",
        uncertain,
        uncertain > (1 + ABOUT) * nominal,
        f"Mean error of `composite` with the uncertainty of Table 6, compared with {short(nominal)} mm without "
        f"uncertainty. `fl4`: {short(others[1])} mm compared with {short(others[0])} mm.",
    )


def _open_tracking(item: Published, run: Run) -> Statement:
    errors = {
        kind: [run.number(f"claims.{loop}_loop_{kind}_error_mm") for loop in ("closed", "open")]
        for kind in ("planar", "spatial")
    }
    each = ", ".join(
        f"{kind} {short(closed)} mm with and {short(opened)} mm without feedback"
        for kind, (closed, opened) in errors.items()
    )
    return (
        f"{short(errors['spatial'][0])} mm",
        errors["spatial"][0],
        all(closed < opened for closed, opened in errors.values()),
        f"Mean errors with the uncertainty of Table 6; the open loop applies the torques of exact tracking: {each}.",
    )


def _open_loads(run: Run, criterion: str) -> tuple[bool, str]:
    """Whether feedback has the larger payload, and a text of the payloads."""
    words, better = [], True
    for kind in ("planar", "spatial"):
        names = (f"claims.{loop}_loop_{kind}{criterion}_kg" for loop in ("closed", "open"))
        closed, opened = (run.optional(name) for name in names)
        better &= closed is not None and (opened is None or closed > opened)
        words.append(f"{kind} {kilograms(closed)} with and {kilograms(opened)} without feedback")
    return better, ", ".join(words)


_TWO_CRITERIA = (
    "Payloads without uncertainty under the paper criterion, where the motors are the limit: {}. Under the task "
    "criterion, where the errors are the limit: {}."
)


def _open_payload(item: Published, run: Run) -> Statement:
    """Evaluates the criterion of the paper."""
    (better, paper), (_, task) = (_open_loads(run, criterion) for criterion in ("_paper", ""))
    value = run.optional("claims.closed_loop_spatial_paper_kg")
    return kilograms(value), value, better, _TWO_CRITERIA.format(paper, task)


def _controller(item: Published, run: Run) -> Statement:
    """Evaluates the task criterion, which requires accuracy."""
    tracked, _, closer, words = _open_tracking(item, run)
    (_, paper), (better, task) = (_open_loads(run, criterion) for criterion in ("_paper", ""))
    value = run.optional("claims.closed_loop_spatial_kg")
    ours = f"{tracked}, {kilograms(value)}"
    reason = (
        'The verdict uses the errors, because the paper argues with accuracy ("and so"); §6 uses the paper criterion.'
    )
    return ours, value, bool(closer) and better, join_sentences([words, _TWO_CRITERIA.format(paper, task), reason])


# --- joint springs --------------------------------------------------------------------------------------------------


def _growth(run: Run) -> tuple[float, str]:
    soft, stiff = run.number("eq22.max_growth_K2"), run.number("eq22.max_growth_K3")
    return max(soft, stiff), f"Small deviations grow at {short(soft)} 1/s for K = 2 and {short(stiff)} 1/s for K = 3."


def _any_stiffness(run: Run) -> str:
    least, friction = run.maybe("eq22.least_growth_any_K"), run.maybe("eq22.friction_needed")
    return join_sentences(
        [
            "" if least is None else f"For all K from 1 to 10⁵ N·m/rad the growth rate is at least {short(least)} 1/s.",
            "" if friction is None else f"Stability requires a motor friction of {short(friction)} N·m·s/rad.",
        ]
    )


def _eq22(item: Published, run: Run) -> Statement:
    growth, words = _growth(run)
    lost = run.maybe("fig7.closed_loop_peak_error_mm")
    evidence = join_sentences(
        [
            words,
            _any_stiffness(run),
            "" if lost is None else f"On the robot the error reaches {short(lost)} mm (Fig. 7).",
            "If β̈′ is computed from v, the loop has no s³ term. If β̈′ is measured, it cancels.",
        ]
    )
    return f"growth rate {short(growth)} 1/s", growth, growth < 0, evidence


def _eq25(item: Published, run: Run) -> Statement:
    growth, words = _growth(run)
    robot = run.interpretation.flexible("control")
    divisor = robot.motor_inertia + (1.0 if run.interpretation.eq24 == "verbatim" else 0.0)
    frequency = float(np.sqrt(robot.stiffness / divisor).max()) / (2 * math.pi)
    return (
        f"growth rate {short(growth)} 1/s",
        growth,
        growth < 0,
        f"Eq. 25 alone is an undamped oscillator of {short(frequency)} Hz, so deviations do not decay. On the robot H "
        f"depends on β′, because the springs move the platform. {words}",
    )


def _eq22_robust(item: Published, run: Run) -> Statement:
    least = run.number("eq22.least_growth_any_K")
    return (
        f"growth rate ≥ {short(least)} 1/s",
        least,
        least < 0,
        "Inside its boundary layer the robust term is a stiffer PD controller. No gains stabilise Eq. 22: the "
        "characteristic polynomial M J′s⁴ + K (M + J′)(s² + K_D s + K_P) has no s³ term, so the sum of its roots is "
        "zero.",
    )


def _stable_springs(item: Published, run: Run) -> Statement:
    growth, words = _growth(run)
    return (
        f"growth rate {short(growth)} 1/s",
        growth,
        growth < 0,
        join_sentences([f"Closed loop with Eq. 22. {words}", _any_stiffness(run)]),
    )


def _controllable(item: Published, run: Run) -> Statement:
    rank, states = run.number("eq22.controllable_states"), run.number("eq22.states")
    return (
        f"{int(rank)} of {int(states)} states controllable",
        rank,
        rank < states,
        "Rank of the controllability matrix of the linearised robot. The torques act on the platform through the "
        "springs with relative degree 4, and `fl4` linearises the robot. A system with fewer inputs than degrees of "
        "freedom can be controllable.",
    )


def _constraint(item: Published, run: Run) -> Statement:
    robot = run.interpretation.flexible("control")
    free = robot.coordinates + robot.cables
    return (
        f"{free} free coordinates",
        float(free),
        free < published_value("2.3.freedom"),
        "A spring exerts a torque and does not constrain the motion. All coordinates of Eq. 8 remain free.",
    )


def _elasticity(item: Published, run: Run) -> Statement:
    evidence = "Neither the paper nor this project has a model of elastic cables. §4.3 and §5.2.3 treat the joints."
    return "joints only", None, None, evidence


# --- the algorithm --------------------------------------------------------------------------------------------------


def _positive_definite(item: Published, run: Run) -> Statement:
    definite = run.flag("eq22.lyapunov_printed_definite")
    return (
        "yes" if definite else "none",
        None,
        definite,
        "A must contain −k_p and −k_d. The printed A has plus signs and is unstable, so no such P exists.",
    )


_AFFINE_WORDS = {
    True: "The torques for one, two and three platform masses lie on a line, which does not pass through zero (B of "
    "Eq. 41).",
    False: "Ratio of the second to the first difference of the torques for one, two and three platform masses. S τ is "
    "affine, as Eq. 41 states. τ is not affine, because a different pair of cables carries the minimum tension.",
}


def _affine(kind: str) -> StatementFunction:
    def state(item: Published, run: Run) -> Statement:
        residual = run.number(f"claims.affine_{kind}")
        holds = residual <= AFFINE
        return "affine" if holds else f"{short(100 * residual)} % residual", residual, holds, _AFFINE_WORDS[holds]

    return state


def _answer(item: Published, run: Run) -> Statement:
    ratio = run.number("eq37.literal_over_true")
    literal, corrected, exact = (run.maybe(f"eq37.{name}_payload_kg") for name in ("literal", "corrected", "exact"))
    evidence = join_sentences(
        [
            f"Spatial robot: {kilograms(literal)} as printed, {kilograms(corrected)} corrected, {kilograms(exact)} in "
            "closed form. The printed τ± is the torque reserve with load; correct is the reserve without load.",
        ]
    )
    return f"{short(ratio)} times the payload", ratio, within(ratio, 1.0), evidence


def _converges(item: Published, run: Run) -> Statement:
    spread, literal = run.number("eq37.literal_spread_kg"), run.number("eq37.literal_payload_kg")
    same = spread <= ABOUT * literal
    outcome = "to the same value" if same else f"to values that differ by {short(spread)} kg"
    return (
        f"{kilograms(literal)} from any guess" if same else f"values differ by {short(spread)} kg",
        literal,
        same and run.flag("eq37.literal_converges"),
        f"Different first guesses converge {outcome}, near {kilograms(literal)}. The finding on the load coefficient "
        "(§5.1) compares this value with the payload.",
    )


def _no_accuracy(item: Published, run: Run) -> Statement:
    known, unknown = (run.optional(f"claims.fl_payload_{name}_paper_kg") for name in ("known", "unknown"))
    holds = known is not None and unknown is not None and unknown >= (1 - ABOUT) * known
    task = [f"claims.fl_payload_{name}_kg" for name in ("known", "unknown")]
    loads = [run.maybe(key) for key in task]
    evidence = [
        f"Spatial robot, paper criterion: {kilograms(known)} with known payload. With unknown payload the error limits "
        f"the payload to {kilograms(unknown)}.",
        f"Task criterion: {kilograms(loads[0])} with known and {kilograms(loads[1])} with unknown payload."
        if set(task) <= set(run.numbers)
        else "",
        "The claim holds if the law knows the payload and no motor saturates.",
    ]
    return (
        f"{kilograms(unknown)} instead of {kilograms(known)}",
        unknown,
        holds,
        join_sentences(evidence),
    )


def finding_rules() -> Iterator[tuple[str, FindingRule]]:
    """Yields all rules of results and claims with their keys."""
    yield "abstract.accuracy", _rule(("fig5", "fig6", "claims"), _perfect)
    yield "abstract.stability", _rule("eq22", _stable_gains)
    yield "1.tension", _rule(("fig5", "fig6"), _taut("fig5", "fig6"), "minimum_tension")
    yield "1.elasticity", _rule("fig7", _elasticity)
    yield "1.controller", _rule("claims", _controller, note="task criterion")
    yield "2.3.constraint", _rule("fig3", _constraint)
    yield "3.1.poles", _rule("claims", _poles_match("planar"))
    yield "3.2.poles", _rule("claims", _poles_match("spatial"))
    yield "3.3.linear", _rule("eq22", _eq22, note="β̈′ computed from v")
    yield "3.3.bounded", _rule("eq22", _eq25, "eq24")
    yield "3.3.robust", _rule("eq22", _eq22_robust, note="β̈′ computed from v")
    yield "3.4.uncontrollable", _rule("eq22", _controllable, "stiffness")
    yield "3.4.lyapunov", _rule("eq22", _positive_definite, note="signs as printed")
    yield "3.4.stability", _rule("fig9", _lyapunov_term, note="sign corrected")
    yield "4.1.tension", _rule("fig5", _taut("fig5"), "minimum_tension")
    yield "4.3.vibration", _rule("fig7", _vibration, "stiffness", "eq24")
    robust = {
        "4.4.sum": _reduction("sum"),
        "4.4.max": _reduction("max"),
        "6.robust": _repeated(_reduction("sum"), "4.4.sum"),
    }
    for key, state in robust.items():
        yield key, _rule("fig9", state, note=f"joint springs, ε = {LAYER}, ζ and φ of this project")
    yield "5.1.linear-spatial", _rule("claims", _affine("spatial"))
    yield "5.1.linear-planar", _rule("claims", _affine("planar"), "minimum_tension", note="smallest α")
    yield "5.1.converges", _rule("eq37", _converges, note="as printed")
    yield "5.1.answer", _rule("eq37", _answer, note="as printed")
    yield "5.1.accuracy", _rule("claims", _no_accuracy, note="payload unknown")
    for kind, part, load in (("planar", "fig10", "5.2.1.payload"), ("spatial", "fig12", "5.2.2.payload")):
        yield load, _rule(part, _load(kind, part), *_PAYLOAD_OPTIONS[kind])
        yield load.replace("payload", "motor"), _rule(part, _motor(part), *_PAYLOAD_OPTIONS[kind][1:])
    again = _repeated(_load("spatial", "fig12"), "5.2.2.payload")
    yield "5.2.3.rigid", _rule("fig12", again, *_PAYLOAD_OPTIONS["spatial"])
    yield "5.2.1.path", _rule("fig11", _inside("fig11"), "line", "planar_apex", "minimum_tension", "alpha")
    yield "5.2.2.path", _rule("fig13", _inside("fig13"), *_PAYLOAD_OPTIONS["spatial"][1:])
    yield "5.2.3.stable", _rule("eq22", _stable_springs)
    yield "5.2.3.path", _rule("fig14", _inside_with_springs, "stiffness", "platform_mass", note="Eq. 22")
    yield "5.2.3.payload", _rule("fig15", _spring_load, *_PAYLOAD_OPTIONS["flexible"], note="Eqs. 23–25")
    yield "5.2.3.motor", _rule("fig15", _spring_motor, *_PAYLOAD_OPTIONS["flexible"][1:], note="Eqs. 23–25")
    yield "5.2.3.less", _rule("fig15", _less, *_PAYLOAD_OPTIONS["flexible"], "pulleys", note="Eqs. 23–25")
    yield "6.torque", _rule("fig7", _torque_changes, "stiffness", "eq24")
    yield "6.drop", _rule("fig15", _drop, *_PAYLOAD_OPTIONS["flexible"], "pulleys", note="Eqs. 23–25")
    yield "6.uncertainty", _rule("claims", _uncertain)
    yield "6.open-tracking", _rule("claims", _open_tracking)
    yield "6.open-payload", _rule("claims", _open_payload, note="paper criterion")
