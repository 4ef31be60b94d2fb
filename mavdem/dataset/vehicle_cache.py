"""Cache of results that are derived from the signals of one vehicle, shared by the models of all its axes."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import wraps
from typing import Any, Protocol, TypeVar

from mavdem.errors import NotLearnable
from mavdem.immutable import freeze
from mavdem.ingest.telemetry import Telemetry

CachedFunction = TypeVar("CachedFunction", bound=Callable[..., Any])


class HasCache(Protocol):
    """The part of ``VehicleSignals`` that holds the cache."""

    @property
    def telemetry(self) -> Telemetry:
        """Messages of the vehicle, which are part of every key."""

    @property
    def cache(self) -> dict[Hashable, Any]:
        """Cached results and exceptions by key."""


def cached_per_vehicle(*attributes: str) -> Callable[[CachedFunction], CachedFunction]:
    """Decorates a function whose first argument is the signals of a vehicle, so that each result is computed once.

    Signals for several axes of one vehicle share their cache. A result is looked up by the function, the other
    arguments and those attributes of the signals that it depends on. Results are frozen. A ``NotLearnable`` is cached
    like a result, and raised again at each call.

    Args:
        attributes: Names of the attributes of the signals that the result depends on, such as "axis"; none for what is
            the same for all axes.

    Returns:
        The decorator; the other arguments of the decorated function must be hashable.
    """

    def decorator(function: Any) -> Any:
        """Returns a function with the same results, which it stores in the cache of its first argument, the signals."""

        @wraps(function)
        def cached(signals: HasCache, *arguments: Hashable, **keywords: Hashable) -> Any:
            """Returns the cached result, or computes and caches it.

            The key consists of the function, the vehicle's telemetry, those attributes of the signals on which the
            result depends, and the arguments. Results are made immutable, since all callers share them. The exception
            (``NotLearnable``) is cached like a result, and raised at each call.

            Args:
                signals: signals of the vehicle, which hold the cache.
                arguments, keywords: the further arguments of the function, all hashable.

            Returns:
                What the function returns, immutable.

            Raises:
                NotLearnable: the function raises it with these arguments.
            """
            key = (
                function.__module__,
                function.__qualname__,
                signals.telemetry,
                *[getattr(signals, name) for name in attributes],
                *arguments,
                *keywords.items(),
            )
            if key not in signals.cache:
                try:
                    signals.cache[key] = freeze(function(signals, *arguments, **keywords))
                except NotLearnable as error:
                    signals.cache[key] = NotLearnable(error.fact)
            result = signals.cache[key]
            if isinstance(result, NotLearnable):
                # A new exception each time, since one that is raised again accumulates tracebacks.
                raise NotLearnable(result.fact)
            return result

        return cached

    return decorator
