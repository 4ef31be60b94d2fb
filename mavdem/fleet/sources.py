"""Sources of a fleet: logs by files, folders, patterns and URLs, with a version by which a change is noticed."""

import glob
import os
import re
import shutil
import stat
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from mavdem.errors import Unreadable
from mavdem.extras import require_extra
from mavdem.facts import Fact
from mavdem.facts.fleet import FleetFolderFact
from mavdem.ingest.formats import looks_like_log
from mavdem.log_formats import LOG_ENDINGS

URL_SCHEME = re.compile(r"[a-z][a-z0-9+.-]*://", re.IGNORECASE)
"""The beginning of a URL (RFC 3986, sec. 3.1)."""

UNKNOWN_SIZE = -1
"""Size of a source whose number of bytes is not known, as of a pipe."""

VERSION_FIELDS = (
    "ETag",
    "etag",
    "generation",
    "LastModified",
    "last_modified",
    "mtime",
    "updated",
    "modified",
    "created",
)
"""What the file systems of fsspec call a property that changes with the content of a file, the most reliable first."""

COPY_CHUNK_BYTES = 1 << 20
"""Bytes that are copied at a time when a file is fetched."""


class LogSource(NamedTuple):
    """A log that a fleet is made of: where it is, and what tells that it has changed."""

    path: str
    """absolute path, or URL"""
    size: int
    """bytes, or ``UNKNOWN_SIZE``"""
    version: str
    """a text that changes with the content, such as the time of the last change; empty where there is none"""


def is_url(name: str) -> bool:
    """Returns whether a name is a URL, such as ``s3://…`` or ``https://…``, not a path."""
    return URL_SCHEME.match(name) is not None


class FoundLogs(NamedTuple):
    """The logs that names on the command line refer to."""

    logs: list[LogSource]
    """The logs, each once, in the order of their paths."""

    problems: list[Fact]
    """A fact for each name that refers to no log, or whose files cannot be listed."""


def find_logs(names: Sequence[str], excluded_folder: Path | None = None) -> FoundLogs:
    """Finds the logs that names on the command line refer to.

    A file is a log, whatever its content. In a folder and its subfolders, the files that look like logs are taken.

    Args:
        names: files, folders, patterns such as ``logs/**/*.bin``, and URLs of all these.
        excluded_folder: a folder whose files are left out, such as the folder of the results.
    """
    logs: dict[str, LogSource] = {}
    problems = []
    excluded_path = os.path.realpath(excluded_folder) if excluded_folder else ""
    for name in names:
        name = _without_file_scheme(name)
        try:
            if is_url(name):
                sources = list(remote_logs(name))
            else:
                sources = list(local_logs(name, excluded_path))
        except Unreadable as error:
            problems.append(error.fact)
            continue
        if not sources:
            problems.append(Fact(FleetFolderFact.NO_LOG_NAMED, path=name))
        for source in sources:
            logs[source.path] = source
    return FoundLogs([logs[path] for path in sorted(logs)], problems)


def _without_file_scheme(name: str) -> str:
    """Returns the path of a log on this machine that a user named by a URL which begins with ``file://``.

    Args:
        name: path or URL of a log, as the user has it.

    Returns:
        The path; any other name unchanged.
    """
    if not name.lower().startswith("file://"):
        return name
    # This module imports Python's HTTP client, which takes long and is needed for nothing else here.
    from urllib.request import url2pathname

    return url2pathname(urlsplit(name).path)


def local_logs(name: str, excluded_path: str) -> Iterator[LogSource]:
    """Yields the logs of this machine that a file, a folder or a pattern refers to.

    Args:
        name: path of a file or folder, or a pattern.
        excluded_path: real path of a folder whose files are left out; empty for none.
    """
    paths = []
    if os.path.isdir(name):
        for folder, _, file_names in os.walk(os.path.abspath(name)):
            for file_name in file_names:
                path = os.path.join(folder, file_name)
                if looks_like_log(path):
                    paths.append(path)
    elif os.path.lexists(name):
        # A file that is named itself counts, wherever it is.
        yield local_source(name)
        return
    else:
        # The pattern ``**`` matches folders, too.
        paths = [path for path in glob.iglob(name, recursive=True) if not os.path.isdir(path)]
    for path in paths:
        is_excluded = False
        if excluded_path:
            is_excluded = os.path.realpath(path).startswith(excluded_path + os.sep)
        if not is_excluded:
            yield local_source(path)


def local_source(path: str) -> LogSource:
    """Returns a file of this machine as a source, whether it exists or not.

    Its version is the time of its last change, ns.

    Args:
        path: path of the file.
    """
    absolute_path = os.path.abspath(path)
    try:
        status = os.stat(path)
    except OSError:
        return LogSource(absolute_path, UNKNOWN_SIZE, version="")
    size = status.st_size if stat.S_ISREG(status.st_mode) else UNKNOWN_SIZE
    return LogSource(absolute_path, size, version=str(status.st_mtime_ns))


def remote_logs(url: str) -> Iterator[LogSource]:
    """Yields the logs that a URL refers to: a file, the logs in a folder, or the files that match a pattern.

    fsspec reads the file system of the URL. Files in a folder are chosen by the endings of their names, since their
    first bytes would have to be fetched.

    Args:
        url: the URL, of any protocol that fsspec supports.

    Yields:
        The logs, with size and version if the server reports them.

    Raises:
        MissingExtra: fsspec is not installed.
        Unreadable: the URL cannot be reached.
    """
    require_extra("urls")
    import fsspec  # type: ignore[import-untyped]

    try:
        system, path = fsspec.core.url_to_fs(url)
        files = _remote_files(system, path, is_folder=url.endswith("/"))
    # Each file system raises the errors of the library that it uses.
    except Exception as error:
        raise _url_error(url, error, is_fetched=False) from None
    for name, details in files.items():
        if details.get("type", "file") != "directory":
            size = details.get("size")
            yield LogSource(
                system.unstrip_protocol(name),
                size=UNKNOWN_SIZE if size is None else int(size),
                version=remote_version(details),
            )


def _remote_files(system: Any, path: str, *, is_folder: bool) -> dict[str, Any]:
    """Returns the properties of the files that a path refers to, by their paths.

    Args:
        system: file system of fsspec.
        path: path of a file or a folder in it, or a pattern. A server that is reached by HTTP knows no patterns.
        is_folder: whether the path is known to be a folder.
    """
    is_http = "http" in str(system.protocol)
    if glob.has_magic(path) and not is_http:
        files: dict[str, Any] = system.glob(path, detail=True)
        return files
    # Over HTTP, isfile() would load the whole file to look for links in it.
    if not is_folder and (is_http or system.isfile(path)):
        return {path: system.info(path)}
    logs = {}
    for name, details in system.find(path, detail=True).items():
        if name.lower().endswith(LOG_ENDINGS):
            logs[name] = details
    return logs


def remote_version(details: Mapping[str, Any]) -> str:
    """Returns the version of a remote file, a text that changes with its content; "" where its file system has none.

    It is the first known one of ``VERSION_FIELDS``, such as an ETag or the time of the last change.

    Args:
        details: properties of the file, whose names differ from file system to file system.
    """
    for name in VERSION_FIELDS:
        version = details.get(name)
        if version:
            return str(version)
    return ""


def copy_remote_file(url: str, copy: Path) -> None:
    """Copies the file behind a URL to this machine.

    Args:
        url: the URL of the file.
        copy: the file of this machine to write.

    Raises:
        MissingExtra: fsspec is not installed.
        Unreadable: the file cannot be fetched, or the copy cannot be written.
    """
    require_extra("urls")
    import fsspec

    try:
        with fsspec.open(url, "rb") as remote, copy.open("wb") as file:
            shutil.copyfileobj(remote, file, COPY_CHUNK_BYTES)
    except Exception as error:
        raise _url_error(url, error, is_fetched=True) from None


def _url_error(url: str, error: Exception, *, is_fetched: bool) -> Unreadable:
    """Returns the error to raise if the files behind a URL cannot be listed, or one of them cannot be fetched.

    Args:
        url: the URL.
        error: the error of the library that reads the URL, of any class.
        is_fetched: whether a file was to be fetched; otherwise files were to be listed.
    """
    message = ""
    lines = str(error).strip().splitlines()
    if lines:
        # The first line of a message of many lines is the reason.
        message = lines[0].rstrip(".")
    reason = f"{type(error).__name__}: {message}"
    return Unreadable(FleetFolderFact.URL_UNREADABLE, path=url, reason=reason, fetched=is_fetched)
