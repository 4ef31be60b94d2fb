"""Names that users have given to vehicles and flights, in tables of the fleet's store.

A vehicle is known by what its log calls it, such as the serial number of its board, and a flight by the hash of its
log's content. Names are kept beside the rows, so that they survive another reading, a move or another upload of a log.
"""

import re
import sqlite3
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

from mavdem.fleet.row import FlightRow, FlightRows

MAX_NAME_LETTERS = 60
"""Letters of a name that somebody gives: a line of a table on a phone has room for half of it."""


@dataclass(frozen=True)
class GivenNames:
    """The names that were given to vehicles and flights; those without one keep the name that their log has."""

    vehicles: Mapping[str, str] = field(default_factory=dict)
    """Name of each named vehicle, by what its logs call it."""
    flights: Mapping[str, str] = field(default_factory=dict)
    """Name of each named flight, by the hash of its log's content."""

    logged_vehicles: frozenset[str] = frozenset()
    """What the logs of the fleet call their vehicles, with those that have no other name."""

    @cached_property
    def _labels_of_vehicles(self) -> dict[str, str]:
        """The label that is shown for each named vehicle, by what its logs call it; no two labels are the same.

        A label is the given name. If another vehicle might have the same label, the name in the logs follows in
        parentheses.
        """
        # The number of vehicles that may be shown by each text: what the logs call the vehicle, its given name,
        # or the given name with the other one in parentheses. A text of more than one vehicle is ambiguous.
        vehicle_counts = Counter({*self.logged_vehicles, *self.vehicles})
        for vehicle, name in self.vehicles.items():
            # A name that equals the one in the logs was counted for this vehicle already.
            further_texts = {name, f"{name} ({vehicle})"} - {vehicle}
            vehicle_counts.update(further_texts)
        labels: dict[str, str] = {}
        # Vehicles without a given name are shown by the one in their logs.
        used_labels = set(self.logged_vehicles - self.vehicles.keys())
        for vehicle, name in sorted(self.vehicles.items()):
            label = name
            is_ambiguous = vehicle_counts[name] > 1
            if is_ambiguous:
                label = f"{name} ({vehicle})"
            # Parentheses in names can make two such labels the same.
            while label in used_labels:
                label = f"{label} ({vehicle})"
            labels[vehicle] = label
            used_labels.add(label)
        return labels

    def vehicle(self, vehicle: str) -> str:
        """Returns the name of a vehicle to show to users: the name it was given, otherwise what its logs call it.

        A given name only serves display: vehicles are distinguished by what their logs call them.

        Args:
            vehicle: what the logs call the vehicle.
        """
        return self._labels_of_vehicles.get(vehicle, vehicle)

    def rows_with_given_names(self, rows: Iterable[FlightRow]) -> FlightRows:
        """Replaces the names of vehicles by those that users gave them, for display.

        Rows must be grouped by vehicle before, by the names in the logs: users may give two vehicles the same name.

        Args:
            rows: rows of the fleet's table, one for each axis of each flight.

        Returns:
            The rows in the same order. Rows of vehicles with a given name are copies; the others are the same objects.
        """
        labelled_rows = []
        for row in rows:
            if row.vehicle in self.vehicles:
                row = replace(row, vehicle=self.vehicle(row.vehicle))
            labelled_rows.append(row)
        return labelled_rows

    def flight(self, row: FlightRow) -> str:
        """Returns the name that was given to the flight of a row; empty without one."""
        return self.flights.get(content_hash(row.key), "")


NO_NAMES = GivenNames()
"""The names of a fleet in which nobody has given any."""


def content_hash(key: str) -> str:
    """Returns the hash in the key of a log's content, which is followed by the size of the content."""
    return key.partition("-")[0]


def same_content_sql(content: str) -> str:
    """Returns an SQL condition that selects the rows of the table "flights" by the hash of their log's content.

    The column ``log`` has the hash, a hyphen and the size. The full stop follows the hyphen in ASCII, so that all texts
    that begin with the hash and a hyphen lie in this range. A comparison, other than a pattern, uses the column's
    index.

    Args:
        content: SQL expression of the hash, which is in the condition twice.

    Returns:
        The condition, such as ``log > '1f3a' || '-' and log < '1f3a' || '.'``.
    """
    return f"log > {content} || '-' and log < {content} || '.'"


def plain_name(text: str) -> str:
    """Returns a name that a user has typed in the form in which it is stored: one printable line of limited length.

    Args:
        text: name as it was typed. Several spaces and line breaks become one space.

    Returns:
        At most ``MAX_NAME_LETTERS`` characters; empty if no character of the text can be printed.
    """
    single_line = re.sub(r"\s+", " ", text).strip()
    printable_letters = [letter for letter in single_line if letter.isprintable()]
    name = "".join(printable_letters[:MAX_NAME_LETTERS])
    # The cut may leave a space at the end.
    return name.rstrip()


def read_names(db: sqlite3.Connection) -> GivenNames:
    """Reads all names that users gave to vehicles and flights.

    Args:
        db: the SQLite database of the fleet's store.

    Returns:
        The names, with what the logs of the fleet call their vehicles.
    """
    vehicles = dict(db.execute("select vehicle, name from vehicle_names").fetchall())
    flights = dict(db.execute("select content, name from flight_names").fetchall())
    logged_vehicles = db.execute("select distinct vehicle from flights")
    return GivenNames(vehicles, flights, frozenset(vehicle for (vehicle,) in logged_vehicles))


def store_vehicle_name(db: sqlite3.Connection, vehicle: str, name: str) -> None:
    """Stores the name given to a vehicle, or deletes it.

    Args:
        db: the connection to the store of a fleet.
        vehicle: name of the vehicle in its logs.
        name: the name, as :func:`plain_name` returns it; empty to delete it.
    """
    db.execute("delete from vehicle_names where vehicle = ?", [vehicle])
    if name:
        db.execute("insert into vehicle_names values (?, ?)", [vehicle, name])


def store_flight_name(db: sqlite3.Connection, content: str, name: str) -> None:
    """Stores the name given to a flight, or deletes it.

    Args:
        db: the connection to the store of a fleet.
        content: hash of the content of its log.
        name: the name, as :func:`plain_name` returns it; empty to delete it.
    """
    db.execute("delete from flight_names where content = ?", [content])
    if name:
        db.execute("insert into flight_names values (?, ?)", [content, name])
