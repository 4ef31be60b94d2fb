"""Assessment: what happened in a log, how it ended, and eight lights on the vehicle, whatever the log's rate."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mavdem.assessment.assess import review
    from mavdem.assessment.record import Assessment

__all__ = ["Assessment", "review"]

_MODULES = {"Assessment": "record", "review": "assess"}
"""Module below ``mavdem.assessment`` that defines each public name."""


def __getattr__(name: str) -> Any:
    """Imports a public name when it is first used (PEP 562): one light or event alone needs no models."""
    if name in _MODULES:
        return getattr(import_module(f"mavdem.assessment.{_MODULES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """Returns the public names, also those that are not imported yet."""
    return __all__
