"""Rerun's viewer in a page of the server: the policy of that page, and the program, which loads nothing from elsewhere.

Rerun's package has a page of its own, which requests fonts from Google, and is titled "Rerun Viewer" whatever it shows.
Its program is two files, which the process of the viewer serves to browsers of this machine, and this server passes on.
"""

from collections.abc import Callable, Iterator
from http.client import HTTPConnection, HTTPException
from http.client import HTTPResponse as ViewerResponse

from starlette.requests import Request as HttpRequest
from starlette.responses import Response, StreamingResponse

from mavdem.errors import Refusal
from mavdem.facts.serve import Permission, RefusalReason
from mavdem.machine import LOOPBACK
from mavdem.report.pages.library_page import viewer_script
from mavdem.serve.rights import Rights

PROGRAM_FILES = {"re_viewer.js": "text/javascript", "re_viewer_bg.wasm": "application/wasm"}
"""Files of the viewer's program, of rerun-sdk 0.41, with their media types."""

LENGTH_HEADER = "rerun-final-length"
"""Header in which the process of the viewer sends the length of a file, bytes."""

CHUNK_BYTES = 1 << 20
"""Bytes of the program that are passed on at once: a choice. The larger file has 43 MB."""

MAX_FILE_WAIT = 10.0
"""Seconds in which the process of the viewer must answer: a choice; it takes milliseconds."""


def viewer_policy(data_port: int | None = None) -> str:
    """Returns the directives of the content security policy that only the page with Rerun's viewer needs.

    The page may compile the viewer, which is a WebAssembly program, and request the recording from the process that
    serves it on this machine.

    Args:
        data_port: TCP port at which that process serves the recording; None where it is not known yet, which permits
            any port of this machine.

    Returns:
        Directives of the header ``Content-Security-Policy``.
    """
    port = "*" if data_port is None else str(data_port)
    return (
        "script-src 'self' 'wasm-unsafe-eval'; img-src 'self' data: blob:; "
        f"connect-src 'self' http://{LOOPBACK}:{port}"
    )


class ViewerFiles:
    """Endpoints with the program of Rerun's viewer, and the script that starts it."""

    def __init__(self, rights: Rights, program_port: Callable[[], int | None]) -> None:
        """Stores the rights, and the source of the port of the viewer's process.

        Args:
            rights: who may see recordings.
            program_port: function that returns the port of this machine at which the process of the viewer has its
                program; None while none runs.
        """
        self._rights = rights
        self._program_port = program_port

    def script(self, request: HttpRequest) -> Response:
        """Answers with the script of the viewer's page, ``rerun.js``."""
        return Response(viewer_script(), media_type="text/javascript")

    def program_file(self, request: HttpRequest) -> Response:
        """Answers with a file of the viewer's program, as its process sends it.

        Args:
            request: the request, with the name of the file in its path.

        Raises:
            Refusal: the visitor may not read, there is no such file, or no viewer runs.
        """
        self._rights.require(request, Permission.READ)
        name = request.path_params["name"]
        port = self._program_port()
        if name not in PROGRAM_FILES or port is None:
            raise Refusal(RefusalReason.NO_SUCH_FILE, name=name)
        connection = HTTPConnection(LOOPBACK, port, timeout=MAX_FILE_WAIT)
        try:
            connection.request("GET", f"/{name}")
            response = connection.getresponse()
        except (OSError, HTTPException) as error:
            connection.close()
            raise Refusal(RefusalReason.NOT_STARTED, name=name, reason=str(error)) from None
        # Rerun sends the file in chunks, with its length in a header. The page needs it to say how much has come.
        length = response.getheader(LENGTH_HEADER)
        headers = {} if length is None else {"Content-Length": length}
        return StreamingResponse(
            _chunks(connection, response), media_type=PROGRAM_FILES[name], headers=headers
        )


def _chunks(connection: HTTPConnection, response: ViewerResponse) -> Iterator[bytes]:
    """Yields a response piece by piece, and closes its connection at the end."""
    try:
        while chunk := response.read(CHUNK_BYTES):
            yield chunk
    finally:
        connection.close()
