"""Cache of results that are derived from the signals of one vehicle, shared by the models of all its axes."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
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
            """Returns the cached result of the function for these arguments, or computes and caches it."""
            dependencies = [getattr(signals, name) for name in attributes]
            key = _cache_key(function, signals, dependencies, arguments, keywords)
            if key not in signals.cache:
                signals.cache[key] = _result_or_not_learnable(
                    function, signals, arguments, keywords
                )
            result = signals.cache[key]
            if isinstance(result, NotLearnable):
                # A new exception each time, since one that is raised again accumulates tracebacks.
                raise NotLearnable(result.fact)
            return result

        return cached

    return decorator


def _cache_key(
    function: Callable[..., Any],
    signals: HasCache,
    dependencies: Sequence[Hashable],
    arguments: tuple[Hashable, ...],
    keywords: Mapping[str, Hashable],
) -> Hashable:
    """Returns the key under which the result of a function is stored in the cache of a vehicle.

    Args:
        function: The function that computes the result.
        signals: Its first argument, of which the telemetry belongs to the key.
        dependencies: Values of those attributes of the signals on which the result depends.
        arguments: The further positional arguments of the function.
        keywords: Further keyword arguments of the function.

    Returns:
        A tuple that differs if any of these differ.
    """
    name = (function.__module__, function.__qualname__)
    return (*name, signals.telemetry, *dependencies, *arguments, *keywords.items())


def _result_or_not_learnable(
    function: Callable[..., Any],
    signals: HasCache,
    arguments: tuple[Hashable, ...],
    keywords: Mapping[str, Hashable],
) -> Any:
    """Calls a function, and returns what the cache stores of the call: its result, or its ``NotLearnable``.

    ``NotLearnable`` says why the data determine no result. The same data would give it again, so that it is stored like
    a result. Other exceptions are errors, and are not caught.

    Args:
        function: The function whose results are cached.
        signals: First argument of the function: the signals of a vehicle.
        arguments: Further positional arguments of the function.
        keywords: Further keyword arguments of the function.

    Returns:
        The result, whose arrays are made read-only, since all later callers get the same object; or a new
        ``NotLearnable`` without the traceback of the one that was raised.
    """
    try:
        return freeze(function(signals, *arguments, **keywords))
    except NotLearnable as error:
        return NotLearnable(error.fact)
