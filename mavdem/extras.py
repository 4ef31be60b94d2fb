"""Extras: packages that a core installation can do without, by the names in ``pyproject.toml``."""

from importlib.util import find_spec

from mavdem.facts import Fact
from mavdem.facts.sources import Package

EXTRAS = {
    "control": ("control",),
    "dask": ("distributed",),
    "pandas": ("pandas",),
    "parquet": ("pyarrow",),
    "plot": ("matplotlib",),
    "ros2": ("rosbags",),
    "serve": ("python_multipart", "starlette", "uvicorn"),
    "urls": ("aiohttp", "fsspec"),
    "view": ("rerun",),
    "xarray": ("xarray",),
}
"""Modules by the name of the extra."""


class MissingExtra(ImportError):
    """A package of an extra is not installed: a fact, whose sentence has the command that installs it."""

    def __init__(self, fact: Fact) -> None:
        super().__init__(fact)
        self.fact = fact


def missing_modules(extra: str) -> tuple[str, ...]:
    """Returns the modules of an extra that are not installed; nothing is imported."""
    return tuple(name for name in EXTRAS[extra] if find_spec(name) is None)


def missing_extra_fact(extra: str, subject: str) -> Fact | None:
    """Returns what an ``extra`` lacks for the ``subject`` that needs it; None where all of it is installed."""
    if not (names := missing_modules(extra)):
        return None
    return Fact(Package.EXTRA_MISSING, subject=subject, extra=extra, names=names)


def require_extra(extra: str, subject: str = "") -> None:
    """Raises ``MissingExtra`` where an ``extra``, which the ``subject`` needs, is not installed."""
    if fact := missing_extra_fact(extra, subject):
        raise MissingExtra(fact)
