"""Dashboard of a live flight: a Rerun viewer, browsers or a recording, if they are installed and requested."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavdem.cli.streams import print_to_stderr
from mavdem.dataset.axes import model_outputs
from mavdem.errors import Unreadable, failure_fact
from mavdem.extras import missing_extra_fact, require_extra
from mavdem.facts import Fact
from mavdem.facts.session import SessionFact
from mavdem.live import RowFormat, SessionStatus
from mavdem.live.history import horizon_steps
from mavdem.live.session import LiveSession
from mavdem.machine import LOOPBACK, LOOPBACK_HOSTS, free_port, has_screen, require_free_port

if TYPE_CHECKING:
    from mavdem.serve.live_server import LiveServer
    from mavdem.serve.rights import Rights
    from mavdem.view.live_view import LiveView
    from mavdem.view.sinks import RecordingFile, WebServer

PAGE_PORT = 9090
"""Port of this machine at which browsers find the session; that of Rerun's own page, too. A choice."""

NO_SCREEN_ADVICE = (
    "There is no screen here: use --rrd FILE to record, or --serve for browsers of this machine."
)
"""What a user without a screen can do, where nothing else shows the flight."""


@dataclass(frozen=True)
class PageAddress:
    """Where browsers find the page of a session, and who may see it."""

    host: str = LOOPBACK
    """Name or address to listen on."""

    port: int | None = None
    """Port to listen on; None for ``PAGE_PORT``, or a free one while another session has that."""

    token: str = ""
    """Secret that browsers need; empty for none."""

    @property
    def is_on_this_machine(self) -> bool:
        """Whether browsers of this machine alone reach it."""
        return self.host in LOOPBACK_HOSTS

    @property
    def chosen_port(self) -> int:
        """The port to listen on."""
        if self.port is not None:
            return self.port
        try:
            require_free_port(PAGE_PORT)
        except OSError:
            return free_port()
        return PAGE_PORT


class Dashboard:
    """Shows a live flight in a viewer, in browsers, and in an .rrd file.

    It shows nothing, and says nothing of it, if Rerun is not installed. Nor does it where there is neither a screen nor
    a recording or browser to show it in. Browsers get the page of the session, which needs no Rerun.

    Attributes:
        view: What shows the flight; None if nothing does.
        file: The recording that is written; None if none is.
        advice: Sentences on how to open the dashboard, or why there is none; empty if it opens by itself.
        sign_in_link: Link that signs a browser in without typing the token; empty where no token is needed.
    """

    def __init__(
        self,
        link: str,
        axis: str,
        rrd: Path | None,
        *,
        address: PageAddress | None,
        connect: str | None,
        is_plain: bool = False,
    ) -> None:
        """Opens the dashboard.

        Args:
            link: Connection string of the link, for the title.
            axis: Axis that is modelled.
            rrd: Recording to write; None for none.
            address: Where browsers find the page of the session; None to serve none.
            connect: URL of a Rerun viewer to show the flight in; None for none.
            is_plain: Whether the user has chosen lines below each other, and so misses no dashboard without a screen.

        Raises:
            Unreadable: A port is taken, a file cannot be written, or a token is missing or too short.
            click.BadParameter: ``connect`` is no URL.
            MissingExtra: What is requested needs a package that is not installed.
        """
        self.view: LiveView | None = None
        self.file: RecordingFile | None = None
        self.advice = ""
        self.sign_in_link = ""
        self._link = link
        self._axis = axis
        self._reported_problems: set[str] = set()
        self._server: LiveServer | None = None
        # What must be installed for Rerun, and for the session's own page; None if it is installed.
        missing_view = missing_extra_fact("view", "The dashboard")
        missing_server = missing_extra_fact("serve", "The page of a live session")
        # Rerun's server has the data of the dashboard for the session's page or, if that is not installed, for a page
        # of its own. It serves browsers of this machine only.
        can_serve_rerun = (
            address is not None and missing_view is None and address.is_on_this_machine
        )
        if address is not None and missing_server is not None and not can_serve_rerun:
            require_extra("serve", "The page of a live session")
        if rrd is not None or connect is not None:
            require_extra("view", "The dashboard")
        # Rerun is shown where it was requested, and otherwise opens its viewer on the screen.
        has_place_for_rerun = bool(rrd or address or connect) or has_screen()
        shows_rerun = missing_view is None and has_place_for_rerun
        if missing_view is None and not has_place_for_rerun and not is_plain:
            self.advice = NO_SCREEN_ADVICE
        # A token that is missing or too short is refused before anything is started.
        rights = None
        if address is not None and missing_server is None:
            rights = _rights_of_browsers(address)
        # If something cannot be started, what was started before is closed.
        with ExitStack() as resources:
            web_server = None
            try:
                if address is not None and can_serve_rerun:
                    web_server = _start_rerun_server(
                        page_address=address if missing_server is not None else None
                    )
                    resources.callback(web_server.close)
                if address is not None and rights is not None:
                    self._server = _start_live_server(link, address, rights, web_server)
                    resources.callback(self._server.close)
                if shows_rerun:
                    self._start_rerun_view(rrd, connect, web_server)
            except OSError as error:
                raise Unreadable(SessionFact.DASHBOARD_NOT_OPENED, reason=error) from None
            # What was started goes on until ``close``.
            resources.pop_all()
        if self._server is not None:
            self.sign_in_link = self._server.sign_in_link
            self.advice = _with_missing_extra(_advice_on_page(self._server, address), missing_view)
        elif web_server is not None:
            self.advice = _with_missing_extra(_advice_on_rerun_page(web_server), missing_server)

    def _start_rerun_view(
        self, rrd: Path | None, connect: str | None, web_server: WebServer | None
    ) -> None:
        """Starts to send the flight to Rerun: to a recording, to a viewer, and to Rerun's server for browsers.

        Without any of the three, a viewer is started on the screen of this machine.

        Args:
            rrd: Path of the recording; None for none.
            connect: URL of a running viewer; None for none.
            web_server: Rerun's server for browsers; None for none.

        Raises:
            click.BadParameter: ``connect`` is no URL.
        """
        # Rerun takes a second to import, and 60 MB of memory.
        from mavdem.view.live_view import LiveView
        from mavdem.view.sinks import RecordingFile, requested_sinks

        try:
            sinks = requested_sinks(rrd, connect, web_server)
        except ValueError as error:
            raise click.BadParameter(f"{error}.", param_hint="--connect") from error
        self.view = LiveView(sinks)
        for sink in sinks:
            if isinstance(sink, RecordingFile):
                self.file = sink

    @property
    def has_recording(self) -> bool:
        """Whether there is a recording that holds at least one whole message."""
        return self.file is not None and self.file.complete_bytes > 0

    @property
    def is_recording_empty(self) -> bool:
        """Whether there was nothing to write to the recording, which then does not exist."""
        return self.file is not None and not self.has_recording and not self.is_recording_broken

    @property
    def is_recording_broken(self) -> bool:
        """Whether something could not be written to the recording."""
        return self.file is not None and self.file.is_broken

    def open(self, row_format: RowFormat) -> LiveView | None:
        """Prepares the view for samples of a new format, and returns it; the live session then adds its samples to it.

        A sample (row) has the outputs of all motors, which are the inputs of the model, and the outputs of the model,
        such as the roll angle, at one time. Its format is new at first, and when other motor messages come.

        Args:
            row_format: Motors, units and sampling step of the samples.

        Returns:
            The view; None if no viewer, browser or file shows the samples.
        """
        if self.view is None:
            return None
        # Rerun's libraries are loaded only where a view is shown.
        from mavdem.view.live_content import Channels

        outputs = model_outputs(self._axis)
        channels = Channels(
            title=self._link,
            dt=row_format.dt,
            horizons=horizon_steps(row_format.dt),
            input_names=row_format.geometry.names,
            output_names=tuple(output.name for output in outputs),
            input_units=row_format.input_units,
            output_units=tuple(output.unit for output in outputs),
        )
        self.view.change(channels)
        return self.view

    def report(
        self,
        session: LiveSession,
        status: SessionStatus,
        files: Sequence[str] = (),
        *,
        is_ending: bool = False,
    ) -> None:
        """Shows the status of the session, and prints each new problem of page and view once on standard error.

        Args:
            session: The session, with the history of its flight.
            status: Its state now, or at its end.
            files: Sentences on the files that the session has written, once it is over.
            is_ending: Whether the session watches nothing any more, and its verdict follows.
        """
        present_problems = set()
        if self._server is not None:
            try:
                self._server.report(session, status, files, is_ending=is_ending)
            except Exception as error:
                # A page that cannot be rendered must not end the session, which watches the vehicle.
                present_problems.add(str(failure_fact(SessionFact.DISPLAY_FAILED, error)))
        if self.view is not None:
            self.view.status(status)
            present_problems.update(self.view.problems)
        new_problems = present_problems - self._reported_problems
        for problem in new_problems:
            print_to_stderr(problem)
            self._reported_problems.add(problem)

    def close(self) -> None:
        """Ends the server and the view, and completes the recording."""
        if self._server is not None:
            self._server.close()
        if self.view is not None:
            self.view.close()


def _advice_on_page(server: LiveServer, address: PageAddress | None) -> str:
    """Returns the sentence that says in which browsers to open the page of the session.

    Args:
        server: The server of the page.
        address: Where browsers find the page.
    """
    place = " of this machine" if address is not None and address.is_on_this_machine else ""
    return f"Open {server.address} in a browser{place}."


def _advice_on_rerun_page(web_server: WebServer) -> str:
    """Returns the advice to open Rerun's own page, and what that sends to others.

    Args:
        web_server: Rerun's server for browsers.
    """
    return (
        f"Open {web_server.page} in a browser. It is Rerun's own page, which requests fonts from Google and "
        "reports its use to Rerun."
    )


def _with_missing_extra(advice: str, missing_extra: Fact | None) -> str:
    """Returns advice, followed by what to install for more; the advice alone if nothing is missing."""
    return advice if missing_extra is None else f"{advice} {missing_extra}"


def _start_rerun_server(page_address: PageAddress | None) -> WebServer:
    """Starts Rerun's server for browsers, a process with two ports: one for the data, one for the viewer's program.

    Args:
        page_address: Where users open Rerun's own page, which has the viewer; None if the session has a page of its
            own, which loads the viewer from any port.

    Raises:
        OSError: A port is taken.
    """
    # Rerun takes a second to import, and 60 MB of memory.
    from mavdem.view import WebServer

    viewer_port = free_port() if page_address is None else page_address.chosen_port
    data_port = free_port()
    return WebServer(data_port, viewer_port)


def _rights_of_browsers(address: PageAddress) -> Rights:
    """Returns who may see the page of the session.

    Args:
        address: Where browsers find the page, with the token.

    Raises:
        Unreadable: The token is too short, or missing where other machines reach the page.
    """
    # The web framework takes a second to import.
    from mavdem.serve.rights import rights_for_host

    return rights_for_host(address.host, address.token, is_behind_proxy=False, has_library=False)


def _start_live_server(
    link: str, address: PageAddress, rights: Rights, web_server: WebServer | None
) -> LiveServer:
    """Starts the HTTP server of the session's own page, in a thread of this process.

    Args:
        link: Connection string of the link.
        address: Where browsers find the page.
        rights: Who may see it.
        web_server: Process of Rerun that has the data of the dashboard; None without a dashboard.

    Raises:
        Unreadable: Its host is no address of this machine, or its port is taken.
    """
    # The web framework takes a second to import.
    from mavdem.serve.live_server import LiveServer

    return LiveServer(link, address.host, address.chosen_port, rights, web_server)
