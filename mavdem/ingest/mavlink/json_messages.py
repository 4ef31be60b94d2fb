"""MAVLink messages in JSON as payloads of the dialect.

There are two layouts: the fields at top level, or BlueOS's ``{"header": {"system_id", "component_id", "sequence",
"message_id"}, "message": {"type": "ATTITUDE", ...fields}}``. There a field that is itself called ``type`` is
``mavtype``, an enum's value is ``{"type": "MAV_TYPE_QUADROTOR"}``, a bitmask ``{"bits": 81}`` or ``"A | B"``, and a
text is an array of its characters. Numbers are those of JSON5, with NaN and Infinity; plain JSON has null for NaN.
Source: the JSON of rust-mavlink (https://github.com/mavlink/rust-mavlink, ``serde`` feature), which BlueOS records.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Mapping, Sequence
from functools import cache, lru_cache
from math import nan
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

from mavdem.ingest.mavlink.definitions import MessageDefinition, definitions

NOT_SENT = object()  # Value of a field that the JSON lacks
NO_SEQUENCE = -1

# Texts may contain control characters.
_PARSER = json.JSONDecoder(strict=False)


class Written(NamedTuple):
    """A message in JSON; ``sequence`` is ``NO_SEQUENCE`` and ``system`` to ``name`` None where it lacks them."""

    fields: dict[str, Any]
    sequence: int = NO_SEQUENCE
    system: int | None = None
    component: int | None = None
    message_id: int | None = None
    name: str | None = None


def parse(body: bytes) -> Written | None:
    """The message in one body, of either layout; None without one."""
    document = _document(body)
    if not isinstance(document, dict):
        return None
    message = document.get("message")
    if not isinstance(message, dict):
        return Written(document)
    header = document.get("header")
    header = header if isinstance(header, dict) else {}
    sequence = _within(header.get("sequence"), 255)
    name = message.pop("type", None)
    if "mavtype" in message:
        message["type"] = message["mavtype"]
    return Written(
        message,
        NO_SEQUENCE if sequence is None else sequence,
        _within(header.get("system_id"), 255),
        _within(header.get("component_id"), 255),
        _within(header.get("message_id"), 0xFFFFFF),
        name if isinstance(name, str) else None,
    )


def payloads(
    messages: Sequence[Mapping[str, Any]], definition: MessageDefinition
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Payloads (N,) of ``definition.wire``, and (N,) whether each message is valid: all values have the right type.

    A missing field is zero where it is an extension or an integer, as on the wire, and else NaN. A parameter of
    value NaN becomes a float.
    """
    made = np.zeros(len(messages), dtype=definition.wire)
    good = np.array([not message.keys().isdisjoint(definition.fields) for message in messages], dtype=np.bool_)
    for name in definition.fields:
        kind = definition.wire[name]
        absent = nan if kind.base.kind == "f" and name not in _extensions(definition.message_id) else 0
        values = [message.get(name, NOT_SENT) for message in messages]
        if kind.kind == "S":
            made[name], fits = _texts(values, kind.itemsize)
        elif kind.subdtype is None:
            made[name], fits = _numbers(values, kind, absent)
        else:
            made[name], fits = _arrays(values, kind, absent)
        good &= fits
    if definition.name == "PARAM_VALUE":
        # PX4 sends an integer as the bits of a float. JSON has one NaN only, so the bits are lost.
        made["param_type"][np.isnan(made["param_value"])] = dialect.MAV_PARAM_TYPE_REAL32
    return made, good


@lru_cache(maxsize=1 << 12)
def definition_named(name: str) -> MessageDefinition | None:
    """The dialect's definition of a message; None without one of that name."""
    return next((definition for definition in definitions().values() if definition.name == name), None)


def _document(body: bytes) -> Any:
    try:
        return _PARSER.decode(body.decode("utf-8", errors="replace"))
    except (ValueError, RecursionError):
        # Rust prints an infinity so, instead of JSON5's Infinity.
        repaired = re.sub(rb"(?<=[:,\[])\s*(-?)inf(?=\s*[,\]}])", rb"\1Infinity", body)
        return None if repaired == body else _document(repaired)


def _within(value: Any, most: int) -> int | None:
    return value if type(value) is int and 0 <= value <= most else None


@cache
def _extensions(message_id: int) -> frozenset[str]:
    """The extension fields: those pymavlink lets a caller leave out."""
    taken = inspect.signature(dialect.mavlink_map[message_id].__init__).parameters.values()
    return frozenset(argument.name for argument in taken if argument.default is not inspect.Parameter.empty)


@cache
def _enum_values() -> Mapping[str, int]:
    """The value of each enum entry of the dialect by its name."""
    return {entry.name: value for enum in dialect.enums.values() for value, entry in enum.items()}


def _numbers(values: list[Any], kind: np.dtype[Any], absent: float) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    types = set(map(type, values))
    if kind.kind == "f" and types <= {float, int}:
        try:
            return _as_floats(np.array(values, dtype=np.float64), kind)
        except OverflowError:
            pass
    limits = np.iinfo(kind) if kind.kind in "iu" else None
    if limits is not None and types == {int} and limits.min <= min(values) and max(values) <= limits.max:
        return np.array(values, dtype=kind), np.ones(len(values), dtype=np.bool_)
    numbers = [absent if value is NOT_SENT else _number(value) for value in values]
    if limits is None:
        fits = np.array([number is not None for number in numbers], dtype=np.bool_)
        floats, finite = _as_floats(np.array([number or 0.0 for number in numbers], dtype=np.float64), kind)
        return floats, fits & finite
    whole = [number is not None and number == number // 1 and limits.min <= number <= limits.max for number in numbers]
    kept = [int(number) if fit and number is not None else 0 for number, fit in zip(numbers, whole, strict=True)]
    return np.array(kept, dtype=kind), np.array(whole, dtype=np.bool_)


def _as_floats(values: NDArray[np.float64], kind: np.dtype[Any]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """The values in the width of the wire, and whether they fit."""
    with np.errstate(over="ignore", invalid="ignore"):
        narrow = values.astype(kind)
    return narrow, np.isfinite(values) <= np.isfinite(narrow)


def _number(value: Any) -> float | None:
    """A value as a number: itself, an entry of an enum, or a bitmask; None for anything else."""
    if isinstance(value, dict):
        value = value.get("type", value.get("bits"))
        if isinstance(value, dict):
            return None
    if value is None:
        return nan
    if isinstance(value, str):
        bits = _flags(value)
        try:  # in quotes, as NaN is in JSON without JSON5
            return float(value) if bits is None else bits
        except ValueError:
            return None
    if isinstance(value, int):
        # A 64-bit field holds more digits than a float; no field holds more than 64 bits.
        return value if value.bit_length() <= 64 else None
    return value if isinstance(value, float) else None


@lru_cache(maxsize=1 << 12)
def _flags(text: str) -> int | None:
    """The bits of names joined with |, or the value of a single name; names may also be numbers."""
    bits = 0
    for name in filter(None, map(str.strip, text.split("|"))):
        try:
            bits |= _enum_values()[name] if name in _enum_values() else int(name, 0)
        except ValueError:
            return None
    return bits if bits.bit_length() <= 64 else None


def _arrays(values: list[Any], kind: np.dtype[Any], absent: float) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    (size,) = kind.shape
    fits = np.array([value is NOT_SENT or (isinstance(value, list) and len(value) <= size) for value in values])
    flat: list[Any] = []
    for value, fit in zip(values, fits.tolist(), strict=True):
        items = value if fit and value is not NOT_SENT else []
        flat += items
        flat += [NOT_SENT] * (size - len(items))
    numbers, each = _numbers(flat, kind.base, absent)
    return numbers.reshape(-1, size), fits & each.reshape(-1, size).all(axis=1)


def _texts(values: list[Any], size: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    texts = [_text(value) for value in values]
    fits = np.array([text is not None and len(text.rstrip(b"\0")) <= size for text in texts])
    return np.array([text[:size] if text is not None else b"" for text in texts], dtype=f"S{size}"), fits


def _text(value: Any) -> bytes | None:
    """A text's bytes; in JSON it is a string, or an array of its characters or of their codes."""
    if value is NOT_SENT or value is None:
        return b""
    if isinstance(value, str):
        return value.encode("utf-8", errors="replace")
    codes = value if isinstance(value, list) else [value]
    try:
        # A character of an array is one byte.
        return bytes(ord(code) if isinstance(code, str) else code for code in codes)
    except (TypeError, ValueError, OverflowError):
        return None
