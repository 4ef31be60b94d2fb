"""Uploads: logs within a request, written to the disk and hashed as they come."""

from __future__ import annotations

import asyncio
import hashlib
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from python_multipart.exceptions import MultipartParseError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect
from starlette.requests import Request as HttpRequest

from mavdem.errors import Refusal
from mavdem.facts import Fact
from mavdem.facts.serve import Crowd, Request
from mavdem.ingest.contents import MAX_BYTES
from mavdem.serve.library import Library, refusal_of

PATIENCE_SECONDS = (
    30.0  # for the next bytes of an upload: a link of a field's telephone has such gaps
)
MOST_FILES = 1000  # of one request
MOST_TEXT = 1 << 16  # bytes of all fields of a form together, and of the headers of a part


@dataclass
class Part:
    """A file of a form, as far as it has come: where it is, and what its name and its SHA-256 are."""

    path: Path
    name: str
    file: BinaryIO
    digest: hashlib._Hash = field(default_factory=hashlib.sha256)
    size: int = 0


class Form:
    """A form that comes in pieces: fields are kept, files written to parts of the ``library``."""

    def __init__(self, library: Library, boundary: bytes) -> None:
        self._library = library
        self.fields = dict[str, str]()
        self.parts = list[Part]()
        self.is_whole = False
        self._text = 0
        self._header = [b"", b""]
        self._field = ""
        self._value = bytearray()
        self._part: Part | None = None
        self._parser = MultipartParser(
            boundary,
            {
                "on_part_begin": self._begin,
                "on_header_field": lambda data, start, end: self._add(0, data[start:end]),
                "on_header_value": lambda data, start, end: self._add(1, data[start:end]),
                "on_header_end": self._end_header,
                "on_headers_finished": self._end_headers,
                "on_part_data": lambda data, start, end: self._take(data[start:end]),
                "on_part_end": self._end_part,
                "on_end": self._end,
            },
        )

    def write(self, data: bytes) -> None:
        """Takes the next piece; raises ``Refusal``."""
        try:
            self._parser.write(data)
        except MultipartParseError as error:
            raise Refusal(Fact(Request.BAD_REQUEST, because=str(error))) from None
        except OSError as error:
            raise refusal_of(error) from None

    def save(self) -> None:
        """Puts all files on the disk."""
        for part in self.parts:
            part.file.flush()
            os.fsync(part.file.fileno())
            part.file.close()

    def drop(self) -> None:
        """Removes what is not taken."""
        for part in self.parts:
            part.file.close()
            part.path.unlink(missing_ok=True)

    def _begin(self) -> None:
        self._headers = dict[bytes, bytes]()
        self._value.clear()

    def _add(self, place: int, data: bytes) -> None:
        self._count(len(data))
        self._header[place] += data

    def _count(self, size: int) -> None:
        self._text += size
        if self._text > MOST_TEXT * (1 + len(self.parts)):
            raise Refusal(Fact(Request.UPLOAD_TOO_LARGE, size_limit=MOST_TEXT))

    def _end_header(self) -> None:
        name, value = self._header
        self._headers[name.lower()] = value
        self._header = [b"", b""]

    def _end_headers(self) -> None:
        _, options = parse_options_header(self._headers.get(b"content-disposition", b""))
        self._field = options.get(b"name", b"").decode(errors="replace")
        if b"filename" not in options:
            return
        if len(self.parts) == MOST_FILES:
            raise Refusal(Fact(Request.UPLOADS_TOO_MANY, count=MOST_FILES, name=Crowd.FILES))
        # What some browsers send as name is a path of their machine.
        name = options[b"filename"].decode(errors="replace").replace("\\", "/").rpartition("/")[2]
        path = self._library.new_part()
        self._part = Part(path, name[:200], path.open("xb"))
        self.parts.append(self._part)

    def _take(self, data: bytes) -> None:
        part = self._part
        if part is None:
            self._count(len(data))
            self._value += data
            return
        if part.size + len(data) > MAX_BYTES:
            raise Refusal(Fact(Request.UPLOAD_TOO_LARGE, size_limit=MAX_BYTES))
        part.file.write(data)
        part.digest.update(data)
        part.size += len(data)

    def _end_part(self) -> None:
        if self._part is None:
            self.fields[self._field] = self._value.decode(errors="replace")
        self._part = None

    def _end(self) -> None:
        self.is_whole = True


async def received(request: HttpRequest, library: Library) -> Form:
    """Returns the form of a request, whole and on the disk; raises ``Refusal``, and leaves nothing behind."""
    kind, options = parse_options_header(request.headers.get("content-type"))
    boundary = options.get(b"boundary", b"")
    if kind != b"multipart/form-data" or not 0 < len(boundary) <= 70:  # RFC 2046 allows no more
        raise Refusal(Fact(Request.UPLOAD_WITHOUT_LOG))
    announced = request.headers.get("content-length", "")
    library.room_for(int(announced) if announced.isdecimal() else 0)
    form = Form(library, boundary)
    try:
        await _stream(request, form, library)
        parts = [part for part in form.parts if part.size]
        if not form.is_whole:
            raise Refusal(Fact(Request.UPLOAD_BROKEN))
        if not parts:
            raise Refusal(Fact(Request.UPLOAD_WITHOUT_LOG))
        await run_in_threadpool(form.save)
    except OSError as error:
        form.drop()
        raise refusal_of(error) from None
    except BaseException:
        form.drop()
        raise
    return form


async def _stream(request: HttpRequest, form: Form, library: Library) -> None:
    size = 0
    checked = 0
    stream = request.stream()
    while True:
        try:
            chunk = await asyncio.wait_for(anext(stream), PATIENCE_SECONDS)
        except StopAsyncIteration:
            return
        except TimeoutError:
            raise Refusal(Fact(Request.UPLOAD_TOO_SLOW, time_limit=PATIENCE_SECONDS)) from None
        except ClientDisconnect:
            raise Refusal(Fact(Request.UPLOAD_BROKEN)) from None
        form.write(chunk)
        size += len(chunk)
        if size - checked > 1 << 24:  # others upload too
            checked = size
            library.room_for(0)
