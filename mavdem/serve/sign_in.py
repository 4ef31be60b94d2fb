"""Endpoints of a server for browsers to sign in with the token or by a link, and out again."""

from urllib.parse import parse_qs

from starlette.requests import Request as HttpRequest
from starlette.responses import RedirectResponse, Response

from mavdem.errors import Refusal
from mavdem.facts.serve import Permission, RefusalReason
from mavdem.serve.requests import read_body
from mavdem.serve.rights import COOKIE_NAME, Rights

SIGN_IN_PATH = "/enter"
"""Path of the form for the token, and of the link that signs a browser in."""


class SignIn:
    """Endpoints that set and delete the cookie with which a browser may read all flights."""

    def __init__(self, rights: Rights, first_page: str = "/") -> None:
        """Takes the access rights of the server.

        Args:
            rights: who may read.
            first_page: path of the page to which the link that signs in leads.
        """
        self._rights = rights
        self._first_page = first_page

    async def form(self, request: HttpRequest) -> Response:
        """Signs in the browser that follows the link with the key for reading; without a key, asks for the token.

        Raises:
            Refusal: there is no key, or a wrong one. The page of that refusal has the form that asks for the token.
        """
        key = request.query_params.get("key", "")
        if not key:
            raise Refusal(RefusalReason.NO_RIGHT, name=Permission.READ)
        if not self._rights.is_reading_key(key):
            await self._rights.delay_wrong_token()
            raise Refusal(RefusalReason.WRONG_TOKEN)
        return self._signed_in(request, self._first_page)

    async def sign_in(self, request: HttpRequest) -> Response:
        """Checks the token of a form, and gives the browser the cookie for reading.

        A wrong token is answered after a delay, which slows guessing down.
        """
        fields = parse_qs((await read_body(request)).decode(errors="replace"))
        token = fields.get("token", [""])[0].strip()
        if not self._rights.is_token(token):
            await self._rights.delay_wrong_token()
            raise Refusal(RefusalReason.WRONG_TOKEN)
        return self._signed_in(request, "/")

    def _signed_in(self, request: HttpRequest, page: str) -> Response:
        """Redirects a browser to a page, and gives it the cookie for reading.

        The cookie holds a key that is derived from the token, not the token itself, and JavaScript cannot read it.

        Args:
            request: request of the browser.
            page: path of the page.
        """
        response = RedirectResponse(page, 303)
        response.set_cookie(
            COOKIE_NAME,
            self._rights.derived_key(Permission.READ),
            httponly=True,
            samesite="lax",
            secure=request.url.scheme == "https",
        )
        return response

    def sign_out(self, request: HttpRequest) -> Response:
        """Removes the cookie from the browser."""
        response = RedirectResponse("/", 303)
        response.delete_cookie(COOKIE_NAME)
        return response
