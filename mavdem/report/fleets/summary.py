"""The report of a fleet: which vehicles need a look and why, what was flown, and which logs could not be used."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import PurePath

from mavdem.comparison.flight_figures import NAMELESS, OK, FlightFigures, flights_of, vehicles_of
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.names import listed

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
    flown = [flight for flights in vehicles.values() for flight in flights]
    named = {name: flights for name, flights in vehicles.items() if name != NAMELESS}
    return [
        Sentence("", _headline(named, flown)),
        *([_flown(named, flown)] if flown else []),
        *_unknown(named, vehicles.get(NAMELESS, ())),
        *_unused([flight[0] for flight in flights_of(row for row in rows if row.status != OK)]),
    ]


def vehicle_health(flights: Flights) -> str:
    """The worst of any flight of a vehicle that was found: "fault", "drift", "ok", or "unknown" if none was judged."""
    found = {row.health for flight in flights for row in flight}
    return next((health for health in (*TROUBLE, OK) if health in found), "unknown")


def vehicle_words(flights: Flights) -> str:
    """What was found of one vehicle, in a sentence or two."""
    counts = Counter(_worst(flight) for flight in flights)
    if not any(counts[kind] for kind in TROUBLE):
        if counts[OK]:
            return f"No drift and no fault in {_counted(counts[OK], 'flight')} that could be judged."
        reason = next((row.health_reason for flight in reversed(flights) for row in flight if row.health_reason), "")
        return f"Not judged{': ' + reason if reason else '.'}"
    kinds = [f"{'a fault' if kind == 'fault' else 'a drift'} in {counts[kind]}" for kind in TROUBLE if counts[kind]]
    latest = next(flight for flight in reversed(flights) if _worst(flight) in TROUBLE)
    row = next(row for row in latest if row.health == _worst(latest))
    last = " The flights after it show none." if _worst(flights[-1]) == OK else ""
    sentence = f"Of {_counted(len(flights), 'flight')} {listed(kinds)}. The latest: {_when(row)}{_motor(row)}"
    return f"{sentence}{': ' + row.health_reason if row.health_reason else '.'}{last}"


def _worst(flight: Sequence[FlightFigures]) -> str:
    return next((kind for kind in (*TROUBLE, OK) if any(row.health == kind for row in flight)), "unknown")


def _when(row: FlightFigures) -> str:
    name = PurePath(row.file).name
    return name if row.date is None else f"{row.date:%Y-%m-%d} ({name})"


def _motor(row: FlightFigures) -> str:
    if row.suspect_motor is None:
        return ""
    sure = "" if row.fault_probability is None else f" (probability {row.fault_probability:.2f})"
    return f", motor {row.suspect_motor}{sure}"


def _headline(named: dict[str, Flights] | dict[str, list[list[FlightFigures]]], flown: Flights) -> str:
    if not flown:
        return "No log holds a flight that could be used."
    healths = {name: vehicle_health(flights) for name, flights in named.items()}
    ill = sorted((name for name in healths if healths[name] in TROUBLE), key=lambda name: TROUBLE.index(healths[name]))
    if ill:
        words = []
        for name in ill[:MAX_NAMED]:
            motors = {row.suspect_motor for flight in named[name] for row in flight if row.health == healths[name]}
            suspects = sorted(motor for motor in motors if motor is not None)
            where = f", motor {listed(suspects)}" if suspects else ""
            words.append(f"{name} ({healths[name]}{where})")
        if len(ill) > MAX_NAMED:
            words.append(f"{len(ill) - MAX_NAMED} more")
        needs = "needs" if len(ill) == 1 else "need"
        return f"{len(ill)} of {_counted(len(named), 'vehicle')} {needs} a look: {listed(words)}."
    if OK in healths.values():
        judged = sum(health == OK for health in healths.values())
        return f"No drift and no fault in {_counted(judged, 'vehicle')} that could be judged."
    return "No vehicle could be judged yet."


def _flown(named: dict[str, list[list[FlightFigures]]], flown: Flights) -> Sentence:
    hours = sum(max((row.duration or 0.0 for row in flight), default=0.0) for flight in flown) / 3600
    dates = sorted(flight[0].date for flight in flown if flight[0].date is not None)
    when = f", {dates[0]:%Y-%m-%d} to {dates[-1]:%Y-%m-%d}" if dates else ""
    # The best of a flight's axes: what the log allows.
    tiers = Counter(min((row.tier for row in flight if row.tier), default="") for flight in flown)
    kinds = [f"{tiers[tier]} of tier {tier} ({what})" for tier, what in TIERS.items() if tiers[tier]]
    of = f" of {_counted(len(named), 'vehicle')}" if named else ""
    return Sentence(
        f"{_counted(len(flown), 'flight')}{of}{when}, {hours:.2g} h settled; {listed(kinds) or 'no tier known'}.",
        "Flown:",
    )


def _unknown(named: dict[str, list[list[FlightFigures]]], nameless: Flights) -> list[Sentence]:
    """Which vehicles are not judged, and which flights are nobody's."""
    sentences = []
    waiting = [name for name, flights in named.items() if vehicle_health(flights) == "unknown"]
    if waiting and len(waiting) < len(named):
        sentences.append(
            Sentence(f"{_counted(len(waiting), 'vehicle')}, for the reason that each gives.", "Not judged:")
        )
    if nameless:
        text = f"{_counted(len(nameless), 'flight')} whose logs do not say of which vehicle; compared with no other."
        sentences.append(Sentence(text, "Without a name:"))
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
