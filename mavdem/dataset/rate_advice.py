"""Rate advice: how to get attitude and motors fast out of an autopilot, by the settings that its log shows."""

import re
from collections.abc import Sequence

from mavdem.dataset.motor_outputs import DEMAND_MESSAGE
from mavdem.dataset.signals import MIN_STREAM_RATE
from mavdem.facts import Fact
from mavdem.facts.learnability import Remedy
from mavdem.ingest import Component
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import mavlink_constant

REQUEST = "REQUEST_DATA_STREAM"
SET_MESSAGE_INTERVAL = mavlink_constant("MAV_CMD_SET_MESSAGE_INTERVAL")
"""How ground stations ask a vehicle for rates: a message, and a command of MAV_CMD."""
STREAM_RATE = re.compile(r"((SR|MAV)\d+)_(EXTRA1|RC_CHAN)$")
"""ArduPilot's parameters for the rates of attitude and motor outputs on each port; MAV from 4.7 on."""
RATE_LIMITS = {"LOG_FILE_RATEMAX": 1, "LOG_MAV_RATEMAX": 2, "LOG_BLK_RATEMAX": 4}
"""ArduPilot's limits of the rate of each message, Hz, 0 for none, and the bits of LOG_BACKEND_TYPE that use them."""
FIRMWARE_VERSION = re.compile(r"V(\d+)\.(\d+)")
DEMAND_SINCE = (3, 3)
"""Where ArduCopter's version is in what it calls itself, and the first that logs RATE; some builds of its development
did not."""
STREAMS = {
    "uXRCE-DDS": Remedy.DDS_TOPICS,
    "MAVROS": Remedy.MAVROS_INTERVALS,
    "PX4": Remedy.PX4_STREAMS,
    "ARDUPILOTMEGA": Remedy.ARDUPILOT_STREAMS,
}
"""How rates of a stream are set, by what a log was translated from, or by its autopilot."""


def rate_advice(
    telemetry: Telemetry, rate: int = 100, components: Sequence[Component] = ()
) -> Fact:
    """Returns how to get attitude and motors at ``rate`` Hz.

    How to stop one of the ``components`` from asking for rates comes first: those hold whatever the settings.
    """
    own = (telemetry.system, telemetry.component)
    senders = [
        f"{sender.system}:{sender.component}"
        for sender in components
        if REQUEST in sender.messages and (sender.system, sender.component) != own
    ]
    replies = telemetry.messages.get("COMMAND_ACK", {})
    remedy = _settings(telemetry, rate, bool(senders))
    if not senders and SET_MESSAGE_INTERVAL not in replies.get("command", ()):
        return remedy
    return Fact(Remedy.STOP_ASKING_FOR_RATES, names=senders, remedy=remedy)


def _settings(telemetry: Telemetry, rate: int, asked: bool) -> Fact:
    parameters = telemetry.parameters
    recorder = telemetry.translated_from
    if recorder == "DataFlash":
        return _dataflash(telemetry)
    if recorder == "ULog":
        profile = parameters.get("SDLOG_PROFILE")
        return Fact(
            Remedy.LOG_HIGH_RATE,
            profile=None if profile is None else int(profile),
            has_parameters=bool(parameters),
            dropouts=telemetry.dropouts,
        )
    code = STREAMS.get(recorder, STREAMS.get(telemetry.autopilot, Remedy.MESSAGE_INTERVALS))
    named = [match for name in parameters if (match := STREAM_RATE.match(name))]
    kinds = {match[2] for match in named}
    fast = [
        port
        for port in sorted({match[1] for match in named})
        if min(parameters.get(f"{port}_{of}", 0) for of in ("EXTRA1", "RC_CHAN")) >= MIN_STREAM_RATE
    ]
    return Fact(
        code, rate=rate, asked=asked, names=fast, prefix="SR" if "SR" in kinds else "".join(kinds)
    )


def _dataflash(telemetry: Telemetry) -> Fact:
    """How to log attitude and the demand fast with ArduPilot; ArduCopter logs motor outputs (RCOU) at 10 Hz."""
    bitmask = telemetry.parameters.get("LOG_BITMASK")
    firmware = telemetry.firmware
    is_fast = bitmask is not None and bool(int(bitmask) & 1)
    named = FIRMWARE_VERSION.search(firmware)
    version = (int(named[1]), int(named[2])) if named else ()
    can_log = version > DEMAND_SINCE or (version == DEMAND_SINCE and "-dev" not in firmware)
    if DEMAND_MESSAGE not in telemetry.messages and (is_fast or (named and not can_log)):
        return Fact(
            Remedy.DEMAND_NOT_LOGGED,
            firmware=firmware,
            version=version,
            can_log=can_log,
            is_fast=is_fast,
        )
    backends = int(telemetry.parameters.get("LOG_BACKEND_TYPE", 7))
    low = {
        name: limit
        for name, backend in RATE_LIMITS.items()
        if 0 < (limit := telemetry.parameters.get(name, 0.0)) < MIN_STREAM_RATE
        and backend & backends
    }
    return Fact(
        Remedy.LOG_FAST_ATTITUDE,
        bitmask=None if bitmask is None else int(bitmask),
        names=tuple(low),
        rates=tuple(low.values()),
        dropouts=telemetry.dropouts,
    )
