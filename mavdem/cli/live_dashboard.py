"""Dashboard of a live flight: a Rerun viewer, browsers or a recording, if they are installed and requested."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from mavdem.cli.streams import print_to_stderr
from mavdem.dataset.axes import model_outputs
from mavdem.errors import Unreadable
from mavdem.extras import missing_extra_fact, require_extra
from mavdem.facts.session import SessionFact
from mavdem.live import RowFormat, SessionStatus
from mavdem.live.history import horizon_steps
from mavdem.machine import has_screen

if TYPE_CHECKING:
    from mavdem.view.live_view import LiveView
    from mavdem.view.sinks import RecordingFile

NO_SCREEN_ADVICE = (
    "There is no screen here: use --rrd FILE to record, or --serve for browsers of this machine."
)
"""What a user without a screen can do, where nothing else shows the flight."""


class Dashboard:
    """Shows a live flight in a viewer, in browsers, and in an .rrd file.

    It shows nothing if Rerun is not installed, and where there is neither a screen nor a recording or browser to show
    it in.

    Attributes:
        view: What shows the flight; None if nothing does.
        file: The recording that is written; None if none is.
        advice: Sentence on how to open the dashboard, or why there is none; empty if it opens by itself.
    """

    def __init__(
        self, link: str, axis: str, rrd: Path | None, *, serve: bool, connect: str | None
    ) -> None:
        """Opens the dashboard.

        Args:
            link: Connection string of the link, for the title.
            axis: Axis that is modelled.
            rrd: Recording to write; None for none.
            serve: Whether to serve browsers on this machine.
            connect: URL of a Rerun viewer to show the flight in; None for none.

        Raises:
            Unreadable: A port is taken, or a file cannot be written.
            click.BadParameter: ``connect`` is no URL.
            MissingExtra: The dashboard is requested, and Rerun is not installed.
        """
        self.view: LiveView | None = None
        self.file: RecordingFile | None = None
        self.advice = ""
        self._link = link
        self._axis = axis
        self._reported_problems: set[str] = set()
        missing_extra = missing_extra_fact("view", "The dashboard")
        if missing_extra is not None:
            self.advice = str(missing_extra)
            if rrd is not None or serve or connect is not None:
                require_extra("view", "The dashboard")
            return
        if not (rrd or serve or connect or has_screen()):
            self.advice = NO_SCREEN_ADVICE
            return
        # Rerun takes a second to import, and 60 MB of memory.
        from mavdem.view.live_view import LiveView
        from mavdem.view.sinks import RecordingFile, WebServer, requested_sinks

        try:
            sinks = requested_sinks(rrd, serve, connect)
        except ValueError as error:
            raise click.BadParameter(f"{error}.", param_hint="--connect") from error
        except OSError as error:
            raise Unreadable(SessionFact.DASHBOARD_NOT_OPENED, reason=error) from None
        self.view = LiveView(sinks)
        for sink in sinks:
            if isinstance(sink, WebServer):
                self.advice = f"Open {sink.page} in a browser."
            elif isinstance(sink, RecordingFile):
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
        """Tells the view the names and units of the samples that follow, before the first of them.

        A row holds the inputs and outputs of the vehicle at one time. Its format is known only when messages have been
        received, and it may change during the flight, for example if another motor message comes.

        Args:
            row_format: Motors, units and sampling step of the rows.

        Returns:
            The view, to which the caller sends the rows; None if no viewer, browser or file shows them.
        """
        if self.view is None:
            return None
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

    def report(self, status: SessionStatus) -> None:
        """Shows the status of the session, and prints each new problem of the view once on standard error.

        Args:
            status: State of the session.
        """
        if self.view is None:
            return
        self.view.status(status)
        for problem in set(self.view.problems) - self._reported_problems:
            print_to_stderr(problem)
            self._reported_problems.add(problem)

    def close(self) -> None:
        """Ends the view, and completes the recording."""
        if self.view is not None:
            self.view.close()
