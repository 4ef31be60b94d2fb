"""ULog files to read, built byte by byte as https://docs.px4.io/main/en/dev_log/ulog_file_format.html lays them out."""

import struct

import numpy as np

from mavdem.ingest import read_log

REAL = ["logs/pyulog_sample.ulg", "logs/pyulog_appended_multiple.ulg"]
TIMES = 20 + 0.01 * np.arange(300)
"""A short flight."""
HEADER = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000)
SYNC = struct.pack("<HB", 8, ord("S")) + bytes.fromhex("2F731320250CBB12")
FORMATS = {
    "vehicle_attitude": "uint64_t timestamp;uint64_t timestamp_sample;float[4] q;uint8_t reset;uint8_t[7] _padding0;",
    "vehicle_angular_velocity": "uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz;",
    "actuator_motors": "uint64_t timestamp;uint64_t timestamp_sample;float[12] control;",
    "actuator_outputs": "uint64_t timestamp;uint32_t noutputs;float[16] output;uint8_t[4] _padding0;",
    "actuator_controls_0": "uint64_t timestamp;float[8] control;",
    "vehicle_torque_setpoint": "uint64_t timestamp;float[3] xyz;",
    "vehicle_thrust_setpoint": "uint64_t timestamp;float[3] xyz;",
    "vehicle_status": "uint64_t timestamp;uint8_t arming_state;uint8_t system_type;uint8_t vehicle_type;",
    "vehicle_land_detected": "uint64_t timestamp;bool landed;",
    "vehicle_control_mode": "uint64_t timestamp;bool flag_control_auto_enabled;",
    "position_setpoint": "uint64_t timestamp;double lat;bool valid;uint8_t type;",
    "position_setpoint_triplet": "uint64_t timestamp;position_setpoint previous;position_setpoint current;",
    "vehicle_local_position": "uint64_t timestamp;float x;float y;float z;float vx;float vy;float vz;bool v_z_valid;",
    "vehicle_attitude_setpoint": "uint64_t timestamp;float yaw_sp_move_rate;float[4] q_d;bool q_d_valid;",
    "vehicle_rates_setpoint": "uint64_t timestamp;float roll;float pitch;float yaw;",
    "autotune_attitude_control_status": "uint64_t timestamp;float[3] rate_sp;",
    "battery_status": "uint64_t timestamp;float voltage_v;float voltage_filtered_v;",
    "vehicle_air_data": "uint64_t timestamp;float baro_alt_meter;float baro_pressure_pa;",
    "manual_control_setpoint": "uint64_t timestamp;bool valid;float throttle;",
    "cpuload": "uint64_t timestamp;float load;",
}
"""As PX4 defines them, shortened."""
CODES = {"uint64_t": "Q", "uint32_t": "I", "uint8_t": "B", "float": "f", "double": "d", "bool": "?"}


def layout(name):
    """What the logger writes of a topic: no padding at the end."""
    codes = ""
    for kind, field in (field.split(" ") for field in FORMATS[name].split(";")[:-1]):
        base, _, count = kind.partition("[")
        if not field.startswith("_padding"):
            codes += int(count[:-1] or 1) * (CODES[base] if base in CODES else layout(base))
    return codes


NUMBERS = {name: number for number, name in enumerate(FORMATS) if name != "position_setpoint"}
OFF = [float("nan")] * 8
"""Controls of the motors that a quadrotor does not have."""


def message(kind, content):
    """Any message."""
    return struct.pack("<HB", len(content), ord(kind)) + content


def definitions(*more):
    """The formats of ``FORMATS``, and more of them."""
    texts = [f"{name}:{fields}" for name, fields in FORMATS.items()]
    return b"".join(message("F", text.encode()) for text in [*texts, *more])


def parameter(name, value, kind="int32_t"):
    """A parameter, initial or changed by where it stands."""
    key = f"{kind} {name}".encode()
    return message(
        "P", bytes([len(key)]) + key + struct.pack("<f" if kind == "float" else "<i", value)
    )


def subscription(name, instance=0, number=None):
    """The subscription to one instance of a topic; its number is that of ``NUMBERS`` and its instance times 100."""
    number = NUMBERS[name] + 100 * instance if number is None else number
    return message("A", struct.pack("<BH", instance, number) + name.encode())


def data(name, seconds, *values, instance=0, number=None):
    """Returns a data message of a topic at a time, s.

    Topics with a ``timestamp_sample`` have it 1 ms before their stamp.
    """
    number = NUMBERS[name] + 100 * instance if number is None else number
    stamp = round(seconds * 1e6)
    sample = (stamp - 1000,) if "timestamp_sample" in FORMATS[name] else ()
    return message(
        "D", struct.pack("<H", number) + struct.pack("<" + layout(name), stamp, *sample, *values)
    )


def subscriptions(*names):
    """Of the topics named, or of all."""
    return b"".join(subscription(name) for name in names or NUMBERS)


def log(*pieces, first=b"", parameters=b""):
    """A file of all formats and subscriptions, and then the pieces; ``first`` before all, ``parameters`` between."""
    return b"".join([HEADER, first, definitions(), parameters, subscriptions(), *pieces])


def roll(time):
    """A motion: angle, rad, and its derivative, rad/s."""
    size = np.array([0.1, 0.05, 0.01])
    hertz = np.array([0.7, 1.9, 4.3])
    turning = 2 * np.pi * hertz
    phase = np.multiply.outer(time, turning) + hertz
    return np.sin(phase) @ size, np.cos(phase) @ (size * turning)


def flight(times):
    """Returns the messages of a hover.

    Attitude, rates, motors and torque at each time, s, and sometimes the status.
    """
    pieces = []
    for row, (time, angle, rate) in enumerate(np.column_stack([times, *roll(times)]).tolist()):
        motors = [0.5 - angle, 0.5 + angle, 0.5 + angle, 0.5 - angle, *OFF]
        pieces += [
            data("vehicle_angular_velocity", time, rate, 0.0, 0.0),
            data("vehicle_attitude", time, np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0, 0),
            data("vehicle_torque_setpoint", time, angle, 0.0, 0.0),
            data("actuator_motors", time, *motors),
            data("cpuload", time, 0.5),
        ]
        if row % 50 == 0:
            pieces += [data("vehicle_status", time, 2, 2, 1), SYNC]
    return pieces


def vehicle_of(content, folder):
    """The vehicle that is read of a file of that content."""
    path = folder / "flight.ulg"
    path.write_bytes(content)
    (vehicle,) = read_log(path).vehicles
    return vehicle


def vehicle_in(folder, *pieces, **more):
    """The vehicle that is read of a file of the :func:`log` of these."""
    return vehicle_of(log(*pieces, **more), folder)
