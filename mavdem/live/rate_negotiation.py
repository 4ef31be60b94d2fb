"""Negotiation of message rates with the vehicle of a live session, if the user wants it."""

from collections.abc import Callable, Mapping
from math import inf

from mavdem.facts import Fact
from mavdem.facts.session import RateFact
from mavdem.ingest.mavlink.payloads import FrameSender
from mavdem.ingest.motors import control_parameters, lean_limit_parameters, motor_parameters
from mavdem.live import clock
from mavdem.live.intake import LinkIntake
from mavdem.live.link import MAX_TRIES, RETRY_SECONDS
from mavdem.live.rate_request import ArrivalRates, RateRequest, greeting
from mavdem.live.stream import LiveStream
from mavdem.live.vehicle_selection import Component

CONFIRMATION_POLL_SECONDS = 0.05
"""Longest wait for something to come while a confirmation is awaited, s: a choice."""


class RateNegotiation:
    """Sends requests for message rates over a link, and takes the vehicle's replies from its stream."""

    def __init__(
        self,
        requested_rate: float | None,
        *,
        awaits_greeting: bool,
        intake: LinkIntake,
        stream: LiveStream,
        log: Callable[[Fact], None],
    ) -> None:
        """Prepares the negotiation; nothing is sent before the first update.

        Args:
            requested_rate: Hz; None to send nothing at all.
            awaits_greeting: whether the other side sends only after it has received something.
            intake: sends, and receives while rates are restored.
            stream: stream of the vehicle.
            log: is called with each fact about the rates.
        """
        self._requested_rate = requested_rate
        self._awaits_greeting = awaits_greeting
        self._intake = intake
        self._stream = stream
        self._log = log
        self._request: RateRequest | None = None
        self._arrival_rates = ArrivalRates()
        self._greeting_time = -inf

    def update(
        self,
        now: float,
        message_time: float,
        *,
        is_busy: bool,
        vehicle_seconds: float | None = None,
    ) -> None:
        """Sends what is due: a greeting if the link needs one, then requests to the vehicle once it is known.

        It is called with each step of the session. Which requests are due depends on the measured rates of messages.

        Args:
            now: time up to which everything that arrived is analysed, s of the monotonic clock.
            message_time: time of the last message, s of that clock.
            is_busy: whether the analysis is late, so that messages seem to come only as fast as they are analysed.
            vehicle_seconds: seconds of the vehicle's clock so far; None if it runs as this computer's.
        """
        if self._requested_rate is None:
            # The user wants to send nothing.
            return
        if self._intake.is_lost or is_busy:
            # Rates would be measured wrongly now, so that their measurement begins anew with the next call.
            self._arrival_rates = ArrivalRates()
            return
        seconds_without_contact = now - max(message_time, self._greeting_time)
        if self._awaits_greeting and seconds_without_contact >= RETRY_SECONDS:
            # The other end of such a link (``udpout``) is silent until it has received something.
            self._greeting_time = now
            self._intake.send([greeting()])
        vehicle = self._stream.followed_vehicle
        is_silent = now - message_time > RETRY_SECONDS
        if vehicle is None or is_silent:
            # Without a reply from the vehicle, requests would only use up their tries, and rates would seem to fall.
            return
        if self._request is None:
            self._request = self._request_to(vehicle, self._requested_rate)
        rates = self._arrival_rates.update(now, vehicle.message_counts, vehicle_seconds)
        self._exchange(self._request, vehicle, rates, now)

    def _exchange(
        self,
        request: RateRequest,
        vehicle: Component,
        rates: Mapping[int, float] | None,
        now: float,
    ) -> None:
        """Takes the vehicle's replies to a request, sends the frames that are due then, and reports what came of it.

        Args:
            request: the request for message rates and parameters.
            vehicle: the followed vehicle, with the parameters that have come.
            rates: measured rates, Hz, by message id; None while they are unknown.
            now: s of the monotonic clock.
        """
        for message in self._stream.drain_replies():
            request.add_reply(message)
        self._intake.send(request.frames_due(now, rates, vehicle.parameters))
        for fact in request.drain_events():
            self._log(fact)

    @staticmethod
    def _request_to(vehicle: Component, rate: float) -> RateRequest:
        """Makes the request to a vehicle for messages, and for the parameters of its motors, gains and lean.

        Args:
            vehicle: the followed vehicle. Its autopilot decides the names of the parameters.
            rate: requested rate of attitude and motor outputs, Hz.

        Returns:
            The request, addressed to the vehicle.
        """
        parameters = (
            *motor_parameters(vehicle.autopilot),
            *control_parameters(vehicle.autopilot),
            *lean_limit_parameters(vehicle.autopilot),
        )
        ids = FrameSender(vehicle.system, vehicle.component)
        return RateRequest(ids, rate, parameters=parameters)

    @property
    def absent_messages(self) -> frozenset[str]:
        """Names of the messages that do not come, although they were requested."""
        return frozenset() if self._request is None else self._request.absent_messages

    def restart(self) -> None:
        """Requests rates again, after a reboot or a silence in which the vehicle may have forgotten them."""
        if self._request is not None:
            self._arrival_rates = ArrivalRates()
            self._request.allow_new_requests()

    def restore(self, *, is_silent: bool = False, is_flying: bool = True) -> None:
        """Restores the vehicle's own message rates at the end of a session, and waits for its confirmation.

        Rates that the vehicle does not confirm are sent again, ``MAX_TRIES`` times in all, since radios lose frames. If
        some rate remains unconfirmed, a fact reports it, as the vehicle may keep the requested rates.

        Args:
            is_silent: whether the vehicle has sent nothing for some seconds.
            is_flying: whether it flies, as far as is known. A silent one that does not is switched off: nothing is
                reported, since it cannot confirm anything, and has its own rates again when it is switched on.
        """
        request = self._request
        if request is None:
            return
        frames = request.restoring_frames()
        if is_silent and not is_flying and frames:
            self._intake.send(frames)
            return
        if not self._intake.is_lost:
            for _ in range(MAX_TRIES):
                frames = request.restoring_frames()
                if not frames:
                    return
                self._intake.send(frames)
                self._await_confirmations(request)
        if request.restoring_frames():
            self._log(Fact(RateFact.RATES_NOT_RESTORED, is_silent=is_silent))

    def _await_confirmations(self, request: RateRequest) -> None:
        """Receives messages until all restored rates are confirmed, for ``RETRY_SECONDS`` at most.

        Messages are recorded as always, and searched for the vehicle's replies; their rows are no longer needed. A fast
        link could keep the analysis busy for longer, so it stops when the time is over.

        Args:
            request: the request that sent the restored rates, and gets the replies.
        """
        end_time = clock.monotonic() + RETRY_SECONDS
        while request.unconfirmed and not self._intake.is_lost:
            remaining = end_time - clock.monotonic()
            if remaining <= 0:
                return
            for batch in self._intake.receive(min(remaining, CONFIRMATION_POLL_SECONDS)):
                if clock.monotonic() < end_time:
                    self._stream.process_without_rows(batch.stamp, batch.frames)
            for message in self._stream.drain_replies():
                request.add_reply(message)
