"""Guards the endpoints of a server: checks access rights, adds security headers, and answers refused requests.

A fact is a coded finding, here the reason why a request is refused.
"""

import asyncio
import inspect
from collections.abc import Awaitable, Callable, Mapping
from http import HTTPStatus
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.requests import Request as HttpRequest
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route

from mavdem.containers import JsonValues, Names
from mavdem.documents import complete_document
from mavdem.errors import Refusal
from mavdem.facts import Fact
from mavdem.facts.serve import RefusalReason
from mavdem.report.pages.library_page import refusal_page
from mavdem.serve.openapi import STATUS_BY_REFUSAL
from mavdem.serve.requests import error_values
from mavdem.serve.rights import COOKIE_NAME, Rights

RETRY_HEADERS = {"Retry-After": "10"}
"""Header with the seconds after which a request to a busy or ending server may be repeated."""

POLICY_HEADER = "content-security-policy"
"""Name of the header with the content security policy of a page."""

PAGE_POLICY = {
    "default-src": "'none'",
    "script-src": "'self'",
    "style-src": "'unsafe-inline'",
    "img-src": "data:",
    "connect-src": "'self'",
    "form-action": "'self'",
    "base-uri": "'none'",
    "frame-ancestors": "'none'",
}
"""Content security policy of all pages, by directive (W3C, Content Security Policy Level 3).

It lets pages run only the server's own script and those of a flight's charts, by their hashes, show no frames, and load
nothing from other servers. The page with Rerun's viewer has some directives of its own.
"""

RESPONSE_HEADERS = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-cache, private",
    "x-robots-tag": "noindex",
}
"""Headers of every answer besides the policy: no guessing of content types, and no copies in shared caches.

They also keep the secret link of a flight from other sites, which would otherwise see it as the referrer, and keep
flights out of search engines.
"""

Endpoint = Callable[[HttpRequest], Awaitable[Response]]
"""A coroutine function that answers a request."""


class Guard:
    """Guards the endpoints of one server: wraps each of them, and answers in its place where a request is refused."""

    def __init__(
        self,
        rights: Rights,
        scripts: Names,
        visitor_values: Callable[[HttpRequest], JsonValues],
    ) -> None:
        """Stores the rights, the security headers of all responses, and the source of the templates' values.

        Args:
            rights: who may read, upload and change flights.
            scripts: hashes of the scripts that pages may run besides the server's own.
            visitor_values: function that returns the values that the templates of all pages need, by a request.
        """
        self._rights = rights
        self._policy = PAGE_POLICY | {"script-src": " ".join((PAGE_POLICY["script-src"], *scripts))}
        self._response_headers = RESPONSE_HEADERS | {POLICY_HEADER: _policy_text(self._policy)}
        self._visitor_values = visitor_values

    def routes(self, endpoints: Mapping[str, Callable[[HttpRequest], Any]]) -> list[Route]:
        """Returns Starlette's routes to endpoints, each wrapped so that it checks rights and adds security headers.

        Args:
            endpoints: function that answers the requests, by HTTP method and path, such as "GET /live". It is a
                coroutine function, or a plain one, which is then called in a thread.
        """
        routes = []
        for method_and_path, endpoint in endpoints.items():
            method, path = method_and_path.split()
            routes.append(Route(path, self._guarded_endpoint(endpoint), methods=[method]))
        return routes

    @property
    def exception_handlers(self) -> Mapping[Any, Callable[..., Response]]:
        """What answers where no endpoint does, by the class of the error, as Starlette takes it."""
        return {
            HTTPException: self._answer_to_unknown_address,
            Exception: self._answer_to_defect,
        }

    def _answer_to_unknown_address(self, request: HttpRequest, error: HTTPException) -> Response:
        """Returns the response to a request for an address, or with a method, that no endpoint has.

        Args:
            request: the request.
            error: Starlette's error with the status, 404 or 405, and headers.
        """
        response = self._answer_to_refusal(request, Fact(RefusalReason.NO_SUCH_PAGE))
        response.status_code = error.status_code
        self._add_security_headers(response)
        response.headers.update(error.headers or {})
        return response

    def _answer_to_defect(self, request: HttpRequest, error: Exception) -> Response:
        """Returns the response after an unexpected error in an endpoint, a defect of the program or a damaged file.

        Starlette calls it, and raises the error again afterwards, which prints the traceback on the server's terminal.

        Args:
            request: the request whose endpoint raised the error.
            error: the error; only the name of its class is sent, since its message may contain paths of this machine.

        Returns:
            A response with the status 500 and the security headers.
        """
        fact = Fact(RefusalReason.ANSWER_FAILED, reason=type(error).__name__)
        response = self._answer_to_refusal(request, fact)
        self._add_security_headers(response)
        return response

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
            self._add_security_headers(response)
            # A browser that has the cookie of an earlier token waits only once. The answer may bring the right one.
            if self._rights.has_wrong_cookie(request) and "Set-Cookie" not in response.headers:
                response.delete_cookie(COOKIE_NAME)
            return response

        return answer

    def _add_security_headers(self, response: Response) -> None:
        """Adds the headers of all responses; a content security policy of the page itself extends the common one.

        Args:
            response: the response of an endpoint, which is modified.
        """
        policy_of_page = response.headers.get(POLICY_HEADER, "")
        response.headers.update(self._response_headers)
        if policy_of_page:
            directives = self._policy | _policy_directives(policy_of_page)
            response.headers[POLICY_HEADER] = _policy_text(directives)

    def _answer_to_refusal(self, request: HttpRequest, fact: Fact) -> Response:
        """Returns the response to a refused request: JSON for programs, or an HTML page for browsers.

        The path of the URL decides which of the two is sent. The page for a missing right asks for the access token.
        The caller must add the headers that all responses have.

        Args:
            request: the request that was refused.
            fact: reason of the refusal, a coded finding. Its code selects the HTTP status from ``STATUS_BY_REFUSAL``.

        Returns:
            A JSON document of the kind "error", or an HTML page. A response with the status 503 has the header
            Retry-After.
        """
        # Codes of other enumerations are reasons why an uploaded file cannot be read as a log.
        default_status = HTTPStatus.UNSUPPORTED_MEDIA_TYPE
        if isinstance(fact.code, RefusalReason):
            default_status = HTTPStatus.BAD_REQUEST
        status = STATUS_BY_REFUSAL.get(fact.code, default_status)
        headers = RETRY_HEADERS if status == HTTPStatus.SERVICE_UNAVAILABLE else None
        # ``request.url`` would raise an error if the header Host is no valid address.
        path = request.scope["path"]
        if path.startswith("/api/") or path.endswith("/upload"):
            document = complete_document("error", {"error": error_values(fact)})
            return JSONResponse(document, status, headers)
        asks_for_token = fact.code in (RefusalReason.NO_RIGHT, RefusalReason.WRONG_TOKEN)
        html = refusal_page(fact, asks_for_token=asks_for_token, **self._visitor_values(request))
        return HTMLResponse(html, status, headers)


def _policy_text(policy: Mapping[str, str]) -> str:
    """Returns the text of the header for a content security policy, given as the sources by directive."""
    return "; ".join(f"{directive} {sources}" for directive, sources in policy.items())


def _policy_directives(text: str) -> dict[str, str]:
    """Returns the directives of a content security policy, with their sources, from the text of its header."""
    policy = {}
    for part in text.split(";"):
        directive, _, sources = part.strip().partition(" ")
        policy[directive] = sources
    return policy
