"""The page of a live session, and the endpoint of a server that answers with it."""

from collections.abc import Sequence
from typing import Protocol

from starlette.requests import Request as HttpRequest
from starlette.responses import HTMLResponse, Response

from mavdem.errors import Refusal
from mavdem.facts.serve import Permission, RefusalReason
from mavdem.fleet.names import NO_NAMES, GivenNames
from mavdem.live.session import LiveSession
from mavdem.live.session_status import SessionStatus
from mavdem.report.pages.flight_page import live_page
from mavdem.report.pages.page import PageLink
from mavdem.report.templates import Medium, sentences_for
from mavdem.serve.rights import Rights

PAGE_SECONDS = 5.0
"""Seconds between two pages of a session."""


class SessionPages(Protocol):
    """What renders the page of a live session again and again."""

    @property
    def page(self) -> str:
        """The HTML page of the running session, which is at most a few seconds old.

        Raises:
            Refusal: no session runs any more.
        """


class LivePages:
    """The endpoint of a server that answers with the page of a live session."""

    def __init__(self, rights: Rights, session_pages: SessionPages | None) -> None:
        """Takes what the answer depends on.

        Args:
            rights: who may read the page.
            session_pages: what renders it; None where no session runs.
        """
        self._rights = rights
        self._session_pages = session_pages

    def live_session(self, request: HttpRequest) -> Response:
        """Answers with the page of the live session, which the browser loads again every few seconds."""
        self._rights.require(request, Permission.READ)
        if self._session_pages is None:
            raise Refusal(RefusalReason.NO_SUCH_FLIGHT)
        return HTMLResponse(self._session_pages.page, headers={"Refresh": f"{PAGE_SECONDS:g}"})


def session_page(
    session: LiveSession,
    status: SessionStatus,
    names: GivenNames = NO_NAMES,
    *,
    back: PageLink | None = None,
    links: Sequence[PageLink] = (),
    saved_flight: PageLink | None = None,
) -> str:
    """Returns the HTML page of a live session.

    Args:
        session: the session, with the history of its flight.
        status: state of the live session: vehicle, learning, alarms, headline and next step.
        names: names that were given to vehicles in the library.
        back: link to the page that leads here, if any.
        links: links to other pages, such as that of the flight before.
        saved_flight: link to the page of this session's flight in the library; None while the session goes on.
    """
    # Sentences for a browser must not advise options of `mavdem live`, which its reader cannot give.
    with sentences_for(Medium(has_terminal=False)):
        return live_page(
            session.link.name,
            session.stream.axis,
            session.history,
            status,
            session.time_account(),
            learned=None,
            back=back,
            links=links,
            saved_flight=saved_flight,
            names=names,
        )
