"""The ledger: which logs a fleet knows, by what they are known again, and what each cost to read."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, fields
from importlib import metadata
from pathlib import Path

from mavdem.errors import Unreadable
from mavdem.fleet.dataset import durable_write
from mavdem.fleet.reading.outcome import Limits, ReadOutcome, size_of
from mavdem.fleet.reading.sources import Source
from mavdem.fleet.row import SCHEMA_VERSION, as_text

LEDGER = "logs.parquet"


def identity(key: str, path: str) -> str:
    """By which the rows of a log are found: its content's key, or the path where it has none."""
    return key or f"path:{path}"


@dataclass(frozen=True, slots=True)
class LedgerEntry:
    """One log by one name.

    Attributes:
        path: absolute path as text, or URL.
        size, version: as :class:`Source` has them.
        key: of its content; empty if that was not reached.
        groups: of the data set that have its rows.
        ended: how its reading ended, as :class:`ReadOutcome` has it.
        seconds, megabytes: what it cost, of the log with this content that was read.
        time_limit, memory_limit: that held then, s and MB.
        schema: version of the columns then.
        mavdem_version: of the program then.
    """

    path: str
    size: int
    version: str
    key: str
    groups: tuple[str, ...]
    ended: str
    seconds: float
    megabytes: float
    time_limit: float
    memory_limit: int
    schema: int
    mavdem_version: str

    @property
    def identity(self) -> str:
        """By which its rows are found."""
        return identity(self.key, self.path)


def entry_of(source: Source, outcome: ReadOutcome, groups: Iterable[str], limits: Limits) -> LedgerEntry:
    """The entry of a log that was just read."""
    return LedgerEntry(
        as_text(source.path),
        source.size,
        source.version,
        outcome.key,
        tuple(sorted(set(groups))),
        outcome.ended,
        round(outcome.seconds, 3),
        round(outcome.megabytes, 1),
        limits.seconds,
        limits.megabytes,
        SCHEMA_VERSION,
        metadata.version("mavdem"),
    )


class Ledger:
    """The entries of all logs, by path and by content."""

    def __init__(self, entries: Iterable[LedgerEntry] = ()) -> None:
        self.by_path: dict[str, LedgerEntry] = {}
        self._by_key: dict[str, LedgerEntry] = {}
        self._by_size: dict[int, set[str]] = defaultdict(set)
        for entry in entries:
            self.add(entry)

    def add(self, entry: LedgerEntry) -> None:
        """Takes the place of an entry of the same path."""
        self.by_path[entry.path] = entry
        if entry.key and _current(entry):
            self._by_key[entry.key] = entry
            self._by_size[size_of(entry.key)].add(entry.key)

    def with_rows_in(self, groups: Iterable[str]) -> Ledger:
        """Without logs of which rows are in other groups than these, as where a file of the data set was deleted."""
        there = set(groups)
        return Ledger(entry for entry in self.by_path.values() if there.issuperset(entry.groups))

    def keeps(self, source: Source, outcome: ReadOutcome) -> bool:
        """Whether what it has of a log stays, as this outcome says nothing of the content.

        A source that cannot be reached now may be as it was; so may one that ended its reading, unless it has changed.
        """
        entry = self.by_path.get(as_text(source.path))
        if outcome.key or entry is None or not (entry.key and _current(entry)):
            return False
        return outcome.ended == "source" or source.version in ("", entry.version)

    def named(self, sources: Iterable[Source]) -> list[LedgerEntry]:
        """The entries of logs that were named; of those it has."""
        names = (as_text(source.path) for source in sources)
        return [self.by_path[name] for name in names if name in self.by_path]

    def knows(self, source: Source, limits: Limits) -> bool:
        """Whether a log need not be looked at: it is as it was, and another reading would end as the last one did."""
        entry = self.by_path.get(as_text(source.path))
        if entry is None or not source.version or (entry.size, entry.version) != source[1:]:
            return False
        return _current(entry) and not _worth_another_try(entry, limits)

    def keys_to_try(self, source: Source, limits: Limits) -> tuple[str, ...]:
        """Keys of known logs that this one may be a copy of."""
        # Copied at once: meanwhile another thread may add to it.
        candidates = tuple(self._by_size.get(source.size, ()))
        return tuple(sorted(key for key in candidates if not _worth_another_try(self._by_key[key], limits)))

    def of_key(self, key: str) -> LedgerEntry:
        """An entry of a log with this content."""
        return self._by_key[key]


def _current(entry: LedgerEntry) -> bool:
    return entry.schema == SCHEMA_VERSION


def _worth_another_try(entry: LedgerEntry, limits: Limits) -> bool:
    if entry.ended == "source":
        return True
    if entry.ended == "error":
        return entry.mavdem_version != metadata.version("mavdem")
    raised = limits.seconds > entry.time_limit or limits.megabytes > entry.memory_limit
    return entry.ended in ("time", "memory", "died") and raised


def read_ledger(folder: Path) -> Ledger:
    """The ledger of a fleet, empty where there is none; raises ``Unreadable`` where it is damaged."""
    from pyarrow import ArrowException, parquet

    path = folder / LEDGER
    if not path.exists():
        return Ledger()
    try:
        columns = parquet.ParquetFile(path).read().to_pydict()
        columns["groups"] = [tuple(groups) for groups in columns["groups"]]
        ordered = [columns[field.name] for field in fields(LedgerEntry)]
    except (ArrowException, OSError, KeyError) as error:
        reason = str(error).splitlines()[0]
        raise Unreadable(f"{path} is damaged ({reason}): delete it, and all logs are read again.") from None
    return Ledger(LedgerEntry(*values) for values in zip(*ordered, strict=True))


def write_ledger(folder: Path, ledger: Ledger) -> None:
    """Replaces the ledger of a fleet whole."""
    import pyarrow
    from pyarrow import parquet

    entries = [ledger.by_path[path] for path in sorted(ledger.by_path)]
    text, number = pyarrow.string(), pyarrow.float64()
    kinds = {"str": text, "float": number, "int": pyarrow.int64(), "tuple[str, ...]": pyarrow.list_(text)}
    schema = pyarrow.schema([(field.name, kinds[str(field.type)]) for field in fields(LedgerEntry)])
    columns = {name: [getattr(entry, name) for entry in entries] for name in schema.names}
    with durable_write(folder / LEDGER, folder) as file:
        parquet.write_table(pyarrow.Table.from_pydict(columns, schema), file, compression="zstd")
