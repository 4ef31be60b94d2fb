"""Flights in a log from which a model can be learned, or the reason why there are none."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from mavdem.dataset.attitude import ATTITUDE_MESSAGES
from mavdem.dataset.learnability import learnability_of, segment_learnabilities
from mavdem.dataset.segment_learnability import MIN_SEGMENT_DURATION, Learnability
from mavdem.dataset.segments import Segment, Segments
from mavdem.dataset.signals import MIN_STREAM_RATE, Signals
from mavdem.dataset.time_series import message_counts
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts
from mavdem.facts.learnability import Caution, NotLearnableReason
from mavdem.files import AnyPath
from mavdem.flight import Flight, Flights, boot_number
from mavdem.ingest import Component, Log, read_log
from mavdem.ingest.telemetry import Telemetry


def read_flight(
    path: AnyPath,
    axis: str = "roll",
    vehicle: str | None = None,
    inputs: str | None = None,
) -> Flight:
    """Reads the longest segment of settled flight in a log that a model can be learned from.

    >>> flight = mavdem.read_flight("flight.tlog", axis="roll")
    >>> flight.output_names, flight.inputs.shape[1], flight.dt
    (('roll', 'roll rate'), 4, 0.01)

    Args:
        path: A log in one of the formats of ``mavdem.ingest.read_log``.
        axis: "roll", "pitch" or "yaw". A flight of yaw has the body rate only: it serves to estimate physical
            parameters, not to learn a model.
        vehicle: "system" or "system:component", where the log holds several vehicles.
        inputs: "motors", or "demand" for the controller's demand about the axis, a single column. By default the
            motors, unless they come too slowly and the demand does not.

    Returns:
        The flight: uniform samples of attitude, motor outputs and setpoints. What makes a model of it less reliable is
        in ``provenance["cautions"]``.

    Raises:
        Unreadable: The log cannot be read.
        NotLearnable: The log has no vehicle, several of which none was chosen, or no usable segment.
        ValueError: The path is no path, or the axis or the kind of inputs does not exist.

    See Also:
        :func:`mavdem.read_segments`: all usable segments; :class:`mavdem.Flight`; :func:`mavdem.learn`.
    """
    return learnable_flight(read_log(path), axis, vehicle, inputs).flight


def read_segments(
    path: AnyPath,
    axis: str = "roll",
    vehicle: str | None = None,
    inputs: str | None = None,
) -> Flights:
    """Reads all segments of settled flight in a log that a model can be learned from, in the order of time.

    >>> [flight.duration > 50 for flight in mavdem.read_segments("flight.tlog")]
    [True]

    All have the same inputs and outputs and the same sampling step, the one of the longest segment, so that
    ``mavdem.learn`` can take them together. Each passed the checks of :func:`read_flight`. Times of different boots
    (``provenance["segment"]["boot"]``) must not be compared.

    Args:
        path: A log in one of the formats of ``mavdem.ingest.read_log``.
        axis: "roll", "pitch" or "yaw".
        vehicle: "system" or "system:component", where the log holds several vehicles.
        inputs: "motors" or "demand", as in :func:`read_flight`.

    Returns:
        The flights. Where segments failed the checks, ``provenance["cautions"]`` has how much is left out.

    Raises:
        Unreadable, NotLearnable, ValueError: As for :func:`read_flight`.

    See Also:
        :func:`mavdem.read_flight`: the longest segment; :func:`mavdem.learn`.
    """
    log = read_log(path)
    signals = Signals(choose_vehicle(log.vehicles, vehicle), axis, inputs)
    flights, learnability = usable_segments(signals, log.components)
    if not flights:
        raise NotLearnable(learnability.reason)
    return flights


class LearnableFlight(NamedTuple):
    """A flight from which a model can be learned."""

    flight: Flight
    """The longest usable segment of settled flight."""

    learnability: Learnability
    """The checks of the log, with their figures."""


def learnable_flight(
    log: Log,
    axis: str = "roll",
    vehicle: str | None = None,
    inputs: str | None = None,
) -> LearnableFlight:
    """Returns the longest usable segment of a log, as :func:`read_flight` does, and its learnability.

    Args:
        log: A log that was read.
        axis: "roll", "pitch" or "yaw": the axis of which a model is to be learned.
        vehicle: Vehicle to choose, if the log contains several.
        inputs: "motors" or "demand"; None for the motors, unless only the demand comes fast enough.

    Returns:
        The flight, and the checks of the log with their figures.

    Raises:
        NotLearnable: No vehicle could be chosen, or no segment is usable.
    """
    signals = Signals(choose_vehicle(log.vehicles, vehicle), axis, inputs)
    learnability = learnability_of(signals, log.components)
    return LearnableFlight(_flight_with_cautions(learnability), learnability)


class UsableSegments(NamedTuple):
    """The segments of settled flight from which a model can be learned."""

    flights: Flights
    """The segments, aligned with one sampling step, in the order of time; none if no segment is learnable."""

    learnability: Learnability
    """Learnability of the best segment, usable or not."""


@cached_per_vehicle("axis", "inputs")
def usable_segments(
    signals: Signals, components: tuple[Component, ...] = (), min_rate: float = MIN_STREAM_RATE
) -> UsableSegments:
    """Returns all segments of a vehicle's settled flight from which a model can be learned, as training data.

    A segment is a part without gaps; settled flight has neither take-off nor landing.

    Args:
        signals: Logged time series of the vehicle, with angle, rate and setpoints of an axis.
        components: All components in the log, for the advice on rates.
        min_rate: Rate, Hz, that attitude and model inputs need.

    Returns:
        The flights in the order of time, all with one sampling step, empty if no segment is usable; and the
        learnability of the best segment, which then says why.
    """
    # They say of each segment whether a model can be learned from it, and why not. The best segment comes first.
    learnabilities = list(segment_learnabilities(signals, components, min_rate))
    best_learnability = learnabilities[0]
    usable = [learnability for learnability in learnabilities if learnability.learnable]
    all_segments = best_learnability.segments
    used_segments = [learnability.segment for learnability in usable]
    cautions = _cautions_on_unused_segments(all_segments, used_segments)
    flights = [_flight_with_cautions(learnability, *cautions) for learnability in usable]
    flights.sort(key=lambda flight: (boot_number(flight), flight.time[0]))
    return UsableSegments(tuple(flights), best_learnability)


def _cautions_on_unused_segments(
    segments: Segments, used_segments: Sequence[Segment | None]
) -> Facts:
    """Returns a caution if part of the settled flight is not used to learn the model.

    Args:
        segments: All segments (parts without gaps) of settled flight, which has neither take-off nor landing.
        used_segments: Segments from which the model is learned; None for one that could not be used.

    Returns:
        One caution, with the number and the duration of the unused segments; empty if all or none of them are used.
    """
    unused_durations = [segment.duration for segment in segments if segment not in used_segments]
    if not unused_durations or len(unused_durations) == len(segments):
        return ()
    caution = Fact(
        Caution.SEGMENTS_LEFT_OUT,
        count=len(unused_durations),
        segments=len(segments),
        duration=sum(unused_durations),
        settled=sum(segment.duration for segment in segments),
        least_duration=MIN_SEGMENT_DURATION,
    )
    return (caution,)


def flights_of_longest_boot(flights: Flights) -> Flights:
    """Returns the flights of the boot with the longest flight; times of different boots cannot be compared."""
    boot = boot_number(max(flights, key=len))
    return [flight for flight in flights if boot_number(flight) == boot]


def _flight_with_cautions(learnability: Learnability, *log_cautions: Fact) -> Flight:
    """Returns the flight of a learnable segment with all cautions on it: what to mind with a model learned from it.

    Args:
        learnability: Whether a model can be learned from the segment, with its flight and its own cautions.
        log_cautions: Cautions on the whole log.

    Returns:
        A copy of the flight with all cautions, also as texts in its provenance, which is written to files.

    Raises:
        NotLearnable: The segment is not learnable.
    """
    if not learnability.learnable or learnability.flight is None:
        raise NotLearnable(learnability.reason)
    flight = learnability.flight
    cautions = (*learnability.cautions, *log_cautions)
    provenance = {**flight.provenance, "cautions": [str(caution) for caution in cautions]}
    return replace(flight, provenance=provenance, cautions=cautions)


def choose_vehicle(vehicles: Sequence[Telemetry], requested: str | None = None) -> Telemetry:
    """Chooses one vehicle of a log.

    Args:
        vehicles: All vehicles of the log.
        requested: "system", "system:component" or the number of the vehicle's board. None chooses the only vehicle that
            sends its attitude or, if none does, the only vehicle.

    Returns:
        The vehicle.

    Raises:
        NotLearnable: No vehicle matches, or several do; the fact lists them.
    """
    matching = matching_vehicles(vehicles, requested)
    if len(matching) == 1:
        return matching[0]
    if not vehicles:
        raise NotLearnable(NotLearnableReason.LOG_WITHOUT_VEHICLE)
    reason = NotLearnableReason.NO_SUCH_VEHICLE
    listed_vehicles = vehicles
    if matching:
        reason = NotLearnableReason.SEVERAL_VEHICLES
        listed_vehicles = matching
    raise NotLearnable(
        reason,
        name=requested,
        names=names_of_vehicles(listed_vehicles),
        kinds=[vehicle.vehicle for vehicle in listed_vehicles],
        autopilots=[vehicle.autopilot for vehicle in listed_vehicles],
    )


def names_of_vehicles(vehicles: Sequence[Telemetry]) -> list[str]:
    """Returns the names by which a user chooses one of several vehicles of a log.

    They are MAVLink's ids. In a file of two logs, vehicles may have the same ids; then only the number of the board
    distinguishes them.

    Args:
        vehicles: The vehicles, which are named in this order.
    """
    distinct_ids = {_mavlink_ids(vehicle) for vehicle in vehicles}
    has_same_ids = len(distinct_ids) < len(vehicles)
    names = []
    for vehicle in vehicles:
        names.append(vehicle.board if has_same_ids and vehicle.board else _mavlink_ids(vehicle))
    return names


def matching_vehicles(
    vehicles: Sequence[Telemetry], requested: str | None = None
) -> list[Telemetry]:
    """Selects the vehicles of a log that a user's choice matches.

    Args:
        vehicles: All vehicles of the log.
        requested: "system", "system:component" or the number of a board; None without a choice.

    Returns:
        Those vehicles; without a choice, the vehicles that send their attitude or, if none does, all.
    """
    if requested is not None:
        return [
            vehicle
            for vehicle in vehicles
            if requested in (str(vehicle.system), _mavlink_ids(vehicle), vehicle.board)
        ]
    vehicles_with_attitude = []
    for vehicle in vehicles:
        if any(message_counts(vehicle, ATTITUDE_MESSAGES).values()):
            vehicles_with_attitude.append(vehicle)
    return vehicles_with_attitude or list(vehicles)


def _mavlink_ids(vehicle: Telemetry) -> str:
    """Returns MAVLink's ids of a vehicle, "system:component"."""
    return f"{vehicle.system}:{vehicle.component}"
