"""Faster: how to get more attitude and motor outputs a second out of each autopilot, in its own words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mavdem.ingest import Speaker
from mavdem.telemetry import Telemetry

REQUEST, SET_MESSAGE_INTERVAL = "REQUEST_DATA_STREAM", 511
"""How ground stations ask a vehicle for rates: a message, and a command of MAV_CMD."""


def kept_from_asking(telemetry: Telemetry, speakers: Sequence[Speaker]) -> str:
    """A sentence about whoever asks the vehicle for rates, which then hold whatever it was set to; empty if none does.

    Args:
        telemetry: of the vehicle.
        speakers: who was heard beside it.
    """
    own = (telemetry.system, telemetry.component)
    asking = [
        f"{speaker.system}:{speaker.component}"
        for speaker in speakers
        if REQUEST in speaker.messages and (speaker.system, speaker.component) != own
    ]
    if asking:
        return (
            f"A ground station ({', '.join(asking)}) asks for rates with {REQUEST}: keep it from that (in MAVProxy "
            "with `set streamrate -1`)."
        )
    answers = telemetry.messages.get("COMMAND_ACK")
    if answers is not None and (np.asarray(answers["command"]) == SET_MESSAGE_INTERVAL).any():
        return (
            "Somebody asks for rates with SET_MESSAGE_INTERVAL, which the vehicle acknowledged: let them ask for more, "
            "or for none."
        )
    return ""


def ask_for_rate(telemetry: Telemetry, rate: int = 100) -> str:
    """How to get attitude and motors at ``rate`` Hz out of this autopilot.

    Args:
        telemetry: of the vehicle.
        rate: Hz.

    PX4: https://docs.px4.io/main/en/modules/modules_communication (``mavlink``). ArduPilot:
    https://ardupilot.org/dev/docs/mavlink-requesting-data.html; its stream groups EXTRA1 and RC_CHAN send ATTITUDE and
    SERVO_OUTPUT_RAW. ROS 2: https://docs.px4.io/main/en/middleware/uxrce_dds and MAVROS's ``plugins/sys_status.cpp``.
    """
    if telemetry.translated_from == "uXRCE-DDS":
        return (
            "In PX4's src/modules/uxrce_dds_client/dds_topics.yaml add vehicle_attitude, vehicle_angular_velocity and "
            f"actuator_motors to the publications, no rate_limit below {rate}; build and flash PX4, and record anew."
        )
    if telemetry.translated_from == "MAVROS":
        return (
            "Call `ros2 service call /mavros/set_message_interval mavros_msgs/srv/MessageInterval "
            f'"{{message_id: 31, message_rate: {rate}}}"` (attitude), then with 36 (motors), and record anew.'
        )
    if telemetry.translated_from == "DataFlash":
        return (
            "Set bit 0 of LOG_BITMASK (fast attitude), which logs attitude and the demand at the loop rate; fly anew."
        )
    if telemetry.translated_from == "ULog":
        return "Set SDLOG_PROFILE to 17 (default and high rate), which logs attitude and the demand fast; fly anew."
    if telemetry.autopilot == "PX4":
        return (
            f"In PX4's shell run `mavlink stream -d DEVICE -s ATTITUDE -r {rate}` and "
            f"`mavlink stream -d DEVICE -s SERVO_OUTPUT_RAW_0 -r {rate}`, where DEVICE is the telemetry port "
            "(`-u PORT` for UDP), and record anew."
        )
    interval = round(1e6 / rate)
    if telemetry.autopilot == "ARDUPILOTMEGA":
        return (
            f"Set the telemetry port's SRn_EXTRA1 and SRn_RC_CHAN (MAVn_EXTRA1 and MAVn_RC_CHAN from ArduPilot 4.7) to "
            f"{rate} and reboot, or in MAVProxy enter `set streamrate -1`, `long SET_MESSAGE_INTERVAL 30 {interval}` "
            f"and `long SET_MESSAGE_INTERVAL 36 {interval}`; then record anew."
        )
    return (
        f"Ask the autopilot for messages 30 (ATTITUDE) and 36 (SERVO_OUTPUT_RAW) every {interval} µs with "
        "MAV_CMD_SET_MESSAGE_INTERVAL, and record anew."
    )
