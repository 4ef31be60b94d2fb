"""Running the server: its address, its workers, and the end of both."""

import asyncio
import resource
import socket
import threading
import webbrowser
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from typing import NamedTuple

import h11
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

from mavdem.errors import Unreadable, error_message
from mavdem.extras import missing_modules
from mavdem.facts import Fact
from mavdem.facts.serve import Start
from mavdem.fleet.cluster import Cluster
from mavdem.fleet.workers import JobLimits
from mavdem.serve.app import Server
from mavdem.serve.attached import Attached
from mavdem.serve.library import Library
from mavdem.serve.reading import read_for_library
from mavdem.serve.rights import LOOPBACK, rights_of
from mavdem.serve.uploads import PATIENCE_SECONDS
from mavdem.serve.viewers import Viewers
from mavdem.serve.work import Work

MOST_CONNECTIONS = 1000  # open at once; further ones are refused
REQUEST_SECONDS = 10  # until a request of a connection is there


class Connection(H11Protocol):
    """One of a client, which ends if it is one too many or its next request does not come: uvicorn would keep both."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begins it, and its time."""
        super().connection_made(transport)
        if len(self.connections) > _most_connections():
            transport.close()
        self.loop.call_later(REQUEST_SECONDS, self._end_unasked, None)

    def on_response_complete(self) -> None:
        """Gives the next request as much time; uvicorn would wait for ever for one that is incomplete."""
        last = self.cycle
        super().on_response_complete()
        # Who still sends a body that is refused already should read why.
        is_read = self.conn.their_state is not h11.SEND_BODY
        patience = REQUEST_SECONDS if is_read else PATIENCE_SECONDS
        self.loop.call_later(patience, self._end_unasked, last)

    def _end_unasked(self, last: RequestResponseCycle | None) -> None:
        """Closes it if no request has come since the ``last``."""
        if self.cycle is last:
            self.transport.close()


def _most_connections() -> int:
    """Returns as many as leave half of the process's descriptors to other files."""
    return min(MOST_CONNECTIONS, resource.getrlimit(resource.RLIMIT_NOFILE)[0] // 2)


class ServerOptions(NamedTuple):
    """How a server runs.

    ``processes`` read logs, each within ``limits``, or the Dask cluster at ``scheduler`` does. ``quota`` is in bytes.
    A server may be attached to a ``link``.
    """

    folder: Path
    host: str
    port: int
    token: str
    is_behind_proxy: bool
    quota: int | None
    processes: int
    limits: JobLimits
    scheduler: str | None
    sample: Path | None
    link: str | None = None


def serve(
    options: ServerOptions, say: Callable[[str], None], warn: Callable[[Fact], None], is_shown: bool
) -> None:
    """Runs a server until it is asked to end.

    ``say`` is called with the server's own address when it listens, ``warn`` with what its owner must know, and
    ``is_shown`` opens it in a browser. Raises ``Unreadable``: it cannot listen, or that is not safe, or the folder
    cannot be written to.
    """
    rights = rights_of(options.host, options.token, options.is_behind_proxy)
    listening = _listening(options.host, options.port)
    library = Library(options.folder, options.quota)
    library.adopt()
    cluster = (
        Cluster(options.scheduler, options.limits, read_for_library) if options.scheduler else None
    )
    work = Work(library, options.processes, options.limits, cluster)
    viewers = Viewers()
    # A viewer listens on this machine only, so whoever opens one must sit there.
    can_show = (
        options.host in LOOPBACK and not options.is_behind_proxy and not missing_modules("view")
    )
    show = viewers.show if can_show else None
    live = Attached(options.link, library, work.notify, warn) if options.link else None
    app = Server(library, rights, work, options.sample, show, live).app
    config = uvicorn.Config(
        app,
        log_level="warning",
        server_header=False,
        date_header=False,
        http=Connection,
        backlog=100,  # accepted at a time, before any of them can be ended
        timeout_graceful_shutdown=3,  # s, for answers that are on their way
        proxy_headers=options.is_behind_proxy,
    )
    name = f"[{options.host}]" if ":" in options.host else options.host
    address = f"http://{name}:{listening.getsockname()[1]}"
    say(address)
    if is_shown:
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
    with closing(viewers), suppress(KeyboardInterrupt):
        uvicorn.Server(config).run(sockets=[listening])


def _listening(host: str, port: int) -> socket.socket:
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family, backlog=512)
    except OSError as error:
        busy = Fact(Start.ADDRESS_NOT_FREE, address=f"{host}:{port}", because=error_message(error))
        raise Unreadable(busy) from None
