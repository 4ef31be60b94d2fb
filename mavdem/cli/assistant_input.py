"""What an assistant sends to ``mavdem mcp``, without escapes that stand for no character.

The name of a file may have bytes that are no characters. Python and JavaScript write such a name in JSON with a lone
surrogate, such as ``\\ud800``, which the library of the protocol refuses to read: it drops the line, and the assistant
waits for an answer without end. With the character U+FFFD in its place, the answer is that there is no such file.
"""

import io
import re
from typing import BinaryIO, TextIO

JSON_ESCAPE = re.compile(
    rb"""(?x)
    \\u[dD][89abAB][0-9a-fA-F]{2} \\u[dD][c-fC-F][0-9a-fA-F]{2}  # a pair of surrogates, which is one character
    | (?P<lone> \\u[dD][89a-fA-F][0-9a-fA-F]{2})
    | \\.  # any other escape, such as a backslash
    """
)
"""An escape in a JSON text, of the first of three kinds that fits. An escaped backslash begins no surrogate."""


def without_lone_surrogates(text: bytes) -> bytes:
    r"""Replaces lone surrogates in a JSON text, which are no valid Unicode, by the replacement character U+FFFD.

    A character beyond U+FFFF is escaped as a pair of surrogates, such as ``\ud83d\ude00``. Half of a pair is lone.

    Args:
        text: the JSON text, in UTF-8.

    Returns:
        The text, in which all pairs are unchanged.
    """

    def replaced(escape: re.Match[bytes]) -> bytes:
        """Returns an escape as it is, or the replacement character for a lone surrogate."""
        is_lone_surrogate = escape["lone"] is not None
        return rb"\ufffd" if is_lone_surrogate else escape[0]

    return JSON_ESCAPE.sub(replaced, text)


class _CharacterInput(io.RawIOBase):
    """Binary input whose lines are JSON texts, without lone surrogates."""

    def __init__(self, source: BinaryIO) -> None:
        """Begins to read.

        Args:
            source: The input, at the beginning of a line.
        """
        self._source = source
        # The part of the latest line that was not read yet.
        self._unread = memoryview(b"")

    def readable(self) -> bool:
        """Returns that this is an input."""
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        """Reads as much of one line as there is room for, and waits for the line if it has not come.

        Args:
            buffer: Room for the bytes.

        Returns:
            Number of bytes that were read; 0 at the end of the input.
        """
        if not self._unread:
            line = self._source.readline()
            self._unread = memoryview(without_lone_surrogates(line))
        count = min(len(buffer), len(self._unread))
        buffer[:count] = self._unread[:count]
        self._unread = self._unread[count:]
        return count


def character_input(source: TextIO) -> TextIO:
    """Returns an input, such as standard input, whose lines are JSON texts, without lone surrogates."""
    return io.TextIOWrapper(io.BufferedReader(_CharacterInput(source.buffer)), encoding="utf-8")
