"""The report of a difference between two states of a vehicle: what changed, what is the same, what cannot be said."""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees, hypot
from pathlib import PurePath

from mavdem.comparison.flight_figures import NAMELESS
from mavdem.comparison.vehicle_difference import (
    BETWEEN,
    FAMILY_ERROR,
    Conditions,
    QuantityChange,
    SinceBaseline,
    VehicleDifference,
)
from mavdem.comparison.vehicle_estimates import DAMPING, EFFECT, LAG, MEAN_EFFECT, SHARE
from mavdem.report.blocks import Block, Sentence
from mavdem.report.numbers import listed, plus_minus, readable, rounded, short

ALLOWED = {SHARE: "those of shares for the lean", MEAN_EFFECT: "those of mean effects for battery and mean output"}
"""Which intervals allow for which conditions."""
MIN_LEAN, MIN_SHARE = 2.0, 0.02  # degrees, and share of a voltage or output, from which a difference is reported


def difference_blocks(found: VehicleDifference) -> list[Block]:
    """All of it, in sentences: changed, the same, uncertain, not comparable, conditions, and how sure that is."""
    return [
        *change_blocks(found),
        *_uncertain(found),
        *_incomparable(found),
        *_conditions(found),
        *_vehicles(found),
        *([Sentence(_sureness(found), "How sure:")] if found.changes else []),
    ]


def change_blocks(found: VehicleDifference) -> list[Block]:
    """What changed and what is the same."""
    if not found.changes:
        return [Sentence("", "Nothing can be compared.")]
    changed, same = found.of("changed"), found.of("same")
    blocks: list[Block] = []
    if changed:
        blocks.append(Sentence(f"{'; '.join(_change(one, found) for one in changed)}.", "Changed:"))
    else:
        blocks.append(Sentence("", "Nothing changed beyond chance."))
    if same:
        blocks.append(Sentence(f"{listed(_grouped(same, found))}.", "The same:"))
    return blocks


def _incomparable(found: VehicleDifference) -> list[Block]:
    """Each reason once, with what it is of."""
    names: dict[str, list[str]] = {}
    for name, reason in found.incomparable:
        names.setdefault(reason, []).append(name)
    return [Sentence(f"{listed(those)}: {reason}", "Not compared:") for reason, those in names.items()]


def _uncertain(found: VehicleDifference) -> list[Block]:
    """What was compared without a result, with what was found."""
    changes = [_change(one, found) for one in found.of("uncertain")]
    text = f"{'; '.join(changes)}: too uncertain to call changed or the same."
    return [Sentence(text, "Not known:")] if changes else []


def baseline_blocks(since: SinceBaseline) -> list[Block]:
    """What differs between a vehicle's latest flight and its flights of the baseline."""
    lead = "Since the baseline:"
    if since.found is None:
        return [Sentence("the baseline has no flight of this vehicle.", lead)]
    name = PurePath(since.file).name
    when = "" if since.date is None else f" ({since.date:%Y-%m-%d})"
    latest = Sentence(f"the latest flight, {name}{when}, beside {_flights(since.found.flights[0])}.", lead)
    return [latest, *change_blocks(since.found), *_uncertain(since.found), *_vehicles(since.found)]


def _change(one: QuantityChange, found: VehicleDifference) -> str:
    """As in "motor 3's effect −18 % ± 6 %"."""
    kind, _, _ = one.quantity
    name = _name(one, found)
    if kind in (SHARE, EFFECT, MEAN_EFFECT):
        return f"{name} {_percent(one.difference, one.half_width)}"
    scale, unit = (1.0, "1/s") if kind == DAMPING else (1e3, "ms")
    assert one.before is not None and one.after is not None
    values = f"{rounded(scale * one.before)} → {rounded(scale * one.after)} {unit}"
    return f"{name} {values} ({_signed(plus_minus(scale * one.difference, scale * one.half_width))})"


def _name(one: QuantityChange, found: VehicleDifference) -> str:
    kind, motor, axis = one.quantity
    if motor:
        name = short(found.motors[motor - 1]) if motor <= len(found.motors) else f"motor {motor}"
        return f"{name}'s {kind}"
    return f"{kind} on {axis}"


def _grouped(changes: Sequence[QuantityChange], found: VehicleDifference) -> list[str]:
    """Names with the widest half width, those of motors together: "the shares of motors 1, 2 and 4 (± 2 %)"."""
    words = []
    for kind in (SHARE, EFFECT):
        ours = [one for one in changes if one.quantity.kind == kind]
        if ours:
            motors = listed(one.quantity.motor for one in ours)
            width = 100 * max(one.half_width for one in ours)
            plural = "s" * (len(ours) > 1)
            words.append(f"the {kind}{plural} of motor{plural} {motors} (± {rounded(width)} %)")
    for one in changes:
        kind = one.quantity.kind
        if kind in (MEAN_EFFECT, DAMPING, LAG):
            scale, unit = {MEAN_EFFECT: (100.0, "%"), DAMPING: (1.0, "1/s"), LAG: (1e3, "ms")}[kind]
            words.append(f"{_name(one, found)} (± {rounded(scale * one.half_width)} {unit})")
    return words


def _percent(difference: float, half: float) -> str:
    decimals = 0 if 100 * half >= 3 else 1
    return f"{_signed(f'{100 * difference:.{decimals}f}')} % ± {100 * half:.{decimals}f} %"


def _signed(number: str) -> str:
    return number.replace("-", "−") if number.startswith(("-", "(-")) else f"+{number}"


def _conditions(found: VehicleDifference) -> list[Block]:
    """How A and B were flown, which is no change of the vehicle."""
    one, other = found.conditions
    words = [*_battery(one, other), *_lean(one, other), *_wind(one, other)]
    if not words:
        return []
    kinds = {change.quantity.kind for change in found.changes if change.allowance}
    covered = [words for kind, words in ALLOWED.items() if kind in kinds]
    allowed = f" Intervals that allow for conditions: {' and '.join(covered)}." if covered else ""
    return [Sentence(f"{'; '.join(words)}.{allowed}", "Conditions, no change of the vehicle:")]


def _battery(one: Conditions, other: Conditions) -> list[str]:
    words = []
    if one.voltage and other.voltage:
        words.append(f"battery {one.voltage:.1f} → {other.voltage:.1f} V")
    else:
        words.append("battery not logged in both")
    if one.collective and other.collective:
        change = other.collective / one.collective - 1
        if abs(change) < MIN_SHARE:
            words.append("the motors' mean output the same")
        else:
            words.append(
                f"the motors' mean output {100 * change:+.0f} % (payload, battery or climbing)".replace("-", "−")
            )
    return words


def _lean(one: Conditions, other: Conditions) -> list[str]:
    if None in (one.lean_roll, one.lean_pitch, other.lean_roll, other.lean_pitch):
        return ["lean not known in both"]
    roll, pitch = (
        degrees((after or 0.0) - (before or 0.0))
        for before, after in ((one.lean_roll, other.lean_roll), (one.lean_pitch, other.lean_pitch))
    )
    if hypot(roll, pitch) < MIN_LEAN:
        return ["lean the same"]
    return [f"another lean: {roll:+.0f}° of roll and {pitch:+.0f}° of pitch (wind, or flown forward)".replace("-", "−")]


def _wind(one: Conditions, other: Conditions) -> list[str]:
    unit = readable("rad/s²")
    words = []
    for axis in one.wind_torque.keys() & other.wind_torque.keys():
        before, after = (unit.scale * state.wind_torque[axis] for state in (one, other))
        words.append(f"wind's torque on {axis} {rounded(before)} → {rounded(after)} {unit.name}")
    return sorted(words, reverse=True)  # roll first


def _vehicles(found: VehicleDifference) -> list[Block]:
    before, after = found.vehicles
    if NAMELESS in (*before, *after):
        return [
            Sentence("a log does not say of which vehicle it is; that both are the same is taken on trust.", "Vehicle:")
        ]
    if before and after and set(before) != set(after):
        text = f"A is {listed(before)} and B is {listed(after)}: what differs may be that between two vehicles."
        return [Sentence(text, "Caution:")]
    if found.shared:
        text = (
            f"{listed(found.shared)} is a name by the MAVLink system id, which many vehicles share; that A and B are "
            "of one vehicle is taken on trust."
        )
        return [Sentence(text, "Caution:")]
    return []


def _sureness(found: VehicleDifference) -> str:
    """What the statements rest on."""
    words = (
        f"± are 90 % intervals. {len(found.changes)} quantities are tested together (Holm): that any is called changed "
        f"when none did has a chance of at most {100 * FAMILY_ERROR:.0f} %, as far as the intervals hold."
    )
    if max(found.flights) == 1:
        return (
            f"{words} A and B are one flight each, and their intervals those of one flight each: how much a flight "
            f"differs from the next is assumed (a share by {100 * BETWEEN[SHARE]:.0f} %, an effect by "
            f"{100 * BETWEEN[EFFECT]:.0f} %), not measured. Track several flights of each to measure it."
        )
    before, after = map(_flights, found.flights)
    return f"{words} {before} of A and {after} of B show how much flights differ."


def _flights(count: int) -> str:
    return f"{count} flight{'' if count == 1 else 's'}"
