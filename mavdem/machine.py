"""The machine that mavdem runs on: its loopback address, whether it has a screen, and which TCP port is free."""

import os
import socket
import sys

LOOPBACK = "127.0.0.1"
"""IPv4 address that other machines cannot reach."""


def has_screen() -> bool:
    """Returns whether a window can probably be opened: on Linux, whether an X11 or Wayland display is set.

    On other systems a user nearly always has a screen.
    """
    return not sys.platform.startswith("linux") or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


def free_port() -> int:
    """Returns a TCP port of the loopback address that is free now; another program may take it before it is used."""
    with socket.create_server((LOOPBACK, 0)) as probe:
        return int(probe.getsockname()[1])
