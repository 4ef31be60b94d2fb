"""The application: what each address of the server answers."""

import asyncio
import inspect
import json
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import replace
from functools import cache, cached_property
from pathlib import Path, PureWindowsPath
from stat import S_ISREG
from typing import Any, TypeVar
from urllib.parse import parse_qs

from pydantic import ValidationError
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect
from starlette.requests import Request as HttpRequest
from starlette.responses import (
    FileResponse,
    HTMLResponse,
    JSONResponse,
    RedirectResponse,
    Response,
    StreamingResponse,
)
from starlette.routing import Route

from mavdem.containers import JsonValues, group_by
from mavdem.documents import whole
from mavdem.documents.document import Document
from mavdem.documents.library import Added, Baseline, Change, Flight, Flights, Progress, Viewer
from mavdem.errors import Refusal
from mavdem.facts import Fact
from mavdem.facts.serve import Crowd, Request, Sharing, Stage, Use
from mavdem.fleet.difference import (
    baseline_differences,
    changed_parameters,
    states_without_gains,
    vehicle_difference,
)
from mavdem.fleet.flights import vehicles_of, worst_row
from mavdem.fleet.row import FlightRow
from mavdem.fleet.workers import PAGES, POLL_SECONDS
from mavdem.ingest.formats import detect_format
from mavdem.report.difference import baseline_blocks
from mavdem.report.fleet import TROUBLED_HEALTHS
from mavdem.report.pages.difference_page import comparison_page
from mavdem.report.pages.library_page import (
    interface_words,
    refusal_page,
    render_server_page,
    script,
    script_hashes,
    vehicle_page,
    with_bar,
    without_policy,
)
from mavdem.report.pages.page import PageLink
from mavdem.results import PAGE_FILE, RECORDING_FILE, REPORT_FILE
from mavdem.serve.attached import PAGE_SECONDS, Attached
from mavdem.serve.library import Entry, Library
from mavdem.serve.openapi import TABLE, openapi
from mavdem.serve.rights import COOKIE, Rights
from mavdem.serve.search import WORKING, SqlCondition, condition_of
from mavdem.serve.uploads import MOST_FILES, MOST_TEXT, Form, pieces, received
from mavdem.serve.work import Work

PAGE_LENGTH = 100  # flights
MOST_UPLOADS = 32  # at a time: each has a file open
MOST_WATCHERS = 100  # of progress: each asks the index twice a second
MOST_WAITING = 5000  # logs: hours of work
POLICY = (
    "default-src 'none'; script-src 'self' {scripts}; style-src 'unsafe-inline'; img-src data:; connect-src 'self'; "
    "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
"""No script but the server's own and those of a flight's page, no frame, nothing from elsewhere."""
STATUS = TABLE["status"]
"""Of what is refused; 400 of other requests, and 415 of what is no log."""

Model = TypeVar("Model", bound=Document)
Endpoint = Callable[[HttpRequest], Awaitable[Response]]


class Server:
    """Answers requests about a ``library``, whose logs ``work`` reads, by the ``rights`` of those who ask.

    ``sample`` is a flight to try it with; ``show`` opens a recording in a viewer and returns its address; ``live`` is a
    link that the server is attached to.
    """

    def __init__(
        self,
        library: Library,
        rights: Rights,
        work: Work,
        sample: Path | None = None,
        show: Callable[[Path], str] | None = None,
        live: Attached | None = None,
    ) -> None:
        self.library = library
        self.rights = rights
        self.work = work
        self._sample = sample
        self._show = show
        self._live = live
        self._uploads = 0
        self._watchers = 0

    @cached_property
    def app(self) -> Starlette:
        """The application."""
        routes = {
            "GET /": self._list_page,
            "GET /f/{id}": self._flight_page,
            "GET /f/{id}/{name}": self._file,
            "GET /live": self._live_page,
            "GET /vehicle": self._vehicle_page,
            "GET /compare": self._compare_page,
            "GET /enter": self._enter_page,
            "POST /enter": self._enter,
            "POST /leave": self._leave,
            "GET /static/serve.js": self._script,
            "POST /upload": self._upload,
            "POST /{key}/upload": self._upload,
            "POST /api/logs": self._add,
            "GET /static/sample": self._sample_log,
            "GET /api/flights": self._flights,
            "GET /api/flights/{id}": self._flight,
            "PATCH /api/flights/{id}": self._change,
            "DELETE /api/flights/{id}": self._delete,
            "POST /api/flights/{id}/viewer": self._viewer,
            "PUT /api/baseline": self._baseline,
            "GET /api/progress": self._progress,
            "GET /api/openapi.json": self._openapi,
        }
        return Starlette(
            routes=[
                Route(path, self._guarded(endpoint), methods=[method])
                for key, endpoint in routes.items()
                for method, path in [key.split()]
            ],
            lifespan=self._lifespan,
            exception_handlers={Exception: self._failed},
        )

    @asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        _headers()  # compiles the pages, too: whoever asks first should not wait for that
        self.work.start()
        if self._live is not None:
            self._live.start()
        yield
        if self._live is not None:
            await run_in_threadpool(self._live.stop)
        await run_in_threadpool(self.work.stop)
        self.library.close()

    def _guarded(self, endpoint: Callable[[HttpRequest], Any]) -> Endpoint:
        """An endpoint, also one that is a plain function, whose refusals become answers."""

        async def answer(request: HttpRequest) -> Response:
            try:
                self.rights.check_site(request)
                if inspect.iscoroutinefunction(endpoint):
                    response = await endpoint(request)
                else:
                    response = await run_in_threadpool(endpoint, request)
            except Refusal as error:
                response = await run_in_threadpool(self._refused, request, error.fact)
            except ClientDisconnect:
                response = Response(status_code=400)
            except asyncio.CancelledError:  # the server ends
                response = Response(status_code=503, headers={"Retry-After": "10"})
            response.headers.update(_headers())
            return response

        return answer

    def _failed(self, request: HttpRequest, error: Exception) -> Response:
        """The answer where a defect, or a damaged folder, left none: the error is raised again, and printed."""
        return self._refused(request, Fact(Request.ANSWER_FAILED, because=type(error).__name__))

    def _refused(self, request: HttpRequest, fact: Fact) -> Response:
        status = STATUS.get(fact.code, 400 if isinstance(fact.code, Request) else 415)
        headers = _headers() | ({"Retry-After": "10"} if status == 503 else {})
        path = request.scope["path"]  # of its url, a Host that is no address makes an error
        if path.startswith("/api/") or path.endswith("/upload"):
            return JSONResponse(whole("error", {"error": _error(fact)}), status, headers)
        asks = fact.code is Request.NO_RIGHT
        return HTMLResponse(refusal_page(fact, asks, **self._known(request)), status, headers)

    def _seen(self, request: HttpRequest) -> Entry:
        """The flight of a link, for one who may see it."""
        entry = self.library.entry(request.path_params["id"])
        if not self.rights.may_see(request, entry):
            # nor may one know that it is there
            raise Refusal(Request.NO_SUCH_FLIGHT)
        return entry

    def _known(self, request: HttpRequest) -> JsonValues:
        """What every page knows: who reads it, and where the server is."""
        may_read = self.rights.may(request, Use.READ)
        address = str(request.base_url).rstrip("/")
        key = self.rights.key(Use.UPLOAD)
        return {
            "may_read": may_read,
            "key": self.rights.key(Use.WRITE) if may_read else "",
            "has_token": bool(self.rights.token),
            "address": address,
            "upload": f"{address}{f'/{key}' if key else ''}/upload" if may_read else "",
        }

    # Pages

    def _found(
        self, request: HttpRequest, most: int, limit: int
    ) -> tuple[list[Entry], int, str, int]:
        """The flights that were asked for and may be listed, their number, the search and where it begins."""
        query = request.query_params.get("q", "")[:500]
        offset = _whole_number(request, "offset", 0)
        where, values = condition_of(query)
        if not self.rights.may(request, Use.READ):
            where = f"sharing = '{Sharing.PUBLIC}' and {where}"
        entries, total = self.library.find(where, values, min(limit, most), offset)
        return entries, total, query, offset

    def _troubles(self, entries: Sequence[Entry]) -> dict[str, FlightRow]:
        """The worst row of each flight that differs from others of its vehicle, by the flight's id."""
        by_path = {str(self.library.path_of(entry)): entry for entry in entries}
        troubled = [
            row
            for row in self.library.rows_of(entries)
            if row.health in TROUBLED_HEALTHS and row.vehicle == by_path[row.file].vehicle
        ]
        by_file = group_by(troubled, lambda row: row.file)
        return {by_path[file].id: worst_row(rows) for file, rows in by_file.items()}

    def _list_page(self, request: HttpRequest) -> Response:
        entries, total, query, offset = self._found(request, PAGE_LENGTH, PAGE_LENGTH)
        visitor = self._known(request)
        return HTMLResponse(
            render_server_page(
                "library",
                entries=entries,
                total=total,
                query=query,
                offset=offset,
                page=PAGE_LENGTH,
                is_empty=not entries and not query and not offset,
                sample=self._sample,
                is_live=self._live is not None,
                vehicles=self.library.vehicles() if visitor["may_read"] else [],
                troubles=self._troubles(entries) if visitor["may_read"] else {},
                **visitor,
            )
        )

    def _flight_page(self, request: HttpRequest) -> Response:
        entry = self._seen(request)
        values = self._known(request) | {"one": entry}
        wanted = request.query_params.get("vehicle", "")
        other = f"vehicle_{wanted}.html"
        own = self.library.results_of(entry) / (other if other in entry.file_names else PAGE_FILE)
        path = own if entry.digest else self.library.folder / PAGES / Path(entry.files).name
        if entry.stage != Stage.DONE or not (entry.digest or path.is_file()):
            return HTMLResponse(render_server_page("flight", **values))
        if values["may_read"] and not wanted:
            values["trouble"] = self._troubles([entry]).get(entry.id)
        with gone_refused():
            page = path.read_text("utf-8")
        return HTMLResponse(
            with_bar(
                page,
                files=entry.file_names if entry.digest else [],
                can_open=self._show and RECORDING_FILE in entry.file_names and values["may_read"],
                **values,
            )
        )

    def _file(self, request: HttpRequest) -> Response:
        entry = self._seen(request)
        name = request.path_params["name"]
        if name == "log":
            if not entry.log_shared and not self.rights.may(request, Use.READ):
                raise Refusal(Request.NO_RIGHT, name=Use.DOWNLOAD)
            path = self.library.path_of(entry)
            if not entry.digest and path.is_file():
                detect_format(path)  # whatever an altered index says, only logs are given out
            name = entry.name
        elif entry.digest and name in entry.file_names:
            path = self.library.results_of(entry) / name
        else:
            raise Refusal(Request.NO_SUCH_FLIGHT)
        with gone_refused():
            there = path.stat()
        if not S_ISREG(there.st_mode):
            raise Refusal(Request.NO_SUCH_FLIGHT)
        kind = "application/octet-stream"
        return FileResponse(path, media_type=kind, filename=name, stat_result=there)

    def _live_page(self, request: HttpRequest) -> Response:
        self.rights.need(request, Use.READ)
        if self._live is None:
            raise Refusal(Request.NO_SUCH_FLIGHT)
        return HTMLResponse(self._live.page, headers={"Refresh": f"{PAGE_SECONDS:g}"})

    def _vehicle_page(self, request: HttpRequest) -> Response:
        self.rights.need(request, Use.READ)
        name = request.query_params.get("name", "")
        entries, _ = self.library.find("vehicle = ?", [name], MOST_FILES)
        if not entries:
            raise Refusal(Request.NO_SUCH_FLIGHT)
        rows = [row for row in self.library.rows_of(entries) if row.vehicle == name]
        healthy = [row for row in self.library.store.healthy if row.vehicle == name]
        change = baseline_differences(rows, healthy).get(name) if healthy else None
        return HTMLResponse(
            vehicle_page(
                vehicles_of(rows).get(name, []),
                baseline_blocks(*change) if change else (),
                name=name,
                entries=entries,
                baseline=len({row.key for row in healthy}),
                troubles=self._troubles(entries),
                **self._known(request),
            )
        )

    def _compare_page(self, request: HttpRequest) -> Response:
        self.rights.need(request, Use.READ)
        a, b = (self.library.entry(request.query_params.get(name, "")) for name in "ab")
        before, after = (
            [row for row in self.library.rows_of([entry]) if row.vehicle == entry.vehicle]
            for entry in (a, b)
        )
        difference = vehicle_difference(before, after)
        gains = json.loads(a.gains), json.loads(b.gains)
        page = comparison_page(
            (a.name, b.name),
            (self._review(a) or {}, self._review(b) or {}),
            difference,
            changed_parameters(*gains),
            states_without_gains(*gains),
            PageLink("Flights", "/"),
        )
        return HTMLResponse(without_policy(page, **self._known(request)))

    def _enter_page(self, request: HttpRequest) -> Response:
        raise Refusal(Request.NO_RIGHT, name=Use.READ)

    async def _enter(self, request: HttpRequest) -> Response:
        fields = parse_qs((await _body(request)).decode(errors="replace"))
        if not self.rights.is_token(fields.get("token", [""])[0].strip()):
            await asyncio.sleep(1.0)  # guessing takes longer
            raise Refusal(Request.NO_RIGHT, name=Use.READ)
        answer = RedirectResponse("/", 303)
        answer.set_cookie(
            COOKIE,
            self.rights.key(Use.READ),
            httponly=True,
            samesite="lax",
            secure=request.url.scheme == "https",
        )
        return answer

    def _leave(self, request: HttpRequest) -> Response:
        answer = RedirectResponse("/", 303)
        answer.delete_cookie(COOKIE)
        return answer

    def _script(self, request: HttpRequest) -> Response:
        return Response(script(), media_type="text/javascript")

    def _sample_log(self, request: HttpRequest) -> Response:
        if self._sample is None:
            raise Refusal(Request.NO_SUCH_FLIGHT)
        return FileResponse(self._sample)

    # For programs

    async def _upload(self, request: HttpRequest) -> Response:
        """As Flight Review has it: the page's address, and nothing else."""
        added = await self._receive(request)
        return RedirectResponse(f"/f/{added.flights[0].id}", 302)

    async def _add(self, request: HttpRequest) -> Response:
        added = await self._receive(request)
        return JSONResponse(added.as_dict(), 201)

    async def _receive(self, request: HttpRequest) -> Added:
        self.rights.need(request, Use.UPLOAD)
        _, waiting = await run_in_threadpool(self.library.find, "stage = ?", [Stage.WAITING], 0)
        limits = {Crowd.UPLOADS: (self._uploads, MOST_UPLOADS), Crowd.LOGS: (waiting, MOST_WAITING)}
        for crowd, (count, most) in limits.items():
            if count >= most:
                raise Refusal(Request.UPLOADS_TOO_MANY, count=count, name=crowd)
        self._uploads += 1
        try:
            form = await received(request, self.library)
        finally:
            self._uploads -= 1
        return await run_in_threadpool(self._enter_logs, form, request)

    def _enter_logs(self, form: Form, request: HttpRequest) -> Added:
        """Enters the logs of a form, which are then in the library; raises ``Refusal`` if there is none.

        Of a log that was there already, who may write widens the sharing, and adds the description that is missing.
        """
        fields = form.fields
        columns = {
            "note": _unicode(fields.get("description", ""))[:4000],
            "keep": int(fields.get("keep", "true").lower() != "false"),
        }
        if request.url.path.endswith("/upload"):  # as Flight Review has it
            is_public = fields.get("public", "").lower() in ("true", "1", "on")
            columns["sharing"] = Sharing.PUBLIC if is_public else Sharing.LINK
        flights = []
        refused = []
        try:
            for path, file in form.files.items():
                if not file.size:
                    continue
                # What some browsers send as name is a path of their machine.
                name = PureWindowsPath(_unicode(file.filename or "")).name[:200] or "log"
                try:
                    detect_format(path)
                    entry = self.library.entered(path, name, **columns)
                    if self.rights.may(request, Use.WRITE):
                        entry = self.library.widened(entry, columns)
                    flights.append(entry)
                except Refusal as error:
                    if isinstance(error.fact.code, Request):
                        raise
                    refused.append((name, error.fact.but(path=name)))
        finally:
            form.drop()
        if not flights:
            raise Refusal(refused[0][1])
        self.work.notify()
        return Added.model_validate(
            {
                "flights": flights,
                "refused": [{"name": name, "error": _error(fact)} for name, fact in refused],
            }
        )

    def _flights(self, request: HttpRequest) -> Response:
        limit = _whole_number(request, "limit", PAGE_LENGTH)
        entries, total, *_ = self._found(request, MOST_FILES, limit)
        return _answer(Flights.model_validate({"total": total, "flights": entries}))

    def _flight(self, request: HttpRequest) -> Response:
        entry = self._seen(request)
        return JSONResponse(
            {"flight": Flight.model_validate(entry).as_dict(), "review": self._review(entry)}
        )

    def _review(self, entry: Entry) -> JsonValues | None:
        """The document of a flight's review; None before it is done, and of a flight of `mavdem track`."""
        path = self.library.results_of(entry) / REPORT_FILE
        if not path.is_file():
            return None
        with gone_refused():
            return dict(json.loads(path.read_bytes()))

    async def _change(self, request: HttpRequest) -> Response:
        self.rights.need(request, Use.WRITE)
        told = _checked(Change, await _body(request)).model_dump(mode="json", exclude_unset=True)
        if "tags" in told:
            told["tags"] = ",".join(told["tags"])
        entry = await run_in_threadpool(self.library.change, request.path_params["id"], **told)
        return _answer(Flight.model_validate(entry))

    def _delete(self, request: HttpRequest) -> Response:
        self.rights.need(request, Use.WRITE)
        self.library.delete(request.path_params["id"])
        return Response(status_code=204)

    def _viewer(self, request: HttpRequest) -> Response:
        self.rights.need(request, Use.WRITE)
        entry = self._seen(request)
        if self._show is None or RECORDING_FILE not in entry.file_names:
            raise Refusal(Request.NO_SUCH_FLIGHT)
        return _answer(Viewer(address=self._show(self.library.results_of(entry) / RECORDING_FILE)))

    async def _baseline(self, request: HttpRequest) -> Response:
        self.rights.need(request, Use.WRITE)
        chosen = _checked(Baseline, await _body(request))
        await run_in_threadpool(self.library.set_baseline, chosen.flights)
        return _answer(chosen)

    def _openapi(self, request: HttpRequest) -> Response:
        return JSONResponse(openapi())

    async def _progress(self, request: HttpRequest) -> Response:
        id = request.query_params.get("id")
        if id is None:
            self.rights.need(request, Use.READ)
            condition = SqlCondition(WORKING)
        else:
            request.path_params["id"] = id
            await run_in_threadpool(self._seen, request)
            condition = SqlCondition("id = ?", (id,))
        if self._watchers >= MOST_WATCHERS:
            raise Refusal(Request.UPLOADS_TOO_MANY, count=self._watchers, name=Crowd.WATCHERS)
        return StreamingResponse(self._told(request, condition), media_type="text/event-stream")

    async def _told(self, request: HttpRequest, condition: SqlCondition) -> AsyncIterator[str]:
        """Events while flights are being read, those that were done meanwhile too."""
        watched = list[str]()
        before = []
        where = f"{condition.where} or id in (select value from json_each(?))"
        self._watchers += 1
        try:
            while not await request.is_disconnected():
                values = *condition.values, json.dumps(watched)
                entries, _ = await run_in_threadpool(self.library.find, where, values, MOST_FILES)
                now = [self._progress_of(entry) for entry in entries]
                watched = [entry.id for entry in entries if not entry.is_done]
                changed = [progress.as_dict() for progress in now if progress not in before]
                before = now
                if changed:
                    yield f"data: {json.dumps(changed)}\n\n"
                if not watched:
                    break
                await asyncio.sleep(POLL_SECONDS)
        except asyncio.CancelledError:  # the server ends
            return
        finally:
            self._watchers -= 1
        yield "event: end\ndata: \n\n"

    def _progress_of(self, entry: Entry) -> Progress:
        if not entry.is_done:
            entry = replace(entry, **self.library.told(entry))
        return Progress.gather(entry, words=interface_words()["stages"][entry.stage])


@contextmanager
def gone_refused() -> Iterator[None]:
    """Raises ``Refusal`` where a file is no longer there: its flight is being deleted."""
    try:
        yield
    except FileNotFoundError:
        raise Refusal(Request.NO_SUCH_FLIGHT) from None


@cache
def _headers() -> dict[str, str]:
    """Of every answer: its policy, nothing sniffed, nothing kept."""
    return {
        "content-security-policy": POLICY.format(scripts=" ".join(script_hashes())),
        "x-content-type-options": "nosniff",
        "referrer-policy": "same-origin",
        "cross-origin-opener-policy": "same-origin",
        "cross-origin-resource-policy": "same-origin",
        "cache-control": "no-cache, private",
        "x-robots-tag": "noindex",
    }


def _error(fact: Fact) -> JsonValues:
    return {"reason": fact, "remedy": fact.remedy, "fact": fact}


def _answer(document: Document) -> Response:
    return JSONResponse(document.as_dict())


def _whole_number(request: HttpRequest, name: str, default: int) -> int:
    text = request.query_params.get(name, "")
    return int(text) if text.isdecimal() and len(text) < 10 else default


def _unicode(text: str) -> str:
    """A text of a form without halves of characters: what its own charset says may be anything."""
    return text.encode(errors="replace").decode()


async def _body(request: HttpRequest) -> bytes:
    """The body of a request that is no upload."""
    body = bytearray()
    async for chunk in pieces(request):
        body += chunk
        if len(body) > MOST_TEXT:
            raise Refusal(Request.UPLOAD_TOO_LARGE, size_limit=MOST_TEXT)
    return bytes(body)


def _checked(model: type[Model], body: bytes) -> Model:
    try:
        return model.model_validate_json(body)
    except ValidationError as error:
        raise Refusal(Request.BAD_REQUEST, because=error.errors()[0]["msg"]) from None
