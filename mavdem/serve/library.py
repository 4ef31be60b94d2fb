"""The library: which logs the server has, how far each is and who sees it, in the store of the fleet.

The table ``entries`` of ``FOLDER/fleet.sqlite`` is the index; what logs say is in the tables of ``mavdem.fleet.store``.
A log is ``logs/DIGEST/NAME``, by the SHA-256 of its content, and ``results/DIGEST/`` is what was made of it. Each is
there whole or not at all, and an entry is acknowledged when both log and index are on the disk. Several processes may
share a folder: each holds a lock on a file of its own, and what a dead one was doing is given to another.
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
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from mavdem.containers import JsonValues, group_by
from mavdem.errors import Refusal, Unreadable, error_message
from mavdem.facts import Fact
from mavdem.facts.lights import Light
from mavdem.facts.serve import Request, Sharing, Stage, Start
from mavdem.fleet.row import FlightRows, utf8_text
from mavdem.fleet.sources import LogSource, source_of
from mavdem.fleet.store import Store
from mavdem.fleet.workers import JobLimits, JobOutcome
from mavdem.results import PAGE_FILE

EARLIER = "library.sqlite"  # where earlier versions have the index
LOGS = "logs"
RESULTS = "results"
INCOMING = "incoming"
SERVERS = "servers"
PROGRESS = "progress.json"
INDEXES = Path(__file__).with_suffix(".sql").read_text(encoding="utf-8")
# left free, so that flights can still be deleted, which SQLite writes down
RESERVED_BYTES = 64 << 20
DIGEST = "[0-9a-f]" * len(hashlib.sha256().hexdigest())  # as a pattern of file names
MAX_NAME = 150  # bytes, of 255 that file systems allow


@dataclass(frozen=True)
class Entry:
    """A log of the library: what is listed of it. Lights are levels; ``modes`` and ``tags`` words between commas."""

    id: str
    name: str
    digest: str = ""
    path: str = ""  # relative to the folder, or absolute for a log that the fleet has elsewhere
    size: int = 0  # of the log, bytes
    kept: int = 0  # of its results, bytes
    keep: int = 1  # whether a log that cannot be read is kept
    received: float = 0.0  # UNIX time, s
    stage: str = Stage.WAITING
    claimed: str = ""
    problem: str = ""
    sharing: str = Sharing.PRIVATE
    log_shared: int = 0
    note: str = ""
    tags: str = ""
    vehicle: str = ""
    date: str = ""
    duration: float | None = None
    headline: str = ""
    level: str = ""
    next_step: str = ""
    motors: str = ""
    vibration: str = ""
    tracking: str = ""
    margins: str = ""
    power: str = ""
    estimator: str = ""
    wind: str = ""
    log: str = ""
    modes: str = ""
    motor: int | None = None
    wind_speed: float | None = None
    gains: str = "{}"
    files: str = ""  # of the results, by commas
    sorted_by: str = ""  # its date or, where that is not known, when it was received

    @property
    def lights(self) -> dict[str, str]:
        """The level of each light; empty before the log is judged."""
        return {str(light): getattr(self, light) for light in Light} if self.level else {}

    @property
    def file_names(self) -> list[str]:
        """Names of the files that were made of it."""
        return self.files.split(",") if self.files else []

    @property
    def is_done(self) -> bool:
        """Whether nothing more will become of it."""
        return self.stage in (Stage.DONE, Stage.FAILED)


COLUMNS = tuple(column.name for column in fields(Entry))


class Library:
    """The library in a ``folder``, of at most ``quota`` bytes.

    Attributes:
        is_unpublished: set where the fleet's rows have changed, and its table has not.

    Raises:
        Unreadable: the folder cannot be written to.
    """

    def __init__(self, folder: Path, quota: int | None = None) -> None:
        self.folder = folder.absolute()
        self.quota = quota
        self.name = secrets.token_hex(8)
        self._local = threading.local()
        self.is_unpublished = threading.Event()
        try:
            self._make_folders()
            # locked before others see it
            self._lock = (self.folder / INCOMING / self.name).open("w")
            fcntl.flock(self._lock, fcntl.LOCK_EX)
            os.rename(self._lock.name, self.folder / SERVERS / self.name)
            self._migrate()
        except (OSError, sqlite3.Error) as error:
            wrong = Fact(Start.FOLDER_NOT_WRITABLE, path=folder, because=error_message(error))
            raise Unreadable(wrong) from None
        self.recover()

    def _make_folders(self) -> None:
        for part in (LOGS, RESULTS, INCOMING, SERVERS):
            (self.folder / part).mkdir(parents=True, exist_ok=True)

    def _migrate(self) -> None:
        """Makes the table, or adds the columns that an earlier version had not, and takes over an earlier index."""
        db = self._db
        columns = {name: f"{name} default ''" for name in COLUMNS}
        db.execute(f"create table if not exists entries ({', '.join(columns.values())})")
        for row in db.execute("pragma table_info(entries)"):
            del columns[row["name"]]
        for column in columns.values():
            db.execute(f"alter table entries add column {column}")
        db.executescript(INDEXES)
        earlier = self.folder / EARLIER
        if earlier.is_file():
            db.execute("attach ? as earlier", [str(earlier)])
            there = db.execute("pragma earlier.table_info(entries)")
            names = ", ".join(row["name"] for row in there)
            with self._transaction():
                db.execute(
                    f"""insert into entries ({names}) select {names} from earlier.entries
                    where id not in (select id from entries)"""
                )
            db.execute("detach earlier")
            earlier.unlink(missing_ok=True)

    def close(self) -> None:
        """Gives back what it was doing."""
        with self._transaction() as db:
            self._release(db, self.name)
        (self.folder / SERVERS / self.name).unlink(missing_ok=True)
        self._lock.close()

    @property
    def store(self) -> Store:
        """The store, by a connection of this thread."""
        if not hasattr(self._local, "store"):
            self._local.store = Store(self.folder)
            self._local.adopted = None
        return self._local.store

    @property
    def _db(self) -> sqlite3.Connection:
        return self.store.db

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """All or nothing; raises ``Refusal`` where the disk is full."""
        with full_disk_refused(), self.store.transaction():
            yield self._db

    def path_of(self, entry: Entry) -> Path:
        """Returns where the log is; the server's own are always in its folder, whatever path the index has."""
        if entry.digest:
            return self.folder / LOGS / entry.digest / Path(entry.path).name
        return self.folder / entry.path

    def results_of(self, entry: Entry) -> Path:
        """Returns the folder of what was made of a log."""
        return self.folder / RESULTS / entry.digest

    def told(self, entry: Entry) -> JsonValues:
        """Returns the columns that the process that reads a log has said of it so far."""
        for name in (entry.digest, f".{entry.digest}"):
            with suppress(OSError, ValueError):
                told = json.loads((self.folder / RESULTS / name / PROGRESS).read_bytes())
                return {column: told[column] for column in COLUMNS if column in told}
        return {}

    @property
    def used(self) -> int:
        """Bytes of all logs and results."""
        (total,) = self._db.execute("select total(size + kept) from entries").fetchone()
        return int(total)

    def room_for(self, size: int) -> None:
        """Raises ``Refusal`` where a log of this ``size`` has no room."""
        self._make_folders()  # somebody may have removed them meanwhile
        used = self.used
        for path in (self.folder / INCOMING).iterdir():
            with suppress(FileNotFoundError):
                used += path.stat().st_size
        if self.quota is not None and used + size > self.quota:
            raise Refusal(Request.QUOTA_REACHED, size=used + size, size_limit=self.quota)
        if shutil.disk_usage(self.folder).free < size + RESERVED_BYTES:
            raise Refusal(Request.DISK_FULL)

    def new_part(self, recording: str = "") -> Path:
        """Returns where an upload may be written, or a ``recording`` of that name.

        Of what a dead server leaves there, uploads are swept, and recordings entered.
        """
        return self.folder / INCOMING / f"{self.name}-{recording or secrets.token_hex(8)}"

    def receive(self, part: Path, digest: str, name: str, **columns: Any) -> Entry:
        """Takes a whole upload, ``part``, and returns its entry.

        When it returns, neither the end of the process nor of its machine loses the log. Of a log that is known
        already the entry is the one there was, unless that could not be read.
        """
        path = Path(LOGS, digest, file_name(name))
        with self._transaction() as db:
            former = _known(db, digest)
            if former is not None:
                if former["stage"] != Stage.FAILED:
                    part.unlink()
                    return _entry(former)
                db.execute("delete from entries where digest = ?", [digest])
            now = datetime.now(UTC)
            entry = Entry(
                former["id"] if former else new_id(),
                name,
                digest,
                str(path),
                part.stat().st_size,
                received=now.timestamp(),
                sorted_by=now.isoformat(),
                **columns,
            )
            insert(db, entry)
            (self.folder / path).parent.mkdir(exist_ok=True)
            os.replace(part, self.folder / path)
            _sync((self.folder / path).parent)
            _sync(self.folder / LOGS)
        return entry

    def entered(self, part: Path, name: str, **columns: Any) -> Entry:
        """Takes a whole log that this server has written, ``part``, and returns its entry, with these ``columns``."""
        with full_disk_refused(), part.open("rb") as file:
            os.fsync(file.fileno())
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        return self.receive(part, digest, name, **columns)

    def set_baseline(self, ids: Iterable[str]) -> None:
        """Makes these flights those that all others of their vehicles are compared with."""
        rows = self.rows_of([self.entry(id) for id in ids])
        with full_disk_refused():
            self.store.healthy = [row for row in rows if row.is_read]
        self.is_unpublished.set()

    def entry(self, id: str) -> Entry:
        """Returns the entry of a link; raises ``Refusal`` if there is none."""
        row = self._db.execute("select * from entries where id = ?", [id]).fetchone()
        if row is None:
            raise Refusal(Request.NO_SUCH_FLIGHT)
        return _entry(row)

    def find(
        self, where: str, values: Iterable[Any], limit: int, offset: int = 0
    ) -> tuple[list[Entry], int]:
        """Returns the entries ``where`` a condition with ``values`` holds, the newest first, and their number."""
        values = [*values]
        rows = self._db.execute(
            f"select * from entries where {where} order by sorted_by desc limit ? offset ?",
            [*values, limit, offset],
        ).fetchall()
        (total,) = self._db.execute(
            f"select count(*) from entries where {where}", values
        ).fetchone()
        return [_entry(row) for row in rows], total

    def vehicles(self) -> list[str]:
        """Returns the names of all vehicles."""
        return [
            name
            for (name,) in self._db.execute(
                "select distinct vehicle from entries where vehicle <> '' order by vehicle"
            )
        ]

    def change(self, id: str, **columns: Any) -> Entry:
        """Sets columns of an entry."""
        with self._transaction() as db:
            changed = ", ".join(f"{name} = :{name}" for name in ("id", *columns))
            row = db.execute(
                f"update entries set {changed} where id = :id returning *", {**columns, "id": id}
            ).fetchone()
        if row is None:
            raise Refusal(Request.NO_SUCH_FLIGHT)
        return _entry(row)

    def widened(self, entry: Entry, columns: JsonValues) -> Entry:
        """Gives an entry the sharing of these ``columns`` where that is wider, and their note if it has none."""
        widest = max(entry.sharing, columns.get("sharing", Sharing.PRIVATE), key=[*Sharing].index)
        return self.change(entry.id, sharing=widest, note=entry.note or columns["note"])

    def claim(self) -> Entry | None:
        """Returns a log to read, the one that waits longest; None if there is none."""
        with self._transaction() as db:
            row = db.execute(
                """update entries set stage = ?, claimed = ? where id =
                (select id from entries where stage = ? and digest glob ? order by received limit 1)
                returning *""",
                [Stage.READING, self.name, Stage.WAITING, DIGEST],
            ).fetchone()
        return row and _entry(row)

    def finish(self, entry: Entry, outcome: JobOutcome, limits: JobLimits) -> None:
        """Enters what became of a log: its rows into the fleet, and what is known of it into the index.

        A log that cannot be read goes, unless its entry says that it is to be kept.
        """
        results = self.results_of(entry)
        columns = self.told(entry) | {"claimed": ""}
        if columns.get("date"):
            columns["sorted_by"] = columns["date"]
        if (results / PAGE_FILE).is_file():
            (results / PROGRESS).unlink(missing_ok=True)
            files = sorted(results.iterdir())
            columns |= {"stage": Stage.DONE, "problem": ""}
            columns["kept"] = sum(path.stat().st_size for path in files)
            columns["files"] = ",".join(path.name for path in files)
        else:
            columns |= {"stage": Stage.FAILED, "problem": outcome.rows[0].status}
        is_kept = bool(entry.keep) or columns["stage"] == Stage.DONE
        if not is_kept:
            columns |= {"size": 0, "path": entry.id}
        source = source_of(str(self.path_of(entry)))
        try:
            with self._transaction():
                self.change(entry.id, **columns)
                self.store.add(source, outcome, limits)
                self.store.track([source])
                if not is_kept:
                    self.store.remove(source)
                    self._remove_log(entry)
        except Refusal as error:
            if error.fact.code is not Request.NO_SUCH_FLIGHT:
                raise
            with self._transaction() as db:  # it was deleted meanwhile
                self._remove_files(db, entry)
            return
        self.is_unpublished.set()

    def delete(self, id: str) -> None:
        """Removes log, results and row; a log that is not the server's stays on the disk."""
        entry = self.entry(id)
        path = self.path_of(entry)
        with self._transaction() as db:
            db.execute("delete from entries where id = ?", [id])
            self.store.remove(source_of(str(path)))
            self._remove_files(db, entry)
        self.is_unpublished.set()

    def _remove_files(self, db: sqlite3.Connection, entry: Entry) -> None:
        """Removes the server's files of a log within a transaction, unless it was received again meanwhile."""
        if entry.digest and _known(db, entry.digest) is None:
            shutil.rmtree(self.results_of(entry), ignore_errors=True)
            self._remove_log(entry)

    def _remove_log(self, entry: Entry) -> None:
        """Removes a log of the server's own.

        What cannot be removed keeps its row: the next start would enter it again.
        """
        if entry.digest:
            with suppress(FileNotFoundError):
                shutil.rmtree(self.folder / LOGS / entry.digest)

    def rows_of(self, entries: Iterable[Entry]) -> FlightRows:
        """Returns the fleet's rows of these logs."""
        return self.store.rows_of(LogSource(str(self.path_of(entry)), -1, "") for entry in entries)

    def dead_servers(self) -> list[str]:
        """Returns the names of servers of this folder that have ended without saying so."""
        places = (self.folder / SERVERS).glob("[0-9a-f]" * 16)
        return [path.name for path in places if path.name != self.name and not _is_held(path)]

    def recover(self) -> None:
        """Gives what dead servers were doing to others, and removes what they left half done, but no recording.

        Logs that the index lacks are entered again: their upload was not acknowledged yet, or the index is lost.
        """
        # Once: of one that dies meanwhile the recording would be swept and not entered.
        dead = self.dead_servers()
        for server in dead:
            for part in (self.folder / INCOMING).glob(f"{server}-*.tlog"):
                with suppress(FileNotFoundError):  # another server has taken it
                    if part.stat().st_size:
                        self.entered(part, part.name.removeprefix(f"{server}-"))
        with self._transaction() as db:
            for server in dead:
                self._release(db, server)
                for part in (self.folder / INCOMING).glob(f"{server}-*"):
                    part.unlink(missing_ok=True)
                (self.folder / SERVERS / server).unlink(missing_ok=True)
            # A log's folder tells its digest, whatever the index has.
            db.execute(
                """update entries set digest = substr(path, 6, 64)
                where path glob ? and digest is not substr(path, 6, 64)""",
                [f"{LOGS}/{DIGEST}/*"],
            )
            query = "select digest from entries union select '.' || digest from entries where claimed <> ''"
            used = {name for (name,) in db.execute(query)}
            # What others have put into the folder stays.
            for name in (DIGEST, f".{DIGEST}"):
                for path in (self.folder / RESULTS).glob(name):
                    if path.name not in used:  # of a log that is deleted
                        shutil.rmtree(path, ignore_errors=True)
            for path in (self.folder / LOGS).glob(f"{DIGEST}/*"):
                digest = path.parent.name
                if digest not in used:
                    stored_name = f"{LOGS}/{digest}/{path.name}"
                    there = path.stat()
                    insert(
                        db,
                        Entry(
                            new_id(),
                            path.name,
                            digest,
                            stored_name,
                            there.st_size,
                            received=there.st_mtime,
                            sorted_by=datetime.fromtimestamp(there.st_mtime, UTC).isoformat(),
                        ),
                    )

    def _release(self, db: sqlite3.Connection, server: str) -> None:
        db.execute(
            "update entries set stage = ?, claimed = '' where claimed = ?", [Stage.WAITING, server]
        )

    def adopt(self) -> None:
        """Enters the flights that `mavdem track` has put into the fleet, if others have written since the last call."""
        (version,) = self._db.execute("pragma data_version").fetchone()
        if version == self._local.adopted:
            return
        entered = "select logs.log from entries join logs on logs.path in (entries.path, ? || entries.path)"
        query = f"""select row, file from flights where file is not null and log not in ({entered})
        and not exists (select 1 from entries where path = file) order by rowid"""
        with self._transaction() as db:
            rows_of_folder = self.store.sound_rows(query, [utf8_text(f"{self.folder}/")])
            for file, rows in group_by(rows_of_folder, lambda row: row.file).items():
                insert(db, _of_rows(file, rows))
        self._local.adopted = version


def new_id() -> str:
    """Returns the name that a link has, of 128 bits, which cannot be guessed."""
    return secrets.token_urlsafe(16)


def file_name(name: str) -> str:
    """Returns the name that a log has on the disk: nothing in it leads elsewhere."""
    plain = re.sub(r"[^\w.()-]", "_", name).lstrip(".")
    return plain.encode()[-MAX_NAME:].decode(errors="ignore").lstrip(".") or "log"


def _of_rows(file: str, rows: FlightRows) -> Entry:
    """The entry of a log of a fleet."""
    first = rows[0]
    is_sound = first.has_flight
    columns = columns_of(rows)
    size = first.key.rpartition("-")[2]
    return Entry(
        new_id(),
        Path(file).name,
        path=file,
        size=int(size) if size.isdecimal() else 0,
        received=0.0 if first.date is None else first.date.timestamp(),
        stage=Stage.DONE if is_sound else Stage.FAILED,
        problem="" if is_sound else first.status,
        sorted_by=columns["date"],
        files=first.page or "",
        **columns,
    )


def columns_of(rows: FlightRows) -> JsonValues:
    """Returns what the index has of a log's rows."""
    first = rows[0]
    lights = {str(light): getattr(first, f"light_{light}") or "" for light in Light}
    suspects = (row.suspect_motor for row in rows if row.suspect_motor is not None)
    return {
        "vehicle": first.vehicle,
        "date": "" if first.date is None else first.date.isoformat(timespec="seconds"),
        "duration": first.duration,
        "headline": first.headline or "",
        "level": first.headline_level or "",
        "motor": next(suspects, None),
        "wind_speed": first.wind_speed,
        **lights,
    }


@contextmanager
def full_disk_refused() -> Iterator[None]:
    """Raises ``Refusal`` where the disk is full."""
    try:
        yield
    except (sqlite3.OperationalError, OSError) as error:
        number = getattr(error, "errno", None)
        code = getattr(error, "sqlite_errorcode", None)
        if number in (errno.ENOSPC, errno.EDQUOT) or code == sqlite3.SQLITE_FULL:
            raise Refusal(Request.DISK_FULL) from None
        raise


def _known(db: sqlite3.Connection, digest: str) -> Any:
    """The row of a log, or None."""
    return db.execute("select * from entries where digest = ?", [digest]).fetchone()


def _entry(row: sqlite3.Row) -> Entry:
    """An entry; empty columns have their defaults, as has a digest that is none."""
    entry = Entry(**{name: row[name] for name in COLUMNS if row[name] not in (None, "")})
    return entry if fnmatchcase(str(entry.digest), DIGEST) else replace(entry, digest="")


def insert(db: sqlite3.Connection, entry: Entry) -> None:
    """Enters a row."""
    names = ", ".join(COLUMNS)
    places = ", ".join(f":{name}" for name in COLUMNS)
    db.execute(f"insert into entries ({names}) values ({places})", vars(entry))


def _is_held(path: Path) -> bool:
    with suppress(OSError), path.open() as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return False
    return path.exists()


def _sync(folder: Path) -> None:
    """Puts the names in a folder on the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
