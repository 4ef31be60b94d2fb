"""What a live session learns and judges of one flight, which the next take-off makes anew."""

from collections.abc import Callable
from concurrent.futures import Executor

from mavdem.dem import Learned, Settings
from mavdem.facts import Fact
from mavdem.live.backlog import LatencyMeter
from mavdem.live.judging import ModelJudging
from mavdem.live.learning import FlightLearning


class FlightAnalysis:
    """All that a session learns and judges of its latest flight by a model, so that no flight is judged by another's.

    What outlives a flight belongs to the session: the link and its statistics, recording, events and plots, the
    parameters of the autopilot and the geometry of the motors that follows from them, and the prior of the user. The
    stream keeps alarms, wind and the lights that need no model, and begins these anew at the same take-off.

    Attributes:
        learning: learns a model of the flight.
        judging: judges that model.
        latencies: measures how late the estimates of the flight come.
        postponed_rows: number of rows of free flight that this computer had no time to learn from.
        settled_seconds: duration of settled flight (without take-off and landing), s, learned from or not.
        unusable_messages_reason: why the latest messages in flight that no motion could be computed from were
            unusable, such as that the attitude was missing; None if there were none.
    """

    def __init__(
        self,
        axis: str,
        settings: Settings,
        executor: Executor | None,
        prior: Learned | None,
        log: Callable[[Fact], None],
        recording_name: str | None,
    ) -> None:
        """Begins without a row.

        Args:
            axis: "roll" or "pitch".
            settings: settings of the fits.
            executor: executor in which models are learned and judged; None for this thread, and to judge at the end.
            prior: model of an earlier flight of the vehicle, which the user has given; None without one.
            log: function that is called with each fact about learning.
            recording_name: the log that shows more; empty if it is known later, None without one.
        """
        self.learning = FlightLearning(axis, settings, executor, prior, log)
        self.judging = ModelJudging(executor, recording_name)
        self.latencies = LatencyMeter()
        self.postponed_rows = 0
        self.settled_seconds = 0.0
        self.unusable_messages_reason: Fact | None = None
