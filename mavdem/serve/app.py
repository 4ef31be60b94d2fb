"""The web application of the server: its routes, and the background work that starts and ends with it."""

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request as HttpRequest

from mavdem.report.pages.library_page import script_hashes
from mavdem.serve.api import Api
from mavdem.serve.field_store import FieldStore
from mavdem.serve.guard import Guard
from mavdem.serve.library import Library
from mavdem.serve.link_monitor import LinkMonitor
from mavdem.serve.live_pages import LIVE_PATH, LivePages
from mavdem.serve.pages import Pages
from mavdem.serve.rerun_viewer import ViewerFiles
from mavdem.serve.rights import Rights
from mavdem.serve.sign_in import SIGN_IN_PATH, SignIn
from mavdem.serve.viewers import RecordingViewer
from mavdem.serve.visible_library import VisibleLibrary


class BackgroundReading(Protocol):
    """The work that reads the waiting logs of the library in the background, such as ``ReadingThreads``."""

    def start(self) -> None:
        """Starts the work."""

    def notify(self) -> None:
        """Reports that a log was added to the library, or recordings were requested."""

    def stop(self) -> None:
        """Ends the work, and returns when it has ended."""


class Server:
    """The web application of ``mavdem serve``."""

    def __init__(
        self,
        library: Library,
        rights: Rights,
        reading: BackgroundReading,
        sample_log: Path | None = None,
        viewer: RecordingViewer | None = None,
        monitor: LinkMonitor | None = None,
        fields: FieldStore | None = None,
    ) -> None:
        """Joins the parts of the server.

        Args:
            library: the logs that the server stores, with their results and their index.
            rights: who may read, upload and change its flights.
            reading: threads that read the uploaded logs.
            sample_log: a log that visitors may try the server with.
            viewer: shows recordings in a viewer on this machine; None if that is not possible.
            monitor: monitor of a live link; None without one.
            fields: the columns of the logs whose fields are plotted; None for a process of its own.
        """
        self._library = library
        self._reading = reading
        self._monitor = monitor
        self._visible_library = VisibleLibrary(library, rights)
        # The pages of flights have the scripts of the version that wrote them, which may be an earlier one.
        scripts = library.add_script_hashes(script_hashes())
        self._pages = Pages(
            self._visible_library,
            reading.notify,
            sample_log,
            has_viewer=viewer is not None,
            session_summary=None if monitor is None else lambda: monitor.summary,
            scripts=scripts,
        )
        self._live_pages = LivePages(rights, monitor)
        # With a vehicle on the link, its page is what a telephone is for.
        self._sign_in = SignIn(rights, "/" if monitor is None else LIVE_PATH)
        self._viewer_files = ViewerFiles(
            rights, lambda: None if viewer is None else viewer.program_port
        )
        self._fields = fields or FieldStore()
        self._guard = Guard(rights, scripts, self._visible_library.visitor_values)
        self._api = Api(self._visible_library, reading.notify, viewer, self._fields)

    @cached_property
    def app(self) -> Starlette:
        """The ASGI application: the addresses of the server, and what answers each of them.

        The pages are for browsers, below ``/``; the JSON interface is below ``/api``. Logs are
        uploaded as to PX4's Flight Review, to ``/upload``, or ``/{key}/upload`` where a token is needed. Every endpoint
        is guarded: refusals become answers, and all answers get security headers.
        """
        pages = self._pages
        api = self._api
        sign_in = self._sign_in
        endpoints: dict[str, Callable[[HttpRequest], Any]] = {
            "GET /": pages.list_flights,
            "GET /f/{id}": pages.flight,
            "GET /f/{id}/viewer": pages.viewer,
            "GET /f/{id}/{name}": pages.file,
            f"GET {LIVE_PATH}": self._live_pages.live_session,
            f"GET {LIVE_PATH}/update": self._live_pages.live_session_update,
            "GET /vehicle": pages.vehicle,
            "GET /flights": pages.redirect_to_flights,
            "GET /vehicles": pages.list_vehicles,
            "GET /compare": pages.compare,
            f"GET {SIGN_IN_PATH}": sign_in.form,
            f"POST {SIGN_IN_PATH}": sign_in.sign_in,
            "POST /leave": sign_in.sign_out,
            "GET /static/serve.js": pages.script,
            "GET /static/rerun.js": self._viewer_files.script,
            "GET /rerun/{name}": self._viewer_files.program_file,
            "GET /static/sample": pages.sample_log,
            "POST /upload": api.upload,
            "POST /{key}/upload": api.upload,
            "POST /api/logs": api.add_logs,
            "GET /api/flights": api.list_flights,
            "GET /api/flights/{id}": api.flight,
            "PATCH /api/flights/{id}": api.change_flight,
            "DELETE /api/flights/{id}": api.delete_flight,
            "GET /api/flights/{id}/recordings": api.recordings,
            "POST /api/flights/{id}/recordings": api.make_recordings,
            "GET /api/flights/{id}/fields": api.fields,
            "GET /api/flights/{id}/samples": api.samples,
            "POST /api/flights/{id}/viewer": api.open_viewer,
            "PUT /api/baseline": api.set_baseline,
            "DELETE /api/baseline": api.remove_baseline,
            "PUT /api/vehicle": api.name_vehicle,
            "GET /api/progress": api.progress,
            "GET /api/openapi.json": api.describe,
        }
        return Starlette(
            routes=self._guard.routes(endpoints),
            lifespan=self._lifespan,
            exception_handlers=self._guard.exception_handlers,
        )

    @asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        """Starts the background work when the server starts, and ends it with the server; called by Starlette.

        The live session is ended before the reading of logs, since its recording is added to the library at its end.
        """
        self._reading.start()
        if self._monitor is not None:
            self._monitor.start()
        yield
        if self._monitor is not None:
            await run_in_threadpool(self._monitor.stop)
        await run_in_threadpool(self._fields.stop)
        await run_in_threadpool(self._reading.stop)
        self._library.close()
