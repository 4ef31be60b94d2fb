"""Rights: who may read, upload and change, by one token; and which sites a browser may ask from.

Without a token the server listens on this machine only, or a proxy has checked who comes in, and everybody who reaches
it owns all flights. With one, derived keys do less than the token itself: a browser's cookie reads, the key within a
page changes, and the upload key, which stands in an address given to QGroundControl, uploads.
"""

import hashlib
import hmac
import re
from dataclasses import dataclass

from starlette.requests import HTTPConnection

from mavdem.errors import Refusal, Unreadable
from mavdem.facts.serve import Request, Sharing, Start, Use
from mavdem.serve.library import Entry

COOKIE = "mavdem"
FEWEST_LETTERS = 16  # of a token: 64 bits in hexadecimal digits
LOOPBACK = ("127.0.0.1", "localhost", "::1", "[::1]")
SAME_SITE = ("same-origin", "none")
"""Values of Sec-Fetch-Site of what a page of this server, or the user by a typed address, asks for."""


@dataclass(frozen=True)
class Rights:
    """Who may do what.

    Attributes:
        token: the secret of the owner; empty where everybody who reaches the server is one.
        is_local: only names of this machine are answered to, whatever a name server says of others.
    """

    token: str = ""
    is_local: bool = True

    def key(self, use: Use) -> str:
        """Returns the key for one ``use``; empty without a token."""
        if not self.token:
            return ""
        return hmac.new(self.token.encode(), use.encode(), hashlib.sha256).hexdigest()[:32]

    def may(self, request: HTTPConnection, use: Use) -> bool:
        """Returns whether the one who asks has the right to this ``use`` of all flights."""
        if self._holds(_bearer(request), Use.WRITE):
            return True
        # A cookie reads and no more, and so does the key in the address upload.
        weak = {Use.READ: request.cookies.get(COOKIE), Use.UPLOAD: request.path_params.get("key")}
        return self._holds(weak.get(use) or "", use)

    def need(self, request: HTTPConnection, use: Use) -> None:
        """Raises ``Refusal`` where the one who asks has no right to this ``use``."""
        if not self.may(request, use):
            raise Refusal(Request.NO_RIGHT, name=use)

    def may_see(self, request: HTTPConnection, entry: Entry) -> bool:
        """Returns whether the one who asks, and has its link, may see a flight."""
        return entry.sharing in (Sharing.LINK, Sharing.PUBLIC) or self.may(request, Use.READ)

    def is_token(self, token: str) -> bool:
        """Returns whether this is the token."""
        return hmac.compare_digest(token.encode(), self.token.encode())

    def _holds(self, secret: str, use: Use) -> bool:
        if not self.token:
            return True
        return self.is_token(secret) or hmac.compare_digest(secret.encode(), self.key(use).encode())

    def check_site(self, request: HTTPConnection) -> None:
        """Raises ``Refusal`` for what another site's page asks for, or under a name that is not this machine's."""
        host = request.headers.get("host", "")
        if self.is_local and re.sub(r":\d*$", "", host).lower() not in LOOPBACK:
            raise Refusal(Request.OTHER_SITE, address=host)
        if request.scope["method"] in ("GET", "HEAD"):
            return
        origin = request.headers.get("origin")
        site = request.headers.get("sec-fetch-site", SAME_SITE[0])
        if site not in SAME_SITE or (origin is not None and origin.partition("://")[2] != host):
            raise Refusal(Request.OTHER_SITE, address=origin or site)


def rights_of(host: str, token: str, is_behind_proxy: bool) -> Rights:
    """Returns the rights on a server that listens on ``host``; raises ``Unreadable`` where that is not safe."""
    if token and len(token) < FEWEST_LETTERS:
        raise Unreadable(Start.TOKEN_TOO_SHORT, count=len(token), needed=FEWEST_LETTERS)
    if not token and not is_behind_proxy and host not in LOOPBACK:
        raise Unreadable(Start.TOKEN_NEEDED, address=host)
    return Rights(token, is_local=not token and not is_behind_proxy)


def _bearer(request: HTTPConnection) -> str:
    kind, _, secret = request.headers.get("authorization", "").partition(" ")
    return secret.strip() if kind.lower() == "bearer" else ""
