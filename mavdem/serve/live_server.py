"""The server of ``mavdem live --serve``: the page of a live session, and its dashboard in Rerun's viewer."""

import threading
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request as HttpRequest
from starlette.responses import HTMLResponse, RedirectResponse, Response

from mavdem.containers import JsonValues
from mavdem.errors import Refusal
from mavdem.facts.serve import Permission, RefusalReason
from mavdem.fleet.names import NO_NAMES
from mavdem.live import clock
from mavdem.live.session import LiveSession
from mavdem.live.session_status import SessionStatus
from mavdem.report.live import live_title
from mavdem.report.pages.library_page import render_server_page, script_hashes, server_script
from mavdem.report.pages.page_link import PageLink
from mavdem.serve.guard import POLICY_HEADER, Guard
from mavdem.serve.listening import (
    MAX_SHUTDOWN_SECONDS,
    listening_socket,
    server_config,
    server_url,
    sign_in_link,
)
from mavdem.serve.live_pages import (
    LIVE_PATH,
    LivePages,
    SessionPage,
    session_page,
)
from mavdem.serve.rerun_viewer import ViewerFiles, viewer_policy
from mavdem.serve.rights import Rights
from mavdem.serve.sign_in import SIGN_IN_PATH, SignIn

if TYPE_CHECKING:
    from mavdem.view import WebServer

DASHBOARD_PATH = "/dashboard"
"""Path of the page with the dashboard."""

DASHBOARD_LINK = PageLink("Dashboard in Rerun", DASHBOARD_PATH, needs_wide_screen=True)
"""Link to the dashboard on the page of the session."""


class LiveServer:
    """Serves browsers the page of a live session, and its dashboard in Rerun's viewer if there is one.

    Attributes:
        address: URL of the server, which leads to the page of the session.
        sign_in_link: link that signs a browser in without typing the token; empty where no token is needed.
    """

    def __init__(
        self, link: str, host: str, port: int, rights: Rights, viewer: "WebServer | None"
    ) -> None:
        """Starts the server in a thread.

        Args:
            link: connection string of the link, which is the title until a vehicle is followed.
            host: name or address to listen on.
            port: port to listen on; 0 for a free one.
            rights: who may see the session.
            viewer: process of Rerun that has the data of the dashboard; None without a dashboard. It serves browsers of
                this machine only.

        Raises:
            Unreadable: the port is taken.
        """
        self._link = link
        self._rights = rights
        self._viewer = viewer
        self._status: SessionStatus | None = None
        # The newest page of the session, as the endpoints read it.
        self.page = SessionPage("", clock.monotonic())
        listener = listening_socket(host, port)
        self.address = server_url(host, listener)
        self.sign_in_link = sign_in_link(self.address, rights)
        self._server = uvicorn.Server(server_config(self._app()))
        # Outside the main thread, uvicorn does not handle the signals; they end the session.
        self._thread = threading.Thread(
            target=self._server.run, kwargs={"sockets": [listener]}, daemon=True
        )
        self._thread.start()

    def report(
        self,
        session: LiveSession,
        status: SessionStatus,
        files: Sequence[str] = (),
        *,
        is_ending: bool = False,
    ) -> None:
        """Takes the state of the session, and makes its HTML page anew if that is outdated or the session is over.

        The session calls this about once a second.

        Args:
            session: the session, with the history of its flight.
            status: its state now, as it is shown to users.
            files: sentences on the files that the session has written, once it is over.
            is_ending: whether the session is over, but its flight is not judged yet: this page says so, and is followed
                by one with the judgement.
        """
        self._status = status
        is_page_due = self.page.is_outdated(session) or status.is_over
        if not is_page_due:
            return
        # A session that ends because another vehicle sends has a successor, which continues at the same address.
        another_page_follows = is_ending or session.successor is not None
        is_last = status.is_over and not another_page_follows
        # The viewer of the dashboard runs until the last session ends.
        links = []
        if self._viewer is not None and not is_last:
            links = [DASHBOARD_LINK]
        start_time = clock.monotonic()
        html = session_page(session, status, links=links, files=files, is_last=is_last)
        self.page = SessionPage.made_now(html, session, status, start_time)

    def close(self) -> None:
        """Ends the server; answers that are being sent get ``MAX_SHUTDOWN_SECONDS``."""
        self._server.should_exit = True
        self._thread.join(2 * MAX_SHUTDOWN_SECONDS)

    def _app(self) -> Starlette:
        """Returns the ASGI application: the addresses of the server, and what answers each of them."""
        rights = self._rights
        guard = Guard(rights, script_hashes(), self._visitor_values)
        pages = LivePages(rights, self)
        sign_in = SignIn(rights, LIVE_PATH)
        viewer = self._viewer
        files = ViewerFiles(rights, lambda: None if viewer is None else viewer.page_port)
        endpoints: Mapping[str, Any] = {
            "GET /": _redirect_to_live_page,
            f"GET {LIVE_PATH}": pages.live_session,
            f"GET {LIVE_PATH}/update": pages.live_session_update,
            f"GET {DASHBOARD_PATH}": self._dashboard,
            f"GET {SIGN_IN_PATH}": sign_in.form,
            f"POST {SIGN_IN_PATH}": sign_in.sign_in,
            "POST /leave": sign_in.sign_out,
            "GET /static/serve.js": _script,
            "GET /static/rerun.js": files.script,
            "GET /rerun/{name}": files.program_file,
        }
        return Starlette(
            routes=guard.routes(endpoints),
            exception_handlers=guard.exception_handlers,
        )

    def _dashboard(self, request: HttpRequest) -> Response:
        """Answers with the page that shows the session in Rerun's viewer; its title names the vehicle.

        Args:
            request: the request.

        Raises:
            Refusal: the visitor may not see it, or there is no dashboard, as where Rerun is not installed.
        """
        self._rights.require(request, Permission.READ)
        viewer = self._viewer
        if viewer is None:
            raise Refusal(RefusalReason.NO_SUCH_PAGE)
        status = self._status
        name = self._link if status is None else live_title(status, self._link, NO_NAMES)
        html = render_server_page(
            "viewer",
            name=name,
            back=PageLink("Live page", LIVE_PATH),
            data_address=viewer.url,
            **self._visitor_values(request),
        )
        return HTMLResponse(html, headers={POLICY_HEADER: viewer_policy(viewer.port)})

    def _visitor_values(self, request: HttpRequest) -> JsonValues:
        """Returns what the templates of all pages must know about the visitor of this server.

        There is no library of flights, and there are no given names of vehicles.

        Args:
            request: the request, whose cookie shows whether the visitor may read.
        """
        return {
            "may_read": self._rights.allows(request, Permission.READ),
            "key": "",
            "has_token": bool(self._rights.token),
            "has_library": False,
            "given": NO_NAMES,
            "frames": {},
        }


def _redirect_to_live_page(request: HttpRequest) -> Response:
    """Redirects a browser from the server's address, which the terminal shows, to the page of the session."""
    return RedirectResponse(LIVE_PATH, HTTPStatus.SEE_OTHER)


def _script(request: HttpRequest) -> Response:
    """Answers with the script of the pages that say why something is refused."""
    return Response(server_script(), media_type="text/javascript")
