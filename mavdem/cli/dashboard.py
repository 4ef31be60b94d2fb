"""The dashboard of ``mavdem live``: Rerun's live view, opened once it is known what there is to show."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

import click

from mavdem.attached import Standing
from mavdem.cli.output import say_aside
from mavdem.cli.signals import ending_at_once
from mavdem.dem.online import HORIZONS
from mavdem.errors import Unreadable
from mavdem.live import Setup

if TYPE_CHECKING:
    from mavdem.view.live import LiveView, RecordingFile


class Dashboard:
    """Where a live flight is shown, and recorded as pictures; without a screen and anywhere else, nowhere."""

    def __init__(self, link: str, axis: str, rrd: Path | None, serve: bool, connect: str | None) -> None:
        """Takes the link's name, the axis, and where to show it.

        Raises:
            Unreadable: a port is taken.
            click.BadParameter: the URL is none.
        """
        # Rerun takes a second to load.
        with ending_at_once():
            from mavdem.view.live import RecordingFile, WebServer, sinks_for
            from mavdem.view.show import has_screen
        self._link, self._axis = link, axis
        self._view: LiveView | None = None
        self._troubles: list[str] = []
        self._sinks = []
        self._file: RecordingFile | None = None
        self._where = ""
        if rrd is None and not serve and connect is None and not has_screen():
            self._where = "There is no screen here: --rrd FILE records, --serve shows it in a browser of this machine."
            return
        try:
            self._sinks = sinks_for(rrd, serve, connect)
        except ValueError as error:
            raise click.BadParameter(f"{error}.", param_hint="--connect") from error
        except OSError as error:
            raise Unreadable(f"It cannot be shown: {error}.") from None
        for sink in self._sinks:
            if isinstance(sink, WebServer):
                self._where = f"Open {sink.page} in a browser."
            elif isinstance(sink, RecordingFile):
                self._file = sink

    @property
    def opened(self) -> bool:
        """Whether there was something to show."""
        return self._view is not None

    @property
    def recorded(self) -> bool:
        """Whether any of it is in a file."""
        return self._file is not None and self._file.kept

    @property
    def broken(self) -> bool:
        """Whether the file could not be written to its end."""
        return self._file is not None and self._file.broken

    def say_where(self) -> None:
        """Says where to look, where that does not show."""
        if self._where:
            say_aside(self._where)

    def open(self, setup: Setup) -> LiveView:
        """Shows rows of a setup from now on."""
        from mavdem.view.live import Channels, LiveView

        names = setup.layout.names
        channels = Channels(
            self._link,
            setup.dt,
            HORIZONS,
            names,
            (self._axis, f"{self._axis} rate"),
            (setup.scale.unit,) * len(names),
            ("rad", "rad/s"),
        )
        if self._view is None:
            self._view = LiveView(channels, self._sinks)
        self._view.change(channels)
        return self._view

    def tell(self, standing: Standing) -> None:
        """Shows how things stand, and says what is wrong with the showing."""
        from mavdem.view.live import Status

        if self._view is None:
            return
        rates, (median, _) = standing.rates, standing.latency
        self._view.status(Status(rates, standing.lost, median, sum(standing.samples), standing.obstacle))
        for trouble in self._view.troubles:
            if trouble not in self._troubles:
                self._troubles.append(trouble)
                say_aside(trouble)

    def __enter__(self) -> Dashboard:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._view is not None:
            self._view.close()
        else:
            for sink in self._sinks:
                sink.close()
