"""Findings: what a flight's model is good for, purpose by purpose, each with a grade and the reason.

One scale of three grades says how sure something is. What is estimated is graded by the half width of its 90 %
interval, as a share of the estimate (``HALF_WIDTH``), and by its status: what is biased is ``LIMITED`` however narrow
its interval is. Forecasts are graded by windows that no model saw (``PREDICTION_LIMITS``).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, nan
from typing import Literal, NamedTuple

from mavdem.confidence import LEVEL, quantile
from mavdem.dem import Learned, Physical, WindTorque
from mavdem.evaluate.held_out import HeldOut

Grade = Literal["GOOD", "LIMITED", "NOT IDENTIFIABLE"]
GOOD: Grade = "GOOD"
LIMITED: Grade = "LIMITED"
NONE: Grade = "NOT IDENTIFIABLE"
GRADE_OF_STATUS: dict[str, Grade] = {"reported": GOOD, "biased": LIMITED, "not identifiable": NONE}
"""The best grade of a physical parameter with that status."""

HALF_WIDTH = {"effect": 0.15, "damping": 1 / 3, "lag": 1 / 3, "wind": 0.25}
"""Of the 90 % interval over the estimate, up to which it is GOOD; of the wind torque that of its standard deviation.
The effect decides what the wind torque is; damping and lag matter less and are harder to identify."""


class PredictionLimits(NamedTuple):
    """When a prediction is GOOD; each limit is from docs/report.md, and a test holds it at its edge."""

    ratio: float = 0.5  # of the squared error of the better baseline, at most
    worse: float = 0.1  # share of the windows that may be worse than the constant mean
    coverage: float = 0.75  # of a 90 % band, at least; below, a warning says so
    over_expected: float = 3.0  # squared error over the one to expect, above which a warning says so
    windows: int = 5  # fewest; where in a flight a single one is decides its error


PREDICTION_LIMITS = PredictionLimits()
PURPOSES = ("motor effectiveness", "damping and lag", "wind", "prediction")


class Finding(NamedTuple):
    """A ``purpose``, whether the model serves it, and why: one sentence with the figures that decide."""

    purpose: str
    grade: Grade
    reason: str


def findings(learned: Learned, held_out: HeldOut | None) -> tuple[Finding, ...]:
    """Returns the findings on each of the ``PURPOSES``; on prediction only with ``held_out`` windows."""
    physical, why_not = learned.physical, learned.physical_reason
    if physical is None:
        graded = [(NONE, why_not)] * 3
    else:
        graded = [_effect(physical), _motion(physical), _wind(learned.wind, physical, why_not)]
    if held_out is not None:
        graded.append(_prediction(held_out))
    return tuple(
        Finding(purpose, grade, _first_sentence(reason) + ".")
        for purpose, (grade, reason) in zip(PURPOSES, graded, strict=False)
    )


def _first_sentence(text: str) -> str:
    return text.split(". ")[0].rstrip(".")


def _grade(name: str, share: float, status: str = "reported") -> Grade:
    """The grade of an estimate by its ``status`` and the half ``width`` of its interval as a share of it."""
    best = GRADE_OF_STATUS[status]
    return LIMITED if best == GOOD and share > HALF_WIDTH[name] else best


def _effect(physical: Physical) -> tuple[Grade, str]:
    mean, half = physical.mean_effect(LEVEL)
    status = physical.status["effect"]
    reason = f"Known to ±{100 * half / mean:.0f} %." if status == "reported" else physical.reasons["effect"]
    return _grade("effect", half / mean, status), reason


def _motion(physical: Physical) -> tuple[Grade, str]:
    half, grades, known, doubts = physical.interval(LEVEL), [], [], dict[str, list[str]]()
    for key, name in (("damping", "rate damping"), ("lag", "motor time constant")):
        value, status = getattr(physical, key), physical.status[key]
        share = getattr(half, key) / value if value else nan
        grades.append(_grade(key, share, status))
        if isfinite(share):
            known.append(f"{name} to ±{100 * share:.0f} %")
        if status != "reported":
            doubts.setdefault(_first_sentence(physical.reasons[key]), []).append(f"{name} {status}")
    if set(grades) == {NONE}:
        reason = physical.reasons["damping"] or physical.reasons["lag"]
        same = _first_sentence(reason) == _first_sentence(physical.reasons["effect"])
        return NONE, "For the same reason as control effectiveness." if same else reason
    reason = f"Known: {', '.join(known) or 'nothing'}"
    reason += "".join(f"; {' and '.join(names)}: {sentence}" for sentence, names in doubts.items())
    return (GOOD if set(grades) == {GOOD} else LIMITED), reason


def known_wind(wind: WindTorque | None, physical: Physical | None) -> WindTorque | None:
    """Returns the ``wind`` torque where it is resolved and the effect, which it follows from, is identifiable.

    ``physical`` are the parameters of the same flight.
    """
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
    words = {"effect": "control effectiveness", "damping": "rate damping", "lag": "motor time constant"}
    if doubtful := [words[name] for name, status in physical.status.items() if status != "reported"]:
        followed = f"{words['effect']}, {words['damping']} and {words['lag']}"
        return LIMITED, f"It follows from {followed}: {' and '.join(doubtful)} not well known."
    half = quantile() * wind.scale_error
    return _grade("wind", half), f"Its standard deviation is known to ±{100 * half:.0f} %."


def _prediction(held_out: HeldOut) -> tuple[Grade, str]:
    limits, best = PREDICTION_LIMITS, held_out.best_baseline
    ratio, worse = held_out.error_ratio() / held_out.error_ratio(best), float((held_out.error_ratios() > 1).mean())
    shown = (
        f"{ratio:.2g} times the squared error of “{best}”" if isfinite(ratio) else "No model of a part could be learned"
    )
    among = f"in {100 * worse:.0f} % of {len(held_out)} windows" if len(held_out) > 1 else f"in {worse:.0f} of 1 window"
    reason = f"{shown}; worse than the mean {among}."
    if not ratio < 1:
        return NONE, reason
    good = len(held_out) >= limits.windows and ratio <= limits.ratio and worse <= limits.worse
    return (GOOD if good and held_out.coverage >= limits.coverage else LIMITED), reason


def warnings_of(learned: Learned, held_out: HeldOut | None) -> tuple[str, ...]:
    """Returns what must be known before the model is used, one sentence each; mostly none."""
    warnings, limits = [], PREDICTION_LIMITS
    if held_out is not None:
        warnings += [f"No model of a part of the flight could be learned: {failure}." for failure in held_out.failures]
        if held_out.coverage < limits.coverage:
            few = len(held_out) < limits.windows
            advice = "of so few windows it may be chance" if few else "do not rely on it"
            warnings.append(f"The 90 % band held {100 * held_out.coverage:.0f} % of the held-out samples: {advice}.")
        if held_out.over_expected > limits.over_expected:
            warnings.append(
                f"Forecasts had {held_out.over_expected:.1f} times the squared error that was to be expected: the "
                "flight changed, or the model is wrong."
            )
    if not learned.stable:
        warnings.append("The model is unstable: long forecasts grow without bound.")
    return tuple(warnings)


def next_step(found: Sequence[Finding]) -> str:
    """Returns what to do next, by what was ``found``: the first purpose that is not served decides."""
    grades = {finding.purpose: finding.grade for finding in found}
    effect, motion, _, prediction = (grades.get(purpose, GOOD) for purpose in PURPOSES)
    if effect != GOOD or motion == NONE:
        return (
            "Fly half a minute of quick small movements on this axis in calm air (docs/manoeuvres.md), and learn from "
            "that: the motors must move more than the wind makes them."
        )
    if motion != GOOD:
        return (
            "Fly such movements for longer, at a higher rate if the log allows it: rate damping and motor time "
            "constant need both."
        )
    if prediction == NONE:
        return "`mavdem compare` with this log shows whether another method predicts it better."
    return "Keep this as the vehicle's reference; `--axis all` has pitch and yaw."
