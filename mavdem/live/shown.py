"""Shown: the display of a live session, which opens at take-off and is not used again once it has failed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mavdem.facts import Code, Fact, Level
from mavdem.facts.session import Session
from mavdem.live.decisions import Setup
from mavdem.live.history import LiveHistory
from mavdem.live.stream import LiveStream


class Shown:
    """What ``show`` returns for the rows of a setup: the ``display``, or None.

    Args:
        show: called with a setup, as in a ``LiveSession``.
        history: of the session, whose events so far a new display logs.
        log: called with the fact that the display failed.
    """

    def __init__(
        self, show: Callable[[Setup], Any], history: LiveHistory, log: Callable[[Fact], None]
    ) -> None:
        self.display: Any = None
        self._show: Callable[[Setup], Any] = show
        self._history = history
        self._log = log

    def open(self, setup: Setup) -> None:
        """Shows the rows of a ``setup`` from now on."""
        before = self.display
        try:
            self.display = self._show(setup)
        except Exception as error:
            self.display = None
            self._show = lambda setup: None
            self._log(failure(Session.DISPLAY_FAILED, error))
        if before is None and self.display is not None:
            for event in self._history.events:
                self.display.log(event)

    def preview(self, stream: LiveStream, known: Setup | None) -> None:
        """Shows the latest sample while the ``stream`` has no rows: what is wrong must not wait for them.

        Of inputs that are others than those of a ``known`` setup nothing is shown.
        """
        latest = stream.latest()
        if latest is None:
            return
        setup, row = latest
        if self.display is None:
            self.open(setup)
        is_alike = known is None or known.layout.names == setup.layout.names
        if self.display is not None and is_alike:
            shift = self._history.shift
            sample = row.time, shift, row.segment, row.outputs, row.inputs
            self.display.put(*sample, None, None, None, stream.pose)


def failure(code: Code, error: Exception, finishing: bool = False) -> Fact:
    """Returns a fact of this ``code`` that says how something failed."""
    text = error.strerror if isinstance(error, OSError) else None
    text = (text or str(error)).rstrip(".")
    return Fact(code, Level.WATCH, error=text, finishing=finishing)
