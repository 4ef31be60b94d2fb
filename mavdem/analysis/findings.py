"""Findings: what a flight says of its vehicle and what its model is good for, made once and shown everywhere.

docs/report.md has the scale. What is estimated is graded by the half width of its 90 % interval (``HALF_WIDTH``) and by
its status, forecasts by windows that no model saw (``PREDICTION_LIMITS``). What makes the flight itself doubtful
overrides all grades.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from math import isfinite, nan
from typing import Any, Literal, NamedTuple

import numpy as np

from mavdem.alignment.verdict import DOUBTFUL_CONSISTENCY
from mavdem.condition import Condition
from mavdem.confidence import LEVEL, quantile
from mavdem.dem import Learned, Physical, WindTorque
from mavdem.dem.engine.linalg import Array
from mavdem.evaluate.held_out import BASELINES, HOLD_LAST, HeldOut
from mavdem.facts import Fact, Level
from mavdem.facts.forecasts import Forecasts
from mavdem.flight import Flight
from mavdem.health.in_flight import MotorAlarm

Grade = Literal["GOOD", "LIMITED", "NOT IDENTIFIABLE"]
GOOD: Grade = "GOOD"
LIMITED: Grade = "LIMITED"
NONE: Grade = "NOT IDENTIFIABLE"

HALF_WIDTH = {"effect": 0.15, "damping": 1 / 3, "lag": 1 / 3, "wind": 0.25}
"""Of the 90 % interval over the estimate, up to which it is GOOD; of the wind torque that of its standard deviation.
The effect decides what the wind torque is; damping and lag matter less and are harder to identify."""


class PredictionLimits(NamedTuple):
    """When a prediction is GOOD; each limit is from docs/report.md, and a test holds it at its edge."""

    ratio: float = 0.5  # of the squared error of the better baseline, at most
    worse: float = 0.1  # share of the windows that may be worse than the constant mean
    # and than the last sample held, which near the trim is hard to beat
    worse_than_last: float = 0.25
    coverage: float = 0.75  # of a 90 % band, at least; below, a warning says so
    # squared error over the one to expect, above which a warning says so
    over_expected: float = 3.0
    windows: int = 5  # fewest; where in a flight a single one is decides its error


PREDICTION_LIMITS = PredictionLimits()
# share of the time at full throttle, from which on no linear model describes the vehicle
SATURATED = 0.05
UNEVEN = 8.0  # percent of a motor beyond the mean of all: what health calls a fault's size
# autocorrelation of the rate after a swing: below, as of a damping ratio of 0.3; above
RINGING = 0.15
SWINGING = 0.4
# below, as a share of the motors' full torque
WIND_WORDS = {"light": 0.005, "moderate": 0.02, "strong": float("inf")}
# in a reason; left out under overrides
ADVICE = re.compile(r"[:.] (?:fly|steer|record|log)\b[^;.]*", re.IGNORECASE)
PURPOSES = ("motor effectiveness", "damping and lag", "wind", "prediction", "residuals")


class Finding(NamedTuple):
    """A ``purpose``, whether the model serves it, and why: one sentence with the figures that decide."""

    purpose: str
    grade: Grade
    reason: str


class Override(NamedTuple):
    """What makes the flight itself doubtful, and overrides all grades."""

    kind: str  # "oscillation", "motors", "saturation", "trim" or "data"
    headline: str  # the plain sentence, for above all tables
    sentence: str  # the same with its figures
    remedy: str  # what to do, one sentence


class Findings(NamedTuple):
    """What a flight says, as every screen, page and document shows it."""

    headline: str  # one plain sentence; empty of a model alone
    overrides: tuple[Override, ...]  # the worst first
    purposes: tuple[Finding, ...]  # graded; none without a model
    warnings: tuple[str, ...]  # what must be known before the model is used
    next_step: str  # one sentence

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values; ``findings`` are the graded purposes."""
        return {
            "headline": self.headline,
            "overrides": [override._asdict() for override in self.overrides],
            "findings": [finding._asdict() for finding in self.purposes],
            "warnings": list(self.warnings),
            "next_step": self.next_step,
        }


def findings_of(
    learned: Learned | None = None,
    held_out: HeldOut | None = None,
    condition: Condition | None = None,
    alarms: Sequence[MotorAlarm] = (),
    reason: str = "",
    remedy: str = "",
    flights: Sequence[Flight] = (),
    watched: bool = False,
    consistency: float | None = None,
) -> Findings:
    """Returns the findings of a flight, of which each part may be missing.

    Args:
        learned, held_out: the model, and forecasts of windows that no model saw.
        condition: of the vehicle.
        alarms: lasting changes of the motors' balance.
        reason, remedy: why there is no full model, and what to change.
        flights: what the model was trained on.
        watched: whether a motor that weakens would have been seen.
        consistency: share of the angle's changes that the rates explain.
    """
    known = _oscillation(condition), _lost_thrust(alarms), _unbalanced(condition)
    # What comes first explains the others: motors at their limits, where the vehicle oscillates or one is weak.
    overrides = tuple(next(filter(None, known), []))
    if learned is not None and consistency is not None and consistency < DOUBTFUL_CONSISTENCY:
        sentence = (
            f"The rate explains {consistency:.2f} of the angle's changes: noise, or an alias."
        )
        remedy = (
            "Log attitude and rates faster, and check the mounting of the autopilot for vibration."
        )
        overrides += (Override("data", "Angle and rate contradict each other.", sentence, remedy),)
    purposes = () if learned is None else _purposes(learned, held_out)
    if other := _stepped(learned, flights):
        meant = {
            PURPOSES[0]: "that of a motor may have changed",
            PURPOSES[2]: "not all of it is wind",
        }
        clear = [one for one in purposes if one.grade == GOOD and one.purpose in meant]
        doubts = {one: f"{other}: {meant[one.purpose]}." for one in clear}
        purposes = tuple(
            one._replace(grade=LIMITED, reason=doubts[one]) if one in doubts else one
            for one in purposes
        )
    if overrides:
        headline = overrides[0].headline
        following = overrides[0].remedy
        purposes = tuple(_doubted(one, overrides[0]) for one in purposes)
    elif reason:
        headline = f"{'No model' if learned is None else 'Slow motion only'}: {reason}"
        following = remedy
    else:
        is_windy = any(one.purpose == "wind" and one.grade == GOOD for one in purposes)
        headline = _in_short(learned if is_windy else None, condition, flights, watched, other)
        check = "Check motors, propellers and the load, and fly again before you keep this as the vehicle's reference."
        following = (
            "Learn a model: `mavdem learn`."
            if learned is None
            else check
            if other
            else next_step(purposes)
        )
    return Findings(
        headline,
        overrides,
        purposes,
        () if learned is None else warnings_of(learned, held_out),
        following,
    )


def disown_torque(learned: Learned, condition: Condition) -> None:
    """Gives the wind torque of a vehicle that oscillates the reason why it is not the wind's."""
    if condition.oscillation is not None and (torque := learned.wind_torque) is not None:
        vars(learned)["wind_torque"] = replace(
            torque, reason="The vehicle oscillates: that torque is its own."
        )


def _doubted(finding: Finding, override: Override) -> Finding:
    """Not GOOD, and what the override is where it was; of a flight that oscillates without figures of its own."""
    is_good = finding.grade == GOOD
    reason = ADVICE.sub("", finding.reason)
    if override.kind == "oscillation":
        reason = override.headline
    elif is_good:
        reason += f" {override.headline}"
    return finding._replace(grade=LIMITED if is_good else finding.grade, reason=reason)


def _oscillation(condition: Condition | None) -> list[Override]:
    found = None if condition is None else condition.oscillation
    if found is None:
        return []
    at = "" if found.frequency is None else f" at {found.frequency:.2g} Hz"
    size = f"{found.axis} rate {found.rate:.0f} °/s (standard deviation) for {found.seconds:.0f} s"
    limit = f"{', growing' if found.growing else ''}; a motor at a limit {100 * found.at_limit:.0f} % of that time"
    remedy = "Do not fly: check frame type, gains and motor order."
    return [
        Override(
            "oscillation",
            f"Oscillates{at}: do not fly.",
            f"It oscillates{at}, {size}{limit}.",
            remedy,
        )
    ]


def _lost_thrust(alarms: Sequence[MotorAlarm]) -> list[Override]:
    """Each motor that weakened in flight, at the time of its first alarm and by its largest, the worst first."""
    ours = sorted((alarm for alarm in alarms if alarm.weak), key=lambda alarm: -alarm.size)
    overrides = []
    for name, worst in reversed({alarm.name: alarm for alarm in reversed(ours)}.items()):
        since = min(alarm.since for alarm in ours if alarm.name == name)
        lost = f"lost {worst.lost} of its thrust at {since:.0f} s"
        remedy = f"Do not fly before {name}, its propeller, connector and controller are inspected."
        sentence = worst.sentence.removeprefix("Alarm: ")
        overrides.append(Override("motors", f"{name.capitalize()} {lost}.", sentence, remedy))
    return overrides


def most_uneven(imbalance: Sequence[float]) -> int:
    """Returns which motor, from 0, is farthest from the mean, in percent; one that works harder goes before others."""
    hardest = max(imbalance)
    return list(imbalance).index(hardest if hardest > UNEVEN else max(imbalance, key=abs))


def _unbalanced(condition: Condition | None) -> list[Override]:
    """The motor most at its upper limit, if over ``SATURATED``; else the most uneven one, if over ``UNEVEN``."""
    hover = None if condition is None else condition.hover
    if hover is None:
        return []
    share = max(hover.at_upper_limit)
    uneven = most_uneven(hover.imbalance)
    most = hover.imbalance[uneven]
    number = hover.at_upper_limit.index(share) if share > SATURATED else uneven
    name = hover.motors[number].split(" (")[0]
    if share > SATURATED:
        kind = "saturation"
        fact = f"is at its upper limit {100 * share:.0f} % of the time"
        meaning = "there it cannot follow the controller, and no linear model holds"
        remedy = f"Do not fly in wind before {name} and its propeller are checked,"
        remedy += " and the load is reduced or centred."
    elif abs(most) > UNEVEN:
        kind = "trim"
        fact = f"works {abs(most):.0f} % {'harder' if most > 0 else 'less'} than the mean of all"
        weak = "a motor or propeller is weak" if most > 0 else "another motor or propeller is weak"
        meaning = f"{weak}, or the load is off centre"
        first = f"{name}, " if most > 0 else ""
        remedy = f"Inspect {first}the propellers and the place of the load before the next flight."
    else:
        return []
    headline = f"{name.capitalize()} {fact}"
    return [Override(kind, f"{headline}.", f"{headline}: {meaning}.", remedy)]


def _in_short(
    windy: Learned | None,
    condition: Condition | None,
    flights: Sequence[Flight],
    watched: bool,
    other: str,
) -> str:
    """What is clearly so of a flight that nothing overrides; ``windy`` where the wind is GOOD, empty if all is open."""
    swings = nan
    hover = None if condition is None else condition.hover
    # the highest autocorrelation of the rate after it has been negative: of what rings on
    for flight in flights:
        rate = flight.outputs[:, -1] - flight.outputs[:, -1].mean()
        auto = correlation(rate, rate, min(round(3.0 / flight.dt), len(rate) - 1))
        swings = np.fmax(swings, auto[int(np.argmax(auto < 0)) :].max())
    words = ["Healthy" if watched and not swings > SWINGING else "No fault seen"]
    if hover is None:
        words = [] if condition is None else ["Motor outputs not known"]
    elif other:
        words = [other]
    elif min(hover.headroom) < 0.1:
        words = [f"Headroom of {100 * min(hover.headroom):.0f} % only"]
    if swings < RINGING:
        words.append("well damped")
    elif swings > SWINGING:
        words.append("hardly damped, or steered to and fro")
    scale = flights[0].provenance.get("scale") if flights else None
    if scale and windy is not None and windy.physical and windy.wind:
        full = abs(windy.physical.effect).sum() * (scale["high"] - scale["low"])
        words.append(
            next(
                f"{word} wind torque"
                for word, most in WIND_WORDS.items()
                if windy.wind.sd < most * full
            )
        )
    return f"{words[0][0].upper()}{', '.join(words)[1:]}." if words else ""


def _stepped(learned: Learned | None, flights: Sequence[Flight]) -> str:
    """That the torque changes at once and stays so, as by a load that moves; empty where it does not."""
    wind = None if learned is None else known_wind(learned.wind_torque, learned.physical)
    if wind is None or wind.step is None or not flights:
        return ""
    sample, size = wind.step
    time = np.concatenate([flight.time for flight in flights])[sample]
    change = f"{np.degrees(size):.0f} °/s² at {time:.0f} s"
    return f"The torque on this axis changes for good by {change} (load or motor)"


def _purposes(learned: Learned, held_out: HeldOut | None) -> tuple[Finding, ...]:
    """The findings on each of the ``PURPOSES``; on prediction only with ``held_out`` windows."""
    physical = learned.physical
    why_not = learned.physical_reason
    graded = dict.fromkeys(PURPOSES[:3], (NONE, why_not))
    if physical is not None:
        parts = _effect(physical), _motion(physical), _wind(learned.wind_torque, physical, why_not)
        graded = dict(zip(PURPOSES, parts, strict=False))
    if held_out is not None:
        graded["prediction"] = _prediction(held_out)
    found = residuals(learned)
    (auto, across) = found.largest
    (bound, joint) = found.bounds
    figures = f"autocorrelation up to {auto:.2f} (99 % bound {bound:.2f}), with the command {across:.2f} ({joint:.2f})"
    word = (
        "Not white"
        if not found.white
        else "White"
        if auto <= bound and across <= joint
        else "Nearly white"
    )
    graded["residuals"] = GOOD if found.white else LIMITED, f"{word}: {figures}"
    return tuple(
        Finding(name, grade, _first_sentence(reason) + ".")
        for name, (grade, reason) in graded.items()
    )


def _first_sentence(text: str) -> str:
    return text.split(". ")[0].rstrip(".")


def _grade(name: str, share: float, status: str = "reported") -> Grade:
    """The grade of an estimate by its ``status`` and the half width of its interval, as a ``share`` of it."""
    if status == "not identifiable":
        return NONE
    return LIMITED if status == "biased" or share > HALF_WIDTH[name] else GOOD


def _effect(physical: Physical) -> tuple[Grade, str]:
    (mean, half) = physical.mean_effect(LEVEL)
    status = physical.status["effect"]
    reason = (
        f"Known to ±{100 * half / mean:.0f} %."
        if status == "reported"
        else physical.reasons["effect"]
    )
    return _grade("effect", half / mean, status), reason


def _motion(physical: Physical) -> tuple[Grade, str]:
    half = physical.interval(LEVEL)
    grades = []
    known = []
    doubts = dict[str, list[str]]()
    for key, name in (("damping", "rate damping"), ("lag", "motor time constant")):
        value = getattr(physical, key)
        status = physical.status[key]
        share = getattr(half, key) / value if value else nan
        grades.append(_grade(key, share, status))
        if isfinite(share):
            known.append(f"{name} to ±{100 * share:.0f} %")
        if status != "reported":
            because = _first_sentence(physical.reasons[key])
            doubts.setdefault(f"{status}: {because[:1].lower()}{because[1:]}", []).append(name)
    if set(grades) == {NONE}:
        reason = physical.reasons["damping"] or physical.reasons["lag"]
        same = _first_sentence(reason) == _first_sentence(physical.reasons["effect"])
        return NONE, "For the same reason as control effectiveness." if same else reason
    reason = f"Known: {', '.join(known) or 'nothing'}"
    for text, names in doubts.items():
        reason += f"; {' and '.join(names)} {'is' if len(names) == 1 else 'are'} {text}"
    return (GOOD if set(grades) == {GOOD} else LIMITED), reason


def known_wind(wind: WindTorque | None, physical: Physical | None) -> WindTorque | None:
    """Returns the ``wind`` torque where it is resolved and the effect among ``physical`` is identifiable."""
    if wind is None or wind.reason is not None or physical is None or not physical.identifiable:
        return None
    return wind


def _wind(wind: WindTorque | None, physical: Physical, why_not: str) -> tuple[Grade, str]:
    if wind is None:
        return NONE, why_not
    if not physical.identifiable:
        # The torque of the wind is what is left when that of the motors is taken away.
        return NONE, "It follows from the control effectiveness, which is not identifiable."
    if wind.reason is not None:
        return NONE, wind.reason
    words = {
        "effect": "control effectiveness",
        "damping": "rate damping",
        "lag": "motor time constant",
    }
    if doubtful := [
        words[name] for name, status in physical.status.items() if status != "reported"
    ]:
        return LIMITED, f"It follows from figures that are not well known: {', '.join(doubtful)}."
    half = quantile() * wind.scale_error
    return _grade("wind", half), f"Its standard deviation is known to ±{100 * half:.0f} %."


def _prediction(held_out: HeldOut) -> tuple[Grade, str]:
    limits = PREDICTION_LIMITS
    best = held_out.best_baseline
    ratio = held_out.error_ratio() / held_out.error_ratio(best)
    worse, than_last = (
        float((held_out.error_ratios(baseline=name) > 1).mean()) for name in BASELINES
    )
    shown = f"{ratio:.2g} times the squared error of “{best}”"
    shown = shown if isfinite(ratio) else "No model of a part could be learned"
    among = (
        f"in {100 * worse:.0f} % of {len(held_out)} windows"
        if len(held_out) > 1
        else f"in {worse:.0f} of 1 window"
    )
    reason = f"{shown}; worse than the mean {among}, than “{HOLD_LAST}” in {100 * than_last:.0f} %."
    if not ratio < 1:
        return NONE, reason
    good = len(held_out) >= limits.windows and ratio <= limits.ratio and worse <= limits.worse
    good = good and than_last <= limits.worse_than_last
    return (GOOD if good and held_out.coverage >= limits.coverage else LIMITED), reason


def warnings_of(learned: Learned, held_out: HeldOut | None) -> tuple[str, ...]:
    """Returns what must be known before the model is used, one sentence each; mostly none."""
    warnings = []
    limits = PREDICTION_LIMITS
    if held_out is not None:
        warnings += [
            str(Fact(Forecasts.PART_NOT_LEARNED, Level.WATCH, because=failure))
            for failure in held_out.failures
        ]
        if held_out.coverage < limits.coverage:
            few = len(held_out) < limits.windows
            advice = "with so few windows that may be chance" if few else "do not rely on it"
            warnings.append(
                f"The 90 % band held {100 * held_out.coverage:.0f} % of the held-out samples: {advice}."
            )
        if held_out.over_expected > limits.over_expected:
            larger = f"{held_out.over_expected:.1f} times the expected squared error"
            warnings.append(f"Forecasts had {larger}: the flight changed, or the model is wrong.")
    if not learned.stable:
        warnings.append("The model is unstable: long forecasts grow without bound.")
    return tuple(warnings)


def next_step(found: Sequence[Finding]) -> str:
    """Returns what to do next, by what was ``found``: the first purpose that is not served decides."""
    grades = {finding.purpose: finding.grade for finding in found}
    effect, motion, _, prediction = (grades.get(purpose, GOOD) for purpose in PURPOSES[:4])
    if effect != GOOD or motion == NONE:
        movements = "quick small movements on this axis in calm air (docs/manoeuvres.md)"
        needed = "the steering must move the motors more than the wind does."
        return f"Fly half a minute of {movements}, and learn from that: {needed}"
    if motion != GOOD:
        needed = "rate damping and motor time constant need a longer flight and faster samples."
        return f"Fly such movements for longer, and log faster if you can: {needed}"
    if prediction == NONE:
        return "`mavdem compare` with this log shows whether another method predicts it better."
    if prediction != GOOD:
        return "Keep its physical parameters as the vehicle's reference, but do not rely on its forecasts."
    return "Keep this as the vehicle's reference; `--axis all` adds pitch and yaw."


BOUND_LEVEL = 0.99  # of the bounds that chance alone keeps to
LAG_SECONDS = 0.5


class Residuals(NamedTuple):
    """One-step residuals of one output with their correlations by lag, and the 99 % bounds of these."""

    errors: Array  # (T,) in the output's unit; NaN where nothing was predicted
    lag: Array  # (L + 1,) s, from 0 on
    auto: Array  # (L + 1,) autocorrelation
    across: Array  # (L + 1,) correlation with the command, so long after it
    # of both; the second allows for the autocorrelation of both (Ljung, sec. 16.6)
    bounds: tuple[float, float]

    @property
    def largest(self) -> tuple[float, float]:
        """The largest correlations, but for the first of ``auto``."""
        return float(np.abs(self.auto[1:]).max()), float(np.abs(self.across).max())

    @property
    def white(self) -> bool:
        """Whether neither is outside its bound by three times, which is no chance."""
        return all(size <= 3 * bound for size, bound in zip(self.largest, self.bounds, strict=True))


def residuals(learned: Learned, output: int = -1) -> Residuals:
    """Returns the residuals of an ``output`` of the training data, the last one unless given."""
    record = learned.record
    command = learned.record.inputs @ weights(directions(learned))
    errors = record.outputs[:, output] - learned.one_step()[:, output]
    errors[record.starts] = np.nan  # a segment's first is not predicted
    known = ~np.isnan(errors)
    centred = np.where(known, errors - errors[known].mean(), 0.0)
    driven = command - command.mean()
    lags = round(LAG_SECONDS / learned.dt)
    auto = correlation(centred, centred, lags)
    driven_auto = correlation(driven, driven, lags)
    width = float(quantile(BOUND_LEVEL) / np.sqrt(known.sum()))
    # The variance of a correlation of two independent series.
    joint = float(np.sqrt(max(1 + 2 * float(auto[1:] @ driven_auto[1:]), 1.0)))
    lag = np.arange(lags + 1.0) * learned.dt
    return Residuals(errors, lag, auto, correlation(driven, centred, lags), (width, width * joint))


def correlation(one: Array, other: Array, lags: int) -> Array:
    """Returns (lags + 1,) of ``one`` at a time with ``other`` 0, 1, … samples later."""
    size = 2 * len(one)
    products = np.fft.irfft(np.conj(np.fft.rfft(one, size)) * np.fft.rfft(other, size), size)[
        : lags + 1
    ]
    scale = np.sqrt(float(one @ one) * float(other @ other))
    return np.asarray(products / scale if scale else np.zeros(lags + 1))


def directions(learned: Learned) -> Array:
    """Returns (r,) how each input turns the vehicle, relative to the others: by the mixer, or else as estimated."""
    known = learned.record.effect_directions
    if known is not None:
        return np.asarray(known)
    if learned.record.inputs.shape[1] == 1:  # the controller's demand
        return np.ones(1)
    effect = learned.model.B[-1] if learned.physical is None else learned.physical.effect
    return np.asarray(effect if effect.any() else np.ones(len(effect)))


def weights(directions: Array) -> Array:
    """Returns (r,) the share of each input in the command of the axis: those that turn up it sum to 1, others to -1."""
    up = np.maximum(directions, 0.0)
    down = np.maximum(-directions, 0.0)
    return np.asarray(
        sum(sign * side / side.sum() for sign, side in ((1, up), (-1, down)) if side.any())
    )
