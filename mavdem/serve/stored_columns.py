"""All numeric columns of a log in one file, which a worker process writes and the server maps into memory.

The columns follow each other in the file as they are in memory. A second file, JSON, lists for each vehicle of the log
its messages and where in the file each of their columns begins.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.containers import JsonValues
from mavdem.errors import Refusal, Unreadable
from mavdem.export.fields import numeric_messages
from mavdem.facts import Fact
from mavdem.facts.fleet import ReadingFact
from mavdem.facts.serve import RefusalReason
from mavdem.fleet.workers import LogRows
from mavdem.ingest.all_messages import with_all_messages
from mavdem.ingest.telemetry import Columns, Telemetry
from mavdem.serve.reading import read_stored_log
from mavdem.serve.recordings import vehicle_of_page

COLUMNS_FILE = "columns.bin"
"""Name of the file with the columns."""

VEHICLES_FILE = "vehicles.json"
"""Name of the file with what is listed of each vehicle; the first one is that of the flight's page."""

MAX_FIELDS = 20_000
"""Fields of all vehicles of a log, at most. The largest logs at hand, of PX4 at full rate, have 1600; a hostile log of
a few hundred kilobytes can define half a million, whose list alone would take the server's memory."""

MAX_COLUMN_BYTES = 1 << 30
"""Bytes of all columns of a log on the disk, at most. Logs of 35 MB have columns of 40 MB."""

ALIGNMENT = 8
"""Bytes at whose multiples columns begin: no number is larger, and NumPy is slow with numbers that are not aligned."""


NUMERIC_KINDS = "biuf"
"""Kinds of NumPy's types whose columns are kept: truth values, integers with and without a sign, floating point."""


class StoredColumn(NamedTuple):
    """Where a column is in the file."""

    begin: int
    """Position of its first byte."""
    type: str
    """Type of its elements, as NumPy writes it: "<f8"."""
    shape: tuple[int, ...]
    """Number of messages, and for an array the number of its elements."""


class StoredVehicle(NamedTuple):
    """What is listed of a vehicle of a log."""

    vehicle: str
    """``SYSTEM_COMPONENT``."""
    messages: list[JsonValues]
    """Its messages, ``MessageFields`` as dictionaries."""
    source_names: dict[str, str]
    """The names of messages in the log, by those in MAVLink."""
    columns: dict[str, dict[str, StoredColumn]]
    """Its columns by message and field."""


class StoredLog(NamedTuple):
    """The columns of a log, as ``write_columns`` wrote them."""

    vehicles: list[StoredVehicle]
    """The vehicles of the log, that of the flight's page first."""
    data: NDArray[np.uint8]
    """Bytes of the file of columns, mapped into memory."""

    def vehicle(self, name: str) -> StoredVehicle:
        """Returns the entry of a vehicle in the list of stored vehicles.

        Args:
            name: ``SYSTEM_COMPONENT``; empty for the first one.

        Raises:
            Refusal: the log has no such vehicle.
        """
        for vehicle in self.vehicles:
            if name in ("", vehicle.vehicle):
                return vehicle
        raise Refusal(RefusalReason.NO_SUCH_FIELD, reason=f"the log has no vehicle {name}")

    def telemetry(self, name: str) -> Telemetry:
        """Returns a vehicle with its messages. A column is read from the disk when it is used.

        Args:
            name: ``SYSTEM_COMPONENT`` of the vehicle; empty for the first one.

        Raises:
            Refusal: the log has no such vehicle.
        """
        vehicle = self.vehicle(name)
        return Telemetry(
            # Whoever plots a field needs the messages only: what identifies the vehicle is not stored with them.
            system=0,
            component=0,
            vehicle="",
            autopilot="",
            messages=_MappedMessages(self.data, vehicle.columns),
            source_names=vehicle.source_names,
        )


def write_columns(
    folder: Path, document: Path | None, path: Path, key: str, page: object
) -> LogRows:
    """Reads a log and writes all its numeric columns into one file, and a list of them into another.

    Worker processes call a ``ReadLog`` function with the last three arguments; the caller binds the first two
    (``functools.partial``). ``open_columns`` reads both files.

    Args:
        folder: the folder for the files.
        document: path of the document that names the vehicle of the flight's page; None, or one that does not exist,
            for the first vehicle of the log.
        path: path of the log.
        key: key of the log's content, which is not used.
        page: maker of a page, which is not used.

    Returns:
        No rows and no pages: both files are the result.

    Raises:
        Unreadable: the log cannot be read, or has more than ``MAX_FIELDS`` fields or ``MAX_COLUMN_BYTES`` bytes.
    """
    log = read_stored_log(path)
    first_vehicle = log.vehicles[0]
    if document is not None and document.is_file():
        first_vehicle = vehicle_of_page(log, document)
    other_vehicles = [vehicle for vehicle in log.vehicles if vehicle is not first_vehicle]
    stored_vehicles = []
    field_count = 0
    with Path(folder, COLUMNS_FILE).open("wb") as file:
        for vehicle in [first_vehicle, *other_vehicles]:
            telemetry = with_all_messages(vehicle, path)
            # The columns are counted first, since listing half a million fields would take minutes.
            for columns in telemetry.messages.values():
                field_count += _numeric_columns(columns)
            if field_count > MAX_FIELDS:
                fact = Fact(ReadingFact.FIELDS_TOO_MANY, count=field_count, limit=MAX_FIELDS)
                raise Unreadable(fact)
            stored_vehicles.append(_written_vehicle(telemetry, file))
    Path(folder, VEHICLES_FILE).write_text(json.dumps(stored_vehicles), "utf-8")
    return LogRows(rows=[], pages={})


def open_columns(folder: Path) -> StoredLog:
    """Returns the columns of a log from the folder to which ``write_columns`` wrote them.

    Only the list of columns is read. The file with their values is mapped into memory, so that the operating system
    reads the columns that are used.

    Args:
        folder: the folder with the columns and their list.

    Returns:
        The vehicles, the one of the flight's page first, and the mapped file.
    """
    vehicles = []
    for vehicle_values in json.loads(Path(folder, VEHICLES_FILE).read_text("utf-8")):
        # JSON stores named tuples as lists.
        vehicle = StoredVehicle(*vehicle_values)
        columns: dict[str, dict[str, StoredColumn]] = {}
        for message, stored_fields in vehicle.columns.items():
            columns[message] = {}
            for name, column_values in stored_fields.items():
                columns[message][name] = StoredColumn(*column_values)
        vehicles.append(vehicle._replace(columns=columns))
    path = folder / COLUMNS_FILE
    # An empty file cannot be mapped.
    data = np.memmap(path, np.uint8, "r") if path.stat().st_size else np.zeros(0, np.uint8)
    return StoredLog(vehicles, data)


def _numeric_columns(columns: Columns) -> int:
    """Returns the number of numeric columns of a message, each element of an array by itself."""
    count = 0
    for values in columns.values():
        if values.dtype.kind in NUMERIC_KINDS:
            count += 1 if values.ndim == 1 else values.shape[1]
    return count


def _written_vehicle(telemetry: Telemetry, file: BinaryIO) -> StoredVehicle:
    """Appends the columns of a vehicle to the file of columns, each at an aligned offset.

    Only numeric columns are written: truth values, integers and floating-point numbers.

    Args:
        telemetry: messages of the vehicle.
        file: the file of columns, open for writing.

    Returns:
        Name and messages of the vehicle, with offset, type and shape of each column.

    Raises:
        Unreadable: the columns take more than ``MAX_COLUMN_BYTES``.
    """
    stored_columns: dict[str, dict[str, StoredColumn]] = {}
    for message, columns in telemetry.messages.items():
        stored_columns[message] = {}
        for name, values in columns.items():
            if values.dtype.kind not in NUMERIC_KINDS:
                continue
            if file.tell() + values.nbytes > MAX_COLUMN_BYTES:
                limit = MAX_COLUMN_BYTES >> 20
                raise Unreadable(Fact(ReadingFact.COLUMNS_TOO_LARGE, memory_limit=limit))
            stored_columns[message][name] = StoredColumn(
                file.tell(), values.dtype.str, values.shape
            )
            file.write(np.ascontiguousarray(values).data)
            # Zeros fill the file up to the aligned beginning of the next column.
            file.write(bytes(-file.tell() % ALIGNMENT))
    return StoredVehicle(
        vehicle=f"{telemetry.system}_{telemetry.component}",
        messages=[message._asdict() for message in numeric_messages(telemetry)],
        source_names=dict(telemetry.source_names),
        columns=stored_columns,
    )


class _MappedMessages(Mapping[str, Columns]):
    """The messages of one vehicle of a file of columns; of each column only what is used is read from the disk."""

    def __init__(
        self, data: NDArray[np.uint8], columns: Mapping[str, Mapping[str, StoredColumn]]
    ) -> None:
        """Takes the file.

        Args:
            data: its bytes, mapped into memory.
            columns: places of the columns in the file, by message and field.
        """
        self._data = data
        self._columns = columns

    def __getitem__(self, message: str) -> Columns:
        """Returns the columns of a message, as views of the file."""
        views = {}
        for name, column in self._columns[message].items():
            dtype = np.dtype(column.type)
            size = dtype.itemsize * int(np.prod(column.shape))
            column_bytes = self._data[column.begin : column.begin + size]
            views[name] = column_bytes.view(dtype).reshape(column.shape)
        return views

    def __iter__(self) -> Iterator[str]:
        """Iterates over the names of the messages."""
        return iter(self._columns)

    def __len__(self) -> int:
        """Returns the number of messages."""
        return len(self._columns)
