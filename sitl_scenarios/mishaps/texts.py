"""Texts that the autopilots send about a mishap (STATUSTEXT), as in their source code.

ArduPilot: ``ArduCopter/*.cpp``, ``AP_NavEKF3``, ``AP_Logger``; PX4: ``src/modules/commander``, ``src/modules/ekf2``.
"""

from typing import NamedTuple

from sitl_scenarios.mishaps.pilot import RADIO_SECONDS
from sitl_scenarios.mishaps.specs import (
    EmptyBattery,
    FailsafeDisarm,
    GpsGlitch,
    GpsLoss,
    HeightRunaway,
    Mishap,
    YawReset,
)

CRITICAL, ERROR, WARNING, INFO = 2, 3, 4, 6
"""MAV_SEVERITY."""

WATCHDOG_TEXT = "WDG: T-3 SL0 FL0 FT0 FA0 FTP0 FLR0 FICSR0 MM0 MC0 IE0 IEC0 TN:main"
"""Text that ArduPilot sends after its watchdog reset it, the first 50 characters."""

CRASH_CHECK_SECONDS = 2.0
"""Time after which ArduCopter's crash check disarms: CRASH_CHECK_TRIGGER_SEC of crash_check.cpp."""


class Announcement(NamedTuple):
    """A text of the autopilot."""

    time: float
    """Time at which it is sent, s after arming."""
    text: str
    """At most 50 characters."""
    severity: int
    """MAV_SEVERITY."""


def announcements(mishap: Mishap | None, *, is_px4: bool, duration: float) -> list[Announcement]:
    """Returns the texts that the autopilot sends about a mishap, as far as their times are known before the flight.

    Texts whose times depend on the motion, such as the text of a crash check, are sent by the simulation itself.

    Args:
        mishap: Mishap of the flight; None for a flight without one.
        is_px4: Whether the autopilot is PX4 rather than ArduPilot.
        duration: Duration of the flight, s.

    Returns:
        The texts in order of time; empty if there are none.
    """
    match mishap:
        case FailsafeDisarm(start=start, cause="radio"):
            texts = ("Radio Failsafe", "Radio Failsafe - Disarming")
            if is_px4:
                texts = ("Manual control lost", "Failsafe activated: Disarm")
            return [
                Announcement(start - RADIO_SECONDS / 2, texts[0], WARNING),
                Announcement(start, texts[1], CRITICAL),
            ]
        case FailsafeDisarm(start=start):
            texts = (
                "Battery 1 is low 10.20V used 2410 mAh",
                "Battery 1 is critical 9.60V used 2900 mAh",
            )
            if is_px4:
                texts = ("Low battery level! Return advised", "Emergency battery level! Land now")
            return [
                Announcement(0.7 * start, texts[0], WARNING),
                Announcement(start - 0.2, texts[1], CRITICAL),
            ]
        case GpsLoss(start=start, failsafe=failsafe):
            texts = ("EKF3 IMU0 stopped aiding", "EKF Failsafe: changed to LAND Mode")
            if is_px4:
                texts = ("GNSS fix lost", "Failsafe activated: position lost, Descend")
            return [
                Announcement(start + 1.0, texts[0], WARNING),
                Announcement(start + failsafe, texts[1], CRITICAL),
            ]
        case GpsGlitch(start=start, seconds=seconds):
            if is_px4:
                return [Announcement(start + 1.0, "GNSS data fusion stopped", WARNING)]
            return [
                Announcement(start + 0.5, "GPS Glitch or Compass error", CRITICAL),
                Announcement(start + seconds, "Glitch cleared", CRITICAL),
            ]
        case YawReset(start=start):
            text = "EKF2 yaw estimate reset" if is_px4 else "EKF3 IMU0 emergency yaw reset"
            return [Announcement(start, text, WARNING)]
        case HeightRunaway(start=start) if not is_px4:
            return [Announcement(start + 1.0, "Vibration compensation ON", CRITICAL)]
        case EmptyBattery():
            texts = (
                "Battery 2 is low 9.80V used 2410 mAh",
                "Battery 2 is critical 9.00V used 2900 mAh",
            )
            if is_px4:
                texts = ("Low battery level! Return advised", "Critical battery level! Land now")
            return [
                Announcement(0.5 * duration, texts[0], WARNING),
                Announcement(0.75 * duration, texts[1], CRITICAL),
            ]
    return []
