"""Running the server: the threads around it, and its end."""

import threading
import webbrowser
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path

import uvicorn

from mavdem.extras import missing_modules
from mavdem.facts import Fact
from mavdem.facts.event import Event
from mavdem.fleet.cluster import Cluster
from mavdem.fleet.workers import JobLimits
from mavdem.live.session_status import SessionStatus
from mavdem.machine import LOOPBACK_HOSTS
from mavdem.serve.app import Server
from mavdem.serve.field_store import FieldStore
from mavdem.serve.library import Library
from mavdem.serve.link_monitor import LinkMonitor
from mavdem.serve.listening import (
    SessionServer,
    end_by_all_signals,
    listening_socket,
    server_config,
    server_url,
    sign_in_link,
)
from mavdem.serve.reading import read_for_library
from mavdem.serve.reading_threads import ReadingThreads
from mavdem.serve.rights import rights_for_host
from mavdem.serve.viewers import RecordingViewer


@dataclass(frozen=True)
class ServerOptions:
    """How a server runs."""

    folder: Path
    """Folder of the library."""
    host: str
    """Name or address to listen on."""
    port: int
    """Port to listen on; 0 for any free one."""
    token: str
    """Secret of the owner; empty for none."""
    is_behind_proxy: bool
    """Whether a reverse proxy checks who has access."""
    quota: int | None
    """Bytes that logs and results may take; None for no limit."""
    processes: int
    """Worker processes that read logs."""
    limits: JobLimits
    """Time and memory for each log."""
    scheduler: str | None
    """Address of a Dask cluster that reads the logs instead."""
    sample_log: Path | None
    """A log that visitors may try the server with."""
    link: str | None = None
    """Address of a MAVLink link to monitor."""
    request_rate: float | None = None
    """Rate that its vehicle is asked for, Hz; None to send nothing to it."""
    vehicle: str | None = None
    """The only vehicle of that link to follow, "system" or "system:component"; None for any."""


def serve(
    options: ServerOptions,
    report_address: Callable[[str, str], None],
    warn: Callable[[Fact], None],
    report_event: Callable[[Event], None],
    report_status: Callable[[SessionStatus], None],
    *,
    opens_browser: bool,
) -> None:
    """Runs a server until it is asked to end.

    Args:
        options: options of the server.
        report_address: function that is called when it listens, with the server's URL and the link that signs a
            browser in; the link is empty where none is needed, or where a proxy has another address.
        warn: function that is called with problems that its owner should know.
        report_event: function that is called with what happens on the link, such as alarms.
        report_status: function that is called with the status of the session on the link every few seconds.
        opens_browser: whether to open the URL in a browser of this machine.

    Raises:
        Unreadable: the server cannot listen, or that would not be safe; or the folder cannot be written to.
    """
    rights = rights_for_host(options.host, options.token, is_behind_proxy=options.is_behind_proxy)
    listener = listening_socket(options.host, options.port)
    library = Library(options.folder, options.quota)
    library.add_fleet_logs()
    cluster = None
    if options.scheduler:
        cluster = Cluster(options.scheduler, options.limits, read_for_library)
    reading_threads = ReadingThreads(library, options.processes, options.limits, cluster)
    url = server_url(options.host, listener)
    monitor = None
    if options.link:
        monitor = LinkMonitor(
            options.link,
            library,
            reading_threads.notify,
            warn,
            report_event,
            report_status,
            options.request_rate,
            server_address=url,
            vehicle=options.vehicle,
        )
    viewer = RecordingViewer()
    # The viewer opens on this machine only, so it is offered only where all visitors sit at this machine.
    is_on_this_machine = options.host in LOOPBACK_HOSTS and not options.is_behind_proxy
    can_open_recordings = is_on_this_machine and not missing_modules("view")
    server = Server(
        library,
        rights,
        reading_threads,
        options.sample_log,
        viewer if can_open_recordings else None,
        monitor,
        FieldStore(options.limits),
    )
    config = server_config(server.app, is_behind_proxy=options.is_behind_proxy)
    report_address(url, "" if options.is_behind_proxy else sign_in_link(url, rights))
    if opens_browser:
        threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()
    http_server = uvicorn.Server(config)
    if monitor is not None:
        http_server = SessionServer(config, monitor.end_session)
    end_by_all_signals(http_server)
    with closing(viewer), suppress(KeyboardInterrupt):
        http_server.run(sockets=[listener])
