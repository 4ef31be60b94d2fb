"""The committed dialect is that of the installed pymavlink, message for message and entry for entry."""

import struct

from pymavlink.dialects.v20 import all as theirs
from pytest import mark

from mavdem.ingest.mavlink.dialect import (
    definitions_by_id,
    definitions_by_name,
    enum_entries,
    enum_name,
    mavlink_constant,
    mavlink_message_id,
)
from mavdem.ingest.mavlink.framing import (
    HEADER_BYTES_V1,
    HEADER_BYTES_V2,
    MARKER_V1,
    MARKER_V2,
    SIGNATURE_BYTES,
    SIGNED_FLAG,
)

STRUCT_LETTERS = {"f": "f", "i": "?bh?i???q", "u": "?BH?I???Q"}


def struct_format(wire):
    """The format by which pymavlink unpacks a payload of this type."""
    letters = "<"
    for name in wire.names:
        field = wire[name]
        if field.kind == "S":
            letters += f"{field.itemsize}s" if field.itemsize > 1 else "c"
        elif field.base.kind == "f":
            letters += (
                f"{field.shape[0] if field.shape else ''}{'d' if field.base.itemsize == 8 else 'f'}"
            )
        else:
            letter = STRUCT_LETTERS[field.base.kind][field.base.itemsize]
            letters += f"{field.shape[0] if field.shape else ''}{letter}"
    return letters


def test_messages_are_those_of_pymavlink():
    assert definitions_by_id().keys() == theirs.mavlink_map.keys()
    for message_id, message in theirs.mavlink_map.items():
        definition = definitions_by_id()[message_id]
        assert definitions_by_name()[message.msgname] is definition
        assert definition.crc_extra == message.crc_extra
        assert definition.fields == tuple(message.fieldnames)
        assert definition.payload_type.names == tuple(message.ordered_fieldnames)
        assert definition.payload_type.itemsize == message.unpacker.size
        mine, other = struct_format(definition.payload_type), message.unpacker.format
        # "4f" and "ffff" unpack the same; what they unpack of the same bytes tells.
        content = bytes(byte % 251 for byte in range(1, message.unpacker.size + 1))
        assert str(struct.unpack(mine, content)) == str(struct.unpack(other, content))


def test_enumerations_are_those_of_pymavlink():
    expected = {}
    for name, enum in theirs.enums.items():
        for number, entry in enum.items():
            if entry.name.endswith("_ENUM_END"):
                assert enum_name(name, number) == str(number)
                continue
            expected[entry.name] = number
            assert enum_name(name, number) == entry.name.removeprefix(f"{name}_")
    assert enum_entries() == expected
    assert mavlink_constant("MAV_TYPE_QUADROTOR") == theirs.MAV_TYPE_QUADROTOR
    assert mavlink_message_id("ATTITUDE") == theirs.MAVLINK_MSG_ID_ATTITUDE


@mark.parametrize(
    ("ours", "name"),
    [
        (MARKER_V1, "PROTOCOL_MARKER_V1"),
        (MARKER_V2, "PROTOCOL_MARKER_V2"),
        (HEADER_BYTES_V1, "HEADER_LEN_V1"),
        (HEADER_BYTES_V2, "HEADER_LEN_V2"),
        (SIGNATURE_BYTES, "MAVLINK_SIGNATURE_BLOCK_LEN"),
        (SIGNED_FLAG, "MAVLINK_IFLAG_SIGNED"),
    ],
)
def test_constants_of_frames_are_those_of_pymavlink(ours, name):
    assert ours == getattr(theirs, name)
