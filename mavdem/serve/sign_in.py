"""Endpoints of a server for browsers to sign in with the token, and out again."""

from urllib.parse import parse_qs

from starlette.requests import Request as HttpRequest
from starlette.responses import RedirectResponse, Response

from mavdem.errors import Refusal
from mavdem.facts.serve import Permission, RefusalReason
from mavdem.serve.requests import read_body
from mavdem.serve.rights import COOKIE_NAME, Rights


class SignIn:
    """Endpoints that set and delete the cookie with which a browser may read all flights."""

    def __init__(self, rights: Rights) -> None:
        """Takes the access ``rights`` of the server."""
        self._rights = rights

    def form(self, request: HttpRequest) -> Response:
        """Refuses the request: the page of that refusal has the form that asks for the token."""
        raise Refusal(RefusalReason.NO_RIGHT, name=Permission.READ)

    async def sign_in(self, request: HttpRequest) -> Response:
        """Checks the token of a form, and gives the browser the cookie for reading.

        The cookie holds a key that is derived from the token, not the token itself, and JavaScript cannot read it. A
        wrong token is answered after a delay, which slows guessing down.
        """
        fields = parse_qs((await read_body(request)).decode(errors="replace"))
        token = fields.get("token", [""])[0].strip()
        if not self._rights.is_token(token):
            await self._rights.delay_wrong_token()
            raise Refusal(RefusalReason.WRONG_TOKEN)
        response = RedirectResponse("/", 303)
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
