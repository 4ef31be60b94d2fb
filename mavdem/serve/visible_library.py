"""The library as the sender of a request may see it: flights, searches, and values for all pages."""

import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from starlette.requests import Request as HttpRequest

from mavdem.containers import JsonValues, group_by
from mavdem.documents.library import Flight, Recordings
from mavdem.errors import Refusal
from mavdem.facts.serve import ListingOrder, Permission, RefusalReason, Sharing, Stage
from mavdem.fleet.health_figures import health_figures
from mavdem.fleet.names import content_hash
from mavdem.fleet.tracking import healthy_figures_by_log
from mavdem.machine import LOOPBACK_HOSTS
from mavdem.motors.healthy_flights import is_comparable
from mavdem.report.pages.library_page import interface_words
from mavdem.report.pages.motor_anomaly import motor_anomaly, review_with_anomaly
from mavdem.results import REPORT_FILE
from mavdem.serve.index import CONTENT_HASH_SQL, IS_VEHICLE_UNNAMED_SQL, LibraryEntry
from mavdem.serve.library import Library
from mavdem.serve.recordings import RecordingRequests
from mavdem.serve.requests import query_number
from mavdem.serve.rights import Rights
from mavdem.serve.search import UNFINISHED_SQL, search_condition
from mavdem.serve.similar_flight import most_similar_flight

MAX_SEARCH_LETTERS = 500
"""Letters of a search that are used; further ones are ignored."""

ORDER_COOKIE = "order"
"""Name of the cookie by which a browser remembers the order of the list that was chosen last."""

MAX_COMPARABLE_FLIGHTS = 100
"""Flights that the page of a flight offers to be compared with: a choice, since nobody looks through more."""

COMPARABLE_SQL = "stage = ? and digest != '' and id != ?"
"""SQL condition of a flight with which another one can be compared: its values are ``Stage.DONE`` and the other's id.

A flight without a digest, whose log the library does not keep, need not have a page.
"""


MAX_UNREAD_LOGS_ON_TOP = 5
"""Logs still to be read that are listed as the newest uploads; a choice. More are of a folder, whose flights that have
a verdict would be pushed off the first page.
"""


class SearchResult(NamedTuple):
    """What a search in the library found."""

    entries: list[LibraryEntry]
    """the flights of one page of the result in the order that was asked for; logs that could not be read come last"""
    total: int
    """number of all flights that match"""
    query: str
    """the search"""
    order: ListingOrder
    """the order in which they are listed"""
    is_reversed: bool
    """whether that order is reversed"""
    offset: int
    """number of matching flights that precede the page"""
    is_judged_first: bool
    """whether logs that are still to be read come after the flights with a verdict, whatever the order"""

    @property
    def sort(self) -> str:
        """The order as the query ``sort`` has it, such as ``time``, or reversed ``-time``."""
        return f"-{self.order}" if self.is_reversed else str(self.order)


class UnnamedGroup(NamedTuple):
    """Logs that call their vehicle by the same name, which several vehicles may have."""

    name: str
    """what the logs call the vehicle, made of its MAVLink system id"""
    first_entry: LibraryEntry
    """the log of them that was uploaded last"""
    log_count: int
    """number of these logs"""


@dataclass(frozen=True)
class VisibleLibrary:
    """A library with the access rights of those who send requests."""

    library: Library
    """The library."""
    rights: Rights
    """The access rights."""

    def entry(self, request: HttpRequest, id: str) -> LibraryEntry:
        """Returns the entry of a flight, if the sender may see it.

        Args:
            request: the request, for the sender's rights.
            id: id of the flight.

        Returns:
            The entry.

        Raises:
            Refusal: there is no such flight, or the sender may not see it. The reason is the same in both cases, so
                that a sender cannot find out which flights exist.
        """
        entry = self.library.entry(id)
        if not self.rights.allows_viewing(request, entry):
            raise Refusal(RefusalReason.NO_SUCH_FLIGHT)
        return entry

    def log_path(self, request: HttpRequest, entry: LibraryEntry) -> Path:
        """Returns the path of the log of a flight, after checking that the sender of a request may have it.

        Senders who may read all flights may have the log and any field of it; others only if its owner shares it with
        those who may see the flight.

        Args:
            request: the request, for the sender's rights.
            entry: a flight that the sender may see.

        Raises:
            Refusal: the sender may not have the log.
        """
        if not entry.log_shared and not self.rights.allows(request, Permission.READ):
            raise Refusal(RefusalReason.NO_RIGHT, name=Permission.DOWNLOAD)
        return self.library.log_path(entry)

    def search(self, request: HttpRequest, limit: int) -> SearchResult:
        """Searches the flights that the sender of a request may list.

        Args:
            request: the request. Its query has the search ``q``, the order ``sort`` (a value of ``ListingOrder`` such
                as "time", or "-time" for the reversed order; without it the order that the browser remembers), and the
                number of flights to skip as ``offset``.
            limit: largest number of flights that are returned.

        Returns:
            The flights, the number of all that match, and the search as it was interpreted.

        Raises:
            Refusal: the offset is not a number.
        """
        query = request.query_params.get("q", "")[:MAX_SEARCH_LETTERS]
        offset = query_number(request, "offset", 0)
        remembered_order = request.cookies.get(ORDER_COOKIE, "")
        sort = request.query_params.get("sort", remembered_order)
        order = ListingOrder.UPLOAD
        is_reversed = False
        order_name = sort.removeprefix("-")
        if order_name in {*ListingOrder}:
            order = ListingOrder(order_name)
            is_reversed = sort.startswith("-")
        condition, values = search_condition(query)
        # Senders without the right to read all flights find only the public ones.
        if not self.rights.allows(request, Permission.READ):
            condition = f"sharing = '{Sharing.PUBLIC}' and ({condition})"
        # Only the order by upload has a place for a log that nothing is known of.
        unread_count = self.library.find(UNFINISHED_SQL, (), limit=0).total
        is_judged_first = order != ListingOrder.UPLOAD or unread_count > MAX_UNREAD_LOGS_ON_TOP
        entries, entry_count = self.library.find(
            condition,
            values,
            limit,
            offset,
            order,
            is_reversed=is_reversed,
            judged_first=is_judged_first,
        )
        return SearchResult(
            entries,
            total=entry_count,
            query=query,
            order=order,
            is_reversed=is_reversed,
            offset=offset,
            is_judged_first=is_judged_first,
        )

    def previous_flight(self, entry: LibraryEntry) -> LibraryEntry | None:
        """Returns the flight of the same vehicle before this one, by date.

        Args:
            entry: a flight. One without a date, or of an unnamed vehicle, has none before it.

        Returns:
            The flight; None if none is known.
        """
        earlier_entries = self._earlier_flights(entry, limit=1)
        return earlier_entries[0] if earlier_entries else None

    def flight_to_compare_with(self, entry: LibraryEntry) -> LibraryEntry | None:
        """Returns the flight of the same vehicle with which one without an anomaly of its motors is best compared.

        Earlier flights and those of the baseline come into question; all flights if there are none of these. Which one
        suits best is decided by :func:`most_similar_flight`.

        Args:
            entry: index entry of the flight.

        Returns:
            The flight; None if the library has no other flight that is known to be of this vehicle.
        """
        candidates = self._earlier_flights(entry, MAX_COMPARABLE_FLIGHTS)
        baseline = {content_hash(row.key) for row in self.library.baseline_rows(entry.vehicle)}
        if baseline or not candidates:
            other_entries = self.comparable_flights(entry, best_entry=None)
            baseline_entries = [other for other in other_entries if other.content_hash in baseline]
            candidates = [*candidates, *baseline_entries] or other_entries
        compared = self.library.compared_entries(candidates)
        return most_similar_flight(entry, compared.entries, baseline)

    def healthy_flights_to_compare_with(
        self, entries: Iterable[LibraryEntry]
    ) -> dict[str, LibraryEntry]:
        """Finds the flights with which those with an anomaly of their motors are best compared.

        An anomaly shows in comparison with healthy flights of the vehicle: its baseline or, without one, the flights
        that are taken for healthy. Of these, the one in the most similar conditions is chosen, whatever its other
        lights, so that both pages rest on the same evidence.

        Args:
            entries: index entries of the flights with an anomaly.

        Returns:
            The healthy flights by the ids of the others, without those for which the library has none.
        """
        flights_to_compare = {}
        for vehicle, entries_of_vehicle in group_by(entries, lambda entry: entry.vehicle).items():
            rows = self.library.motor_rows_of_vehicle(vehicle)
            rows_by_log = {content_hash(row.key): row for row in rows}
            healthy_figures = healthy_figures_by_log(rows, self.library.baseline_rows(vehicle))
            healthy_entries = self._flights_of_logs(vehicle, list(healthy_figures))
            for entry in entries_of_vehicle:
                row = rows_by_log.get(entry.content_hash)
                if row is None:
                    # The flight was deleted meanwhile.
                    continue
                figures = health_figures(row)
                comparable_logs = {
                    log for log, other in healthy_figures.items() if is_comparable(figures, other)
                }
                comparable_entries = [
                    other
                    for other in healthy_entries
                    if other.content_hash in comparable_logs and other.id != entry.id
                ]
                most_similar = most_similar_flight(
                    entry, comparable_entries, baseline=comparable_logs
                )
                if most_similar is not None:
                    flights_to_compare[entry.id] = most_similar
        return flights_to_compare

    def _flights_of_logs(self, vehicle: str, logs: Sequence[str]) -> list[LibraryEntry]:
        """Returns the flights of a vehicle whose logs are among the given ones, if they have pages in the library.

        Args:
            vehicle: name of the vehicle in its logs.
            logs: the logs, each as the hash of its content.
        """
        # A flight has a page once its log was read, if the library keeps the log; without one the digest is empty.
        condition = (
            "vehicle = ? and stage = ? and digest != ''"
            f" and {CONTENT_HASH_SQL} in (select value from json_each(?))"
        )
        values = [vehicle, Stage.DONE, json.dumps(logs)]
        return self.library.find(condition, values, len(logs), order=ListingOrder.FLIGHT).entries

    def _earlier_flights(self, entry: LibraryEntry, limit: int) -> list[LibraryEntry]:
        """Returns the flights of a vehicle that began before one of them and can be compared with it.

        Args:
            entry: index entry of the flight.
            limit: largest number of flights that are returned.

        Returns:
            The entries by date, the latest first. There are none if the flight has no date or its vehicle is unnamed:
            then no flight is known to be an earlier one of the same vehicle.
        """
        if not entry.date or entry.is_vehicle_unnamed:
            return []
        # Dates are texts. Flights without one have an empty text, which precedes every date. Copies of the log have the
        # same date, and are no earlier flights.
        condition = f"vehicle = ? and date != '' and date < ? and {COMPARABLE_SQL}"
        values = [entry.vehicle, entry.date, Stage.DONE, entry.id]
        return self.library.find(condition, values, limit, order=ListingOrder.FLIGHT).entries

    def comparable_flights(
        self, entry: LibraryEntry, best_entry: LibraryEntry | None
    ) -> list[LibraryEntry]:
        """Returns the flights of the same vehicle that one can be compared with, the best first.

        Args:
            entry: index entry of the flight.
            best_entry: the flight that it is best compared with (:meth:`flight_to_compare_with`); None if there is no
                such flight.

        Returns:
            The best one, then the others by date, the latest first, of which there are at most
            ``MAX_COMPARABLE_FLIGHTS``; none of a log that does not identify its vehicle.
        """
        if entry.is_vehicle_unnamed:
            return []
        condition = f"vehicle = ? and {COMPARABLE_SQL}"
        values = [entry.vehicle, Stage.DONE, entry.id]
        others = self.library.find(
            condition, values, MAX_COMPARABLE_FLIGHTS, order=ListingOrder.FLIGHT
        ).entries
        if best_entry is None:
            return others
        return [best_entry, *(other for other in others if other.id != best_entry.id)]

    def unnamed_groups(self) -> list[UnnamedGroup]:
        """Returns the logs that name no vehicle but its MAVLink system id, in groups of the same id, the largest first.

        Several vehicles may have the same id, so that users are asked to name them. Groups that have a name from a user
        are left out, and so are logs without an id.
        """
        names_from_users = {*self.library.vehicle_names()}
        condition = f"stage = ? and vehicle <> '' and {IS_VEHICLE_UNNAMED_SQL}"
        entries = self.library.find(condition, [Stage.DONE], sys.maxsize).entries
        groups = []
        for name, entries_of_group in group_by(entries, lambda entry: entry.vehicle).items():
            if name not in names_from_users:
                latest_entry = entries_of_group[0]
                groups.append(UnnamedGroup(name, latest_entry, log_count=len(entries_of_group)))
        return sorted(groups, key=lambda group: group.log_count, reverse=True)

    def flights_of_other_vehicles(self, entry: LibraryEntry) -> list[LibraryEntry]:
        """Returns the flights of other or unknown vehicles that one can be compared with, by date, the latest first.

        Args:
            entry: index entry of the flight. Where its log does not identify the vehicle, all flights count.

        Returns:
            Their entries, at most ``MAX_COMPARABLE_FLIGHTS``.
        """
        condition = COMPARABLE_SQL
        values = [Stage.DONE, entry.id]
        if not entry.is_vehicle_unnamed:
            condition += " and vehicle != ?"
            values.append(entry.vehicle)
        return self.library.find(
            condition, values, MAX_COMPARABLE_FLIGHTS, order=ListingOrder.FLIGHT
        ).entries

    def documents(self, entries: Sequence[LibraryEntry]) -> list[Flight]:
        """Returns flights of the library as JSON documents, with the names that users gave to them and their vehicles.

        Flights are judged as on pages and in searches: by the log, and in comparison with the vehicle's other flights.
        A fault or drift that the comparison shows is the anomaly of the motors.

        Args:
            entries: index entries of the flights.

        Returns:
            The documents, in the order of the entries.
        """
        names = self.library.names
        compared = self.library.compared_entries(entries)
        documents = []
        for entry in compared.entries:
            flight_name = names.flights.get(entry.content_hash, "")
            vehicle_name = names.vehicles.get(entry.vehicle, "")
            anomalous_row = compared.anomalous_rows.get(entry.id)
            reason = None if anomalous_row is None else anomalous_row.health_reason
            document = Flight.from_results(
                entry,
                given_name=flight_name,
                vehicle_name=vehicle_name,
                motor_anomaly=reason or "",
            )
            documents.append(document)
        return documents

    def judged_review(self, entry: LibraryEntry) -> JsonValues | None:
        """Returns the document of a flight's review, with the motors judged also by the vehicle's other flights.

        So it has the same headline, motors' light and next step as the page of the flight and its line in lists.

        Args:
            entry: index entry of the flight.

        Returns:
            The document; None if :meth:`review` returns none.

        Raises:
            Refusal: the flight is being deleted, or its document is damaged.
        """
        review = self.review(entry)
        if review is None:
            return None
        anomalous_row = self.library.compared_entries([entry]).anomalous_rows.get(entry.id)
        return dict(review_with_anomaly(review, motor_anomaly(anomalous_row)))

    def review(self, entry: LibraryEntry) -> JsonValues | None:
        """Returns the document of a flight's review, by its log alone.

        Args:
            entry: index entry of the flight.

        Returns:
            The document; None before it is done, and for flights of ``mavdem track``.

        Raises:
            Refusal: the flight is being deleted, or its document is damaged.
        """
        path = self.library.results_folder(entry) / REPORT_FILE
        if not path.is_file():
            return None
        with refuse_missing_file():
            content = path.read_bytes()
        try:
            return dict(json.loads(content))
        except (TypeError, ValueError):
            # Text that is no JSON, or JSON that is no object.
            raise Refusal(RefusalReason.RESULTS_DAMAGED, file=REPORT_FILE) from None

    def recordings(self, entry: LibraryEntry) -> Recordings:
        """Returns the JSON document on the recordings of a flight: whether they are requested, being made, or done.

        Recordings are files for the viewers Rerun and Foxglove, which are made on request.

        Args:
            entry: index entry of the flight.

        Returns:
            The stage, such as waiting or done, the same in words, and, if they could not be made, the reason.
        """
        stage = RecordingRequests(self.library).stage(entry)
        stage_in_words = interface_words()["stages"].get(stage, "")
        return Recordings(
            id=entry.id,
            stage=stage,
            words=stage_in_words,
            problem=entry.recording_problem,
        )

    def visitor_values(self, request: HttpRequest) -> JsonValues:
        """Returns what the templates of all pages need: the visitor's rights, the server's addresses, and given names.

        A visitor who may read all flights also gets two secret keys: one with which the page's script changes flights,
        and one in the address to which a ground station uploads logs.

        Args:
            request: the request, for the rights of its sender.

        Returns:
            Values by the names in the templates: ``may_read``, whether the visitor may read all flights; ``key`` for
            changes; ``has_token``, whether visitors can sign in with a token; ``has_library``; ``address`` of the
            server, whether it leads here on this machine only (``is_loopback``), and the address for uploads
            (``upload``); the names that were ``given`` to vehicles; the names of
            all ``vehicles`` in logs, empty for those who may not read; and the type of each vehicle's frame
            (``frames``).
        """
        may_read = self.rights.allows(request, Permission.READ)
        address = str(request.base_url).rstrip("/")
        upload_address = ""
        vehicle_names: list[str] = []
        given_names = self.library.names
        if may_read:
            # In the order of the names that are shown.
            vehicle_names = sorted(
                self.library.vehicle_names(), key=lambda name: given_names.vehicle(name).casefold()
            )
            upload_key = self.rights.derived_key(Permission.UPLOAD)
            upload_path = f"/{upload_key}/upload" if upload_key else "/upload"
            upload_address = address + upload_path
        return {
            "may_read": may_read,
            "key": self.rights.derived_key(Permission.WRITE) if may_read else "",
            "has_token": bool(self.rights.token),
            "has_library": True,
            "address": address,
            "is_loopback": request.url.hostname in LOOPBACK_HOSTS,
            "upload": upload_address,
            "given": given_names,
            "vehicles": vehicle_names,
            "frames": self.library.vehicle_frames,
        }


@contextmanager
def refuse_missing_file() -> Iterator[None]:
    """Raises ``Refusal`` in place of the error that a file does not exist: its flight is being deleted."""
    try:
        yield
    except FileNotFoundError:
        raise Refusal(RefusalReason.NO_SUCH_FLIGHT) from None
