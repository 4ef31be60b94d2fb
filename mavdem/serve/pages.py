"""Endpoints of the server for browsers: HTML pages, and the files of flights."""

import asyncio
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from stat import S_ISREG

from markupsafe import Markup
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request as HttpRequest
from starlette.responses import (
    FileResponse,
    HTMLResponse,
    JSONResponse,
    RedirectResponse,
    Response,
)

from mavdem.containers import JsonValues
from mavdem.documents.library import Recordings
from mavdem.errors import Refusal
from mavdem.facts.serve import ListingOrder, Permission, RefusalReason, Stage
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.difference import baseline_differences
from mavdem.fleet.flights import group_by_vehicle
from mavdem.fleet.names import content_hash
from mavdem.fleet.parameter_text import parse_parameters
from mavdem.fleet.row import FlightRows
from mavdem.fleet.state import (
    motors_by_pair,
    rows_judged_by_each_other,
    rows_with_known_health,
)
from mavdem.fleet.tracking import logs_taken_for_healthy
from mavdem.fleet.workers import PAGES, POLL_SECONDS
from mavdem.ingest.formats import detect_format
from mavdem.ingest.telemetry import Parameters
from mavdem.report.blocks import Blocks
from mavdem.report.charts.comparison_charts import FlightSeries
from mavdem.report.difference.baseline import baseline_blocks
from mavdem.report.difference.reviewed import (
    ComparedState,
    ReviewedDifference,
    compared_states,
)
from mavdem.report.pages.difference_page import comparison_page
from mavdem.report.pages.library_page import (
    render_server_page,
    script_hashes_of_page,
    server_script,
    vehicle_id_on_page,
    vehicle_page,
    vehicles_page,
    with_comparison_bar,
    with_toolbar,
    without_last_position,
)
from mavdem.report.pages.motor_anomaly import motor_anomaly
from mavdem.report.pages.page_link import PageLink
from mavdem.results import PAGE_FILE, RECORDING_FILE, RECORDINGS
from mavdem.serve.guard import POLICY_HEADER
from mavdem.serve.index import LibraryEntry, vehicle_page_name
from mavdem.serve.recordings import RecordingRequests, reason_without_file
from mavdem.serve.rerun_viewer import viewer_policy
from mavdem.serve.search import UNFINISHED_SQL, needs_complete_entries, search_hints
from mavdem.serve.stored_parameters import read_parameters
from mavdem.serve.stored_series import read_series
from mavdem.serve.uploads import MAX_FILES
from mavdem.serve.visible_library import (
    ORDER_COOKIE,
    SearchResult,
    VisibleLibrary,
    refuse_missing_file,
)

FLIGHTS_PER_PAGE = 100
"""Flights on one page of the list."""

ORDER_COOKIE_SECONDS = 365 * 24 * 3600
"""Seconds for which a browser remembers the order of the list that was chosen last: a year, a choice."""

MAX_RECORDING_WAIT = 20.0
"""Seconds for which the download of a recording waits until it is made, at most: most flights take five, and proxies
give up after 30 to 60."""

MAX_WAITING_DOWNLOADS = 100
"""Downloads that wait for a recording at a time; further ones are answered without waiting."""

RECORDING_RETRY_SECONDS = 2
"""Seconds after which a recording that is being made may be requested again."""


def recordings_answer(recordings: Recordings) -> Response:
    """Returns the answer on recordings: 202 while they are made, 200 when they are there, 409 where that has failed."""
    status_by_stage: dict[str, int] = {Stage.DONE: 200, Stage.FAILED: 409}
    status = status_by_stage.get(recordings.stage, 202)
    headers = {"Retry-After": str(RECORDING_RETRY_SECONDS)} if status == 202 else None
    return JSONResponse(recordings.as_dict(), status, headers)


def _changes_from_baseline(name: str, rows: FlightRows, healthy_rows: FlightRows) -> Blocks:
    """Describes how the latest flight of a vehicle differs from its flights that the owner marked as healthy.

    Args:
        name: name of the vehicle in its logs.
        rows: rows of all its flights in the fleet's table.
        healthy_rows: rows of the healthy flights, the baseline.

    Returns:
        Sentences for the vehicle's page; none without a baseline, or if all flights of the vehicle are in it.
    """
    if not healthy_rows:
        return []
    latest_difference = baseline_differences(rows, healthy_rows).get(name)
    if latest_difference is None:
        return []
    latest_row, difference = latest_difference
    # A difference is missing only if the baseline has no flight of this vehicle.
    assert difference is not None
    # The page itself says that several vehicles may have the name.
    return baseline_blocks(latest_row, difference, has_identity_cautions=False)


def _with_reasons_for_missing_parameters(
    reviewed: ReviewedDifference, entries_without_parameters: Mapping[str, LibraryEntry]
) -> ReviewedDifference:
    """Returns the comparison of two flights with the reason why the library has few or no parameters of a flight.

    Args:
        reviewed: the comparison.
        entries_without_parameters: index entries of the flights with few or no parameters, by side, "A" or "B".
    """
    tracked_sides = []
    outdated_sides = []
    for side, entry in entries_without_parameters.items():
        has_log_in_library = bool(entry.digest)
        if has_log_in_library:
            # An earlier version, which kept no other parameters than gains, has read the log.
            outdated_sides.append(side)
        else:
            # `mavdem track` has read the log in the user's own folder, and has only added the flight to the index.
            tracked_sides.append(side)
    return reviewed._replace(
        tracked_sides=tuple(tracked_sides), outdated_sides=tuple(outdated_sides)
    )


class Pages:
    """Endpoints that answer with pages for a browser, or with files.

    Each takes a request and returns the answer. Each raises ``Refusal`` where the visitor has no right to it, or what
    is requested does not exist.
    """

    def __init__(
        self,
        visible: VisibleLibrary,
        work_requested: Callable[[], None],
        sample_log: Path | None,
        *,
        has_viewer: bool,
        session_summary: Callable[[], str] | None,
        scripts: Collection[str],
    ) -> None:
        """Stores the library and the settings of the server that the pages show.

        Args:
            visible: the library, with the access rights.
            work_requested: function that is called after recordings or a page were requested.
            sample_log: a log that visitors may try the server with; None for no offer.
            has_viewer: whether recordings can be opened in a viewer on this machine.
            session_summary: function that returns the vehicle of the live session and what it does; None without a
                live session.
            scripts: hashes of the scripts that pages of this library may run, also of pages that earlier versions
                wrote.
        """
        self._visible_library = visible
        self._library = visible.library
        self._rights = visible.rights
        self._work_requested = work_requested
        self._waiting_downloads = 0
        self._sample_log = sample_log
        self._has_viewer = has_viewer
        self._session_summary = session_summary
        self._scripts = frozenset(scripts)

    def list_flights(self, request: HttpRequest) -> Response:
        """Answers with the page that lists the library's flights, newest first, or the flights that a search finds.

        A visitor without the right to read sees only public flights, and no names of vehicles. The verdict on a flight
        is the same for all who see it.

        Args:
            request: the request, whose query may contain a search.
        """
        result = self._visible_library.search(request, FLIGHTS_PER_PAGE)
        # The rights of the visitor, and what else all pages have.
        visitor = self._visible_library.visitor_values(request)
        unread_count = 0
        if visitor["may_read"] and result.is_judged_first:
            unread_count = self._library.find(UNFINISHED_SQL, (), limit=0).total
        is_library_empty = not result.entries and not result.query and not result.offset
        html = render_server_page(
            "library",
            total=result.total,
            query=result.query,
            problems=search_hints(result.query, is_nothing_found=not result.entries),
            order=result.order,
            sort=result.sort,
            offset=result.offset,
            page=FLIGHTS_PER_PAGE,
            is_empty=is_library_empty,
            sample=self._sample_log,
            unread_count=unread_count,
            is_live=self._session_summary is not None,
            session_summary=self._session_summary() if self._session_summary else "",
            **self._values_of_search(result, may_read=visitor["may_read"]),
            **visitor,
        )
        response = HTMLResponse(html)
        if "sort" in request.query_params:
            response.set_cookie(
                ORDER_COOKIE, result.sort, max_age=ORDER_COOKIE_SECONDS, samesite="lax"
            )
        return response

    def _values_of_search(self, result: SearchResult, *, may_read: bool) -> JsonValues:
        """Returns what the list of flights shows of the flights that a search finds.

        Args:
            result: the search, with the flights on the page.
            may_read: whether the visitor may read all flights. Without that right, links to comparisons and the number
                of flights that are not known are left out.

        Returns:
            Values by the names in the template: those of :meth:`_judged_flights`; and ``not_known_count``, the number
            of flights of which it is not known whether they match the search.
        """
        not_known_count = 0
        if may_read and needs_complete_entries(result.query):
            not_known_count = self._library.incomplete_count()
        return {
            "not_known_count": not_known_count,
            **self._judged_flights(result.entries, may_read=may_read),
        }

    def _judged_flights(self, entries: Sequence[LibraryEntry], *, may_read: bool) -> JsonValues:
        """Returns the values of a template with a table of flights, which shows the verdict on each flight.

        The verdict is by the log of the flight. If a comparison with other flights of the vehicle shows a fault or
        drift of the motors, it says that too, and a link compares the flight with the one that suits this best.

        Args:
            entries: index entries of the flights, whose verdicts are by their logs alone.
            may_read: whether the visitor may read all flights; there are no such links otherwise.

        Returns:
            ``entries`` with the verdicts that are shown; ``anomalous_rows``, the row in the fleet's table of each
            flight whose motors have a fault or drift, by the entry's id; ``uncompared_ids`` of flights whose motors are
            still to be compared; ``baseline_vehicles``, names of the vehicles that have a baseline; and
            ``flights_to_compare``, the entry of the other flight, by the same id.
        """
        compared = self._library.compared_entries(entries)
        flights_to_compare = {}
        if may_read:
            anomalous_entries = [entry for entry in entries if entry.id in compared.anomalous_rows]
            flights_to_compare = self._visible_library.healthy_flights_to_compare_with(
                anomalous_entries
            )
        return {
            "entries": compared.entries,
            "anomalous_rows": compared.anomalous_rows,
            "uncompared_ids": compared.uncompared_ids,
            "baseline_vehicles": self._library.baseline_vehicles(),
            "flights_to_compare": flights_to_compare,
        }

    def flight(self, request: HttpRequest) -> Response:
        """Answers with the page of a flight, below the bar of the library with its downloads and settings.

        While the log is being read, or if it cannot be read, a page with this state and the plots that are ready is
        sent. A page with scripts of an unknown version, which would show no charts, is made anew. The query ``vehicle``
        chooses another vehicle of the log.

        Args:
            request: the request, with the id of the flight in its path.

        Returns:
            The page of the flight, or that of its progress.

        Raises:
            Refusal: there is no such flight, or the visitor may not see it.
        """
        entry = self._visible_library.entry(request, request.path_params["id"])
        values = self._visible_library.visitor_values(request) | {"flight": entry}
        vehicle = request.query_params.get("vehicle", "")
        path = self._page_path(entry, vehicle)
        # A log with a digest is stored here, with its page. The page of a log that `mavdem track` has read may be gone.
        is_stored = bool(entry.digest)
        if entry.stage != Stage.DONE or not (is_stored or path.is_file()):
            return self._page_without_results(entry, values)
        with refuse_missing_file():
            html = path.read_text("utf-8")
        if not (values["may_read"] or entry.log_shared):
            html = without_last_position(html)
        if is_stored and self._request_page_if_outdated(entry, html):
            entry = self._library.entry(entry.id)
            return self._page_without_results(entry, values | {"flight": entry})
        # The fleet judges the vehicle under which the log is listed, and not another one that the query names.
        if not vehicle:
            values |= self._values_of_comparison(entry, may_read=values["may_read"])
        has_recording = RECORDING_FILE in entry.file_names
        return HTMLResponse(
            with_toolbar(
                html,
                given_name=values["given"].flights.get(entry.content_hash, ""),
                has_baseline=entry.vehicle in self._library.baseline_vehicles(),
                follows_verdict=not vehicle,
                first_vehicle=self._vehicle_on_first_page(entry, html, vehicle),
                files=entry.file_names if is_stored else [],
                missing=RecordingRequests(self._library).missing_names(entry),
                can_open=self._has_viewer and has_recording and values["may_read"],
                **values,
            )
        )

    def _values_of_comparison(self, entry: LibraryEntry, *, may_read: bool) -> JsonValues:
        """Returns what the page of a flight shows of the comparison with the vehicle's other flights.

        Args:
            entry: index entry of the flight.
            may_read: whether the visitor may read all flights, and so gets links to others.

        Returns:
            Values by the names in the template: the ``anomaly`` of the motors, None without any; whether the comparison
            was made (``is_compared``); the entry with its verdict by that (``flight``); and the flights with links.
        """
        compared = self._library.compared_entries([entry])
        anomaly = motor_anomaly(compared.anomalous_rows.get(entry.id))
        [compared_entry] = compared.entries
        flights_with_links: JsonValues = {}
        if may_read:
            suggested_entry = self._flight_to_compare_with(entry, has_anomaly=anomaly is not None)
            if anomaly is not None and suggested_entry is not None:
                link = self._comparison_link(entry, suggested_entry)
                anomaly = anomaly._replace(comparison=link)
            flights_with_links = self._flights_beside(entry, suggested_entry)
        return {
            "anomaly": anomaly,
            "is_compared": not compared.uncompared_ids,
            "flight": compared_entry,
            **flights_with_links,
        }

    def _vehicle_on_first_page(self, entry: LibraryEntry, page: str, vehicle: str) -> str:
        """Returns the ids of system and component, such as "2:1", of the vehicle on the first page of a log.

        Args:
            entry: index entry of the log.
            page: HTML of the page that is shown.
            vehicle: the vehicle that the query names, such as "3_1"; if it is another one of the log, the shown page is
                not the first one.

        Returns:
            The ids; empty if the log has a single vehicle.

        Raises:
            Refusal: the first page is gone.
        """
        if not entry.other_vehicles:
            return ""
        if vehicle in entry.other_vehicles:
            with refuse_missing_file():
                page = self._page_path(entry, vehicle="").read_text("utf-8")
        return vehicle_id_on_page(page)

    def _flight_to_compare_with(
        self, entry: LibraryEntry, *, has_anomaly: bool
    ) -> LibraryEntry | None:
        """Returns the flight of the same vehicle with which one is best compared; None if the library has none.

        Args:
            entry: index entry of the flight.
            has_anomaly: whether its motors have a fault or drift, which shows beside a healthy flight only.
        """
        if not has_anomaly:
            return self._visible_library.flight_to_compare_with(entry)
        healthy_entries = self._visible_library.healthy_flights_to_compare_with([entry])
        return healthy_entries.get(entry.id)

    def _flights_beside(
        self, entry: LibraryEntry, suggested_entry: LibraryEntry | None
    ) -> JsonValues:
        """Returns the other flights to which the page of a flight has links.

        Args:
            entry: index entry of the flight.
            suggested_entry: the flight that it is best compared with; None if there is none.

        Returns:
            Values by the names in the template: the ``previous`` flight of the vehicle, its flights that are
            ``comparable``, and those ``of_other_vehicles``.
        """
        previous_entry = self._visible_library.previous_flight(entry)
        return {
            "previous": previous_entry,
            "comparable": self._visible_library.comparable_flights(entry, suggested_entry),
            "of_other_vehicles": self._visible_library.flights_of_other_vehicles(entry),
        }

    def _comparison_link(self, entry: LibraryEntry, other_entry: LibraryEntry) -> PageLink:
        """Returns the link from a flight with a motor anomaly to its comparison with another flight.

        Args:
            entry: index entry of the flight with the anomaly.
            other_entry: index entry of the other flight.
        """
        given_names = self._library.names.flights
        name = given_names.get(other_entry.content_hash, other_entry.name)
        return PageLink(f"Compare with {name}", f"/compare?a={other_entry.id}&b={entry.id}")

    def _page_without_results(self, entry: LibraryEntry, template_values: JsonValues) -> Response:
        """Returns the page of a flight that has no results (yet): how far its log is read, or why it cannot be.

        It also shows the first plots of the log, which are drawn before the log is judged, once they are there.

        Args:
            entry: index entry of the flight.
            template_values: further values for the template of the page, by their names in it.
        """
        # These plots are HTML made by this program, which must not be escaped.
        first_plots = Markup(self._library.first_plots(entry))
        html = render_server_page("flight", first_plots=first_plots, **template_values)
        return HTMLResponse(html)

    def _request_page_if_outdated(self, entry: LibraryEntry, html: str) -> bool:
        """Requests a new page of a flight if the stored one has a script that the server's security policy forbids.

        The policy lists the hashes of the scripts of this version of mavdem. A page that an earlier version wrote may
        have other scripts.

        Args:
            entry: index entry of the flight.
            html: the stored page.

        Returns:
            Whether a new page was requested; then the log waits to be read again.
        """
        if script_hashes_of_page(html) <= self._scripts:
            return False
        is_requested = self._library.request_new_page(entry)
        if is_requested:
            self._work_requested()
        return is_requested

    def viewer(self, request: HttpRequest) -> Response:
        """Answers with the page that shows the recording of a flight in Rerun's viewer.

        The page itself does not contain the recording. While it is visible, its script requests every half minute that
        the server keeps the viewer running, or starts it again. A server that cannot open recordings has no such page.

        Args:
            request: the request, with the id of the flight in its path.

        Returns:
            The page "viewer", whose security policy permits the viewer's program.

        Raises:
            Refusal: the visitor may not read, there is no such flight, it has no recording, or the server has no
                viewer.
        """
        self._rights.require(request, Permission.READ)
        entry = self._visible_library.entry(request, request.path_params["id"])
        if not self._has_viewer or RECORDING_FILE not in entry.file_names:
            raise Refusal(reason_without_file(entry, RECORDING_FILE))
        visitor = self._visible_library.visitor_values(request)
        # The name that a user gave to the flight, or else that of its file.
        given_name = visitor["given"].flights.get(entry.content_hash)
        return HTMLResponse(
            render_server_page(
                "viewer",
                flight=entry,
                name=given_name or entry.name,
                back=PageLink("Flight", f"/f/{entry.id}"),
                **visitor,
            ),
            headers={POLICY_HEADER: viewer_policy()},
        )

    def _page_path(self, entry: LibraryEntry, vehicle: str) -> Path:
        """Returns the path of a flight's page: in its folder of results, or among the pages of ``mavdem track``.

        Args:
            entry: index entry of the flight.
            vehicle: ``SYSTEM_COMPONENT`` of another vehicle of its log; if it has no page, the path of the log's page
                is returned.
        """
        if not entry.digest:
            # Only the name is used, since an index that was tampered with must not lead to other folders.
            return self._library.folder / PAGES / Path(entry.files).name
        page_name = vehicle_page_name(vehicle)
        if page_name not in entry.file_names:
            page_name = PAGE_FILE
        return self._library.results_folder(entry) / page_name

    async def file(self, request: HttpRequest) -> Response:
        """Answers with a result file of a flight by its name, or with its log, by the name ``log``.

        A recording that does not exist yet is made: the answer waits for it for ``MAX_RECORDING_WAIT``, and is then 202
        with the header Retry-After and the document on how far it is.
        """
        entry = await run_in_threadpool(
            self._visible_library.entry, request, request.path_params["id"]
        )
        name = request.path_params["name"]
        recordings = RecordingRequests(self._library)
        is_listed_recording = name in RECORDINGS and name in entry.file_names
        if is_listed_recording and request.method == "GET":
            entry = await run_in_threadpool(recordings.request, entry)
            self._work_requested()
            entry = await self._wait_for_recording(entry)
            if await run_in_threadpool(recordings.missing_names, entry):
                return recordings_answer(self._visible_library.recordings(entry))
        return await run_in_threadpool(self._file_response, request, entry, name)

    async def _wait_for_recording(self, entry: LibraryEntry) -> LibraryEntry:
        """Waits until the recordings of a flight are made or have failed, for a while at most.

        Args:
            entry: index entry of the flight.

        Returns:
            The entry as it is then.
        """
        recordings = RecordingRequests(self._library)
        deadline = time.monotonic() + MAX_RECORDING_WAIT
        if self._waiting_downloads >= MAX_WAITING_DOWNLOADS:
            return entry
        self._waiting_downloads += 1
        try:
            while time.monotonic() < deadline:
                stage = await run_in_threadpool(recordings.stage, entry)
                if stage in (Stage.DONE, Stage.FAILED):
                    break
                await asyncio.sleep(POLL_SECONDS)
                entry = await run_in_threadpool(self._library.entry, entry.id)
        finally:
            self._waiting_downloads -= 1
        return entry

    def _file_response(self, request: HttpRequest, entry: LibraryEntry, name: str) -> Response:
        """Returns the answer with a result file of a flight, or its log.

        Only files that the index lists are sent, whatever the URL names. Whoever requests the log needs the right to
        read all flights, unless its owner shares it with those who may see the flight.

        Args:
            request: the request, for the sender's rights.
            entry: index entry of the flight.
            name: name of the file, or ``log``.

        Raises:
            Refusal: the sender may not have the file, or there is none of this name.
        """
        # A log with a digest is stored in the library; others lie where `mavdem track` has read them.
        is_stored = bool(entry.digest)
        if name == "log":
            path = self._visible_library.log_path(request, entry)
            if not is_stored and path.is_file():
                # This path in the index may have been tampered with. So the file is sent only if it is a log:
                # ``detect_format`` raises an error for any other one.
                detect_format(path)
            name = entry.name
        elif is_stored and name in entry.file_names:
            path = self._library.results_folder(entry) / name
        else:
            raise Refusal(reason_without_file(entry, name))
        with refuse_missing_file():
            status = path.stat()
        # A folder or a device in the place of the file is not sent.
        if not S_ISREG(status.st_mode):
            raise Refusal(RefusalReason.NO_SUCH_FLIGHT)
        return FileResponse(
            path, media_type="application/octet-stream", filename=name, stat_result=status
        )

    def list_vehicles(self, request: HttpRequest) -> Response:
        """Answers with the table of all vehicles: how each is, its flights, its last flight, and what to do next.

        Raises:
            Refusal: the visitor may not read.
        """
        self._rights.require(request, Permission.READ)
        rows = self._library.rows_of_named_vehicles()
        visitor = self._visible_library.visitor_values(request)
        return HTMLResponse(
            vehicles_page(rows, unnamed_groups=self._visible_library.unnamed_groups(), **visitor)
        )

    def redirect_to_flights(self, request: HttpRequest) -> Response:
        """Redirects from ``/flights``, an address that users guess, to the list of flights at ``/``."""
        return RedirectResponse("/")

    def vehicle(self, request: HttpRequest) -> Response:
        """Answers with the page of a vehicle: its flights over time, and how the latest differs from the baseline.

        The baseline are the flights that the owner has marked as healthy.

        Args:
            request: the request, whose query ``name`` is the name of the vehicle in its logs.

        Returns:
            The page of the vehicle.

        Raises:
            Refusal: the visitor may not read, or the library has no flight of such a vehicle.
        """
        self._rights.require(request, Permission.READ)
        name = request.query_params.get("name", "")
        matches = self._library.find("vehicle = ?", [name], MAX_FILES, order=ListingOrder.FLIGHT)
        entries = matches.entries
        if not entries:
            raise Refusal(RefusalReason.NO_SUCH_FLIGHT)
        if all(entry.is_vehicle_unnamed for entry in entries):
            return self._page_of_unnamed_vehicles(request, name, entries)
        return self._page_of_vehicle(request, name, entries)

    def _page_of_vehicle(
        self, request: HttpRequest, name: str, entries: Sequence[LibraryEntry]
    ) -> Response:
        """Returns the page of a vehicle that its logs identify.

        Args:
            request: the request, for the rights of its sender.
            name: name of the vehicle in its logs.
            entries: index entries of its flights.
        """
        # A log may have several vehicles, so its rows in the fleet's table are filtered by the name, too.
        rows = [row for row in self._library.flight_rows(entries) if row.vehicle == name]
        healthy_rows = self._library.baseline_rows(name)
        # A flight has a row for each axis, all with the same key. A flight of the baseline may have been deleted since.
        healthy_flights = {content_hash(row.key) for row in healthy_rows}
        baseline_entries = [entry for entry in entries if entry.content_hash in healthy_flights]
        # Without a baseline, the flights that are compared are those that count as healthy until somebody names others.
        assumed_healthy = set() if healthy_rows else logs_taken_for_healthy(rows)
        healthy_entries = [entry for entry in entries if entry.content_hash in assumed_healthy]
        html = vehicle_page(
            group_by_vehicle(rows).get(name, []),
            _changes_from_baseline(name, rows, healthy_rows),
            healthy_flights or assumed_healthy,
            name=name,
            baseline_count=len(healthy_flights),
            baseline_entries=baseline_entries,
            healthy_entries=healthy_entries,
            **self._judged_flights(entries, may_read=True),
            **self._visible_library.visitor_values(request),
        )
        return HTMLResponse(html)

    def _page_of_unnamed_vehicles(
        self, request: HttpRequest, name: str, entries: Sequence[LibraryEntry]
    ) -> Response:
        """Returns the page on which a user assigns flights to vehicles, for logs that have only a MAVLink system id.

        Several vehicles may have the same id, so that this page, unlike that of a vehicle, shows no changes over its
        flights.

        Args:
            request: the request, for the rights of its sender.
            name: name that was made of the system id.
            entries: index entries of the flights.

        Returns:
            The page.
        """
        html = render_server_page(
            "unnamed_vehicles",
            name=name,
            **self._judged_flights(entries, may_read=True),
            **self._visible_library.visitor_values(request),
        )
        return HTMLResponse(html)

    def compare(self, request: HttpRequest) -> Response:
        """Answers with the comparison of two flights, whose ids are ``a`` and ``b`` in the query.

        The earlier flight is A, where both have dates. The page states what changed of the vehicle, by the fleet's rows
        of both flights, and which parameters were changed.

        Args:
            request: the request, with both ids in its query.

        Returns:
            The page of the comparison.

        Raises:
            Refusal: the visitor may not read, or there is no such flight.
        """
        self._rights.require(request, Permission.READ)
        entry_before = self._entry_with_results(request.query_params.get("a", ""))
        entry_after = self._entry_with_results(request.query_params.get("b", ""))
        # A is the earlier flight, so that a change for the worse is not presented as an improvement.
        if entry_before.date and entry_after.date and entry_after.date < entry_before.date:
            entry_before, entry_after = entry_after, entry_before
        # Before the verdicts are read: a comparison of motors that ends in between is then still called pending.
        uncompared_ids = self._library.compared_entries([entry_before, entry_after]).uncompared_ids
        reviewed = self._comparison(entry_before, entry_after)
        given_names = self._library.names.flights
        names = {}
        for entry in (entry_before, entry_after):
            names[entry.id] = given_names.get(entry.content_hash, entry.name)
        html = comparison_page(
            names=(names[entry_before.id], names[entry_after.id]),
            reviewed=reviewed,
            flights=(self._series(entry_before), self._series(entry_after)),
            addresses=(f"/f/{entry_before.id}", f"/f/{entry_after.id}"),
        )
        html = with_comparison_bar(
            html,
            [name for id, name in names.items() if id in uncompared_ids],
            **self._visible_library.visitor_values(request),
        )
        return HTMLResponse(html)

    def _entry_with_results(self, entry_id: str) -> LibraryEntry:
        """Returns the entry of a flight in the library's index.

        Args:
            entry_id: id of the flight in the library.

        Raises:
            Refusal: there is no such flight, or its log is still being read.
        """
        entry = self._library.entry(entry_id)
        if not entry.is_done:
            raise Refusal(RefusalReason.STILL_BEING_READ, name=entry.name)
        return entry

    def _comparison(
        self, entry_before: LibraryEntry, entry_after: LibraryEntry
    ) -> ReviewedDifference:
        """Compares two flights of the library, A and B: what was estimated of the vehicle in each, and the parameters.

        The library keeps all parameters of a flight that was uploaded to it, and in its index the gains of each flight.
        If it has all parameters of both flights, these are compared, and otherwise the gains. The page then states of
        which flight it has no more, and why.

        Args:
            entry_before: the flight A.
            entry_after: the flight B.
        """
        parameters_before = read_parameters(self._library.results_folder(entry_before))
        parameters_after = read_parameters(self._library.results_folder(entry_after))
        name_before, name_after = STATE_NAMES
        entries_without_parameters = {}
        if parameters_before is None:
            entries_without_parameters[name_before] = entry_before
        if parameters_after is None:
            entries_without_parameters[name_after] = entry_after
        if parameters_before is None or parameters_after is None:
            # Damaged parameters of the index count as not known.
            parameters_before = parse_parameters(entry_before.gains) or {}
            parameters_after = parse_parameters(entry_after.gains) or {}
        rows_before = self._rows_of_listed_vehicle(entry_before)
        rows_after = self._rows_of_listed_vehicle(entry_after)
        pair_before, pair_after = rows_judged_by_each_other(rows_before, rows_after)
        # All pages of a flight have the same verdict on its motors: that by all flights of the vehicle.
        rows_before = rows_with_known_health(rows_before, pair_before)
        rows_after = rows_with_known_health(rows_after, pair_after)
        reviewed = compared_states(
            self._compared_state(entry_before, rows_before, parameters_before),
            self._compared_state(entry_after, rows_after, parameters_after),
        )
        reviewed = reviewed._replace(motors_by_pair=motors_by_pair(rows_after, pair_after))
        return _with_reasons_for_missing_parameters(reviewed, entries_without_parameters)

    def _compared_state(
        self, entry: LibraryEntry, rows: FlightRows, parameters: Parameters
    ) -> ComparedState:
        """Returns what is compared of a flight: its rows, its review, and the given parameters of its autopilot.

        Args:
            entry: the flight.
            rows: its rows in the fleet's table, by the vehicle's name in the log.
            parameters: parameters of the autopilot by name.
        """
        review = self._visible_library.review(entry) or {}
        return ComparedState(self._library.names.rows_with_given_names(rows), review, parameters)

    def _series(self, entry: LibraryEntry) -> FlightSeries | None:
        """Returns the time series of a flight; None if an earlier version has read it, or its results are lost."""
        return read_series(self._library.results_folder(entry))

    def _rows_of_listed_vehicle(self, entry: LibraryEntry) -> FlightRows:
        """Returns the fleet's rows of a log, of the vehicle under which it is listed."""
        return [row for row in self._library.flight_rows([entry]) if row.vehicle == entry.vehicle]

    def script(self, request: HttpRequest) -> Response:
        """Answers with the JavaScript of the pages."""
        return Response(server_script(), media_type="text/javascript")

    def sample_log(self, request: HttpRequest) -> Response:
        """Answers with the sample log."""
        if self._sample_log is None:
            raise Refusal(RefusalReason.NO_SUCH_FLIGHT)
        return FileResponse(self._sample_log)
