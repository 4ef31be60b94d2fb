"""Running the server: its socket, its connections, the threads around it, and its end."""

import asyncio
import socket
import threading
import webbrowser
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path

import h11
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

from mavdem.errors import Unreadable, error_message
from mavdem.extras import missing_modules
from mavdem.facts import Fact
from mavdem.facts.event import Event
from mavdem.facts.serve import StartFailure
from mavdem.fleet.cluster import Cluster
from mavdem.fleet.workers import JobLimits
from mavdem.processes import max_open_files
from mavdem.serve.app import Server
from mavdem.serve.field_store import FieldStore
from mavdem.serve.library import Library
from mavdem.serve.link_monitor import LinkMonitor
from mavdem.serve.reading import read_for_library
from mavdem.serve.reading_threads import ReadingThreads
from mavdem.serve.rights import LOOPBACK_HOSTS, rights_for_host
from mavdem.serve.uploads import MAX_CHUNK_DELAY
from mavdem.serve.viewers import RecordingViewer

MAX_CONNECTIONS = 1000
"""Connections that are open at once, at most; further ones are closed."""

MAX_REQUEST_DELAY = 10
"""Seconds until the next complete request of a connection must come."""

LISTEN_QUEUE_LENGTH = 512
"""Connections that the operating system holds until the server accepts them."""

ACCEPTED_AT_ONCE = 100
"""Connections that uvicorn accepts in one step, before any of them can be closed again."""

MAX_SHUTDOWN_SECONDS = 3
"""Seconds that answers which are being sent may take after the server was asked to end."""


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
    report_address: Callable[[str], None],
    warn: Callable[[Fact], None],
    report_event: Callable[[Event], None],
    *,
    opens_browser: bool,
) -> None:
    """Runs a server until it is asked to end.

    Args:
        options: options of the server.
        report_address: function that is called with the server's URL when it listens.
        warn: function that is called with problems that its owner should know.
        report_event: function that is called with what happens on the link, such as alarms.
        opens_browser: whether to open the URL in a browser of this machine.

    Raises:
        Unreadable: the server cannot listen, or that would not be safe; or the folder cannot be written to.
    """
    rights = rights_for_host(options.host, options.token, is_behind_proxy=options.is_behind_proxy)
    listener = _listening_socket(options.host, options.port)
    library = Library(options.folder, options.quota)
    library.add_fleet_logs()
    cluster = None
    if options.scheduler:
        cluster = Cluster(options.scheduler, options.limits, read_for_library)
    reading_threads = ReadingThreads(library, options.processes, options.limits, cluster)
    url = _url(options.host, listener)
    monitor = None
    if options.link:
        monitor = LinkMonitor(
            options.link,
            library,
            reading_threads.notify,
            warn,
            report_event,
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
        viewer.open if can_open_recordings else None,
        monitor,
        FieldStore(options.limits),
    )
    config = uvicorn.Config(
        server.app,
        log_level="warning",
        server_header=False,
        date_header=False,
        http=Connection,
        backlog=ACCEPTED_AT_ONCE,
        timeout_graceful_shutdown=MAX_SHUTDOWN_SECONDS,
        proxy_headers=options.is_behind_proxy,
    )
    report_address(url)
    if opens_browser:
        threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()
    with closing(viewer), suppress(KeyboardInterrupt):
        uvicorn.Server(config).run(sockets=[listener])


class Connection(H11Protocol):
    """The connection of one client, closed if there are too many, or if its next request does not arrive in time.

    uvicorn alone would keep such connections open for ever, and a few clients could take all of them.
    """

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begins the connection and the time in which the first request must come; called by asyncio."""
        super().connection_made(transport)
        if len(self.connections) > _max_connections():
            transport.close()
        self.loop.call_later(MAX_REQUEST_DELAY, self._close_if_idle_since, None)

    def on_response_complete(self) -> None:
        """Starts the timeout for the next request of this connection; called by uvicorn after each answer.

        ``cycle`` is uvicorn's object of the latest request. If it is still the same after the timeout, no further
        request has arrived.
        """
        answered_request = self.cycle
        super().on_response_complete()
        # A client that still sends the body of a refused request reads the reason only afterwards, and gets more time.
        is_sending_body = self.conn.their_state is h11.SEND_BODY
        delay = MAX_CHUNK_DELAY if is_sending_body else MAX_REQUEST_DELAY
        self.loop.call_later(delay, self._close_if_idle_since, answered_request)

    def _close_if_idle_since(self, last_request: RequestResponseCycle | None) -> None:
        """Closes the connection if no request has followed ``last_request``, where None means no request at all."""
        if self.cycle is last_request:
            self.transport.close()


def _max_connections() -> int:
    """Returns how many connections may be open: half of the files that the process may open, at most."""
    return min(MAX_CONNECTIONS, max_open_files() // 2)


def _url(host: str, listener: socket.socket) -> str:
    """Returns the URL of the server; an IPv6 address is put in brackets (RFC 3986, sec. 3.2.2)."""
    url_host = f"[{host}]" if ":" in host else host
    port = listener.getsockname()[1]
    return f"http://{url_host}:{port}"


def _listening_socket(host: str, port: int) -> socket.socket:
    """Opens a socket that listens on an address, by IPv4 or IPv6.

    Args:
        host: name or number of the address.
        port: number of the port; 0 for a free one.

    Returns:
        The socket, bound and listening.

    Raises:
        Unreadable: the address is in use, or does not belong to this machine.
    """
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family, backlog=LISTEN_QUEUE_LENGTH)
    except OSError as error:
        reason = error_message(error)
        address = f"{host}:{port}"
        raise Unreadable(StartFailure.ADDRESS_NOT_FREE, address=address, reason=reason) from None
