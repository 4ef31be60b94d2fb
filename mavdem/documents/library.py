"""Models of the JSON documents that the HTTP server exchanges with programs."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from mavdem.containers import JsonValues
from mavdem.documents.document import Document, Error
from mavdem.documents.review import Review
from mavdem.facts.serve import Sharing
from mavdem.fleet.names import MAX_NAME_LETTERS
from mavdem.units import Hertz, Metres, Seconds, Speed, UnixSeconds, with_unit


def _split_at_commas(value: Any) -> Any:
    """Splits a text such as "Loiter,Land", as the index of the library has lists, into its items; lists stay."""
    if isinstance(value, str):
        return [item for item in value.split(",") if item]
    return value


CommaSeparated = Annotated[list[str], BeforeValidator(_split_at_commas)]
"""Type of a field with a list of texts, whose value may be one text with commas."""


class Stage(Document):
    """How far the reading of a log is, and what is known of the flight."""

    id: str
    """of its link, /f/ID"""
    stage: str
    """waiting, reading, judging, learning, drawing, done or failed"""
    problem: str
    """why it cannot be read; empty where it can"""
    headline: str
    """the worst that was found in the log or, of the motors, beside other flights of the vehicle, or how the flight was
    lost"""
    level: str
    """level of the headline: good, watch, bad or unknown"""
    lights: dict[str, str]
    """level by light: motors, vibration, tracking, margins, power, estimator, wind and log"""


class Flight(Stage):
    """A log of the library."""

    name: str
    """of the log"""
    size: Annotated[int, with_unit("B")]
    """of the log"""
    received: UnixSeconds
    """when it was uploaded"""
    sharing: str
    """private, link or public"""
    log_shared: bool
    """whether whoever sees it may download the log"""
    note: str
    """what was written about it"""
    tags: CommaSeparated
    """words that were given to it"""
    repaired: str = ""
    """when its fault was said to be repaired, ISO 8601, UTC; empty where it was not"""
    given_name: str = ""
    """name that was given to the flight; empty without one"""
    vehicle: str
    """what the log calls the vehicle, such as its serial number, or the vehicle that was assigned to the flight"""
    is_vehicle_unnamed: bool = False
    """whether that is a system id only, which says of no two flights that one vehicle flew them"""
    vehicle_name: str = ""
    """name that was given to the vehicle; empty without one"""
    date: str
    """when the flight began, ISO 8601, UTC; empty where that is not known or in the future"""
    simulated: bool = False
    """whether the log shows that a simulator flew"""
    duration: Seconds
    """duration of settled flight"""
    flight_time: Seconds
    """time off the ground, of all flights of the log"""
    distance: Metres
    """length of the path over ground, of all flights of the log"""
    height: Metres
    """largest height above the take-off"""
    next_step: str
    """what to do about it"""
    motor_anomaly: str = ""
    """how the motors differ from those in other flights of the vehicle, a fault or drift; empty where they do not"""
    modes: CommaSeparated
    """flight modes, in order"""
    motor: int | None
    """number of the motor that is suspected, from 1"""
    wind_speed: Speed
    """mean of the wind speeds"""
    wind_low: Speed = None
    """lower end of its 90 % interval"""
    wind_high: Speed = None
    """upper end of its 90 % interval"""
    files: CommaSeparated
    """what was made of it, at /f/ID/FILE; recordings, flight.rrd and flight.mcap, are made when they are asked for"""


class Flights(Document):
    """Flights of the library, the newest first."""

    total: int
    """how many there are"""
    flights: list[Flight]
    """those that were asked for"""


class FlightReview(Document):
    """A flight, and its review."""

    flight: Flight
    """what is listed of it"""
    review: JsonValues | None
    """the document of `mavdem review --json`, which judges the log alone; null before it is done"""


class RefusedLog(Document):
    """An uploaded file that is no log."""

    name: str
    """of the file"""
    error: Error
    """why"""


class Added(Document):
    """What became of the files of an upload."""

    flights: list[Flight]
    """logs, which are read now"""
    refused: list[RefusedLog]
    """files that are none"""


class Progress(Stage):
    """How far the reading of a log is, also in words."""

    words: str
    """the stage in words"""
    step: str = ""
    """step of the stage, in words; empty where there is none"""
    share: float | None = None
    """share of the step that is done; null where it is not known"""
    seconds: Seconds = None
    """how long it has been worked on; null before that"""
    ahead: int = 0
    """logs that are read before it"""
    estimated_end: UnixSeconds | None = None
    """when it will probably have been read, by sizes and durations of logs before it; null where that is not known"""
    has_plots: bool = False
    """whether its page has the plots that need no model"""


class Change(Document):
    """Changes to a flight; keys that are absent stay as they are."""

    given_name: Annotated[str, Field(max_length=MAX_NAME_LETTERS)] = ""
    """name of the flight; empty for that of its log"""
    vehicle_name: Annotated[str, Field(max_length=MAX_NAME_LETTERS)] = ""
    """vehicle of a flight whose log does not identify it; empty to take it away"""
    sharing: Sharing = Sharing.PRIVATE
    """private, link or public"""
    log_shared: bool = False
    """whether whoever sees it may download the log"""
    note: Annotated[str, Field(max_length=4000)] = ""
    """what is to be known of it"""
    tags: Annotated[
        list[Annotated[str, Field(max_length=40, pattern="^[^,]+$")]], Field(max_length=20)
    ] = []
    """words to find it by"""
    repaired: bool = False
    """whether its fault was repaired, so that later flights are not warned of it"""


class VehicleName(Document):
    """The name that is given to a vehicle."""

    vehicle: str
    """what its logs call it, such as its serial number"""
    name: Annotated[str, Field(max_length=MAX_NAME_LETTERS)]
    """name of the vehicle; empty for what its logs call it"""


class Baseline(Document):
    """The healthy flights with which the others of their vehicles are compared."""

    flights: Annotated[list[str], Field(max_length=1000)]
    """ids"""


class StoredBaseline(Baseline):
    """A baseline as it was stored, with what is doubtful about its flights."""

    caution: str
    """which flights have motors to be watched, and what follows; empty where none has"""


class Recordings(Document):
    """How far the recordings of a flight are, flight.rrd for Rerun and flight.mcap for Foxglove."""

    id: str
    """of the flight"""
    stage: str
    """empty before they are asked for; then waiting, reading, learning, recording, done or failed"""
    words: str
    """the stage in words"""
    problem: str
    """why they cannot be made; empty where they can"""


class MessageFields(Document):
    """A message of a log."""

    message: str
    """its name, as MAVLink calls it"""
    name_in_source: str
    """its name in the log"""
    messages: int
    """how many there are"""
    rate: Hertz
    """messages per second without gaps, of the first instance where there are several"""
    first_time: Seconds
    """when the first one was sent, on the autopilot's boot clock"""
    last_time: Seconds
    """when the last one was sent; after a later boot, on that one's clock"""
    fields: list[str]
    """names of its numeric fields"""
    units: list[str]
    """unit of each field as MAVLink's definition writes it, such as rad; empty where it has none, or is the log's"""
    instances: list[int]
    """numbers of its instances; empty where it has none"""


class LogFields(Document):
    """What of a log can be plotted."""

    id: str
    """of the flight"""
    messages: list[MessageFields]
    """by their names"""


class PlottedField(Document):
    """Samples of one field, or of each short interval its least and its largest value."""

    message: str
    """name of the message"""
    field: str
    """name of the field"""
    instance: int | None
    """which instance; null for all of them"""
    count: int
    """samples in the time that was asked for"""
    is_thinned: bool
    """whether they are the extremes of intervals, in the order in which they came"""
    time: Annotated[list[float], with_unit("s")]
    """on the autopilot's boot clock"""
    values: list[float | None]
    """in the unit of the message's definition; null where the log has none"""


class Viewer(Document):
    """A viewer that shows a flight."""

    address: str
    """of its page"""
    data_address: str
    """from which a viewer loads the recording, such as rerun+http://127.0.0.1:9876/proxy"""


ANSWERS = (
    Flights,
    FlightReview,
    Added,
    Progress,
    Change,
    VehicleName,
    Baseline,
    StoredBaseline,
    Recordings,
    LogFields,
    PlottedField,
    Viewer,
    Error,
    Review,
)
"""Models whose schemas the description of the interface has."""
