"""Whether the messages of a live vehicle are there, and fast enough, for a model of one axis."""

from collections.abc import Callable, Mapping

from mavdem.dataset.attitude import ATTITUDE_MESSAGES
from mavdem.dataset.learnability import slow_streams
from mavdem.dataset.segments import STEP_TOLERANCE
from mavdem.dataset.signals import MIN_STREAM_RATE
from mavdem.facts import Fact
from mavdem.facts.session import Rows, VehicleFact
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS


class RateCheck:
    """Reports when messages are missing or too slow, and when they no longer are."""

    def __init__(self, axis: str, can_request: bool, report: Callable[[Fact], None]) -> None:
        """Begins with messages that are not known to be too slow.

        Args:
            axis: "roll" or "pitch", which the model is of.
            can_request: whether the user may still be advised to request rates.
            report: is called with each change.
        """
        self._axis = axis
        self._can_request = can_request
        self._report = report
        self._is_enough = True

    @property
    def no_attitude(self) -> Fact:
        """That no attitude comes, and what to do about it."""
        code = Rows.NO_LIVE_ATTITUDE if self._can_request else Rows.ATTITUDE_ASKED
        return Fact(code, can_ask=self._can_request)

    def update(
        self,
        vehicle_type: str,
        attitude_message: str | None,
        motor_message: str | None,
        rates: Mapping[str, float],
    ) -> Fact | None:
        """Checks the present messages, and reports when something begins to be missing or all is there again.

        It is called with each review of the vehicle, twice a second, and so reports changes only.

        Args:
            vehicle_type: name of the MAV_TYPE.
            attitude_message: name of the message that attitude is read from; None where none comes.
            motor_message: name of the message of the model's inputs; None where they are not chosen.
            rates: Hz by message name.

        Returns:
            Why there are no rows; None where nothing is missing.
        """
        obstacle = self._obstacle(vehicle_type, attitude_message, motor_message, rates)
        if obstacle is not None and self._is_enough:
            self._report(obstacle)
        elif obstacle is None and not self._is_enough:
            self._report(Fact(Rows.LIVE_RATES_ENOUGH))
        self._is_enough = obstacle is None
        return obstacle

    def _obstacle(
        self,
        vehicle_type: str,
        attitude_message: str | None,
        motor_message: str | None,
        rates: Mapping[str, float],
    ) -> Fact | None:
        """Why there are no rows: the first reason that holds, from the most basic one on.

        The vehicle may be no multirotor, attitude or motor outputs may be missing, or one of them may come slower than
        ``MIN_STREAM_RATE``. Once all was well, rates may be a little lower than that (hysteresis): a rate at the limit
        must not be reported twice a second. The arguments are those of ``update``.

        Returns:
            The reason; None where nothing is missing.
        """
        if vehicle_type not in POSSIBLE_MULTIROTORS:
            return Fact(VehicleFact.NOT_A_MULTIROTOR, vehicle_type=vehicle_type, axis=self._axis)
        if attitude_message is None:
            return self.no_attitude
        if motor_message is None:
            # Before inputs are chosen the fastest message of outputs counts.
            outputs = [name for name in rates if name not in ATTITUDE_MESSAGES]
            motor_message = max(outputs, key=rates.__getitem__, default=None)
        if motor_message is None:
            return Fact(Rows.NO_LIVE_MOTORS)
        needed_rates = {name: rates[name] for name in (attitude_message, motor_message)}
        # Hysteresis: as long as all is well, the lower of the two limits holds.
        min_rate = MIN_STREAM_RATE / STEP_TOLERANCE if self._is_enough else MIN_STREAM_RATE
        if min(needed_rates.values()) >= min_rate:
            return None
        slow = slow_streams(needed_rates, self._axis)
        if slow is None:
            return None
        return Fact(Rows.LIVE_RATES_TOO_LOW, can_ask=self._can_request, because=slow)
