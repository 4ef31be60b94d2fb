"""Backlog: what waits for a slow sink, bounded; the oldest gives way."""

from __future__ import annotations

from collections import deque
from threading import Lock
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Backlog(Generic[Item]):
    """A queue of at most ``most`` items between two threads; neither ever waits for the other."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._items: deque[Item] = deque()
        self._dropped = 0
        # Held for an append or a swap, never while anything is done with an item.
        self._lock = Lock()

    def put(self, item: Item) -> None:
        """Takes the latest item, and drops the oldest where there are too many."""
        with self._lock:
            if len(self._items) == self._most:
                self._items.popleft()
                self._dropped += 1
            self._items.append(item)

    def take(self) -> list[Item]:
        """Hands over all that waits, oldest first."""
        with self._lock:
            taken, self._items = self._items, deque()
        return list(taken)

    @property
    def dropped(self) -> int:
        """How many items gave way so far."""
        return self._dropped
