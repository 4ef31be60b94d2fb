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


def stamps(made, message):
    return made.messages[message]["time"]


def instrumented(mode="Loiter"):
    """A hover at 10 m, level and still, whose sensors all agree."""
    made = Hover(sway=0.0).telemetry(50.0, 50.0, parameters=X_QUAD_PARAMETERS)
    time = stamps(made, "ATTITUDE")
    level = quaternion(*3 * [0 * time])
    made = changed(made, "ATTITUDE_TARGET", **columns(time, **attitude_target(level)))
    # A gyro that never moves is dead.
    noise = 1e-3 * np.random.default_rng(3).standard_normal(len(time))
    made = changed(made, "ATTITUDE", rollspeed=noise)
    made = changed(made, "HIGHRES_IMU", **columns(time, xacc=0.0, yacc=0.0, zacc=-9.8))
    made = changed(made, "RC_CHANNELS", **columns(time, chan3_raw=STICK_MIDDLE))
    made = changed(made, "CURRENT_MODE", **columns([0.0], custom_mode=COPTER[mode]))
    place = made.messages["LOCAL_POSITION_NED"]
    height = np.cumsum(-place["vz"]) * 0.1
    made = changed(made, "LOCAL_POSITION_NED", x=0.0, y=0.0, vx=0.0, vy=0.0, z=-height)
    made = changed(made, "SCALED_PRESSURE", **columns(place["time"], altitude=120.0 + height))
    return changed(made, "GPS_RAW_INT", **columns(place["time"], fix_type=3))


def moving(made, climb):
    """The vehicle truly climbs so fast, m/s, a function of the time since ``EVENT``, in the air only."""
    place = made.messages["LOCAL_POSITION_NED"]
    since = place["time"] - EVENT
    speed = np.where(since > 0, climb(since), -place["vz"])
    height = np.maximum(np.cumsum(speed) * 0.1, 0.0)
    vz = np.where((since > 0) & (height <= 0), 0.0, -speed)
    made = changed(made, "LOCAL_POSITION_NED", vz=vz, z=-height)
    return changed(made, "SCALED_PRESSURE", altitude=120.0 + height)


def estimating(made, climb):
    """The estimate climbs so fast, m/s, a function of the time since ``EVENT``, whatever the barometer shows."""
    place = made.messages["LOCAL_POSITION_NED"]
    since = place["time"] - EVENT
    speed = np.where(since > 0, climb(since), -place["vz"])
    return changed(made, "LOCAL_POSITION_NED", vz=-speed, z=-np.cumsum(speed) * 0.1)


def driven(made, output, start=EVENT, end=np.inf):
    """All motors have this output, µs, from ``start`` to ``end``."""
    time = stamps(made, "SERVO_OUTPUT_RAW")
    is_driven = (time >= start) & (time < end)
    return with_pulses(made, np.where(is_driven, output, pulses(made)))


def stick(made, pulse, start=EVENT, end=np.inf):
    """The throttle stick has this pulse width, µs, from ``start`` to ``end``."""
    time = stamps(made, "RC_CHANNELS")
    moved = np.where(
        (time >= start) & (time < end), pulse, made.messages["RC_CHANNELS"]["chan3_raw"]
    )
    return changed(made, "RC_CHANNELS", chan3_raw=moved)


def knocked(made, time, size=80.0):
    """The accelerometer feels a knock of this size, m/s², for a moment."""
    is_knock = abs(stamps(made, "HIGHRES_IMU") - time) < 0.03
    force = made.messages["HIGHRES_IMU"]["zacc"]
    return changed(made, "HIGHRES_IMU", zacc=np.where(is_knock, -size, force))


def rolled(made, angle, time=EVENT, seconds=0.3):
    """The vehicle rolls by this angle, degrees, within so many seconds, and stays so; gyro and accelerometer agree."""
    at = stamps(made, "ATTITUDE")
    roll = np.radians(angle) * np.clip((at - time) / seconds, 0, 1)
    noise = made.messages["ATTITUDE"]["rollspeed"]
    made = changed(made, "ATTITUDE", roll=roll, rollspeed=np.gradient(roll, at) + noise)
    force = made.messages["HIGHRES_IMU"]["zacc"]
    return changed(made, "HIGHRES_IMU", yacc=force * np.sin(roll), zacc=force * np.cos(roll))


def in_mode(made, *changes):
    """The vehicle changes its mode: pairs of a time, s, and the name of the mode."""
    times = [0.0, *(time for time, _ in changes)]
    first = made.messages["CURRENT_MODE"]["custom_mode"][0]
    modes = [first, *(COPTER[name] for _, name in changes)]
    return changed(made, "CURRENT_MODE", **columns(times, custom_mode=np.array(modes)))


def saying(made, time, text):
    """The autopilot says something at a time, s, as an alert."""
    row = columns([time], text=np.array([text]), severity=np.array([1]))
    return changed(made, "STATUSTEXT", **row)
