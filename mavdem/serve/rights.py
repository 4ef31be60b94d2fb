"""Access rights: who may read, upload and change flights, by one secret token, and which sites may send requests.

Without a token the server listens on this machine only, or a proxy has checked who has access, and everybody who
reaches it owns all flights. With a token, keys derived from it allow less than the token itself: the cookie of a
browser, which the link that signs it in has too, only reads, the key in the address that QGroundControl is given only
uploads, and the key within a page also changes flights.
"""

import asyncio
import hashlib
import hmac
import re
from dataclasses import dataclass, field

from starlette.requests import HTTPConnection

from mavdem.errors import Refusal, Unreadable
from mavdem.facts.serve import Permission, RefusalReason, Sharing, StartFailure
from mavdem.machine import LOOPBACK_HOSTS
from mavdem.serve.index import LibraryEntry

COOKIE_NAME = "mavdem"
"""Name of the cookie with the key for reading."""

MIN_TOKEN_LETTERS = 16
"""Letters of a token, at least: as many hexadecimal digits have 64 random bits."""

KEY_DIGITS = 32
"""Hexadecimal digits of a derived key: 128 bits, which cannot be guessed."""

WRONG_TOKEN_DELAY = 1.0
"""Seconds until a request with a wrong token or key is answered, one after another, so that guessing takes long."""

SAME_SITE = ("same-origin", "none")
"""Values of the header Sec-Fetch-Site for requests by pages of this server, and by users who type an address."""


@dataclass(frozen=True)
class Rights:
    """The access rights on one server: who may read, add and delete flights, by a secret token."""

    token: str = ""
    """Secret of the owner; empty where everybody who reaches the server is the owner."""
    is_local: bool = True
    """Whether only requests to the names of this machine are answered.

    This prevents DNS rebinding, where another site's name is made to point to this machine.
    """
    _wrong_token_lock: asyncio.Lock = field(default_factory=asyncio.Lock, compare=False)
    """Held while a request with a wrong token or key waits: those of many connections wait one after another."""

    async def delay_wrong_token(self) -> None:
        """Waits ``WRONG_TOKEN_DELAY`` before a wrong token or key is answered, after all that already wait.

        Guesses on many connections at once are therefore as slow as those on one.
        """
        async with self._wrong_token_lock:
            await asyncio.sleep(WRONG_TOKEN_DELAY)

    def derived_key(self, use: Permission) -> str:
        """Returns the key for one use, an HMAC of its name with the token; empty without a token."""
        if not self.token:
            return ""
        return hmac.new(self.token.encode(), use.encode(), hashlib.sha256).hexdigest()[:KEY_DIGITS]

    def allows(self, request: HTTPConnection, use: Permission) -> bool:
        """Returns whether the sender of a request may use all flights of the library in this way.

        The token, or the key for writing, in the header Authorization allows every use. The cookie allows reading only,
        and the key in the path of an upload's address allows uploading only.

        Args:
            request: the request, whose headers, cookies and path may have a secret.
            use: right that the request needs.
        """
        if self._secret_allows(_bearer_secret(request), Permission.WRITE):
            return True
        if use is Permission.READ:
            secret = request.cookies.get(COOKIE_NAME)
        elif use is Permission.UPLOAD:
            secret = request.path_params.get("key")
        else:
            secret = None
        return self._secret_allows(secret or "", use)

    def has_wrong_secret(self, request: HTTPConnection) -> bool:
        """Returns whether a request has a secret that is wrong, so that its sender may be guessing the token.

        It may be in the header Authorization, in the cookie, or in the path of an upload's address.

        Args:
            request: the request.
        """
        secrets = {
            Permission.WRITE: _bearer_secret(request),
            Permission.READ: request.cookies.get(COOKIE_NAME),
            Permission.UPLOAD: request.path_params.get("key"),
        }
        # A request without a secret is no attempt to guess it.
        sent_secrets = {use: secret for use, secret in secrets.items() if secret}
        return not all(self._secret_allows(secret, use) for use, secret in sent_secrets.items())

    def has_wrong_cookie(self, request: HTTPConnection) -> bool:
        """Returns whether a request has the cookie of an earlier token, or a made-up one."""
        secret = request.cookies.get(COOKIE_NAME)
        return bool(secret) and not self._secret_allows(secret or "", Permission.READ)

    def require(self, request: HTTPConnection, use: Permission) -> None:
        """Checks that the sender of a request may use the flights of the library in this way.

        Args:
            request: the request, which may have a secret.
            use: right that the request needs: to see, read or change flights.

        Raises:
            Refusal: the sender has no such right.
        """
        if not self.allows(request, use):
            raise Refusal(RefusalReason.NO_RIGHT, name=use)

    def allows_viewing(self, request: HTTPConnection, entry: LibraryEntry) -> bool:
        """Returns whether the sender of a request, who has the flight's link, may see this flight."""
        return entry.sharing in (Sharing.LINK, Sharing.PUBLIC) or self.allows(
            request, Permission.READ
        )

    def is_token(self, secret: str) -> bool:
        """Returns whether a secret is the token, in a time that does not depend on how much of it agrees."""
        return hmac.compare_digest(secret.encode(), self.token.encode())

    def is_reading_key(self, secret: str) -> bool:
        """Returns whether a secret is the key for reading or the token, in a time that does not depend on it."""
        return self._secret_allows(secret, Permission.READ)

    def _secret_allows(self, secret: str, use: Permission) -> bool:
        """Returns whether a secret is the token or the key for this use; without a token any secret is."""
        if not self.token:
            return True
        key = self.derived_key(use)
        return self.is_token(secret) or hmac.compare_digest(secret.encode(), key.encode())

    def check_origin(self, request: HTTPConnection) -> None:
        """Checks that a request is addressed to this machine, and is not made by a page of another site.

        The first check prevents DNS rebinding, the second cross-site request forgery. Requests that only read (GET,
        HEAD) may come from other sites, since browsers do not show them the answer.

        Args:
            request: the request, with its headers Host and Origin.

        Raises:
            Refusal: the request is for another host, or would change something on behalf of another site.
        """
        host = request.headers.get("host", "")
        host_without_port = re.sub(r":\d*$", "", host).lower()
        if self.is_local and host_without_port not in LOOPBACK_HOSTS:
            raise Refusal(RefusalReason.OTHER_SITE, address=host)
        if request.scope["method"] in ("GET", "HEAD"):
            return
        origin = request.headers.get("origin")
        # Programs and old browsers do not send the header.
        fetch_site = request.headers.get("sec-fetch-site", SAME_SITE[0])
        is_other_origin = origin is not None and origin.partition("://")[2] != host
        if fetch_site not in SAME_SITE or is_other_origin:
            raise Refusal(RefusalReason.OTHER_SITE, address=origin or fetch_site)


def rights_for_host(
    host: str, token: str, *, is_behind_proxy: bool, has_library: bool = True
) -> Rights:
    """Returns the access rights on a server, after checking that they suffice for its address.

    Args:
        host: name or address that the server listens on.
        token: secret of the owner; empty for none.
        is_behind_proxy: whether a reverse proxy in front of the server checks its users.
        has_library: whether the server has a library of flights, and not only the page of a live session.

    Returns:
        The rights.

    Raises:
        Unreadable: the token is too short, or other machines could reach the server and it has no token.
    """
    if token and len(token) < MIN_TOKEN_LETTERS:
        raise Unreadable(StartFailure.TOKEN_TOO_SHORT, count=len(token), needed=MIN_TOKEN_LETTERS)
    if not token and not is_behind_proxy and host not in LOOPBACK_HOSTS:
        raise Unreadable(StartFailure.TOKEN_NEEDED, address=host, has_library=has_library)
    return Rights(token, is_local=not token and not is_behind_proxy)


def _bearer_secret(request: HTTPConnection) -> str:
    """Returns the secret in the header ``Authorization: Bearer SECRET``; empty without one."""
    scheme, _, secret = request.headers.get("authorization", "").partition(" ")
    return secret.strip() if scheme.lower() == "bearer" else ""
