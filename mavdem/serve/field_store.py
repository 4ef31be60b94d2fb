"""Any field of a log of the library: a worker process reads the log once, the server reads columns of what it wrote.

The first request for a flight has its log read within the limits of every log, which takes seconds. The worker writes
all columns into one file, uncompressed, so that each further request reads a single message of it. The files of the
flights that were asked for last are kept until the server ends.
"""

import json
import shutil
import tempfile
import threading
import zipfile
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from mavdem.containers import JsonValues
from mavdem.errors import Refusal
from mavdem.export.fields import FieldSamples, messages_of, samples_of
from mavdem.facts.serve import Crowd, Request
from mavdem.fleet.workers import Job, JobLimits, JobOutcome, LogReader, LogRows, ReadLog
from mavdem.ingest.all_messages import with_all_messages
from mavdem.ingest.telemetry import Columns, Telemetry
from mavdem.results import REPORT_FILE
from mavdem.serve.reading import read_stored_log
from mavdem.serve.recordings import vehicle_of_page
from mavdem.serve.stored_files import RESULTS

MAX_KEPT_LOGS = 4
"""Logs whose columns are kept, those that were asked for last: each takes up to a log's memory limit on the disk."""

MAX_WAITING_REQUESTS = 8
"""Requests that wait for columns at a time: each takes a thread of the server, which has forty."""

COLUMNS_FILE = "columns.npz"
"""Name of the file with the columns, in NumPy's format without compression."""

VEHICLES_FILE = "vehicles.json"
"""Name of the file with what is listed of each vehicle; the first one is that of the flight's page."""


DEFAULT_LIMITS = JobLimits()
"""Time and memory for reading a log whose fields are plotted, where the command line sets none."""


class Reader(Protocol):
    """Reads logs, one at a time, such as ``LogReader``."""

    def read(self, job: Job, limits: JobLimits, read: ReadLog) -> JobOutcome | None:
        """Returns the outcome of reading a log by a function; None where that was given up."""

    def stop(self) -> None:
        """Ends the reading."""


class FieldRequest(NamedTuple):
    """A field of a message that somebody wants to see."""

    message: str
    """Name of the message, as MAVLink or as the log calls it."""
    field: str
    """Name of one of its fields."""
    instance: int | None = None
    """Which of several equal sensors or outputs; None for all of them."""
    boot: int = 0
    """After which boot of the autopilot, from 0."""
    vehicle: str = ""
    """``SYSTEM_COMPONENT`` of a vehicle of the log; empty for that of the flight's page."""


class FieldStore:
    """The columns of the logs that were asked for last, for all threads of one server."""

    def __init__(self, limits: JobLimits = DEFAULT_LIMITS, reader: Reader | None = None) -> None:
        """Starts no process before the first request.

        Args:
            limits: time and memory for reading one log.
            reader: reads one log at a time; None for a process of its own.
        """
        self._limits = limits
        self._is_stopping = threading.Event()
        self._reader = reader or LogReader(self._is_stopping.is_set)
        self._lock = threading.Lock()
        self._waiting = threading.BoundedSemaphore(MAX_WAITING_REQUESTS)
        # Folders by the path of the log, the one that was asked for last at the end.
        self._folders: OrderedDict[Path, Path] = OrderedDict()
        self._parent: Path | None = None

    def messages(self, log: Path, vehicle: str = "") -> list[JsonValues]:
        """Lists the messages of a log with their fields and instances.

        Args:
            log: path of the log.
            vehicle: ``SYSTEM_COMPONENT`` of a vehicle of the log; empty for that of the flight's page.

        Raises:
            Refusal: the log cannot be read, has no such vehicle, or too many requests wait.
        """
        with self._folder(log) as folder:
            listed: list[JsonValues] = _vehicle_values(folder, vehicle)["messages"]
            return listed

    def samples(self, log: Path, request: FieldRequest) -> FieldSamples:
        """Returns all samples of one field.

        Args:
            log: path of the log.
            request: the field.

        Raises:
            Refusal: the log cannot be read, has no such field, or too many requests wait.
        """
        with self._folder(log) as folder:
            values = _vehicle_values(folder, request.vehicle)
            with np.load(folder / COLUMNS_FILE) as columns:
                telemetry = Telemetry(
                    system=0,
                    component=0,
                    vehicle="",
                    autopilot="",
                    messages=_StoredMessages(columns, values),
                    source_names=values["source_names"],
                )
                try:
                    return samples_of(
                        telemetry, request.message, request.field, request.instance, request.boot
                    )
                except ValueError as error:
                    raise Refusal(Request.NO_SUCH_FIELD, because=str(error)) from None

    def stop(self) -> None:
        """Ends the process, whatever it does, and removes all columns."""
        self._is_stopping.set()
        with self._lock:
            self._reader.stop()
            if self._parent is not None:
                shutil.rmtree(self._parent, ignore_errors=True)

    @contextmanager
    def _folder(self, log: Path) -> Iterator[Path]:
        """Yields the folder with the columns of a log, which nobody removes meanwhile.

        Raises:
            Refusal: the log cannot be read, or too many requests wait.
        """
        if not self._waiting.acquire(blocking=False):
            raise Refusal(Request.UPLOADS_TOO_MANY, count=MAX_WAITING_REQUESTS, name=Crowd.FIELDS)
        try:
            with self._lock:
                if log not in self._folders:
                    self._folders[log] = self._read(log)
                self._folders.move_to_end(log)
                while len(self._folders) > MAX_KEPT_LOGS:
                    _, oldest = self._folders.popitem(last=False)
                    shutil.rmtree(oldest, ignore_errors=True)
                yield self._folders[log]
        finally:
            self._waiting.release()

    def _read(self, log: Path) -> Path:
        """Has a log read by the worker process, and returns the folder with its columns.

        Raises:
            Refusal: it cannot be read, or the server is ending.
        """
        if self._parent is None:
            self._parent = Path(tempfile.mkdtemp(prefix="mavdem-fields-"))
        folder = Path(tempfile.mkdtemp(dir=self._parent))
        outcome = self._reader.read(
            Job(str(log)), self._limits, partial(write_columns, str(folder))
        )
        if outcome is not None and outcome.ended == "read" and not outcome.rows:
            return folder
        shutil.rmtree(folder, ignore_errors=True)
        if outcome is None:
            raise Refusal(Request.NOT_STARTED, name="The reader", because="the server is ending")
        raise Refusal(Request.LOG_NOT_READ, because=outcome.rows[0].status)


def write_columns(folder: str, path: Path, key: str, page: object) -> LogRows:
    """Writes all numeric columns of a log; with the folder given, a ``ReadLog`` function for worker processes.

    Args:
        folder: the folder that gets the files.
        path: path of the log, ``FOLDER/logs/DIGEST/NAME``.
        key: not used.
        page: not used.

    Returns:
        No rows and no pages.

    Raises:
        Unreadable: the log cannot be read.
    """
    log = read_stored_log(path)
    report = path.parents[2] / RESULTS / path.parent.name / REPORT_FILE
    first = vehicle_of_page(log, report) if report.is_file() else log.vehicles[0]
    vehicles = [first, *(vehicle for vehicle in log.vehicles if vehicle is not first)]
    listed = []
    with zipfile.ZipFile(Path(folder, COLUMNS_FILE), "w", zipfile.ZIP_STORED) as archive:
        for number, vehicle in enumerate(vehicles):
            telemetry = with_all_messages(vehicle, path)
            listed.append(_listed_vehicle(number, telemetry))
            for message, columns in telemetry.messages.items():
                for column, values in columns.items():
                    if values.dtype.kind not in "biuf":
                        continue
                    name = f"{number}/{message}/{column}.npy"
                    with archive.open(name, "w", force_zip64=True) as file:
                        np.lib.format.write_array(file, np.ascontiguousarray(values))
    Path(folder, VEHICLES_FILE).write_text(json.dumps(listed), "utf-8")
    return [], {}


def _listed_vehicle(number: int, telemetry: Telemetry) -> JsonValues:
    """Returns what is listed of a vehicle: its name, its messages with their fields, and their names in the log.

    Args:
        number: the vehicle's place in the files.
        telemetry: what it sent.
    """
    messages = messages_of(telemetry)
    return {
        "number": number,
        "vehicle": f"{telemetry.system}_{telemetry.component}",
        "messages": [message._asdict() for message in messages],
        "source_names": dict(telemetry.source_names),
    }


def _vehicle_values(folder: Path, vehicle: str) -> JsonValues:
    """Returns what is listed of a vehicle.

    Args:
        folder: the folder with the columns of its log.
        vehicle: ``SYSTEM_COMPONENT``; empty for the first one.

    Raises:
        Refusal: the log has no such vehicle.
    """
    listed: Sequence[JsonValues] = json.loads(Path(folder, VEHICLES_FILE).read_text("utf-8"))
    for values in listed:
        if vehicle in ("", values["vehicle"]):
            return values
    raise Refusal(Request.NO_SUCH_FIELD, because=f"the log has no vehicle {vehicle}")


class _StoredMessages(Mapping[str, Columns]):
    """The messages of one vehicle of a file of columns, each read when it is asked for."""

    def __init__(self, columns: "np.lib.npyio.NpzFile", vehicle: JsonValues) -> None:
        """Takes the open file.

        Args:
            columns: the file.
            vehicle: what is listed of the vehicle.
        """
        self._columns = columns
        self._prefix = f"{vehicle['number']}/"
        self._names = [message["message"] for message in vehicle["messages"]]

    def __getitem__(self, message: str) -> Columns:
        """Returns the columns of a message."""
        if message not in self._names:
            raise KeyError(message)
        prefix = f"{self._prefix}{message}/"
        return {
            name.removeprefix(prefix): self._columns[name]
            for name in self._columns.files
            if name.startswith(prefix)
        }

    def __iter__(self) -> Iterator[str]:
        """Iterates over the names of the messages."""
        return iter(self._names)

    def __len__(self) -> int:
        """Returns the number of messages."""
        return len(self._names)
