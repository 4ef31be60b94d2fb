"""A made-up hover for tests: a vehicle whose every signal is a known function of time, sampled as a stream would."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mavdem.assessment.condition import measure_condition
from mavdem.assessment.evidence import Evidence
from mavdem.dataset.learnability import learnability_of
from mavdem.ingest.telemetry import Log, Telemetry, selected_rows

MAV_TYPES = {
    "FIXED_WING": 1,
    "QUADROTOR": 2,
    "GCS": 6,
    "GROUND_ROVER": 10,
    "SUBMARINE": 12,
    "HEXAROTOR": 13,
    "OCTOROTOR": 14,
}
MAV_AUTOPILOTS = {"ARDUPILOTMEGA": 3, "INVALID": 8, "PX4": 12}
ARMED = 128
LEVEL = ("pitch", "pitchspeed", "yaw", "yawspeed")
X_QUAD = np.array([-1.0, 1.0, 1.0, -1.0])
"""Sign of the roll torque of motors 1 front right, 2 rear left, 3 front left, 4 rear right."""
X_QUAD_PARAMETERS = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 5)} | {
    "FRAME_CLASS": 1.0,
    "FRAME_TYPE": 1.0,
}


@dataclass(frozen=True)
class Hover:
    """Armed at 5 s, off the ground at 6, climbing 2 m/s until ``level``, sinking 0.5 m/s from ``sinking``, for 20 s."""

    hovering: float = 40.0
    sway: float = 0.05
    command: float = 20.0
    level: float = 11.0

    @property
    def sinking(self):
        return self.level + self.hovering

    @property
    def landed(self):
        return self.sinking + 20.0

    @property
    def end(self):
        return self.landed + 5.0

    def roll(self, t):
        return self.sway * (np.sin(2.1 * t) + 0.5 * np.sin(7.3 * t + 1.0))

    def roll_rate(self, t):
        return self.sway * (2.1 * np.cos(2.1 * t) + 0.5 * 7.3 * np.cos(7.3 * t + 1.0))

    def roll_command(self, t):
        """The (left − right)/4 combination of the motors, µs."""
        return self.command * np.sin(5.0 * t)

    def motors(self, t):
        """(N, 4) pulse widths, µs: 1000 on the ground, 1600 and the command in the air."""
        flying = (t >= 6.0) & (t < self.landed)
        return np.where(flying[:, None], 1600.0 + X_QUAD * self.roll_command(t)[:, None], 1000.0)

    def climb(self, t):
        rises = (t > 6.0) & (t < self.level)
        sinks = (t > self.sinking) & (t < self.landed)
        return 2.0 * rises - 0.5 * sinks

    def telemetry(
        self,
        attitude_time=100.0,
        motor_time=100.0,
        vehicle="QUADROTOR",
        autopilot="ARDUPILOTMEGA",
        parameters=None,
        without=(),
    ):
        """The stream: stamps of attitude and motors are given, or a rate in Hz."""
        at = self.stamps(attitude_time)
        mt = self.stamps(motor_time)
        beat = self.stamps(1.0)
        motors = np.pad(self.motors(mt), ((0, 0), (0, 4)))
        messages = {
            "ATTITUDE": columns(
                at, roll=self.roll(at), rollspeed=self.roll_rate(at), **dict.fromkeys(LEVEL, 0.0)
            ),
            "SERVO_OUTPUT_RAW": columns(
                mt, port=0.0, **{f"servo{n + 1}_raw": motors[:, n] for n in range(8)}
            ),
            "HEARTBEAT": columns(
                beat,
                type=MAV_TYPES[vehicle],
                autopilot=MAV_AUTOPILOTS[autopilot],
                base_mode=np.where((beat >= 5.0) & (beat < self.landed + 1.0), ARMED + 1, 1),
            ),
            "LOCAL_POSITION_NED": columns(self.stamps(10.0), vz=-self.climb(self.stamps(10.0))),
        }
        kept = {name: table for name, table in messages.items() if name not in without}
        return Telemetry(1, 1, vehicle, autopilot, kept, parameters or {}, "made-up.tlog")

    def stamps(self, rate_or_stamps):
        if isinstance(rate_or_stamps, float):
            return np.arange(round(self.end * rate_or_stamps)) / rate_or_stamps
        return rate_or_stamps


def columns(time, boot=0, **fields):
    """A message of these times, each field a column, or one value that every row has."""
    time = np.asarray(time)
    return {
        name: _column(values, len(time)) for name, values in {"boot": boot, **fields}.items()
    } | {"time": time}


def _column(values, rows):
    return np.asarray(values) if np.ndim(values) else np.full(rows, values)


def changed(telemetry, message, **fields):
    """The telemetry with other columns in one message, or with another message; a value alone is of every row."""
    table = {**telemetry.messages.get(message, {}), **fields}
    parameters = {name: _column(values, len(table["time"])) for name, values in table.items()}
    return replace(telemetry, messages={**telemetry.messages, message: parameters})


def asking(telemetry, time, ignored, rate, angle):
    """Returns telemetry with setpoints of the roll rate, rad/s, and angle, rad, (N,) each.

    The bits ``ignored`` say which of them do not count.
    """
    half_angle = 0 * time if angle is None else angle / 2
    quaternions = np.column_stack(
        [np.cos(half_angle), np.sin(half_angle), 0 * half_angle, 0 * half_angle]
    )
    rates = {"body_roll_rate": 0.0 if rate is None else rate}
    rates |= dict.fromkeys(("body_pitch_rate", "body_yaw_rate"), 0.0)
    target = columns(time, type_mask=ignored, q=quaternions, **rates)
    return changed(telemetry, "ATTITUDE_TARGET", **target)


def only(telemetry, wanted, *messages):
    """The telemetry with those messages, of the kinds that are named or of all, whose time is ``wanted``."""
    for message in messages or telemetry.messages:
        table = telemetry.messages[message]
        telemetry = changed(telemetry, message, **selected_rows(table, wanted(table["time"])))
    return telemetry


def pulses(telemetry):
    """(4, N) the outputs of motors 1 to 4."""
    return np.array([telemetry.messages["SERVO_OUTPUT_RAW"][f"servo{n}_raw"] for n in range(1, 5)])


def with_pulses(telemetry, outputs):
    """The telemetry with other outputs (k, N) of the motors from 1 on."""
    return changed(
        telemetry, "SERVO_OUTPUT_RAW", **{f"servo{n}_raw": row for n, row in enumerate(outputs, 1)}
    )


def with_demand(telemetry, rate=100.0, pace=1.0, group=0.0):
    """The telemetry with a controller's demand beside it: roll a sine of ``pace`` rad/s, pitch nothing."""
    time = np.arange(0.0, telemetry.messages["ATTITUDE"]["time"][-1], 1 / rate)
    controls = np.zeros((len(time), 8))
    controls[:, 0] = 0.1 * np.sin(pace * time)
    controls[:, 3] = 0.5
    return changed(
        telemetry,
        "ACTUATOR_CONTROL_TARGET",
        **columns(time, controls=controls, group_mlx=group),
    )


def disarmed(telemetry):
    """The telemetry of a vehicle that never armed."""
    beats = len(telemetry.messages["HEARTBEAT"]["time"])
    return changed(telemetry, "HEARTBEAT", base_mode=np.ones(beats, dtype=np.uint8))


def with_texts(telemetry, *texts, severity=()):
    """The telemetry with texts of the autopilot, one a second from 1 s on."""
    time = np.arange(1.0, len(texts) + 1)
    return changed(
        telemetry,
        "STATUSTEXT",
        **columns(time, text=np.array(texts), severity=np.array(severity or [6] * len(texts))),
    )


def px4_rotors(*rotors):
    """Returns PX4's parameters of rotors.

    Each has its position forward and right, and possibly its torque per thrust.
    """
    parameters = {
        f"CA_ROTOR{n}_{name}": value
        for n, rotor in enumerate(rotors)
        for name, value in zip(("PX", "PY", "KM"), rotor, strict=False)
    }
    return {"CA_ROTOR_COUNT": float(len(rotors)), **parameters}


def log_of(telemetry):
    """A log of that vehicle alone."""
    return Log(telemetry.source, (telemetry,), (), (), 0, 0, (0.0, 0.0))


class EvidenceOnDemand(Evidence):
    """Evidence that measures learnability and condition when they are used: many lights use one of them or none."""

    def __init__(self, log, signals, learnability=None, condition=None, **parameters):
        super().__init__(log, signals, learnability, condition, **parameters)
        # What is not given is measured by the property of its name, which an attribute would hide.
        if learnability is None:
            del self.__dict__["learnability"]
        if condition is None:
            del self.__dict__["condition"]

    @cached_property
    def learnability(self):
        return learnability_of(self.signals)

    @cached_property
    def condition(self):
        return measure_condition(self.signals)


def evidence_of(signals, **parameters):
    """Returns what a log of these signals alone shows; ``parameters`` are fields of the evidence that are known."""
    fields = {"log": log_of(signals.telemetry)} | parameters
    return EvidenceOnDemand(signals=signals, **fields)


def overtake(draw, kept):
    """Exchanges a twentieth of what is sent with what comes next."""
    for row in np.flatnonzero(draw.random(len(kept) - 1) < 0.05):
        kept[row : row + 2] = kept[row : row + 2][::-1]
