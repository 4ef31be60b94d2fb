"""The page of a live session, and the endpoints of a server that answer with it and with what is new in it."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from http import HTTPStatus
from typing import Protocol

from starlette.requests import Request as HttpRequest
from starlette.responses import HTMLResponse, Response

from mavdem.errors import Refusal
from mavdem.facts.event import Event
from mavdem.facts.serve import Permission, RefusalReason
from mavdem.fleet.names import NO_NAMES, GivenNames
from mavdem.live import clock
from mavdem.live.session import LiveSession
from mavdem.live.session_status import SessionStatus
from mavdem.report.pages.live_page import live_page
from mavdem.report.pages.page import page_update
from mavdem.report.pages.page_link import PageLink
from mavdem.report.templates import Medium, sentences_for
from mavdem.serve.rights import Rights

LIVE_PATH = "/live"
"""Path of the page of a live session."""

PAGE_SECONDS = 5.0
"""Seconds between two pages of a session; one with an alarm or another event comes at once."""

NEWS_SECONDS = 0.2
"""Seconds between two looks whether a session has reported something that its page does not show: a choice."""

AGE_SECONDS = 1.0
"""Seconds between two pages of a session that says how long ago its vehicle fell silent in flight."""

PAUSE_PER_RENDERING_SECOND = 3.0
"""Pause after a page until one with newer events, in multiples of the time that rendering it took: a choice.

Without it, a vehicle that reports events without end would leave the session no time for its messages.
"""

MAX_PAUSE = 1.0
"""Longest such pause, s: a choice; rendering takes a tenth of a second."""

MAX_FIRST_PAGE_WAIT = 20.0
"""Seconds for which a browser waits for the first page of a session, at most.

The process that learns starts before the session, which takes seconds.
"""

MAX_UPDATE_WAIT = 2.0
"""Seconds for which the answer on what is new in a session waits until something is: a choice.

A page that gets no answer for longer says so.
"""

UPDATE_POLL_SECONDS = 0.1
"""Seconds between two looks whether there is a newer page for a waiting browser: a choice; an alarm comes at once."""


@dataclass(frozen=True)
class SessionPage:
    """The page of a live session as it was at one moment."""

    html: str
    """The page as HTML; empty before there is one."""

    made_time: float
    """When it was made, s of the monotonic clock."""

    longest_age: float = PAGE_SECONDS
    """Age at which it is rendered again, s, where nothing is reported before."""

    latest_event: Event | None = None
    """The latest event that the session had reported when it was made; None before any."""

    rendering_seconds: float = 0.0
    """Time that rendering it took, s."""

    @classmethod
    def made_now(
        cls, html: str, session: LiveSession, status: SessionStatus, start_time: float
    ) -> SessionPage:
        """Returns a page of a session that was just rendered.

        Args:
            html: the page.
            session: the session, with all events that it has reported.
            status: its state that the page shows.
            start_time: when rendering it began, s of the monotonic clock.
        """
        now = clock.monotonic()
        longest_age = PAGE_SECONDS if status.link_loss is None else AGE_SECONDS
        return cls(html, now, longest_age, _latest_event(session), now - start_time)

    def is_outdated(self, session: LiveSession) -> bool:
        """Returns whether it is too old, or the session has reported an event since."""
        if not self.html or self.age >= self.longest_age:
            return True
        pause = min(PAUSE_PER_RENDERING_SECOND * self.rendering_seconds, MAX_PAUSE)
        return _latest_event(session) is not self.latest_event and self.age >= pause

    @cached_property
    def tag(self) -> str:
        """A text that no other page has, as the header ETag needs it; empty before there is a page."""
        if not self.html:
            return ""
        return f'"{sha256(self.html.encode()).hexdigest()}"'

    @cached_property
    def update(self) -> str:
        """What the page shows, without its style and scripts, for browsers in which an earlier one is open."""
        return page_update(self.html)

    @property
    def age(self) -> float:
        """Time since it was made, s."""
        return clock.monotonic() - self.made_time


def _latest_event(session: LiveSession) -> Event | None:
    """Returns the latest event that a session has reported; None before any."""
    events = session.history.events
    return events[-1] if events else None


class SessionPages(Protocol):
    """What renders the page of a live session again and again."""

    @property
    def page(self) -> SessionPage:
        """The page of the running session, which is at most a few seconds old; empty before the first one.

        Raises:
            Refusal: no session runs any more.
        """


class LivePages:
    """The endpoints of a server that answer with the page of a live session, and with what is new in it."""

    def __init__(self, rights: Rights, session_pages: SessionPages | None) -> None:
        """Stores the rights, and the source of the session's pages.

        Args:
            rights: who may read the page.
            session_pages: what renders it; None where no session runs.
        """
        self._rights = rights
        self._session_pages = session_pages

    async def live_session(self, request: HttpRequest) -> Response:
        """Answers with the page of the live session, which keeps itself up to date in the browser.

        As in the library, who may read it gets the key for changes: the page can store that a fault was repaired.
        """
        page = await self._newest_page(request, MAX_FIRST_PAGE_WAIT)
        key = self._rights.derived_key(Permission.WRITE)
        key_element = f'<meta name="mavdem-key" content="{key}">' if key else ""
        return HTMLResponse(page.html.replace("</head>", f"{key_element}</head>", 1))

    async def live_session_update(self, request: HttpRequest) -> Response:
        """Answers with the newest content of the session's page, for a browser in which an earlier one is open.

        This is long polling with entity tags (RFC 9110, sec. 8.8.3). While the browser shows the newest page, the
        answer waits for ``MAX_UPDATE_WAIT`` at most, and then has the status 304, as it has before the first page.

        Args:
            request: the request, whose header If-None-Match has the tag of the page that the browser shows.

        Returns:
            Title and main part of the page; its header Age has the time since the page was made, s.

        Raises:
            Refusal: the sender has no right, the server has no link, or no session runs any more.
        """
        # Proxies that compress answers turn strong tags into weak ones; the two compare as equal here (sec. 13.1.2).
        shown_tag = request.headers.get("if-none-match", "").removeprefix("W/")
        page = await self._newest_page(request, MAX_UPDATE_WAIT, shown_tag)
        headers = {"ETag": page.tag, "Age": f"{page.age:.1f}"}
        if page.tag in ("", shown_tag):
            return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
        return HTMLResponse(page.update, headers=headers)

    async def _newest_page(
        self, request: HttpRequest, longest_wait: float, shown_tag: str = ""
    ) -> SessionPage:
        """Returns the page of the live session, after waiting for the first one, or for another than is shown.

        Args:
            request: the request, whose sender needs the right to read.
            longest_wait: time after which the page is returned as it is, s.
            shown_tag: tag of the page that the browser shows; empty for none.

        Raises:
            Refusal: the sender has no right, the server has no link, or no session runs any more.
        """
        self._rights.require(request, Permission.READ)
        if self._session_pages is None:
            raise Refusal(RefusalReason.NO_LINK)
        deadline = clock.monotonic() + longest_wait
        page = self._session_pages.page
        while page.tag in ("", shown_tag) and clock.monotonic() < deadline:
            await asyncio.sleep(UPDATE_POLL_SECONDS)
            page = self._session_pages.page
        return page


def session_page(
    session: LiveSession,
    status: SessionStatus,
    names: GivenNames = NO_NAMES,
    *,
    back: PageLink | None = None,
    links: Sequence[PageLink] = (),
    saved_flight: PageLink | None = None,
    files: Sequence[str] = (),
    is_last: bool = False,
) -> str:
    """Returns the HTML page of a live session as the server shows it, which a browser loads again every few seconds.

    Args:
        session: the session, with the history of its flight.
        status: state of the session now: vehicle, learning, alarms, headline and next step.
        names: names that were given to vehicles in the library.
        back: link to the page that leads here, if any.
        links: links to other pages, such as that of the flight before.
        saved_flight: link to the page of this session's flight in the library; None while the session goes on.
        files: sentences on the files that the session has written, once it is over.
        is_last: whether the server ends after this page, so that a browser must keep it and not ask for a newer one.
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
            files=files,
            refresh_seconds=None if is_last else PAGE_SECONDS,
        )
