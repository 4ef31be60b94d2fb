"""The examples in the docstrings of public names do what they say."""

from __future__ import annotations

import doctest
import os
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from simulated import simulated

import mavdem

LOG = Path(__file__).parents[1] / "logs" / "ardupilot_wind5_steps.tlog"
ROOMS = ("", "baselines", "condition", "dem", "evaluate", "ingest")
"""Modules whose public names may have examples; ``mavdem`` itself first."""
WITH_EXAMPLE = (
    *("Flight", "Flight.segments", "hover", "read_flight", "read_segments", "ingest.read_log"),
    *("learn", "Settings", "Learned.forecast", "Learned.predict", "Learned.simulate", "dem.physical", "evaluate.mspe"),
    *("baselines.subspace", "baselines.pem", "baselines.em", "baselines.arx", "OnlineLearner.update"),
)
"""The most used: each has an example, and says what else to see."""


def examples() -> Iterator[doctest.DocTest]:
    seen: set[int] = set()
    for room in ROOMS:
        module = import_module(f"mavdem.{room}".rstrip("."))
        for name in module.__all__:
            thing = getattr(module, name)
            if id(thing) in seen or not hasattr(thing, "__module__"):
                continue
            seen.add(id(thing))
            names = {**vars(import_module(thing.__module__)), "mavdem": mavdem, "np": np}
            found = doctest.DocTestFinder().find(thing, f"{room}.{name}".lstrip("."), globs=names)
            yield from (one for one in found if one.examples)


EXAMPLES = {one.name: one for one in examples()}


@pytest.fixture(scope="module")
def learned() -> mavdem.Learned:
    return mavdem.learn(simulated(wind=1.0)[:700])


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_does_what_it_says(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    """In a folder with a log, ``flight.tlog``; of a method of ``Learned``, on ``learned``, of 700 samples."""
    monkeypatch.chdir(tmp_path)
    os.symlink(LOG, "flight.tlog")
    test = EXAMPLES[name]
    if any("train" in example.source for example in test.examples):
        test.globs |= {"train": simulated(wind=1.0)[:300], "test": simulated(wind=1.0)[300:400]}
    if any("learned" in example.source for example in test.examples) and "learned =" not in test.docstring:
        test.globs |= {"learned": request.getfixturevalue("learned"), "test": simulated(wind=1.0)[700:]}
    said: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    assert runner.run(test, out=said.append).failed == 0, "".join(said)


@pytest.mark.parametrize("name", WITH_EXAMPLE)
def test_the_most_used_names_have_an_example_and_say_what_else_to_see(name: str) -> None:
    assert name in EXAMPLES and "See Also:" in (EXAMPLES[name].docstring or "")
