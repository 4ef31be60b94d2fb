"""Words that docs/glossary.md replaced by the field's own do not come back."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEXTS = sorted(
    path
    for pattern in (
        "mavdem/**/*.py",
        "sitl_scenarios/**/*.py",
        "tools/**/*.py",
        "README.md",
        "CONTRIBUTING.md",
        "docs/*.md",
    )
    for path in ROOT.glob(pattern)
)
REPLACED = re.compile(
    r"are news to|leant on|rotors stand|beyond all numbers|without measure|believed"
    r"|\b(?:is|are|was|were) (?:not )?told\b"
    r"|\berrs [0-9.]+ times|in the places of|\bstretches\b|learnt from / tried on|how they stand|climbs? higher",
    re.IGNORECASE,
)


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_text_uses_the_vocabulary(path):
    lines = path.read_text().splitlines()
    found = [f"{number}: {line.strip()}" for number, line in enumerate(lines, 1) if REPLACED.search(line)]
    assert not found
