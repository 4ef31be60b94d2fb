"""Log formats: the endings of file names and the first bytes of each kind of flight log that mavdem reads.

A new format is entered here, and its reader in ``mavdem.ingest.formats``. This module imports nothing heavy, since the
command line looks at the endings before it loads anything else.
"""

from dataclasses import dataclass
from enum import StrEnum

from mavdem.containers import Names


class Format(StrEnum):
    """What flight logs are written in."""

    ULOG = "ulog"
    """PX4's own logs."""
    DATAFLASH = "dataflash"
    """ArduPilot's own logs, binary or as text."""
    MCAP = "mcap"
    """MCAP recordings of MAVLink or of ROS 2 topics."""
    TLOG = "tlog"
    """Telemetry logs of ground stations: MAVLink frames with receive stamps."""


@dataclass(frozen=True)
class FormatSignature:
    """By what a file of one format is recognised."""

    first_bytes: bytes
    """Bytes at the beginning of every such file; empty where there are no fixed ones."""
    endings: Names
    """Endings of file names, in lower case, that other kinds of files do not have."""
    shared_endings: Names = ()
    """Endings that other kinds of files have too: such a file may be a log."""
    compressed_endings: Names = ()
    """Endings of the files under which compressed logs are usually shared."""


COMPRESSED_ENDING = ".xz"
"""Ending of an xz archive, behind the ending of the log in it."""

FORMAT_SIGNATURES = {
    Format.TLOG: FormatSignature(b"", (".tlog",)),
    Format.MCAP: FormatSignature(b"\x89MCAP0\r\n", (".mcap",)),
    Format.DATAFLASH: FormatSignature(b"\xa3\x95", (".bin",), shared_endings=(".log",)),
    Format.ULOG: FormatSignature(
        b"ULog\x01\x12\x35", (".ulg",), compressed_endings=(".ulg" + COMPRESSED_ENDING,)
    ),
}
"""Every format that is read.

Sources of the first bytes: https://mcap.dev/spec (magic), ArduPilot ``AP_Logger/LogStructure.h`` (HEAD_BYTE1 and
HEAD_BYTE2), https://docs.px4.io/main/en/dev_log/ulog_file_format.html (file header).
"""


ZIP_ENDING = ".zip"
"""Ending of a zip archive, in which logs are shared too."""

PX4_LOG_ENDING = ".px4log"
"""Ending of PX4's logs before ULog, which its module sdlog2 wrote."""

UNREAD_LOG_ENDINGS = (".ulge", PX4_LOG_ENDING)
"""Endings of logs that are recognised and not read, so that the refusal says what to do: the first are encrypted."""

ENCRYPTED_ULOG_MAGIC = b"ULogEnc"
"""First bytes of an encrypted ULog (https://docs.px4.io/main/en/dev_log/log_encryption)."""


def _uncompressed_endings() -> Names:
    """Lists the endings of all formats, in the order of ``FORMAT_SIGNATURES``."""
    endings: list[str] = []
    for signature in FORMAT_SIGNATURES.values():
        endings.extend(signature.endings)
        endings.extend(signature.shared_endings)
    return tuple(endings)


def _compressed_endings() -> Names:
    """Lists the usual endings of compressed logs."""
    endings: list[str] = []
    for signature in FORMAT_SIGNATURES.values():
        endings.extend(signature.compressed_endings)
    return tuple(endings)


UNCOMPRESSED_ENDINGS = _uncompressed_endings()
"""Endings of the names of logs, in lower case, without endings of archives."""

LOG_ENDINGS = UNCOMPRESSED_ENDINGS + _compressed_endings()
"""Endings of the names of files that are taken for logs where a folder is searched, in lower case."""

FORMAT_OF_ENDING = {
    ending: format_
    for format_, signature in FORMAT_SIGNATURES.items()
    for ending in signature.endings
}
"""Format by ending of the file name, of the endings that only logs have."""
