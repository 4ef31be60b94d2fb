"""Uploads: multipart forms whose files are written to the library's disk while they are received."""

import asyncio
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import BinaryIO, cast

from starlette.datastructures import UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import ClientDisconnect
from starlette.requests import Request as HttpRequest

from mavdem.errors import Refusal, Unreadable
from mavdem.facts.serve import RefusalReason
from mavdem.facts.sources import SourceFact
from mavdem.ingest.contents import MAX_LOG_BYTES, file_beginning
from mavdem.ingest.dataflash.definitions import has_dataflash_messages
from mavdem.ingest.formats import detect_format
from mavdem.ingest.tlog import check_beginning
from mavdem.log_formats import FORMAT_OF_ENDING, Format
from mavdem.serve.library import Library
from mavdem.serve.stored_files import refuse_full_disk

MAX_CHUNK_DELAY = 30.0
"""Seconds until the next bytes of a request's body must come. A telephone on a field loses its network for a while."""

MAX_FILES = 1000
"""Files in one form, and flights in one answer, at most."""

MAX_FIELD_BYTES = 1 << 16
"""Bytes of a form's field, and of the body of a request that is no upload, at most."""

ARCHIVE_SIGNATURES = (b"\xfd7zXZ\0", b"PK")
"""First bytes of the archives, xz and zip, that may hold a log."""

MAX_SIGNATURE_BYTES = 6
"""Bytes of the longest of the ``ARCHIVE_SIGNATURES``."""

SPACE_CHECK_BYTES = 1 << 24
"""Bytes of an upload after which the free space is checked again, since others upload at the same time."""


class UploadForm(MultiPartParser):
    """The multipart form of one request, whose files are written to new incoming files of a library.

    Attributes:
        files: the received files by the paths where their contents are.
        is_complete: whether the last line of the form has come.
    """

    def __init__(self, request: HttpRequest, library: Library) -> None:
        """Prepares the parser; :meth:`parse` then receives the form.

        Args:
            request: the request, whose body is the form.
            library: library that gives the files their places on the disk.
        """
        # The chunks of the body are received with limits of their own for time and size.
        super().__init__(
            request.headers,
            _upload_chunks(request, library),
            max_files=MAX_FILES,
            max_fields=MAX_FILES,
            max_part_size=MAX_FIELD_BYTES,
        )
        self.files: dict[Path, UploadFile] = {}
        self.is_complete = False
        self._library = library

    @property
    def fields(self) -> dict[str, str]:
        """Values of the fields that are no files, by name."""
        return {name: value for name, value in self.items if isinstance(value, str)}

    def on_headers_finished(self) -> None:
        """Replaces the temporary file that Starlette makes for a new part of the form by one of the library."""
        super().on_headers_finished()
        file = self._current_part.file
        if file is not None:
            file.file.close()
            path = self._library.new_incoming_path()
            file.file = cast(BinaryIO, _AppendedFile(path))
            self.files[path] = file

    def on_end(self) -> None:
        """Notes that the last line of the form has come; without it the connection broke off."""
        self.is_complete = True

    def remove_files(self) -> None:
        """Removes the received files that were not moved into the library."""
        for path in self.files:
            path.unlink(missing_ok=True)


class _AppendedFile:
    """A file that is opened again for each write: a form may have more files than a process may open at once."""

    def __init__(self, path: Path) -> None:
        path.open("xb").close()
        self._path = path

    def write(self, chunk: bytes) -> int:
        with self._path.open("ab") as file:
            return file.write(chunk)

    def seek(self, offset: int) -> int:
        """Does nothing: Starlette goes back to the beginning of a received file, which is not read from here."""
        return offset

    def close(self) -> None:
        """Does nothing, since the file is open during writes only."""


async def receive_form(request: HttpRequest, library: Library) -> UploadForm:
    """Receives the form of an upload (multipart/form-data), with at least one file.

    The files are written to the disk as they arrive. Nothing of an upload that is refused or breaks off stays there.

    Args:
        request: the request. Its announced length is checked against the free space before anything is received.
        library: library that gives the files their places on the disk.

    Returns:
        The complete form, whose files are on the disk.

    Raises:
        Refusal: the request has no valid form or no file, is too large or too slow, or there is no room for it. No file
            is left on the disk then.
    """
    if not request.headers.get("content-type", "").startswith("multipart/form-data"):
        raise Refusal(RefusalReason.UPLOAD_WITHOUT_LOG)
    content_length = request.headers.get("content-length", "")
    library.check_space(int(content_length) if content_length.isdecimal() else 0)
    form = UploadForm(request, library)
    try:
        with refuse_full_disk():
            await form.parse()
        if not form.is_complete:
            raise Refusal(RefusalReason.UPLOAD_BROKEN)
        # A browser sends a file without name and content for a file field that was left blank.
        if not any(file.size or file.filename for file in form.files.values()):
            raise Refusal(RefusalReason.UPLOAD_WITHOUT_LOG)
    except BaseException as error:
        form.remove_files()
        if isinstance(error, MultiPartException | UnicodeError):
            raise Refusal(RefusalReason.BAD_REQUEST, reason=str(error)) from None
        raise
    return form


def require_log_file(path: Path, name: str) -> None:
    """Checks that an uploaded file is a log, before it waits with the others to be read.

    Args:
        path: path of the file on the server. Its name is a temporary one, so that the content decides.
        name: name that the file was uploaded with.

    Raises:
        Unreadable: it is empty, or no log.
    """
    if not path.stat().st_size:
        raise Unreadable(SourceFact.FILE_EMPTY, path=name, zeros=False)
    with path.open("rb") as file:
        is_packed = file.read(MAX_SIGNATURE_BYTES).startswith(ARCHIVE_SIGNATURES)
    log_format = detect_format(path)[1]
    # Any binary file that is not recognised otherwise may be a telemetry log; whether it is, its frames show.
    if log_format is not Format.TLOG or is_packed:
        return
    try:
        check_beginning(path)
    except Unreadable:
        # The error names the format that the user takes the file for, by the ending of its name.
        named_format = FORMAT_OF_ENDING.get(Path(name.lower()).suffix)
        if named_format is Format.DATAFLASH:
            _require_dataflash_messages(path, name)
        elif named_format is Format.ULOG:
            raise Unreadable(SourceFact.FORMAT_UNKNOWN, path=name, name=Format.ULOG) from None
        else:
            raise


def _require_dataflash_messages(path: Path, name: str) -> None:
    """Checks that a file has messages of a DataFlash log, even if the definitions with which one begins are missing.

    That these are missing is not reported here, but when the whole file is read.

    Args:
        path: path of the file on the server.
        name: name that the file was uploaded with.

    Raises:
        Unreadable: it has no such messages.
    """
    if not has_dataflash_messages(file_beginning(path)):
        raise Unreadable(SourceFact.DATAFLASH_WITHOUT_MESSAGES, path=name) from None


async def body_chunks(request: HttpRequest) -> AsyncGenerator[bytes]:
    """Yields the body of a request chunk by chunk while it is received.

    The limit of time is for each chunk: a slow network may take long for a large log, but a silent client is dropped.

    Raises:
        Refusal: no chunk has come for ``MAX_CHUNK_DELAY``, or the connection broke off.
    """
    stream = request.stream()
    while True:
        try:
            yield await asyncio.wait_for(anext(stream), MAX_CHUNK_DELAY)
        except StopAsyncIteration:
            return
        except TimeoutError:
            raise Refusal(RefusalReason.UPLOAD_TOO_SLOW, time_limit=MAX_CHUNK_DELAY) from None
        except ClientDisconnect:
            raise Refusal(RefusalReason.UPLOAD_BROKEN) from None


async def _upload_chunks(request: HttpRequest, library: Library) -> AsyncGenerator[bytes]:
    """Yields the body of an upload chunk by chunk, while it is not too large and the library has room for it.

    Raises:
        Refusal: the upload is larger than the largest log that can be read, or there is no room any more.
    """
    received_bytes = 0
    bytes_at_last_check = 0
    async for chunk in body_chunks(request):
        received_bytes += len(chunk)
        if received_bytes > MAX_LOG_BYTES:
            raise Refusal(RefusalReason.UPLOAD_TOO_LARGE, size_limit=MAX_LOG_BYTES)
        if received_bytes - bytes_at_last_check > SPACE_CHECK_BYTES:
            bytes_at_last_check = received_bytes
            # What has been received is on the disk and counted already.
            library.check_space(0)
        yield chunk
