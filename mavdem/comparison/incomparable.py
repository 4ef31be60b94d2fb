"""What of two states of a vehicle cannot be compared, and why not."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from mavdem.comparison.flight_figures import AXIS_ORDER, FlightFigures
from mavdem.comparison.vehicle_estimates import DAMPING, EFFECT, LAG, MEAN_EFFECT, SHARE, FlightEstimate, Quantity

Flights = Sequence[Sequence[FlightFigures]]
SIDES = ("A", "B")
TILT_AXES = [*AXIS_ORDER][:2]
OF_MODELS = (EFFECT, MEAN_EFFECT, DAMPING, LAG)
"""Quantities that belong to a model, and with it to its inputs."""


def other_kinds(before: Flights, after: Flights) -> str:
    """Why nothing of the two can be compared; empty where something can."""
    for side, flights in zip(SIDES, (before, after), strict=True):
        if not flights:
            return f"{side} has no flight with figures."
    counts = [
        sorted({len(row.motors) for flight in flights for row in flight if row.motors}) for flights in (before, after)
    ]
    if all(counts) and counts[0] != counts[1]:
        return f"A has {_spoken(counts[0])} motors and B {_spoken(counts[1])}: these are other vehicles."
    units = [
        {row.trim_unit for flight in flights for row in flight if row.trim_unit is not None}
        for flights in (before, after)
    ]
    frames = [{row.frame for flight in flights for row in flight if row.frame} for flights in (before, after)]
    if all(frames) and not frames[0] & frames[1]:
        return f"A is a {_spoken(frames[0])} and B a {_spoken(frames[1])}: these are other vehicles."
    if all(units) and not units[0] & units[1]:
        return "The motors' outputs are logged in other units: learn both from the same kind of log."
    return ""


def other_inputs(before: Flights, after: Flights) -> str:
    """Why nothing that belongs to models can be compared: they are driven by other inputs; empty if by the same."""
    with_model = [row for flights in (before, after) for flight in flights for row in flight if row.effect]
    if len({row.inputs for row in with_model} - {None}) > 1:
        return "some models have the motors as inputs and others the controller's demand."
    if len({row.input_unit for row in with_model} - {None}) > 1:
        return "the models' inputs have other units."
    return ""


def why_not(
    sides: Sequence[Flights], estimates: Sequence[Sequence[Mapping[Quantity, FlightEstimate]]]
) -> list[tuple[str, str]]:
    """What is missing on either side, by name, each with its reason."""
    if reason := other_kinds(*sides):
        return [("everything", reason)]
    found = []
    refused = other_inputs(*sides)
    if refused:
        found.append(("effects, damping and lag", refused))
    for kind, name in ((SHARE, "motors' shares"), (EFFECT, "motors' effects")):
        if not (refused and kind in OF_MODELS) and not _common(estimates, kind, ""):
            found.append((name, _reason(kind, sides, estimates, "")))
    for kind in () if refused else (DAMPING, LAG):
        for axis in TILT_AXES:
            if not _common(estimates, kind, axis):
                found.append((f"{kind} on {axis}", _reason(kind, sides, estimates, axis)))
    return found


def _common(estimates: Sequence[Sequence[Mapping[Quantity, FlightEstimate]]], kind: str, axis: str) -> set[Quantity]:
    """The quantities of a kind, on an axis or on any, that both sides have."""
    before, after = ({quantity for one in side for quantity in one} for side in estimates)
    return {one for one in before & after if one.kind == kind and axis in ("", one.axis)}


def _reason(
    kind: str, sides: Sequence[Flights], estimates: Sequence[Sequence[Mapping[Quantity, FlightEstimate]]], axis: str
) -> str:
    """Of the sides that lack it."""
    reasons = []
    for side, flights, known in zip(SIDES, sides, estimates, strict=True):
        if any(one.kind == kind and axis in ("", one.axis) for found in known for one in found):
            continue
        rows = [row for flight in flights for row in flight if axis in ("", row.axis)]
        tiers = sorted({row.tier for row in rows if row.tier})
        statuses = {getattr(row, f"{kind}_status", None) for row in rows}
        if not rows:
            reasons.append(f"{side} has no figures of {axis}")
        elif kind == SHARE:
            without = any(row.trim_share for row in rows)
            missing = (
                "too little flight for the interval of its shares" if without else "no motor outputs of known range"
            )
            reasons.append(f"{side} has {missing}")
        elif known_not := [status for status in ("biased", "not identifiable") if status in statuses]:
            reasons.append(f"{_spoken(known_not)} in {side}")
        elif tiers and "a" not in tiers:
            reasons.append(f"{side} is of tier {_spoken(tiers)}; this needs tier a, 40 Hz or more")
        else:
            reasons.append(f"not estimated in {side}, or too uncertain there")
    return f"{'; '.join(reasons) or 'each side has others'}."


def _spoken(values: Iterable[object]) -> str:
    return " or ".join(map(str, sorted(values, key=str)))
