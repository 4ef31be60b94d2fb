"""Files of the library: its folders, the names in them, the locks of its servers, and writing that is safe on disk."""

import os
import re
import secrets
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from mavdem.errors import Refusal
from mavdem.facts.serve import RefusalReason
from mavdem.files import is_disk_full

LOGS = "logs"
"""Folder of the logs, with a folder for each digest."""

RESULTS = "results"
"""Folder of the results, with a folder for each digest."""

INCOMING = "incoming"
"""Folder of uploads and recordings that are being written."""

SERVERS = "servers"
"""Folder with a file for each running server, and next to it the file that the server has locked."""

LOCK_ENDING = ".lock"
"""Ending of the file that a server has locked. Other processes cannot read a locked file on Windows."""

PROGRESS = "progress.json"
"""File in a folder of results with the columns of the index that are known while the log is read."""

FIRST_PLOTS = "first_plots.html"
"""File in a folder of results with the plots that need no model, part of a page, while the log is read."""

SERIES_FILE = "series.npz"
"""File in a folder of results with the time series of the flight, which a comparison draws; no page links to it."""

PARAMETERS_FILE = "parameters.json"
"""File in a folder of results with all parameters of the flight, which a comparison reads; no page links to it."""

UNFINISHED_RECORDINGS = ".recordings"
"""Ending of the hidden folder, next to that of the results, in which the recordings of a flight are made.

The folder without this ending is that of a log being read: a flight whose recordings are being made may be deleted, and
its log uploaded again.
"""

SERVER_NAME_BYTES = 8
"""Number of random bytes in the name of a server and of an upload, written as hexadecimal digits."""

RESERVED_BYTES = 64 << 20
"""Number of bytes of the disk that uploads leave free: deleting flights needs some for SQLite's journal."""

RESERVED_NAME = re.compile(r"(con|prn|aux|nul|(com|lpt)[0-9¹²³])(\.|$)", re.IGNORECASE)
"""Names of devices on Windows, which no file can have.

Source: https://learn.microsoft.com/en-us/windows/win32/fileio/naming-a-file
"""

MAX_FILE_NAME_BYTES = 150
"""Largest length of the name of a stored log, bytes. File systems allow 255, and derived names are longer."""


def stored_file_name(name: str) -> str:
    """Returns the name under which a log is stored: its name without characters that could form a path.

    Spaces stay, so that what a review says to do with the log names it as the user does.

    Names of more than ``MAX_FILE_NAME_BYTES`` lose their beginning, so that the extension remains. A name that Windows
    reserves for a device, with any extension, gets an underscore before it, and dots and spaces at the end are removed,
    since a folder of logs may be moved to Windows.

    Args:
        name: name of the uploaded file, of any characters.
    """
    plain_name = re.sub(r"[^\w.() -]", "_", name).strip().lstrip(".")
    # Cutting bytes may leave a part of a character at the beginning, which is dropped.
    short_name = plain_name.encode()[-MAX_FILE_NAME_BYTES:].decode(errors="ignore").lstrip(". ")
    short_name = short_name.rstrip(". ")
    if RESERVED_NAME.match(short_name):
        return f"_{short_name}"
    return short_name or "log"


@contextmanager
def refuse_full_disk() -> Iterator[None]:
    """Converts errors of SQLite or the operating system about a full disk, in its block, to refusals.

    Raises:
        Refusal: the disk, or the user's quota on it, is full.
    """
    try:
        yield
    except (sqlite3.OperationalError, OSError) as error:
        if is_disk_full(error):
            raise Refusal(RefusalReason.DISK_FULL) from None
        raise


def random_name() -> str:
    """Returns a random name for a file of an upload."""
    return secrets.token_hex(SERVER_NAME_BYTES)


class ServerLock:
    """Lock that a running server holds until its process ends, by which other servers see that it is running.

    It is a lock on the file next to the server's own. On POSIX it is one on the server's own file too, which is the
    only one that earlier versions take and check; Windows, where a locked file cannot be read, has no such versions.
    """

    def __init__(self, path: Path) -> None:
        """Takes the path of the server's file; nothing is locked yet."""
        lock_paths = [path.with_name(path.name + LOCK_ENDING)]
        if os.name == "posix":
            lock_paths.append(path)
        # Each thread may release them, and none waits for them.
        self._locks = [
            FileLock(lock_path, blocking=False, thread_local=False) for lock_path in lock_paths
        ]

    def acquire(self) -> None:
        """Takes both locks.

        Raises:
            Timeout: another process holds one of them; none is held then.
        """
        try:
            for lock in self._locks:
                lock.acquire()
        except Timeout:
            self.release()
            raise

    def release(self) -> None:
        """Gives the locks back; files that are not held stay as they are."""
        for lock in self._locks:
            lock.release()


def register_server(path: Path) -> ServerLock:
    """Creates the file that shows a running server to other servers, and takes its lock.

    The lock is taken before the file is created: other servers take a file without a lock for the file of a dead
    server.

    Args:
        path: path of the server's file; the lock file is next to it.

    Returns:
        The lock, which the server holds until it ends.

    Raises:
        Timeout: another process holds the lock.
    """
    lock = ServerLock(path)
    lock.acquire()
    path.touch()
    return lock


def is_locked(path: Path) -> bool:
    """Returns whether a process holds the lock of a server's file, which means that the server is running.

    The operating system releases the lock when the process ends in any way. The test takes the lock, and releases it at
    once.

    Args:
        path: path of the server's file.
    """
    lock = ServerLock(path)
    try:
        lock.acquire()
    except Timeout:
        return True
    lock.release()
    return False


def remove_server(path: Path) -> None:
    """Removes the file and the lock file of a server that has ended, where another server has not done it already."""
    path.unlink(missing_ok=True)
    path.with_name(path.name + LOCK_ENDING).unlink(missing_ok=True)


def sync_folder(folder: Path) -> None:
    """Writes the entries of a folder to the disk, so that the names of its files survive a power failure.

    Windows cannot open a folder; its file system keeps a journal of the entries, so nothing is done there.

    Args:
        folder: the folder whose entries, the names of its files, are written.
    """
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except PermissionError:
        return
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
