"""Extras: packages that only a part of mavdem needs, and the command that installs them."""

from __future__ import annotations

from importlib.util import find_spec

EXTRAS = {
    "control": ("control",),
    "dask": ("distributed",),
    "fleet": ("aiohttp", "fsspec", "pyarrow"),
    "pandas": ("pandas",),
    "paper": ("matplotlib", "rerun"),
    "parquet": ("pyarrow",),
    "plot": ("matplotlib",),
    "ros2": ("mcap_ros2",),
    "view": ("rerun",),
    "xarray": ("xarray",),
}
"""Modules by the name of the extra in pyproject.toml."""


class MissingExtra(ImportError):
    """A package of an extra is not installed; the message is one sentence with the command that installs it."""


def missing(extra: str) -> tuple[str, ...]:
    """The modules of an extra that are not installed; nothing is imported."""
    return tuple(name for name in EXTRAS[extra] if find_spec(name) is None)


def advice(purpose: str, extra: str) -> str:
    """One sentence, such as "The dashboard needs rerun: pip install 'mavdem[view]'."; empty if nothing is missing."""
    names = missing(extra)
    return f"{purpose} needs {' and '.join(names)}: pip install 'mavdem[{extra}]'." if names else ""


def require(purpose: str, extra: str) -> None:
    """Raises ``MissingExtra`` with :func:`advice` if a package of the extra is missing."""
    if sentence := advice(purpose, extra):
        raise MissingExtra(sentence)
