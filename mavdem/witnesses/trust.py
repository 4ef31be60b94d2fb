"""Which sensors can be trusted in one boot (from a start of the autopilot to the next): each is checked by another."""

from dataclasses import dataclass

import numpy as np

from mavdem.dataset.intervals import Intervals, intersection
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, series_of_boot
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.trust import TrustCheck
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.witnesses.accelerometer import (
    AccelerometerRecord,
    accelerometer_in_use,
    accelerometer_records,
)
from mavdem.witnesses.flight_check import FlightCheck, flight_check, powered_intervals
from mavdem.witnesses.height import (
    MIN_CONTRADICTION_SECONDS,
    HeightComparison,
    height_comparison,
)
from mavdem.witnesses.position import PositionRecord, position_record
from mavdem.witnesses.rotation import RotationUnderPower, rotation_under_power
from mavdem.witnesses.sensors import throttle_stick

MIN_FIX_FRACTION = 0.95
"""Fraction of the time under power with a position fix from which on the position can be trusted; a choice."""


@dataclass(frozen=True, eq=False)
class SensorTrust:
    """Which sensors of one boot can be trusted; a result is None if the log does not show it."""

    boot: int
    """Number of the boot."""
    is_multirotor: bool
    """Whether the vehicle may be a multirotor: of others the outputs do not show when the motors carry them."""
    powered: Intervals
    """When the motors could carry the vehicle, s since boot; also empty if they were not recorded."""
    height: HeightComparison
    """Barometer and estimated climb, and when they contradict each other."""
    accelerometers: tuple[AccelerometerRecord, ...]
    """Gravity at rest, and peaks, of each accelerometer, by number."""
    accelerometer: AccelerometerRecord | None
    """The accelerometer that the estimator uses; None if none was recorded."""
    rotation: RotationUnderPower | None
    """Whether roll and pitch follow their setpoints, and whether gyro and attitude agree."""
    position: PositionRecord
    """Fixes of GPS, and whether the estimator reports a position."""
    stick: TimeSeries | None
    """The pilot's throttle stick (N,), from 0 (closed) to 1 (open); None if it was not recorded."""
    flight_check: FlightCheck
    """Whether the vehicle flew."""
    height_drift: Fact | None = None
    """The event that the barometer's height left that of satellites, or its own at rest; None if neither was found."""

    @property
    def is_barometer_usable(self) -> bool | None:
        """Whether the barometer measures the height; None without one."""
        if self.height.barometer_noise is None:
            return None
        return self.height.barometer is not None

    @property
    def is_climb_estimate_sound(self) -> bool | None:
        """Whether the estimated climb never contradicts the barometer for long; None if one of them is not known.

        Only the time under power counts: after an impact, with the motors off, the estimate often diverges.
        """
        if self.height.barometer_climb is None or self.height.estimated_climb is None:
            return None
        return self.contradiction_seconds < MIN_CONTRADICTION_SECONDS

    @property
    def contradiction_seconds(self) -> float:
        """Time in which barometer and estimated climb contradict each other, s; under power, if that is known."""
        return float(sum(end - start for start, end in self._contradictions))

    @property
    def _contradictions(self) -> Intervals:
        """When barometer and estimated climb contradict each other, s since boot; under power, if that is known."""
        if not self.powered:
            return self.height.contradictions
        return intersection(self.height.contradictions, self.powered)

    @property
    def is_accelerometer_sound(self) -> bool | None:
        """Whether the accelerometer measures gravity at rest; None if the vehicle never rested."""
        return None if self.accelerometer is None else self.accelerometer.is_sound

    @property
    def has_position_fix(self) -> bool | None:
        """Whether GPS had a fix at any time under power; None if no receiver was recorded."""
        return None if self.position.fix_fraction is None else self.position.fix_fraction > 0

    @property
    def attitude_follows_setpoint(self) -> bool | None:
        """Whether roll and pitch follow their setpoints; None if the setpoints change too little to decide."""
        return None if self.rotation is None else self.rotation.follows_setpoint

    @property
    def gyro_agrees(self) -> bool | None:
        """Whether gyro and attitude agree; None if the vehicle hardly turned."""
        return None if self.rotation is None else self.rotation.gyro_agrees

    @property
    def flew(self) -> bool | None:
        """Whether the vehicle flew; None if the sensors do not show it."""
        return self.flight_check.has_flown

    @property
    def checks(self) -> Facts:
        """The checks in the order in which they are shown, as facts (coded findings): good, to be watched, or unknown.

        Whether the vehicle flew, followed its setpoints, and has a sound gyro is checked of multirotors only.
        """
        sensors = (self._barometer_check(), self._accelerometer_check(), self._position_check())
        # The pilot's stick comes last: it is no sensor of the vehicle.
        stick = self._stick_check()
        if not self.is_multirotor:
            return (*sensors, stick)
        motion = (self._attitude_check(), self._gyro_check())
        return (self._flight_check(), *sensors, *motion, stick)

    def _flight_check(self) -> Fact:
        """Returns the check of whether the vehicle flew, with the facts of its sensors for and against that.

        Where the sensors do not decide it, a vehicle whose motors had enough power to fly is assumed to have flown.
        """
        return Fact(
            TrustCheck.FLIGHT,
            _level_of_check(self.flew),
            flew=self.flew,
            is_assumed=self.flew is None and self.flight_check.had_power,
            witnesses=self.flight_check.sensor_facts,
            boot=self.boot,
        )

    def _barometer_check(self) -> Fact:
        """Returns the check of the barometer as a fact: whether it is usable, and agrees with the estimated climb.

        The fact has the time, s, of the first contradiction, the noise of the barometer as ``acceleration``, m/s², the
        median difference of the climb rates as ``speed``, m/s, and the ``drift`` of its height, if there is one. Its
        level is unknown if the log does not show whether the two agree.
        """
        is_usable = self.is_barometer_usable
        agrees_with_climb = self.is_climb_estimate_sound
        is_right: bool | None
        if not is_usable:
            # A barometer that is not usable, or not known to be, cannot be compared with the estimate.
            is_right = is_usable
        elif not agrees_with_climb or self.height_drift is None:
            is_right = agrees_with_climb
        elif self.height_drift.code is MotionEvent.HEIGHTS_DISAGREE:
            # The barometer only differs from the satellites, so either of them may have drifted.
            is_right = None
        else:
            # The estimated climb mostly rests on the barometer, and does not show that it drifts.
            is_right = False
        first_contradiction_time = None
        if agrees_with_climb is False:
            first_contradiction_time, _ = self._contradictions[0]
        return Fact(
            TrustCheck.BAROMETER,
            _level_of_check(is_right),
            time=first_contradiction_time,
            is_usable=is_usable,
            is_sound=agrees_with_climb,
            acceleration=self.height.barometer_noise,
            speed=self.height.climb_difference if agrees_with_climb else None,
            duration=self.contradiction_seconds,
            drift=self.height_drift,
            boot=self.boot,
        )

    def _accelerometer_check(self) -> Fact:
        """Returns the check of the accelerometers as a fact: whether the one in use measures gravity at rest.

        The fact has the specific force that it measured at rest as ``acceleration``, m/s², and as ``names`` the other
        accelerometers that do not measure gravity. Those that the parameters exclude from use are left out.
        """
        accelerometer = self.accelerometer
        unsound_names = []
        for candidate in self.accelerometers:
            # Both flags are None if the log does not show them: only what is known to be excluded or wrong counts.
            may_be_used = candidate.is_used is not False
            if candidate is not accelerometer and may_be_used and candidate.is_sound is False:
                unsound_names.append(candidate.name)
        return Fact(
            TrustCheck.ACCELEROMETER,
            _level_of_check(self.is_accelerometer_sound),
            name="" if accelerometer is None else accelerometer.name,
            acceleration=None if accelerometer is None else accelerometer.gravity_at_rest,
            names=tuple(unsound_names),
            boot=self.boot,
        )

    def _position_check(self) -> Fact:
        """Returns the check of the position as a fact: whether GPS had a fix for most of the flight.

        Its ``share`` is the time with a fix over the time in which the motors could carry the vehicle, or over the
        whole boot if that is not known (``is_powered`` is false).
        """
        share = self.position.fix_fraction
        has_mostly_fix = None if share is None else share >= MIN_FIX_FRACTION
        is_powered = bool(self.powered)
        return Fact(
            TrustCheck.POSITION,
            _level_of_check(has_mostly_fix),
            share=share,
            is_powered=is_powered,
            boot=self.boot,
        )

    def _attitude_check(self) -> Fact:
        """Returns the check of the attitude as a fact: whether roll and pitch follow their setpoints under power.

        The fact has the correlation of angle and setpoint, and their median difference as ``angle``, rad.
        """
        rotation = self.rotation
        return Fact(
            TrustCheck.ATTITUDE_RESPONSE,
            _level_of_check(self.attitude_follows_setpoint),
            correlation=None if rotation is None else rotation.correlation,
            angle=None if rotation is None else rotation.median_error,
            boot=self.boot,
        )

    def _gyro_check(self) -> Fact:
        """Returns the check of the gyro as a fact: whether the integral of its rates is the change of the attitude."""
        return Fact(TrustCheck.GYRO, _level_of_check(self.gyro_agrees), boot=self.boot)

    def _stick_check(self) -> Fact:
        """Returns the check of the pilot's throttle stick as a fact: whether it was recorded, and moved.

        Only a stick that moved can be the cause of an event. ``bounds`` are its lowest and highest position, 0 to 1.
        """
        if self.stick is None:
            return Fact(TrustCheck.STICK, Level.UNKNOWN, is_recorded=False, boot=self.boot)
        lowest, highest = float(self.stick.values.min()), float(self.stick.values.max())
        level = Level.GOOD if highest > lowest else Level.UNKNOWN
        return Fact(
            TrustCheck.STICK, level, is_recorded=True, bounds=(lowest, highest), boot=self.boot
        )


def _level_of_check(is_passed: bool | None) -> Level:
    """Returns the level of a check: GOOD if the sensor passed it, WATCH if not, UNKNOWN if it could not be checked.

    Args:
        is_passed: whether the sensor passed the check; None if it could not be checked.
    """
    if is_passed is None:
        return Level.UNKNOWN
    return Level.GOOD if is_passed else Level.WATCH


@cached_per_vehicle()
def sensor_trust(signals: Signals, boot: int) -> SensorTrust:
    """Checks the sensors of a vehicle against each other in one boot: from a start of the autopilot to the next.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot, from 0.

    Returns:
        The results of all checks. They are cached, so that events, lights and reports use the same ones.
    """
    return SensorTrust(
        boot=boot,
        is_multirotor=signals.telemetry.vehicle in POSSIBLE_MULTIROTORS,
        powered=powered_intervals(signals, boot),
        height=height_comparison(signals, boot),
        accelerometers=accelerometer_records(signals, boot),
        accelerometer=accelerometer_in_use(signals, boot),
        rotation=rotation_under_power(signals, boot),
        position=position_record(signals, boot),
        stick=series_of_boot(throttle_stick(signals), boot),
        flight_check=flight_check(signals, boot),
    )


def trust_of_boots(signals: Signals) -> tuple[SensorTrust, ...]:
    """Checks the sensors of a vehicle against each other, in each boot in which the attitude was recorded.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        The results for each of these boots, in order.
    """
    if not signals.tilts:
        return ()
    return tuple(sensor_trust(signals, boot) for boot in np.unique(signals.tilts[0].boot).tolist())
