"""Sources of a fleet: the logs that files, folders, globs and URLs name, with what tells that one has changed."""

from __future__ import annotations

import glob
import os
import re
import shutil
import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote, urlsplit

from mavdem.errors import Unreadable, require
from mavdem.ingest.contents import LOG_ENDINGS
from mavdem.ingest.formats import looks_like_log

URL = re.compile(r"[a-z][a-z0-9+.-]*://", re.IGNORECASE)
VERSIONS = ("ETag", "etag", "generation", "LastModified", "last_modified", "mtime", "updated", "modified", "created")
"""What file systems call that which changes with a file's content, the surest first."""


class Source(NamedTuple):
    """One log.

    Attributes:
        path: absolute path, or URL.
        size: bytes; -1 where it is not known.
        version: changes with the content, as the time of the last change does; empty where nothing does.
    """

    path: str
    size: int
    version: str


class Found(NamedTuple):
    """The logs that were named, each once and by path, and a sentence for each name that names none."""

    logs: list[Source]
    problems: list[str]


def is_url(name: str) -> bool:
    """Whether it names a file of another machine, ``s3://…`` or ``https://…``."""
    return URL.match(name) is not None


def find_logs(names: Sequence[str], apart_from: Path | None = None) -> Found:
    """The logs that names stand for: a file is one, whatever it holds; of a folder, those that look like logs.

    Args:
        names: files, folders (with all folders in them), patterns such as ``logs/**/*.bin``, URLs of all these.
        apart_from: a folder that is left out wherever it lies: that of the results.
    """
    logs: dict[str, Source] = {}
    problems = []
    left_out = os.path.realpath(apart_from) if apart_from else ""
    for name in names:
        if name.lower().startswith("file://"):
            name = unquote(urlsplit(name).path)
        try:
            found = {one.path: one for one in (_remote(name) if is_url(name) else _here(name, left_out))}
        except Unreadable as error:
            problems.append(str(error))
            continue
        if not found:
            problems.append(f"{name} names no log: check the name.")
        logs |= found
    return Found([logs[path] for path in sorted(logs)], problems)


def _here(name: str, left_out: str) -> Iterator[Source]:
    if os.path.isdir(name):
        yield from _inside(os.path.abspath(name), left_out, set())
    elif os.path.lexists(name) or not glob.has_magic(name):
        if not os.path.lexists(name):
            raise Unreadable(f"{name} does not exist: check the name.")
        yield local_source(os.path.abspath(name))
    else:
        for path in sorted(glob.iglob(name, recursive=True)):
            # What a pattern names is taken as if it were named, but `**` also names the folders.
            is_left_out = bool(left_out) and os.path.realpath(path).startswith(left_out + os.sep)
            if not os.path.isdir(path) and not is_left_out:
                yield local_source(os.path.abspath(path))


def _inside(folder: str, left_out: str, seen: set[tuple[int, int]]) -> Iterator[Source]:
    """Logs in a folder and those below it, each folder once: links may lead in a circle."""
    try:
        status = os.stat(folder)
        if (status.st_dev, status.st_ino) in seen or os.path.realpath(folder) == left_out:
            return
        seen.add((status.st_dev, status.st_ino))
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError as error:
        if not seen:
            raise Unreadable(f"{folder} cannot be read ({error.strerror}): check its permissions.") from None
        return
    for entry in entries:
        if _is_folder(entry):
            yield from _inside(entry.path, left_out, seen)
        elif looks_like_log(entry.path):
            yield local_source(entry.path)


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:  # a link that leads to itself
        return False


def local_source(path: str) -> Source:
    """A file of this machine, whether it is there or not."""
    try:
        status = os.stat(path)
    except OSError:
        return Source(path, -1, "")
    size = status.st_size if stat.S_ISREG(status.st_mode) else -1
    return Source(path, size, str(status.st_mtime_ns))


def _remote(url: str) -> Iterator[Source]:
    require("Reading logs from URLs", "fleet")
    import fsspec  # type: ignore[import-untyped]

    protocol = url.partition("://")[0].lower()
    try:
        system, path = fsspec.core.url_to_fs(url)
        if glob.has_magic(path) and not protocol.startswith("http"):
            found = system.glob(path, detail=True)
        elif url.lower().endswith(LOG_ENDINGS) or not (url.endswith("/") or _is_remote_folder(system, path)):
            found = {path: system.info(path)}
        else:
            found = {name: details for name, details in system.find(path, detail=True).items() if _named_as_log(name)}
    except ImportError as error:
        raise Unreadable(f"{url} cannot be read: {_one_sentence(error)}.") from None
    except Exception as error:  # of whatever library the file system takes
        raise Unreadable(f"{url} cannot be read ({type(error).__name__}: {_one_sentence(error)}).") from None
    for name, details in found.items():
        if details.get("type", "file") != "directory":
            yield Source(system.unstrip_protocol(name), _size(details), _version(details))


def _is_remote_folder(system: Any, path: str) -> bool:
    # Over HTTP this would load the file to look for links in it.
    return not str(system.protocol).count("http") and system.isdir(path)


def _named_as_log(name: str) -> bool:
    return name.lower().endswith(LOG_ENDINGS)


def _size(details: Mapping[str, Any]) -> int:
    size = details.get("size")
    return int(size) if size is not None else -1


def _version(details: Mapping[str, Any]) -> str:
    return next((str(details[name]) for name in VERSIONS if details.get(name)), "")


def _one_sentence(error: Exception) -> str:
    lines: Iterable[str] = str(error).strip().splitlines()
    return next(iter(lines), type(error).__name__).rstrip(".")


def fetch(url: str, place: Path) -> None:
    """Copies the file behind a URL to a place of this machine; raises ``Unreadable``."""
    require("Reading logs from URLs", "fleet")
    import fsspec

    try:
        with fsspec.open(url, "rb") as remote, place.open("wb") as file:
            shutil.copyfileobj(remote, file, 1 << 20)
    except Exception as error:
        raise Unreadable(f"{url} cannot be fetched ({type(error).__name__}: {_one_sentence(error)}).") from None
