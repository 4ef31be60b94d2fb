"""DataFlash's messages in MAVLink's vocabulary.

Fields and units: https://ardupilot.org/copter/docs/logmessages.html, from ArduPilot's ``LogStructure.h`` files.
docs/formats.md#dataflash has the table of both vocabularies.

RATE has the rates that MAVLink's ATTITUDE sends, filtered and without the gyro bias that the estimator finds. IMU has
the bias still, and is used only where RATE was logged slower than both it and the angles, or not at all.

Rates and angles that were asked for are messages of ATTITUDE_TARGET of their own, in which the other is masked.
ArduCopter before 3.4 called RATE's columns otherwise for a time, and logged them in centidegrees/s, the demands as
-4500 to 4500, and AOut as 0 to 1000. Notes say where that was found.
"""

from contextlib import suppress
from datetime import UTC, datetime, timedelta

import numpy as np
from pymavlink.dialects.v20 import all as dialect

from mavdem.arrays import Array
from mavdem.confidence import MIN_SAMPLES_FOR_STATISTICS
from mavdem.containers import Names
from mavdem.facts import Facts
from mavdem.facts.sources import Repair
from mavdem.files import load_adjacent_toml
from mavdem.ingest.dataflash.binary import MessageTable
from mavdem.ingest.dataflash.states import states_of
from mavdem.ingest.telemetry import (
    MIN_PREFERRED_SHARE,
    Columns,
    Tables,
    concatenated_columns,
    interpolated,
    last_values,
    repair_facts,
    selected_rows,
    translated_fields,
)
from mavdem.ingest.vocabulary import (
    NO_SEVERITY,
    attitude_target,
    quaternion,
    wrapped_angle,
)


def having(tables: Tables, name: str, fields: Names) -> Columns:
    """Returns the messages of that name; empty where there are none, or one of the fields is not there."""
    columns = tables.get(name, {})
    return columns if columns.keys() >= {*fields} and count(columns) else {}


def instance(columns: Columns, field: str, number: float) -> Columns:
    """Returns those of one instance (sensor, core), empty without one; all where the messages have no instances."""
    if field not in columns:
        return columns
    rows = columns[field] == number
    return selected_rows(columns, rows) if rows.any() else {}


def count(columns: Columns) -> int:
    """Returns how many messages there are."""
    return len(columns.get("time", ()))


def values(columns: Columns, fields: Names) -> Array:
    """Returns the fields as columns (N, k); NaN where not finite."""
    values = np.column_stack([columns[field] for field in fields]).astype(np.float64)
    values[~np.isfinite(values)] = np.nan
    return values


def stamped(logged: Columns, fields: Columns) -> Columns:
    """Returns a message's ``fields`` at the logged stamps."""
    return {"time": logged["time"], "boot": logged["boot"], **fields}


_RENAMED = load_adjacent_toml(__file__, "translation.toml")
BATTERIES = ("BAT", "CURR")
LEVELS = ("VibeX", "VibeY", "VibeZ")
# As many have a counter of clips
MAX_IMUS = sum("clipping" in name for name in dialect.MAVLink_vibration_message.fieldnames)
GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC).timestamp()  # UNIX s at which GPS time began
WEEK = timedelta(weeks=1).total_seconds()
LEAP_SECONDS = 18  # GPS time is ahead of UTC, since 2017; a second or two less before


def battery(tables: Tables) -> tuple[Columns, str]:
    """Returns SYS_STATUS of the first battery, with the decimals the message cuts off, and the name of its message."""
    for name in BATTERIES:
        logged = having(tables, name, ("Volt",))
        if not logged:
            continue
        for field in ("Inst", "Instance", "I"):
            logged = instance(logged, field, 0) or logged
        volts = values(logged, ("Volt",))[:, 0]
        # No multirotor has more than 200 V, and a battery of one cell has more hundredths.
        hundredths = np.any(volts > 0) and np.nanmedian(volts[volts > 0]) > 200
        unit = 10.0 if hundredths else 1000.0
        columns = {"voltage_battery": volts * unit}
        if "Curr" in logged:
            columns["current_battery"] = values(logged, ("Curr",))[:, 0] * (unit / 10)
        return stamped(logged, columns), name
    return {}, BATTERIES[0]


def vibration(tables: Tables) -> Columns:
    """Returns VIBRATION: standard deviations of the first IMU's acceleration, m/s², and of all as ``levels`` (N, 3 k).

    IMUs that were logged a sample longer than others are cut.
    """
    logged = having(tables, "VIBE", LEVELS)
    if not logged:
        return {}
    numbers = range(MAX_IMUS if "IMU" in logged else 1)
    each = [sensor for number in numbers if (sensor := instance(logged, "IMU", number))]
    least = min(map(count, each))
    imus = [selected_rows(imu, np.arange(least)) for imu in each]
    clips = [np.zeros(least)] * MAX_IMUS
    if "Clip" in logged:
        clips[: len(imus)] = [imu["Clip"] for imu in imus]
    elif "Clip0" in logged:
        clips = [imus[0].get(f"Clip{number}", clips[number]) for number in range(MAX_IMUS)]
    levels = np.column_stack([values(imu, LEVELS) for imu in imus])
    axes = zip(("vibration_x", "vibration_y", "vibration_z"), levels.T, strict=False)
    by_imu = {f"clipping_{number}": column for number, column in enumerate(clips)}
    return stamped(imus[0], {**dict(axes), **by_imu, "levels": levels})


OLD_AXES = {"Rll": "R", "Pit": "P", "Yaw": "Y"}
OLD_NAMES = {
    "GPS": {"TimeMS": "GMS", "Week": "GWk", "T": "TimeMS"},
    "EKF4": {"SMX": "SM"},
    "RATE": {
        f"{old}{end}": f"{axis}{end}"
        for old, axis in OLD_AXES.items()
        for end in ("", "Des", "Out")
    },
}
"""GPS before ArduPilot 3.3, where TimeMS is of the week and T of the boot; of the first filter's three ratios of the
compass the first; RATE before ArduCopter 3.3 was released."""


def under_later_names(name: str, logged: MessageTable) -> MessageTable:
    """Returns messages of that name with the columns that later versions call otherwise under their later names."""
    old = OLD_NAMES.get(name, {})
    if not old.keys() <= logged.columns.keys():
        return logged
    return MessageTable(
        logged.place, {old.get(field, field): column for field, column in logged.columns.items()}
    )


def calendar_time(tables: Tables) -> Columns:
    """Returns SYSTEM_TIME, UTC by the receiver, where it has a fix."""
    logged = having(tables, "GPS", ("Status", "GMS", "GWk"))
    if not logged:
        return {}
    # 3D, by which it knows the time
    logged = selected_rows(logged, (logged["Status"] >= 3) & (logged["GWk"] > 0))
    week, milliseconds = values(logged, ("GWk", "GMS")).T
    seconds = GPS_EPOCH + WEEK * week + milliseconds / 1e3 - LEAP_SECONDS
    unix = np.rint(1e6 * np.where(np.isfinite(seconds), seconds, 0.0)).astype(np.uint64)
    return stamped(logged, {"time_unix_usec": unix})


def _fixes(tables: Tables) -> Columns:
    """GPS_RAW_INT of the first receiver; in 1e-7 degrees, as of the message, 0 where it has no fix."""
    fields = ("Status", "NSats", "HDop", "Lat", "Lng")
    logged = instance(having(tables, "GPS", fields), "I", 0)
    if not logged:
        return {}
    status, satellites, dilution, lat, lon = values(logged, fields).T
    scale = np.where(status >= 3, 1e7, 0.0)
    return stamped(
        logged,
        {
            "fix_type": status,
            "satellites_visible": satellites,
            "eph": 100 * dilution,
            "lat": scale * lat,
            "lon": scale * lon,
        },
    )


def _position(tables: Tables) -> tuple[str, Columns]:
    """LOCAL_POSITION_NED; with the first filter's, EKF1, the vertical speed of CTUN: its own is off by 0.3 m/s."""
    name, columns = _renamed(tables, "LOCAL_POSITION_NED")
    _, rising = _renamed(tables, "VFR_HUD")
    if not columns or not rising or name != "EKF1" or not rising["climb"].any():
        return name, columns
    climb = _onto(columns, rising, rising["climb"][:, None])[:, 0]
    return name, {**columns, "vz": -climb}


def _filter_status(tables: Tables) -> tuple[str, Columns]:
    """EKF_STATUS_REPORT; its flags are the first bits of the filter's own (AP_Nav_Common.h), and the glitch of GPS."""
    name, columns = _renamed(tables, "EKF_STATUS_REPORT")
    if "flags" not in columns:  # before ArduCopter 3.3 there was no status
        return name, columns
    own = columns["flags"].astype(np.int64)
    alike = own & (dialect.EKF_UNINITIALIZED - 1)
    glitching = np.where(own & OWN_GPS_GLITCH > 0, dialect.EKF_GPS_GLITCHING, 0)
    return name, {**columns, "flags": alike | glitching}


def texts_of(columns: Columns, field: str) -> list[str]:
    """Returns the texts of a field; empty ones where it has none."""
    return [
        value.split(b"\0", 1)[0].decode("utf-8", errors="replace")
        if isinstance(value, bytes)
        else ""
        for value in columns.get(field, ())
    ]


def _texts(tables: Tables) -> Columns:
    """STATUSTEXT of MSG, which has no severity."""
    logged = having(tables, "MSG", ("Message",))
    if not logged:
        return {}
    severity = np.full(count(logged), NO_SEVERITY, dtype=np.uint8)
    texts = np.array(texts_of(logged, "Message"), dtype=np.object_)
    return stamped(logged, {"severity": severity, "text": texts})


ANGLES = ("Roll", "Pitch", "Yaw")
GYROS = ("GyrX", "GyrY", "GyrZ")
ACCELEROMETERS = ("AccX", "AccY", "AccZ")
RATES = ("R", "P", "Y")
DEMANDS = ("ROut", "POut", "YOut")
DESIRED_RATES = ("RDes", "PDes", "YDes")
DESIRED_ANGLES = ("DesRoll", "DesPitch", "DesYaw")
OF_FLIGHT = ("ATT", "ANG", "RATE", "IMU", "RCOU", "CTUN", "XKF1", "XKF4", "NKF1", "EV", "ARM")
"""DataFlash's messages of the vehicle's motion, motors and state: a log without them is none of a flight."""
# Bit of the filter's own status, which below EKF_UNINITIALIZED is that of the message
OWN_GPS_GLITCH = 1 << 14
TUNING = "PIDR", "PIDP", "PIDY"
"""The rate controllers of roll, pitch and yaw."""
NEEDED = (
    *TUNING,
    *OF_FLIGHT,
    *BATTERIES,
    "VIBE",
    "MAG",
    "GPS",
    "POWR",
    "XKF2",
    "NKF2",
    "NKF4",
    "EKF1",
    "EKF4",
    "MODE",
    "ERR",
    "MSG",
    "PARM",
    "SIDD",
    "SIDS",
    "ESC",
    "GYR",
    "ACC",
    "ISBH",
    "ISBD",
)  # DataFlash's messages that are translated
CENTIDEGREES = (15.0, 400.0)
"""RATE, taken for degrees/s, over the gyro: the range in which it is in centidegrees/s. RATE may be filtered where the
gyro is not, so that it is less than 100 times as much."""
# rad/s of the gyro from which a sample counts
MOVING_RATE = 0.1
MAX_DEMAND = 2.0  # Demands of the range -1 to 1 lie below it, but for damaged ones
# Full demand and full thrust where they are not 1
OLD_DEMAND = 4500.0
OLD_THRUST = 1000.0


def translated(tables: Tables, kind: int) -> tuple[dict[str, Columns], dict[str, str], Facts]:
    """Returns MAVLink's messages with data in DataFlash's ``tables``, what the log calls each, and notes on oddities.

    ``kind`` is the vehicle's MAV_TYPE, for HEARTBEAT.
    """
    notes = _in_centidegrees(tables)
    per_degree = 100.0 if notes else 1.0
    attitude, named = _attitude(tables, per_degree)
    demands, scaled = _demands(tables)
    targets, asked = _targets(tables, per_degree)
    volts, measured = battery(tables)
    armed, landed = states_of(tables, kind)
    named_columns = {
        "ATTITUDE": (named, attitude),
        "SERVO_OUTPUT_RAW": ("RCOU", _servos(tables)),
        "ACTUATOR_CONTROL_TARGET": ("RATE", demands),
        "ATTITUDE_TARGET": (asked, targets),
        "PID_TUNING": ("RATE", _tuning(tables, attitude, per_degree)),
        "D_TERM": ("PIDR/PIDP/PIDY", _derivative_terms(tables)),
        "SYS_STATUS": (measured, volts),
        "VIBRATION": ("VIBE", vibration(tables)),
        "SYSTEM_TIME": ("GPS", calendar_time(tables)),
        "GPS_RAW_INT": ("GPS", _fixes(tables)),
        "STATUSTEXT": ("MSG", _texts(tables)),
        "ERR": ("ERR", having(tables, "ERR", ("Subsys", "ECode"))),
        "PARAM_VALUE": ("PARM", _parameters_set(tables)),
        "EV": ("EV", having(tables, "EV", ("Id",))),
        "ESC": ("ESC", having(tables, "ESC", ("RPM",))),
        "SIDD": ("SIDD", _injected(tables)),
        **{message: _renamed(tables, message) for message in _RENAMED},
        "LOCAL_POSITION_NED": _position(tables),
        "EKF_STATUS_REPORT": _filter_status(tables),
        "HEARTBEAT": ("EV", armed),
        "EXTENDED_SYS_STATE": ("EV", landed),
    }
    there = {name: made for name, (_, made) in named_columns.items() if count(made)}
    return there, {name: own for name, (own, _) in named_columns.items() if own}, (*notes, *scaled)


def _attitude(tables: Tables, per_degree: float) -> tuple[Columns, str]:
    """At the stamps of the slower of angles and rates; with the name of that message."""
    named = _faster_angles(tables, ANGLES)
    angles = having(tables, named, ANGLES)
    gyros = instance(having(tables, "IMU", GYROS), "I", 0)
    rates = having(tables, "RATE", RATES)
    if not angles or not (rates or gyros):
        return {}, named
    if count(rates) < MIN_PREFERRED_SHARE * count(angles) and count(rates) < count(gyros):
        rates = gyros
        speeds = values(gyros, GYROS)
        source = "IMU"
    else:
        speeds = np.radians(values(rates, RATES)) / per_degree
        source = "RATE"
    base, named = (
        (rates, source) if count(rates) < MIN_PREFERRED_SHARE * count(angles) else (angles, named)
    )
    angles_rad = _onto(base, angles, np.radians(values(angles, ANGLES)), turning=True)
    speeds = _onto(base, rates, speeds)
    # To one turn about zero, as MAVLink has it.
    angles_rad = np.where(abs(angles_rad) > np.pi, wrapped_angle(angles_rad), angles_rad)
    fields = ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed")
    turned = dict(zip(fields, np.hstack([angles_rad, speeds]).T, strict=True))
    return stamped(base, turned), named


def _faster_angles(tables: Tables, fields: Names) -> str:
    return max(("ATT", "ANG"), key=lambda name: count(having(tables, name, fields)))


def _in_centidegrees(tables: Tables) -> Facts:
    """Why RATE is in centidegrees/s, by the gyro where that turns; or empty."""
    rates = having(tables, "RATE", RATES)
    gyros = instance(having(tables, "IMU", GYROS), "I", 0)
    if not rates or not gyros:
        return ()
    turning = np.linalg.norm(_onto(rates, gyros, values(gyros, GYROS)), axis=1)
    moving = turning > MOVING_RATE
    if np.count_nonzero(moving) < MIN_SAMPLES_FOR_STATISTICS:
        return ()
    speeds = np.linalg.norm(np.radians(values(rates, RATES)[moving]), axis=1)
    ratio = np.median(speeds / turning[moving])
    low, high = CENTIDEGREES
    return repair_facts(Repair.CENTIDEGREES_CONVERTED, ratio=ratio) if low < ratio < high else ()


def _servos(tables: Tables) -> Columns:
    logged = tables.get("RCOU", {})
    pulses = {
        n: logged[name]
        for n in range(1, 17)
        for name in (f"C{n}", f"Ch{n}", f"Chan{n}")
        if name in logged
    }
    if not pulses:
        return {}
    none = np.zeros(count(logged))
    outputs = {"port": none.astype(np.uint8)}
    for n in range(1, 17):
        pulse = np.nan_to_num(pulses.get(n, none).astype(np.float64))
        outputs[f"servo{n}_raw"] = np.clip(pulse, 0, np.iinfo(np.uint16).max).astype(np.uint16)
    return stamped(logged, outputs)


def _targets(tables: Tables, per_degree: float) -> tuple[Columns, str]:
    """With the names of its messages."""
    parts = []
    names = []
    named = _faster_angles(tables, DESIRED_ANGLES)
    if rates := having(tables, "RATE", DESIRED_RATES):
        asked = np.radians(values(rates, DESIRED_RATES)) / per_degree
        parts.append(stamped(rates, attitude_target(asked)))
        names.append("RATE")
    if angles := having(tables, named, DESIRED_ANGLES):
        q = quaternion(*np.radians(values(angles, DESIRED_ANGLES)).T)
        parts.append(stamped(angles, attitude_target(q)))
        names.append(named)
    if not parts:
        return {}, "RATE"
    together = concatenated_columns(parts)
    return selected_rows(together, np.lexsort((together["time"], together["boot"]))), " and ".join(
        names
    )


def _tuning(tables: Tables, attitude: Columns, per_degree: float) -> Columns:
    """PID_TUNING, three messages a row of RATE, where that comes faster than the attitude, in degrees/s."""
    logged = having(tables, "RATE", (*DESIRED_RATES, *RATES))
    if count(attitude) >= MIN_PREFERRED_SHARE * count(logged):
        return {}
    none = np.zeros(count(logged), np.uint8)
    parts = []
    for axis, (desired, achieved) in enumerate(zip(DESIRED_RATES, RATES, strict=True), 1):
        rates = values(logged, (desired, achieved)) / per_degree
        fields = {"axis": none + np.uint8(axis), "desired": rates[:, 0], "achieved": rates[:, 1]}
        parts.append(stamped(logged, fields))
    return concatenated_columns(parts)


def _derivative_terms(tables: Tables) -> Columns:
    """D_TERM, what the rate controllers of roll, pitch and yaw make of the gyro's slope; empty without all three."""
    logged = [having(tables, name, ("D",)) for name in TUNING]
    rows = min(map(count, logged))
    if not rows:
        return {}
    terms = {name: message["D"][:rows] for name, message in zip("xyz", logged, strict=True)}
    return stamped(selected_rows(logged[0], slice(rows)), terms)


def _parameters_set(tables: Tables) -> Columns:
    """PARAM_VALUE, when the logger began and when one was set."""
    logged = having(tables, "PARM", ("Name", "Value"))
    if not logged:
        return {}
    value = logged["Value"].astype(np.float32)
    return stamped(logged, {"param_id": logged["Name"], "param_value": value})


def _injected(tables: Tables) -> Columns:
    """SIDD, the signal of the system identification mode, with the axis of its run, SID_AXIS, which SIDS has."""
    runs = having(tables, "SIDS", ("Ax",))
    logged = having(tables, "SIDD", ("Targ",))
    if not runs or not logged:
        return {}
    axis = last_values(_across_boots(logged), _across_boots(runs), runs["Ax"])
    return stamped(logged, {"axis": axis, "target": logged["Targ"]})


def _demands(tables: Tables) -> tuple[Columns, Facts]:
    """The demands, −1 to 1, and thrust, 0 to 1 (NaN where RATE has none); and a repair where they were scaled."""
    logged = having(tables, "RATE", DEMANDS)
    if not logged:
        return {}, ()
    controls = np.pad(values(logged, DEMANDS), ((0, 0), (0, 8 - len(DEMANDS))))
    controls[:, 3] = logged.get("AOut", np.nan)
    notes: Facts = ()
    demanded = abs(controls[:, :3])
    demanded = demanded[demanded > 0]
    if len(demanded) and np.percentile(demanded, 75) > MAX_DEMAND:
        controls[:, :3] /= OLD_DEMAND
        controls[:, 3] /= OLD_THRUST
        notes = repair_facts(Repair.DEMANDS_SCALED, divisor=OLD_DEMAND)
    group = np.zeros(len(controls), dtype=np.uint8)
    return stamped(logged, {"group_mlx": group, "controls": controls}), notes


def _renamed(tables: Tables, message: str) -> tuple[str, Columns]:
    """A message of ``translation.toml`` with the name of its own; of the filter's states, of the primary core.

    The name is "XKF1[0]" where other cores were logged, but not the primary one, 0.
    """
    chosen = tables.get("XKF4", {}).get("PI", np.zeros(0))
    cores, times = np.unique(chosen[chosen >= 0], return_counts=True)
    primary = int(cores[times.argmax()]) if len(cores) else 0
    rule = _RENAMED[message]
    for name in rule["messages"]:
        core = primary if name.startswith("XKF") else 0
        logged = instance(tables.get(name, {}), "C", core)
        with suppress(KeyError):
            if count(logged):
                return name, stamped(
                    logged, translated_fields(logged, rule["fields"], rule.get("optional_fields"))
                )
    first = rule["messages"][0]
    if first in tables and not instance(tables[first], "C", primary):
        first += f"[{primary}]"
    return first, {}


def _onto(base: Columns, source: Columns, values: Array, turning: bool = False) -> Array:
    """Columns of ``values`` (N, k), of ``source``, at the stamps of ``base``; NaN before, after and inside gaps.

    Linear between the neighbours, across a full turn where ``turning``; exact at a stamp that both have.
    """
    if base is source:
        return values
    finite = np.isfinite(values).all(axis=1)
    time, first = np.unique(_across_boots(source)[finite], return_index=True)
    at = _across_boots(base)
    if len(time) < 2:
        return np.full((len(at), values.shape[1]), np.nan)
    defined = values[finite][first]
    if turning:
        defined = np.unwrap(defined, axis=0)
    steps = np.diff(time)
    before = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(steps) - 1)
    # a longer step is a gap
    is_gap = (
        (steps > 3 * np.median(steps))[before] & (at != time[before]) & (at != time[before + 1])
    )
    is_sure = ~is_gap & (at >= time[0]) & (at <= time[-1])
    return np.where(is_sure[:, None], interpolated(at, time, defined), np.nan)


def _across_boots(columns: Columns) -> Array:
    """Stamps (N,) on a clock of all boots: no boot is as long as what lies between two."""
    return columns["time"] + 1e9 * columns["boot"]
