"""Words that docs/glossary.md replaced by the field's own do not come back."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
TEXTS = ("mavdem/**/*.py", "sitl_scenarios/**/*.py", "tools/**/*.py", "README.md", "CONTRIBUTING.md", "docs/*.md")
REPLACED = re.compile(
    r"are news to|leant on|rotors stand|beyond all numbers|without measure|believed"
    r"|\b(?:is|are|was|were) (?:not )?told\b|of them their past|is another since|what is wrong with it"
    r"|\berrs [0-9.]+ times|in the places of|\bstretches\b|learnt from / tried on|how they stand|climbs? higher",
    re.IGNORECASE,
)


def test_texts_use_the_vocabulary():
    assert [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for pattern in TEXTS
        for path in sorted(ROOT.glob(pattern))
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if REPLACED.search(line)
    ] == []
