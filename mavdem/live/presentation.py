"""What the user of a live session sees: samples on a display, reported events, and the history of the flight."""

from collections.abc import Callable
from math import nan
from typing import NamedTuple

from mavdem.assessment.repeated_reports import REPEAT_SECONDS
from mavdem.containers import Numbers
from mavdem.dem import Estimate, Learned
from mavdem.errors import failure_fact
from mavdem.facts import Code, Fact
from mavdem.facts.event import Event
from mavdem.facts.session import LinkFact, SessionFact
from mavdem.facts.watch import WatchFact
from mavdem.live import clock
from mavdem.live.display import Display, DisplayRow
from mavdem.live.history import LiveHistory
from mavdem.live.link import SILENCE_SECONDS
from mavdem.live.motor_alarms import MotorAlarms
from mavdem.live.pose import LatestPose
from mavdem.live.report_limit import ReportLimit
from mavdem.live.rows import AlignedRow, FormattedRow, RowFormat
from mavdem.live.wind import WindEstimate

OpenDisplay = Callable[[RowFormat], Display | None]
"""Returns the display of rows of a format; None where there is none."""


class _RepetitionKey(NamedTuple):
    """What two reports of the same thing have in common, whatever their measured figures are."""

    code: Code
    """Code of the fact."""

    subject: str
    """What the fact is about, such as a motor."""

    detail: object
    """Text of the autopilot, alarm of another vehicle, or level of a lost link; None for all other facts."""


class Presentation:
    """Shows the samples (rows) and events of a flight on a display, if there is one, and keeps its history.

    Attributes:
        history: what happened.
        has_display: whether rows are displayed.
    """

    def __init__(
        self,
        open_display: OpenDisplay,
        report_event: Callable[[Event], None],
        motor_alarms: MotorAlarms,
    ) -> None:
        """Makes an empty history; the display is opened with the first rows.

        Args:
            open_display: is called with each new format of rows.
            report_event: is called with each event for the user.
            motor_alarms: show since when the torque is caused by a weak motor.
        """
        self.history = LiveHistory()
        self._open_display = open_display
        self._report_event = report_event
        self._motor_alarms = motor_alarms
        self._display: Display | None = None
        # When a fact with each ``_repetition_key`` was reported last, s of the monotonic clock.
        self._report_times: dict[_RepetitionKey, float] = {}
        self._report_limit = ReportLimit()

    @property
    def has_display(self) -> bool:
        """Whether rows are displayed."""
        return self._display is not None

    def open(self, row_format: RowFormat) -> None:
        """Opens the display for rows of a format, which may replace the present display.

        A first display is given all events so far. If opening fails, that is reported and no display is opened again: a
        session must not end because it cannot be watched.

        Args:
            row_format: format of the next rows.
        """
        had_display = self.has_display
        try:
            self._display = self._open_display(row_format)
        except Exception as error:
            self._display = None
            self._open_display = _no_display
            self.log(failure_fact(SessionFact.DISPLAY_FAILED, error))
        if not had_display and self._display is not None:
            for event in self.history.events:
                self._display.log(event)

    def pause(self, is_paused: bool) -> None:
        """Makes displayed rows wait while this computer has no time to draw them."""
        if self._display is not None:
            self._display.pause(is_paused)

    def add_to_history(
        self,
        row: AlignedRow,
        row_format: RowFormat,
        estimate: Estimate | None,
        wind: WindEstimate | None,
        pose: LatestPose | None = None,
    ) -> None:
        """Adds one sample of the flight to the history, with the latest wind and pose.

        The wind is kept as speed and half width of its band, m/s, and each motor output as a fraction of its range.
        What is not known is NaN.

        Args:
            row: the sample: motor outputs and motion at one time.
            row_format: format of the row, with the boot of its time, and the range of the motors.
            estimate: estimate of the learner for this row; None if the learner did not take the row.
            wind: the latest estimate of the wind, which is left out ``SILENCE_SECONDS`` later; None before the first.
            pose: the latest attitude with its setpoint; None before the first.
        """
        wind_speed = nan
        wind_band = nan
        # An estimate that has ended is not drawn on: nothing measures the wind any more.
        if wind is not None and row.time - wind.time <= SILENCE_SECONDS:
            compass_wind = wind.compass
            wind_speed = compass_wind.speed
            wind_band = compass_wind.speed_high - compass_wind.speed
        motor_fractions = row_format.scale.fraction(row.inputs)
        self.history.advance(row.time, row_format.boot)
        # ``LiveHistory.add_row`` defines this order.
        further_values = (wind_speed, wind_band, *_pose_values(pose), *motor_fractions)
        self.history.add_row(row.segment, row.time, row.outputs, estimate, further_values)

    def show(
        self,
        row: AlignedRow,
        pose: LatestPose | None,
        estimate: Estimate | None = None,
        learned: Learned | None = None,
        wind: WindEstimate | None = None,
    ) -> None:
        """Displays a sample of the flight together with the estimates at its time, if there is a display.

        Args:
            row: the sample: motor outputs and motion at one time.
            pose: the latest attitude with its setpoint; None before the first.
            estimate: the learner's estimate for this sample; None if it was not learned from.
            learned: the latest model; None before the first.
            wind: the latest estimate of the wind; None before the first.
        """
        if self._display is None:
            return
        displayed_row = DisplayRow(
            row.time,
            timeline_offset=self.history.timeline_offset,
            segment=row.segment,
            outputs=row.outputs,
            inputs=row.inputs,
            estimate=estimate,
            learned=learned,
            wind=wind,
            pose=pose,
        )
        self._display.put(displayed_row)

    def preview(
        self,
        latest_sample: FormattedRow,
        pose: LatestPose | None,
        wind: WindEstimate | None,
        displayed_format: RowFormat | None,
    ) -> None:
        """Displays the latest sample of a vehicle whose messages come too slowly to learn a model from them.

        Samples are usually displayed when the model learns from them. If it learns from none, the user must see the
        motion nevertheless, to find out what is wrong.

        Args:
            latest_sample: the sample, with its format.
            pose: latest pose of the vehicle; None if it is not known.
            wind: the latest estimate of the wind; None before the first.
            displayed_format: format of the samples that the display has shown so far; None before the first. Samples of
                other motors cannot be added to the same display.
        """
        if not self.has_display:
            self.open(latest_sample.row_format)
        motor_names = latest_sample.row_format.geometry.names
        if displayed_format is None or displayed_format.geometry.names == motor_names:
            self.show(latest_sample.row, pose, wind=wind)

    def log(self, fact: Fact) -> None:
        """Reports a fact (a finding) as an event: to the user, to the history and to the display.

        A fact that repeats one that was just reported is dropped, and so are texts of the autopilot that come too fast
        to be read, and changes of a state that flaps (``ReportLimit``).

        Args:
            fact: its time, where it has one, is in s of the boot clock. The event has it in s of the session's
                timeline, which goes on across reboots.
        """
        if not self._is_repetition(fact) and self._report_limit.admits(fact, clock.monotonic()):
            self._add_event(fact)

    def _add_event(self, fact: Fact) -> None:
        """Adds a fact as an event to the history, and shows it to the user and on the display.

        Args:
            fact: the fact, as for :meth:`log`.
        """
        # Times of the boot clock plus this offset are times of the session's timeline.
        timeline_offset = self.history.timeline_offset
        start_time = nan
        if fact.time is not None:
            start_time = fact.time + timeline_offset
        is_of_weak_motor = fact.time == self._motor_alarms.change_time
        if is_of_weak_motor:
            # Since the motor became weak, the estimated wind torque was in truth the torque of the motor.
            self.history.clear_wind_torque(start_time)
        event = Event(
            self.history.now,
            fact,
            start_time,
            reception=clock.unix_time(),
            clock=self.history.now - timeline_offset,
            boot=self.history.boot,
        )
        self._report_event(event)
        self.history.add_event(event)
        if self._display is not None:
            self._display.log(event)

    def report_omissions(self, *, is_at_end: bool = False) -> None:
        """Makes up for reports of the autopilot that were left out, because too many of one kind had come.

        From time to time the user sees how many these were. Where a state, such as "on the ground", was left out and
        still holds, it is shown as soon as the limit allows, so that the last state that is shown is the present one.

        Args:
            is_at_end: whether the session ends, after which nothing can be shown any more. Before, this is called once
                a second.
        """
        now = clock.monotonic()
        omission_report = self._report_limit.pop_omission_report(now)
        if omission_report is not None:
            self.log(omission_report)
        for state in self._report_limit.pop_omitted_states(now, is_at_end=is_at_end):
            # These passed the limit of reports already, which :meth:`log` would apply again.
            self._add_event(state)

    def _is_repetition(self, fact: Fact) -> bool:
        """Returns whether a fact was reported in the last ``REPEAT_SECONDS``; if not, notes that it is reported now.

        So a state that changes all the time does not flood the user. Facts with a time, as each alarm and each recovery
        has, are no repetitions.

        Args:
            fact: the fact to be reported.
        """
        now = clock.monotonic()
        # Older reports are forgotten, which bounds the memory.
        recent_times = {}
        for reported_key, time in self._report_times.items():
            if now - time < REPEAT_SECONDS:
                recent_times[reported_key] = time
        self._report_times = recent_times
        key = _repetition_key(fact)
        if fact.time is None and key in recent_times:
            return True
        recent_times[key] = now
        return False


def _pose_values(pose: LatestPose | None) -> Numbers:
    """Returns the numbers of a pose that the history keeps; each is NaN if it is not known.

    Args:
        pose: the latest attitude with its setpoint and position; None before the first.

    Returns:
        Roll, pitch, their setpoints and yaw, rad; north, east and height, m.
    """
    if pose is None:
        return (nan,) * 8
    roll, pitch, yaw = pose.angles
    roll_setpoint, pitch_setpoint = pose.setpoint
    north, east, height = nan, nan, nan
    if pose.position is not None:
        north, east, down = pose.position
        height = -down
    return (roll, pitch, roll_setpoint, pitch_setpoint, yaw, north, east, height)


def _repetition_key(fact: Fact) -> _RepetitionKey:
    """Returns the key that a fact shares with its repetitions, such as the same text of the autopilot sent again.

    Args:
        fact: the fact that is reported to the user.
    """
    detail = fact.figures.get("text")
    if fact.code is WatchFact.OTHER_VEHICLE_ALARM:
        detail = fact.figures["reason"]
    elif fact.code is LinkFact.LOST_IN_FLIGHT:
        # A link that is lost for long is worse news than one that has just been lost.
        detail = fact.level
    return _RepetitionKey(fact.code, fact.subject, detail)


def _no_display(_: RowFormat) -> Display | None:
    """Takes the place of a display that has failed."""
    return None
