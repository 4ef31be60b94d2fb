"""Loops of a log: the plant that its settled flight shows, and the controller of its parameters."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from math import inf, isfinite
from types import MappingProxyType

import numpy as np

from mavdem.alignment.drive import AXES
from mavdem.alignment.phases import in_modes
from mavdem.alignment.read import usable_segments
from mavdem.alignment.signals import SLOW_MOTION_RATE, Signals
from mavdem.analysis.analysis import flown_after
from mavdem.analysis.figures import AxisFigures
from mavdem.condition.loop.from_flight import loop_of
from mavdem.condition.loop.in_flight import plant_in_loop
from mavdem.condition.loop.loop import Loop
from mavdem.dem import NotIdentifiable, Physical, physical
from mavdem.dem.learning import FEWEST_SAMPLES
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Level
from mavdem.facts.loops import Loops
from mavdem.flight import Flight
from mavdem.ingest import Log
from mavdem.ingest.mavlink.definitions import parameters_sent
from mavdem.ingest.vocabulary import CONTROL_PARAMETERS, OWN_PARAMETERS

NAMED = {"roll": ("RLL", "ROLL"), "pitch": ("PIT",), "yaw": ("YAW",)}
"""What the names of one axis's parameters have in them."""


AUTOTUNE = frozenset({"Autotune"})
"""The mode of ArduPilot whose gains no parameter has."""


def loops_of_axes(
    log: Log,
    signals: Signals,
    start: float = 0.0,
    known: Mapping[str, AxisFigures] = MappingProxyType({}),
) -> dict[str, Loop | Fact]:
    """Returns the loops of roll, pitch and yaw, or why there are none; ``known`` are figures by axis."""
    found = dict[str, Loop | Fact]()
    for axis in AXES:
        try:
            about = signals.about(axis, signals.inputs)
            found[axis] = loops_of_log(about, log, start, known.get(axis))
        except NotLearnable as error:
            found[axis] = error.fact
    return found


def loops_of_log(
    signals: Signals, log: Log, start: float = 0.0, known: AxisFigures | None = None
) -> Loop:
    """Returns the loops of the axis of ``signals``; raises ``NotLearnable``: why there are none.

    The plant is the one that inputs and outputs alone tell, which may be ``known``, where they tell it without a bias;
    else the one that is identified in its loop.
    """
    segments, verdict = usable_segments(signals, log.components)
    is_slow = not segments
    if is_slow:
        segments, _ = usable_segments(signals, log.components, SLOW_MOTION_RATE)
    if not segments:
        raise NotLearnable(verdict.reason)
    flights, caution = with_one_set_of_gains(flown_after(segments, start), signals)
    plant: Physical | NotIdentifiable | None = None
    if not is_slow:
        plant = physical(flights) if known is None or caution else known.physical
    if not isinstance(plant, Physical) or not plant.identifiable or plant.bias:
        try:
            plant = plant_in_loop(signals, flights)
        except NotLearnable:
            if not isinstance(plant, Physical) or not plant.identifiable:
                raise
    loop = loop_of(plant, Record.of(flights))
    return loop if caution is None else replace(loop, cautions=(caution, *loop.cautions))


def with_one_set_of_gains(
    flights: Sequence[Flight], signals: Signals
) -> tuple[tuple[Flight, ...], Fact | None]:
    """Returns the parts of ``flights`` with the set of gains that was flown longest, with these; a fact if not all.

    Parts in ArduPilot's AutoTune are left out: no parameter has its gains. Raises ``NotLearnable``: no part is left.
    """
    sets = gains_of_log(signals)
    parts = defaultdict[tuple[tuple[str, float], ...], list[Flight]](list)
    for flight in flights:
        boot = flight.provenance["segment"]["boot"]
        tuning = in_modes(signals, boot, AUTOTUNE)
        stamps = [time for of_boot, time, _ in sets if of_boot == boot]
        edges = np.searchsorted(flight.time, [*stamps, *np.ravel(tuning)])
        for first, last in pairwise(np.unique([0, *edges, len(flight)]).tolist()):
            begin = flight.time[first]
            is_tuned = any(since <= begin < until for since, until in tuning)
            if last - first >= FEWEST_SAMPLES and not is_tuned:
                known = [values for *since, values in sets if since <= [boot, begin]]
                parts[known[-1]].append(flight[first:last])
    if not parts:
        raise NotLearnable(Fact(Loops.GAINS_OF_AUTOTUNE))
    gains, longest = max(parts.items(), key=lambda item: sum(map(len, item[1])))
    kept = tuple(_with_parameters(part, dict(gains)) for part in longest)
    if sum(map(len, kept)) == sum(map(len, flights)):
        return kept, None
    caution = Fact(
        Loops.GAINS_OF_PART,
        Level.WATCH,
        names=sorted({name for other in parts for name, _ in set(other) - set(gains)}),
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
    named = parameters_sent(sent, telemetry.autopilot)
    own = [
        (boot, time, name, value)
        for boot, time, (name, value) in zip(
            sent["boot"].tolist(), sent["time"].tolist(), named, strict=True
        )
        if CONTROL_PARAMETERS.match(name)
        and not OWN_PARAMETERS.search(name)
        and not any(part in name for part in others)
        and isfinite(value)
    ]
    known = {name: value for _, _, name, value in reversed(own)}
    sets = [(-1, -inf, tuple(known.items()))]
    for boot, time, name, value in own:
        if known[name] != value:
            known[name] = value
            sets.append((boot, time, tuple(known.items())))
    return sets


def _with_parameters(flight: Flight, values: Mapping[str, float]) -> Flight:
    known = {"parameters": {**flight.provenance["parameters"], **values}, "earlier": {}}
    return replace(flight, provenance={**flight.provenance, **known})
