"""Mishap: pydantic models of what goes wrong in a flight, one model for each kind.

A scenario has one mishap at most, in its section ``[mishap]``. Times are seconds after the first arming.
"""

from typing import Annotated, Literal

from pydantic import Field

from sitl_scenarios.section import NotNegative, Positive, Section, Share

Number = Annotated[int, Field(ge=1, le=8)]  # Number of a motor, as the autopilot counts
Bearing = Annotated[float, Field(ge=-360, le=360)]  # Degrees clockwise from the nose
Length = Annotated[float, Field(ge=-200, le=200)]  # Metres.
Start = NotNegative


class MotorStop(Section):
    """A motor that stops at once, as its controller or a wire fails."""

    kind: Literal["motor_stop"]
    start: Start
    motor: Number = 1
    """The motor that stops"""


class MotorFade(Section):
    """A motor that loses its thrust slowly."""

    kind: Literal["motor_fade"]
    start: Start
    motor: Number = 1
    """The motor that fades"""
    seconds: Positive = 20.0
    """Seconds until it has lost all that it loses"""
    thrust: Share = 0.4
    """Share of its thrust that is left then"""


class LoosePropeller(Section):
    """A propeller that slips on its shaft now and then, and shakes the frame."""

    kind: Literal["propeller_loose"]
    start: Start
    motor: Number = 1
    """The motor that turns it"""
    thrust: Share = 0.6
    """Share of its thrust that is left while it slips"""
    vibration: Annotated[float, Field(ge=0, le=200)] = 25.0
    """Vibration that it adds, m/s²"""


class HeightRunaway(Section):
    """An accelerometer that vibration makes read too little: the estimated climb falls, and the vehicle rises."""

    kind: Literal["height_runaway"]
    start: Start
    seconds: Positive = 5.0
    """Seconds until the estimate is right again"""
    bias: Annotated[float, Field(ge=0, le=10)] = 2.5
    """What the accelerometer reads too little, m/s²"""
    vibration: Annotated[float, Field(ge=0, le=200)] = 70.0
    """Vibration that makes it, m/s²"""


class VibrationRectification(Section):
    """Vibration that biases the accelerometer: the barometer holds the estimated height, at a wrong value."""

    kind: Literal["vibration_rectification"]
    start: Start
    bias: Annotated[float, Field(ge=0, le=10)] = 0.6
    """What the accelerometer reads too little, m/s²"""
    vibration: Annotated[float, Field(ge=0, le=200)] = 50.0
    """Vibration that makes it, m/s²"""


class BarometerDrift(Section):
    """A barometer whose height drifts away: the autopilot follows it, and satellites do not."""

    kind: Literal["barometer_drift"]
    start: Start
    metres: Length = 8.0
    """How far it drifts, m"""
    seconds: Positive = 15.0
    """Seconds until it has drifted so far"""


class BarometerStuck(Section):
    """A barometer whose reading no longer changes, while the vehicle climbs and descends."""

    kind: Literal["barometer_stuck"]
    start: Start
    climb: Annotated[float, Field(gt=0, le=50)] = 6.0
    """How far the vehicle climbs after that, m"""


class GpsLoss(Section):
    """Satellites that are lost: the position drifts, and the autopilot lands without it."""

    kind: Literal["gps_loss"]
    start: Start
    failsafe: Positive = 5.0
    """Seconds until the autopilot lands"""


class GpsGlitch(Section):
    """A position of the satellites that jumps, and comes back."""

    kind: Literal["gps_glitch"]
    start: Start
    seconds: Positive = 6.0
    """Seconds until it is back"""
    metres: Length = 40.0
    """How far it jumps to the east, m"""


class YawReset(Section):
    """An estimated heading that was wrong since boot, until the estimator sets it again in flight."""

    kind: Literal["yaw_reset"]
    start: Start
    degrees: Annotated[float, Field(ge=-60, le=60)] = 30.0
    """By how much it was wrong"""


class BenchRun(Section):
    """Motors that run without lifting: on a bench, tied down, or without propellers."""

    kind: Literal["bench_run"]
    throttle: Share = 0.6
    """Greatest throttle"""
    reports_flight: bool = True
    """Whether the autopilot's land detector takes it for flight"""


class ToppleAtTakeOff(Section):
    """A vehicle that tips over as it lifts off: a leg is caught, or motors are in the wrong order."""

    kind: Literal["topple_at_take_off"]
    bearing: Bearing = 90.0
    """To which side it tips, degrees clockwise from the nose"""


class ToppleAtLanding(Section):
    """A vehicle that tips over as it lands by its pilot, who closes the throttle."""

    kind: Literal["topple_at_landing"]
    bearing: Bearing = 90.0
    """To which side it tips, degrees clockwise from the nose"""


class ThrottleCut(Section):
    """A pilot who closes the throttle in the air, in a mode in which that stops the lift: the vehicle falls."""

    kind: Literal["throttle_cut"]
    start: Start


class FailsafeDisarm(Section):
    """A failsafe that disarms in the air: the vehicle falls."""

    kind: Literal["failsafe_disarm"]
    start: Start
    cause: Literal["radio", "battery"] = "radio"
    """What the failsafe acts on"""


class Dive(Section):
    """A pilot who closes the throttle in the air, lets the vehicle fall, and catches it."""

    kind: Literal["dive"]
    start: Start
    seconds: Annotated[float, Field(gt=0, le=3)] = 1.2
    """Seconds for which the throttle is closed"""


class Flip(Section):
    """A roll through 360°, as the pilot commands it."""

    kind: Literal["flip"]
    start: Start


class Restart(Section):
    """An autopilot whose watchdog resets it in flight; it flies on."""

    kind: Literal["restart"]
    start: Start


class SecondLink(Section):
    """A second link that delivers every frame again, late."""

    kind: Literal["second_link"]
    delay: Annotated[float, Field(gt=0, le=10)] = 2.0
    """Seconds between the two links"""


class SecondVehicle(Section):
    """A second vehicle that sends under the same system id, from its own boot and place."""

    kind: Literal["second_vehicle"]
    metres: Length = 40.0
    """How far it is to the east, m"""
    boot: Annotated[float, Field(ge=1, le=10_000)] = 300.0
    """Seconds that it was on before the first one"""


class EmptyBattery(Section):
    """Two batteries, of which the second is empty."""

    kind: Literal["empty_battery"]
    cell: Annotated[float, Field(ge=2, le=4.2)] = 2.9
    """Voltage of each of its three cells at the end, V"""


class BrownOut(Section):
    """A supply of the autopilot's board that falls until the board stops, and with it the record."""

    kind: Literal["brown_out"]
    start: Start
    seconds: Positive = 4.0
    """Seconds in which it falls before the board stops"""
    voltage: Annotated[float, Field(ge=3, le=5)] = 4.1
    """Voltage at which it stops, V"""


Mishap = Annotated[
    MotorStop
    | MotorFade
    | LoosePropeller
    | HeightRunaway
    | VibrationRectification
    | BarometerDrift
    | BarometerStuck
    | GpsLoss
    | GpsGlitch
    | YawReset
    | BenchRun
    | ToppleAtTakeOff
    | ToppleAtLanding
    | ThrottleCut
    | FailsafeDisarm
    | Dive
    | Flip
    | Restart
    | SecondLink
    | SecondVehicle
    | EmptyBattery
    | BrownOut,
    Field(discriminator="kind"),
]
