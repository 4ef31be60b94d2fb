"""Endpoints of the server for programs: uploads, the list of flights and changes to it as JSON, progress as events."""

import asyncio
import json
import time
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from math import inf, isfinite
from pathlib import Path, PureWindowsPath
from typing import NamedTuple

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request as HttpRequest
from starlette.responses import JSONResponse, RedirectResponse, Response, StreamingResponse

from mavdem.containers import JsonValues
from mavdem.documents.document import Document
from mavdem.documents.library import (
    Added,
    Baseline,
    Change,
    Flights,
    LogFields,
    PlottedField,
    Progress,
    StoredBaseline,
    VehicleName,
    Viewer,
)
from mavdem.errors import Refusal
from mavdem.export.fields import extremes_of_intervals, samples_between
from mavdem.facts.serve import LimitedResource, Permission, RefusalReason, Sharing, Stage
from mavdem.report.pages.library_page import interface_words
from mavdem.results import RECORDING_FILE, REPORT_FILE
from mavdem.serve.field_store import FieldRequest, FieldStore
from mavdem.serve.index import COLUMNS, LibraryEntry
from mavdem.serve.openapi import openapi
from mavdem.serve.pages import FLIGHTS_PER_PAGE, recordings_answer
from mavdem.serve.reading_queue import QueuePlace, queue_places
from mavdem.serve.recordings import RecordingRequests, reason_without_file
from mavdem.serve.requests import (
    error_values,
    query_decimal,
    query_integer,
    query_number,
    read_document,
    valid_unicode,
)
from mavdem.serve.search import UNFINISHED_SQL, SqlCondition, search_hints
from mavdem.serve.uploads import MAX_FILES, UploadForm, receive_form, require_log_file
from mavdem.serve.viewers import RecordingViewer
from mavdem.serve.visible_library import VisibleLibrary

MAX_UPLOADS = 32
"""Uploads that are received at a time: each has a file open."""

MAX_PROGRESS_STREAMS = 100
"""Clients that watch the progress at a time: for each the index is asked five times a second."""

PROGRESS_SECONDS = 0.2
"""Seconds between looks at the progress of logs: the first plots come within a second."""

PROGRESS_KEYS = ("step", "share", "has_plots")
"""Keys of the progress file that are given to those who wait as they are."""

MAX_WAITING_LOGS = 5000
"""Logs that wait to be read, at most: hours of work."""

FIELD_INTERVALS = 1000
"""Intervals of a plotted field of which the extremes are sent: a plot is about 1000 pixels wide."""

MAX_FIELD_INTERVALS = 20_000
"""Intervals that may be requested, at most: an answer of about a megabyte."""

MAX_NOTE_LETTERS = 4000
"""Letters of a note, as the model ``Change`` allows; further ones of an upload's description are dropped."""

MAX_NAME_LETTERS = 200
"""Letters of the name of an uploaded log that are kept."""


class _EntryWithLog(NamedTuple):
    """A listed flight and the file that it was read from."""

    entry: LibraryEntry
    """The flight, as the library lists it."""

    log: Path
    """Path of its log, which exists."""


class _ProgressOfFlights(NamedTuple):
    """How far the server has read and judged some flights."""

    progress_by_id: dict[str, Progress]
    """The progress of each flight by its id, in the order in which the flights are listed."""

    unfinished_ids: list[str]
    """Ids of the flights without a final verdict: their logs are being read, or their motors are to be compared."""


class Api:
    """Endpoints that answer programs and the JavaScript of the pages.

    Each takes a request and returns the answer. Each raises ``Refusal`` where the sender has no right to it, or what is
    requested does not exist.
    """

    def __init__(
        self,
        visible: VisibleLibrary,
        work_requested: Callable[[], None],
        viewer: RecordingViewer | None,
        fields: FieldStore,
    ) -> None:
        """Stores the library, the viewer and the columns of logs on which the endpoints work.

        Args:
            visible: the library, with the access rights.
            work_requested: function that is called after logs were added to the library, recordings were requested, or
                a baseline was changed.
            viewer: shows recordings in a viewer on this machine; None if that is not possible.
            fields: the columns of the logs whose fields are plotted.
        """
        self._visible_library = visible
        self._library = visible.library
        self._rights = visible.rights
        self._work_requested = work_requested
        self._viewer = viewer
        self._fields = fields
        self._uploads = 0
        self._progress_streams = 0

    # Uploads

    async def upload(self, request: HttpRequest) -> Response:
        """Takes an upload as Flight Review does: the answer redirects to the page of the flight, and has no body."""
        added = await self._receive_logs(request)
        return RedirectResponse(f"/f/{added.flights[0].id}", 302)

    async def add_logs(self, request: HttpRequest) -> Response:
        """Takes an upload, and answers with the flights that were added and the files that were refused."""
        added = await self._receive_logs(request)
        return JSONResponse(added.as_dict(), 201)

    async def _receive_logs(self, request: HttpRequest) -> Added:
        """Receives the logs of an upload and adds them to the library.

        Two limits protect the server before it receives anything: the number of uploads at the same time, and the
        number of logs that still wait to be read.

        Raises:
            Refusal: the sender may not upload, one of the limits is reached, or the upload has no log that can be
                added.
        """
        self._rights.require(request, Permission.UPLOAD)
        # The number of rows that match, without the rows themselves.
        _, waiting_logs = await run_in_threadpool(
            self._library.find, "stage = ?", [Stage.WAITING], 0
        )
        if self._uploads >= MAX_UPLOADS:
            raise Refusal(
                RefusalReason.UPLOADS_TOO_MANY, count=self._uploads, name=LimitedResource.UPLOADS
            )
        if waiting_logs >= MAX_WAITING_LOGS:
            raise Refusal(
                RefusalReason.UPLOADS_TOO_MANY, count=waiting_logs, name=LimitedResource.LOGS
            )
        self._uploads += 1
        try:
            form = await receive_form(request, self._library)
        finally:
            self._uploads -= 1
        return await run_in_threadpool(self._add_logs_of_form, form, request)

    def _add_logs_of_form(self, form: UploadForm, request: HttpRequest) -> Added:
        """Moves the logs of an upload into the library, and deletes all other files that came with it.

        A file that is no log does not stop the others: it is listed with the reason. If the library has the same log
        already, its flight is kept; a sender who may change flights then widens its sharing and adds a missing note.

        Args:
            form: the received files, which lie in a temporary folder, and the text fields of the form.
            request: the request, for the sender's rights and for its path, which may select the sharing.

        Returns:
            The flights that were added or already there, and the refused files with the reasons.

        Raises:
            Refusal: none of the files is a log; the disk is full; or the flight was deleted in the meantime.
        """
        columns = _columns_of_form(form.fields, request.url.path)
        flights = []
        refused_files = []
        try:
            for path, file in form.files.items():
                # A browser sends a file without name and content for a file field that was left blank.
                if not file.size and not file.filename:
                    continue
                # Some browsers send the whole path of the file on their machine.
                file_name = PureWindowsPath(valid_unicode(file.filename or "")).name
                name = file_name[:MAX_NAME_LETTERS] or "log"
                try:
                    flights.append(self._add_log(path, name, columns, request))
                except Refusal as error:
                    # A full disk or a deleted flight concerns the whole request, not this file.
                    if isinstance(error.fact.code, RefusalReason):
                        raise
                    refused_files.append((name, error.fact.replace(path=name)))
        finally:
            form.remove_files()
        if not flights:
            first_reason = refused_files[0][1]
            raise Refusal(first_reason)
        # This wakes the background reading.
        self._work_requested()
        refused_logs = [{"name": name, "error": error_values(fact)} for name, fact in refused_files]
        return Added(flights=self._visible_library.documents(flights), refused=refused_logs)

    def _add_log(
        self, path: Path, name: str, columns: JsonValues, request: HttpRequest
    ) -> LibraryEntry:
        """Moves one file of an upload into the library, if it is a log.

        Args:
            path: path of the received file.
            name: name of the log that users see.
            columns: values that the form sets in the index: ``note``, ``keep`` and perhaps ``sharing``.
            request: the request, for the sender's rights.

        Returns:
            The index entry of the log, which the library may have had already.

        Raises:
            Refusal: the file is no log, the disk is full, or the flight was deleted in the meantime.
        """
        require_log_file(path, name)
        entry = self._library.add(path, name, **columns)
        if not self._rights.allows(request, Permission.WRITE):
            return entry
        sharing = columns.get("sharing", Sharing.PRIVATE)
        return self._library.widen_sharing(entry, sharing, columns["note"])

    # Flights

    def list_flights(self, request: HttpRequest) -> Response:
        """Answers with the flights that a search finds, ``limit`` of them from ``offset``.

        Raises:
            Refusal: a word of the search has a wrong value, or names no known property and nothing is found.
        """
        limit = min(query_number(request, "limit", FLIGHTS_PER_PAGE), MAX_FILES)
        result = self._visible_library.search(request, limit)
        hints = search_hints(result.query, is_nothing_found=not result.total)
        if hints:
            raise Refusal(RefusalReason.SEARCH_NOT_UNDERSTOOD, reason="; ".join(hints))
        flights = self._visible_library.documents(result.entries)
        return _json(Flights(total=result.total, flights=flights))

    def flight(self, request: HttpRequest) -> Response:
        """Answers with a flight and the document of its review, both judged also by the vehicle's other flights."""
        entry = self._visible_library.entry(request, request.path_params["id"])
        (flight,) = self._visible_library.documents([entry])
        review = self._visible_library.judged_review(entry)
        return JSONResponse({"flight": flight.as_dict(), "review": review})

    async def change_flight(self, request: HttpRequest) -> Response:
        """Changes what users say of a flight, such as its name, or that its fault was repaired; answers with it."""
        self._rights.require(request, Permission.WRITE)
        change = await read_document(request, Change)
        columns = change.model_dump(mode="json", exclude_unset=True)
        if "tags" in columns:
            columns["tags"] = ",".join(columns["tags"])
        given_name = columns.pop("given_name", None)
        vehicle_name = columns.pop("vehicle_name", None)
        is_repaired = columns.pop("repaired", None)
        id = request.path_params["id"]
        if vehicle_name is not None:
            entry = await run_in_threadpool(self._library.entry, id)
            await run_in_threadpool(self._library.assign_vehicle, entry, vehicle_name)
        entry = await run_in_threadpool(self._library.change, id, **columns)
        if is_repaired is not None:
            entry = await run_in_threadpool(
                self._library.state_repair, entry, is_repaired=is_repaired
            )
        if given_name is not None:
            await run_in_threadpool(self._library.name_flight, entry, given_name)
        (flight,) = await run_in_threadpool(self._visible_library.documents, [entry])
        return _json(flight)

    def delete_flight(self, request: HttpRequest) -> Response:
        """Deletes a flight with its log, its results and the columns that were read from it; the answer has no body.

        Args:
            request: the request, with the id of the flight in its path.

        Returns:
            A response without a body (status 204).

        Raises:
            Refusal: the sender may not change flights, or there is no such flight.
        """
        self._rights.require(request, Permission.WRITE)
        id = request.path_params["id"]
        log = self._library.log_path(self._library.entry(id))
        self._library.delete(id)
        self._fields.remove(log)
        return Response(status_code=204)

    def recordings(self, request: HttpRequest) -> Response:
        """Answers with how far the recordings of a flight are."""
        entry = self._visible_library.entry(request, request.path_params["id"])
        return _json(self._visible_library.recordings(entry))

    def make_recordings(self, request: HttpRequest) -> Response:
        """Has the recordings of a flight made, unless they exist or are being made; answers with how far they are."""
        entry = self._visible_library.entry(request, request.path_params["id"])
        entry = RecordingRequests(self._library).request(entry)
        self._work_requested()
        return recordings_answer(self._visible_library.recordings(entry))

    def fields(self, request: HttpRequest) -> Response:
        """Answers with the messages of a flight's log, their fields and instances, all of which can be plotted."""
        entry, log = self._entry_with_log(request)
        vehicle = request.query_params.get("vehicle", "")
        messages = self._fields.messages(log, vehicle, self._document_of_page(entry))
        return _json(LogFields.model_validate({"id": entry.id, "messages": messages}))

    def samples(self, request: HttpRequest) -> Response:
        """Answers with one field of a flight's log over time, for a plot.

        A plot of ``points`` pixels can show a minimum and a maximum for each pixel. If there are more samples than
        these, the answer has only the minimum and maximum of each of ``points`` intervals, so that no peak is lost.

        Args:
            request: its query has ``message`` and ``field``; and where wanted ``instance`` (of several equal sensors),
                ``boot`` (number of the autopilot's boot, from 0), ``vehicle`` (``SYSTEM_COMPONENT``), ``start`` and
                ``end`` (s), and ``points``.

        Returns:
            A ``PlottedField`` as JSON: times, values, and how many samples the log has; NaN and infinity become null.

        Raises:
            Refusal: the sender may not have the log, it has no such field, or a number of the query is none.
        """
        entry, log = self._entry_with_log(request)
        query = request.query_params
        field_request = FieldRequest(
            message=query.get("message", ""),
            field=query.get("field", ""),
            instance=query_integer(request, "instance"),
            boot=query_integer(request, "boot") or 0,
            vehicle=query.get("vehicle", ""),
        )
        start = query_decimal(request, "start", -inf)
        end = query_decimal(request, "end", inf)
        requested_intervals = query_number(request, "points", FIELD_INTERVALS)
        intervals = min(max(requested_intervals, 1), MAX_FIELD_INTERVALS)
        all_samples = self._fields.samples(log, field_request, self._document_of_page(entry))
        samples = samples_between(all_samples, start, end)
        # Each interval has two samples in the plot, its minimum and its maximum.
        is_thinned = len(samples.time) > 2 * intervals
        plotted_samples = extremes_of_intervals(samples, intervals) if is_thinned else samples
        # JSON has no infinity and no NaN.
        values = [value if isfinite(value) else None for value in plotted_samples.values.tolist()]
        return _json(
            PlottedField(
                message=field_request.message,
                field=field_request.field,
                instance=field_request.instance,
                count=len(samples.time),
                is_thinned=is_thinned,
                time=plotted_samples.time.tolist(),
                values=values,
            )
        )

    def _entry_with_log(self, request: HttpRequest) -> _EntryWithLog:
        """Returns the flight that a request names in its path, and the path of its log.

        Args:
            request: the request, with the id of the flight in its path.

        Raises:
            Refusal: the sender may not have the log, or its file is missing.
        """
        entry = self._visible_library.entry(request, request.path_params["id"])
        log = self._visible_library.log_path(request, entry)
        if not log.is_file():
            raise Refusal(RefusalReason.NO_SUCH_FLIGHT)
        return _EntryWithLog(entry, log)

    def _document_of_page(self, entry: LibraryEntry) -> Path | None:
        """Returns the path of the document that was written with a flight's page; None for a log without results."""
        return self._library.results_folder(entry) / REPORT_FILE if entry.digest else None

    def open_viewer(self, request: HttpRequest) -> Response:
        """Opens the recording of a flight in a viewer on this machine, and answers with the address of its page.

        A recording that does not exist yet is made first; until it is complete, each call answers with its progress.

        Args:
            request: the request, with the id of the flight in its path.

        Returns:
            JSON with the addresses of the viewer, or with the progress of the recording.

        Raises:
            Refusal: the sender may not start programs here, there is no such flight, or it has no recording.
        """
        self._rights.require(request, Permission.WRITE)
        entry = self._visible_library.entry(request, request.path_params["id"])
        if self._viewer is None or RECORDING_FILE not in entry.file_names:
            raise Refusal(reason_without_file(entry, RECORDING_FILE))
        recording = self._library.results_folder(entry) / RECORDING_FILE
        if not recording.is_file():
            return self.make_recordings(request)
        data_address = self._viewer.open(recording)
        page_address = f"{str(request.base_url).rstrip('/')}/f/{entry.id}/viewer"
        return _json(Viewer(address=page_address, data_address=data_address))

    async def set_baseline(self, request: HttpRequest) -> Response:
        """Sets the healthy flights with which others are compared, and answers with them and a caution.

        The caution says which of them have motors to be watched; it is empty if none have.
        """
        self._rights.require(request, Permission.WRITE)
        baseline = await read_document(request, Baseline)
        caution = await run_in_threadpool(self._library.set_baseline, baseline.flights)
        self._work_requested()
        caution_text = "" if caution is None else caution.sentence_and_remedy
        return _json(StoredBaseline(flights=baseline.flights, caution=caution_text))

    async def remove_baseline(self, request: HttpRequest) -> Response:
        """Removes the baseline of the vehicle whose name in its logs is ``vehicle`` in the query."""
        self._rights.require(request, Permission.WRITE)
        vehicle = request.query_params.get("vehicle", "")
        await run_in_threadpool(self._library.remove_baseline, vehicle)
        self._work_requested()
        return Response(status_code=204)

    async def name_vehicle(self, request: HttpRequest) -> Response:
        """Gives a name to a vehicle, and answers with the name as it is stored."""
        self._rights.require(request, Permission.WRITE)
        change = await read_document(request, VehicleName)
        name = await run_in_threadpool(self._library.name_vehicle, change.vehicle, change.name)
        return _json(VehicleName(vehicle=change.vehicle, name=name))

    def describe(self, request: HttpRequest) -> Response:
        """Answers with the OpenAPI description of these endpoints."""
        return JSONResponse(openapi())

    # Progress

    async def progress(self, request: HttpRequest) -> Response:
        """Answers with a stream of server-sent events on the progress of reading logs, for the progress bars of pages.

        The query ``id`` chooses one flight, which whoever may see it may follow. Without it the stream is about all
        unfinished flights, and needs the right to read.

        Raises:
            Refusal: the sender may not see this, there is no such flight, or too many streams are open.
        """
        id = request.query_params.get("id")
        if id is None:
            self._rights.require(request, Permission.READ)
            condition = SqlCondition(UNFINISHED_SQL)
        else:
            # This also checks that the sender may see the flight.
            entry = await run_in_threadpool(self._visible_library.entry, request, id)
            condition = SqlCondition("id = ?", (entry.id,))
        if self._progress_streams >= MAX_PROGRESS_STREAMS:
            count = self._progress_streams
            raise Refusal(
                RefusalReason.UPLOADS_TOO_MANY, count=count, name=LimitedResource.WATCHERS
            )
        events = self._progress_events(request, condition)
        return StreamingResponse(events, media_type="text/event-stream")

    async def _progress_events(
        self, request: HttpRequest, condition: SqlCondition
    ) -> AsyncIterator[str]:
        """Yields an event whenever the progress of flights has changed, until all are done and have final verdicts.

        The final verdict comes a moment after a flight is done, when its motors have been compared with the vehicle's
        other flights.

        Args:
            request: the stream ends when its client disconnects.
            condition: condition of the flights. A flight is followed until it is done, even if the condition, such as
                being unfinished, does not hold any more.

        Yields:
            Events with a JSON list of the changed ``Progress`` documents; at the end the event ``end``.
        """
        unfinished_ids = list[str]()
        previous_progress = dict[str, Progress]()
        is_followed = f"({condition.expression}) or id in (select value from json_each(?))"
        self._progress_streams += 1
        try:
            while not await request.is_disconnected():
                condition_values = (*condition.values, json.dumps(unfinished_ids))
                matches = await run_in_threadpool(
                    self._library.find, is_followed, condition_values, MAX_FILES
                )
                current = await run_in_threadpool(self._progress_of_all, matches.entries)
                unfinished_ids = current.unfinished_ids
                changes = [
                    progress.as_dict()
                    for id, progress in current.progress_by_id.items()
                    if progress != previous_progress.get(id)
                ]
                previous_progress = current.progress_by_id
                if changes:
                    yield f"data: {json.dumps(changes)}\n\n"
                if not unfinished_ids:
                    break
                await asyncio.sleep(PROGRESS_SECONDS)
        except asyncio.CancelledError:
            # The server is ending.
            return
        finally:
            self._progress_streams -= 1
        yield "event: end\ndata: \n\n"

    def _progress_of_all(self, entries: Sequence[LibraryEntry]) -> _ProgressOfFlights:
        """Returns how far the server has read and judged each of some flights, for the list of flights in a browser.

        Args:
            entries: index entries of the flights, with the verdicts that follow from each log alone.

        Returns:
            The progress of each flight, and the ids of those without a final verdict. A flight that was read has the
            verdict that pages show, to which the comparison of its motors with the vehicle's other flights belongs.
        """
        read_entries = [entry for entry in entries if entry.is_done]
        compared = self._library.compared_entries(read_entries)
        shown_entries = {entry.id: entry for entry in compared.entries}
        # A thousand logs may wait: one query finds the places of all in the queue.
        are_all_read = len(read_entries) == len(entries)
        places_in_queue = {} if are_all_read else queue_places(self._library)
        progress_by_id = {}
        unfinished_ids = []
        for entry in entries:
            shown_entry = shown_entries.get(entry.id, entry)
            progress_by_id[entry.id] = self._flight_progress(shown_entry, places_in_queue)
            is_verdict_final = entry.is_done and entry.id not in compared.uncompared_ids
            if not is_verdict_final:
                unfinished_ids.append(entry.id)
        return _ProgressOfFlights(progress_by_id, unfinished_ids)

    def _flight_progress(
        self, entry: LibraryEntry, places_in_queue: Mapping[str, QueuePlace]
    ) -> Progress:
        """Returns the progress of a flight: its index entry, its place in the queue, and what its worker has reported.

        While a log is read, its process reports into a file, and the index is updated only at the end. So where the
        file has a value for a column of the index, such as the stage, it replaces the value of the entry.

        Args:
            entry: index entry of the flight.
            places_in_queue: place in the queue of each log that waits or is read, by its id.

        Returns:
            The progress, with the stage in words and, once the log is read, the seconds since reading began.
        """
        # A log that a worker claimed after the places were listed has none.
        queue_place = places_in_queue.get(entry.id, QueuePlace())
        reading_progress: JsonValues = {}
        if entry.stage != Stage.WAITING and not entry.is_done:
            reported_progress = self._library.progress(entry)
            entry = replace(entry, **_values_of_keys(reported_progress, COLUMNS))
            reading_progress = _values_of_keys(reported_progress, PROGRESS_KEYS)
            # The UNIX time at which reading began, s.
            reading_start = reported_progress.get("started")
            if reading_start is not None:
                reading_progress["seconds"] = round(time.time() - reading_start)
        stage_in_words = interface_words()["stages"][entry.stage]
        # The fields of the document have the same names as those of the entry, the queue place and the progress file.
        return Progress.from_results(
            entry, words=stage_in_words, **queue_place._asdict(), **reading_progress
        )


def _values_of_keys(values: JsonValues, keys: Iterable[str]) -> JsonValues:
    """Returns the values of these keys, without the keys that are missing."""
    return {key: values[key] for key in keys if key in values}


def _columns_of_form(fields: dict[str, str], path: str) -> JsonValues:
    """Returns the values that an upload form sets in the index for its logs.

    Args:
        fields: fields of the form, as Flight Review has them: ``description`` and ``public``; and ``keep``, which
            decides whether a log that cannot be read is kept.
        path: path of the URL. Logs that are sent to Flight Review's address ``…/upload`` can be seen by everyone with
            the link, or are public, as there; other logs are private.
    """
    columns: JsonValues = {
        "note": valid_unicode(fields.get("description", ""))[:MAX_NOTE_LETTERS],
        "keep": int(fields.get("keep", "false").lower() == "true"),
    }
    if path.endswith("/upload"):
        is_public = fields.get("public", "").lower() in ("true", "1", "on")
        columns["sharing"] = Sharing.PUBLIC if is_public else Sharing.LINK
    return columns


def _json(document: Document) -> Response:
    """Returns the answer with a JSON document."""
    return JSONResponse(document.as_dict())
