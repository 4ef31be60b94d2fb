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
from http import HTTPStatus
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
from mavdem.serve.index import LibraryEntry, insert_entry
from mavdem.serve.library import Library
from mavdem.serve.pages import FLIGHTS_PER_PAGE

# Modules are compiled once, as where mavdem is installed, whatever this shell says.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

PATIENCE_SECONDS = 600.0
"""Longest time until an uploaded log has its page, s."""

KILL_CLIENTS = 4
"""Clients that upload logs at once to the server that is killed."""

LOAD_LOGS = 50
"""Logs that are uploaded to the server under load."""

LOAD_CLIENTS = 10
"""Clients that upload these logs at once."""

LOAD_READERS = 20
"""Readers that open pages meanwhile."""

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
        rows = []
        with running_server(folder) as server:
            # Any flight will do; this one was made by ``multiply_flights``.
            flight = server.flights()["flights"][500]
            for name, path in _pages_to_time(flight, flights).items():
                rows.append([name, *_times_of_page(server, path)])
            rows.append(["memory of the server", f"{server.megabytes:.0f} MB", ""])
    click.echo(markdown([Table(["what", "time", "processor time"], rows)]))


def _pages_to_time(flight: dict[str, str], flight_count: int) -> dict[str, str]:
    """Returns the paths of the pages whose response is measured, by their names in the table.

    Args:
        flight: a flight of the library, by the columns of its list.
        flight_count: number of its flights.
    """
    offset_of_last_page = flight_count - FLIGHTS_PER_PAGE
    return {
        "first page of the list": "/",
        "last page of the list": f"/?offset={offset_of_last_page}",
        "by the date of the flight": "/?sort=flight",
        "a word": "/?q=quad-7",
        "two terms": "/?q=motors:bad wind>5",
        "a gain": "/?q=ATC_RAT_RLL_P>0.13",
        "a word that none has": "/?q=nothing",
        "list as JSON": "/api/flights",
        "page of a flight": f"/f/{flight['id']}",
        "page of a vehicle": f"/vehicle?name={flight['vehicle']}",
    }


def _times_of_page(server: Served, path: str) -> tuple[str, str]:
    """Requests a page ``REQUESTS`` times, and returns the quantiles of the response time and the mean processor time.

    Args:
        server: the server.
        path: path of the page.
    """
    response_seconds = []
    processor_seconds_before = server.processor_seconds
    for _ in range(REQUESTS):
        status, seconds = server.timed(path)
        assert status == HTTPStatus.OK
        response_seconds.append(seconds)
    processor_seconds = (server.processor_seconds - processor_seconds_before) / REQUESTS
    return percentiles(response_seconds), f"{1e3 * processor_seconds:.0f} ms"


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
            entry = _varied_entry(original, number, random_numbers)
            insert_entry(db, entry)
            path = str(library.log_path(entry))
            # Size and digest of the log's content; the size is a made-up number, which no other log has.
            size = number + 1
            key = f"{entry.digest[:KEY_HASH_DIGITS]}-{size}"
            date = datetime.fromtimestamp(entry.received, UTC)
            rows = [
                replace(row, file=path, vehicle=entry.vehicle, date=date, key=key)
                for row in rows_by_id[original.id]
            ]
            outcome = JobOutcome(path, "read", tuple(rows), key)
            library.store.add(LogSource(path, size, version=""), outcome, limits)
            results = library.results_folder(entry)
            results.mkdir()
            for file in library.results_folder(original).iterdir():
                os.link(file, results / file.name)
    library.close()


def _varied_entry(
    original: LibraryEntry, number: int, random_numbers: random.Random
) -> LibraryEntry:
    """Returns the entry of a further flight: that of another one with its own vehicle, date, wind, motors and gains.

    Args:
        original: entry of the flight that is copied.
        number: number of the further flight, which becomes a part of its id, name and path.
        random_numbers: source of the random numbers.
    """
    digest = hashlib.sha256(str(number).encode()).hexdigest()
    date = FIRST_DATE + timedelta(minutes=random_numbers.randrange(1_000_000))
    gains = {}
    for name, value in json.loads(original.gains).items():
        gains[name] = value * random_numbers.uniform(0.8, 1.25)
    return replace(
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


@bench.command("load")
@click.argument("log", type=click.Path(path_type=Path))
def load_command(log: Path) -> None:
    """Measures a server while 10 clients upload 50 logs, and 20 readers open its pages meanwhile.

    The logs are copies of LOG, each changed a little, so that the server reads all of them.
    """
    content = log.read_bytes()
    with TemporaryDirectory() as folder, running_server(folder) as server:
        # The readers open the list of flights, and the page of a flight that was uploaded before.
        server.upload(log.name, content)
        server.wait_for(1)
        first_flight = server.flights()["flights"][0]
        page_paths = ("/", f"/f/{first_flight['id']}")
        page_statuses: list[int] = []
        page_seconds: list[float] = []
        pauses = random.Random(1)
        is_over = False

        def read_pages() -> None:
            """Opens both pages again and again, with pauses, until all logs are read."""
            while not is_over:
                for path in page_paths:
                    status, seconds = server.timed(path)
                    page_statuses.append(status)
                    page_seconds.append(seconds)
                    time.sleep(pauses.uniform(0.0, 1.0))

        def upload(number: int) -> int:
            """Uploads a log that differs from all others, and returns the HTTP status."""
            return server.upload(f"{number}.tlog", distinct_log(content, number))

        began = time.perf_counter()
        with (
            ThreadPoolExecutor(LOAD_READERS) as readers,
            ThreadPoolExecutor(LOAD_CLIENTS) as clients,
        ):
            for _ in range(LOAD_READERS):
                readers.submit(read_pages)
            upload_statuses = list(clients.map(upload, range(LOAD_LOGS)))
            megabytes_after_uploads = server.megabytes
            # All of them, and the one that was uploaded first.
            server.wait_for(LOAD_LOGS + 1)
            reading_seconds = time.perf_counter() - began
            max_megabytes = max(megabytes_after_uploads, server.megabytes)
            is_over = True
    page_errors = len(page_statuses) - page_statuses.count(HTTPStatus.OK)
    upload_errors = LOAD_LOGS - upload_statuses.count(HTTPStatus.CREATED)
    logs_per_second = LOAD_LOGS / reading_seconds
    report(
        [
            [
                f"a page, {LOAD_READERS} readers",
                f"{percentiles(page_seconds)} of {len(page_seconds)}",
            ],
            ["answers that were errors", str(page_errors + upload_errors)],
            ["the most memory of the server", f"{max_megabytes:.0f} MB"],
            [
                f"the {LOAD_LOGS} logs were read in",
                f"{reading_seconds:.0f} s, {logs_per_second:.1f} a second",
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
