"""The parts of a flight with one set of gains."""

import re
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise
from math import inf, isfinite

import numpy as np

from mavdem.assessment.autopilot_messages import status_texts
from mavdem.dataset.phases import mode_intervals
from mavdem.dataset.signals import Signals
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.dem.learning import MIN_SAMPLES
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.loops import Loops
from mavdem.flight import Flight, Flights, boot_number
from mavdem.ingest.mavlink.definitions import decoded_parameters
from mavdem.ingest.telemetry import Parameters
from mavdem.ingest.vocabulary import AUTOPILOT_SET_PARAMETERS, CONTROL_PARAMETERS
from mavdem.loops.axis_loops import Loop, margin_rating

NAMED = {"roll": ("RLL", "ROLL"), "pitch": ("PIT",), "yaw": ("YAW",)}
"""What the names of one axis's parameters have in them."""
AUTOTUNE = frozenset({"Autotune"})
"""The mode of ArduPilot whose gains no parameter has."""
FOUND = re.compile(r"\b([PID]):(\d+\.?\d*)")
"""A gain that ArduPilot's AutoTune ended with, in "Roll Rate: P:0.116, I:0.116, D:0.0006" and "Roll Angle P:36.000"."""


@cached_per_vehicle("axis", "inputs")
def with_one_set_of_gains(signals: Signals, flights: Flights) -> tuple[Flights, Fact | None]:
    """Returns the parts of ``flights`` with the set of gains that was flown longest, with these; a fact if not all.

    The fact has the durations of the other sets, the longest first, and which gains were others in each.
    Parts in ArduPilot's AutoTune are left out: no parameter has its gains. Raises ``NotLearnable``: no part is left.
    """
    sets = gains_of_log(signals)
    parts = defaultdict[tuple[tuple[str, float], ...], list[Flight]](list)
    for flight in flights:
        boot = boot_number(flight)
        tuning = mode_intervals(signals, boot, AUTOTUNE)
        stamps = [time for of_boot, time, _ in sets if of_boot == boot]
        edges = np.searchsorted(flight.time, [*stamps, *np.ravel(tuning)])
        for first, last in pairwise(np.unique([0, *edges, len(flight)]).tolist()):
            begin = flight.time[first]
            is_tuned = any(since <= begin < until for since, until in tuning)
            if last - first >= MIN_SAMPLES and not is_tuned:
                before = [values for *since, values in sets if since <= [boot, begin]]
                parts[before[-1]].append(flight[first:last])
    if not parts:
        raise NotLearnable(Loops.GAINS_OF_AUTOTUNE)
    gains, longest = max(parts.items(), key=lambda item: sum(map(len, item[1])))
    kept = tuple(
        replace(
            part,
            provenance={
                **part.provenance,
                "parameters": {**part.provenance["parameters"], **dict(gains)},
                "earlier": {},
            },
        )
        for part in longest
    )
    if sum(map(len, kept)) == sum(map(len, flights)):
        return kept, None
    del parts[gains]
    others = [
        (sum(part.duration for part in flown), sorted(set(other) - set(gains)))
        for other, flown in parts.items()
    ]
    caution = Fact(
        Loops.GAINS_OF_PART,
        names=sorted({name for _, values in others for name, _ in values}),
        parts=sorted(others, reverse=True),
        ratings=(),
        duration=sum(part.duration for part in kept),
        settled=sum(flight.duration for flight in flights),
    )
    return kept, caution


def gains_of_log(signals: Signals) -> list[tuple[int, float, tuple[tuple[str, float], ...]]]:
    """Returns boot, time, s, and names and values of the axis's control: from before the log, and after each change."""
    telemetry = signals.telemetry
    sent = telemetry.messages.get("PARAM_VALUE")
    if sent is None:
        return [(-1, -inf, ())]
    others = [part for axis, parts in NAMED.items() if axis != signals.axis for part in parts]
    named = decoded_parameters(sent, telemetry.autopilot)
    own = [
        (boot, time, name, value)
        for boot, time, (name, value) in zip(
            sent["boot"].tolist(), sent["time"].tolist(), named, strict=True
        )
        if CONTROL_PARAMETERS.match(name)
        and not AUTOPILOT_SET_PARAMETERS.search(name)
        and not any(part in name for part in others)
        and isfinite(value)
    ]
    current = {name: value for _, _, name, value in reversed(own)}
    sets = [(-1, -inf, tuple(current.items()))]
    for boot, time, name, value in own:
        if current[name] != value:
            current[name] = value
            sets.append((boot, time, tuple(current.items())))
    return sets


def autotuned(signals: Signals, loop: Loop | Fact) -> Fact | None:
    """Returns that AutoTune tuned the axis of ``signals``, with gains before and after; None where it did not.

    Those after are the parameters or, until they are set, what it said that it found. Where the ``loop`` is known, so
    is how its margins rate with either.
    """
    named = f"AutoTune: {signals.axis.capitalize()}"
    begins = f"{named} ", f"{named}("  # "Yaw(E)", "Yaw(D)": by its error's filter, or D
    words = [text for text in status_texts(signals.telemetry) if text.text.startswith(begins)]
    stamps = [(text.boot, text.time) for text in words]
    if signals.telemetry.autopilot == "PX4":
        for _, signal in signals.injected_signals:
            stamps += [
                (boot, time)
                for boot, time, value in zip(signal.boot, signal.time, signal.values, strict=True)
                if value
            ]
    if not stamps:
        return None
    boot, begin = min(stamps)
    sets = gains_of_log(signals)
    before = [dict(values) for *since, values in sets if since <= [boot, begin]][-1]
    after = before | {
        f"ATC_{'ANG' if 'Angle' in text.text else 'RAT'}_{NAMED[signals.axis][0]}_{letter}": float(
            value
        )
        for text in words
        for letter, value in FOUND.findall(text.text)
    }
    after |= {name: value for name, value in sets[-1][2] if before[name] != value}
    changes = [
        (name, before.get(name), value)
        for name, value in after.items()
        if before.get(name) != value
    ]
    tuned = Fact(
        Loops.AUTOTUNED,
        time=begin,
        until=max(time for of_boot, time in stamps if of_boot == boot),
        subject=signals.axis,
        boot=boot,
        changes=changes,
        ratings=(),
    )
    if isinstance(loop, Fact):
        return tuned
    ratings = ratings_of(loop, (before, after))
    if not ratings:
        return tuned
    return tuned.but(min(ratings[1].level, Level.WATCH, key=list(Level).index), ratings=ratings)


def ratings_of(loop: Loop, gains: Iterable[Parameters]) -> Facts:
    """Returns how the margins of a ``loop`` rate with other ``gains``; nothing where some are no controller's."""
    try:
        return tuple(margin_rating(loop.with_parameters(values)) for values in gains)
    except NotLearnable:
        return ()
