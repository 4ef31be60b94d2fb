"""The web application of the server: its routes, and responses to refusals, each by a fact (a coded finding)."""

import asyncio
import inspect
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from functools import cached_property
from http import HTTPStatus
from pathlib import Path
from typing import Any, Protocol

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect
from starlette.requests import Request as HttpRequest
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route

from mavdem.containers import Names
from mavdem.documents import complete_document
from mavdem.errors import Refusal
from mavdem.facts import Fact
from mavdem.facts.serve import RefusalReason
from mavdem.report.pages.library_page import refusal_page, script_hashes
from mavdem.serve.api import Api
from mavdem.serve.field_store import FieldStore
from mavdem.serve.library import Library
from mavdem.serve.link_monitor import LinkMonitor
from mavdem.serve.openapi import STATUS_BY_REFUSAL
from mavdem.serve.pages import Pages
from mavdem.serve.requests import error_values
from mavdem.serve.rights import COOKIE_NAME, Rights
from mavdem.serve.visible_library import VisibleLibrary

RETRY_HEADERS = {"Retry-After": "10"}
"""Header with the seconds after which a request to a busy or ending server may be repeated."""

CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'self' {scripts}; style-src 'unsafe-inline'; img-src data:; connect-src 'self'; "
    "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
"""Policy that lets pages run only the server's own script and those of a flight's charts, by their hashes, show no
frames, and load nothing from other servers. The page with Rerun's viewer adds a frame from this machine."""

Endpoint = Callable[[HttpRequest], Awaitable[Response]]
"""A coroutine function that answers a request."""


class BackgroundReading(Protocol):
    """The work that reads the waiting logs of the library in the background, such as ``ReadingThreads``."""

    def start(self) -> None:
        """Starts the work."""

    def notify(self) -> None:
        """Reports that a log was added to the library, or recordings were requested."""

    def stop(self) -> None:
        """Ends the work, and returns when it has ended."""


class Server:
    """The web application of ``mavdem serve``."""

    def __init__(
        self,
        library: Library,
        rights: Rights,
        reading: BackgroundReading,
        sample_log: Path | None = None,
        open_recording: Callable[[Path], str] | None = None,
        monitor: LinkMonitor | None = None,
        fields: FieldStore | None = None,
    ) -> None:
        """Joins the parts of the server.

        Args:
            library: the logs that the server stores, with their results and their index.
            rights: who may read, upload and change its flights.
            reading: threads that read the uploaded logs.
            sample_log: a log that visitors may try the server with.
            open_recording: opens a recording in a viewer on this machine and returns its address; None if that is not
                possible.
            monitor: monitor of a live link; None without one.
            fields: the columns of the logs whose fields are plotted; None for those of a process of its own.
        """
        self._library = library
        self._rights = rights
        self._reading = reading
        self._monitor = monitor
        self._visible_library = VisibleLibrary(library, rights)
        self._pages = Pages(
            self._visible_library, reading.notify, sample_log, open_recording, monitor
        )
        self._fields = fields or FieldStore()
        # The pages of flights have the scripts of the version that wrote them, which may be an earlier one.
        self._response_headers = _response_headers(library.known_scripts(script_hashes()))
        self._api = Api(self._visible_library, reading.notify, open_recording, self._fields)

    @cached_property
    def app(self) -> Starlette:
        """The ASGI application: the addresses of the server, and what answers each of them.

        The pages are for browsers, below ``/``; the JSON interface is below ``/api``. Logs are
        uploaded as to PX4's Flight Review, to ``/upload``, or ``/{key}/upload`` where a token is needed. Every endpoint
        is guarded: refusals become answers, and all answers get security headers.
        """
        pages = self._pages
        api = self._api
        endpoints: dict[str, Callable[[HttpRequest], Any]] = {
            "GET /": pages.list_flights,
            "GET /f/{id}": pages.flight,
            "GET /f/{id}/viewer": pages.viewer,
            "GET /f/{id}/{name}": pages.file,
            "GET /live": pages.live_session,
            "GET /vehicle": pages.vehicle,
            "GET /compare": pages.compare,
            "GET /enter": pages.sign_in_form,
            "POST /enter": pages.sign_in,
            "POST /leave": pages.sign_out,
            "GET /static/serve.js": pages.script,
            "GET /static/sample": pages.sample_log,
            "POST /upload": api.upload,
            "POST /{key}/upload": api.upload,
            "POST /api/logs": api.add_logs,
            "GET /api/flights": api.list_flights,
            "GET /api/flights/{id}": api.flight,
            "PATCH /api/flights/{id}": api.change_flight,
            "DELETE /api/flights/{id}": api.delete_flight,
            "GET /api/flights/{id}/recordings": api.recordings,
            "POST /api/flights/{id}/recordings": api.make_recordings,
            "GET /api/flights/{id}/fields": api.fields,
            "GET /api/flights/{id}/samples": api.samples,
            "POST /api/flights/{id}/viewer": api.open_viewer,
            "PUT /api/baseline": api.set_baseline,
            "PUT /api/vehicle": api.name_vehicle,
            "GET /api/progress": api.progress,
            "GET /api/openapi.json": api.describe,
        }
        routes = []
        for method_and_path, endpoint in endpoints.items():
            method, path = method_and_path.split()
            routes.append(Route(path, self._guarded_endpoint(endpoint), methods=[method]))
        return Starlette(
            routes=routes,
            lifespan=self._lifespan,
            exception_handlers={Exception: self._answer_to_defect},
        )

    @asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        """Starts the background work when the server starts, and ends it with the server; called by Starlette.

        The live session is ended before the reading of logs, since its recording is added to the library at its end.
        """
        self._reading.start()
        if self._monitor is not None:
            self._monitor.start()
        yield
        if self._monitor is not None:
            await run_in_threadpool(self._monitor.stop)
        await run_in_threadpool(self._fields.stop)
        await run_in_threadpool(self._reading.stop)
        self._library.close()

    def _guarded_endpoint(self, endpoint: Callable[[HttpRequest], Any]) -> Endpoint:
        """Wraps an endpoint so that refusals become responses, and all responses get the security headers.

        Args:
            endpoint: a coroutine function, or a plain function, which is then called in a thread.

        Returns:
            A coroutine function that answers a request.
        """

        async def answer(request: HttpRequest) -> Response:
            """Answers one request by the endpoint, or with the reason why it is refused."""
            has_wrong_secret = self._rights.has_wrong_secret(request)
            try:
                # A page of another server must not act with the rights of this server's visitors.
                self._rights.check_origin(request)
                if has_wrong_secret:
                    await self._rights.delay_wrong_token()
                if inspect.iscoroutinefunction(endpoint):
                    response = await endpoint(request)
                else:
                    response = await run_in_threadpool(endpoint, request)
            except Refusal as error:
                response = await run_in_threadpool(self._answer_to_refusal, request, error.fact)
            except ClientDisconnect:
                response = Response(status_code=HTTPStatus.BAD_REQUEST)
            except asyncio.CancelledError:
                # The server is ending. The answer has the time after which to repeat the request.
                response = Response(
                    status_code=HTTPStatus.SERVICE_UNAVAILABLE, headers=RETRY_HEADERS
                )
            additional_policy = response.headers.get("content-security-policy", "")
            response.headers.update(self._response_headers)
            if additional_policy:
                policy = response.headers["content-security-policy"]
                response.headers["content-security-policy"] = f"{policy}; {additional_policy}"
            # A browser that has the cookie of an earlier token waits only once. The answer may bring the right one.
            if self._rights.has_wrong_cookie(request) and "Set-Cookie" not in response.headers:
                response.delete_cookie(COOKIE_NAME)
            return response

        return answer

    def _answer_to_defect(self, request: HttpRequest, error: Exception) -> Response:
        """Returns the response after an unexpected error, which Starlette raises again to print the traceback.

        The cause is a defect of the program, or a damaged file in the library's folder.

        Args:
            request: the request whose endpoint raised the error.
            error: the error; only the name of its class is sent, since its message may contain paths of this machine.

        Returns:
            A response with the status 500 and the headers of all responses.
        """
        fact = Fact(RefusalReason.ANSWER_FAILED, reason=type(error).__name__)
        response = self._answer_to_refusal(request, fact)
        response.headers.update(self._response_headers)
        return response

    def _answer_to_refusal(self, request: HttpRequest, fact: Fact) -> Response:
        """Returns the response with the reason of a refusal: JSON for programs, a page for browsers.

        The path of the URL decides which of the two is sent. The page for a missing right asks for the token. The
        caller must add the headers that all responses have (``_response_headers``).

        Args:
            request: the request that was refused.
            fact: reason of the refusal, a coded finding whose code selects the HTTP status from ``STATUS_BY_REFUSAL``.

        Returns:
            A JSON document of the kind "error", or an HTML page. A status of 503 has the header Retry-After.
        """
        # Codes of other enumerations are reasons why an uploaded file cannot be read as a log.
        default_status = HTTPStatus.UNSUPPORTED_MEDIA_TYPE
        if isinstance(fact.code, RefusalReason):
            default_status = HTTPStatus.BAD_REQUEST
        status = STATUS_BY_REFUSAL.get(fact.code, default_status)
        headers = RETRY_HEADERS if status == HTTPStatus.SERVICE_UNAVAILABLE else None
        # The path is taken from the scope: request.url raises an error if the header Host is no valid address.
        path = request.scope["path"]
        if path.startswith("/api/") or path.endswith("/upload"):
            return JSONResponse(
                complete_document("error", {"error": error_values(fact)}), status, headers
            )
        asks_for_token = fact.code in (RefusalReason.NO_RIGHT, RefusalReason.WRONG_TOKEN)
        html = refusal_page(
            fact, asks_for_token=asks_for_token, **self._visible_library.visitor_values(request)
        )
        return HTMLResponse(html, status, headers)


def _response_headers(scripts: Names) -> dict[str, str]:
    """Returns the headers of every answer: the policy, no guessing of content types, no copies in shared caches.

    They also keep the secret link of a flight from other sites, which would otherwise see it as the referrer, and keep
    flights out of search engines.

    Args:
        scripts: hashes of the scripts that pages may run besides the server's own.
    """
    return {
        "content-security-policy": CONTENT_SECURITY_POLICY.format(scripts=" ".join(scripts)),
        "x-content-type-options": "nosniff",
        "referrer-policy": "same-origin",
        "cross-origin-opener-policy": "same-origin",
        "cross-origin-resource-policy": "same-origin",
        "cache-control": "no-cache, private",
        "x-robots-tag": "noindex",
    }
