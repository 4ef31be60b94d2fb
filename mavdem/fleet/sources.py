"""Sources of a fleet: the logs that files, folders, patterns and URLs name, with what tells that one has changed."""

import glob
import os
import re
import shutil
import stat
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

from mavdem.errors import Unreadable
from mavdem.extras import require_extra
from mavdem.facts import Fact
from mavdem.facts.fleet import Folder
from mavdem.ingest.formats import looks_like_log
from mavdem.log_formats import LOG_ENDINGS

URL = re.compile(r"[a-z][a-z0-9+.-]*://", re.IGNORECASE)
VERSIONS = (
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
"""What file systems call that which changes with a file's content, the surest first."""


class LogSource(NamedTuple):
    """One log."""

    path: str  # absolute path, or URL
    size: int  # bytes; -1 where it is not known
    # changes with the content, as the time of the last change does; empty where nothing does
    version: str


def is_url(name: str) -> bool:
    """Returns whether it names a file of another machine, ``s3://…`` or ``https://…``."""
    return URL.match(name) is not None


def find_logs(
    names: Sequence[str], apart_from: Path | None = None
) -> tuple[list[LogSource], list[Fact]]:
    """Finds the logs that names stand for: a file is one, whatever it holds; of a folder, those that look like logs.

    ``names``: files, folders with all folders in them, patterns such as ``logs/**/*.bin``, URLs of all these. The
    folder ``apart_from``, of the results, is left out wherever it lies. Returns the logs, each once and by path, and a
    fact for each name that names none.
    """
    logs: dict[str, LogSource] = {}
    problems = []
    left_out = os.path.realpath(apart_from) if apart_from else ""
    for name in names:
        if name.lower().startswith("file://"):
            name = unquote(urlsplit(name).path)
        try:
            named = list(_remote(name) if is_url(name) else _local(name, left_out))
        except Unreadable as error:
            problems.append(error.fact)
            continue
        if not named:
            problems.append(Fact(Folder.NO_LOG_NAMED, path=name))
        logs |= {source.path: source for source in named}
    return [logs[path] for path in sorted(logs)], problems


def _local(name: str, left_out: str) -> Iterator[LogSource]:
    """Logs of this machine: a file, what looks like a log in a folder and those below it, or what a pattern names."""
    if os.path.isdir(name):
        paths = [
            path
            for folder, _, names in os.walk(os.path.abspath(name))
            for path in (os.path.join(folder, name) for name in names)
            if looks_like_log(path)
        ]
    elif os.path.lexists(name):
        yield source_of(name)
        return
    else:
        # `**` also names the folders
        paths = [path for path in glob.iglob(name, recursive=True) if not os.path.isdir(path)]
    for path in paths:
        if not left_out or not os.path.realpath(path).startswith(left_out + os.sep):
            yield source_of(path)


def source_of(path: str) -> LogSource:
    """Returns a file of this machine, whether it is there or not."""
    try:
        status = os.stat(path)
    except OSError:
        return LogSource(os.path.abspath(path), -1, "")
    size = status.st_size if stat.S_ISREG(status.st_mode) else -1
    return LogSource(os.path.abspath(path), size, str(status.st_mtime_ns))


def _remote(url: str) -> Iterator[LogSource]:
    require_extra("urls")
    import fsspec  # type: ignore[import-untyped]

    try:
        system, path = fsspec.core.url_to_fs(url)
        is_http = "http" in str(system.protocol)
        if glob.has_magic(path) and not is_http:
            files = system.glob(path, detail=True)
        # Over HTTP, to ask whether it is a folder would load the file to look for links in it.
        elif not url.endswith("/") and (is_http or system.isfile(path)):
            files = {path: system.info(path)}
        else:
            files = system.find(path, detail=True)
            files = {name: files[name] for name in files if name.lower().endswith(LOG_ENDINGS)}
    except Exception as error:  # of whatever library the file system takes
        raise _unreadable(url, error, fetched=False) from None
    for name, details in files.items():
        if details.get("type", "file") != "directory":
            size = details.get("size")
            version = next((str(details[name]) for name in VERSIONS if details.get(name)), "")
            yield LogSource(
                system.unstrip_protocol(name), -1 if size is None else int(size), version
            )


def _unreadable(url: str, error: Exception, fetched: bool) -> Unreadable:
    """Why it cannot be read or ``fetched``, by the first line of what is said."""
    reason = next(iter(str(error).strip().splitlines()), "").rstrip(".")
    because = f"{type(error).__name__}: {reason}"
    return Unreadable(Folder.URL_UNREADABLE, path=url, because=because, fetched=fetched)


def fetch(url: str, copy: Path) -> None:
    """Copies the file behind a URL to this machine; raises ``Unreadable``."""
    require_extra("urls")
    import fsspec

    try:
        with fsspec.open(url, "rb") as remote, copy.open("wb") as file:
            shutil.copyfileobj(remote, file, 1 << 20)
    except Exception as error:
        raise _unreadable(url, error, fetched=True) from None
