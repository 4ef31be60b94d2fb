"""A link that the server is attached to: the page of the session, and its recording in the library at its end."""

from collections.abc import Callable
from datetime import UTC, datetime
from threading import Event, Thread

from mavdem.dem import Settings
from mavdem.dem.parallel import LearningProcess
from mavdem.errors import Refusal, fact_from_error
from mavdem.facts import Fact
from mavdem.facts.serve import Request
from mavdem.facts.session import LinkFact
from mavdem.live import LiveStream
from mavdem.live.link import Link
from mavdem.live.raw_recording import RawRecording
from mavdem.live.session import LiveSession
from mavdem.live.session_loop import run_session
from mavdem.report.pages.flight_page import live_page
from mavdem.report.pages.page import PageLink
from mavdem.serve.library import Library

PAGE_SECONDS = 5.0  # between two pages of a session
SILENT_PAGES = 12  # in which nothing was received after something was: the session is over
AXIS = "roll"


class Attached:
    """Sessions on a link, one after the other, in a thread; nothing is ever sent to a vehicle.

    A session ends when a vehicle that was heard is silent for a minute, or when the server ends. The last one ends
    where something fails, as on a full disk: ``warn`` is called with the reason, and what was recorded is kept.

    Attributes:
        problem: why no session runs any longer; None while one does.

    Raises:
        Unreadable: the link cannot be opened.
    """

    def __init__(
        self,
        link: str,
        library: Library,
        notify: Callable[[], None],
        warn: Callable[[Fact], None],
    ) -> None:
        self.problem: Fact | None = None
        self._page = ""
        self._link = Link(link)
        self._library = library
        self._notify = notify
        self._warn = warn
        self._is_ending = Event()
        self._silent = 0
        self._frames = 0
        self._thread = Thread(target=self._run, daemon=True)

    def start(self) -> None:
        """Begins."""
        self._thread.start()

    def stop(self) -> None:
        """Ends the session; its recording is then in the library."""
        self._is_ending.set()
        self._thread.join()
        self._link.close()

    @property
    def page(self) -> str:
        """HTML of what the running session has so far; raises ``Refusal`` where none runs."""
        if self.problem is not None:
            raise Refusal(self.problem)
        return self._page

    def _run(self) -> None:
        try:
            with LearningProcess() as executor:
                while not self._is_ending.is_set():
                    self._attend(executor)
        except Exception as error:  # whatever it is: nobody waits for this thread
            because = fact_from_error(error)
            self.problem = Fact(Request.SESSION_FAILED, name=self._link.name, because=because)
            self._warn(self.problem)

    def _attend(self, executor: LearningProcess) -> None:
        """One session."""
        name = f"{datetime.now(UTC):%Y-%m-%d_%H-%M-%S}.tlog"
        part = self._library.new_part(name)
        recording = RawRecording(part)
        ignored = lambda _: None  # noqa: E731

        def check(fact: Fact) -> None:
            if fact.code is LinkFact.STREAM_RECORDING_ENDED:
                raise OSError(fact.figures["error"])

        session = LiveSession(
            self._link,
            LiveStream(AXIS),
            Settings(),
            ignored,
            ignored,
            check,
            executor,
            recording,
            recording_name="",  # it is in the library when it has ended
        )
        self._silent = self._frames = 0
        try:
            try:
                self._show(session)
                run_session(session, self._is_over, None, PAGE_SECONDS, self._show)
            finally:
                session.end()
        finally:
            if recording.frame_count:
                self._library.entered(part, name)
                self._notify()
            else:
                part.unlink()

    def _is_over(self) -> bool:
        return self._is_ending.is_set() or self._silent >= SILENT_PAGES

    def _show(self, session: LiveSession) -> None:
        self._library.room_for(0)  # while there is room to keep the recording
        recording = session.intake.recording
        # A recording that fails ends the session before its next page.
        assert recording is not None
        frames = recording.frame_count
        self._silent = self._silent + 1 if frames == self._frames > 0 else 0
        self._frames = frames
        shown = AXIS, session.history, session.status, session.time_account(), None
        self._page = live_page(session.link.name, *shown, PageLink("Flights", "/"))
