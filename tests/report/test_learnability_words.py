"""Learnability in words: each branch of a sentence or a remedy of the table."""

import pytest

from mavdem.facts import Fact
from mavdem.facts.learnability import Caution, Reason, Remedy
from mavdem.report.words import advised

FLY = Fact(Remedy.RECORD_A_FLIGHT)
STREAMS = {"rate": 100, "asked": False, "names": (), "prefix": ""}
DATAFLASH = {"names": (), "rates": (), "dropouts": 0}
LIMITS = {"names": ("LOG_FILE_RATEMAX", "LOG_BLK_RATEMAX"), "rates": (10.0, 20.0)}
GROUNDED = {"armed": 9.4, "name": "EXTENDED_SYS_STATE", "climb_rate": None, "remedy": FLY}
GROUNDED |= {"collective": None, "least_collective": 0.2}
ROLL = {"axis": "roll", "span": 0.2, "consistency": 0.2512, "still": False, "remedy": FLY}


@pytest.mark.parametrize(
    ("code", "figures", "words"),
    [
        (
            Reason.STREAMS_TOO_SLOW,
            {"names": ["ATT", "RCOU"], "rates": [9.76983, 39.99], "least_rate": 40, "axis": "roll"},
            "ATT comes at 9.8 Hz and RCOU at 39.99 Hz; roll motion has",
        ),
        (Reason.NEVER_ARMED, {"remedy": FLY}, "never armed. Record a flight: half a minute in the"),
        (Reason.NEVER_AIRBORNE, GROUNDED, "armed for 9 s and never left the ground: by EXTENDED"),
        (Reason.NEVER_AIRBORNE, GROUNDED | {"climb_rate": 0.1}, "it did not rise by 0.1 m/s, or"),
        (
            Reason.NEVER_AIRBORNE,
            GROUNDED | {"collective": 0.109},
            "ran at 10 % of their range at most, and flight takes 20 %.",
        ),
        (Reason.RATE_CONTRADICTS_ANGLE, ROLL, "explains 0.251 of the angle's changes over 0.2 s,"),
        (Reason.RATE_CONTRADICTS_ANGLE, ROLL | {"still": True}, "excite roll with the stick."),
        (Reason.RATE_CONTRADICTS_ANGLE, ROLL | {"axis": "yaw"}, "Turn the vehicle with the yaw"),
        (
            Caution.NEAR_RESOLUTION,
            {"axis": "yaw", "angle_step": 0.1, "rate_step": 0.05, "share": 1 / 21},
            "yaw rate is near the resolution of the stream (steps of 0.05 rad/s): rounding can "
            "shrink what is learned of the dynamics by 5 %.",
        ),
        (
            Remedy.LOG_FAST_ATTITUDE,
            DATAFLASH | {"bitmask": 176126},
            "LOG_BITMASK is 176126 in this log: set it to 176127, with bit 0",
        ),
        (
            Remedy.LOG_FAST_ATTITUDE,
            DATAFLASH | LIMITS | {"bitmask": None},
            "If it is not set (the log does not show it), set bit 0 of LOG_BITMASK (fast attitude)"
            ", and LOG_FILE_RATEMAX, 10 Hz in this log, to 0, and LOG_BLK_RATEMAX, 20 Hz in",
        ),
        (
            Remedy.LOG_FAST_ATTITUDE,
            DATAFLASH | LIMITS | {"bitmask": 1},
            "set already, but the rate of messages is limited: set LOG_FILE_RATEMAX, 10 Hz in this",
        ),
        (
            Remedy.LOG_FAST_ATTITUDE,
            DATAFLASH | {"bitmask": 1, "dropouts": 12},
            "the logger had no room for 12 messages",
        ),
        (
            Remedy.LOG_HIGH_RATE,
            {"profile": 131, "has_parameters": True, "dropouts": 0},
            "SDLOG_PROFILE is 131 in this log: set it to 147 (adds the high rate, bit 4)",
        ),
        (
            Remedy.LOG_HIGH_RATE,
            {"profile": 17, "has_parameters": True, "dropouts": 0},
            "SDLOG_PROFILE is 17, so the high rate (bit 4) is set already: reboot if",
        ),
        (Remedy.ARDUPILOT_STREAMS, STREAMS, "SRn_RC_CHAN (MAVn_EXTRA1 and MAVn_RC_CHAN from"),
        (
            Remedy.ARDUPILOT_STREAMS,
            STREAMS | {"prefix": "MAV"},
            "Set the telemetry port's MAVn_EXTRA1 and MAVn_RC_CHAN to 100 and reboot, or in MAVProxy "
            "enter `set streamrate -1`, `long SET_MESSAGE_INTERVAL 30 10000`",
        ),
        (
            Remedy.ARDUPILOT_STREAMS,
            STREAMS | {"prefix": "SR", "names": ("SR1",), "asked": True},
            "SR1_EXTRA1 and SR1_RC_CHAN are 40 or more already: if that is the port of this link,",
        ),
        (
            Remedy.MAVROS_INTERVALS,
            STREAMS,
            'mavros_msgs/srv/MessageInterval "{message_id: 31, message_rate: 100}"` (attitude)',
        ),
        (Remedy.MESSAGE_INTERVALS, STREAMS, "36 (SERVO_OUTPUT_RAW) every 10000 µs"),
    ],
)
def test_sentences_have_their_figures(code, figures, words):
    assert words in advised(Fact(code, **figures))
