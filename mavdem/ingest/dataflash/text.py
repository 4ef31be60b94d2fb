"""DataFlash logs as text (.log), as ground stations write them: one message per line, name first.

Values are in their units; FMT lines define the others as in the binary log. A line that does not match its definition
is left out. pymavlink's reader of such text gives up at a line that is not UTF-8 or after a thousand lines that it does
not know, so it is not used.
"""

import re
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.facts.sources import Repair
from mavdem.ingest.dataflash.definitions import (
    FORMAT,
    TEXT_CHARACTERS,
    FormatDefinition,
    FormatFields,
    parse_definition,
)
from mavdem.ingest.dataflash.recording import EMPTY_TABLE, DataflashRecording, MessageTable
from mavdem.ingest.telemetry import repair_facts, selected_rows

_BYTE = re.compile(rb"\s*\d{1,3}\s*")
"""A number of one byte as text."""

NON_NUMERIC_CHARACTERS = TEXT_CHARACTERS + "aM"
"""Format characters of fields that are kept as texts: texts, arrays, and the names of flight modes."""


INTEGER_CHARACTERS = "bBhHiIqQ"
"""Format characters of fields that are integers in the text too; others are written in their unit, with a fraction."""

MAX_INTEGER = 2.0**63
"""Bound of the integers that are kept: an integer of 64 bits has a sign."""


class _Line(NamedTuple):
    """One line with a message."""

    number: int
    """Number of the line in the file, from 0."""
    values: bytes
    """What follows the name of the message and a comma."""


def read_text(content: bytes) -> DataflashRecording:
    """Finds the messages of a text log; the messages of a name are decoded on request.

    A line is a message if a line above it defines its name, and it has at least as many values as the definition.

    Args:
        content: The bytes of the file.

    Returns:
        The recording; positions of messages are numbers of lines. All other lines that are not blank are counted as
        skipped.
    """
    # The lines of messages, and the definition of a message, by its name.
    lines: dict[str, list[_Line]] = {}
    definitions: dict[str, FormatDefinition] = {}
    bytes_skipped = 0
    lines_skipped = 0
    for number, line in enumerate(content.split(b"\n")):
        name_bytes, _, values = line.partition(b",")
        name = name_bytes.decode("latin-1").strip()
        if name == FORMAT.name:
            definition = _definition_in_line(values)
            if definition is not None:
                # The line is itself a message, FMT, whose definition every log has. Of several definitions of one
                # name the first one counts.
                definitions.setdefault(FORMAT.name, FORMAT)
                definitions.setdefault(definition.name, definition)
        # The last value may be a text with commas, so that there may be more commas than between the fields.
        if name in definitions and values.count(b",") >= len(definitions[name].fields) - 1:
            lines.setdefault(name, []).append(_Line(number, values))
        elif line.strip():
            line_break_bytes = 1
            bytes_skipped += len(line) + line_break_bytes
            lines_skipped += 1

    def decode(name: str) -> MessageTable:
        """Decodes the messages of one name; none if the log has none."""
        if name not in lines:
            return EMPTY_TABLE
        return _message_table(definitions[name], lines[name])

    counts = {name: len(lines_of_name) for name, lines_of_name in lines.items()}
    repairs = repair_facts(Repair.LINES_LEFT_OUT, count=lines_skipped)
    return DataflashRecording(counts, decode, bytes_skipped, len(content), repairs)


def _definition_in_line(values: bytes) -> FormatDefinition | None:
    """Reads the definition of a message in an FMT line.

    Args:
        values: Text after "FMT,": id, length, name, format characters, and then the names of all fields.

    Returns:
        The definition; None if it is damaged.
    """
    # Four commas are before the names of the fields, which have commas between them too.
    definition_values = values.split(b",", 4)
    if len(definition_values) < 5:
        return None
    message_id, length, name, characters, field_names = definition_values
    if _BYTE.fullmatch(message_id) is None or _BYTE.fullmatch(length) is None:
        return None
    fields = FormatFields(int(message_id), int(length), name, characters, field_names)
    numbered_definition = parse_definition(fields)
    return None if numbered_definition is None else numbered_definition.definition


def _message_table(definition: FormatDefinition, lines: list[_Line]) -> MessageTable:
    """Decodes the lines of the messages of one name into columns.

    Args:
        definition: Definition of the message.
        lines: Its lines in the order of the file.

    Returns:
        The messages, whose positions are the numbers of their lines. Numbers are integers or floats; everything else is
        bytes in arrays of objects. Lines in which a numeric field contains no number, or an integer field a fraction,
        are left out and counted. There are no messages if the definition is inconsistent.
    """
    is_consistent = definition.body_type is not None
    if not is_consistent or not definition.fields:
        return EMPTY_TABLE
    is_numeric = [character not in NON_NUMERIC_CHARACTERS for character in definition.characters]
    line_numbers = []
    values_of_messages = []
    for line in lines:
        row = _values_of_line(line, definition, is_numeric)
        if row is not None:
            values_of_messages.append(row)
            line_numbers.append(line.number)
    # Whether each message has an integer in all its integer fields.
    is_valid = np.ones(len(values_of_messages), dtype=np.bool_)
    columns: dict[str, NDArray[Any]] = {}
    for index, name in enumerate(definition.fields):
        # Texts are kept as objects: an array of bytes would take the memory of the longest text for each.
        column_type = np.float64 if is_numeric[index] else np.object_
        column = np.array([values[index] for values in values_of_messages], dtype=column_type)
        if definition.characters[index] in INTEGER_CHARACTERS:
            is_integer = (column == np.trunc(column)) & (abs(column) < MAX_INTEGER)
            is_valid &= is_integer
            # Rows without an integer are left out below; until then they have the number 0.
            column = np.where(is_integer, column, 0.0).astype(np.int64)
        columns[name] = column
    valid_line_numbers = np.array(line_numbers, dtype=np.int64)[is_valid]
    unreadable_count = len(lines) - len(valid_line_numbers)
    return MessageTable(valid_line_numbers, selected_rows(columns, is_valid), unreadable_count)


def _values_of_line(
    line: _Line, definition: FormatDefinition, is_numeric: list[bool]
) -> list[float | bytes] | None:
    """Parses the values of a line whose numbers are written with decimal points ("0.5") or decimal commas ("0,5").

    Args:
        line: The line of one message.
        definition: Definition of the message.
        is_numeric: For each field, whether its values are numbers.

    Returns:
        Numbers and texts in the order of the fields; None if the line cannot be read in either way.
    """
    # The line is split at as many commas as there are between its fields: the last field may be a text with commas.
    texts = line.values.split(b",", len(is_numeric) - 1)
    values = _parsed_values(texts, is_numeric)
    if values is None:
        texts = _texts_with_decimal_points(line.values, definition)
        values = _parsed_values(texts, is_numeric)
    return values


def _parsed_values(texts: list[bytes], is_numeric: list[bool]) -> list[float | bytes] | None:
    """Parses the values of one line.

    Args:
        texts: The values as they are written in the file, one per field.
        is_numeric: For each field, whether its values are numbers.

    Returns:
        Numbers, and texts without the spaces around them; None if there are not as many values as fields, or a
        numeric field does not contain a number.
    """
    if len(texts) != len(is_numeric):
        return None
    values: list[float | bytes] = []
    try:
        for text, numeric in zip(texts, is_numeric, strict=True):
            values.append(float(text) if numeric else text.strip())
    except ValueError:
        return None
    return values


def _texts_with_decimal_points(values: bytes, definition: FormatDefinition) -> list[bytes]:
    """Splits a line of values with decimal commas, such as "1000, 0,5, -1,25", which some ground stations write.

    A space after a comma shows that it separates two values. Without spaces ("1000,0,5") the definition tells which
    values may have a decimal comma, and all of them must have one; otherwise it is unknown which of them do.

    Args:
        values: The values of the line.
        definition: Definition of the message.

    Returns:
        The values, with decimal points; an empty list if decimal commas cannot be distinguished from separators.
    """
    field_count = len(definition.fields)
    # The last field may be a text that contains ", " itself: the line is split into as many texts as there are fields.
    texts = values.strip().split(b", ", maxsplit=field_count - 1)
    if len(texts) != field_count:
        return _fields_of_pieces(values.split(b","), definition.characters)
    fields = []
    for text, character in zip(texts, definition.characters, strict=True):
        is_numeric = character not in NON_NUMERIC_CHARACTERS
        fields.append(text.replace(b",", b".") if is_numeric else text)
    return fields


def _fields_of_pieces(pieces: list[bytes], characters: str) -> list[bytes]:
    """Joins the pieces of a line that was split at all commas, also at the decimal commas of its numbers.

    A number with a fraction has two pieces, its integer part and its fraction; every other field has one.

    Args:
        pieces: The pieces between the commas ("1000", "0", "5").
        characters: Format character of each field, which says whether it can have a fraction.

    Returns:
        The text of each field, with decimal points ("1000", "0.5"); empty if there are not as many pieces as this
        needs, because some numbers were written without a fraction.
    """
    # Format characters of fields without a fraction: integers, texts and arrays.
    whole_characters = INTEGER_CHARACTERS + NON_NUMERIC_CHARACTERS
    piece_counts = [1 if character in whole_characters else 2 for character in characters]
    if len(pieces) != sum(piece_counts):
        return []
    fields = []
    next_piece = 0
    for piece_count in piece_counts:
        pieces_of_field = pieces[next_piece : next_piece + piece_count]
        if piece_count == 1:
            fields.append(pieces_of_field[0])
        else:
            integer_part, fraction = pieces_of_field
            fields.append(integer_part.strip() + b"." + fraction.strip())
        next_piece += piece_count
    return fields
