"""ShownRow: a sample of a live flight with all that is known of it, as a display is given it."""

from typing import NamedTuple, Protocol

from mavdem.arrays import Array
from mavdem.dem import Estimate, Learned
from mavdem.facts.event import Event
from mavdem.live.stream import LatestPose
from mavdem.live.wind import WindRow


class ShownRow(NamedTuple):
    """A sample and its estimate, at ``time``, s of the boot clock."""

    time: float
    shift: (
        float  # of a timeline on which flights of two boots do not overlap beside the boot clock, s
    )
    segment: int  # changes where samples are missing or the vehicle rebooted
    outputs: Array  # (m,)
    inputs: Array  # (r,)
    estimate: Estimate | None = None  # of this sample; ``None`` without a learner
    learned: Learned | None = None  # the learner's last batch result
    wind: WindRow | None = None  # the latest, in m/s
    pose: LatestPose | None = None  # the latest attitude

    @property
    def clock(self) -> float:
        """The time on the timeline, s."""
        return self.time + self.shift


class Display(Protocol):
    """What a session shows a flight by; it returns at once."""

    def put(self, row: ShownRow) -> None:
        """Shows a row."""

    def log(self, event: Event) -> None:
        """Shows an event."""

    def hold(self, held: bool) -> None:
        """Makes rows wait while this computer has no time to draw them."""
