"""From a log to the Flight a model can be learnt from, or the reason why not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from os import PathLike

from mavdem.alignment.drive import message_counts
from mavdem.alignment.signals import ATTITUDE_MESSAGES, MINIMUM_RATE, SLOW_MOTION_RATE, Signals
from mavdem.alignment.verdict import MINIMUM_DURATION, Verdict, segment_verdicts, verdict_of
from mavdem.errors import NotLearnable
from mavdem.flight import Flight
from mavdem.ingest import Component, Log, read_log
from mavdem.ingest.telemetry import Telemetry

# What the rates of a log allow: everything; its slow motion; figures of its condition
TIERS = ("a", "b", "c")


def read_flight(
    path: str | bytes | PathLike[str],
    axis: str = "roll",
    vehicle: str | None = None,
    inputs: str | None = None,
    tier: str = "a",
) -> Flight:
    """Returns the longest usable segment of a log; its cautions are in ``provenance["cautions"]``.

    >>> flight = mavdem.read_flight("flight.tlog", axis="roll")
    >>> flight.output_names, flight.inputs.shape[1], flight.dt
    (('roll', 'roll rate'), 4, 0.01)

    Args:
        path: a log that ``mavdem.ingest.read_log`` reads.
        axis: "roll", "pitch" or "yaw". A flight of yaw has the rate only: for physical parameters, not for a model.
        vehicle: "system" or "system:component", where the log holds several.
        inputs: "motors", or "demand": what the controller asked of the axis, one column; None for the motors, unless
            they come too slowly and the demand does not.
        tier: the lowest that will do: "a", attitude and inputs at 40 Hz or more, for a model; "b", 8 Hz and more, for
            its slow motion; "c", at any rate, whether or not its attitude is consistent. The provenance's cautions then
            say why no full model can be learnt from it.

    Raises:
        Unreadable: the log cannot be read.
        NotLearnable: it holds no vehicle, or several and none was chosen, or the verdict is no.
        ValueError: ``path`` is no path, or an axis, inputs or a tier that is none.

    See Also:
        :func:`mavdem.read_segments`: all usable segments; :class:`mavdem.Flight`: what it is; :func:`mavdem.learn`.
    """
    if tier not in TIERS:
        raise ValueError(f"tier must be one of {', '.join(TIERS)}, not {tier!r}")
    flight, _ = learnable_flight(read_log(path), axis, vehicle, inputs, tier)
    return flight


def read_segments(
    path: str | bytes | PathLike[str],
    axis: str = "roll",
    vehicle: str | None = None,
    inputs: str | None = None,
) -> tuple[Flight, ...]:
    """Returns all usable segments of settled flight in a log, in the order of time.

    >>> [flight.duration > 50 for flight in mavdem.read_segments("flight.tlog")]
    [True]

    They have the same inputs and outputs and the same step, that of the longest, so that ``mavdem.learn`` takes them
    together. Each passed the checks of :func:`read_flight`; where some did not, ``provenance["cautions"]`` say how
    much is left out. Times of different boots (``provenance["segment"]["boot"]``) must not be compared.

    Args:
        path, axis, vehicle, inputs: as for :func:`read_flight`.

    Raises:
        Unreadable, NotLearnable, ValueError: as :func:`read_flight`.

    See Also:
        :func:`mavdem.read_flight`: the longest segment; :func:`mavdem.learn`, which takes them together.
    """
    log = read_log(path)
    flights, verdict = usable_segments(
        Signals(choose_vehicle(log.vehicles, vehicle), axis, inputs), log.components
    )
    if not flights:
        raise NotLearnable(verdict.reason, verdict.remedy)
    return flights


def learnable_flight(
    log: Log,
    axis: str = "roll",
    vehicle: str | None = None,
    inputs: str | None = None,
    tier: str = "a",
) -> tuple[Flight, Verdict]:
    """Returns the longest usable segment of a log, as :func:`read_flight` gives it, and the verdict on it."""
    signals = Signals(choose_vehicle(log.vehicles, vehicle), axis, inputs)
    verdict = verdict_of(signals, log.components)
    if verdict.learnable or tier == "a":
        return _with_cautions(verdict), verdict
    doubt = (f"No full {axis} model can be learnt from it: {verdict.reason}",)
    slow = verdict_of(signals, log.components, SLOW_MOTION_RATE)
    if slow.learnable or tier == "b" or verdict.flight is None:
        return _with_cautions(slow, doubt), verdict
    provenance = {**verdict.flight.provenance, "cautions": list(doubt)}
    return replace(verdict.flight, provenance=provenance), verdict


def usable_segments(
    signals: Signals, components: Sequence[Component] = (), least_rate: float = MINIMUM_RATE
) -> tuple[tuple[Flight, ...], Verdict]:
    """Returns all usable segments, none if the verdict, on the longest, is no; both need ``least_rate``, Hz."""
    verdicts = list(segment_verdicts(signals, components, least_rate))
    found = verdicts[0].segments
    usable = [verdict for verdict in verdicts if verdict.learnable]
    lost = [
        segment.duration
        for segment in found
        if segment not in [verdict.segment for verdict in usable]
    ]
    left_out: tuple[str, ...] = ()
    if 0 < len(lost) < len(found):
        seconds = sum(segment.duration for segment in found)
        left_out = (
            f"{len(lost)} of {len(found)} segments of settled flight, {sum(lost):.1f} of {seconds:.1f} s, are left "
            f"out: they are shorter than {MINIMUM_DURATION:.0f} s, come slower than the longest, or cannot be learnt "
            "from.",
        )
    flights = [_with_cautions(verdict, left_out) for verdict in usable]
    in_time = sorted(
        flights, key=lambda flight: (flight.provenance["segment"]["boot"], float(flight.time[0]))
    )
    return tuple(in_time), verdicts[0]


def _with_cautions(verdict: Verdict, further: tuple[str, ...] = ()) -> Flight:
    if not verdict.learnable or verdict.flight is None:
        raise NotLearnable(verdict.reason, verdict.remedy)
    provenance = {**verdict.flight.provenance, "cautions": [*verdict.cautions, *further]}
    return replace(verdict.flight, provenance=provenance)


def choose_vehicle(vehicles: Sequence[Telemetry], wanted: str | None = None) -> Telemetry:
    """The one vehicle, or the one ``wanted``: "system", "system:component" or the number of its board.

    One that sends no attitude is no rival.

    Raises NotLearnable: none or several match; the message lists them.
    """
    if wanted is not None:
        matching = [
            vehicle
            for vehicle in vehicles
            if wanted in (str(vehicle.system), _ids(vehicle), vehicle.board)
        ]
    else:
        moving = [
            vehicle
            for vehicle in vehicles
            if any(message_counts(vehicle, ATTITUDE_MESSAGES).values())
        ]
        matching = moving or list(vehicles)
    if len(matching) == 1:
        return matching[0]
    if not vehicles:
        raise NotLearnable(
            "There is no vehicle in it.", "Check that the autopilot's own messages are recorded."
        )
    rivals = matching or vehicles
    # two logs in one, of vehicles with the same ids
    alike = len({_ids(vehicle) for vehicle in rivals}) < len(rivals)
    names = [vehicle.board if alike and vehicle.board else _ids(vehicle) for vehicle in rivals]
    listed = ", ".join(
        f"{name} ({one.vehicle}, {one.autopilot})" for name, one in zip(names, rivals, strict=True)
    )
    example = f"Choose one, for example with `--vehicle {names[0]}`."
    if not matching:
        there = "is" if len(vehicles) == 1 else "are"
        raise NotLearnable(f"There is no vehicle {wanted}; there {there} {listed}.", example)
    raise NotLearnable(f"There are several vehicles: {listed}.", example)


def _ids(vehicle: Telemetry) -> str:
    return f"{vehicle.system}:{vehicle.component}"
