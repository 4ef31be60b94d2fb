"""Clipping of the accelerometers in flight (their range was exceeded), as facts (coded findings)."""

from collections.abc import Iterator

from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.dataset.intervals import Intervals, in_intervals, merge_close_intervals
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import series_of_boot
from mavdem.facts import Fact
from mavdem.facts.ending import MotionEvent
from mavdem.vibration.vibration_message import most_clips, reported_clips


def clipping_events(signals: Signals, boot: int, flights: Intervals) -> Iterator[Fact]:
    """Yields an event for each time in flight in which an accelerometer exceeded its range ("clipping").

    Clips that follow each other within ``RECOVERY_SECONDS`` are one event. It counts the clips of the inertial
    measurement unit (IMU) with most of them.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        flights: start and end of each flight, s since boot.
    """
    clips = series_of_boot(reported_clips(signals), boot)
    if clips is None:
        return
    has_clipped = clips.values.any(axis=1) & in_intervals(clips.time, flights)
    clip_times = [(clip_time, clip_time) for clip_time in clips.time[has_clipped].tolist()]
    for start, end in merge_close_intervals(clip_times, RECOVERY_SECONDS):
        count = most_clips(clips.within((start, end)).values)
        yield Fact(MotionEvent.CLIPPED, time=start, end_time=end, count=count, boot=boot)
