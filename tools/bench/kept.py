"""Outcomes that are kept: what a method makes of a window is worked out anew only where something of it has changed.

An outcome is a pure function of the window's numbers, the method with its settings, and the source that both run. Its
file is named after a digest of all three, so one that is found is right, and nothing needs to be thrown away for that.
"""

from __future__ import annotations

import os
import pickle
import platform
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from functools import partial
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from source import digest

from mavdem.comparison import Method, Outcome, judge, outcomes
from mavdem.flight import Flight
from mavdem.whole_file import whole_file
from mavdem.windows import Window

FOLDER = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mavdem-bench"
"""Where outcomes are kept unless told otherwise; whatever lies there may be deleted at any time."""


def kept_outcomes(
    folder: Path, windows: Sequence[Window], methods: Sequence[Method], executor: Executor | None = None
) -> Iterator[Outcome]:
    """What each method makes of each window, in any order: those that are kept first, and then the others, kept too.

    Args:
        folder: where they are kept, which is made.
        windows: of one or several flights.
        methods: what learns.
        executor: does the work; any ``concurrent.futures.Executor``, which is left running.

    Raises:
        OSError: the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    made_by = {method.name: _made_by(method) for method in methods}
    missing: dict[tuple[Method, ...], list[Window]] = {}
    for window in windows:
        numbers, lacking = _numbers(window), []
        for method in methods:
            kept = _read(_file(folder, made_by[method.name], numbers))
            if kept is None:
                lacking.append(method)
            else:
                yield kept
        if lacking:
            missing.setdefault(tuple(lacking), []).append(window)
    for lacking_all, of in missing.items():
        by_place = {(window.flight, window.start): _numbers(window) for window in of}
        for outcome in outcomes(of, lacking_all, executor):
            _write(_file(folder, made_by[outcome.method], by_place[outcome.flight, outcome.start]), outcome)
            yield outcome


def _file(folder: Path, *made_of: str) -> Path:
    name = sha256(repr(made_of).encode()).hexdigest()
    return folder / name[:2] / name


def _made_by(method: Method) -> str:
    """Of everything that decides a method's outcome but the window."""
    bound: list[Any] = []
    learn: Callable[..., Any] = method.learn
    while isinstance(learn, partial):
        bound += [learn.args, sorted(learn.keywords.items())]
        learn = learn.func
    source = digest(learn.__module__, judge.__module__)
    versions = [platform.python_version(), *map(version, ("numpy", "scipy"))]
    return repr((method.name, learn.__module__, learn.__qualname__, bound, source, versions))


def _numbers(window: Window) -> str:
    """A digest of everything in a window but where its flight came from."""
    found = sha256(repr((window.flight, window.start)).encode())
    for part in (window.train, window.test):
        found.update(repr(_labels(part)).encode())
        for table in (part.time, part.inputs, part.outputs):
            found.update(repr(table.shape).encode() + np.ascontiguousarray(table).tobytes())
    return found.hexdigest()


def _labels(flight: Flight) -> tuple[Any, ...]:
    return flight.dt, flight.input_names, flight.output_names, flight.input_units, flight.output_units


def _read(file: Path) -> Outcome | None:
    """``None`` where there is none, or a damaged one."""
    try:
        content = file.read_bytes()
    except FileNotFoundError:
        return None
    check, body = content[: sha256().digest_size], content[sha256().digest_size :]
    if check != sha256(body).digest():
        return None
    kept = pickle.loads(body)
    return kept if isinstance(kept, Outcome) else None


def _write(file: Path, outcome: Outcome) -> None:
    file.parent.mkdir(exist_ok=True)
    body = pickle.dumps(outcome)
    with whole_file(file) as opened:
        opened.write(sha256(body).digest() + body)
