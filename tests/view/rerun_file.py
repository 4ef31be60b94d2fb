"""What is in a Rerun file, for tests of what was drawn."""

import re
import warnings

from rerun.chunk import RrdReader


def chunks(path, static=False):
    """All over time, or ``static`` too: the entity's path, without the slash before it, the chunk and its rows."""
    for chunk in _reader(path).stream():
        if not ((chunk.is_static and not static) or str(chunk.entity_path).startswith("/__")):
            yield _plain(chunk.entity_path), chunk, chunk.to_record_batch()


def views(path):
    """The origins, without the slash, of the views of the one blueprint."""
    reader = _reader(path)
    column = "ViewBlueprint:space_origin"
    (blueprint,) = reader.blueprints()
    batches = [chunk.to_record_batch() for chunk in reader.stream(store=blueprint)]
    return [
        _plain(batch.column(column).to_pylist()[0][0])
        for batch in batches
        if column in batch.schema.names
    ]


def _reader(path):
    with warnings.catch_warnings():
        # Of a flight under way there is no table of chunks at the end of the file.
        warnings.simplefilter("ignore")
        return RrdReader(path)


def _plain(path):
    letters = re.sub(r"\\u\{(\w+)\}", lambda found: chr(int(found[1], 16)), str(path))
    return letters.replace("\\", "").lstrip("/")
