"""The library: the logs that the server keeps with their results, and the index of them in the fleet's SQLite file.

The table ``entries`` of ``FOLDER/fleet.sqlite`` is the index; the figures of flights are in the tables of
``mavdem.fleet.store``. A log is the file ``logs/DIGEST/NAME``, where DIGEST is the SHA-256 of its content, and
``results/DIGEST/`` has its result files. Both are moved to their place complete, and an upload is acknowledged when log
and index are safely on the disk.

Several servers may share a folder. Each holds a lock on a file of its own in ``servers/``; when the lock is free the
server has died, and the others read the logs that it had claimed.
"""

import errno
import fcntl
import hashlib
import json
import os
import re
import secrets
import shutil
import sqlite3
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from mavdem.containers import JsonValues, group_by
from mavdem.errors import Refusal, Unreadable, error_message
from mavdem.facts import Fact
from mavdem.facts.serve import Request, Sharing, Stage, Start
from mavdem.fleet.row import FlightRows, utf8_text
from mavdem.fleet.sources import UNKNOWN_SIZE, LogSource, source_of
from mavdem.fleet.store import Store
from mavdem.fleet.workers import JobLimits, JobOutcome
from mavdem.results import PAGE_FILE
from mavdem.serve.index import (
    COLUMNS,
    DIGEST_GLOB,
    Entry,
    create_or_update_table,
    entry_from_row,
    entry_of_fleet_log,
    find_by_digest,
    insert_entry,
    new_id,
)

LOGS = "logs"
"""Folder of the logs, with a folder for each digest."""

RESULTS = "results"
"""Folder of the results, with a folder for each digest."""

INCOMING = "incoming"
"""Folder of uploads and recordings that are being written."""

SERVERS = "servers"
"""Folder of the lock files of running servers."""

PROGRESS = "progress.json"
"""File in a folder of results with the columns of the index that are known while the log is read."""

FORMER_INDEX = "library.sqlite"
"""Name of the SQLite file in which earlier versions had the index."""

SERVER_NAME_BYTES = 8
"""Random bytes in the name of a server and of an upload, written as hexadecimal digits."""

RESERVED_BYTES = 64 << 20
"""Bytes of the disk that uploads leave free: deleting flights needs some, since SQLite writes a journal."""

MAX_FILE_NAME_BYTES = 150
"""Bytes of the name of a stored log. File systems allow 255, and names beside it are longer."""


class Library:
    """The logs of one folder with their index, for all threads of one server.

    Attributes:
        folder: absolute path of the folder.
        quota: bytes that all logs and results may take; None for no limit.
        name: random name of this server among those that share the folder.
        table_is_outdated: set when rows of the fleet have changed since its table of flights was written.
    """

    def __init__(self, folder: Path, quota: int | None = None) -> None:
        """Opens or creates the library, and takes over what servers that died have left.

        Raises:
            Unreadable: the folder cannot be written to.
        """
        self.folder = folder.absolute()
        self.quota = quota
        self.name = secrets.token_hex(SERVER_NAME_BYTES)
        self.table_is_outdated = threading.Event()
        self._thread_state = threading.local()
        try:
            self._create_folders()
            # The file is locked before it gets its place: other servers must not see it without a lock.
            self._lock_file = (self.folder / INCOMING / self.name).open("w")
            fcntl.flock(self._lock_file, fcntl.LOCK_EX)
            os.rename(self._lock_file.name, self.folder / SERVERS / self.name)
            create_or_update_table(self._db)
            self._import_former_index()
        except (OSError, sqlite3.Error) as error:
            reason = Fact(Start.FOLDER_NOT_WRITABLE, path=folder, because=error_message(error))
            raise Unreadable(reason) from None
        self.recover()

    def close(self) -> None:
        """Gives the logs that this server was reading back to the queue, and releases its lock."""
        with self._transaction() as db:
            self._release_claims(db, self.name)
        (self.folder / SERVERS / self.name).unlink(missing_ok=True)
        self._lock_file.close()

    @property
    def store(self) -> Store:
        """The fleet's store, by a connection that belongs to the calling thread."""
        if not hasattr(self._thread_state, "store"):
            self._thread_state.store = Store(self.folder)
            self._thread_state.fleet_version = None
        return self._thread_state.store

    # Paths and space on the disk

    def log_path(self, entry: Entry) -> Path:
        """Returns the path of a log.

        A log with a digest is always taken from the library's own folder, whatever path an altered index has.
        """
        if entry.digest:
            return self.folder / LOGS / entry.digest / Path(entry.path).name
        return self.folder / entry.path

    def results_folder(self, entry: Entry) -> Path:
        """Returns the folder with the result files of a log."""
        return self.folder / RESULTS / entry.digest

    def progress_columns(self, entry: Entry) -> JsonValues:
        """Returns the columns of the index that the reading process has written into a log's progress file so far.

        The file is in the final folder of results or, while the log is read, in a hidden folder beside it. It is
        missing before reading begins, and for a moment while the folder is renamed; then there are no columns.
        """
        for folder_name in (entry.digest, f".{entry.digest}"):
            with suppress(OSError, ValueError):
                path = self.folder / RESULTS / folder_name / PROGRESS
                progress = json.loads(path.read_bytes())
                return {column: progress[column] for column in COLUMNS if column in progress}
        return {}

    @property
    def used_bytes(self) -> int:
        """Bytes of all logs and results."""
        (total,) = self._db.execute("select total(size + kept) from entries").fetchone()
        return int(total)

    def check_space(self, size: int) -> None:
        """Checks that the quota and the disk have room for a log of ``size`` bytes.

        Raises:
            Refusal: there is no room.
        """
        # Somebody may have removed the folders while the server runs.
        self._create_folders()
        # Uploads that are being received count too.
        used = self.used_bytes
        for path in (self.folder / INCOMING).iterdir():
            with suppress(FileNotFoundError):
                used += path.stat().st_size
        if self.quota is not None and used + size > self.quota:
            raise Refusal(Request.QUOTA_REACHED, size=used + size, size_limit=self.quota)
        if shutil.disk_usage(self.folder).free < size + RESERVED_BYTES:
            raise Refusal(Request.DISK_FULL)

    def new_incoming_path(self, recording_name: str = "") -> Path:
        """Returns the path of a new file for an upload or a recording that is to be written.

        Args:
            recording_name: name of the recording of a live session; empty for an upload. If this server dies, another
                one adds its recordings to the library and removes its uploads.
        """
        return self.folder / INCOMING / f"{self.name}-{recording_name or _random_name()}"

    def _create_folders(self) -> None:
        """Creates the folders of the library that do not exist."""
        for name in (LOGS, RESULTS, INCOMING, SERVERS):
            (self.folder / name).mkdir(parents=True, exist_ok=True)

    # Adding logs

    def add(self, incoming: Path, name: str, **columns: Any) -> Entry:
        """Moves a complete file into the library, as :meth:`add_with_digest` does, after computing its digest."""
        with refuse_full_disk(), incoming.open("rb") as file:
            os.fsync(file.fileno())
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        return self.add_with_digest(incoming, digest, name, **columns)

    def add_with_digest(self, incoming: Path, digest: str, name: str, **columns: Any) -> Entry:
        """Moves a complete file into the library.

        When it returns, neither the end of the process nor a power failure loses the log. If the library has a log
        of the same content already, the file is removed, unless that log could not be read: then it is read again.

        Args:
            incoming: path of the file, in the folder for incoming files.
            digest: SHA-256 of its content.
            name: name of the log that users see.
            **columns: further columns of its entry, such as ``note`` and ``sharing``.

        Returns:
            The new entry, or that of the log with the same content. A log that is read again keeps its id, and so its
            link.

        Raises:
            Refusal: the disk is full.
        """
        stored_path = Path(LOGS, digest, stored_file_name(name))
        with self._transaction() as db:
            former_entry = find_by_digest(db, digest)
            if former_entry is not None:
                if former_entry.stage != Stage.FAILED:
                    incoming.unlink()
                    return former_entry
                db.execute("delete from entries where digest = ?", [digest])
            now = datetime.now(UTC)
            entry = Entry(
                new_id() if former_entry is None else former_entry.id,
                name,
                digest,
                str(stored_path),
                incoming.stat().st_size,
                received=now.timestamp(),
                sorted_by=now.isoformat(),
                **columns,
            )
            insert_entry(db, entry)
            # The file is moved before the transaction ends: an entry without its log would be worse than a log without
            # its entry, which the next start adds again.
            folder = (self.folder / stored_path).parent
            folder.mkdir(exist_ok=True)
            os.replace(incoming, self.folder / stored_path)
            _sync_folder(folder)
            _sync_folder(self.folder / LOGS)
        return entry

    def add_fleet_logs(self) -> None:
        """Adds entries of logs that ``mavdem track`` has read, if the SQLite file changed since the last call.

        A log is left out that the index has by its path, or by another path of the same content. SQLite's data version
        changes with every commit of another connection; comparing it is cheap enough to be done every second.
        """
        (version,) = self._db.execute("pragma data_version").fetchone()
        if version == self._thread_state.fleet_version:
            return
        # Paths in the index may be relative to the library's folder, those of the fleet are absolute.
        indexed_logs = "select logs.log from entries join logs on logs.path in (entries.path, ? || entries.path)"
        query = f"""select row, file from flights where file is not null and log not in ({indexed_logs})
        and not exists (select 1 from entries where path = file) order by rowid"""
        with self._transaction() as db:
            rows = self.store.sound_rows(query, [utf8_text(f"{self.folder}/")])
            for file, rows_of_file in group_by(rows, lambda row: row.file).items():
                insert_entry(db, entry_of_fleet_log(file, rows_of_file))
        self._thread_state.fleet_version = version

    # Looking up and changing entries

    def entry(self, id: str) -> Entry:
        """Returns the entry with this id.

        Raises:
            Refusal: there is none.
        """
        row = self._db.execute("select * from entries where id = ?", [id]).fetchone()
        if row is None:
            raise Refusal(Request.NO_SUCH_FLIGHT)
        return entry_from_row(row)

    def find(
        self, where: str, values: Iterable[Any], limit: int, offset: int = 0
    ) -> tuple[list[Entry], int]:
        """Finds the entries for which a condition holds.

        Args:
            where: SQL expression on the table ``entries``, with a ``?`` for each value.
            values: values of the condition.
            limit: number of entries that are returned, at most.
            offset: number of entries that are skipped.

        Returns:
            The entries, the newest first, and the number of all for which the condition holds.
        """
        values = list(values)
        rows = self._db.execute(
            f"select * from entries where {where} order by sorted_by desc limit ? offset ?",
            [*values, limit, offset],
        ).fetchall()
        count_query = f"select count(*) from entries where {where}"
        (total,) = self._db.execute(count_query, values).fetchone()
        return [entry_from_row(row) for row in rows], total

    def vehicle_names(self) -> list[str]:
        """Returns the names of all vehicles, in alphabetical order."""
        query = "select distinct vehicle from entries where vehicle <> '' order by vehicle"
        return [name for (name,) in self._db.execute(query)]

    def flight_rows(self, entries: Iterable[Entry]) -> FlightRows:
        """Returns the fleet's rows of these logs: one for each axis of each vehicle."""
        sources = (
            LogSource(str(self.log_path(entry)), size=UNKNOWN_SIZE, version="") for entry in entries
        )
        return self.store.rows_of(sources)

    def change(self, id: str, **columns: Any) -> Entry:
        """Sets columns of an entry, and returns the changed entry.

        Args:
            id: id of the entry.
            **columns: new values by the name of the column. Names become part of the SQL, so that they must come from
                this program and not from a request.

        Raises:
            Refusal: there is no entry with this id.
        """
        with self._transaction() as db:
            assignments = ", ".join(f"{name} = :{name}" for name in ("id", *columns))
            row = db.execute(
                f"update entries set {assignments} where id = :id returning *",
                {**columns, "id": id},
            ).fetchone()
        if row is None:
            raise Refusal(Request.NO_SUCH_FLIGHT)
        return entry_from_row(row)

    def widen_sharing(self, entry: Entry, sharing: str, note: str) -> Entry:
        """Shares a flight with more people and completes its note, when its log is uploaded again.

        Args:
            entry: the flight.
            sharing: whom the new upload shares it with; it counts only if that is wider than before.
            note: note of the new upload; it counts only if there is none yet.
        """
        # The members of Sharing are in the order of how many people see the flight.
        narrow_to_wide = [str(member) for member in Sharing]
        widest = max(entry.sharing, sharing, key=narrow_to_wide.index)
        return self.change(entry.id, sharing=widest, note=entry.note or note)

    def set_baseline(self, ids: Iterable[str]) -> None:
        """Makes these flights the healthy ones with which the other flights of their vehicles are compared."""
        rows = self.flight_rows([self.entry(id) for id in ids])
        with refuse_full_disk():
            self.store.healthy = [row for row in rows if row.is_read]
        self.table_is_outdated.set()

    def delete(self, id: str) -> None:
        """Deletes a flight: its entry, log, results and rows. A log outside the library's folder stays on the disk."""
        entry = self.entry(id)
        source = source_of(str(self.log_path(entry)))
        with self._transaction() as db:
            db.execute("delete from entries where id = ?", [id])
            self.store.remove(source)
            self._remove_files_of_deleted_log(db, entry)
        self.table_is_outdated.set()

    # Reading logs

    def claim(self) -> Entry | None:
        """Marks the log that has waited longest as being read by this server.

        Finding and marking it are one SQL statement, so that no two threads or servers get the same log.

        Returns:
            Its entry; None if no log waits.
        """
        with self._transaction() as db:
            row = db.execute(
                """update entries set stage = ?, claimed = ? where id =
                (select id from entries where stage = ? and digest glob ? order by received limit 1)
                returning *""",
                [Stage.READING, self.name, Stage.WAITING, DIGEST_GLOB],
            ).fetchone()
        return None if row is None else entry_from_row(row)

    def finish_reading(self, entry: Entry, outcome: JobOutcome, limits: JobLimits) -> None:
        """Stores the outcome of a log that was read: its rows in the fleet's store, its columns in the index.

        A log that cannot be read is removed, unless its entry says that it is to be kept. If the entry was deleted
        while the log was read, the results are removed.

        Args:
            entry: the log, as it was claimed.
            outcome: what came of reading it.
            limits: the limits within which it was read.
        """
        # The index, the rows and the log on the disk change together, or not at all.
        columns = self._columns_of_outcome(entry, outcome)
        removes_log = columns["stage"] == Stage.FAILED and not entry.keep
        if removes_log:
            # The log has no path any more. The id takes its place, since paths in the index are unique.
            columns |= {"size": 0, "path": entry.id}
        source = source_of(str(self.log_path(entry)))
        try:
            with self._transaction():
                self.change(entry.id, **columns)
                self.store.add(source, outcome, limits)
                self.store.track([source])
                if removes_log:
                    self.store.remove(source)
                    self._remove_log(entry)
        except Refusal as error:
            if error.fact.code is not Request.NO_SUCH_FLIGHT:
                raise
            with self._transaction() as db:
                self._remove_files_of_deleted_log(db, entry)
            return
        self.table_is_outdated.set()

    def _columns_of_outcome(self, entry: Entry, outcome: JobOutcome) -> JsonValues:
        """Returns the columns of the index that reading a log has changed, and removes its progress file.

        The log was read with success if its folder of results has a page. Otherwise the status of its first row says
        why not.

        Args:
            entry: the log, as it was claimed.
            outcome: what came of reading it.
        """
        results = self.results_folder(entry)
        columns = self.progress_columns(entry) | {"claimed": ""}
        if columns.get("date"):
            columns["sorted_by"] = columns["date"]
        if not (results / PAGE_FILE).is_file():
            return columns | {"stage": Stage.FAILED, "problem": outcome.rows[0].status}
        (results / PROGRESS).unlink(missing_ok=True)
        paths = sorted(results.iterdir())
        return columns | {
            "stage": Stage.DONE,
            "problem": "",
            "kept": sum(path.stat().st_size for path in paths),
            "files": ",".join(path.name for path in paths),
        }

    # Recovery after a server has died

    def dead_servers(self) -> list[str]:
        """Returns the names of servers of this folder that have ended without releasing their claims."""
        dead_servers = []
        for path in (self.folder / SERVERS).glob("[0-9a-f]" * 2 * SERVER_NAME_BYTES):
            if path.name != self.name and not _is_locked(path):
                dead_servers.append(path.name)
        return dead_servers

    def recover(self) -> None:
        """Takes over the work of servers that died, and makes the index and the folders agree again.

        Logs that the index lacks are added: their upload was not acknowledged yet, or the index is lost.
        """
        # The list is made once: if a server dies meanwhile, its recordings would be removed instead of added.
        dead_servers = self.dead_servers()
        for server in dead_servers:
            self._add_recordings(server)
        with self._transaction() as db:
            for server in dead_servers:
                self._release_claims(db, server)
                for path in (self.folder / INCOMING).glob(f"{server}-*"):
                    path.unlink(missing_ok=True)
                (self.folder / SERVERS / server).unlink(missing_ok=True)
            _restore_digests(db)
            query = "select digest from entries union select '.' || digest from entries where claimed <> ''"
            used_names = {name for (name,) in db.execute(query)}
            self._remove_orphaned_results(used_names)
            self._add_unindexed_logs(db, used_names)

    def _add_recordings(self, server: str) -> None:
        """Adds the recordings of live sessions of a dead server to the library."""
        for path in (self.folder / INCOMING).glob(f"{server}-*.tlog"):
            # Another server that recovers at the same time may take the file.
            with suppress(FileNotFoundError):
                if path.stat().st_size:
                    self.add(path, path.name.removeprefix(f"{server}-"))

    def _release_claims(self, db: sqlite3.Connection, server: str) -> None:
        """Gives the logs that a server has claimed back to the queue."""
        db.execute(
            "update entries set stage = ?, claimed = '' where claimed = ?", [Stage.WAITING, server]
        )

    def _remove_orphaned_results(self, used_names: set[str]) -> None:
        """Removes the folders of results, also unfinished ones, that no entry of the index uses.

        Args:
            used_names: names of the folders that entries use. Folders whose names are no digest are left alone: others
                have put them there.
        """
        for pattern in (DIGEST_GLOB, f".{DIGEST_GLOB}"):
            for path in (self.folder / RESULTS).glob(pattern):
                if path.name not in used_names:
                    shutil.rmtree(path, ignore_errors=True)

    def _add_unindexed_logs(self, db: sqlite3.Connection, indexed_digests: set[str]) -> None:
        """Adds entries for logs that lie in the library's folder but are missing in the index.

        A log lies at ``logs/DIGEST/NAME``, so that its entry can be made again from the path. It is then waiting to be
        read. In place of the time of its upload, which is lost, the file's time of change is taken.

        Args:
            db: the connection, within a transaction.
            indexed_digests: digests of the logs that the index has.
        """
        for path in (self.folder / LOGS).glob(f"{DIGEST_GLOB}/*"):
            digest = path.parent.name
            if digest in indexed_digests:
                continue
            status = path.stat()
            modified = datetime.fromtimestamp(status.st_mtime, UTC)
            entry = Entry(
                new_id(),
                path.name,
                digest,
                f"{LOGS}/{digest}/{path.name}",
                status.st_size,
                received=status.st_mtime,
                sorted_by=modified.isoformat(),
            )
            insert_entry(db, entry)

    # Files and SQL

    def _remove_files_of_deleted_log(self, db: sqlite3.Connection, entry: Entry) -> None:
        """Removes the log and the results of a deleted entry, unless the same log was uploaded again meanwhile.

        It must be called within a transaction, which keeps such an upload waiting.
        """
        if entry.digest and find_by_digest(db, entry.digest) is None:
            shutil.rmtree(self.results_folder(entry), ignore_errors=True)
            self._remove_log(entry)

    def _remove_log(self, entry: Entry) -> None:
        """Removes a log from the library's folder.

        Errors are raised, so that the transaction fails and the entry stays: without it the next start would add the
        log again.
        """
        if entry.digest:
            with suppress(FileNotFoundError):
                shutil.rmtree(self.folder / LOGS / entry.digest)

    def _import_former_index(self) -> None:
        """Copies the entries of an earlier version's index, a file of its own, into this one, and removes that file.

        Entries with an id that this index has already were copied before, by an import that was interrupted. The
        columns of the earlier version are a part of those of today; the others get their defaults.
        """
        former_index = self.folder / FORMER_INDEX
        if not former_index.is_file():
            return
        db = self._db
        db.execute("attach ? as earlier", [str(former_index)])
        columns = db.execute("pragma earlier.table_info(entries)")
        names = ", ".join(row["name"] for row in columns)
        with self._transaction():
            db.execute(
                f"""insert into entries ({names}) select {names} from earlier.entries
                where id not in (select id from entries)"""
            )
        db.execute("detach earlier")
        former_index.unlink(missing_ok=True)

    @property
    def _db(self) -> sqlite3.Connection:
        """The connection of the calling thread to the SQLite file."""
        return self.store.db

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """Makes all changes of its block or none, while other threads and servers wait.

        Raises:
            Refusal: the disk is full.
        """
        with refuse_full_disk(), self.store.transaction():
            yield self._db


def stored_file_name(name: str) -> str:
    """Returns the name that a log has on the disk: its own name, without characters that could form a path."""
    plain_name = re.sub(r"[^\w.()-]", "_", name).lstrip(".")
    # Cutting bytes may leave a part of a character at the beginning, which is dropped.
    short_name = plain_name.encode()[-MAX_FILE_NAME_BYTES:].decode(errors="ignore").lstrip(".")
    return short_name or "log"


@contextmanager
def refuse_full_disk() -> Iterator[None]:
    """Raises ``Refusal`` in place of an error of SQLite or the operating system that the disk or a quota is full."""
    try:
        yield
    except (sqlite3.OperationalError, OSError) as error:
        error_number = getattr(error, "errno", None)
        sqlite_code = getattr(error, "sqlite_errorcode", None)
        if error_number in (errno.ENOSPC, errno.EDQUOT) or sqlite_code == sqlite3.SQLITE_FULL:
            raise Refusal(Request.DISK_FULL) from None
        raise


def _restore_digests(db: sqlite3.Connection) -> None:
    """Sets the digest of each entry to that in the path of its log, in case somebody has altered the index."""
    # In the path logs/DIGEST/NAME the digest has 64 characters, from the sixth.
    db.execute(
        """update entries set digest = substr(path, 6, 64)
        where path glob ? and digest is not substr(path, 6, 64)""",
        [f"{LOGS}/{DIGEST_GLOB}/*"],
    )


def _random_name() -> str:
    """Returns a random name for a file of an upload."""
    return secrets.token_hex(SERVER_NAME_BYTES)


def _is_locked(path: Path) -> bool:
    """Returns whether the lock file of a server exists and its process, which lives, holds the lock."""
    with suppress(OSError), path.open() as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return False
    return path.exists()


def _sync_folder(folder: Path) -> None:
    """Makes the names of files in a folder survive a power failure."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
