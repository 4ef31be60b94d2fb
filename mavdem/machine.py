"""The machine that mavdem runs on: its loopback address, whether it has a screen, free TCP ports, freed memory."""

import ctypes
import os
import socket
import sys
from contextlib import suppress

import psutil

LOOPBACK = "127.0.0.1"
"""IPv4 address that other machines cannot reach."""

LOOPBACK_HOSTS = (LOOPBACK, "localhost", "::1", "[::1]")
"""Names of this machine as a host to listen on, and in the Host header of requests."""


def has_screen() -> bool:
    """Returns whether a window can probably be opened: on Linux, whether an X11 or Wayland display is set.

    On other systems a user nearly always has a screen.
    """
    if not sys.platform.startswith("linux"):
        return True
    has_x11 = bool(os.environ.get("DISPLAY"))
    has_wayland = bool(os.environ.get("WAYLAND_DISPLAY"))
    return has_x11 or has_wayland


def network_address() -> str:
    """Returns the IPv4 address at which other machines of the network reach this one; ``LOOPBACK`` without a network.

    It is the address of the default route or, where there is none as on an access point of its own, of an interface
    that is up.
    """
    with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        # Connecting a UDP socket sends nothing; 192.0.2.1 is reserved for documentation (RFC 5737).
        probe.connect(("192.0.2.1", 9))
        return str(probe.getsockname()[0])
    states = psutil.net_if_stats()
    for name, addresses in psutil.net_if_addrs().items():
        is_up = name in states and states[name].isup
        for address in addresses:
            is_loopback = address.address.startswith("127.")
            if is_up and address.family is socket.AF_INET and not is_loopback:
                return str(address.address)
    return LOOPBACK


def free_port() -> int:
    """Returns a TCP port of the loopback address that is free now; another program may take it before it is used."""
    with socket.create_server((LOOPBACK, 0)) as probe:
        return int(probe.getsockname()[1])


def require_free_port(port: int) -> None:
    """Checks that no program listens at a TCP port of the loopback address; one may begin to before it is used.

    Args:
        port: number of the port.

    Raises:
        OSError: a program listens there, or the port may not be used.
    """
    try:
        socket.create_server((LOOPBACK, port)).close()
    except OSError as error:
        raise OSError(
            f"port {port} of {LOOPBACK} is taken: end the program that uses it, perhaps another view"
        ) from error


def return_freed_memory() -> None:
    """Returns memory that Python has freed to the operating system, if the C library is glibc.

    glibc keeps freed blocks of up to 32 MB for later allocations (``M_MMAP_THRESHOLD`` in mallopt(3)); after reading a
    log of hours these are hundreds of megabytes.
    """
    if sys.platform.startswith("linux"):
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)
