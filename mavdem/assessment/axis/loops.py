"""Loops of a log: the plant that its settled flight shows, and the controller of its parameters."""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from mavdem.assessment.axis.analysis import flown_after
from mavdem.assessment.axis.figures import AxisFigures
from mavdem.assessment.axis.gains import autotuned, ratings_of, with_one_set_of_gains
from mavdem.dataset.axes import AXES
from mavdem.dataset.flights import usable_segments
from mavdem.dataset.signals import MIN_SLOW_MOTION_RATE, Signals
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.flight import Flights
from mavdem.ingest import Log
from mavdem.loops.axis_loops import Loop
from mavdem.loops.identification import identify_plant_in_loop
from mavdem.loops.loop_construction import loop_from_plant
from mavdem.plant import Physical, physical


def loops_of_axes(
    log: Log,
    signals: Signals,
    start: float = 0.0,
    figures: Mapping[str, AxisFigures] = MappingProxyType({}),
) -> dict[str, Loop | Fact]:
    """Returns the loops of roll, pitch and yaw, or why there are none; ``figures`` are by axis."""
    loops = dict[str, Loop | Fact]()
    for axis in AXES:
        try:
            about = signals.for_axis(axis, signals.inputs)
            loops[axis] = loops_of_log(about, log, start, figures.get(axis))
        except NotLearnable as error:
            loops[axis] = error.fact
    return loops


def loops_of_log(
    signals: Signals, log: Log, start: float = 0.0, figures: AxisFigures | None = None
) -> Loop:
    """Returns the loops of the axis of ``signals``; raises ``NotLearnable``: why there are none.

    The ``figures`` of the axis may have its plant.
    """
    segments, learnability = usable_segments(signals, log.components)
    if not segments:
        segments, learnability = usable_segments(signals, log.components, MIN_SLOW_MOTION_RATE)
    if not segments:
        raise NotLearnable(learnability.reason)
    flights, caution = with_one_set_of_gains(signals, flown_after(segments, start))
    # With parts of other gains among them all flights may refuse what these allow.
    fitted = figures.physical if figures is not None and caution is None else None
    plant = _plant(signals, flights, fitted)
    loop = loop_from_plant(plant, Record.from_flights(flights))
    if caution is not None:
        other_gains = (dict(values) for _, values in caution.figures["parts"])
        caution = caution.but(ratings=ratings_of(loop, other_gains))
    own = filter(None, (caution, autotuned(signals, loop)))
    return replace(loop, cautions=(*own, *loop.cautions))


def _plant(signals: Signals, flights: Flights, fitted: Physical | None) -> Physical:
    """The plant in its loop, else the one that inputs and outputs alone tell, which may be ``fitted`` already."""
    try:
        return identify_plant_in_loop(signals, flights)
    except NotLearnable as error:
        plant = (fitted or physical(flights))._replace(refusal=error.fact)
    if isinstance(plant, Physical) and plant.identifiable:
        return plant
    assert plant.refusal is not None
    raise NotLearnable(plant.refusal)
