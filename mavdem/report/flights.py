"""What is said of many flights: which vehicles need a look, and what changed between two states of one.

``fleet_blocks`` is the summary of a fleet; ``difference_blocks`` what changed, what is the same, what cannot be said.
``live_report`` says how well a live flight was predicted, ``truth_blocks`` how estimates compare with a truth file.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from math import degrees, hypot, isfinite, sqrt
from pathlib import PurePath

import numpy as np

from mavdem.evaluate.truth import ComparedParameter, TruthComparison
from mavdem.facts import Fact, Level
from mavdem.facts.fleet import Outcome
from mavdem.facts.identifiability import Status
from mavdem.facts.motors import MotorHealth
from mavdem.facts.session import Session, Spent
from mavdem.fleet import difference
from mavdem.fleet import row as fleet_row
from mavdem.fleet.difference import (
    BETWEEN,
    FAMILY_ERROR,
    Conditions,
    Flights,
    QuantityChange,
    VehicleDifference,
)
from mavdem.fleet.row import HEALTHS, OK, UNKNOWN, FlightRow, is_shared, worst_health
from mavdem.health.in_flight import FALSE_ALARMS
from mavdem.live.history import AHEAD, HorizonErrors, LiveHistory, SessionStatus
from mavdem.report.blocks import Block, Rated, Sentence, Table, caution
from mavdem.report.condition import TIER_WORDS
from mavdem.report.numbers import (
    TORQUE,
    few,
    listed,
    named,
    plus_minus,
    readable,
    rounded,
    short,
    with_unit,
)
from mavdem.report.words import advised, begin

TROUBLE = HEALTHS[:2]
LEVELS = {
    MotorHealth.FAULT: Level.BAD,
    MotorHealth.DRIFT: Level.WATCH,
    MotorHealth.OK: Level.GOOD,
    MotorHealth.UNKNOWN: Level.UNKNOWN,
}
"""The level by which the health of motors is shown."""
MAX_REASONS = 8  # rows of logs that could not be used
QUANTITIES = {  # what a kind of quantity is called, and the scale and unit that it is shown in
    difference.SHARE: ("share", 100.0, "%"),
    difference.EFFECT: ("control effectiveness", 100.0, "%"),
    difference.MEAN_EFFECT: ("mean control effectiveness", 100.0, "%"),
    difference.DAMPING: ("rate damping", 1.0, "1/s"),
    difference.LAG: ("motor time constant", 1e3, "ms"),
}


def fleet_blocks(rows: Sequence[FlightRow]) -> list[Block]:
    """Returns the summary of a fleet: a headline, what was flown, and why logs could not be used."""
    vehicles = fleet_row.vehicles_of(rows)
    named = {name: flights for name, flights in vehicles.items() if is_one_vehicle(name, flights)}
    once = {
        name: fleet_row.flown_once(flights)
        for name, flights in named.items()
        if not is_shared(flights)
    }
    flown = [flight for name in vehicles for flight in once.get(name, vehicles[name])]
    blocks: list[Block] = [Sentence("", _headline(named, flown))]
    if flown:
        twice = sum(len(vehicles[name]) - len(once[name]) for name in once)
        blocks.append(Sentence(_flown(len(once), flown, twice), "Flown:"))
    waiting = [name for name, flights in named.items() if vehicle_health(flights) == UNKNOWN]
    if waiting and len(waiting) < len(named):
        blocks.append(
            Sentence(
                f"{_counted(len(waiting), 'vehicle')}, for the reason that each gives.",
                "Not judged:",
            )
        )
    if nameless := sum(len(flights) for name, flights in vehicles.items() if name not in named):
        text = "whose logs do not name a vehicle, or only by a system id; they are not compared."
        blocks.append(Sentence(f"{_counted(nameless, 'flight')} {text}", "Without a name:"))
    return blocks + _unused(
        [flight[0] for flight in fleet_row.flights_of(row for row in rows if row.status != OK)]
    )


def is_one_vehicle(name: str, flights: Flights) -> bool:
    """Returns whether these are a vehicle's: of a system id, which many share, only if they were judged as such."""
    return name != UNKNOWN and (not is_shared(flights) or vehicle_health(flights) != UNKNOWN)


def vehicle_health(flights: Flights) -> str:
    """Returns what was found in a vehicle's latest flight that was judged; "unknown" if none was."""
    return next(
        (health for flight in reversed(flights) if (health := worst_health(flight)) != UNKNOWN),
        UNKNOWN,
    )


def had_trouble(flights: Flights) -> bool:
    """Returns whether any flight showed a fault or a drift."""
    return any(worst_health(flight) in TROUBLE for flight in flights)


def doubt(flights: Flights) -> str:
    """Returns what overrides all else in a vehicle's latest flight, as an oscillation; empty where nothing does."""
    return next((row.headline or "" for row in flights[-1] if row.overrides), "")


def urgency(flights: Flights) -> tuple[float, float]:
    """Returns by what vehicles are sorted: the worst first, of these the one with the newest flight."""
    worst = HEALTHS.index(vehicle_health(flights))
    newest = flights[-1][0].date
    return min(worst, 1.5) if doubt(flights) else worst, -newest.timestamp() if newest else 0.0


def vehicle_name(name: str, flights: Flights) -> str:
    """Returns a name to read: beside the number of a board what vehicle it is, and its firmware."""
    known = listed(filter(None, (flights[-1][0].frame, flights[-1][0].firmware)))
    return f"{name} [{known}]" if known and flights[-1][0].vehicle_basis == "board" else name


def conclusion(flights: Flights) -> str:
    """Returns what one vehicle's latest flight that was judged shows, in a sentence."""
    if (health := vehicle_health(flights)) not in TROUBLE:
        seen = next((row.headline for row in flights[-1] if row.headline), "Not judged yet.")
        if health == OK:
            seen = (
                f"No drift and no fault{' in its latest flight' if had_trouble(flights) else ''}."
            )
        return doubt(flights) or seen
    rows = next(flight for flight in reversed(flights) if worst_health(flight) == health)
    motor = next((row.suspect_motor for row in rows if row.suspect_motor is not None), None)
    what = f"Motor {motor}: {health}" if motor else health.capitalize()
    sure = next((row.fault_probability for row in rows if row.fault_probability is not None), None)
    return f"{what}{'' if sure is None else f', probability of a fault {sure:.2f}'}. {doubt(flights)}".strip()


def vehicle_words(flights: Flights) -> str:
    """Returns what was found of one vehicle, in a sentence or two."""
    counts = Counter(map(worst_health, flights))
    name = (
        " The name is a system id, which many vehicles share: these may be several."
        if is_shared(flights)
        else ""
    )
    if not had_trouble(flights):
        if counts[OK]:
            return f"No drift and no fault in {_counted(counts[OK], 'flight')} that could be judged.{name}"
        reason = next(
            (
                row.health_reason
                for flight in reversed(flights)
                for row in flight
                if row.health_reason
            ),
            "",
        )
        return f"Not judged{': ' + reason if reason else '.'}"
    kinds = [f"a {kind} in {counts[kind]}" for kind in TROUBLE if counts[kind]]
    latest = next(flight for flight in reversed(flights) if worst_health(flight) in TROUBLE)
    row = min(latest, key=lambda row: HEALTHS.index(row.health))
    log = PurePath(row.file).name
    when = log if row.date is None else f"{row.date:%Y-%m-%d} ({log})"
    motor = "" if row.suspect_motor is None else f", motor {row.suspect_motor}"
    if motor and row.fault_probability is not None:
        # The row has the probability of any fault, not that of this motor.
        motor += f" (probability of a fault {row.fault_probability:.2f})"
    reason = f": {row.health_reason}" if row.health_reason else "."
    last = " The latest flight that was judged shows none." if vehicle_health(flights) == OK else ""
    return f"Of {_counted(len(flights), 'flight')} {listed(kinds)}. The latest: {when}{motor}{reason}{last}{name}"


def _headline(named: Mapping[str, Flights], flown: Flights) -> str:
    if not flown:
        return "No log holds a flight that could be used."
    healths = {name: vehicle_health(flights) for name, flights in named.items()}
    recovered = sorted(name for name in named if healths[name] == OK and had_trouble(named[name]))
    earlier = (
        f" Trouble in earlier flights, and not in the latest: {few(recovered)}."
        if recovered
        else ""
    )
    ill = [
        name
        for name in sorted(named, key=lambda name: (urgency(named[name]), name))
        if urgency(named[name])[0] < 2
    ]
    if ill:
        words = []
        for name in ill:
            latest = next(
                (flight for flight in reversed(named[name]) if worst_health(flight) != UNKNOWN), ()
            )
            suspects = sorted(
                {row.suspect_motor or 0 for row in latest if row.health == healths[name]} - {0}
            )
            found = [healths[name]] * (healths[name] in TROUBLE) + [
                f"motor {listed(suspects)}"
            ] * bool(suspects)
            found += filter(None, [doubt(named[name]).rstrip(".")])
            words.append(f"{vehicle_name(name, named[name])} ({', '.join(found)})")
        needs = "needs" if len(ill) == 1 else "need"
        return f"{len(ill)} of {_counted(len(named), 'vehicle')} {needs} a look: {few(words)}.{earlier}"
    if judged := sum(health == OK for health in healths.values()):
        which = "the latest flights of " if earlier else ""
        return f"No drift and no fault in {which}{_counted(judged, 'vehicle')} that could be judged.{earlier}"
    return "No vehicle could be judged yet."


def _flown(vehicles: int, flown: Flights, twice: int) -> str:
    hours = (
        sum(max((row.duration or 0.0 for row in flight), default=0.0) for flight in flown) / 3600
    )
    dates = sorted(flight[0].date for flight in flown if flight[0].date is not None)
    tiers = Counter(map(fleet_row.best_tier, flown))
    when = f", {dates[0]:%Y-%m-%d} to {dates[-1]:%Y-%m-%d}" if dates else ""
    kinds = listed(f"{tiers[tier]} {words}" for tier, words in TIER_WORDS.items() if tiers[tier])
    vehicle = f" of {_counted(vehicles, 'vehicle')}" if vehicles else ""
    have = "has a flight" if twice == 1 else "have flights"
    again = f" ({_counted(twice, 'more log')} {have} of these)" if twice else ""
    return f"{_counted(len(flown), 'flight')}{vehicle}{again}{when}, {hours:.2g} h settled; {kinds or 'no tier known'}."


def _unused(refused: Sequence[FlightRow]) -> list[Block]:
    """Why logs could not be used, the most frequent reason first."""
    if not refused:
        return []
    examples: dict[str, list[str]] = {}
    codes = dict[str | None, str]()
    for row in refused:
        # What the first one says, without the numbers that make each reason different.
        first = re.split(r"(?<=[.:;]) ", row.status, maxsplit=1)[0]
        said = re.sub(r"\d[\d.,]*", "…", first).rstrip(".:; ")
        reason = (
            said if row.status_code in (None, "prose") else codes.setdefault(row.status_code, said)
        )
        examples.setdefault(reason, []).append(PurePath(row.file).name)
    reasons = sorted(examples, key=lambda reason: (-len(examples[reason]), reason))
    shown = reasons if len(reasons) <= MAX_REASONS else reasons[: MAX_REASONS - 1]
    cells = [
        [cut(reason, 140), str(len(examples[reason])), cut(examples[reason][0], 60)]
        for reason in shown
    ]
    if others := sum(len(examples[reason]) for reason in reasons[len(shown) :]):
        cells.append(["other reasons: see the table of flights", str(others), ""])
    said = f"{_counted(len(refused), 'log')}; nothing else is said of {'it' if len(refused) == 1 else 'them'}."
    return [
        Sentence(said, "Not used:"),
        Table(["reason", "logs", "for example"], cells, words=True),
    ]


def cut(text: str, longest: int) -> str:
    """Returns the text, shortened to so many letters."""
    return text if len(text) <= longest else f"{text[: longest - 1]}…"


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def difference_blocks(found: VehicleDifference) -> list[Block]:
    """Returns what changed, the same, uncertain, not comparable, conditions, and how sure that is, in sentences."""
    reasons: dict[Fact, list[Fact]] = {}
    for name, reason in found.incomparable:
        reasons.setdefault(reason, []).append(name)
    missing = [
        Sentence(f"{listed(names)}: {reason}", "Not compared:") for reason, names in reasons.items()
    ]
    words = "; ".join(_condition_words(*found.conditions)).replace("-", "−")
    covered = "shares for the lean and mean control effectiveness for battery and mean output"
    allowed = f" Intervals that allow for conditions: {covered}." * any(
        change.allowance for change in found.changes
    )
    conditions = Sentence(f"{words}.{allowed}", "Conditions, not changes of the vehicle:")
    blocks = [*_changes(found), *missing, conditions, *_vehicles(found)]
    if found.changes:
        before, after = (_counted(count, "flight") for count in found.flights)
        basis = f"{before} of A and {after} of B show how much flights differ."
        if max(found.flights) == 1:
            share, effect = (
                f"{100 * BETWEEN[kind]:.0f} %" for kind in (difference.SHARE, difference.EFFECT)
            )
            basis = (
                "A and B are single flights: how much one flight differs from the next is assumed (a share by "
                f"{share}, a control effectiveness by {effect}). Track several flights of each to measure it."
            )
        text = f"± are 90 % intervals. {len(found.changes)} quantities are tested together (Holm): if none changed, "
        text += f"the chance that any is called changed is at most {100 * FAMILY_ERROR:.0f} %."
        blocks.append(Sentence(f"{text} {basis}", "How sure:"))
    return blocks


def baseline_blocks(latest: FlightRow, found: VehicleDifference | None) -> list[Block]:
    """Returns what differs between a vehicle's ``latest`` flight and its flights of the baseline."""
    lead = "Since the baseline:"
    if found is None:
        return [Sentence("the baseline has no flight of this vehicle.", lead)]
    when = "" if latest.date is None else f" ({latest.date:%Y-%m-%d})"
    text = f"the latest flight, {PurePath(latest.file).name}{when}, beside {_counted(found.flights[0], 'flight')}."
    return [Sentence(text, lead), *_changes(found), *_vehicles(found)]


def _changes(found: VehicleDifference) -> list[Block]:
    """What changed, what is the same, and what was compared without a result."""
    if not found.changes:
        return [Sentence("", "Nothing can be compared.")]
    changed, unknown = (
        "; ".join(_change(one, found) for one in found.of(kind))
        for kind in (Outcome.CHANGED, Outcome.UNCERTAIN)
    )
    blocks = [
        Sentence(f"{changed}.", "Changed:")
        if changed
        else Sentence("", "Nothing changed beyond chance.")
    ]
    if same := found.of(Outcome.SAME):
        blocks.append(Sentence(f"{listed(_grouped(same))}.", "The same:"))
    if unknown:
        blocks.append(
            Sentence(f"{unknown}: too uncertain to call changed or the same.", "Not known:")
        )
    return [*blocks]


def _change(change: QuantityChange, found: VehicleDifference) -> str:
    """As in "motor 3's share −18 % ± 6 %"."""
    (kind, motor, axis) = change.quantity
    motors = found.motors
    noun, scale, unit = QUANTITIES[kind]
    name = f"{noun} on {axis}"
    if motor:
        name = f"{short(motors[motor - 1]) if motor <= len(motors) else f'motor {motor}'}'s {noun}"
    more = scale * change.difference
    half = scale * change.half_width
    if change.before is None or change.after is None:
        decimals = 0 if half >= 3 else 1
        return f"{name} {_signed(f'{more:.{decimals}f}')} % ± {half:.{decimals}f} %"
    values = f"{rounded(scale * change.before)} → {rounded(scale * change.after)} {unit}"
    return f"{name} {values} ({_signed(plus_minus(more, half))})"


def _grouped(changes: Sequence[QuantityChange]) -> list[str]:
    """Names with the widest half width, those of motors together: "the shares of motors 1, 2 and 4 (± 2 %)"."""
    words = []
    for kind, ending in ((difference.SHARE, "s"), (difference.EFFECT, "")):
        if ours := [change for change in changes if change.quantity.kind == kind]:
            noun = QUANTITIES[kind][0] + ending * (len(ours) > 1)
            motors = (
                f"motor{'s' * (len(ours) > 1)} {listed(change.quantity.motor for change in ours)}"
            )
            words.append(
                f"the {noun} of {motors} (± {rounded(100 * max(change.half_width for change in ours))} %)"
            )
    for change in changes:
        if not change.quantity.motor:
            noun, scale, unit = QUANTITIES[change.quantity.kind]
            words.append(
                f"{noun} on {change.quantity.axis} (± {rounded(scale * change.half_width)} {unit})"
            )
    return words


def _signed(number: str) -> str:
    return number.replace("-", "−") if number.startswith(("-", "(-")) else f"+{number}"


def _condition_words(before: Conditions, after: Conditions) -> list[str]:
    words = ["battery not logged in both"]
    if before.voltage and after.voltage:
        words = [f"battery {before.voltage:.1f} → {after.voltage:.1f} V"]
    if before.collective and after.collective:
        change = after.collective / before.collective - 1
        more = (
            f"{100 * change:+.0f} % (payload, battery or climbing)"
            if abs(change) >= 0.02
            else "the same"
        )
        words.append(f"the motors' mean output {more}")
    leans = (before.lean_roll, after.lean_roll), (before.lean_pitch, after.lean_pitch)
    roll, pitch = (None if a is None or b is None else degrees(b - a) for a, b in leans)
    if roll is None or pitch is None:
        words.append("lean not known in both")
    elif hypot(roll, pitch) < 2.0:
        words.append("lean the same")
    else:
        words.append(
            f"another lean: {roll:+.0f}° of roll and {pitch:+.0f}° of pitch (wind, or flown forward)"
        )
    # roll first
    for axis in sorted(before.wind_torque.keys() & after.wind_torque.keys(), reverse=True):
        torques = (rounded(TORQUE.scale * state.wind_torque[axis]) for state in (before, after))
        words.append(f"wind torque on {axis} {' → '.join(torques)} {TORQUE.name}")
    return words


def _vehicles(found: VehicleDifference) -> list[Block]:
    before, after = found.vehicles
    trust = "A and B are assumed to be of one vehicle."
    if UNKNOWN in (*before, *after):
        return [Sentence(f"a log does not say of which vehicle it is; {trust}", "Vehicle:")]
    if before and after and set(before) != set(after):
        text = f"A is {listed(before)} and B is {listed(after)}: the difference may be between two vehicles."
        return [caution(text)]
    named = f"{listed(found.shared)} is a name by the MAVLink system id, which many vehicles share; {trust}"
    return [caution(named)] if found.shared else []


def spent_on(kind: Spent) -> Fact:
    """Returns the fact of what seconds of this ``kind`` were."""
    return Fact(Session.SECONDS_SPENT, kind=kind)


def whole_seconds(account: Mapping[Spent, float]) -> dict[Spent, int]:
    """Returns an account in whole seconds, whose sum is that of the account."""
    ends = np.rint(np.cumsum(list(account.values()))).astype(int)
    return dict(zip(account, np.diff(ends, prepend=0).tolist(), strict=True))


def live_report(
    history: LiveHistory,
    status: SessionStatus,
    account: Mapping[Spent, float],
    axis: str,
    seconds: float = 0.0,
) -> list[Block]:
    """Returns the errors of what was predicted on an ``axis``, and the parts trained on, by the vehicle's clock.

    ``history`` was collected in flight, ``status`` is that at its end; ``account`` are seconds by what they
    were; ``seconds`` of the last ones are in the model.
    """
    errors = history.errors()
    angle = readable("rad")
    headline = f"No {axis} was predicted: there was no settled flight to learn from."
    if errors:
        best = min(errors, key=lambda one: abs(one.seconds - AHEAD))
        ours, held = (with_unit(sqrt(square[0]), angle) for square in (best.mse, best.held))
        headline = f"{axis.capitalize()} was predicted {best.seconds:.2g} s ahead with an RMSE of {ours} (baseline "
        headline += (
            f"{held}); {100 * best.inside[0]:.0f} % of the samples were inside the 90 % band."
        )
    blocks: list[Block] = [Sentence("", headline)]
    blocks += [
        Sentence(alarm.sentence.removeprefix("Alarm: "), "Motors:") for alarm in status.alarms
    ]
    if any(alarm.weak for alarm in status.alarms):
        blocks.append(Sentence(str(FALSE_ALARMS), "False alarms:"))
    if status.wind is not None or status.no_wind:
        said = (
            f"{' '.join(map(str, status.wind.facts))}, at {status.wind.time:.0f} s."
            if status.wind
            else str(status.no_wind)
        )
        blocks.append(Sentence(said, "Wind:"))
    if status.obstacle:
        blocks.append(Sentence(advised(status.obstacle), "At the end:"))
    if errors:
        made = "in flight, without the motors of the time ahead. Baseline: the last sample held."
        blocks += [_errors(errors, axis), Sentence(made, "How they were made:")]
    if history.learned:
        (first, *_) = history.learned[0]
        (*_, last) = history.learned[-1]
        total = np.diff(history.learned).sum()
        parts = f"{_counted(len(history.learned), 'part')} of the flight from {first:.0f} to {last:.0f} s"
        text = f"{parts}, {total:.0f} s together; the last {seconds:.0f} s are in the model at the end."
        blocks.append(Sentence(text, "Learned from:"))
    whole = whole_seconds(account)
    spent = [[begin(spent_on(kind)), f"{whole[kind]} s"] for kind in Spent if whole[kind]]
    blocks.append(Table([f"of {sum(whole.values())} s", "time"], spent))
    if status.vehicle is not None:
        rates = ", ".join(
            f"{name} {rate:.3g} Hz" for name, rate in sorted(status.rates.items()) if rate
        )
        text = f"vehicle {status.vehicle}; {f'at the end {rates}; ' if rates else ''}{status.lost} messages lost"
        text += f"; gaps of {status.missing:.1f} s are not counted; " if status.missing else ", "
        text += f"{status.late} samples too late, {status.unread} frames not decoded."
        blocks.append(Sentence(text, "Link:"))
    return blocks


def _errors(errors: Sequence[HorizonErrors], axis: str) -> Table:
    header = ["RMSE of predictions"]
    rows = [[f"{one.seconds:.2g} s ahead"] for one in errors]
    for i, (name, unit) in enumerate(
        [(axis, readable("rad")), (f"{axis} rate", readable("rad/s"))]
    ):
        header += [named(name, unit.name), "baseline", "in its 90 % band"]
        for row, one in zip(rows, errors, strict=True):
            errors_of = (f"{unit.scale * sqrt(square[i]):.2g}" for square in (one.mse, one.held))
            row += [*errors_of, f"{100 * one.inside[i]:.0f} %"]
    return Table(header, rows)


def truth_blocks(found: TruthComparison) -> list[Block]:
    """Returns a row a parameter with the truth beside it, and how the wind torque compares, of what was ``found``."""
    compared = list(found.parameters)
    if found.wind is not None and found.wind.resolved:
        compared.append(found.wind.mean)
    held = [one.inside for one in compared if one.inside is not None]
    count = f" {sum(held)} of {len(held)} intervals hold the truth." if held else ""
    blocks: list[Block] = [
        Sentence(f"of {found.source}; ± is the half width of the 90 % interval.{count}", "Truth:")
    ]
    if compared:
        blocks.append(
            Table(["", "estimate", "truth", "error", "unit", "inside"], list(map(_row, compared)))
        )
    if (wind := found.wind) is not None:
        sizes = (with_unit(sd, TORQUE) for sd in (wind.sd, wind.true_sd))
        text = f"correlation {wind.correlation:.2f}; standard deviation {', truth '.join(sizes)}; "
        text += f"{100 * wind.inside:.0f} % of the samples inside the 90 % band."
        if not wind.resolved:
            text += " The estimate is not resolved: its expected errors are as large as itself."
        blocks.append(Sentence(text, "Wind torque beside its truth:"))
    return blocks


def _row(one: ComparedParameter) -> list[str]:
    """Degrees for radians, ms for s; the error in percent of the truth, where that is no number near 0."""
    angle, per, rest = one.unit.partition(" per ")
    unit, scale = ("ms", 1e3) if one.unit == "s" else readable(angle)
    estimate, half, truth = (scale * value for value in (one.estimate, one.half_width, one.truth))
    near = abs(estimate - truth) < 10.0 * abs(truth)
    inside: str = Rated(one.status, Level.BAD)  # without an interval
    if one.inside is not None:
        biased = ", biased" if Status(one.status) is Status.BIASED else ""
        inside = f"{'yes' if one.inside else 'no'}{biased}"
    words = {
        "mean effect": "mean effectiveness",
        "damping": "rate damping",
        "lag of the motors": "motor time constant",
    }
    return [
        words.get(one.name, one.name.replace("effect of", "effectiveness of")),
        plus_minus(estimate, half) if isfinite(half) else rounded(estimate),
        rounded(truth, 3),
        f"{round(100 * (estimate / truth - 1)) + 0:+d} %" if near else "",
        f"{unit}{per}{rest}",
        inside,
    ]
