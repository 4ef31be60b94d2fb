"""The interface of displays of a live flight: what they are given, sample by sample and event by event."""

from typing import NamedTuple, Protocol

from mavdem.arrays import Array
from mavdem.dem import Estimate, Learned
from mavdem.facts.event import Event
from mavdem.live.pose import LatestPose
from mavdem.live.wind import WindEstimate


class DisplayRow(NamedTuple):
    """One sample of attitude and motors, with the latest estimate, model, wind and pose."""

    time: float
    """Time of the sample, s of the boot clock."""

    timeline_offset: float
    """What to add to the boot clock for the time on the timeline, on which boots do not overlap, s."""

    segment: int
    """Number of the segment; it changes where samples are missing or the vehicle rebooted."""

    outputs: Array
    """(m,) Angle, rad, and body rate, rad/s."""

    inputs: Array
    """(r,) Motor outputs in the unit of the stream."""

    estimate: Estimate | None = None
    """The learner's estimate of this sample; None of a sample that was not learned from."""

    learned: Learned | None = None
    """The learner's latest batch result."""

    wind: WindEstimate | None = None
    """The latest wind, m/s."""

    pose: LatestPose | None = None
    """The latest attitude, with its setpoint."""

    @property
    def timeline_time(self) -> float:
        """Time of the sample on the timeline, s."""
        return self.time + self.timeline_offset


class Display(Protocol):
    """Shows a live flight. All its methods return at once: drawing happens elsewhere."""

    def put(self, row: DisplayRow) -> None:
        """Shows a row."""

    def log(self, event: Event) -> None:
        """Shows an event."""

    def pause(self, is_paused: bool) -> None:
        """Makes rows wait while this computer has no time to draw them, until it is called with False."""
