"""A server in a thread, with logs that are made up and read at once, and what asks it."""

import http.client
import json
import re
import threading
from collections import namedtuple
from contextlib import closing, contextmanager

import uvicorn

from mavdem.errors import Unreadable
from mavdem.facts import Fact
from mavdem.facts.fleet import ReadingFact
from mavdem.facts.lights import Light
from mavdem.fleet.row import FlightRow
from mavdem.fleet.workers import Job, JobLimits, LogRows, outcome_of
from mavdem.report.blocks import Sentence
from mavdem.report.pages.page import render_document
from mavdem.results import PAGE_FILE, RECORDINGS, REPORT_FILE
from mavdem.serve.app import Server
from mavdem.serve.index import columns_of_flight
from mavdem.serve.library import Library
from mavdem.serve.listening import Connection
from mavdem.serve.recordings import RecordingRequests
from mavdem.serve.rights import Rights
from mavdem.serve.stored_files import PROGRESS, RESULTS

TOKEN = "0123456789abcdef"
LIMITS = JobLimits(1, 256)
BEGINNING = b"ULog\x01\x12\x35"
"""Of a log, by which it is known as one."""
BOUNDARY = "----WebKitFormBoundary7MA4YWxkTrZu0gW"


def log(name="", size=100):
    """The bytes of a made-up log."""
    return (BEGINNING + name.encode()).ljust(size, b"~")


def read_made_up(path, key, page):
    """Results of a log whose bytes are its name and headline; one with "damaged" in it cannot be read."""
    headline = path.read_bytes().removeprefix(BEGINNING).rstrip(b"~").decode()
    if "damaged" in headline:
        raise Unreadable(Fact(ReadingFact.NO_VEHICLE))
    results_folder = path.parents[2] / RESULTS / path.parent.name
    results_folder.mkdir(exist_ok=True)
    names = "flight.mcap,flight.rrd" if "model" in headline else ""
    lights = {f"light_{light}": "good" for light in Light} | {"light_motors": "watch"}
    columns = {
        "vehicle": "quad 7",
        "headline": headline,
        "headline_level": "bad",
        "date": (re.search(r"\d{4}-\d\d-\d\d", headline) or ["2026-11-20"])[0],
        "balance": (0.0, 0.0, 0.0),
        "balance_error": (0.01, 0.01, 0.01),
        "balance_lean": (0.0, 0.0),
        "lean_effect": (0.0,) * 6,
        "lean_effect_error": (0.1,) * 6,
        "vehicle_basis": "board",
        "motors": ("motor 1", "motor 2", "motor 3", "motor 4"),
        "positions": ((0.1, 0.1), (-0.1, -0.1), (0.1, -0.1), (-0.1, 0.1)),
        "spins": (1, 1, -1, -1),
    }
    if "by id" in headline:
        columns |= {"vehicle": "ardupilotmega-1", "vehicle_basis": "system id"}
        columns |= {"autopilot": "ARDUPILOTMEGA", "frame": "QUADROTOR", "system": 1}
    if "weak" in headline:
        lights |= {"light_motors": "bad"}
        columns |= {"health": "fault", "health_reason": "Motor 3 lost thrust."}
        # A flight with a motor at its limit is not taken for healthy.
        columns |= {"saturated": (0.0, 0.0, 0.5, 0.0)}
    columns |= {"page": f"{RESULTS}/{path.parent.name}/{PAGE_FILE}"}
    rows = [
        FlightRow(file=str(path), axis=axis, tier="a", duration=60.0, **columns, **lights)
        for axis in ("roll", "pitch")
    ]
    index_columns = columns_of_flight(rows) | {
        "date": "2026-11-20T10:00:00",
        "gains": '{"MC_ROLL_P": 6.5}',
    }
    (results_folder / PROGRESS).write_text(
        json.dumps(index_columns | {"modes": "Loiter,Land", "files": names})
    )
    (results_folder / PAGE_FILE).write_text(
        render_document(path.name, "", [Sentence("", headline)])
    )
    (results_folder / REPORT_FILE).write_text(json.dumps({"headline": headline}))
    return LogRows(rows, {})


def record_made_up(path, key, page):
    """Recordings of a log; one with "no room" in it has none."""
    if b"no room" in path.read_bytes():
        raise Unreadable(Fact(ReadingFact.RECORDINGS_NOT_WRITTEN, reason="full"))
    results_folder = path.parents[2] / RESULTS / path.parent.name
    for name in RECORDINGS:
        (results_folder / name).write_text(f"{name} of {path.name}")
    return LogRows([], {})


class AtOnce:
    """Work that is done by :meth:`run`, in the thread that asks for it, or as logs come."""

    def __init__(self, library, is_eager=True):
        self.library = library
        self.recordings = RecordingRequests(library)
        self.is_eager = is_eager

    def start(self):
        pass

    def stop(self):
        pass

    def notify(self):
        if self.is_eager:
            self.run()

    def run(self):
        while (entry := self.recordings.claim()) is not None:
            job = Job(str(self.library.log_path(entry)))
            self.recordings.finish(entry, outcome_of(job, record_made_up))
        while (entry := self.library.claim()) is not None:
            job = Job(str(self.library.log_path(entry)))
            self.library.finish_reading(entry, outcome_of(job, read_made_up), LIMITS)
        # The made-up rows have their health already, so that no comparison with other flights is awaited.
        self.library.db.execute("update flights set judged = ''")


class Answer(namedtuple("Answer", "status headers text")):
    """What the server answers."""

    @property
    def json(self):
        return json.loads(self.text)

    @property
    def code(self):
        """Of what is refused."""
        return self.json["error"]["fact"]["code"]

    @property
    def refusal(self):
        return self.status, self.code


class Served(namedtuple("Served", "library work port")):
    """A server that listens, and what asks it."""

    @property
    def address(self):
        return f"http://127.0.0.1:{self.port}"

    def ask(self, method, path, body=None, token="", **headers):
        headers_by_name = {name.replace("_", "-"): value for name, value in headers.items()}
        if token:
            headers_by_name["Authorization"] = f"Bearer {token}"
        if isinstance(body, dict):
            body = json.dumps(body)
        with closing(http.client.HTTPConnection("127.0.0.1", self.port, timeout=300)) as line:
            line.request(method, path, body, headers_by_name)
            answer = line.getresponse()
            return Answer(answer.status, answer.headers, answer.read().decode())

    def get(self, path, **how):
        return self.ask("GET", path, **how)

    def progress(self, id):
        """The first event of the progress of a flight."""
        with closing(http.client.HTTPConnection("127.0.0.1", self.port, timeout=300)) as line:
            line.request("GET", f"/api/progress?id={id}")
            data = line.getresponse().readline().decode()
        return json.loads(data.removeprefix("data: "))[0]

    def upload(self, *files, path="/api/logs", token="", fields=None, **headers):
        """Uploads files, each a name and bytes, in Flight Review's form, with ``fields`` by name."""
        kind = f"multipart/form-data; boundary={BOUNDARY}"
        return self.ask("POST", path, form(files, fields), token, Content_Type=kind, **headers)

    def add(self, name="flight.ulg", said="", **more):
        """Uploads one log and returns its id."""
        return self.upload((name, log(said or name)), **more).json["flights"][0]["id"]


def form(files, fields=None):
    """A multipart form, as browsers, QGroundControl and curl make it."""
    parts = [
        f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="{name}"\r\n\r\n{value}\r\n'.encode()
        for name, value in (fields or {}).items()
    ]
    for name, content in files:
        head = f'Content-Disposition: form-data; name="filearg"; filename="{name}"\r\n'
        head = f"--{BOUNDARY}\r\n{head}Content-Type: application/octet-stream\r\n\r\n"
        parts.append(head.encode() + content + b"\r\n")
    return b"".join([*parts, f"--{BOUNDARY}--\r\n".encode()])


@contextmanager
def serving(folder, token="", quota=None, is_eager=True, sample=None, **more):
    """Serves a folder in a thread."""
    library = Library(folder, quota)
    library.add_fleet_logs()
    work = AtOnce(library, is_eager)
    rights = Rights(token, is_local=not token)
    server = Server(library, rights, work, sample, **more)
    running = uvicorn.Server(
        uvicorn.Config(
            server.app, http=Connection, port=0, log_level="warning", timeout_graceful_shutdown=1
        )
    )
    begun = threading.Event()
    startup = running.startup

    async def starting(*given, **known):
        await startup(*given, **known)
        begun.set()

    running.startup = starting
    thread = threading.Thread(target=running.run)
    thread.start()
    try:
        assert begun.wait(300)
        port = running.servers[0].sockets[0].getsockname()[1]
        yield Served(library, work, port)
    finally:
        running.should_exit = True
        thread.join()
