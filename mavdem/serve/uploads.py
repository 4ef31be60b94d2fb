"""Uploads: logs within a request, written to the disk as they come."""

import asyncio
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import BinaryIO, cast

from starlette.datastructures import UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import ClientDisconnect
from starlette.requests import Request as HttpRequest

from mavdem.errors import Refusal
from mavdem.facts.serve import Request
from mavdem.ingest.contents import MAX_LOG_BYTES
from mavdem.serve.library import Library, full_disk_refused

PATIENCE_SECONDS = (
    30.0  # for the next bytes, as a field's telephone has gaps; for a viewer to start
)
MOST_FILES = 1000  # of one request, in it or in its answer
MOST_TEXT = 1 << 16  # bytes of a field of a form
CHECKED_BYTES = 1 << 24  # after which the room is looked at again: others upload too


class _UploadedFile:
    """A file on the disk at ``path`` that is open only while it is written to: a form may have many."""

    def __init__(self, path: Path) -> None:
        path.open("xb").close()
        self._path = path

    def write(self, piece: bytes) -> int:
        with self._path.open("ab") as file:
            return file.write(piece)

    def seek(self, offset: int) -> int:
        return offset

    def close(self) -> None:
        pass


class Form(MultiPartParser):
    """The form of a ``request``, whose files are written to parts of the ``library``.

    Attributes:
        files: the files by where they are.
    """

    def __init__(self, request: HttpRequest, library: Library) -> None:
        super().__init__(
            request.headers,
            _pieces(request, library),
            max_files=MOST_FILES,
            max_fields=MOST_FILES,
            max_part_size=MOST_TEXT,
        )
        self.files = dict[Path, UploadFile]()
        self.is_whole = False
        self._library = library

    @property
    def fields(self) -> dict[str, str]:
        """The fields that are no files, by name."""
        return {name: value for name, value in self.items if isinstance(value, str)}

    def on_headers_finished(self) -> None:
        """Begins a file on the library's disk, not in memory or elsewhere."""
        super().on_headers_finished()
        file = self._current_part.file
        if file is not None:
            file.file.close()
            path = self._library.new_part()
            file.file = cast(BinaryIO, _UploadedFile(path))
            self.files[path] = file

    def on_end(self) -> None:
        """Notes that the form has its last line."""
        self.is_whole = True

    def drop(self) -> None:
        """Removes what is not taken."""
        for path in self.files:
            path.unlink(missing_ok=True)


async def received(request: HttpRequest, library: Library) -> Form:
    """Returns the form of a request, whole and on the disk; raises ``Refusal``, and leaves nothing behind."""
    if not request.headers.get("content-type", "").startswith("multipart/form-data"):
        raise Refusal(Request.UPLOAD_WITHOUT_LOG)
    announced = request.headers.get("content-length", "")
    library.room_for(int(announced) if announced.isdecimal() else 0)
    form = Form(request, library)
    try:
        with full_disk_refused():
            await form.parse()
        if not form.is_whole:
            raise Refusal(Request.UPLOAD_BROKEN)
        if not any(file.size for file in form.files.values()):
            raise Refusal(Request.UPLOAD_WITHOUT_LOG)
    except BaseException as error:
        form.drop()
        if isinstance(error, MultiPartException | UnicodeError):
            raise Refusal(Request.BAD_REQUEST, because=str(error)) from None
        raise
    return form


async def pieces(request: HttpRequest) -> AsyncGenerator[bytes]:
    """Yields the body of a request while it comes; raises ``Refusal`` where it stops."""
    stream = request.stream()
    while True:
        try:
            yield await asyncio.wait_for(anext(stream), PATIENCE_SECONDS)
        except StopAsyncIteration:
            return
        except TimeoutError:
            raise Refusal(Request.UPLOAD_TOO_SLOW, time_limit=PATIENCE_SECONDS) from None
        except ClientDisconnect:
            raise Refusal(Request.UPLOAD_BROKEN) from None


async def _pieces(request: HttpRequest, library: Library) -> AsyncGenerator[bytes]:
    """The body of an upload, while it is not too large, and has room."""
    size = 0
    checked = 0
    async for chunk in pieces(request):
        size += len(chunk)
        if size > MAX_LOG_BYTES:
            raise Refusal(Request.UPLOAD_TOO_LARGE, size_limit=MAX_LOG_BYTES)
        if size - checked > CHECKED_BYTES:
            checked = size
            library.room_for(0)
        yield chunk
