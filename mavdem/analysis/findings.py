"""Findings: what a flight's model is good for, purpose by purpose, each with the reason."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Literal, NamedTuple

from scipy.stats import norm

from mavdem.dem import Learned, Physical, WindTorque
from mavdem.dem.validation import LEVEL
from mavdem.evaluate.held_out import HeldOut

Grade = Literal["GOOD", "LIMITED", "NOT IDENTIFIABLE"]
GOOD: Grade = "GOOD"
LIMITED: Grade = "LIMITED"
NONE: Grade = "NOT IDENTIFIABLE"

EFFECT_ERROR = 0.15  # half width of the interval over the estimate, up to which the motors' effect is good
MOTION_ERROR = 1 / 3  # likewise of damping and lag, which matter less and are harder to identify
WIND_ERROR = 0.25  # likewise of the wind's standard deviation
GOOD_RATIO = 0.5  # of the squared error of the better baseline
MOST_WORSE = 0.1  # share of the windows that may be worse than the constant mean
LEAST_COVERAGE = 0.75  # of a 90 % band
MOST_OVER_EXPECTED = 3.0  # squared error over the one to expect
FEWEST_WINDOWS = 5  # from which on a prediction may be good: where in a flight a single one is decides its error


class Finding(NamedTuple):
    """A ``purpose``, whether the model serves it, and why: one sentence with the figures that decide."""

    purpose: str
    grade: Grade
    reason: str


def findings(learned: Learned, held_out: HeldOut | None) -> tuple[Finding, ...]:
    """Motor effectiveness, damping and lag, wind and, where ``held_out`` windows were forecast, prediction."""
    read, why_not = learned.physical, learned.physical_reason
    found = [_effect(read, why_not), _motion(read, why_not), _wind(learned)]
    if held_out is not None:
        found.append(_prediction(held_out))
    return tuple(
        Finding(purpose, grade, _first_sentence(reason))
        for purpose, (grade, reason) in zip(PURPOSES, found, strict=False)
    )


def _first_sentence(text: str) -> str:
    return text.split(". ")[0].rstrip(".") + "."


PURPOSES = ("motor effectiveness", "damping and lag", "wind", "prediction")


def _effect(read: Physical | None, why_not: str) -> tuple[Grade, str]:
    if read is None:
        return NONE, why_not
    if read.status["effect"] != "reported":
        return (NONE if read.status["effect"] == "not identifiable" else LIMITED), read.reasons["effect"]
    mean, half = read.mean_effect(LEVEL)
    grade = GOOD if half <= EFFECT_ERROR * mean else LIMITED
    return grade, f"Known to ±{100 * half / mean:.0f} %."


def _motion(read: Physical | None, why_not: str) -> tuple[Grade, str]:
    if read is None:
        return NONE, why_not
    _, damping, lag, _ = read.interval(LEVEL)
    known = {
        name: half / value
        for name, value, half in (("damping", read.damping, damping), ("lag", read.lag, lag))
        if value
    }
    status = [read.status[name] for name in ("damping", "lag")]
    if status.count("not identifiable") == len(status):
        reason = read.reasons["damping"] or read.reasons["lag"]
        same = _first_sentence(reason) == _first_sentence(read.reasons["effect"])
        return NONE, "For the same reason as motor effectiveness." if same else reason
    shown = ", ".join(f"{name} to ±{100 * share:.0f} %" for name, share in known.items() if isfinite(share))
    why: dict[str, list[str]] = {}
    for name, found in zip(("damping", "lag"), status, strict=True):
        if found != "reported":
            why.setdefault(_first_sentence(read.reasons[name]).rstrip("."), []).append(f"{name} {found}")
    reason = f"Known: {shown}" if shown else "Known: nothing"
    reason += "".join(f"; {' and '.join(names)}: {sentence}" for sentence, names in why.items())
    good = status == ["reported"] * 2 and all(share <= MOTION_ERROR for share in known.values())
    return (GOOD if good else LIMITED), reason


def known_wind(found: WindTorque | None, read: Physical | None) -> WindTorque | None:
    """The wind's torque where it is resolved, and the motors' effect, which it follows from, is identifiable."""
    if found is None or found.reason is not None or read is None or not read.identifiable:
        return None
    return found


def _wind(learned: Learned) -> tuple[Grade, str]:
    found, read = learned.wind, learned.physical
    if found is None or read is None:
        return NONE, learned.physical_reason
    if not read.identifiable:
        # The torque of the wind is what is left when that of the motors is taken away.
        return NONE, "It follows from the motors' effect, which is not identifiable."
    if found.reason is not None:
        return NONE, found.reason
    half = float(norm.ppf(0.5 + LEVEL / 2)) * found.scale_error
    doubtful = [name for name, status in read.status.items() if status != "reported"]
    if doubtful:
        return LIMITED, f"It follows from the motors' effect, damping and lag: {' and '.join(doubtful)} not well known."
    return (GOOD if half <= WIND_ERROR else LIMITED), f"Its standard deviation is known to ±{100 * half:.0f} %."


def _prediction(held_out: HeldOut) -> tuple[Grade, str]:
    best = held_out.best_baseline
    ratio, worse = held_out.error_ratio() / held_out.error_ratio(best), float((held_out.error_ratios() > 1).mean())
    shown = (
        f"{ratio:.2g} times the squared error of “{best}”" if isfinite(ratio) else "No model of a part could be learnt"
    )
    few = len(held_out) < FEWEST_WINDOWS
    among = f"in {100 * worse:.0f} % of {len(held_out)} windows" if len(held_out) > 1 else f"in {worse:.0f} of 1 window"
    reason = f"{shown}; worse than the mean {among}."
    if not ratio < 1:
        return NONE, reason
    good = not few and ratio <= GOOD_RATIO and worse <= MOST_WORSE and held_out.coverage >= LEAST_COVERAGE
    return (GOOD if good else LIMITED), reason


def warnings_of(learned: Learned, held_out: HeldOut | None) -> tuple[str, ...]:
    """What must be known before the model is used, one sentence each; mostly none.

    Bands that failed and errors beyond what was to be expected, in ``held_out`` windows; or a ``learned`` model that is
    unstable.
    """
    found = []
    if held_out is not None:
        found += [f"No model of a part of the flight could be learnt: {failure}." for failure in held_out.failures]
        if held_out.coverage < LEAST_COVERAGE:
            advice = "do not rely on it" if len(held_out) >= FEWEST_WINDOWS else "of so few windows it may be chance"
            found.append(f"The 90 % band held {100 * held_out.coverage:.0f} % of the held-out samples: {advice}.")
        if held_out.over_expected > MOST_OVER_EXPECTED:
            found.append(
                f"Forecasts had {held_out.over_expected:.1f} times the squared error that was to be expected: the "
                "flight changed, or the model is wrong."
            )
    if not learned.stable:
        found.append("The model is unstable: long forecasts grow without bound.")
    return tuple(found)


def limited_by(found: Sequence[Finding], reason: str) -> tuple[Finding, ...]:
    """The same, with at most LIMITED, for that ``reason``, what was GOOD of the vehicle and the wind."""
    of_vehicle = PURPOSES[:3]
    return tuple(
        one._replace(grade=LIMITED, reason=reason) if one.purpose in of_vehicle and one.grade == GOOD else one
        for one in found
    )


def next_step(found: Sequence[Finding]) -> str:
    """What to do next, one sentence, by what was ``found``: the first purpose that is not served decides."""
    grades = {one.purpose: one.grade for one in found}
    effect, motion, _, prediction = (grades.get(purpose, GOOD) for purpose in PURPOSES)
    if effect != GOOD or motion == NONE:
        return (
            "Fly half a minute of quick small movements on this axis in calm air (docs/manoeuvres.md), and learn from "
            "that: the motors must move more than the wind makes them."
        )
    if motion != GOOD:
        return "Fly such movements for longer, at a higher rate if the log allows it: damping and lag need both."
    if prediction == NONE:
        return "`mavdem compare` with this log shows whether another method predicts it better."
    return "Keep this as the vehicle's reference; `--axis all` has pitch and yaw."
