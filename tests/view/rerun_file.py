"""What is in a Rerun file, for tests of what was drawn."""

import re
import warnings
from collections import defaultdict

import numpy as np


def chunks(path, static=False):
    """All over time, or ``static`` too: the entity's path, without the slash before it, the chunk and its rows."""
    for chunk in _reader(path).stream():
        if not ((chunk.is_static and not static) or str(chunk.entity_path).startswith("/__")):
            yield _plain(chunk.entity_path), chunk, chunk.to_record_batch()


def drawn(path, ignored=""):
    """Times, s, and values of every entity of lines over boot clock, by path, in the order of their times."""
    times = defaultdict(list)
    values = defaultdict(list)
    for name, chunk, batch in chunks(path):
        is_line = "Scalars:scalars" in batch.schema.names and "boot clock" in chunk.timeline_names
        if is_line and name not in ignored:
            times[name] += (np.array(batch.column("boot clock").cast("int64")) / 1e9).tolist()
            values[name] += batch.column("Scalars:scalars").to_pylist()
    return {name: (np.array(times[name]), np.array(values[name])) for name in times}


def views(path):
    """The origins, without the slash, of the views of the one blueprint."""
    reader = _reader(path)
    (blueprint,) = reader.blueprints()
    origins = first_texts(reader.stream(store=blueprint), "ViewBlueprint:space_origin")
    return [_plain(origin) for origin in origins]


def first_texts(stream, column):
    """The first text of a column in each chunk of a stream that has it."""
    batches = [chunk.to_record_batch() for chunk in stream]
    return [
        str(batch.column(column).to_pylist()[0][0])
        for batch in batches
        if column in batch.schema.names
    ]


def _reader(path):
    # Rerun takes a second to import, and the quick tests of files that read recordings do without.
    from rerun.chunk import RrdReader

    with warnings.catch_warnings():
        # Of a flight under way there is no table of chunks at the end of the file.
        warnings.simplefilter("ignore")
        return RrdReader(path)


def _plain(path):
    letters = re.sub(r"\\u\{(\w+)\}", lambda found: chr(int(found[1], 16)), str(path))
    return letters.replace("\\", "").lstrip("/")
