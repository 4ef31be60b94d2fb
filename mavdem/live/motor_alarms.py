"""MotorAlarms: the motor watch of the vehicle that is followed, over all of its flights."""

from collections import deque
from collections.abc import Iterator
from math import nan

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.facts import Fact, Facts
from mavdem.facts.session import Session
from mavdem.facts.watch import Watch
from mavdem.live.recent_messages import MAX_EVENTS
from mavdem.motors.loss_detection import LONGEST_GAP, REFERENCE_SECONDS, MotorAlarm, MotorWatch
from mavdem.plant.online_wind_torque import WeakenedMotors


class MotorAlarms:
    """Changes of the motors' balance: the ``latest``, those ``standing`` as ``alarm`` of a ``SessionStatus``.

    ``landed``: on the ground since; ``changed``: s, since when the motors are as they are, NaN before a change.
    """

    def __init__(self) -> None:
        self.latest: deque[MotorAlarm] = deque(maxlen=MAX_EVENTS)
        self.standing: Facts = ()
        self.landed = False
        self.changed = nan
        self._watch: MotorWatch | None = None
        self._watched: object = None
        self._obstacle: Fact | None = None

    def obstacle(self, now: float, is_flying: bool) -> Fact | None:
        """Returns why no motor that weakens would be found at ``now``, s; None where one would."""
        if not is_flying:
            return Fact(Watch.ON_GROUND_NOW)
        if self._obstacle is not None:
            return self._obstacle
        if self._watch is None or now - self._watch.latest > LONGEST_GAP:
            return Fact(Session.NOT_SETTLED)
        if self._watch.since is None:
            return Fact(Watch.REFERENCE_SHORT, duration=REFERENCE_SECONDS)
        return None

    def weak_motors(self, inputs: Array, low: float) -> WeakenedMotors | None:
        """Returns what weak motors do with ``inputs`` (k,), whose range begins at ``low``; None where none is weak."""
        weak = {} if self._watch is None else self._watch.weak
        if not weak:
            return None
        shares, errors = np.outer([1.0, 0.0], np.ones(len(inputs)))
        for motor, alarm in weak.items():
            shares[motor], errors[motor] = alarm.sound_share
        used = inputs - low
        return WeakenedMotors(self.changed, low + shares * used, errors * used)

    def take(
        self, time: float, boot: int, motors: MotorOutputs, commands: list[float], heading: float
    ) -> Iterator[Fact]:
        """Yields what to report of a sample of ``motors`` in settled flight.

        ``commands`` are shares of their range, ``heading`` is as of ``MotorWatch``.
        """
        if self.landed:
            self.standing = ()
            self.landed = False
        # balances on two ranges differ
        watched = boot, motors.geometry, motors.scale.low, motors.scale.high
        if self._watch is None or watched != self._watched:
            self._watch = MotorWatch(motors.geometry, boot)
            self._watched = watched
        changes = self._watch.take(time, commands, heading)
        for change in changes:
            self.latest.append(change)
            if change.motor is not None:
                self.changed = change.since
                weak = [*self._watch.weak.values()] or [change]
                self.standing = tuple(alarm.announced for alarm in weak)
            yield change.announced
        self._obstacle = self._watch.obstacle
