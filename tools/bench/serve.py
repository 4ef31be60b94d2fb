#!/usr/bin/env python
"""Response times, memory and lost uploads of `mavdem serve`, a web server of flight logs, under load.

Usage: tools/bench/serve.py list LOG ...      # 10,000 flights listed, searched and shown
       tools/bench/serve.py load LOG         # 50 uploads by 10 clients while 20 read pages
       tools/bench/serve.py kill LOG         # kill -9 twenty times in mid-upload and mid-work
"""

import hashlib
import json
import os
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from statistics import quantiles
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import click
import psutil
import requests

from mavdem.facts.serve import Stage
from mavdem.fleet.sources import LogSource
from mavdem.fleet.workers import KEY_HASH_DIGITS, JobLimits, JobOutcome
from mavdem.machine import free_port
from mavdem.report.blocks import Table, markdown
from mavdem.serve.index import insert_entry
from mavdem.serve.library import Library
from mavdem.serve.pages import FLIGHTS_PER_PAGE

# Modules are compiled once, as where mavdem is installed, whatever this shell says.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

PATIENCE_SECONDS = 600.0
"""Longest time until an uploaded log has its page, s."""

KILL_CLIENTS = 4
"""Clients that upload logs at once to the server that is killed."""

REQUESTS = 30
"""Requests of each page of a large library."""

VEHICLES = 200
"""Vehicles among which the flights of a large library are distributed."""

FIRST_DATE = datetime(2024, 1, 1, tzinfo=UTC)
"""Date from which the flights of a large library are distributed over a million minutes."""

get = partial(requests.get, timeout=60)
"""Sends a GET request."""


class Served(NamedTuple):
    """A running server."""

    process: subprocess.Popen[bytes]
    """The process of the server."""

    address: str
    """Its URL, without a path."""

    def flights(self, search: str = "") -> Any:
        """Returns the JSON document of the flights that a search finds."""
        return get(f"{self.address}/api/flights", {"q": search, "limit": "1000"}).json()

    def upload(self, name: str, content: bytes) -> int:
        """Uploads a log, and returns the HTTP status of the response."""
        files = {"filearg": (name, content)}
        return requests.post(f"{self.address}/api/logs", files=files, timeout=60).status_code

    def timed(self, path: str) -> tuple[int, float]:
        """Returns the HTTP status of a page, and the time until it came, s."""
        began = time.perf_counter()
        return get(self.address + path).status_code, time.perf_counter() - began

    def wait_for(self, done: int) -> None:
        """Waits until a number of logs are read."""
        wait_until(lambda: self.flights("stage:done")["total"] == done)

    @property
    def processor_seconds(self) -> float:
        """Processor time of the server's main process so far, s."""
        times = psutil.Process(self.process.pid).cpu_times()
        return times.user + times.system

    @property
    def megabytes(self) -> float:
        """Resident memory of the server's main process, MB."""
        text = Path(f"/proc/{self.process.pid}/status").read_text(encoding="utf-8")
        resident = text.split("VmRSS:")[1]
        return int(resident.split()[0]) / 1024


@contextmanager
def running_server(folder: str) -> Iterator[Served]:
    """Runs a server within the block of ``with``.

    Args:
        folder: folder of the server's library.

    Yields:
        The server, which answers requests.
    """
    port = free_port()
    words = f"-m mavdem serve --port {port} --no-browser --jobs 2".split()
    process = subprocess.Popen([sys.executable, *words, folder], stderr=subprocess.DEVNULL)
    server = Served(process, f"http://127.0.0.1:{port}")
    try:
        wait_until(lambda: get(f"{server.address}/static/serve.js").ok)
        yield server
    finally:
        process.terminate()
        process.wait()


def wait_until(condition: Callable[[], bool]) -> None:
    """Waits until a condition holds.

    Args:
        condition: function that returns whether it holds. An error of the connection means that it does not yet.

    Raises:
        TimeoutError: it does not hold within ``PATIENCE_SECONDS``.
    """
    began = time.perf_counter()
    while time.perf_counter() - began < PATIENCE_SECONDS:
        with suppress(requests.RequestException):
            if condition():
                return
        time.sleep(0.05)
    raise TimeoutError


def distinct_log(content: bytes, number: int) -> bytes:
    """Returns the same log with another digest: what follows the last message of a tlog is not read."""
    return content + number.to_bytes(8, "big")


def report(rows: list[list[str]]) -> None:
    """Prints rows of two columns as a Markdown table."""
    click.echo(markdown([Table(["what", "figure"], rows)]))


def percentiles(seconds: list[float]) -> str:
    """Returns median and 99 % quantile of times in s, as text in ms."""
    # The 99 cut points: index 49 is the median, index 98 the 99 % quantile.
    hundredths = quantiles(seconds, n=100)
    return f"{1e3 * hundredths[49]:.0f} ms, p99 {1e3 * hundredths[98]:.0f} ms"


@click.group()
def bench() -> None:
    """Benchmarks of the server."""


@bench.command("list")
@click.argument("logs", nargs=-1, type=click.Path(path_type=Path))
@click.option("--flights", default=10_000, help="Number of flights.")
@click.option("--library", help="Folder of such a library that was made before.")
def list_command(logs: tuple[Path, ...], flights: int, library: str | None) -> None:
    """Lists, searches and shows flights of a large library, made of the rows of real logs with jitter.

    Of each page it prints the median and the 99 % quantile of the time until it came, and the processor time of the
    server, which does not depend on what else the machine does.
    """
    with TemporaryDirectory() as new_folder:
        folder = library or new_folder
        if library is None:
            with running_server(folder) as server:
                for log in logs:
                    server.upload(log.name, log.read_bytes())
                server.wait_for(len(logs))
            multiply_flights(Path(folder), flights)
        figures = []
        with running_server(folder) as server:
            document = server.flights()
            flight = document["flights"][500]
            offset = flights - FLIGHTS_PER_PAGE
            pages = {
                "first page of the list": "/",
                "last page of the list": f"/?offset={offset}",
                "by the date of the flight": "/?sort=flight",
                "a word": "/?q=quad-7",
                "two terms": "/?q=motors:bad wind>5",
                "a gain": "/?q=ATC_RAT_RLL_P>0.13",
                "a word that none has": "/?q=nothing",
                "list as JSON": "/api/flights",
                "page of a flight": f"/f/{flight['id']}",
                "page of a vehicle": f"/vehicle?name={flight['vehicle']}",
            }
            for name, path in pages.items():
                seconds = []
                processor_seconds = server.processor_seconds
                for _ in range(REQUESTS):
                    status, duration = server.timed(path)
                    assert status == 200
                    seconds.append(duration)
                mean = (server.processor_seconds - processor_seconds) / REQUESTS
                figures.append([name, percentiles(seconds), f"{1e3 * mean:.0f} ms"])
            figures.append(["memory of the server", f"{server.megabytes:.0f} MB", ""])
    click.echo(markdown([Table(["what", "time", "processor time"], figures)]))


def multiply_flights(folder: Path, count: int) -> None:
    """Adds flights to a library until it has so many, each with entry, rows and result files of one that is there.

    Its vehicle, date, wind and gains differ from the original's.

    Args:
        folder: folder of the library, with at least one flight that was read.
        count: number of flights.
    """
    random_numbers = random.Random(1)
    library = Library(folder)
    originals, _ = library.find("stage = ?", [Stage.DONE], 1000)
    rows_by_id = {entry.id: library.flight_rows([entry]) for entry in originals}
    limits = JobLimits()
    with library.transaction() as db:
        for number in range(len(originals), count):
            original = originals[number % len(originals)]
            digest = hashlib.sha256(str(number).encode()).hexdigest()
            date = FIRST_DATE + timedelta(minutes=random_numbers.randrange(1_000_000))
            gains = {
                name: value * random_numbers.uniform(0.8, 1.25)
                for name, value in json.loads(original.gains).items()
            }
            entry = replace(
                original,
                id=f"{number:022}",
                name=f"{number}_{original.name}",
                digest=digest,
                path=f"logs/{digest}/{original.name}",
                vehicle=f"quad-{number % VEHICLES}",
                date=date.isoformat(timespec="seconds"),
                received=date.timestamp(),
                wind_speed=random_numbers.uniform(0.0, 12.0),
                motors=random_numbers.choice(("good", "watch", "bad")),
                gains=json.dumps(gains),
            )
            insert_entry(db, entry)
            path = str(library.log_path(entry))
            rows = [
                replace(row, file=path, vehicle=entry.vehicle, date=date)
                for row in rows_by_id[original.id]
            ]
            key = f"{digest[:KEY_HASH_DIGITS]}-{number + 1}"
            outcome = JobOutcome(path, "read", tuple(replace(row, key=key) for row in rows), key)
            library.store.add(LogSource(path, number + 1, ""), outcome, limits)
            results = library.results_folder(entry)
            results.mkdir()
            for file in library.results_folder(original).iterdir():
                os.link(file, results / file.name)
    library.close()


@bench.command("load")
@click.argument("log", type=click.Path(path_type=Path))
def load_command(log: Path) -> None:
    """Measures a server while 10 clients upload 50 logs, and 20 readers open its pages meanwhile.

    The logs are copies of LOG, each changed a little, so that the server reads all of them.
    """
    content = log.read_bytes()
    with TemporaryDirectory() as folder, running_server(folder) as server:
        server.upload(log.name, content)
        server.wait_for(1)
        paths = "/", f"/f/{server.flights()['flights'][0]['id']}"
        pages = []
        is_over = False
        chance = random.Random(1)

        def read() -> None:
            """Opens both pages again and again, with pauses, until all logs are read."""
            while not is_over:
                for path in paths:
                    pages.append(server.timed(path))
                    time.sleep(chance.uniform(0.0, 1.0))

        def upload(number: int) -> int:
            """Uploads a log of its own, and returns the HTTP status."""
            return server.upload(f"{number}.tlog", distinct_log(content, number))

        began = time.perf_counter()
        with ThreadPoolExecutor(20) as readers, ThreadPoolExecutor(10) as clients:
            for _ in range(20):
                readers.submit(read)
            uploads = list(clients.map(upload, range(50)))
            megabytes_after_uploads = server.megabytes
            server.wait_for(51)
            reading_seconds = time.perf_counter() - began
            max_megabytes = max(megabytes_after_uploads, server.megabytes)
            is_over = True
    errors = [status for status, _ in pages if status != 200]
    errors += [status for status in uploads if status != 201]
    seconds = [taken for _, taken in pages]
    report(
        [
            ["a page, 20 readers", f"{percentiles(seconds)} of {len(pages)}"],
            ["answers that were errors", str(len(errors))],
            ["the most memory of the server", f"{max_megabytes:.0f} MB"],
            [
                "the 50 logs were read in",
                f"{reading_seconds:.0f} s, {50 / reading_seconds:.1f} a second",
            ],
        ]
    )


@bench.command("kill")
@click.argument("log", type=click.Path(path_type=Path))
@click.option("--times", default=20)
def kill_command(log: Path, times: int) -> None:
    """Kills the server again and again during uploads, and counts the acknowledged uploads that are lost.

    The server stores a log under the SHA-256 digest of its content, so that the names of the stored logs are compared
    with the digests of the acknowledged ones.
    """
    content = log.read_bytes()
    random_numbers = random.Random(1)
    acknowledged_digests: set[str] = set()
    with TemporaryDirectory() as folder:
        for kill_number in range(times):
            with running_server(folder) as server, ThreadPoolExecutor(KILL_CLIENTS) as clients:
                for client in range(KILL_CLIENTS):
                    log_number = KILL_CLIENTS * kill_number + client
                    body = distinct_log(content, log_number)
                    name = f"{log_number}.tlog"
                    clients.submit(_upload_and_note, server, name, body, acknowledged_digests)
                # The server is killed alternately within the uploads, and after them, while it reads the logs.
                longest_wait = 3.0 if kill_number % 2 else 0.05
                time.sleep(random_numbers.uniform(0.0, longest_wait))
                server.process.kill()
        with running_server(folder) as server:
            server.wait_for(server.flights()["total"])
        stored_digests = {path.name for path in Path(folder, "logs").iterdir()}
    report(
        [
            ["uploads that were acknowledged", str(len(acknowledged_digests))],
            ["of them lost", str(len(acknowledged_digests - stored_digests))],
        ]
    )


def _upload_and_note(
    server: Served, name: str, body: bytes, acknowledged_digests: set[str]
) -> None:
    """Uploads a log, and adds its digest to the acknowledged ones if the server answers that it has stored it.

    Args:
        server: the server, which may be killed meanwhile.
        name: file name of the log.
        body: bytes of the log.
        acknowledged_digests: SHA-256 digests of all logs that the server has acknowledged with 201 Created.
    """
    with suppress(requests.RequestException):
        if server.upload(name, body) == 201:
            acknowledged_digests.add(hashlib.sha256(body).hexdigest())


if __name__ == "__main__":
    bench()
