"""Compaction: the journal's rows go into the data set, where all flights of a vehicle are judged together."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from mavdem.fleet.dataset import digest_of, groups_in, judged_beside, read_group, write_group
from mavdem.fleet.journal import Journal
from mavdem.fleet.ledger import Ledger, LedgerEntry, identity, read_ledger, write_ledger
from mavdem.fleet.reading.sources import is_url
from mavdem.fleet.row import FlightRow

SecondPass = Callable[[Sequence[FlightRow], Sequence[FlightRow]], Sequence[FlightRow]]
"""From all rows of one vehicle, and those of its baseline, to the same rows with their health."""


def compact(folder: Path, journal: Journal, second_pass: SecondPass, baseline: Sequence[FlightRow]) -> None:
    """Brings the data set up to date, and empties the journal.

    Interrupted at any moment it can be done again: what it makes follows from the data set and the journal, and the
    journal is emptied last.

    Args:
        folder: of the fleet.
        journal: of that folder.
        second_pass: what judges a vehicle's flights.
        baseline: rows of healthy flights; what was judged beside others is judged anew.

    Raises:
        OSError: the data set cannot be written, for want of space, say.
        Unreadable: the data set or the ledger is damaged.
    """
    before = read_ledger(folder)
    names_before, groups_before = _by_identity(before.by_path.values())
    after = Ledger(before.by_path.values())
    journal.into(after)
    after = _without_renamed(after)
    names, groups = _by_identity(after.by_path.values())
    gone = names_before.keys() - names.keys()
    changed = journal.lines.keys() | gone | {one for one in names if names_before.get(one) != names[one]}
    touched = {group for one in changed for group in (*groups.get(one, ()), *groups_before.get(one, ()))}
    lines = journal.lines_by_group()
    digest = digest_of(baseline)
    touched |= {group for group in groups_in(folder) if judged_beside(folder, group) != digest}
    for group in sorted(touched):
        read_anew = list(journal.rows(lines.get(group, ()), group))
        kept = [
            row
            for row in read_group(folder, group)
            if (own := identity(row.key, row.file)) not in gone and own not in journal.lines
        ]
        rows = [replace(row, file=names.get(identity(row.key, row.file), row.file)) for row in (*kept, *read_anew)]
        write_group(folder, group, judged(rows, second_pass, baseline), digest)
    write_ledger(folder, after)
    journal.clear()


def judged(rows: Iterable[FlightRow], second_pass: SecondPass, baseline: Sequence[FlightRow]) -> list[FlightRow]:
    """The rows after the second pass, vehicle by vehicle."""
    healthy = defaultdict(list)
    for row in baseline:
        healthy[row.vehicle].append(row)
    vehicles = defaultdict(list)
    for row in rows:
        vehicles[row.vehicle].append(row)
    found: list[FlightRow] = []
    for vehicle, flown in sorted(vehicles.items()):
        ordered = sorted(flown, key=lambda row: row.order)
        try:
            found += second_pass(ordered, healthy[vehicle])
        except Exception as error:  # a fault of mavdem on one vehicle's figures must not keep back the others'
            reason = f"Health is unknown: this should not have happened ({type(error).__name__}: {error})."
            found += [replace(row, health_reason=reason) for row in ordered]
    return found


def _by_identity(entries: Iterable[LedgerEntry]) -> tuple[dict[str, str], dict[str, tuple[str, ...]]]:
    """The name of each log, of several the first, and the groups that have its rows."""
    names: dict[str, str] = {}
    groups: dict[str, tuple[str, ...]] = {}
    for entry in entries:
        one = entry.identity
        if one not in names or entry.path < names[one]:
            names[one] = entry.path
        groups[one] = entry.groups
    return names, groups


def _without_renamed(ledger: Ledger) -> Ledger:
    """Without names of logs that are there under another name only."""
    paths = defaultdict(list)
    for entry in ledger.by_path.values():
        paths[entry.identity].append(entry)
    left = []
    for entries in paths.values():
        there = [entry for entry in entries if len(entries) == 1 or is_url(entry.path) or os.path.lexists(entry.path)]
        left += there or entries
    return Ledger(left)
