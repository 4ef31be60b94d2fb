"""Columns over time that are written as an MCAP file, chunk by chunk."""

import io
import json

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer
from pytest import mark

from mavdem.ingest.mcap.series import write_series

CHUNK_BYTES = 3000
"""Small enough for several chunks."""

SERIES = {
    "flight/outputs": (
        np.arange(100) * 0.01,
        {"roll": np.sin(np.arange(100.0)), "rate": np.full(100, np.nan)},
    ),
    "wind": (np.arange(20) * 0.05, {"north": np.geomspace(1e-9, 1e9, 20)}),
    "held_out": (np.array([0.25, 0.1, 0.25]), {"band": np.array([1.0, np.inf, 3.0])}),
    "none": (np.empty(0), {"value": np.empty(0)}),
}
"""Channels of other rates, with the same times, with values that JSON lacks, not in order, and without a message."""


def written_by_column(series):
    file = io.BytesIO()
    write_series(file, series, CHUNK_BYTES)
    return file.getvalue()


def written_by_message(series):
    """The same messages, given to the writer of the package ``mcap`` one after the other."""
    file = io.BytesIO()
    writer = Writer(file, chunk_size=CHUNK_BYTES)
    writer.start(library="mavdem")
    messages = []
    for topic, (times, columns) in series.items():
        schema = {"type": "object", "properties": {name: {"type": "number"} for name in columns}}
        name = topic.replace("/", ".")
        number = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
        channel = writer.register_channel(topic, "json", number)
        for row, time in enumerate(times.tolist()):
            body = {}
            for name, column in columns.items():
                value = float(column[row])
                body[name] = value if np.isfinite(value) else None
            messages.append((time, channel, json.dumps(body).encode()))
    for time, channel, body in sorted(messages, key=lambda message: message[0]):
        nanoseconds = round(time * 1e9)
        writer.add_message(channel, nanoseconds, body, nanoseconds)
    writer.finish()
    return file.getvalue()


@mark.parametrize("topics", [list(SERIES), ["none"], ["wind"], []])
def test_the_file_is_that_of_the_writer_of_mcap(topics):
    series = {topic: SERIES[topic] for topic in topics}
    assert written_by_column(series) == written_by_message(series)


def test_the_reader_of_mcap_finds_messages_by_their_index():
    reader = make_reader(io.BytesIO(written_by_column(SERIES)), validate_crcs=True)
    assert reader.get_summary().statistics.chunk_count > 3
    found = [
        (message.log_time, json.loads(message.data))
        for _, _, message in reader.iter_messages(["held_out"], starting_at=200_000_000)
    ]
    assert found == [(250_000_000, {"band": 1.0}), (250_000_000, {"band": 3.0})]
