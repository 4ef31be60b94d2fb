"""Made-up DataFlash logs, byte by byte: FMT for each message, then messages."""

import struct

HEADER = b"\xa3\x95"
STRUCTS = {character: character for character in "QBbHhIifdq"} | {
    "c": "h",
    "C": "H",
    "e": "i",
    "E": "I",
    "L": "i",
    "M": "B",
    "n": "4s",
    "N": "16s",
    "Z": "64s",
    "a": "64s",
}

PULSES = "Q" + 14 * "H", "TimeUS," + ",".join(f"C{n}" for n in range(1, 15))
MESSAGES = {
    "PARM": (64, "QNff", "TimeUS,Name,Value,Default"),
    "MSG": (91, "QZ", "TimeUS,Message"),
    "ATT": (129, "QccccCCCCB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw,AEKF"),
    "RATE": (
        130,
        "Qfffffffffffff",
        "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut,ADes,A,AOut,AOutSlew",
    ),
    "RCOU": (131, *PULSES),
    "IMU": (132, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "EV": (133, "QB", "TimeUS,Id"),
    "ARM": (134, "QBIBB", "TimeUS,ArmState,ArmChecks,Forced,Method"),
    "DSF": (136, "QIHIIII", "TimeUS,Dp,Blk,Bytes,FMn,FMx,FAv"),
    "RCIN": (137, *PULSES),
    "CTUN": (135, "Qfhh", "TimeUS,ThI,DCRt,CRt"),
    "GPS": (140, "QBBIH", "TimeUS,I,Status,GMS,GWk"),
    "ERR": (141, "QBB", "TimeUS,Subsys,ECode"),
    "SIDS": (142, "QBf", "TimeUS,Ax,Mag"),
    "SIDD": (143, "Qff", "TimeUS,Time,Targ"),
    "PIDR": (146, "Qf", "TimeUS,D"),
    "PIDP": (147, "Qf", "TimeUS,D"),
    "PIDY": (148, "Qf", "TimeUS,D"),
    "RCO2": (149, "QHHHH", "TimeUS,C15,C16,C17,C18"),
    "RCO3": (150, "Q" + 14 * "H", "TimeUS," + ",".join(f"C{n}" for n in range(19, 33))),
    "POWR": (151, "QffHHB", "TimeUS,Vcc,VServo,Flags,AccFlags,Safety"),
    "BARO": (160, "QBff", "TimeUS,I,Alt,Press"),
}


def packed(characters):
    return "<" + "".join(STRUCTS[character] for character in characters)


def fmt(name, length=None, kind=None, characters=None):
    """FMT of one of ``MESSAGES``, true or with something else in it."""
    message_number, usual, fields = MESSAGES[name]
    length = 3 + struct.calcsize(packed(usual)) if length is None else length
    body = struct.pack(
        "<BB4s16s64s",
        message_number if kind is None else kind,
        length,
        name.encode(),
        (characters or usual).encode(),
        fields.encode(),
    )
    return HEADER + b"\x80" + body


def formats():
    message_number = struct.pack(
        "<BB4s16s64s", 0x80, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns"
    )
    return HEADER + b"\x80" + message_number + b"".join(fmt(name) for name in MESSAGES)


def message(name, *values, kind=None):
    """Returns a binary DataFlash message with values in the order of its fields. Fields without a value are zero."""
    message_number, characters, _ = MESSAGES[name]
    empty = [b"" if character in "nNZa" else 0 for character in characters]
    given = [value.encode() if isinstance(value, str) else value for value in values]
    body = struct.pack(packed(characters), *given, *empty[len(given) :])
    return HEADER + bytes([message_number if kind is None else kind]) + body


def att(time, roll, pitch=0.0, yaw=0.0):
    """Angles in degrees; the last field, the estimator, is 3."""
    centi = [round(100 * angle) for angle in (roll, pitch, yaw)]
    return message("ATT", round(1e6 * time), 0, centi[0], 0, centi[1], 0, centi[2], 0, 0, 3)


def rate(time, roll):
    """Roll rate in °/s; the last field is 1."""
    return message("RATE", round(1e6 * time), 0, roll, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0.5, 1.0)


def rcou(time, *pulses):
    """Pulses in µs; the last channel is 1500."""
    return message("RCOU", round(1e6 * time), *pulses, *[0] * (13 - len(pulses)), 1500)


def flight(times):
    """Attitude, rate and motors at each time: roll 2°, 4°, …, roll rate a tenth of that, motor 1 at 1500, 1501, …."""
    rows = enumerate(times)
    return [
        att(t, 2.0 + 2 * (i % 5)) + rate(t, 0.2 + 0.2 * (i % 5)) + rcou(t, 1500 + i % 5, 1600)
        for i, t in rows
    ]


def told():
    """What a log says at its beginning: firmware, frame, parameters."""
    return b"".join(
        [
            message("MSG", 1_000_000, "ArduCopter V4.5.7 (2a3dc4b7)"),
            message("MSG", 1_000_000, "Frame: QUAD/X"),
            message("PARM", 1_000_000, "SYSID_THISMAV", 7.0, 1.0),
            message("PARM", 1_000_000, "FRAME_CLASS", 1.0, 0.0),
        ]
    )


def log(*pieces):
    """A file of all formats, of the messages at its beginning, and of the pieces."""
    return b"".join([formats(), told(), *pieces])
