"""This machine: its loopback address, whether it has a screen, and which port is free."""

import os
import socket
import sys

LOOPBACK = "127.0.0.1"


def has_screen() -> bool:
    """Returns whether a window can probably be opened here."""
    return not sys.platform.startswith("linux") or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


def free_port() -> int:
    """Returns a port of the loopback address that is free now."""
    with socket.create_server((LOOPBACK, 0)) as probe:
        return int(probe.getsockname()[1])
