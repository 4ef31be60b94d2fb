"""What to do about slow messages, which no log may show to be done already."""

from __future__ import annotations

import dataclasses

import numpy as np
from hover import Hover, changed, columns

from mavdem.alignment.drive import DEMAND_MESSAGE
from mavdem.alignment.signals import Signals
from mavdem.alignment.verdict import verdict_of


def remedy_for(translated_from: str, without_demand: bool = False, **fields: object) -> str:
    """What to do about a log at 4 Hz whose autopilot had these parameters, firmware and lost messages."""
    telemetry = Hover().telemetry(4.0, 4.0)
    if not without_demand:
        stamps = Hover().stamps(4.0)
        telemetry = changed(telemetry, DEMAND_MESSAGE, **columns(stamps, controls=np.zeros((len(stamps), 8))))
    return verdict_of(Signals(dataclasses.replace(telemetry, translated_from=translated_from, **fields))).remedy


def test_no_remedy_is_in_force_already_in_a_dataflash_log():
    assert "is 176126 in this log: set it to 176127" in remedy_for("DataFlash", parameters={"LOG_BITMASK": 176126.0})
    assert remedy_for("DataFlash", parameters={"LOG_BITMASK": -6146.0}).startswith("LOG_BITMASK is -6146 in this log")
    assert remedy_for("DataFlash").startswith("If it is not set (the log does not show it), set bit 0 of LOG_BITMASK")
    in_force = {"LOG_BITMASK": 32767.0}
    for firmware, cure in (
        ("ArduCopter V3.3-dev (a5a72a84)", "install ArduCopter 3.3 or later"),
        ("", "give the log as the autopilot wrote it, or fly anew with a firmware that logs it"),
        ("ArduCopter V3.3.3 (acf3e3d)", "give the log as the autopilot wrote it"),
    ):
        remedy = remedy_for("DataFlash", without_demand=True, parameters=in_force, firmware=firmware)
        assert firmware in remedy and cure in remedy and "already" in remedy
    old = remedy_for("DataFlash", without_demand=True, parameters={"LOG_BITMASK": 830.0}, firmware="ArduCopter V3.2.1")
    assert "install ArduCopter 3.3 or later" in old and "already" not in old
    limits = {"LOG_FILE_RATEMAX": 10.0, "LOG_BLK_RATEMAX": 20.0, "LOG_MAV_RATEMAX": 100.0}
    limited = remedy_for("DataFlash", parameters={**in_force, **limits})
    assert "set LOG_FILE_RATEMAX, 10 Hz in this log, to 0, and LOG_BLK_RATEMAX, 20 Hz" in limited
    assert "LOG_MAV" not in limited and "et bit 0" not in limited
    assert "LOG_BLK" not in remedy_for("DataFlash", parameters={**limits, "LOG_BACKEND_TYPE": 1.0})
    assert "no room for 12 messages" in remedy_for("DataFlash", parameters=in_force, dropouts=12)


def test_no_remedy_is_in_force_already_in_a_ulog():
    assert "SDLOG_PROFILE is 131 in this log: set it to 147" in remedy_for("ULog", parameters={"SDLOG_PROFILE": 131.0})
    assert "this PX4 has no such parameter" in remedy_for("ULog", parameters={"SDLOG_MODE": 0.0})
    in_force = {"SDLOG_PROFILE": 17.0}
    assert "logger_topics.txt" in remedy_for("ULog", parameters=in_force)
    assert "dropped out 3 times" in remedy_for("ULog", parameters=in_force, dropouts=3)


def test_no_remedy_is_in_force_already_in_a_stream():
    assert "SRn_EXTRA1 and SRn_RC_CHAN to 100" in remedy_for("", parameters={"SR0_EXTRA1": 4.0, "SR0_RC_CHAN": 4.0})
    assert "the telemetry port's MAVn_EXTRA1 and MAVn_RC_CHAN to 100" in remedy_for("", parameters={"MAV1_EXTRA1": 4.0})
    fast = {"SR0_EXTRA1": 4.0, "SR0_RC_CHAN": 4.0, "SR1_EXTRA1": 100.0, "SR1_RC_CHAN": 50.0, "SR2_EXTRA1": 100.0}
    remedy = remedy_for("", parameters=fast)
    assert remedy.startswith("SR1_EXTRA1 and SR1_RC_CHAN are 40 or more already") and "SR2" not in remedy
