"""How a server listens: its socket and its URL, and connections that are closed if they are too many or too slow."""

import asyncio
import errno
import signal
import socket
import threading
from collections.abc import Callable

import h11
import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

from mavdem.errors import Unreadable, error_message
from mavdem.facts.serve import Permission, StartFailure
from mavdem.machine import network_address
from mavdem.processes import TERMINATION_SIGNALS, max_open_files
from mavdem.serve.rights import Rights
from mavdem.serve.sign_in import SIGN_IN_PATH
from mavdem.serve.uploads import MAX_CHUNK_DELAY

WILDCARD_HOSTS = ("0.0.0.0", "::", "")
"""Hosts to listen on that stand for all addresses of this machine, and are no address for a browser."""

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


class SessionServer(uvicorn.Server):
    """The HTTP server of a library with a live session, which it ends before it ends itself.

    While the session ends, browsers are still answered: those with an open page get the last one, which says so.
    """

    def __init__(self, config: uvicorn.Config, end_session: Callable[[], None]) -> None:
        """Prepares the server.

        Args:
            config: its configuration.
            end_session: function that ends the session, and returns once its last page is there.
        """
        super().__init__(config)
        self._end_session = end_session

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Ends the session, and then the server; called by uvicorn."""
        await run_in_threadpool(self._end_session)
        await super().shutdown(sockets)


def end_by_all_signals(server: uvicorn.Server) -> None:
    """Makes every signal that would end the program end the server in order, so that a live recording is kept.

    uvicorn itself handles only Ctrl-C (SIGINT) and SIGTERM. A terminal that is closed, for example, sends SIGHUP.
    Signals that the program ignores stay ignored.

    Args:
        server: server that will run in this thread. Signals can be handled in the main thread only, so that in other
            threads nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        return
    for number in TERMINATION_SIGNALS:
        is_handled_by_uvicorn = number in (signal.SIGINT, signal.SIGTERM)
        is_ignored = signal.getsignal(number) is signal.SIG_IGN
        if not is_handled_by_uvicorn and not is_ignored:
            signal.signal(number, server.handle_exit)


def server_config(app: Starlette, *, is_behind_proxy: bool = False) -> uvicorn.Config:
    """Configures uvicorn, the HTTP server, with limits on connections and without headers that name the software.

    Args:
        app: the ASGI application.
        is_behind_proxy: whether a reverse proxy is in front of the server, whose headers then say from which
            address a request comes.

    Returns:
        The configuration.
    """
    return uvicorn.Config(
        app,
        # Each request that is no HTTP would be a warning, and hide the alarms of a vehicle on the same terminal.
        log_level="error",
        server_header=False,
        date_header=False,
        http=Connection,
        backlog=ACCEPTED_AT_ONCE,
        timeout_graceful_shutdown=MAX_SHUTDOWN_SECONDS,
        proxy_headers=is_behind_proxy,
    )


def listening_socket(host: str, port: int) -> socket.socket:
    """Opens a socket that listens on an address, by IPv4 or IPv6.

    Args:
        host: name or number of the address.
        port: number of the port; 0 for a free one.

    Returns:
        The socket, bound and listening.

    Raises:
        Unreadable: the host is no address of this machine, or its port is in use.
    """
    try:
        addresses = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        # A name with a part of more than 63 letters cannot be encoded (RFC 1035), which is no OSError.
        reason = error_message(error)
        raise Unreadable(StartFailure.HOST_UNKNOWN, address=host, reason=reason) from None
    # Each address is a tuple that begins with its family, IPv4 or IPv6.
    family = addresses[0][0]
    try:
        return socket.create_server((host, port), family=family, backlog=LISTEN_QUEUE_LENGTH)
    except OSError as error:
        reason = error_message(error)
        if error.errno == errno.EADDRNOTAVAIL:
            raise Unreadable(StartFailure.HOST_UNKNOWN, address=host, reason=reason) from None
        address = f"{host}:{port}"
        raise Unreadable(
            StartFailure.ADDRESS_NOT_FREE,
            address=address,
            reason=reason,
            is_in_use=error.errno == errno.EADDRINUSE,
        ) from None


def server_url(host: str, listener: socket.socket) -> str:
    """Returns the URL of the server; an IPv6 address is put in brackets (RFC 3986, sec. 3.2.2).

    If it listens on all addresses of this machine, the URL has the one by which other machines of the network reach it.
    """
    reachable_host = network_address() if host in WILDCARD_HOSTS else host
    url_host = f"[{reachable_host}]" if ":" in reachable_host else reachable_host
    port = listener.getsockname()[1]
    return f"http://{url_host}:{port}"


def sign_in_link(url: str, rights: Rights) -> str:
    """Returns the link that signs a browser in to read, without typing the token; empty where no token is needed.

    Args:
        url: URL of the server.
        rights: access rights, with the token.
    """
    key = rights.derived_key(Permission.READ)
    return f"{url}{SIGN_IN_PATH}?key={key}" if key else ""


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
