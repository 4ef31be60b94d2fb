"""The machine that mavdem runs on: its loopback address, its screen, free TCP ports, freed memory, time of imports."""

import ctypes
import os
import socket
import sys
from importlib import import_module

LOOPBACK = "127.0.0.1"
"""IPv4 address that other machines cannot reach."""

UNUSED_NUMPY_MODULES = ("f2py", "ma", "testing")
"""Submodules of NumPy that SciPy's copy of NumPy's names imports only because they are there."""


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


def return_freed_memory() -> None:
    """Returns memory that Python has freed to the operating system, if the C library is glibc.

    glibc keeps freed blocks of up to 32 MB for later allocations (``M_MMAP_THRESHOLD`` in mallopt(3)); after reading a
    log of hours these are hundreds of megabytes.
    """
    if sys.platform.startswith("linux"):
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


def import_scipy() -> None:
    """Imports the parts of SciPy that each log needs, in two thirds of the time that ``import scipy.ndimage`` takes.

    SciPy copies all public names of NumPy, which imports every submodule of NumPy, a compiler of Fortran among them.
    Those that nobody needs have a value meanwhile, so that NumPy does not import them; afterwards it does when they are
    used. That saves 0.07 s of the processor, a twentieth of the review of a short log.
    """
    namespace = vars(import_module("numpy"))
    hidden_modules = [name for name in UNUSED_NUMPY_MODULES if name not in namespace]
    for name in hidden_modules:
        namespace[name] = None
    try:
        for module in ("scipy.ndimage", "scipy.special"):
            import_module(module)
    finally:
        for name in hidden_modules:
            # It is no longer None if SciPy has imported it after all.
            if namespace[name] is None:
                del namespace[name]
