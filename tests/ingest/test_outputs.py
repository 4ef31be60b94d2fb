"""Motors on any output: RCOU, RCO2 and RCO3 of DataFlash, ports of SERVO_OUTPUT_RAW, and ids that messages share."""

import struct

import dataflash_logs as made
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from mavdem.dataset import flight_states
from mavdem.dataset.motor_outputs import MotorOutputs, motor_outputs_or_reason
from mavdem.dataset.signals import Signals
from mavdem.ingest import read_log
from mavdem.ingest.dataflash.binary import read_binary
from mavdem.ingest.telemetry import Telemetry

STAMPS = 20 + 0.1 * np.arange(300)
PULSES = 1500 + np.arange(300) % 7


def vehicle_of(tmp_path, *pieces):
    path = tmp_path / "flight.bin"
    path.write_bytes(made.log(*pieces))
    return read_log(path).vehicles[0]


def functions(first):
    """Parameters of a quadrotor whose motors 1 to 4 are on neighbouring outputs."""
    return [
        made.message("PARM", 1_000_000, f"SERVO{first + n}_FUNCTION", 33.0 + n, 0.0)
        for n in range(4)
    ]


def steps(*names, event=None):
    """Steps of the loop with attitude, rates, and the four motors on the first outputs of each message of a name."""
    rows = []
    for stamp, pulse in zip(STAMPS, PULSES.tolist(), strict=True):
        rows.append(made.att(stamp, 2.0 + pulse % 5) + made.rate(stamp, 0.2 + pulse % 3))
        for name in names:
            motors = (pulse, pulse + 1, pulse + 2, pulse + 3)
            rows.append(made.message(name, round(1e6 * stamp), *motors))
        if event is not None and stamp == STAMPS[20]:
            rows.append(made.message("EV", round(1e6 * stamp), event))
    return rows


@pytest.mark.parametrize(("message", "first"), [("RCOU", 1), ("RCO2", 15), ("RCO3", 19)])
def test_motors_are_read_from_every_output_of_a_dataflash_log(tmp_path, message, first):
    """ArduPilot logs outputs 1 to 14, 15 to 18 and 19 to 32 in separate messages.

    The motors may be in any of them.
    """
    other = [] if message == "RCOU" else ["RCOU"]
    idle = [made.message("RCOU", round(1e6 * stamp)) for stamp in STAMPS] if other else []
    vehicle = vehicle_of(tmp_path, *functions(first), *idle, *steps(message))
    motors = motor_outputs_or_reason(vehicle)
    assert isinstance(motors, MotorOutputs)
    assert motors.geometry.channels == tuple(range(first, first + 4))
    assert_array_equal(motors.outputs[:, 0], PULSES)
    assert_array_equal(motors.outputs[:, 3], PULSES + 3)
    assert vehicle.source_names["SERVO_OUTPUT_RAW"] == message


def test_an_ardupilot_port_has_16_outputs_though_only_the_second_port_is_used():
    """Messages of two ports alternate, and the motors are the outputs 17 to 20, the first four of the second port."""
    count = len(PULSES)
    outputs = {f"servo{n}_raw": np.zeros(2 * count) for n in range(1, 17)}
    port = np.tile([0, 1], count)
    for n in range(4):
        outputs[f"servo{n + 1}_raw"][1::2] = PULSES + n
    stamps = {"time": np.repeat(STAMPS, 2), "boot": np.zeros(2 * count, np.int64)}
    parameters = {f"SERVO{17 + n}_FUNCTION": 33.0 + n for n in range(4)}
    telemetry = Telemetry(
        1,
        1,
        "QUADROTOR",
        "ARDUPILOTMEGA",
        {"SERVO_OUTPUT_RAW": {**stamps, "port": port, **outputs}},
        parameters,
    )
    motors = motor_outputs_or_reason(telemetry)
    assert isinstance(motors, MotorOutputs)
    assert motors.geometry.channels == (17, 18, 19, 20)
    assert_array_equal(motors.outputs[:, 1], PULSES + 1)


def test_two_messages_that_share_an_id_are_told_apart_by_their_length():
    """A second definition gives the id of RCO2 to another message, of another length."""
    name, characters, fields = b"LDET", b"QHI", b"TimeUS,Flags,Count"
    kind = made.MESSAGES["RCO2"][0]
    length = 3 + struct.calcsize("<QHI")
    other_format = struct.pack("<BB4s16s64s", kind, length, name, characters, fields)
    outputs = [made.message("RCO2", n, 1500, 1501, 1502, 1503) for n in range(5)]
    landings = [made.HEADER + bytes([kind]) + struct.pack("<QHI", n, 7, n) for n in range(3)]
    content = made.log(
        *outputs[:2], made.HEADER + b"\x80" + other_format, *landings, *outputs[2:], made.rate(1, 1)
    )
    recording = read_binary(content)
    assert recording.counts["RCO2"] == 5 and recording.counts["LDET"] == 3
    assert recording.bytes_skipped == 0
    assert_array_equal(recording.decode("LDET").columns["Count"], [0, 1, 2])
    assert_array_equal(recording.decode("RCO2").columns["C18"], [1503] * 5)


NOT_LANDED = 28


def test_a_vehicle_that_reports_to_fly_flies_though_its_outputs_are_missing(tmp_path):
    vehicle = vehicle_of(tmp_path, *steps(event=NOT_LANDED))
    flights = flight_states.airborne_intervals(Signals(vehicle), 0)
    assert flights == [(STAMPS[20], np.inf)]


def test_outputs_that_end_early_are_no_landing(tmp_path):
    idle = [made.rcou(20 + 0.1 * n, 1000 + n % 2, 1000) for n in range(10)]
    vehicle = vehicle_of(tmp_path, *functions(1), *idle, *steps(event=NOT_LANDED))
    assert flight_states.airborne_intervals(Signals(vehicle), 0)[-1][1] == np.inf
