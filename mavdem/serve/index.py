"""The index of the library: the SQLite table ``entries`` with one row per log, and the class of its rows."""

import hashlib
import json
import secrets
import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from fnmatch import fnmatchcase
from pathlib import Path

from mavdem.assessment.flown_flights import FlownFlight
from mavdem.containers import JsonValues
from mavdem.facts.lights import Light
from mavdem.facts.serve import ListingOrder, Sharing, Stage
from mavdem.facts.urgency import URGENCY_OF_LEVELS, Urgency, urgency_of_headline
from mavdem.fleet.names import content_hash, same_content_sql
from mavdem.fleet.row import GIVEN_BASIS, SYSTEM_ID_BASIS, UNKNOWN, FlightRow, FlightRows
from mavdem.fleet.workers import KEY_HASH_DIGITS

DIGEST_GLOB = "[0-9a-f]" * len(hashlib.sha256().hexdigest())
"""Pattern of a SHA-256 in hexadecimal digits, for file names and for GLOB in SQLite."""

VEHICLE_PAGE_PREFIX = "vehicle_"
"""Beginning of the name of the page of a further vehicle of a log; its system and component follow."""

LINK_BYTES = 16
"""Random bytes in the id of an entry. The id is its link, and 128 bits cannot be guessed."""


@dataclass(frozen=True)
class LibraryEntry:
    """One row of the index: a log of the library, how far it is read, and what lists and searches need of it.

    The fields have the names of the columns. A value that is not known is empty or None. Results are by the log alone;
    ``serve.compared_motors`` adds what a comparison of the motors with other flights of the vehicle shows.
    """

    id: str
    """Random id, which is the last part of the flight's link ``/f/ID``."""
    name: str
    """File name of the log, as it was uploaded."""
    digest: str = ""
    """SHA-256 of the log in hexadecimal digits; empty for a log outside the library, which `mavdem track` has read."""
    path: str = ""
    """Path of the log, relative to the library's folder, or absolute for a log outside the library."""
    size: int = 0
    """Size of the log in bytes; 0 if the log is not kept."""
    kept: int = 0
    """Size of all its result files in bytes."""
    keep: int = 1
    """Whether the log is kept where it cannot be read, 0 or 1."""
    received: float = 0.0
    """UNIX time at which the log was received, s."""
    stage: str = Stage.WAITING
    """How far the log is read, a value of ``Stage``."""
    claimed: str = ""
    """Name of the server that reads the log now; empty if none does."""
    recording_stage: str = ""
    """How far the making of its recordings is, a value of ``Stage``; empty if nobody waits for them."""
    recording_problem: str = ""
    """Why its recordings could not be made, one sentence; empty where that was not tried or succeeded."""
    problem: str = ""
    """Why the log cannot be read, one sentence; empty where it can."""
    sharing: str = Sharing.PRIVATE
    """Who may see the flight, a value of ``Sharing``."""
    log_shared: int = 0
    """Whether those who may see the flight may also download the log, 0 or 1."""
    note: str = ""
    """The owner's note."""
    tags: str = ""
    """The owner's tags, separated by commas."""
    repaired: str = ""
    """When a user stated that the fault of this flight was repaired, ISO 8601, UTC; empty where nobody did."""
    vehicle: str = ""
    """Name of the vehicle."""
    vehicle_basis: str = ""
    """What the name of the vehicle is made of, as the field of ``FlightRow`` says it."""
    frame: str = ""
    """Kind of the vehicle's frame, such as "QUADROTOR"."""
    autopilot: str = ""
    """MAV_AUTOPILOT without its prefix."""
    date: str = ""
    """When the flight began, ISO 8601, UTC; empty where the log has no date, or one in the future."""
    future_date: str = ""
    """When the flight began by a clock that was ahead when the log was read, ISO 8601, UTC; empty otherwise."""
    simulated: int = 0
    """Whether the log shows that the flight was simulated, 0 or 1."""
    duration: float | None = None
    """Duration of settled flight, s."""
    flight_time: float | None = None
    """Time off the ground, all flights and hops of the log together, s."""
    distance: float | None = None
    """Length of the path over ground, all flights of the log together, m."""
    height: float | None = None
    """Largest height above the take-off, m."""
    flights: str = "[]"
    """JSON list of the flights of the log, each an object with the fields of ``FlownFlight``."""
    headline: str = ""
    """The most important result of the flight, one sentence."""
    level: str = ""
    """Level of the headline: good, watch, bad or unknown; empty before the log is judged."""
    urgency: int = Urgency.UNKNOWN
    """How urgently the flight needs a look, a value of ``Urgency``."""
    next_step: str = ""
    """What the pilot should do next, one sentence."""
    motors: str = ""
    """Level of the light "motors"; so for the seven lights that follow."""
    vibration: str = ""
    """Level of the light "vibration"."""
    tracking: str = ""
    """Level of the light "tracking"."""
    margins: str = ""
    """Level of the light "margins"."""
    power: str = ""
    """Level of the light "power"."""
    estimator: str = ""
    """Level of the light "estimator"."""
    wind: str = ""
    """Level of the light "wind"."""
    log: str = ""
    """Level of the light "log"."""
    light_sentences: str = "{}"
    """JSON object of what each light states by the log alone: sentence by name of the light."""
    light_figures: str = "{}"
    """JSON object of the figure of each light by the log alone, such as "1.9 m/s²", by name of the light."""
    modes: str = ""
    """Flight modes in order of their first use, separated by commas."""
    motor: int | None = None
    """Number of the motor that is suspected of a fault, or that the light of the motors warns of, from 1."""
    wind_speed: float | None = None
    """Mean of the wind speeds, m/s; none where still air is likely as well, or the speed is not identifiable."""
    wind_low: float | None = None
    """Lower end of the 90 % interval of that speed, m/s: 0 where still air is likely; none without such an interval."""
    wind_high: float | None = None
    """Upper end of that interval, m/s."""
    content: str = ""
    """Hash of the content of a log outside the library, by which the flight's name is found; empty if not known."""
    gains: str = "{}"
    """JSON object of the autopilot's control parameters: value by name."""
    files: str = ""
    """Names of the result files and of the recordings that can be made, separated by commas; for a log outside the
    library, the path of its page."""

    @property
    def lights(self) -> dict[str, str]:
        """The level of each light by its name; empty before the log is judged."""
        if not self.level:
            return {}
        return {str(light): getattr(self, light) for light in Light}

    @property
    def is_vehicle_unnamed(self) -> bool:
        """Whether nothing says which vehicle flew: the log has a system id alone, and nobody assigned a vehicle."""
        return self.vehicle in ("", UNKNOWN) or self.vehicle_basis == SYSTEM_ID_BASIS

    @property
    def is_vehicle_assigned(self) -> bool:
        """Whether a user assigned the vehicle to this flight, since its log does not identify it."""
        return self.vehicle_basis == GIVEN_BASIS

    @property
    def flown_flights(self) -> list[FlownFlight]:
        """The flights of the log from take-off to landing, in order of boot and time."""
        return [FlownFlight(**values) for values in json.loads(self.flights)]

    @property
    def content_hash(self) -> str:
        """Hash of the log's content, by which names of flights are stored; empty if it is not known."""
        return self.digest[:KEY_HASH_DIGITS] or self.content

    @property
    def file_names(self) -> list[str]:
        """Names of the result files."""
        return self.files.split(",") if self.files else []

    @property
    def other_vehicles(self) -> list[str]:
        """The other vehicles in the log, each by the MAVLink ids of its system and component, such as "3_1".

        Each has a page of its own, whose file is named by these ids.
        """
        pages = [name for name in self.file_names if name.startswith(VEHICLE_PAGE_PREFIX)]
        return [Path(name).stem.removeprefix(VEHICLE_PAGE_PREFIX) for name in pages]

    @property
    def is_done(self) -> bool:
        """Whether reading has ended, with results or without."""
        return self.stage in (Stage.DONE, Stage.FAILED)


COLUMNS = tuple(field.name for field in fields(LibraryEntry))
"""Names of the columns of the table ``entries``."""

CONTENT_HASH_SQL = (
    f"iif(entries.digest <> '', substr(entries.digest, 1, {KEY_HASH_DIGITS}), entries.content)"
)
"""SQL expression of :attr:`LibraryEntry.content_hash`."""

IS_VEHICLE_UNNAMED_SQL = (
    f"(entries.vehicle in ('', '{UNKNOWN}') or entries.vehicle_basis = '{SYSTEM_ID_BASIS}')"
)
"""SQL condition of :attr:`LibraryEntry.is_vehicle_unnamed`."""

INCOMPLETE_SQL = (
    "(entries.digest = '' and entries.gains in ('', '{}') and entries.modes = ''"
    f" and entries.flight_time is null and entries.stage = '{Stage.DONE}')"
)
"""SQL condition of flights without flight time, modes and gains, as earlier versions of `mavdem track` stored them.

A log that has none of these, which the present version has read, meets it too: see ``COMPLETE_ROW_SQL``.
"""

COMPLETE_ROW_SQL = (
    "(flights.file is not null and json_valid(flights.row)"
    " and json_extract(flights.row, '$.control_parameters') is not null)"
)
"""SQL condition of rows of a fleet that a version of `mavdem track` wrote which stores flight time, modes and gains."""

SQL_ORDERS = {
    ListingOrder.UPLOAD: "received desc, rowid desc",
    ListingOrder.FLIGHT: "date desc, received desc, rowid desc",
    ListingOrder.TIME: "flight_time desc, received desc, rowid desc",
    ListingOrder.DISTANCE: "distance desc, received desc, rowid desc",
    ListingOrder.HEIGHT: "height desc, received desc, rowid desc",
    ListingOrder.URGENCY: "urgency, received desc, rowid",
    ListingOrder.VEHICLE: "vehicle desc, date desc, received desc, rowid desc",
    ListingOrder.WIND: "wind_speed desc, received desc, rowid desc",
}
"""SQL of each order, the newest, largest or most urgent first. An unknown date or vehicle is an empty text, and an
unknown number null, which come last."""

INDEXES_SQL = Path(__file__).with_suffix(".sql").read_text(encoding="utf-8")
"""SQL that creates the table's indexes."""


def vehicle_page_name(vehicle: str) -> str:
    """Returns the file name of the page of a further vehicle of a log.

    Args:
        vehicle: MAVLink ids of its system and component, such as "3_1".
    """
    return f"{VEHICLE_PAGE_PREFIX}{vehicle}.html"


def create_or_update_table(db: sqlite3.Connection) -> None:
    """Creates the table ``entries`` with its indexes, or adds the columns that an earlier version did not have.

    Columns have no types, so that SQLite stores values unchanged. Their default is '', or null if the default of the
    field is None; :func:`entry_from_row` replaces empty ones by the defaults of the fields.

    Args:
        db: connection to the SQLite file of the library, which also has the tables of the fleet. Its ``row_factory``
            is ``sqlite3.Row``, by which values of a row are found by name.
    """
    definitions = {}
    for column in fields(LibraryEntry):
        default = "null" if column.default is None else "''"
        definitions[column.name] = f"{column.name} default {default}"
    db.execute(f"create table if not exists entries ({', '.join(definitions.values())})")
    existing_columns = {column["name"] for column in db.execute("pragma table_info(entries)")}
    for name, definition in definitions.items():
        if name not in existing_columns:
            db.execute(f"alter table entries add column {definition}")
    db.executescript(INDEXES_SQL)
    if existing_columns and "vehicle_basis" not in existing_columns:
        _fill_vehicle_columns(db)
    if existing_columns and "urgency" not in existing_columns:
        _fill_urgency_column(db)


def _fill_vehicle_columns(db: sqlite3.Connection) -> None:
    """Fills three columns that indexes of earlier versions lacked: basis of the vehicle's name, frame, autopilot.

    The SQLite file also has the fleet's table "flights", with a row in JSON for each axis of a log. The values come
    from a row of the same vehicle and log; the log is recognised by the hash of its content.

    Args:
        db: connection to the SQLite file of the library, which has the fleet's rows in the table "flights".
    """
    columns = ("vehicle_basis", "frame", "autopilot")
    extracted_values = ", ".join(f"json_extract(row, '$.{column}')" for column in columns)
    db.execute(
        f"""update entries set ({", ".join(columns)}) =
        (select {extracted_values} from flights where flights.vehicle = entries.vehicle and json_valid(row)
        and {same_content_sql(CONTENT_HASH_SQL)} limit 1)
        where vehicle <> ''"""
    )


def _fill_urgency_column(db: sqlite3.Connection) -> None:
    """Fills the column with the urgency in an index of an earlier version, which had only the level of the headline.

    Args:
        db: connection to the SQLite file of the library.
    """
    for level, urgency in URGENCY_OF_LEVELS.items():
        db.execute("update entries set urgency = ? where level = ?", [urgency, level])
    db.execute("update entries set urgency = ? where level = ''", [Urgency.UNKNOWN])


def insert_entry(db: sqlite3.Connection, entry: LibraryEntry) -> None:
    """Adds the row of an entry to the table."""
    names = ", ".join(COLUMNS)
    placeholders = ", ".join(f":{name}" for name in COLUMNS)
    db.execute(f"insert into entries ({names}) values ({placeholders})", vars(entry))


def find_by_digest(db: sqlite3.Connection, digest: str) -> LibraryEntry | None:
    """Returns the entry of the log with this SHA-256, or None if the library has no such log."""
    row = db.execute("select * from entries where digest = ?", [digest]).fetchone()
    return None if row is None else entry_from_row(row)


def entry_from_row(row: sqlite3.Row) -> LibraryEntry:
    """Creates an index entry from a row of the SQL table ``entries``.

    Empty columns get the defaults of the fields. The digest becomes part of paths, which must not lead out of the
    library's folder even if the index was tampered with; so a digest that is not a SHA-256 is dropped.

    Args:
        row: a row of the table.

    Returns:
        The entry; its digest is empty if the digest of the row was dropped.
    """
    fields = {}
    for name in COLUMNS:
        if row[name] not in (None, ""):
            fields[name] = row[name]
    entry = LibraryEntry(**fields)
    if fnmatchcase(str(entry.digest), DIGEST_GLOB):
        return entry
    return replace(entry, digest="")


def new_id() -> str:
    """Returns a new random id for an entry, which cannot be guessed and is valid in a URL."""
    return secrets.token_urlsafe(LINK_BYTES)


def entry_of_fleet_log(file: str, rows: FlightRows) -> LibraryEntry:
    """Makes the index entry of a log that ``mavdem track`` has read, so that the server lists it with its own logs.

    The log stays where it is. The digest of its bytes, under which the server keeps copies and results, is left empty:
    it has neither. The name of the flight is found by ``content``, the hash in the key of the fleet's rows.

    Args:
        file: path of the log, as the fleet's rows have it.
        rows: the fleet's rows of this log, at least one; the page of its first flight is the only file of the entry.

    Returns:
        An entry with a new id.
    """
    first_row = rows[0]
    columns = columns_of_flight(rows)
    return LibraryEntry(
        new_id(),
        Path(file).name,
        path=file,
        size=_size_of_log(first_row),
        received=0.0 if first_row.past_date is None else first_row.past_date.timestamp(),
        stage=Stage.DONE if first_row.has_flight else Stage.FAILED,
        problem="" if first_row.has_flight else first_row.status,
        files=first_row.page or "",
        content=content_hash(first_row.key),
        **columns,
    )


def _size_of_log(row: FlightRow) -> int:
    """Returns the size of a row's log in bytes, with which the key of its content ends; 0 if it is not known."""
    size = row.key.rpartition("-")[2]
    return int(size) if size.isdecimal() else 0


def columns_of_flight(rows: Sequence[FlightRow]) -> JsonValues:
    """Returns the columns of the index that follow from the fleet's rows of a log.

    Args:
        rows: rows of the log, one per vehicle and axis, at least one. All values but the motor are taken from the
            first.

    Returns:
        Values by the names of the columns.
    """
    first_row = rows[0]
    lights = {str(light): getattr(first_row, f"light_{light}") or "" for light in Light}
    wind_low, wind_high = first_row.wind_speed_interval or (None, None)
    return {
        "vehicle": first_row.vehicle,
        "vehicle_basis": first_row.vehicle_basis or "",
        "frame": first_row.frame or "",
        "autopilot": first_row.autopilot or "",
        **_date_columns(first_row),
        "simulated": first_row.simulated or 0,
        "duration": first_row.duration,
        "flight_time": first_row.flight_time,
        "distance": first_row.distance,
        "height": first_row.height,
        "modes": ",".join(first_row.modes or ()),
        "gains": first_row.control_parameters or "{}",
        "headline": first_row.headline or "",
        "level": first_row.headline_level or "",
        "urgency": int(urgency_of_headline(first_row.headline_level, first_row.headline_rank)),
        "motor": _suspect_motor(rows),
        "wind_speed": first_row.wind_speed,
        "wind_low": wind_low,
        "wind_high": wind_high,
        **lights,
    }


def _date_columns(row: FlightRow) -> dict[str, str]:
    """Returns the date of a flight in one of two columns, and an empty text in the other.

    Args:
        row: a row of the flight in the table of flights.

    Returns:
        The columns by name: ``date`` has a date in the past; ``future_date`` has one that
        had not come when the log was read, since the clock was wrong or simulated. Both are empty without a date.
    """
    columns = {"date": "", "future_date": ""}
    if row.date is not None:
        column = "future_date" if row.past_date is None else "date"
        columns[column] = row.date.isoformat(timespec="seconds")
    return columns


def _suspect_motor(rows: Sequence[FlightRow]) -> int | None:
    """Returns the number of the motor that a log suspects of a fault.

    Args:
        rows: rows of the log in the fleet's table, one per vehicle and axis. The first with such a motor counts.

    Returns:
        The number, from 1, of a motor that failed; otherwise of one that other flights of the vehicle show to be weak;
        otherwise of one that the light of the motors warns of. None without any.
    """
    for column in ("failed_motor", "suspect_motor", "watched_motor"):
        for row in rows:
            motor: int | None = getattr(row, column)
            if motor is not None:
                return motor
    return None
