"""The library: the logs that the server stores, with their results and their index in the fleet's SQLite file.

The table ``entries`` of ``FOLDER/fleet.sqlite`` is the index; the figures of flights are in the tables of
``mavdem.fleet.store``. A log is the file ``logs/DIGEST/NAME``, where DIGEST is the SHA-256 of its content, and
``results/DIGEST/`` has its result files. Both are moved to their place complete, and an upload is acknowledged when log
and index are safely on the disk.

Several servers may share a folder. Each has a file in ``servers/`` and holds a lock on another one next to it; when the
lock is free the server has died, and the others read the logs that it had claimed (``recovery``).
"""

import hashlib
import json
import os
import secrets
import shutil
import sqlite3
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from mavdem.containers import JsonValues, Names, group_by
from mavdem.errors import Refusal, Unreadable, error_message
from mavdem.facts import Fact, Level
from mavdem.facts.serve import (
    BaselineCaution,
    ListingOrder,
    RefusalReason,
    Sharing,
    Stage,
    StartFailure,
)
from mavdem.fleet.assigned_vehicles import assign_vehicle, rows_with_assigned_vehicles
from mavdem.fleet.baseline import row_with_bad_motors
from mavdem.fleet.flights import worst_row
from mavdem.fleet.names import (
    GivenNames,
    content_hash,
    plain_name,
    read_names,
    store_flight_name,
    store_vehicle_name,
)
from mavdem.fleet.row import (
    GIVEN_BASIS,
    STATUS_READ,
    SYSTEM_ID_BASIS,
    UNKNOWN,
    FlightRow,
    FlightRows,
    utf8_text,
)
from mavdem.fleet.sources import UNKNOWN_SIZE, LogSource, local_source
from mavdem.fleet.store import Store
from mavdem.fleet.workers import JobLimits, JobOutcome
from mavdem.report.fleet import ANOMALOUS_HEALTHS
from mavdem.results import PAGE_FILE
from mavdem.serve.compared_motors import (
    ANOMALIES_INDEX_SQL,
    BASELINE_VEHICLES_SQL,
    HAS_BALANCE_SQL,
    IS_UNCOMPARED_SQL,
    entry_awaiting_comparison,
    entry_compared_with_fleet,
    order_sql,
)
from mavdem.serve.index import (
    COLUMNS,
    COMPLETE_ROW_SQL,
    DIGEST_GLOB,
    INCOMPLETE_SQL,
    LibraryEntry,
    columns_of_flight,
    create_or_update_table,
    entry_from_row,
    entry_of_fleet_log,
    find_by_digest,
    insert_entry,
    new_id,
)
from mavdem.serve.recovery import import_former_index, recover, release_claims
from mavdem.serve.stored_files import (
    FIRST_PLOTS,
    INCOMING,
    LOGS,
    PARAMETERS_FILE,
    PROGRESS,
    RESERVED_BYTES,
    RESULTS,
    SERIES_FILE,
    SERVER_NAME_BYTES,
    SERVERS,
    UNFINISHED_RECORDINGS,
    random_name,
    refuse_full_disk,
    register_server,
    remove_server,
    stored_file_name,
    sync_folder,
)

MAX_WAITING_PAGES = 10
"""Logs that wait at a time, at most, where another one is to be read again for its page alone: about a minute."""


class FoundEntries(NamedTuple):
    """Entries of the library that satisfy a condition."""

    entries: list[LibraryEntry]
    """Those of the requested page, in the requested order."""

    total: int
    """Number of all that satisfy the condition."""


class ComparedEntries(NamedTuple):
    """Flights of the library with the verdicts that are shown: by their logs, and by comparison of their motors."""

    entries: list[LibraryEntry]
    """The entries, whose headline, lights and next step an anomaly of the motors may have replaced."""

    anomalous_rows: dict[str, FlightRow]
    """By the id of each flight whose motors have a fault or drift, the row of the fleet's table with the worst one."""

    uncompared_ids: set[str]
    """Ids of the flights whose motors are still to be compared, and whose verdicts may become worse."""


class Library:
    """The logs of one folder with their index, for all threads of one server.

    Attributes:
        folder: absolute path of the folder.
        quota: number of bytes that all logs and results may take; ``None`` for no limit.
        name: random name of this server among those that share the folder.
        table_is_outdated: set when rows of the fleet have changed since its table of flights was written.
    """

    def __init__(self, folder: Path, quota: int | None = None) -> None:
        """Opens or creates the library, and takes over the work of servers that died.

        Args:
            folder: folder of the library, which may not exist yet.
            quota: number of bytes that all logs and results may take; ``None`` for no limit.

        Raises:
            Unreadable: the folder cannot be written to.
        """
        # Without "..", as the paths of the fleet's rows are written.
        self.folder = Path(os.path.abspath(folder))
        self.quota = quota
        self.name = secrets.token_hex(SERVER_NAME_BYTES)
        self.table_is_outdated = threading.Event()
        self._thread_state = threading.local()
        self._requested_pages = set[str]()
        try:
            self._create_folders()
            self._lock = register_server(self.folder / SERVERS / self.name)
            create_or_update_table(self.db)
            self.db.execute(ANOMALIES_INDEX_SQL)
            import_former_index(self)
        except (OSError, sqlite3.Error) as error:
            reason = Fact(
                StartFailure.FOLDER_NOT_WRITABLE, path=folder, reason=error_message(error)
            )
            raise Unreadable(reason) from None
        recover(self)
        self._correct_paths_after_move()

    def close(self) -> None:
        """Gives the logs that this server was reading back to the queue, and releases its lock."""
        with self.transaction() as db:
            release_claims(db, self.name)
        self._lock.release()
        remove_server(self.folder / SERVERS / self.name)

    @property
    def store(self) -> Store:
        """The fleet's store, by a connection that belongs to the calling thread."""
        if not hasattr(self._thread_state, "store"):
            self._thread_state.store = Store(self.folder)
            self._thread_state.fleet_version = None
        return self._thread_state.store

    def _correct_paths_after_move(self) -> None:
        """Corrects the paths of the library's logs in the fleet's tables after its folder was moved, copied or renamed.

        These paths are absolute and end with ``LOGS``, the digest of the log and its file name. With a path of the
        former folder, a log would be taken for one outside the library and listed a second time, without its results.
        """
        logs_folder = self.folder / LOGS
        moved_paths = []
        for (path,) in self.db.execute("select path from logs").fetchall():
            file = Path(path)
            digest = file.parent.name
            new_path = utf8_text(str(logs_folder / digest / file.name))
            is_in_logs_folder = file.parent.parent.name == LOGS
            if not is_in_logs_folder or new_path == path:
                continue
            if find_by_digest(self.db, digest) is not None:
                moved_paths.append({"former": path, "new": new_path})
        if not moved_paths:
            return
        with self.transaction() as db:
            db.executemany(
                "update or replace logs set path = :new where path = :former", moved_paths
            )
            db.executemany("delete from entries where digest = '' and path = :former", moved_paths)
            self.store.update_names()
        self.table_is_outdated.set()

    # Paths and space on the disk

    def log_path(self, entry: LibraryEntry) -> Path:
        """Returns the path of the log of an entry.

        A log with a digest is always in the library's folder. Of its path in the index only the name is used, since the
        index may have been tampered with.

        Args:
            entry: index entry of the flight.
        """
        if entry.digest:
            return self.folder / LOGS / entry.digest / Path(entry.path).name
        return self.folder / entry.path

    def results_folder(self, entry: LibraryEntry) -> Path:
        """Returns the folder with the result files of a log."""
        return self.folder / RESULTS / entry.digest

    def progress(self, entry: LibraryEntry) -> JsonValues:
        """Returns how far a log has been processed, as the process that does it writes to a file.

        Results are made in a hidden folder, which is renamed when they are complete. So the file is looked for in three
        folders: that of complete results, the hidden one, and the hidden one of recordings that are being made. It is
        missing before the process begins, and for a moment while the folder is renamed.

        Args:
            entry: the log that is being read, or whose recordings are being made.

        Returns:
            Values by their keys (``mavdem.serve.reading.ProgressFile``); empty if there is no file.
        """
        hidden_name = f".{entry.digest}"
        for folder_name in (entry.digest, hidden_name, f"{hidden_name}{UNFINISHED_RECORDINGS}"):
            path = self.folder / RESULTS / folder_name / PROGRESS
            # The file may be missing or, for a moment, incomplete.
            with suppress(OSError, ValueError):
                return dict(json.loads(path.read_bytes()))
        return {}

    def progress_columns(self, entry: LibraryEntry) -> JsonValues:
        """Returns the columns of the index that the reading process of a log has reported so far, by their names."""
        progress = self.progress(entry)
        return {column: progress[column] for column in COLUMNS if column in progress}

    def first_plots(self, entry: LibraryEntry) -> str:
        """Returns the plots of a flight whose log is being read, part of a page; empty before they are drawn."""
        with suppress(OSError):
            path = self.folder / RESULTS / f".{entry.digest}" / FIRST_PLOTS
            return path.read_text("utf-8")
        return ""

    @property
    def used_bytes(self) -> int:
        """Bytes of all logs and results."""
        (total_bytes,) = self.db.execute("select total(size + kept) from entries").fetchone()
        return int(total_bytes)

    def check_space(self, size: int) -> None:
        """Checks that the quota and the disk have room for another log.

        Args:
            size: size of the log, bytes.

        Raises:
            Refusal: there is no room.
        """
        # The folders may have been removed while the server runs.
        self._create_folders()
        # Uploads that are being received count too.
        used_bytes = self.used_bytes
        for path in (self.folder / INCOMING).iterdir():
            with suppress(FileNotFoundError):
                used_bytes += path.stat().st_size
        if self.quota is not None and used_bytes + size > self.quota:
            raise Refusal(
                RefusalReason.QUOTA_REACHED, size=used_bytes + size, size_limit=self.quota
            )
        if shutil.disk_usage(self.folder).free < size + RESERVED_BYTES:
            raise Refusal(RefusalReason.DISK_FULL)

    def new_incoming_path(self, recording_name: str = "") -> Path:
        """Returns the path of a new file, not created yet, for an upload or for the recording of a live session.

        It begins with the name of this server. If this server dies, another one finds its files by that: it adds the
        recordings to the library and removes the uploads.

        Args:
            recording_name: name of the recording of a live session; empty for an upload.
        """
        return self.folder / INCOMING / f"{self.name}-{recording_name or random_name()}"

    def _create_folders(self) -> None:
        """Creates the folders of the library that do not exist."""
        for name in (LOGS, RESULTS, INCOMING, SERVERS):
            (self.folder / name).mkdir(parents=True, exist_ok=True)

    # Adding logs

    def add(self, incoming_path: Path, name: str, **columns: Any) -> LibraryEntry:
        """Moves a file that was received completely into the library; the digest of its content identifies it there.

        Args:
            incoming_path: path of the file, in the folder for incoming files.
            name: name of the log that users see.
            **columns: further columns of its index entry, such as ``note`` and ``sharing``.

        Returns:
            The entry of the log, as :meth:`add_with_digest` returns it.
        """
        with refuse_full_disk(), incoming_path.open("rb") as file:
            # The content must be on the disk before the index names it.
            os.fsync(file.fileno())
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        return self.add_with_digest(incoming_path, digest, name, **columns)

    def add_with_digest(
        self, incoming_path: Path, digest: str, name: str, **columns: Any
    ) -> LibraryEntry:
        """Moves a complete file into the library.

        When it returns, neither the end of the process nor a power failure loses the log. If the library has a log
        of the same content already, the file is removed, unless that log could not be read: then it is read again.

        Args:
            incoming_path: path of the file, in the folder for incoming files.
            digest: SHA-256 of its content.
            name: name of the log that users see.
            **columns: further columns of its entry, such as ``note`` and ``sharing``.

        Returns:
            The new entry, or the entry of a stored log with the same content. A log that is read again keeps its id,
            and so its link.

        Raises:
            Refusal: the disk is full.
        """
        # Relative to the library's folder.
        stored_path = Path(LOGS, digest, stored_file_name(name))
        with self.transaction() as db:
            former_entry = find_by_digest(db, digest)
            if former_entry is not None and former_entry.stage != Stage.FAILED:
                incoming_path.unlink()
                return former_entry
            if former_entry is not None:
                # The new entry takes the place of the one whose log could not be read.
                db.execute("delete from entries where digest = ?", [digest])
            entry = LibraryEntry(
                new_id() if former_entry is None else former_entry.id,
                name=name,
                digest=digest,
                path=stored_path.as_posix(),
                size=incoming_path.stat().st_size,
                received=time.time(),
                **columns,
            )
            insert_entry(db, entry)
            # The file is moved before the transaction ends: an entry without its log would be worse than a log without
            # its entry, which the next start adds again.
            self._move_into_library(incoming_path, self.folder / stored_path)
        return entry

    def _move_into_library(self, incoming_path: Path, stored_path: Path) -> None:
        """Moves a received file to its place in the library, and waits until the move itself is on the disk.

        Args:
            incoming_path: path of the file, in the folder for incoming files.
            stored_path: its path in the library, in a folder of its own, which may not exist yet.
        """
        log_folder = stored_path.parent
        log_folder.mkdir(exist_ok=True)
        os.replace(incoming_path, stored_path)
        # A rename survives a power failure once the folders are on the disk too.
        sync_folder(log_folder)
        sync_folder(self.folder / LOGS)

    def add_fleet_logs(self) -> None:
        """Adds entries to the index for logs that the command ``mavdem track`` has read since the last call.

        That command writes into the same SQLite file. A log is left out if the index has its path, or another path with
        the same content. Entries of an earlier version, without flight time, modes and gains, are completed once the
        command has read their logs again.
        """
        # SQLite's ``data_version`` changes with every commit of another connection. Comparing it is cheap enough to be
        # done every second. Each thread has a separate connection, and so stores the version of its last call.
        (version,) = self.db.execute("pragma data_version").fetchone()
        if version == self._thread_state.fleet_version:
            return
        with self.transaction() as db:
            self._insert_new_fleet_logs(db)
            self._complete_fleet_entries(db)
        self._thread_state.fleet_version = version

    def _insert_new_fleet_logs(self, db: sqlite3.Connection) -> None:
        """Adds entries for the logs of ``mavdem track`` that the index does not have.

        Args:
            db: the connection, within a transaction.
        """
        # The keys of all logs that the index has. Paths in the fleet's table ``logs`` are absolute, with the separator
        # of this system. Paths in the index may be relative to the library's folder, with "/": the two placeholders are
        # for that folder and for the separator.
        indexed_logs = """select logs.log from entries
        join logs on logs.path in (entries.path, ? || replace(entries.path, '/', ?))"""
        new_rows_query = f"""select row, file from flights where file is not null and log not in ({indexed_logs})
        and not exists (select 1 from entries where path = file) order by rowid"""
        folder_with_separator = utf8_text(f"{self.folder}{os.sep}")
        new_rows = self.store.sound_rows(new_rows_query, [folder_with_separator, os.sep])
        for file, rows_of_file in group_by(new_rows, lambda row: row.file).items():
            insert_entry(db, entry_of_fleet_log(file, rows_of_file))

    def _complete_fleet_entries(self, db: sqlite3.Connection) -> None:
        """Completes entries without flight time, modes and gains from rows of the fleet's table that have these now.

        Args:
            db: the connection, within a transaction.
        """
        completed_rows_query = f"""select row, file from flights join entries on file = path
        where {INCOMPLETE_SQL} and {COMPLETE_ROW_SQL} order by flights.rowid"""
        completed_rows = self.store.sound_rows(completed_rows_query)
        for file, rows_of_file in group_by(completed_rows, lambda row: row.file).items():
            columns = columns_of_flight(rows_of_file)
            assignments = ", ".join(f"{name} = :{name}" for name in columns)
            db.execute(
                f"update entries set {assignments} where path = :path",
                {**columns, "path": file},
            )

    # Looking up and changing entries

    def entry(self, id: str) -> LibraryEntry:
        """Returns the entry with this id, the last part of the flight's link.

        Args:
            id: the id.

        Raises:
            Refusal: there is no such entry.
        """
        row = self.db.execute("select * from entries where id = ?", [id]).fetchone()
        if row is None:
            raise Refusal(RefusalReason.NO_SUCH_FLIGHT)
        return entry_from_row(row)

    def find(
        self,
        condition: str,
        values: Iterable[Any],
        limit: int,
        offset: int = 0,
        order: ListingOrder = ListingOrder.UPLOAD,
        *,
        is_reversed: bool = False,
        judged_first: bool = False,
    ) -> FoundEntries:
        """Finds the entries that satisfy a condition.

        The condition is evaluated once for each entry: first the ids of all matches are found, which also counts them,
        and then the entries to return are fetched.

        Args:
            condition: SQL expression on the table ``entries``, with a ``?`` for each value.
            values: values of the condition.
            limit: largest number of entries that are returned.
            offset: number of entries that are skipped.
            order: the order in which entries are returned and skipped. Logs that could not be read come last in all.
            is_reversed: whether that order is reversed; logs that could not be read come last in any case.
            judged_first: whether logs that are still to be read come after all flights with a verdict.

        Returns:
            The entries, and the number of all matches.
        """
        order_keys = order_sql(order, is_reversed=is_reversed)
        id_query = f"select rowid from entries where {condition} order by {order_keys}"
        matching_ids = [id for (id,) in self.db.execute(id_query, list(values))]
        ranks = {}
        stage_query = "select rowid, stage from entries where stage <> ?"
        for id, stage in self.db.execute(stage_query, [Stage.DONE]):
            if stage == Stage.FAILED:
                ranks[id] = 2
            elif judged_first:
                ranks[id] = 1
        # The sort is stable: each group stays in the wanted order.
        matching_ids.sort(key=lambda id: ranks.get(id, 0))
        returned_ids = matching_ids[offset : offset + limit]
        query = "select rowid, * from entries where rowid in (select value from json_each(?))"
        rows = self.db.execute(query, [json.dumps(returned_ids)])
        entries_by_id = {row["rowid"]: entry_from_row(row) for row in rows}
        # An entry may be deleted between the two queries.
        entries = [entries_by_id[id] for id in returned_ids if id in entries_by_id]
        return FoundEntries(entries, total=len(matching_ids))

    def incomplete_count(self) -> int:
        """Returns the number of flights without flight time, modes and gains because an earlier version read their log.

        Earlier versions of ``mavdem track`` did not store these three. A log is counted if the library has none of them
        (``INCOMPLETE_SQL``), unless the present version has read it: then its row in the table of the fleet's flights
        is complete (``COMPLETE_ROW_SQL``), and the log itself does not contain them.
        """
        query = f"""select count(*) from entries where {INCOMPLETE_SQL}
        and path not in (select file from flights where {COMPLETE_ROW_SQL})"""
        (count,) = self.db.execute(query).fetchone()
        return int(count)

    def vehicle_names(self) -> list[str]:
        """Returns the names that identify a vehicle in the library, in alphabetical order.

        They are the names in the logs. A name made from a MAVLink system id may belong to several vehicles, and is left
        out unless a user has renamed that vehicle.
        """
        query = """select distinct vehicle from entries where vehicle not in ('', ?) and
            (vehicle_basis <> ? or vehicle in (select vehicle from vehicle_names)) order by vehicle"""
        return [name for (name,) in self.db.execute(query, [UNKNOWN, SYSTEM_ID_BASIS])]

    def brief_flight_rows(self, entries: Iterable[LibraryEntry]) -> FlightRows:
        """Returns the fleet's rows of these logs with the columns alone that an index of all flights shows."""
        return self.store.brief_rows_of(map(self._source_of, entries))

    def rows_of_named_vehicles(self) -> FlightRows:
        """Returns rows of the fleet's table for all flights of vehicles with a name, for a table of the vehicles.

        A log may have several vehicles. Only the one under which the log is listed has rows here.
        """
        names = {*self.vehicle_names()}
        entries = self.find("vehicle <> ''", (), sys.maxsize).entries
        vehicle_by_path = {str(self.log_path(entry)): entry.vehicle for entry in entries}
        rows = []
        for row in self.brief_flight_rows(entries):
            if row.vehicle in names and row.vehicle == vehicle_by_path[row.file]:
                rows.append(row)
        return rows

    def flight_rows(self, entries: Iterable[LibraryEntry]) -> FlightRows:
        """Returns the fleet's rows of these logs: one for each axis of each vehicle."""
        return self.store.rows_of(map(self._source_of, entries))

    def motor_rows_of_vehicle(self, vehicle: str) -> FlightRows:
        """Returns one row for each flight of a vehicle that has the figures by which motors are compared.

        The fleet's table has a row for each axis of a flight, all with the same figures of the motors. So one of them
        is enough.

        Args:
            vehicle: name of the vehicle in its logs.
        """
        query = f"""select row, path from flights join logs using (log)
            where vehicle = ? and {HAS_BALANCE_SQL.format(table="flights")}
            and json_extract(row, '$.status') = ? group by log"""
        return list(self.store.sound_rows(query, [vehicle, STATUS_READ]))

    def compared_entries(self, entries: Sequence[LibraryEntry]) -> ComparedEntries:
        """Returns flights with the verdict that users see, in which faults count that only other flights show.

        A log alone does not show that a motor has become weaker. That is found in the background, when the motors of
        all flights of the vehicle are compared; then the fault replaces headline, lights and next step of the flight.

        Args:
            entries: index entries of the flights, with the verdicts that follow from each log alone.

        Returns:
            The entries in the same order with their verdicts replaced, the faults of the motors, and the flights that
            are not compared yet, whose motors are unknown unless their logs show something wrong with them.
        """
        if not entries:
            return ComparedEntries([], {}, set())
        # The order of these two queries matters, since a comparison may end between them. As it is, its result is shown
        # a little later. In the other order a verdict without its result would be taken for the final one.
        uncompared_ids = self._uncompared_ids(entries)
        rows_with_fault = self._rows_with_motor_anomaly(entries)
        for id in uncompared_ids:
            # This fault is of an earlier comparison, such as one with another baseline, and may not be true any more.
            rows_with_fault.pop(id, None)
        compared_entries = []
        for entry in entries:
            if entry.id in uncompared_ids:
                compared_entries.append(entry_awaiting_comparison(entry))
            else:
                row_with_fault = rows_with_fault.get(entry.id)
                compared_entries.append(entry_compared_with_fleet(entry, row_with_fault))
        return ComparedEntries(compared_entries, rows_with_fault, uncompared_ids)

    def _uncompared_ids(self, entries: Iterable[LibraryEntry]) -> set[str]:
        """Returns the ids of those flights whose motors have not been compared with the vehicle's other flights yet.

        A log is compared a moment after it was read, once no other log waits, and again with a new baseline; until then
        a loss of thrust that only the comparison shows is not known. Flights that cannot be compared, such as the only
        one of a vehicle (``IS_COMPARABLE_SQL``), are not among them.

        Args:
            entries: index entries of the flights to examine.
        """
        ids_by_path = {str(self.log_path(entry)): entry.id for entry in entries}
        # Logs that the fleet does not track are never compared; "file" does not tell them apart, since it too is empty
        # until their vehicle is judged.
        query = f"""select distinct path from flights join logs using (log)
            where tracked and path in (select value from json_each(?)) and {IS_UNCOMPARED_SQL}"""
        paths = json.dumps([utf8_text(path) for path in ids_by_path])
        return {ids_by_path[path] for (path,) in self.db.execute(query, [paths])}

    def _rows_with_motor_anomaly(self, entries: Iterable[LibraryEntry]) -> dict[str, FlightRow]:
        """Finds the flights whose motors have a fault or drift in comparison with other flights of their vehicle.

        The fleet's table has a row for each axis of each vehicle in a log, with the health of the motors by that axis.

        Args:
            entries: index entries of the flights to examine.

        Returns:
            For each flight with such an anomaly, by the id of its entry, the row with the worst health.
        """
        entries_by_path = {str(self.log_path(entry)): entry for entry in entries}
        anomalous_rows = []
        for row in self.brief_flight_rows(entries_by_path.values()):
            # Rows of other vehicles in the same log do not count: the entry is listed under one vehicle.
            is_of_listed_vehicle = row.vehicle == entries_by_path[row.file].vehicle
            if row.health in ANOMALOUS_HEALTHS and is_of_listed_vehicle:
                anomalous_rows.append(row)
        worst_rows = {}
        for path, rows_of_log in group_by(anomalous_rows, lambda row: row.file).items():
            worst_rows[entries_by_path[path].id] = worst_row(rows_of_log)
        return worst_rows

    def _source_of(self, entry: LibraryEntry) -> LogSource:
        """Returns the log of an entry as the fleet's store names it."""
        return LogSource(str(self.log_path(entry)), size=UNKNOWN_SIZE, version="")

    def change(self, id: str, **columns: Any) -> LibraryEntry:
        """Sets columns of an entry.

        Args:
            id: id of the entry.
            **columns: new values by the name of the column. The names become part of the SQL, so they must be
                taken from this program and never from a request.

        Returns:
            The changed entry.

        Raises:
            Refusal: there is no entry with this id.
        """
        with self.transaction() as db:
            assignments = ", ".join(f"{name} = :{name}" for name in ("id", *columns))
            row = db.execute(
                f"update entries set {assignments} where id = :id returning *",
                {**columns, "id": id},
            ).fetchone()
        if row is None:
            raise Refusal(RefusalReason.NO_SUCH_FLIGHT)
        return entry_from_row(row)

    @property
    def names(self) -> GivenNames:
        """The names that users have given to vehicles and flights."""
        return read_names(self.db)

    def add_script_hashes(self, hashes: Iterable[str]) -> Names:
        """Adds the scripts of this version to those that pages of the library may run, and returns the hashes of all.

        The server's content security policy permits a script by its hash. A stored page has the scripts of the version
        of mavdem that wrote it, so that the library keeps the hashes of all versions: with those of this version alone,
        older pages would show no charts.

        Args:
            hashes: hashes of the scripts of this version.

        Returns:
            The hashes of every version that has served the library, this one included, in alphabetical order.
        """
        new_rows = [[script_hash] for script_hash in hashes]
        with self.transaction() as db:
            db.executemany("insert or ignore into chart_scripts values (?)", new_rows)
            stored_rows = db.execute("select hash from chart_scripts order by hash")
            return tuple(script_hash for (script_hash,) in stored_rows)

    @property
    def vehicle_frames(self) -> dict[str, str]:
        """The kind of frame of each vehicle, such as "QUADROTOR", in its latest row, by its name in the logs."""
        query = """select vehicle, json_extract(brief, '$.frame') from flights
            where rowid in (select max(rowid) from flights group by vehicle) and json_valid(brief)"""
        return {vehicle: frame for vehicle, frame in self.db.execute(query) if vehicle and frame}

    def name_flight(self, entry: LibraryEntry, name: str) -> None:
        """Gives a name to a flight; an empty one takes it away.

        Args:
            entry: index entry of the flight.
            name: its new name, as it was typed.

        Raises:
            Refusal: the entry has no hash of the log's content, under which names are stored, as with logs outside the
                library's folder that an older version added.
        """
        if not entry.content_hash:
            raise Refusal(RefusalReason.NO_SUCH_FLIGHT)
        with self.transaction() as db:
            store_flight_name(db, entry.content_hash, plain_name(name))

    def state_repair(self, entry: LibraryEntry, *, is_repaired: bool) -> LibraryEntry:
        """Stores with the present date that the fault of a flight was repaired, or that it was not.

        Args:
            entry: index entry of the flight. If its fault was stated to be repaired before, that date stays.
            is_repaired: whether the fault was repaired.

        Returns:
            The changed entry.

        Raises:
            Refusal: the flight was deleted.
        """
        if is_repaired and entry.repaired:
            return entry
        repaired = datetime.now(UTC).isoformat(timespec="seconds") if is_repaired else ""
        return self.change(entry.id, repaired=repaired)

    def name_vehicle(self, vehicle: str, name: str) -> str:
        """Gives a name to a vehicle; an empty one takes it away.

        Args:
            vehicle: name of the vehicle in its logs.
            name: the name, as it was typed.

        Returns:
            The name as it is stored, without characters that are not allowed.

        Raises:
            Refusal: the library has no flight of such a vehicle.
        """
        name = plain_name(name)
        with self.transaction() as db:
            query = "select 1 from entries where vehicle = ? and vehicle <> '' limit 1"
            if db.execute(query, [vehicle]).fetchone() is None:
                raise Refusal(RefusalReason.NO_SUCH_FLIGHT)
            store_vehicle_name(db, vehicle, name)
        return name

    def assign_vehicle(self, entry: LibraryEntry, name: str) -> LibraryEntry:
        """Assigns a vehicle to a flight whose log identifies its vehicle by a MAVLink system id only.

        Args:
            entry: index entry of the flight.
            name: name of the vehicle, as the user typed it. If exactly one vehicle was given this name, that one is
                assigned; otherwise a new vehicle of this name. An empty name removes the assignment.

        Returns:
            The changed entry.

        Raises:
            Refusal: the log identifies its vehicle, or has not been read yet.
        """
        assigned_vehicle = self._vehicle_by_given_name(plain_name(name))
        with self.transaction() as db:
            rows = [row for row in self.flight_rows([entry]) if row.vehicle == entry.vehicle]
            # The fleet has a row for each axis of the flight. All name the same vehicle, so that the first will do.
            row = rows[0] if rows else None
            if row is None or row.vehicle_basis not in (SYSTEM_ID_BASIS, GIVEN_BASIS):
                raise Refusal(RefusalReason.VEHICLE_IDENTIFIED, name=entry.name)
            assign_vehicle(db, row, assigned_vehicle)
            [assigned_row] = rows_with_assigned_vehicles(db, [row])
            self._update_baseline(assigned_row)
            entry = self.change(
                entry.id,
                vehicle=assigned_row.vehicle,
                vehicle_basis=assigned_row.vehicle_basis,
            )
        self.table_is_outdated.set()
        return entry

    def _vehicle_by_given_name(self, name: str) -> str:
        """Returns the vehicle to which a user gave a name, as its logs call it.

        If not exactly one vehicle has the name, the name itself is returned, for a new vehicle.

        Args:
            name: the name that was given.
        """
        vehicles_with_name = []
        for vehicle, given_name in self.names.vehicles.items():
            if given_name == name:
                vehicles_with_name.append(vehicle)
        return vehicles_with_name[0] if len(vehicles_with_name) == 1 else name

    def _update_baseline(self, assigned_row: FlightRow) -> None:
        """Corrects the baseline, the flights marked as healthy, after a flight was assigned to another vehicle.

        A flight whose vehicle is unnamed again is removed from the baseline: otherwise flights of other vehicles with
        the same MAVLink system id would be compared with it.

        Args:
            assigned_row: a row of the flight in the fleet's table, with its present vehicle.
        """
        baseline = self.store.healthy
        content_of_flight = content_hash(assigned_row.key)
        if all(content_hash(row.key) != content_of_flight for row in baseline):
            return
        corrected_baseline = []
        for row in rows_with_assigned_vehicles(self.db, baseline):
            is_of_this_flight = content_hash(row.key) == content_of_flight
            if row.has_own_name or not is_of_this_flight:
                corrected_baseline.append(row)
        self.store.healthy = corrected_baseline

    def widen_sharing(self, entry: LibraryEntry, sharing: str, note: str) -> LibraryEntry:
        """Updates who may see a flight when its log is uploaded again: as many people as before, or more.

        Args:
            entry: index entry of the flight.
            sharing: with whom the new upload shares the flight; used only if these are more people than before.
            note: note of the new upload; used only if the entry has none.

        Returns:
            The changed entry.
        """
        # The members of ``Sharing`` are ordered from the fewest to the most people who see the flight.
        narrow_to_wide = [str(member) for member in Sharing]
        widest_sharing = max(entry.sharing, sharing, key=narrow_to_wide.index)
        return self.change(entry.id, sharing=widest_sharing, note=entry.note or note)

    def baseline_vehicles(self) -> set[str]:
        """Returns the names in the logs of the vehicles of which a user marked flights as healthy."""
        return {vehicle for (vehicle,) in self.db.execute(BASELINE_VEHICLES_SQL)}

    def baseline_rows(self, vehicle: str) -> FlightRows:
        """Returns the rows of a vehicle's baseline, one for each axis of its flights that were marked as healthy.

        Args:
            vehicle: name of the vehicle in its logs.

        Returns:
            The rows; empty without a baseline.
        """
        return [row for row in self.store.healthy if row.vehicle == vehicle]

    def set_baseline(self, ids: Iterable[str]) -> Fact | None:
        """Marks some flights as healthy: the baseline with which other flights of the same vehicle are compared.

        They replace those of the same vehicles that were marked before. Two kinds of flights are refused: those that
        could not be read, and those of a vehicle without a name of its own. Such a vehicle is known by its MAVLink
        system id alone, so that flights of other vehicles with this id would be compared with it.

        Args:
            ids: ids of the healthy flights in the index.

        Returns:
            The caution, with the names of the flights, that motors of some have the level "watch"; None if none have.

        Raises:
            Refusal: there is no such flight, one cannot be in a baseline, the motors of one are bad, or the disk is
                full. The baselines then stay as they were.
        """
        entries = [self.entry(id) for id in ids]
        # They are looked up first, since they are then compared with the former baseline, as the pages show them.
        watched_names = self._names_of_watched_flights(entries)
        healthy_rows = []
        for entry in entries:
            rows = self.flight_rows([entry])
            if row_with_bad_motors(rows) is not None:
                raise Refusal(RefusalReason.MOTORS_BAD, name=self._shown_name(entry))
            usable_rows = [row for row in rows if row.is_read and row.has_own_name]
            if not usable_rows:
                raise Refusal(RefusalReason.NOT_FOR_BASELINE, name=self._shown_name(entry))
            healthy_rows += usable_rows
        self._replace_baseline({row.vehicle for row in healthy_rows}, healthy_rows)
        if not watched_names:
            return None
        return Fact(BaselineCaution.MOTORS_WATCHED, names=watched_names)

    def _names_of_watched_flights(self, entries: Sequence[LibraryEntry]) -> list[str]:
        """Returns the names of those flights whose motors have the level "watch" on the pages.

        Args:
            entries: index entries of the flights, with the verdicts that follow from each log alone.
        """
        names = []
        for entry in self.compared_entries(entries).entries:
            if entry.motors == Level.WATCH:
                names.append(self._shown_name(entry))
        return names

    def _shown_name(self, entry: LibraryEntry) -> str:
        """Returns the name under which pages show a flight: the one that a user gave it, or that of its log's file."""
        return self.names.flights.get(entry.content_hash) or entry.name

    def remove_baseline(self, vehicle: str) -> None:
        """Removes the baseline of a vehicle, the flights that a user marked as healthy.

        Its flights are then compared with its first sound ones.

        Args:
            vehicle: name of the vehicle in its logs.

        Raises:
            Refusal: the disk is full.
        """
        self._replace_baseline({vehicle}, [])

    def _replace_baseline(self, vehicles: set[str], healthy_rows: FlightRows) -> None:
        """Replaces the baselines of some vehicles, whose flights are then to be compared again; those of others stay.

        Args:
            vehicles: names of the vehicles in their logs.
            healthy_rows: rows of their healthy flights in the fleet's table.

        Raises:
            Refusal: the disk is full.
        """
        with self.transaction() as db:
            kept_rows = [row for row in self.store.healthy if row.vehicle not in vehicles]
            self.store.healthy = [*kept_rows, *healthy_rows]
            db.execute(
                "update flights set judged = null where vehicle in (select value from json_each(?))",
                [json.dumps([*vehicles])],
            )
        # The thread that reads logs then writes the table of the fleet anew, with the new comparisons.
        self.table_is_outdated.set()

    def delete(self, id: str) -> None:
        """Deletes a flight: its entry, given name, log, results and rows in the fleet's store.

        A log outside the library's folder stays on the disk.

        Args:
            id: id of the flight.

        Raises:
            Refusal: there is no such flight, or the disk is full.
        """
        entry = self.entry(id)
        source = local_source(str(self.log_path(entry)))
        with self.transaction() as db:
            db.execute("delete from entries where id = ?", [id])
            store_flight_name(db, entry.content_hash, name="")
            db.execute("delete from flight_vehicles where content = ?", [entry.content_hash])
            self.store.remove(source)
            self._remove_files_of_deleted_log(db, entry)
        self.table_is_outdated.set()

    def replace_part(self, part_id: str, whole: LibraryEntry) -> LibraryEntry:
        """Deletes a log that is the beginning of another, which takes over what users added to it.

        These are the given name of the flight, its note and tags, and with whom it is shared.

        Args:
            part_id: id of the log that is deleted.
            whole: index entry of the log that contains it.

        Returns:
            The changed entry of the whole log.

        Raises:
            Refusal: the part was deleted before, or the disk is full.
        """
        part = self.entry(part_id)
        given_name = self.names.flights.get(part.content_hash, "")
        # One change for the reader of the library: either both logs are in it, or the whole one with these additions.
        with self.transaction():
            if given_name:
                self.name_flight(whole, given_name)
            whole = self.change(
                whole.id,
                note=part.note,
                tags=part.tags,
                sharing=part.sharing,
                log_shared=part.log_shared,
            )
            self.delete(part_id)
        return whole

    # Reading logs

    def claim(self) -> LibraryEntry | None:
        """Takes the log that has waited longest, and marks it as being read by this server.

        A log that could not be read for lack of disk space waits again, with a text in its column ``problem``. Such
        logs come after all others, which may need less space.

        Returns:
            The entry of the log; None if no log waits.
        """
        with self.transaction() as db:
            # One statement finds the log and marks it, so that no two threads or servers get the same. Only logs in the
            # library's folder, which have a digest (a SHA-256), are read by servers.
            row = db.execute(
                """update entries set stage = ?, claimed = ? where id =
                (select id from entries where stage = ? and digest glob ?
                   order by problem != '', received limit 1)
                returning *""",
                [Stage.READING, self.name, Stage.WAITING, DIGEST_GLOB],
            ).fetchone()
        return None if row is None else entry_from_row(row)

    def request_new_page(self, entry: LibraryEntry) -> bool:
        """Queues a log to be read again, so that its page, which an earlier version wrote, gets this version's scripts.

        Each page is requested once while the server runs, since reading may fail again. At most ``MAX_WAITING_PAGES``
        logs may wait, so that visitors of many old pages do not hold up uploads.

        Args:
            entry: index entry of a flight that has a page.

        Returns:
            Whether the log was queued now.
        """
        with self.transaction() as db:
            (waiting_count,) = db.execute(
                "select count(*) from entries where stage = ?", [Stage.WAITING]
            ).fetchone()
            is_readable = entry.stage == Stage.DONE and self.log_path(entry).is_file()
            was_requested = entry.id in self._requested_pages
            if was_requested or not is_readable or waiting_count >= MAX_WAITING_PAGES:
                return False
            self._requested_pages.add(entry.id)
            self.change(entry.id, stage=Stage.WAITING)
        return True

    def finish_reading(self, entry: LibraryEntry, outcome: JobOutcome, limits: JobLimits) -> None:
        """Stores what a worker process has found in a log: rows in the fleet's store, and columns in the index.

        A log that has a page is only read again to make that page anew. If that fails, its former page and results
        stay. If the log was deleted while it was read, its results are removed, too.

        Args:
            entry: the log, as a server claimed it for reading.
            outcome: result of reading it: rows of the fleet's table, which name the page if one was made.
            limits: the limits of time and memory within which it was read.
        """
        had_page = (self.results_folder(entry) / PAGE_FILE).is_file()
        has_new_page = any(row.page for row in outcome.rows)
        try:
            # The index, the rows and the log on the disk change together, or not at all.
            with self.transaction():
                if had_page and not has_new_page:
                    self.change(entry.id, stage=Stage.DONE, claimed="", problem="")
                else:
                    self._store_outcome(entry, outcome, limits)
        except Refusal as error:
            # Both ways of storing refuse an entry that is no longer in the index.
            was_deleted = error.fact.code is RefusalReason.NO_SUCH_FLIGHT
            if not was_deleted:
                raise
            self.remove_files_of_deleted_log(entry)
            return
        self.table_is_outdated.set()

    def _store_outcome(self, entry: LibraryEntry, outcome: JobOutcome, limits: JobLimits) -> None:
        """Stores the results on a log, and removes a log that cannot be read; called within a transaction.

        Args:
            entry: the log, as a server claimed it for reading.
            outcome: result of reading it, with the fleet's rows.
            limits: the limits of time and memory within which it was read.
        """
        columns = self._columns_of_outcome(entry, outcome)
        is_failed = columns["stage"] == Stage.FAILED
        if not is_failed:
            # What the reading process has reported in this file is among the columns now.
            (self.results_folder(entry) / PROGRESS).unlink(missing_ok=True)
        # A log that cannot be read stays if its uploader wants to keep it, or if it is not itself the cause: its file
        # could not be opened, a package that its format needs is missing ("source"), or mavdem has a defect ("error").
        keeps_log = entry.keep or outcome.ended in ("source", "error")
        removes_log = is_failed and not keeps_log
        if removes_log:
            # The log has no path any more, but paths in the index must be unique, so the id is stored as one.
            columns |= {"size": 0, "path": entry.id}
        self.change(entry.id, **columns)
        source = local_source(str(self.log_path(entry)))
        self.store.add(source, outcome, limits)
        # The table of the fleet's flights shows tracked logs only.
        self.store.track([source])
        if removes_log:
            self.store.remove(source)
            self._remove_log(entry)

    def _columns_of_outcome(self, entry: LibraryEntry, outcome: JobOutcome) -> JsonValues:
        """Returns the columns of a log's index entry that change once the log was read.

        The log was read successfully if its folder of results has a page. Otherwise the status of its first row is the
        reason of the failure.

        Args:
            entry: index entry of the log, as a server claimed it for reading.
            outcome: result of reading it, with the rows of the fleet's table.

        Returns:
            New values by the name of the column: what the reading process reported, such as the headline; the stage,
            ``DONE`` or ``FAILED``, with the reason of a failure as ``problem``; and of a log that was read its vehicle,
            where a user assigned one, and its result files. The claim of the server is cleared.
        """
        columns = self.progress_columns(entry)
        columns["claimed"] = ""
        has_page = (self.results_folder(entry) / PAGE_FILE).is_file()
        if not has_page:
            columns["stage"] = Stage.FAILED
            columns["problem"] = outcome.rows[0].status
            return columns
        columns["stage"] = Stage.DONE
        columns["problem"] = ""
        (first_row,) = rows_with_assigned_vehicles(self.db, outcome.rows[:1])
        is_vehicle_assigned = first_row.vehicle_basis == GIVEN_BASIS
        if is_vehicle_assigned:
            columns["vehicle"] = first_row.vehicle
            columns["vehicle_basis"] = GIVEN_BASIS
        # The reading process reports as files the recordings that can be made on request, separated by commas.
        recordings = columns.get("files", "")
        columns.update(self._columns_of_result_files(entry, recordings))
        return columns

    def _columns_of_result_files(self, entry: LibraryEntry, recordings: str) -> JsonValues:
        """Returns the columns of the index on the result files of a log: their size, and which can be downloaded.

        Args:
            entry: the log, which was read.
            recordings: names of recordings that can be made on request, separated by commas; they can be downloaded
                too.

        Returns:
            ``kept``, bytes of all results, and ``files``, names of the downloads, separated by commas.
        """
        total_size = 0
        downloads = {name for name in recordings.split(",") if name}
        for path in self.results_folder(entry).iterdir():
            if path.name == PROGRESS:
                # The progress of the reading is no result; this file is removed next.
                continue
            total_size += path.stat().st_size
            # Series and parameters are stored only for comparisons of flights.
            if path.name not in (SERIES_FILE, PARAMETERS_FILE):
                downloads.add(path.name)
        return {"kept": total_size, "files": ",".join(sorted(downloads))}

    # Files and SQL

    def remove_files_of_deleted_log(self, entry: LibraryEntry) -> None:
        """Removes the files of an entry that was deleted while its log was worked on."""
        with self.transaction() as db:
            self._remove_files_of_deleted_log(db, entry)

    def _remove_files_of_deleted_log(self, db: sqlite3.Connection, entry: LibraryEntry) -> None:
        """Removes the log and the results of a deleted entry from the disk.

        They stay if the same log was uploaded again meanwhile, since the new entry uses them.

        Args:
            db: the connection, within a transaction, which blocks such an upload until it ends.
            entry: the entry that was deleted.
        """
        if entry.digest and find_by_digest(db, entry.digest) is None:
            shutil.rmtree(self.results_folder(entry), ignore_errors=True)
            self._remove_log(entry)

    def _remove_log(self, entry: LibraryEntry) -> None:
        """Removes a log from the library's folder.

        An error of the disk is raised, so that the transaction fails and the entry remains. Otherwise the next start of
        the server would add the log again, since it adds logs without an entry.

        Args:
            entry: the entry of the log; one outside the library's folder stays on the disk.
        """
        if entry.digest:
            with suppress(FileNotFoundError):
                shutil.rmtree(self.folder / LOGS / entry.digest)

    @property
    def db(self) -> sqlite3.Connection:
        """The connection of the calling thread to the SQLite file."""
        return self.store.db

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Opens a transaction: all changes of its block are made or none, while other threads and servers wait.

        Raises:
            Refusal: the disk is full.
        """
        with refuse_full_disk(), self.store.transaction():
            yield self.db
