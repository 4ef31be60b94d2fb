"""One message at a time says what columns say."""

from __future__ import annotations

import random
from math import isfinite

import numpy as np
import pytest
from mavlink_streams import frame, message

from mavdem.alignment.signals import attitude as attitude_of_columns
from mavdem.ingest.mavlink.definitions import columns, definitions
from mavdem.ingest.mavlink.vehicles import CLOCK_UNITS
from mavdem.ingest.telemetry import Telemetry
from mavdem.live.frames import LiveFrames
from mavdem.live.messages import FIELDS, attitude, message_of, outputs, parameters_of

NAMES = {definition.name: definition for definition in definitions().values()}


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("name", FIELDS)
def test_fields_and_stamps_are_those_of_columns(name, version):
    chance, definition = random.Random(name), NAMES[name]
    if definition.message_id > 255 and version == 1:
        pytest.skip("MAVLink 1 has no such ids")
    size = definition.wire.itemsize
    sent = [
        frame(definition.message_id, chance.randbytes(chance.choice((size, size, 5, 255))), version=version)
        for _ in range(50)
    ]
    content = np.frombuffer(b"".join(sent), dtype=np.uint8)
    starts = np.cumsum([0] + [len(one) for one in sent[:-1]])
    table = columns(content, starts, definition)
    clock = next((field for field in CLOCK_UNITS if field in table), None)
    for row, one in enumerate(LiveFrames().feed(content.tobytes())):
        told = message_of(one)
        assert told is not None
        assert told.name == name
        expected = [value for field in FIELDS[name] for value in np.atleast_1d(table[field][row]).tolist()]
        values = [value.split(b"\0")[0] if isinstance(value, bytes) else value for value in told.values]
        expected = [value.split(b"\0")[0] if isinstance(value, bytes) else value for value in expected]
        np.testing.assert_equal(values, expected)
        assert told.stamp == (table[clock][row] / CLOCK_UNITS[clock] if clock else 0.0)


def test_messages_of_no_use_are_left_alone():
    (one,) = LiveFrames().feed(message("GPS_RAW_INT"))
    assert message_of(one) is None


@pytest.mark.parametrize("name", ["ATTITUDE", "ATTITUDE_QUATERNION"])
def test_attitude_is_that_of_columns_and_what_cannot_be_is_left_out(name):
    chance = random.Random(2)
    odd = (float("nan"), float("inf"), -float("inf"), 1e38, -1e38, 7.0, 80.0, 0.3)
    fields = FIELDS[name]
    sent = []
    for number in range(400):
        values = {field: chance.uniform(-1, 1) for field in fields}
        if number % 2:
            field, value = chance.choice(fields), chance.choice(odd)
            # Columns make an attitude of a quaternion that is infinite.
            values[field] = 0.5 if field.startswith("q") and abs(value) == float("inf") else value
        sent.append(message(name, time_boot_ms=1 + number, **values))
    definition = NAMES[name]
    content = np.frombuffer(b"".join(sent), dtype=np.uint8)
    starts = np.cumsum([0] + [len(one) for one in sent[:-1]])
    table = columns(content, starts, definition)
    table |= {"time": table["time_boot_ms"] / 1e3, "boot": np.zeros(len(sent), dtype=np.int64)}
    telemetry = Telemetry(1, 1, "QUADROTOR", "PX4", {name: table})
    rows = [attitude(told) for one in LiveFrames().feed(content.tobytes()) if (told := message_of(one)) is not None]
    told = np.array([row for row in rows if row is not None])
    roll, pitch = attitude_of_columns(telemetry, "roll"), attitude_of_columns(telemetry, "pitch")
    np.testing.assert_allclose(told[:, 0], roll.angle, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(told[:, 2], roll.rate)
    # Columns of pitch need no roll rate; here both axes must be whole.
    np.testing.assert_allclose(told[:, 1], pitch.angle[np.isin(pitch.rate, told[:, 3])], rtol=0, atol=1e-14)
    assert all(isfinite(value) for value in told.ravel())


def test_unused_outputs_are_zero_and_the_port_is_reported():
    (one,) = LiveFrames().feed(message("SERVO_OUTPUT_RAW", port=1, servo1_raw=1500, servo2_raw=65535))
    told = message_of(one)
    assert outputs(told) == (1, (1500.0, *[0.0] * 15))


def test_parameters_are_those_of_the_autopilot():
    bits = float(np.array([101], dtype="<i4").view("<f4")[0])
    sent = [
        message("PARAM_VALUE", param_id=b"PWM_MAIN_FUNC1", param_type=6, param_value=bits),
        message("PARAM_VALUE", param_id=b"CA_ROTOR0_PX", param_type=9, param_value=0.25),
        message("PARAM_VALUE", param_id=b"NONE", param_type=9, param_value=float("nan")),
    ]
    told = [message_of(one) for one in LiveFrames().feed(b"".join(sent))]
    assert parameters_of(told, "PX4") == {"PWM_MAIN_FUNC1": 101.0, "CA_ROTOR0_PX": 0.25}
