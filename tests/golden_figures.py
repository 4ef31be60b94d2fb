"""Figures of documents beside those of before, in tests/golden, which ``--write-golden`` writes."""

import json
import re
from collections import defaultdict
from pathlib import Path

import numpy as np
from pytest import approx

GOLDEN = Path(__file__).parent / "golden"
FULL_GOLDEN = Path(__file__).parents[1] / "build" / "golden"
MANY = 6  # Count, ends, mean, deviation and quartiles represent more numbers than this.
DIGITS = 5
PRECISION = 0.01
TIMES = re.compile(r"(fly)?\.took|learn\.seconds")  # Times that the machine takes.


def figures(document):
    """All numbers and codes of a document by their keys, whatever their places in lists."""
    values_by_name = defaultdict(list)

    def collect(value, key):
        if isinstance(value, dict):
            for name in value.keys() - {"units"}:
                collect(value[name], f"{key}.{name}")
        elif isinstance(value, list):
            for part in value:
                collect(part, key)
        elif isinstance(value, float | int) or key.endswith(("code", "level")):
            values_by_name[key].append(value)

    collect(document, "")
    return values_by_name


def compares_in_full(config):
    """Returns whether ``--in-full`` was given, and figures of before lie in build/golden or are now written there."""
    option = config.option
    return option.in_full and (option.write_golden or FULL_GOLDEN.is_dir())


def hold(name, values_by_name, request):
    """Compares figures with stored ones of a name, or stores them if the option ``--write-golden`` is given."""
    folder = FULL_GOLDEN if compares_in_full(request.config) else GOLDEN
    path = folder / f"{name}.json"
    durations = [key for key in values_by_name if TIMES.fullmatch(key)]
    assert all(0 <= seconds < 3600 for key in durations for seconds in values_by_name[key])
    sorted_names = sorted(
        key for key in values_by_name.keys() - set(durations) if values_by_name[key]
    )
    current_values = {key: summary(values_by_name[key]) for key in sorted_names}
    if request.config.getoption("--write-golden"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(current_values, indent=0))
    before = json.loads(path.read_text())
    assert current_values.keys() == before.keys()
    assert not {
        key: (before[key], current_values[key])
        for key in current_values
        if not near(current_values[key], before[key])
    }


def summary(values):
    """Returns few values as they are, and of many numbers their count, ends, mean, deviation and quartiles."""
    if len(values) <= MANY or isinstance(values[0], str):
        return [
            float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value for value in values
        ]
    quarters = np.quantile(np.asarray(values, float), [0.0, 0.25, 0.5, 0.75, 1.0])
    ends = summary([len(values), values[0], values[-1]])
    return [*ends, *summary([np.mean(values), np.std(values)]), *summary(quarters.tolist())]


def near(current_values, before):
    """Returns whether codes are the same, and numbers agree up to the rounding of different processors."""
    if isinstance(before[0], str):
        return current_values == before
    # A figure that never changes has a spread of its rounding alone, zero or not.
    rounding = 1e-12 * max(map(abs, before))
    spread = max(before[4], rounding) if len(before) > MANY else 1e-5
    is_alike = [*map(type, current_values)] == [*map(type, before)]  # Integers must stay integers.
    return is_alike and current_values == approx(before, rel=PRECISION, abs=PRECISION * spread)
