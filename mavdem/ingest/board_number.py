"""The number of an autopilot's board, which no other board has, in hexadecimal."""

from __future__ import annotations

import re
from collections.abc import Iterable

ARDUPILOT_TEXT = re.compile(r"^\S+ ([0-9A-F]{8}) ([0-9A-F]{8}) ([0-9A-F]{8})$")
"""What ArduPilot says at boot: the board's name, and the processor's number as three words of four bytes."""
SIMULATED_TEXT = re.compile(r"^.[0-9a-f]{31}$")
"""What its simulator says instead: the machine's number, with the vehicle's added to the first letter."""
SIMULATED_LETTERS = 17  # Letters of it that AUTOPILOT_VERSION has room for
WORD = 4  # Bytes of such a word, the last byte first
LEAST_BYTES = 6
"""Bytes of a number that are not zero: simulators number their vehicles in one or two."""


def in_texts(texts: Iterable[str]) -> str:
    """The number in what ArduPilot says at boot ("CUAVv5Nano 001A002F 30395113 33333539"); empty where it does not."""
    for text in texts:
        if found := ARDUPILOT_TEXT.match(text.strip()):
            return "".join(found.groups()).lower()
        if SIMULATED_TEXT.match(text.strip()):
            return text[:SIMULATED_LETTERS].encode().hex()
    return ""


def in_bytes(uid2: bytes, words: bool) -> str:
    """The number in AUTOPILOT_VERSION.uid2; with ``words``, as ArduPilot's text has it. Empty where there is none."""
    if sum(byte > 0 for byte in uid2) < LEAST_BYTES:
        return ""
    number = uid2.rstrip(b"\0")
    if not words or len(number) > 3 * WORD:
        return (number[:SIMULATED_LETTERS] if words else uid2).hex()
    number = uid2[: 3 * WORD]
    return b"".join(number[at : at + WORD][::-1] for at in range(0, len(number), WORD)).hex()
