"""A made-up hover with all instruments: barometer, accelerometer, throttle stick, setpoints and position."""

import numpy as np
from hover import X_QUAD_PARAMETERS, Hover, changed, columns, pulses, with_pulses

from mavdem.ingest.vocabulary import attitude_target, quaternion

EVENT = 30.0
"""Seconds from boot at which the mishaps of tests begin."""

COPTER = {"Stabilize": 0, "Alt hold": 2, "Auto": 3, "Loiter": 5, "Land": 9}
"""Numbers of ArduCopter's modes."""

STICK_MIDDLE = 1500
STICK_CLOSED = 1000


def stamps(telemetry, message):
    return telemetry.messages[message]["time"]


def instrumented(mode="Loiter"):
    """Returns telemetry of a hover at 10 m, level and still, whose sensors all agree."""
    telemetry = Hover(sway=0.0).telemetry(50.0, 50.0, parameters=X_QUAD_PARAMETERS)
    time = stamps(telemetry, "ATTITUDE")
    level = quaternion(*3 * [0 * time])
    telemetry = changed(telemetry, "ATTITUDE_TARGET", **columns(time, **attitude_target(level)))
    # A gyro that never moves is dead.
    noise = 1e-3 * np.random.default_rng(3).standard_normal(len(time))
    telemetry = changed(telemetry, "ATTITUDE", rollspeed=noise)
    telemetry = changed(telemetry, "HIGHRES_IMU", **columns(time, xacc=0.0, yacc=0.0, zacc=-9.8))
    telemetry = changed(telemetry, "RC_CHANNELS", **columns(time, chan3_raw=STICK_MIDDLE))
    telemetry = changed(telemetry, "CURRENT_MODE", **columns([0.0], custom_mode=COPTER[mode]))
    position = telemetry.messages["LOCAL_POSITION_NED"]
    height = np.cumsum(-position["vz"]) * 0.1
    telemetry = changed(telemetry, "LOCAL_POSITION_NED", x=0.0, y=0.0, vx=0.0, vy=0.0, z=-height)
    telemetry = changed(
        telemetry, "SCALED_PRESSURE", **columns(position["time"], altitude=120.0 + height)
    )
    return changed(telemetry, "GPS_RAW_INT", **columns(position["time"], fix_type=3))


def moving(telemetry, climb):
    """Returns telemetry of a vehicle that climbs at a speed, m/s, which is a function of the time since ``EVENT``."""
    position = telemetry.messages["LOCAL_POSITION_NED"]
    since = position["time"] - EVENT
    speed = np.where(since > 0, climb(since), -position["vz"])
    height = np.maximum(np.cumsum(speed) * 0.1, 0.0)
    vz = np.where((since > 0) & (height <= 0), 0.0, -speed)
    telemetry = changed(telemetry, "LOCAL_POSITION_NED", vz=vz, z=-height)
    return changed(telemetry, "SCALED_PRESSURE", altitude=120.0 + height)


def estimating(telemetry, climb):
    """The estimate climbs so fast, m/s, a function of the time since ``EVENT``, whatever the barometer shows."""
    position = telemetry.messages["LOCAL_POSITION_NED"]
    since = position["time"] - EVENT
    speed = np.where(since > 0, climb(since), -position["vz"])
    return changed(telemetry, "LOCAL_POSITION_NED", vz=-speed, z=-np.cumsum(speed) * 0.1)


def driven(telemetry, output, start=EVENT, end=np.inf):
    """All motors have this output, µs, from ``start`` to ``end``."""
    time = stamps(telemetry, "SERVO_OUTPUT_RAW")
    is_driven = (time >= start) & (time < end)
    return with_pulses(telemetry, np.where(is_driven, output, pulses(telemetry)))


def stick(telemetry, pulse, start=EVENT, end=np.inf):
    """Returns telemetry in which the throttle stick has a pulse width, µs, from start to end, s."""
    time = stamps(telemetry, "RC_CHANNELS")
    stick_pulses = np.where(
        (time >= start) & (time < end), pulse, telemetry.messages["RC_CHANNELS"]["chan3_raw"]
    )
    return changed(telemetry, "RC_CHANNELS", chan3_raw=stick_pulses)


def knocked(telemetry, time, size=80.0):
    """The accelerometer feels a knock of this size, m/s², for a moment."""
    is_knock = abs(stamps(telemetry, "HIGHRES_IMU") - time) < 0.03
    force = telemetry.messages["HIGHRES_IMU"]["zacc"]
    return changed(telemetry, "HIGHRES_IMU", zacc=np.where(is_knock, -size, force))


def rolled(telemetry, angle, time=EVENT, seconds=0.3):
    """The vehicle rolls by this angle, degrees, within so many seconds, and stays so; gyro and accelerometer agree."""
    at = stamps(telemetry, "ATTITUDE")
    roll = np.radians(angle) * np.clip((at - time) / seconds, 0, 1)
    noise = telemetry.messages["ATTITUDE"]["rollspeed"]
    telemetry = changed(telemetry, "ATTITUDE", roll=roll, rollspeed=np.gradient(roll, at) + noise)
    force = telemetry.messages["HIGHRES_IMU"]["zacc"]
    return changed(telemetry, "HIGHRES_IMU", yacc=force * np.sin(roll), zacc=force * np.cos(roll))


def in_mode(telemetry, *changes):
    """The vehicle changes its mode: pairs of a time, s, and the name of the mode."""
    times = [0.0, *(time for time, _ in changes)]
    first = telemetry.messages["CURRENT_MODE"]["custom_mode"][0]
    modes = [first, *(COPTER[name] for _, name in changes)]
    return changed(telemetry, "CURRENT_MODE", **columns(times, custom_mode=np.array(modes)))


def saying(telemetry, time, text):
    """The autopilot says something at a time, s, as an alert."""
    row = columns([time], text=np.array([text]), severity=np.array([1]))
    return changed(telemetry, "STATUSTEXT", **row)
