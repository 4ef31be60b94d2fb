"""Whether the messages of a live vehicle are there, and fast enough, for a model of one axis."""

from collections.abc import Callable, Mapping

from mavdem.dataset.attitude import ATTITUDE_MESSAGES
from mavdem.dataset.segment_learnability import slow_streams
from mavdem.dataset.segments import STEP_TOLERANCE
from mavdem.dataset.signals import MIN_STREAM_RATE
from mavdem.facts import Fact
from mavdem.facts.session import RowsFact, VehicleFact
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS


class RateCheck:
    """Reports when messages are missing or too slow for a model of one axis, and when they no longer are."""

    def __init__(self, axis: str, *, can_request: bool, report: Callable[[Fact], None]) -> None:
        """Prepares the check of message rates; no message is known to be too slow yet.

        Args:
            axis: "roll" or "pitch", which the model is of.
            can_request: whether the user may be advised to request messages; False where the session requests them.
            report: is called with each change.
        """
        self._axis = axis
        self._can_request = can_request
        self._report = report
        # Whether the latest check missed nothing.
        self._was_sufficient = True

    @property
    def no_attitude(self) -> Fact:
        """The fact that no attitude comes.

        It advises to request messages (``--request-rate``), unless the session has requested them already.
        """
        code = RowsFact.NO_LIVE_ATTITUDE if self._can_request else RowsFact.ATTITUDE_ASKED
        return Fact(code, can_ask=self._can_request)

    def update(
        self,
        vehicle_type: str,
        attitude_message: str | None,
        motor_message: str | None,
        rates: Mapping[str, float],
    ) -> Fact | None:
        """Checks the present messages; reports it when something begins to be missing, or nothing is missing again.

        The check is made with each review of the vehicle, twice a second. So only changes are reported.

        Args:
            vehicle_type: name of the MAV_TYPE.
            attitude_message: name of the message that attitude is read from; None if none comes.
            motor_message: name of the message of the model's inputs; None if they are not chosen yet.
            rates: rates, Hz, of all messages of attitude and motor outputs that come, by name.

        Returns:
            The reason why no samples of the model can be formed from the messages; None if nothing is missing.
        """
        reason = self._missing_input(vehicle_type, attitude_message, motor_message, rates)
        is_sufficient = reason is None
        if reason is not None and self._was_sufficient:
            self._report(reason)
        elif is_sufficient and not self._was_sufficient:
            self._report(Fact(RowsFact.LIVE_RATES_ENOUGH))
        self._was_sufficient = is_sufficient
        return reason

    def _missing_input(
        self,
        vehicle_type: str,
        attitude_message: str | None,
        motor_message: str | None,
        rates: Mapping[str, float],
    ) -> Fact | None:
        """Returns the fact that states what a model of the axis lacks; None if it lacks nothing.

        These are checked in order: the vehicle is a multirotor, attitudes are received, motor outputs are received, and
        both are received fast enough.

        Args:
            vehicle_type: name of the MAV_TYPE.
            attitude_message: name of the message that attitude is read from; None if none comes.
            motor_message: name of the message of the model's inputs; None if they are not chosen yet.
            rates: rates, Hz, of all messages of attitude and motor outputs that come, by name.
        """
        if vehicle_type not in POSSIBLE_MULTIROTORS:
            return Fact(VehicleFact.NOT_A_MULTIROTOR, vehicle_type=vehicle_type, axis=self._axis)
        if attitude_message is None:
            return self.no_attitude
        if motor_message is None:
            # The inputs of the model will be read from the fastest message of motor outputs.
            motor_messages = [name for name in rates if name not in ATTITUDE_MESSAGES]
            motor_message = max(motor_messages, key=lambda name: rates[name], default=None)
        if motor_message is None:
            return Fact(RowsFact.NO_LIVE_MOTORS)
        needed_rates = {name: rates[name] for name in (attitude_message, motor_message)}
        if min(needed_rates.values()) >= self._min_rate:
            return None
        slow_fact = slow_streams(needed_rates, self._axis)
        if slow_fact is None:
            return None
        return Fact(RowsFact.LIVE_RATES_TOO_LOW, can_ask=self._can_request, reason=slow_fact)

    @property
    def _min_rate(self) -> float:
        """Least sufficient rate of a message, Hz, with hysteresis.

        As long as nothing was missing, a rate may fall a little below ``MIN_STREAM_RATE``. Otherwise a rate that varies
        around this limit would be reported twice a second.
        """
        if self._was_sufficient:
            return MIN_STREAM_RATE / STEP_TOLERANCE
        return MIN_STREAM_RATE
