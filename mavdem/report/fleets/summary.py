"""The report of a fleet: which vehicles need a look and why, what was flown, and which logs could not be used."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import PurePath

from mavdem.comparison.flight_figures import (
    NAMELESS,
    OK,
    FlightFigures,
    flights_of,
    flown_once,
    is_shared,
    vehicles_of,
)
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.numbers import listed

TROUBLE = ("fault", "drift")
SEVERITY = (*TROUBLE, "unknown", OK)
TIERS = {"a": "everything", "b": "slow motion and conditions", "c": "conditions only"}
MAX_NAMED = 12  # vehicles in a sentence
MAX_REASONS = 8  # rows of the table of logs that could not be used

Flights = Sequence[Sequence[FlightFigures]]
"""Flights of one vehicle in order of date, the rows of each."""


def fleet_blocks(rows: Sequence[FlightFigures]) -> list[Block]:
    """The summary of a fleet: a headline, what was flown, and why logs could not be used."""
    vehicles = vehicles_of(rows)
    named = {name: flights for name, flights in vehicles.items() if is_one_vehicle(name, flights)}
    others = {name: flights for name, flights in vehicles.items() if name not in named}
    own = {name: flown_once(flights) for name, flights in named.items() if not is_shared(flights)}
    flown = [flight for name in vehicles for flight in own.get(name, vehicles[name])]
    twice = sum(len(vehicles[name]) - len(own[name]) for name in own)
    return [
        Sentence("", _headline(named, flown)),
        *([_flown(own, flown, twice)] if flown else []),
        *_unknown(named, [flight for flights in others.values() for flight in flights]),
        *_unused([flight[0] for flight in flights_of(row for row in rows if row.status != OK)]),
    ]


def is_one_vehicle(name: str, flights: Flights) -> bool:
    """Whether these are a vehicle's flights: of a system id, which many share, only if they were judged as such."""
    return name != NAMELESS and (not is_shared(flights) or vehicle_health(flights) != "unknown")


def vehicle_health(flights: Flights) -> str:
    """What was found in a vehicle's latest flight that was judged: "fault", "drift" or "ok"; "unknown" if none was."""
    return next((found for flight in reversed(flights) if (found := _worst(flight)) != "unknown"), "unknown")


def had_trouble(flights: Flights) -> bool:
    """Whether any flight showed a fault or a drift."""
    return any(_worst(flight) in TROUBLE for flight in flights)


def vehicle_words(flights: Flights) -> str:
    """What was found of one vehicle, in a sentence or two."""
    counts = Counter(_worst(flight) for flight in flights)
    if not any(counts[kind] for kind in TROUBLE):
        if counts[OK]:
            return f"No drift and no fault in {_counted(counts[OK], 'flight')} that could be judged.{_by_id(flights)}"
        reason = next((row.health_reason for flight in reversed(flights) for row in flight if row.health_reason), "")
        return f"Not judged{': ' + reason if reason else '.'}"
    kinds = [f"{'a fault' if kind == 'fault' else 'a drift'} in {counts[kind]}" for kind in TROUBLE if counts[kind]]
    latest = next(flight for flight in reversed(flights) if _worst(flight) in TROUBLE)
    row = next(row for row in latest if row.health == _worst(latest))
    last = " The latest flight that was judged shows none." if vehicle_health(flights) == OK else ""
    sentence = f"Of {_counted(len(flights), 'flight')} {listed(kinds)}. The latest: {_when(row)}{_motor(row)}"
    return f"{sentence}{': ' + row.health_reason if row.health_reason else '.'}{last}{_by_id(flights)}"


def _by_id(flights: Flights) -> str:
    """That the name says little, where it does."""
    return " The name is a system id, which many vehicles share: these may be several." if is_shared(flights) else ""


def _worst(flight: Sequence[FlightFigures]) -> str:
    return next((kind for kind in (*TROUBLE, OK) if any(row.health == kind for row in flight)), "unknown")


def _when(row: FlightFigures) -> str:
    name = PurePath(row.file).name
    return name if row.date is None else f"{row.date:%Y-%m-%d} ({name})"


def _motor(row: FlightFigures) -> str:
    if row.suspect_motor is None:
        return ""
    # The row has the probability of any fault, not that of this motor.
    sure = "" if row.fault_probability is None else f" (probability of a fault {row.fault_probability:.2f})"
    return f", motor {row.suspect_motor}{sure}"


def _headline(named: Mapping[str, Flights], flown: Flights) -> str:
    if not flown:
        return "No log holds a flight that could be used."
    healths = {name: vehicle_health(flights) for name, flights in named.items()}
    ill = sorted((name for name in healths if healths[name] in TROUBLE), key=lambda name: TROUBLE.index(healths[name]))
    if ill:
        words = []
        for name in ill[:MAX_NAMED]:
            latest = next(flight for flight in reversed(named[name]) if _worst(flight) != "unknown")
            motors = {row.suspect_motor for row in latest if row.health == healths[name]}
            suspects = sorted(motor for motor in motors if motor is not None)
            where = f", motor {listed(suspects)}" if suspects else ""
            words.append(f"{name} ({healths[name]}{where})")
        if len(ill) > MAX_NAMED:
            words.append(f"{len(ill) - MAX_NAMED} more")
        needs = "needs" if len(ill) == 1 else "need"
        return f"{len(ill)} of {_counted(len(named), 'vehicle')} {needs} a look: {listed(words)}.{_earlier(named)}"
    if OK in healths.values():
        judged = sum(health == OK for health in healths.values())
        earlier = _earlier(named)
        which = "the latest flights of " if earlier else ""
        return f"No drift and no fault in {which}{_counted(judged, 'vehicle')} that could be judged.{earlier}"
    return "No vehicle could be judged yet."


def _earlier(named: Mapping[str, Flights]) -> str:
    """Vehicles in trouble before, which their latest flight does not show."""
    names = sorted(name for name, flights in named.items() if had_trouble(flights) and vehicle_health(flights) == OK)
    more = [f"{len(names) - MAX_NAMED} more"] if len(names) > MAX_NAMED else []
    if not names:
        return ""
    return f" Trouble in earlier flights, and not in the latest: {listed([*names[:MAX_NAMED], *more])}."


def _flown(named: Mapping[str, Flights], flown: Flights, twice: int) -> Sentence:
    hours = sum(max((row.duration or 0.0 for row in flight), default=0.0) for flight in flown) / 3600
    dates = sorted(flight[0].date for flight in flown if flight[0].date is not None)
    when = f", {dates[0]:%Y-%m-%d} to {dates[-1]:%Y-%m-%d}" if dates else ""
    # The best of a flight's axes: what the log allows.
    tiers = Counter(min((row.tier for row in flight if row.tier), default="") for flight in flown)
    kinds = [f"{tiers[tier]} of tier {tier} ({what})" for tier, what in TIERS.items() if tiers[tier]]
    of = f" of {_counted(len(named), 'vehicle')}" if named else ""
    again = (
        f" ({_counted(twice, 'more log')} {'has a flight' if twice == 1 else 'have flights'} of these)" if twice else ""
    )
    counts = f"{_counted(len(flown), 'flight')}{of}{again}{when}"
    return Sentence(f"{counts}, {hours:.2g} h settled; {listed(kinds) or 'no tier known'}.", "Flown:")


def _unknown(named: Mapping[str, Flights], nameless: Flights) -> list[Sentence]:
    """Which vehicles are not judged, and which flights are nobody's."""
    sentences = []
    waiting = [name for name, flights in named.items() if vehicle_health(flights) == "unknown"]
    if waiting and len(waiting) < len(named):
        sentences.append(
            Sentence(f"{_counted(len(waiting), 'vehicle')}, for the reason that each gives.", "Not judged:")
        )
    if nameless:
        text = "whose logs do not say of which vehicle, or by a system id only; compared with no other."
        sentences.append(Sentence(f"{_counted(len(nameless), 'flight')} {text}", "Without a name:"))
    return sentences


def _unused(refused: Sequence[FlightFigures]) -> list[Block]:
    """Why logs could not be used, the most frequent reason first."""
    if not refused:
        return []
    examples: dict[str, list[str]] = {}
    for row in refused:
        examples.setdefault(_kind(row), []).append(PurePath(row.file).name)
    reasons = sorted(examples, key=lambda reason: (-len(examples[reason]), reason))
    cells = [
        [_shortened(reason), str(len(examples[reason])), _shortened(examples[reason][0], 60)] for reason in reasons
    ]
    if len(cells) > MAX_REASONS:
        others = sum(len(examples[reason]) for reason in reasons[MAX_REASONS - 1 :])
        cells = [*cells[: MAX_REASONS - 1], ["other reasons: see the table of flights", str(others), ""]]
    return [
        Sentence(
            f"{_counted(len(refused), 'log')}; nothing else is said of {'it' if len(refused) == 1 else 'them'}.",
            "Not used:",
        ),
        Table(["reason", "logs", "for example"], cells, words=True),
    ]


def _kind(row: FlightFigures) -> str:
    """The reason without the file's name and the numbers that make each one different."""
    text = row.status.replace(row.file, "the log").replace(PurePath(row.file).name, "the log")
    first = re.split(r"(?<=[.:;]) ", text, maxsplit=1)[0]
    return re.sub(r"\d[\d.,]*", "…", first).rstrip(".:; ")


def _shortened(text: str, longest: int = 140) -> str:
    return text if len(text) <= longest else f"{text[: longest - 1]}…"


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
