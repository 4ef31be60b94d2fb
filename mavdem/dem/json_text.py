"""The text of a JSON document, which may have come from anywhere."""

from __future__ import annotations

import json
from typing import Any


def json_values(text: str, name: str) -> Any:
    """The values in a JSON document; ``ValueError``, which names what it should have been, for what is none."""
    try:
        return json.loads(text)
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"{name} must be a JSON document: {error}") from None
