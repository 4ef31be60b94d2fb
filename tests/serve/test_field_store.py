"""Fields of a log that a server plots: listed, thinned, and refused where the log has none, or may not be seen."""

import pytest
from recorded_flights import FLIGHT
from serving import TOKEN, serving

from mavdem.fleet.workers import outcome_of
from mavdem.serve.field_store import FieldStore


class ReaderInThisProcess:
    """Reads logs at once, and counts them."""

    def __init__(self):
        self.logs = 0

    def read(self, job, limits, read):
        self.logs += 1
        return outcome_of(job, read)

    def stop(self):
        pass


@pytest.fixture
def reader():
    return ReaderInThisProcess()


@pytest.fixture
def served(tmp_path, reader):
    with serving(tmp_path, fields=FieldStore(reader=reader)) as server:
        yield server


def flight_with_log(server, content, headline="One."):
    """Uploads a log of the given content after its made-up reading, and returns the beginning of its addresses."""
    id = server.add("flight.tlog", headline)
    server.library.log_path(server.library.entry(id)).write_bytes(content)
    return f"/api/flights/{id}"


def test_fields_are_listed_and_plotted_from_one_reading_of_the_log(served, reader):
    flight = flight_with_log(served, FLIGHT.read_bytes())
    messages = {one["message"]: one for one in served.get(f"{flight}/fields").json["messages"]}
    assert "roll" in messages["ATTITUDE"]["fields"]
    whole = served.get(f"{flight}/samples?message=ATTITUDE&field=roll&points=20000").json
    assert whole["count"] == len(whole["values"]) == messages["ATTITUDE"]["messages"]
    thinned = served.get(f"{flight}/samples?message=ATTITUDE&field=roll&points=10").json
    assert thinned["is_thinned"] and len(thinned["time"]) <= 20
    assert max(thinned["values"]) == max(whole["values"])
    assert min(thinned["values"]) == min(whole["values"])
    start = whole["time"][10]
    part = served.get(
        f"{flight}/samples?message=ATTITUDE&field=roll&start={start}&end={start}"
    ).json
    assert part["time"] == [start]
    assert reader.logs == 1


def test_nonsense_is_refused_in_a_sentence(served):
    flight = flight_with_log(served, FLIGHT.read_bytes())
    refused = {
        "message=NONE&field=roll": (404, "The log has no NONE: it has "),
        "message=ATTITUDE&field=none": (404, "ATTITUDE has no field none: it has "),
        "message=ATTITUDE&field=roll&instance=7": (404, "ATTITUDE has no instance 7"),
        "message=ATTITUDE&field=roll&instance=x": (400, "The request cannot be understood"),
        "message=ATTITUDE&field=roll&start=nan": (400, "The request cannot be understood"),
        "message=ATTITUDE&field=roll&vehicle=9_9": (404, "The log has no vehicle 9_9"),
    }
    for query, (status, beginning) in refused.items():
        answer = served.get(f"{flight}/samples?{query}")
        assert answer.status == status
        assert answer.json["error"]["reason"].startswith(beginning)
    damaged = flight_with_log(served, b"no log", "Two.")
    assert served.get(f"{damaged}/fields").refusal == (415, "log_not_read")


def test_fields_need_the_right_to_the_log(tmp_path, reader):
    with serving(tmp_path, TOKEN, fields=FieldStore(reader=reader)) as server:
        id = server.add("flight.tlog", "One.", token=TOKEN)
        path = f"/api/flights/{id}"
        assert server.get(f"{path}/fields").status == 404
        server.ask("PATCH", path, {"sharing": "link"}, TOKEN, Content_Type="application/json")
        assert server.get(path).status == 200
        assert server.get(f"{path}/fields").refusal == (401, "no_right")
    assert reader.logs == 0
