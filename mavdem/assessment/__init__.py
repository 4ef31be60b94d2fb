"""Assessment: what happened in a log, how it ended, and eight lights on the vehicle, at any rate of the log."""

from typing import TYPE_CHECKING

from mavdem.lazy_names import lazy_names

if TYPE_CHECKING:
    from mavdem.assessment.assess import review
    from mavdem.assessment.record import Assessment

__all__ = ["Assessment", "review"]

# One light or event alone needs no models.
__getattr__ = lazy_names(__name__, {"Assessment": "record", "review": "assess"})


def __dir__() -> list[str]:
    """Returns the public names, also those that are not imported yet."""
    return __all__
