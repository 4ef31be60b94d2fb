"""Rows of a live vehicle, from which a model is learned: its attitude and motor outputs at the same, equal steps."""

from collections.abc import Callable
from dataclasses import replace
from math import inf
from operator import itemgetter

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import Numbers
from mavdem.dataset.attitude import ATTITUDE_MESSAGES
from mavdem.dataset.extreme_tilt import MAX_TILT
from mavdem.dataset.time_series import AVERAGING_SECONDS, preferred_message
from mavdem.facts import Fact
from mavdem.facts.session import RowsFact
from mavdem.ingest.telemetry import Fields, Telemetry
from mavdem.live.flight_phase import FlightPhase
from mavdem.live.live_signals import RecentMotion, attitude_from_samples, slowest_rate
from mavdem.live.motor_inputs import NO_PORT, InputSelector, MotorInputs, StreamKey
from mavdem.live.row_grid import GridPoint, RowGrid
from mavdem.live.rows import AlignedRow, FormattedRow, RowFormat
from mavdem.live.samples import SampleStream

RATE_CHECK_SAMPLES = 8
"""Samples of a stream between two checks of its rate: a choice of computing time."""


class RowBuilder:
    """Builds rows (attitude and motor outputs at one time) from the streams of samples that one vehicle sends.

    Attributes:
        axis: "roll" or "pitch": the outputs are its angle and body rate.
        row_format: what the rows of the latest segment are; None before any.
        sample_count: number of samples of attitude and motors so far.
        inputs: the chosen inputs; None before they are chosen.
        attitude_message: name of the chosen message of attitude; None before it is chosen.
    """

    def __init__(self, axis: str, phase: FlightPhase, report: Callable[[Fact], None]) -> None:
        """Prepares the building of rows, before the first sample.

        Args:
            axis: "roll" or "pitch".
            phase: phase of the present boot.
            report: is called with each fact about the rows.
        """
        self.axis = axis
        self.row_format: RowFormat | None = None
        self.sample_count = 0
        self._report = report
        self._grid = RowGrid()
        self.restart(0, phase)

    def restart(self, boot: int, phase: FlightPhase) -> None:
        """Begins a boot, whose clock starts at zero again: discards all samples, and which outputs drive motors.

        The message of attitude and the motors are chosen again from the samples of this boot. ``row_format`` and
        ``sample_count`` are kept. The constructor calls this method for the first boot.

        Args:
            boot: number of the boot; a boot lasts from one start of the autopilot to the next.
            phase: decides whether the vehicle flies in this boot, and freely, so that rows are made.
        """
        self.inputs: MotorInputs | None = None
        self.attitude_message: str | None = None
        self._boot = boot
        self._phase = phase
        self._streams: dict[StreamKey, SampleStream] = {}
        # The streams that rows are made of: attitude, then each port of the motors, the one with most motors first.
        # There are none before they are chosen.
        self._row_streams: tuple[SampleStream, ...] = ()
        self._selector = InputSelector(boot)
        # Time of the latest row in which the vehicle was tilted by more than MAX_TILT, s of the boot clock.
        self._extreme_tilt_time = -inf
        self._grid.restart()

    @property
    def late_samples(self) -> int:
        """Number of samples of this boot that came too late for their row."""
        return sum(stream.late_count for stream in self._streams.values())

    @property
    def motor_message(self) -> str | None:
        """Name of the message of the chosen inputs; None before they are chosen."""
        return None if self.inputs is None else self.inputs.motors.message

    @property
    def has_motor_messages(self) -> bool:
        """Whether any message of motor outputs has come in this boot."""
        return any(name not in ATTITUDE_MESSAGES for name, _ in self._streams)

    def rates(self, now: float) -> dict[str, float]:
        """Returns the rate of each message of attitude and motor outputs by its name, Hz, the slowest first.

        A message that comes in several ports has the rate of its fastest port.

        Args:
            now: end of the time over which rates are measured, s of the boot clock.
        """
        fastest_rates: dict[str, float] = {}
        for (name, _port), stream in self._streams.items():
            rate = stream.recent_rate(now)
            fastest_rates[name] = max(rate, fastest_rates.get(name, 0.0))
        rate_of_each = itemgetter(1)
        return dict(sorted(fastest_rates.items(), key=rate_of_each))

    def add_sample(
        self, name: str, port: int, time: float, values: Numbers | None
    ) -> SampleStream | None:
        """Adds a sample to the stream of its message and port, which begins with its first sample.

        The samples of all messages of attitude and motor outputs are kept, since they show from which messages rows can
        be made.

        Args:
            name: name of the message.
            port: its port; 0 of attitude.
            time: time on the boot clock, s.
            values: outputs, or roll, pitch, rad, and their body rates, rad/s; None if they cannot be used.

        Returns:
            The stream, if the sample was added and rows may be made of it; otherwise None.
        """
        stream = self._streams.get((name, port))
        if stream is None:
            stream = SampleStream()
            self._streams[name, port] = stream
        if values is None or not stream.add(time, values):
            return None
        self.sample_count += 1
        if stream not in self._row_streams:
            return None
        return stream

    def is_main_motor_stream(self, stream: SampleStream) -> bool:
        """Returns whether a stream has the outputs of the port with most motors, which follows the attitude."""
        return stream is self._row_streams[1]

    def latest_motor_outputs(self) -> list[float] | None:
        """Returns the latest output of each motor, in the unit of its message and the order of the model's inputs.

        It is None before it is known which output channels drive the motors, and while one of the ports to which these
        channels belong has not sent anything. A port is a group of channels with messages of its own.
        """
        if self.inputs is None:
            return None
        outputs = []
        for channel in self.inputs.channels:
            outputs_of_port = self._streams[self.inputs.motors.message, channel.port].latest
            if not outputs_of_port:
                return None
            outputs.append(outputs_of_port[channel.offset])
        return outputs

    def completed_rows(self, name: str, stream: SampleStream) -> list[AlignedRow]:
        """Makes the rows that the latest sample of a stream completes, on the uniform time grid of a segment of rows.

        1. The running segment ends if this sample follows a gap, or shows that a rate has changed.
        2. If no segment is running, one begins as soon as the vehicle may fly freely and the streams allow it.
        3. Each point of the running segment's grid that all streams have passed becomes a row.

        Args:
            name: name of the stream's message, for the reported facts.
            stream: one of the streams of attitude and motor outputs that rows are made of, with the sample added. Such
                streams exist only once inputs were chosen (:meth:`choose_inputs`).

        Returns:
            Rows in the order of time; none while no segment is running.
        """
        inputs = self.inputs
        assert inputs is not None
        if self._grid.is_running:
            self._end_segment_if_interrupted(name, stream)
        if not self._grid.is_running and self._phase.may_fly_freely:
            has_begun = self._grid.begin(self._row_streams)
            if has_begun:
                self._set_row_format(inputs)
        if not self._grid.is_running:
            return []
        return [self._aligned_row(point, inputs) for point in self._grid.completed_points()]

    def _end_segment_if_interrupted(self, name: str, stream: SampleStream) -> None:
        """Ends the segment if the latest sample of a stream follows a gap, or shows that its rate has changed.

        Either is reported. After a gap the next segment has the same time step, so that the learner goes on. After a
        change of the rate the step is decided again, from samples at the new rate only. The rate is checked with every
        ``RATE_CHECK_SAMPLES``-th sample, to save computing time.

        Args:
            name: name of the stream's message.
            stream: the stream, with the latest sample added.
        """
        if stream.gap:
            # The gap is the time, s, for which no sample came before the latest one.
            self._report(Fact(RowsFact.MESSAGE_GAP, subject=name, duration=stream.gap))
            self._grid.end()
            return
        is_rate_check_due = stream.added_count % RATE_CHECK_SAMPLES == 0
        if not is_rate_check_due:
            return
        former_rate = self._grid.changed_rate(stream)
        if former_rate is None:
            return
        self._report(Fact(RowsFact.RATE_CHANGED, subject=name, former_rate=former_rate))
        self._grid.end(forget_step=True)
        # The new step must not depend on samples at the former rate.
        for row_stream in self._row_streams:
            row_stream.break_off()

    def end_segment_unless_free(self) -> None:
        """Ends the segment where no row can be of free flight any more."""
        if self._grid.is_running and not self._phase.may_fly_freely:
            self._grid.end()

    def _set_row_format(self, inputs: MotorInputs) -> None:
        """Sets the format of the rows of a new segment, and reports it if it differs from the one before.

        A segment is a series of rows on one uniform time grid, without a gap. The format of its rows is the time step,
        s, the messages that they are made of, and the motors whose outputs are their inputs. Most segments have the
        same format as the one before.

        Args:
            inputs: the motors whose outputs become the rows' inputs.
        """
        # The grid has begun, which decides its step from the attitude and motor outputs.
        assert self._grid.dt is not None and self.attitude_message is not None
        former_format = self.row_format
        row_format = RowFormat(
            self._boot,
            dt=self._grid.dt,
            attitude_message=self.attitude_message,
            motor_message=inputs.motors.message,
            geometry=inputs.motors.geometry,
            scale=inputs.motors.scale,
            rates=self._grid.rates,
            grid_start=self._grid.start_time,
        )
        self.row_format = row_format
        if former_format is None:
            self._report_row_format(row_format)
            return
        has_same_step = former_format.dt == row_format.dt
        has_same_message = former_format.motor_message == row_format.motor_message
        has_same_motors = former_format.geometry == row_format.geometry
        # The user need not know of a difference in the rates or in the beginning of the grid.
        if not (has_same_step and has_same_message and has_same_motors):
            self._report_row_format(row_format)

    def _report_row_format(self, row_format: RowFormat) -> None:
        """Reports that rows of a format begin and, if the order of their motors is only assumed, that it is.

        The directions of the motors' torques depend on that order.

        Args:
            row_format: the format, with messages, time step and motors of the rows.
        """
        geometry = row_format.geometry
        self._report(
            Fact(
                RowsFact.ROWS_BEGIN,
                names=(row_format.attitude_message, row_format.motor_message),
                step=row_format.dt,
                inputs=len(geometry.names),
            )
        )
        if geometry.assumed:
            self._report(Fact(RowsFact.MOTOR_ORDER_ASSUMED, basis=geometry.basis))

    def _aligned_row(self, point: GridPoint, inputs: MotorInputs) -> AlignedRow:
        """Builds the row of a point of the time grid.

        It has angle and body rate of the learned axis, and the output of each motor. It counts as a row of settled or
        free flight if the flight is so at its time, and the vehicle is upright and does not tumble: by the rule for
        logs (``extreme_tilt_intervals``) an extreme tilt ends half of ``AVERAGING_SECONDS`` after its last row.

        Args:
            point: values of attitude (roll and pitch, rad, and their body rates, rad/s), then of each port of the
                motors, in the order of ``inputs.ports``.
            inputs: the channel of each motor.

        Returns:
            The row.
        """
        attitude = point.values[0]
        roll, pitch, _, _ = attitude
        values_by_port = dict(zip(inputs.ports, point.values[1:], strict=True))
        motor_outputs = []
        for channel in inputs.channels:
            outputs_of_port = values_by_port[channel.port]
            motor_outputs.append(outputs_of_port[channel.offset])
        is_tilted_extremely = max(abs(roll), abs(pitch)) >= MAX_TILT
        if is_tilted_extremely:
            self._extreme_tilt_time = point.time
        is_upright = point.time > self._extreme_tilt_time + AVERAGING_SECONDS / 2
        return AlignedRow(
            point.time,
            np.array(motor_outputs),
            self._angle_and_rate(attitude),
            self._grid.segment,
            is_settled=is_upright and self._phase.is_settled(point.time),
            is_free_flight=is_upright and self._phase.is_free(point.time),
        )

    def _angle_and_rate(self, attitude: Numbers) -> Array:
        """Returns angle, rad, and body rate, rad/s, of the learned axis.

        Args:
            attitude: roll and pitch, rad, and their body rates, rad/s.
        """
        roll, pitch, roll_rate, pitch_rate = attitude
        if self.axis == "roll":
            return np.array([roll, roll_rate])
        return np.array([pitch, pitch_rate])

    def choose_attitude_message(self, now: float) -> None:
        """Chooses the message whose attitude is used for rows, by the same rule as for logs (``preferred_message``).

        The rule compares how many samples of each message have come in the last ``DECISION_SECONDS``. Without any, and
        while a segment of rows (without a gap) goes on, the former choice stays.

        Args:
            now: present time on the boot clock, s.
        """
        is_within_segment = self._grid.is_running
        if is_within_segment:
            return
        recent_counts = {}
        for name in ATTITUDE_MESSAGES:
            stream = self._streams.get((name, NO_PORT))
            if stream is not None:
                recent_counts[name] = stream.recent_count(now)
        preferred_name = preferred_message(recent_counts)
        if preferred_name:
            self.attitude_message = preferred_name
        self._update_row_streams()

    def candidate_messages(self) -> dict[str, Fields]:
        """Returns the columns of the motor messages that inputs may be chosen from; within a segment one stays."""
        present_message = self.motor_message if self._grid.is_running else None
        return self._selector.candidate_messages(self._streams, present_message)

    def choose_inputs(self, messages: dict[str, Fields], vehicle: Telemetry, now: float) -> None:
        """Chooses which output channels are the motors, and reports a change.

        Each review of the vehicle calls it, since parameters and samples that come later may show more. Other channels
        than before end the segment of rows, whose columns would otherwise change their meaning. If the channels stay
        the same and only the order of the motors became known, the segment goes on with an updated format.

        Args:
            messages: result of ``candidate_messages``, by message name.
            vehicle: identity and parameters of the vehicle, without messages.
            now: present time on the boot clock, s.
        """
        inputs = self._selector.select(messages, vehicle, now)
        if inputs is None:
            # After a silence nothing shows that they have changed.
            return
        former_inputs = self.inputs
        self.inputs = inputs
        self._update_row_streams()
        if not self._grid.is_running:
            return
        geometry = inputs.motors.geometry
        if former_inputs is not None and inputs.identity != former_inputs.identity:
            self._report(Fact(RowsFact.INPUTS_CHANGED, names=geometry.names))
            self._grid.end(forget_step=True)
        elif self.row_format is not None and geometry != self.row_format.geometry:
            self.row_format = replace(self.row_format, geometry=geometry)
            if not geometry.assumed:
                self._report(Fact(RowsFact.MOTOR_ORDER_KNOWN, basis=geometry.basis))

    def clear_inputs(self) -> None:
        """Forgets the inputs, of a vehicle that is no multirotor."""
        self.inputs = None
        self._update_row_streams()

    def _update_row_streams(self) -> None:
        """Chooses the streams of samples that rows are made of: first the attitude, then the motor outputs.

        A stream has the samples of one message and one port. A port is a group of motor outputs that are sent together;
        attitude has none. A port that has sent nothing yet gets an empty stream, and there are no rows before its first
        sample.
        """
        if self.inputs is None or self.attitude_message is None:
            self._row_streams = ()
            return
        keys = [(self.attitude_message, NO_PORT)]
        for port in self.inputs.ports:
            keys.append((self.inputs.motors.message, port))
        self._row_streams = tuple(self._streams.setdefault(key, SampleStream()) for key in keys)

    def recent_motion(self) -> RecentMotion | None:
        """Returns attitude and motor outputs of the last seconds, in the form in which a log has them.

        These are the samples themselves, each with its own time, not the rows. It is None before messages are chosen,
        and without any sample of attitude.
        """
        if self.inputs is None or self.attitude_message is None:
            return None
        # The streams are attitude, then the ports of the motors.
        attitude_stream = self._row_streams[0]
        if not attitude_stream.time:
            return None
        # Each has N samples.
        roll, pitch, roll_rate, pitch_rate = attitude_stream.table().T
        time = np.array(attitude_stream.time)
        message = self.attitude_message
        tilts = {
            "roll": attitude_from_samples(message, time, self._boot, roll, roll_rate),
            "pitch": attitude_from_samples(message, time, self._boot, pitch, pitch_rate),
        }
        return RecentMotion(self.inputs.motors, tilts)

    def latest_row(self) -> FormattedRow | None:
        """Returns the latest sample of attitude and motors as a row, for a display that has no rows to show yet.

        The two samples may be of slightly different times; the row has the time of the attitude, and is never learned
        from.

        Returns:
            A format that is made for this row, and the row; None while there are rows, or where samples are missing.
        """
        if self._grid.is_running:
            return None
        row_format = self._format_of_latest_row()
        # The outputs in ``inputs.motors`` are older: they were selected in the latest review.
        outputs = self.latest_motor_outputs()
        if row_format is None or outputs is None:
            return None
        # The streams are attitude, then the ports of the motors.
        attitude = self._row_streams[0]
        row = AlignedRow(
            attitude.time[-1],
            np.array(outputs),
            self._angle_and_rate(attitude.latest),
            self._grid.segment,
            is_settled=False,
            is_free_flight=False,
        )
        return FormattedRow(row_format, row)

    def _format_of_latest_row(self) -> RowFormat | None:
        """Returns the format of the row that :meth:`latest_row` makes; its step is that of the slower message.

        It is None before messages are chosen, and before each has two samples, which show its rate.
        """
        if self.inputs is None or self.attitude_message is None:
            return None
        motors = self.inputs.motors
        attitude = self._row_streams[0]
        rate = slowest_rate([motors.time, attitude.time])
        if not rate:
            return None
        return RowFormat(
            self._boot,
            dt=1 / rate,
            attitude_message=self.attitude_message,
            motor_message=motors.message,
            geometry=motors.geometry,
            scale=motors.scale,
            rates=(rate, rate),
            grid_start=attitude.time[-1],
        )
