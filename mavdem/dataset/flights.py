"""From a log to the Flight a model can be learned from, or the reason why not."""

from collections.abc import Sequence
from dataclasses import replace

from mavdem.dataset.attitude import ATTITUDE_MESSAGES
from mavdem.dataset.learnability import (
    MIN_SEGMENT_DURATION,
    Learnability,
    learnability_of,
    segment_learnabilities,
)
from mavdem.dataset.signals import MIN_STREAM_RATE, Signals
from mavdem.dataset.time_series import message_counts
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.learnability import Caution, Reason
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

    Raises:
        Unreadable: the log cannot be read.
        NotLearnable: it holds no vehicle, or several and none was chosen, or it cannot be learned from.
        ValueError: ``path`` is no path, or an axis or inputs that are none.

    See Also:
        :func:`mavdem.read_segments`: all usable segments; :class:`mavdem.Flight`: what it is; :func:`mavdem.learn`.
    """
    return learnable_flight(read_log(path), axis, vehicle, inputs)[0]


def read_segments(
    path: AnyPath,
    axis: str = "roll",
    vehicle: str | None = None,
    inputs: str | None = None,
) -> Flights:
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
    flights, learnability = usable_segments(
        Signals(choose_vehicle(log.vehicles, vehicle), axis, inputs), log.components
    )
    if not flights:
        raise NotLearnable(learnability.reason)
    return flights


def learnable_flight(
    log: Log,
    axis: str = "roll",
    vehicle: str | None = None,
    inputs: str | None = None,
) -> tuple[Flight, Learnability]:
    """Returns the longest usable segment of a log, as :func:`read_flight` gives it, and whether it is learnable."""
    signals = Signals(choose_vehicle(log.vehicles, vehicle), axis, inputs)
    learnability = learnability_of(signals, log.components)
    return _with_cautions(learnability), learnability


@cached_per_vehicle("axis", "inputs")
def usable_segments(
    signals: Signals, components: tuple[Component, ...] = (), least_rate: float = MIN_STREAM_RATE
) -> tuple[Flights, Learnability]:
    """Returns all usable segments, none if the longest is not learnable; both streams need ``least_rate``, Hz."""
    judged = list(segment_learnabilities(signals, components, least_rate))
    first = judged[0]
    usable = [part for part in judged if part.learnable]
    taken = [part.segment for part in usable]
    lost = [segment.duration for segment in first.segments if segment not in taken]
    left_out = []
    if 0 < len(lost) < len(first.segments):
        left_out = [
            Fact(
                Caution.SEGMENTS_LEFT_OUT,
                count=len(lost),
                segments=len(first.segments),
                duration=sum(lost),
                settled=sum(segment.duration for segment in first.segments),
                least_duration=MIN_SEGMENT_DURATION,
            )
        ]
    flights = [_with_cautions(part, *left_out) for part in usable]
    flights.sort(key=lambda flight: (boot_number(flight), flight.time[0]))
    return tuple(flights), first


def flights_of_longest_boot(flights: Flights) -> Flights:
    """Returns the flights of the longest one's boot: times of another cannot be compared."""
    boot = boot_number(max(flights, key=len))
    return [flight for flight in flights if boot_number(flight) == boot]


def _with_cautions(learnability: Learnability, *further: Fact) -> Flight:
    if not learnability.learnable or learnability.flight is None:
        raise NotLearnable(learnability.reason)
    flight = learnability.flight
    cautions = (*learnability.cautions, *further)
    provenance = {**flight.provenance, "cautions": [str(caution) for caution in cautions]}
    return replace(flight, provenance=provenance, cautions=cautions)


def choose_vehicle(vehicles: Sequence[Telemetry], wanted: str | None = None) -> Telemetry:
    """Returns the one vehicle, or the one ``wanted``: "system", "system:component" or the number of its board.

    One that sends no attitude is no rival.

    Raises NotLearnable: none or several match, which the fact lists.
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
        raise NotLearnable(Reason.LOG_WITHOUT_VEHICLE)
    rivals = matching or vehicles
    # two logs in one, of vehicles with the same ids
    alike = len({_ids(vehicle) for vehicle in rivals}) < len(rivals)
    raise NotLearnable(
        Reason.SEVERAL_VEHICLES if matching else Reason.NO_SUCH_VEHICLE,
        name=wanted,
        names=[rival.board if alike and rival.board else _ids(rival) for rival in rivals],
        kinds=[rival.vehicle for rival in rivals],
        autopilots=[rival.autopilot for rival in rivals],
    )


def _ids(vehicle: Telemetry) -> str:
    return f"{vehicle.system}:{vehicle.component}"
