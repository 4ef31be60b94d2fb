"""The machine that mavdem runs on: its loopback address, whether it has a screen, free TCP ports, freed memory."""

import ctypes
import os
import socket
import sys

LOOPBACK = "127.0.0.1"
"""IPv4 address that other machines cannot reach."""


def has_screen() -> bool:
    """Returns whether a window can probably be opened: on Linux, whether an X11 or Wayland display is set.

    On other systems a user nearly always has a screen.
    """
    if not sys.platform.startswith("linux"):
        return True
    has_x11 = bool(os.environ.get("DISPLAY"))
    has_wayland = bool(os.environ.get("WAYLAND_DISPLAY"))
    return has_x11 or has_wayland


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
