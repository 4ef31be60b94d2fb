"""Optional dependencies (extras of the package): which are installed, and facts (coded findings) on missing ones."""

import os
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path

from mavdem.facts import Fact
from mavdem.facts.sources import PackageFact

MCAP_MODULES = ("lz4", "mcap", "zstandard")
"""Modules that read and write MCAP recordings, which other extras contain too."""

EXTRAS = {
    "control": ("control",),
    "dask": ("distributed",),
    "mcap": MCAP_MODULES,
    "mcp": ("mcp",),
    "pandas": ("pandas",),
    "parquet": ("pyarrow",),
    "plot": ("matplotlib",),
    "ros2": (*MCAP_MODULES, "rosbags"),
    "serve": (*MCAP_MODULES, "h11", "python_multipart", "segno", "starlette", "uvicorn"),
    "urls": ("aiohttp", "fsspec"),
    "view": ("rerun",),
    "xarray": ("xarray",),
}
"""Modules that each extra of ``pyproject.toml`` installs, by the name of the extra."""


EXTRAS_OF_ENDINGS = {".mcap": "mcap", ".parquet": "parquet", ".rrd": "view"}
"""Extras that reading or writing a file needs, by the ending of its name."""


class MissingExtra(ImportError):
    """A package of an extra is not installed.

    Attributes:
        fact: What is missing; its sentence has the command that installs it.
    """

    def __init__(self, fact: Fact) -> None:
        """Takes the ``fact`` that names what is missing."""
        super().__init__(fact)
        self.fact = fact


def missing_modules(extra: str) -> tuple[str, ...]:
    """Returns the modules of an extra that are not installed; none of them is imported."""
    return tuple(name for name in EXTRAS[extra] if find_spec(name) is None)


def missing_extra_fact(extra: str, subject: str) -> Fact | None:
    """Returns a fact that names the missing modules of an extra, or None if all are installed.

    Args:
        extra: Name of the extra, such as "control".
        subject: Name of the part that needs the extra, with which the fact's sentence begins.
    """
    names = missing_modules(extra)
    if not names:
        return None
    fact = Fact(PackageFact.EXTRA_MISSING, subject=subject, extra=extra, names=names)
    if _is_installed():
        return fact
    # Pip does not know this package then, and installs it from its source.
    return fact.replace(folder=str(Path(__file__).parents[1]))


def _is_installed() -> bool:
    """Returns whether pip has installed this package, rather than that its source is run where it lies."""
    try:
        distribution("mavdem")
    except PackageNotFoundError:
        return False
    return True


def require_extra(extra: str, subject: str = "") -> None:
    """Raises ``MissingExtra`` unless all modules of an extra are installed.

    It is called before the import of an optional module, so that the user reads what to install.

    Args:
        extra: Name of the extra, such as "control".
        subject: Name of the part that needs the extra, with which the error's sentence begins.
    """
    fact = missing_extra_fact(extra, subject)
    if fact is not None:
        raise MissingExtra(fact)


def require_extra_of_file(path: str | os.PathLike[str]) -> None:
    """Raises ``MissingExtra`` unless the extra that a file of this ending needs, if any, is installed."""
    extra = EXTRAS_OF_ENDINGS.get(Path(path).suffix.lower())
    if extra is not None:
        require_extra(extra, f"{path}")
