"""Recovery of a library after a server has died: its unfinished work is taken over, and the index repaired."""

import shutil
import sqlite3
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any, Protocol

from mavdem.facts.serve import Stage
from mavdem.serve.index import COLUMNS, DIGEST_GLOB, LibraryEntry, insert_entry, new_id
from mavdem.serve.stored_files import (
    INCOMING,
    LOGS,
    RESULTS,
    SERVER_NAME_BYTES,
    SERVERS,
    UNFINISHED_RECORDINGS,
    is_locked,
    remove_server,
)

FORMER_INDEX = "library.sqlite"
"""Name of the SQLite file in which earlier versions had the index."""


class RecoverableLibrary(Protocol):
    """What recovery uses of a library (``mavdem.serve.library.Library``)."""

    folder: Path
    """Absolute path of its folder."""

    name: str
    """Name of this server among those that share the folder."""

    @property
    def db(self) -> sqlite3.Connection:
        """The connection of the calling thread to the index."""

    def transaction(self) -> AbstractContextManager[sqlite3.Connection]:
        """Makes all changes of its block or none."""

    def add(self, incoming_path: Path, name: str, **columns: Any) -> LibraryEntry:
        """Moves a complete file into the library."""


def dead_servers(library: RecoverableLibrary) -> list[str]:
    """Returns the names of servers of a library's folder that have ended without releasing their claims.

    A running server holds a lock on the file with its name in the folder of servers; the file of a dead server is not
    locked.

    Args:
        library: the library of this server, which is left out itself.
    """
    server_names = []
    for path in (library.folder / SERVERS).glob("[0-9a-f]" * 2 * SERVER_NAME_BYTES):
        if path.name != library.name and not is_locked(path):
            server_names.append(path.name)
    return server_names


def recover(library: RecoverableLibrary) -> None:
    """Takes over the work of servers that died, and makes the index and the folders agree again.

    Recordings of their live sessions are added to the library, their uploads that were not acknowledged are removed,
    and the logs that they were reading wait again. Then results without an entry are removed. Logs without an entry get
    one: their upload was not acknowledged yet, or the index is lost.

    Args:
        library: the logs that this server stores, with their results and their index.
    """
    # The list is made only once: a server that died between the two loops would lose its recordings.
    server_names = dead_servers(library)
    for server in server_names:
        _add_recordings(library, server)
    with library.transaction() as db:
        for server in server_names:
            release_claims(db, server)
            for path in (library.folder / INCOMING).glob(f"{server}-*"):
                path.unlink(missing_ok=True)
            remove_server(library.folder / SERVERS / server)
        _restore_digests(db)
        # The results of a log lie in a folder with its digest, and in hidden ones while it is worked on.
        query = """select digest from entries union select '.' || digest from entries where claimed <> ''
            union select '.' || digest || ? from entries where claimed <> ''"""
        used_names = {name for (name,) in db.execute(query, [UNFINISHED_RECORDINGS])}
        _remove_orphaned_results(library.folder / RESULTS, used_names)
        _add_unindexed_logs(library.folder / LOGS, db, used_names)


def release_claims(db: sqlite3.Connection, server: str) -> None:
    """Gives the logs that a server has claimed, to read them or to make their recordings, back to their queue.

    Args:
        db: the connection, within a transaction.
        server: name of the server.
    """
    # A claimed log whose stage is "done" was claimed for its recordings, not for reading.
    db.execute(
        """update entries set claimed = '',
        stage = iif(stage = :done, stage, :waiting),
        recording_stage = iif(stage = :done, :waiting, recording_stage)
        where claimed = :server""",
        {"done": Stage.DONE, "waiting": Stage.WAITING, "server": server},
    )


def import_former_index(library: RecoverableLibrary) -> None:
    """Copies the entries of an earlier version's index, a separate file, into this one, and removes that file.

    Entries with an id that this index has already were copied before, by an import that was interrupted. Columns that
    only the earlier version had are left out; new columns get their defaults.

    Args:
        library: the library, whose folder may hold the earlier index.
    """
    former_index = library.folder / FORMER_INDEX
    if not former_index.is_file():
        return
    db = library.db
    db.execute("attach ? as earlier", [str(former_index)])
    columns = db.execute("pragma earlier.table_info(entries)")
    names = ", ".join(row["name"] for row in columns if row["name"] in COLUMNS)
    with library.transaction():
        db.execute(
            f"""insert into entries ({names}) select {names} from earlier.entries
            where id not in (select id from entries)"""
        )
    db.execute("detach earlier")
    former_index.unlink(missing_ok=True)


def _add_recordings(library: RecoverableLibrary, server: str) -> None:
    """Adds the recordings of live sessions of a dead server to the library.

    Args:
        library: the logs that this server stores, with their results and their index.
        server: name of the dead server, with which the names of its recordings begin.
    """
    for path in (library.folder / INCOMING).glob(f"{server}-*.tlog"):
        # Another server that recovers at the same time may take the file.
        with suppress(FileNotFoundError):
            if path.stat().st_size:
                library.add(path, path.name.removeprefix(f"{server}-"))


def _restore_digests(db: sqlite3.Connection) -> None:
    """Sets the digest of each entry to the digest in the path of its log, in case the index was tampered with.

    Args:
        db: the fleet's database.
    """
    # The digest of the path logs/DIGEST/NAME has 64 characters, from the sixth.
    db.execute(
        """update entries set digest = substr(path, 6, 64)
        where path glob ? and digest is not substr(path, 6, 64)""",
        [f"{LOGS}/{DIGEST_GLOB}/*"],
    )


def _remove_orphaned_results(results: Path, used_names: set[str]) -> None:
    """Removes the folders of results, finished or not, that belong to no entry of the index.

    Folders whose names are no digest are kept, since they are not from this program.

    Args:
        results: the folder with all results.
        used_names: names of the folders in it that entries use.
    """
    hidden_pattern = f".{DIGEST_GLOB}"
    for pattern in (DIGEST_GLOB, hidden_pattern, f"{hidden_pattern}{UNFINISHED_RECORDINGS}"):
        for path in results.glob(pattern):
            if path.name not in used_names:
                shutil.rmtree(path, ignore_errors=True)


def _add_unindexed_logs(logs: Path, db: sqlite3.Connection, indexed_digests: set[str]) -> None:
    """Adds entries for logs that lie in the library's folder but are missing in the index.

    A log lies at ``logs/DIGEST/NAME``, so that its entry can be made again from the path. It then waits to be read. The
    time of its upload is lost; the modification time of the file is used instead.

    Args:
        logs: the folder with all logs.
        db: the connection, within a transaction.
        indexed_digests: digests of the logs that the index has.
    """
    for path in logs.glob(f"{DIGEST_GLOB}/*"):
        digest = path.parent.name
        if digest in indexed_digests:
            continue
        status = path.stat()
        entry = LibraryEntry(
            new_id(),
            name=path.name,
            digest=digest,
            path=f"{LOGS}/{digest}/{path.name}",
            size=status.st_size,
            received=status.st_mtime,
        )
        insert_entry(db, entry)
