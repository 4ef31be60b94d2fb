"""The data set of a fleet on disk: Parquet files that DuckDB, Polars and pandas read.

``FLEET/flights/schema=1/group=g3f/flights.parquet``: all rows of a vehicle are in one file, and vehicles share 256
files, so that neither a million vehicles nor a million flights of one make more files than a file system likes.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import BinaryIO

from mavdem.errors import Unreadable, require
from mavdem.files import atomic_write
from mavdem.fleet.row import SCHEMA_VERSION, FlightRow, row_schema

ROW_GROUP = 10_000  # rows that a reader skips at once, by the least and the greatest vehicle's name among them
SCHEMA = re.compile(r"schema=(\d+)")  # the folder of rows with this version of the columns
UNFINISHED = ".unfinished"  # the folder of a fleet for files that are being written
JUDGED_BESIDE = b"mavdem_baseline"  # in a file's metadata: which baseline its rows were judged beside
NEEDED_FOR = "Reading and writing the data set of a fleet"


def group_of(vehicle: str) -> str:
    """The file a vehicle's rows are in: g and two hexadecimal digits, which no reader takes for a number."""
    return f"g{hashlib.sha256(vehicle.encode()).hexdigest()[:2]}"


def group_file(folder: Path, group: str) -> Path:
    """Where the rows of a group are."""
    return folder / "flights" / f"schema={SCHEMA_VERSION}" / f"group={group}" / "flights.parquet"


def groups_in(folder: Path) -> list[str]:
    """The groups that have a file, in order."""
    found = folder.glob(f"flights/schema={SCHEMA_VERSION}/group=*/flights.parquet")
    return sorted(path.parent.name.removeprefix("group=") for path in found)


def set_old_aside(folder: Path) -> None:
    """Moves rows with older columns from ``flights`` to ``old``, where no reader counts them.

    Raises:
        Unreadable: there are rows with newer columns.
    """
    versions = {int(found[1]): path for path in _schemas(folder) if (found := SCHEMA.fullmatch(path.name))}
    if max(versions, default=0) > SCHEMA_VERSION:
        raise Unreadable(f"{folder} was written by a newer mavdem: update this one, or name another folder.")
    for version, path in versions.items():
        if version != SCHEMA_VERSION:
            (folder / "old").mkdir(exist_ok=True)
            names = (path.name if number == 1 else f"{path.name}.{number}" for number in count(1))
            path.rename(next(place for name in names if not os.path.lexists(place := folder / "old" / name)))


def _schemas(folder: Path) -> list[Path]:
    """The folders of rows, with whatever version of the columns."""
    return sorted({path.parents[1] for path in folder.glob("flights/schema=*/group=*/flights.parquet")})


def check_free(folder: Path) -> None:
    """Raises ``Unreadable`` where rows would lie among files of somebody else; ``OSError`` where they are not seen."""
    place = folder / "flights"
    if is_fleet(folder) or not place.is_dir():
        return
    if any(not (path.name.startswith(".") or SCHEMA.fullmatch(path.name)) for path in place.iterdir()):
        raise Unreadable(f"{place} holds files that are not of a fleet: name another folder.")


def is_fleet(folder: Path) -> bool:
    """Whether ``mavdem track`` has written there."""
    return bool(_schemas(folder))


def read_rows(folder: Path) -> list[FlightRow]:
    """All rows of a fleet, by vehicle, file and axis.

    Raises:
        Unreadable: there is none, or one of its files is damaged.
        MissingExtra: pyarrow is not installed.
    """
    if not is_fleet(folder):
        raise Unreadable(f"{folder} holds no fleet: make one with `mavdem track LOGS --out {folder}`.")
    rows = [row for group in groups_in(folder) for row in read_group(folder, group)]
    return sorted(rows, key=lambda row: row.order)


def read_group(folder: Path, group: str) -> list[FlightRow]:
    """The rows of one group, none if it has no file; raises as :func:`read_rows`."""
    require(NEEDED_FOR, "fleet")
    import pyarrow
    from pyarrow import parquet

    path = group_file(folder, group)
    if not path.exists():
        return []
    try:
        # Not as a data set: its folders would become columns.
        table = parquet.ParquetFile(path).read()
        return [FlightRow.from_dict(values) for values in table.to_pylist()]
    except (pyarrow.ArrowException, OSError, TypeError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise Unreadable(f"{path} is damaged ({reason}): delete it, and run `mavdem track` again.") from None


def write_rows(folder: Path, rows: Iterable[FlightRow]) -> None:
    """Makes these the fleet's rows: every group's file is replaced whole, and groups without a row are removed.

    The same rows give the same bytes, in whatever order they come.
    """
    by_group = defaultdict(list)
    for row in rows:
        by_group[group_of(row.vehicle)].append(row)
    for group in {*groups_in(folder), *by_group}:
        write_group(folder, group, by_group.get(group, []))


def write_group(folder: Path, group: str, rows: Iterable[FlightRow], baseline: str = "") -> None:
    """Replaces one group's file whole; without rows it is removed.

    Args:
        folder: of the fleet.
        group: whose file it is.
        rows: all of the group.
        baseline: the digest of the baseline that they were judged beside.

    Raises:
        OSError: the file cannot be written.
    """
    require(NEEDED_FOR, "fleet")
    import pyarrow
    from pyarrow import parquet

    path = group_file(folder, group)
    ordered = sorted(rows, key=lambda row: row.order)
    if not ordered:
        path.unlink(missing_ok=True)
        return
    schema = row_schema()
    schema = schema.with_metadata({**schema.metadata, JUDGED_BESIDE: baseline.encode()})
    columns = {name: [getattr(row, name) for row in ordered] for name in schema.names}
    columns["date"] = [None if date is None else date.replace(tzinfo=None) for date in columns["date"]]
    table = pyarrow.Table.from_pydict(columns, schema)
    path.parent.mkdir(parents=True, exist_ok=True)
    with durable_write(path, folder) as file:
        parquet.write_table(table, file, row_group_size=ROW_GROUP, compression="zstd")


def judged_beside(folder: Path, group: str) -> str:
    """The digest of the baseline that a group's rows were judged beside; empty if there was none."""
    import pyarrow
    from pyarrow import parquet

    try:
        metadata = parquet.read_schema(group_file(folder, group)).metadata or {}
    except (pyarrow.ArrowException, OSError):  # whoever reads its rows says so
        return ""
    return str(metadata.get(JUDGED_BESIDE, b"").decode())


def digest_of(rows: Iterable[FlightRow]) -> str:
    """The same for the same rows in any order; empty for none."""
    lines = [repr(row) for row in sorted(rows, key=lambda row: row.order)]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest() if lines else ""


@contextmanager
def durable_write(path: Path, fleet: Path) -> Iterator[BinaryIO]:
    """As ``atomic_write``; at the end the disk has it, so that what it was made from can be removed.

    What a run that was killed left unfinished is not among the rows, where readers of all files would count it, and the
    next to write removes it: one run at a time writes to a fleet.
    """
    scratch = fleet / UNFINISHED
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir(exist_ok=True)
    try:
        # `flights` may be a link to another disk, to which no file can be moved from here.
        moves = os.stat(os.path.realpath(path.parent)).st_dev == os.stat(scratch).st_dev
        with atomic_write(path, scratch if moves else None) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    with suppress(OSError):  # of file systems that cannot do that with a folder
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
