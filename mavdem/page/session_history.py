"""SessionHistory: what a live session shows and says, collected for its page and passed on."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic

from mavdem.dem import Estimate, Learned
from mavdem.dem.engine.linalg import Array
from mavdem.live import Setup
from mavdem.live.history import AHEAD, LiveHistory
from mavdem.live.session import Display


class SessionHistory:
    """A display of a live session that collects its history, ``of``, and passes everything on."""

    def __init__(self, show: Callable[[Setup], Display | None], say: Callable[[str], None]) -> None:
        """Begins now; ``show`` opens the display of a setup, and ``say`` prints a sentence."""
        self.of = LiveHistory(AHEAD)
        self._show, self._say, self._began = show, say, monotonic()
        self._display: Display | None = None

    def open(self, setup: Setup) -> Display:
        """Shows the rows of a setup from now on."""
        self._display = self._show(setup)
        return self

    def put(
        self,
        time: float,
        segment: int,
        outputs: Array,
        inputs: Array,
        estimate: Estimate | None = None,
        learned: Learned | None = None,
    ) -> None:
        """Takes a row."""
        self.of.take(monotonic() - self._began, segment, time, outputs, estimate)
        if self._display is not None:
            self._display.put(time, segment, outputs, inputs, estimate, learned)

    def log(self, text: str) -> None:
        """Passes on a sentence that was said."""
        if self._display is not None:
            self._display.log(text)

    def say(self, text: str) -> None:
        """Takes a sentence when it is said."""
        self.of.note(monotonic() - self._began, text)
        self._say(text)
