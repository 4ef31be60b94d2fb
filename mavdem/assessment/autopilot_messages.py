"""Said: what the autopilot itself reports in words, errors and events, each a fact.

Words are MAVLink's STATUSTEXT, DataFlash's MSG and ULog's logged messages; errors and events are DataFlash's ERR and
EV. ``message_patterns.toml`` has what each means.
"""

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from mavdem.facts import Fact, Level
from mavdem.facts.events import Reported
from mavdem.files import load_adjacent_toml
from mavdem.ingest.telemetry import Telemetry

_SAID = load_adjacent_toml(__file__, "message_patterns.toml")
PATTERNS = [(re.compile(pattern, re.IGNORECASE), *meant) for pattern, *meant in _SAID["texts"]]
SEVERITIES = ("emergency", "alert", "critical", "error", "warning")
"""MAV_SEVERITY of what warns, the worst first."""
PRIMARY_FILTER = 24  # Subsystem of ERR whose code is a lane, also 0
AGAIN_SECONDS = 30.0
"""s after which what is said again is another event: autopilots repeat a standing warning every 5 to 30 s."""


QUOTED = (Reported.AUTOPILOT_SAID, Reported.ARMING_REFUSED)
"""What quotes the autopilot, and is another with another text."""


class Text(NamedTuple):
    """A text of the autopilot at ``time``, s of a ``boot``, with its MAV_SEVERITY; 255 where that is not known."""

    time: float
    boot: int
    severity: int
    text: str


def texts(telemetry: Telemetry) -> list[Text]:
    """Returns all texts of the autopilot, in the order of the stream, those in chunks as one."""
    columns = telemetry.messages.get("STATUSTEXT", {})
    if "text" not in columns:
        return []
    none = [0] * len(columns["time"])
    fields = [
        columns[name].tolist() if name in columns else none
        for name in ("time", "boot", "severity", "id", "chunk_seq", "text")
    ]
    rows: list[Text] = []
    begun = dict[int, int]()
    for time, boot, severity, number, chunk, raw in zip(*fields, strict=True):
        text = raw.decode(errors="replace") if isinstance(raw, bytes) else raw
        if number and chunk and number in begun:
            before = rows[begun[number]]
            rows[begun[number]] = before._replace(text=before.text + text)
        else:
            begun[number] = len(rows)
            rows.append(Text(time, boot, severity, text))
    return [text._replace(text=text.text.strip()) for text in rows]


def said(telemetry: Telemetry) -> list[Fact]:
    """Returns what the autopilot says went wrong.

    Each has ``boot``, ``basis`` (the messages it rests on) and, where it is of a text, ``text`` and the word of its
    ``severity``.
    """
    return [*_of_texts(telemetry), *_of_errors(telemetry), *_of_events(telemetry)]


def _of_texts(telemetry: Telemetry) -> Iterator[Fact]:
    rows = texts(telemetry)
    is_old = any(text.text in _SAID["old_scale"] for text in rows)
    for text in rows:
        warns = text.severity < len(SEVERITIES) and not is_old
        fact = _meant(text, warns)
        if fact is not None:
            yield fact.but(
                boot=text.boot,
                basis=(telemetry.name_in_source("STATUSTEXT"),),
                severity=SEVERITIES[text.severity] if warns else None,
            )


def _meant(message: Text, warns: bool) -> Fact | None:
    """What a text means; None where something is over, or where no pattern knows it and it ``warns`` of nothing."""
    for pattern, code, *level in PATTERNS:
        match = pattern.search(message.text)
        if match:
            if not code:
                return None
            groups = match.groupdict()
            subject = groups.get("subject") or next(
                (f"{name} {groups[name]}" for name in ("motor", "lane") if groups.get(name)), ""
            )
            text = groups.get("text", message.text)
            subject = subject.lower()
            return Fact(
                Reported(code), *map(Level, level), time=message.time, subject=subject, text=text
            )
    said = Fact(Reported.AUTOPILOT_SAID, time=message.time, text=message.text)
    return said if warns else None


def _of_errors(telemetry: Telemetry) -> Iterator[Fact]:
    """ERR, each until its ECode is 0."""
    rows = list(_rows(telemetry, "ERR", "Subsys", "ECode"))
    for time, boot, number, code in rows:
        has_lane = number == PRIMARY_FILTER
        if code == 0 and not has_lane:
            continue
        ends = [ended for ended, *of in rows if of == [boot, number, 0] and ended > time]
        names = _SAID["subsystems"][number - 1 : number]
        name, subject = next(iter(names), (Reported.AUTOPILOT_ERROR, f"{number}"))
        yield Fact(
            Reported(name),
            time=time,
            until=min(ends) if ends and not has_lane else None,
            subject=f"lane {code}" if has_lane else subject,
            error_code=code,
            boot=boot,
            basis=("ERR",),
            severity=SEVERITIES[3],
        )


def _of_events(telemetry: Telemetry) -> Iterator[Fact]:
    for time, boot, number in _rows(telemetry, "EV", "Id"):
        meant = _SAID["events"].get(str(number))
        if meant:
            name, subject = meant
            yield Fact(Reported(name), time=time, subject=subject, boot=boot, basis=("EV",))


def reason(number: float | None) -> tuple[str, Level]:
    """Returns why ArduPilot changed its mode, by the number that it logs, in a word; empty where that is not known."""
    names = _SAID["reasons"][int(number) :][:1] if number else []
    cause, level = next(iter(names), ("", Level.GOOD))
    return cause, Level(level)


def _rows(telemetry: Telemetry, message: str, *fields: str) -> Iterator[Any]:
    """Time, boot and fields of each message of DataFlash's own; none where the log is another."""
    columns = telemetry.messages.get(message)
    if columns is not None:
        yield from zip(*(columns[name].tolist() for name in ("time", "boot", *fields)), strict=True)


def in_order(facts: Iterable[Fact]) -> list[Fact]:
    """Returns the facts by boot and time."""
    return sorted(facts, key=lambda fact: (fact.figures["boot"], fact.time))


def once(facts: Iterable[Fact]) -> list[Fact]:
    """Returns facts in order, those that say the same again soon as one, with its ``count`` and until when."""
    kept: list[Fact] = []
    of_kind = defaultdict[tuple[Any, ...], list[int]](list)
    for fact in in_order(facts):
        quoted = fact.figures["text"] if fact.code in QUOTED else ""
        before = of_kind[fact.figures["boot"], fact.code, quoted]
        at = next((at for at in reversed(before) if _is_again(kept[at], fact)), None)
        if at is None:
            before.append(len(kept))
            kept.append(fact.but(count=1))
        else:
            kept[at] = _joined(kept[at], fact)
    return kept


def _last(fact: Fact) -> float:
    return max(each for each in (fact.time, fact.until) if each is not None)


def _is_again(first: Fact, fact: Fact) -> bool:
    one_subject = first.subject == fact.subject or not (first.subject and fact.subject)
    return one_subject and (fact.time or 0.0) - _last(first) <= AGAIN_SECONDS


def _joined(first: Fact, fact: Fact) -> Fact:
    """The first, with what the next of its kind adds."""
    last = max(_last(first), _last(fact))
    basis = dict.fromkeys((*first.figures["basis"], *fact.figures["basis"]))
    return first.but(
        max(first.level, fact.level, key=list(Level).index),
        until=None if last == first.time else last,
        subject=first.subject or fact.subject,
        **{
            **fact.figures,
            **first.figures,
            "basis": tuple(basis),
            "count": first.figures["count"] + 1,
        },
    )
