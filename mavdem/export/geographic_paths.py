"""The flown path on maps: KML (OGC 12-007r2) for Google Earth and ground stations, and GeoJSON (RFC 7946)."""

import json
from collections.abc import Sequence
from typing import BinaryIO, NamedTuple
from xml.etree import ElementTree

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.signals import global_positions
from mavdem.dataset.time_series import float_column
from mavdem.errors import Unreadable
from mavdem.facts import Fact
from mavdem.facts.sources import SourceFact
from mavdem.ingest.telemetry import Columns, Telemetry
from mavdem.ingest.vocabulary import MILLIMETRES_PER_METRE

POSITION_MESSAGES = ("GLOBAL_POSITION_INT", "GPS_RAW_INT")
"""Messages with a geographic position: the autopilot's estimate, then the fixes of the receiver."""

KML_NAMESPACE = "http://www.opengis.net/kml/2.2"
"""Namespace of the elements of KML."""

DEGREE_DECIMALS = 7
"""Decimals of latitude and longitude: those that MAVLink sends, a centimetre."""

SECOND_DECIMALS = 3
"""Decimals of times and altitudes: MAVLink sends milliseconds and millimetres."""

HALF_TURN = 180.0
"""Step of the longitude, degrees, beyond which a path crosses the antimeridian: the other way round is shorter."""


class GeographicPath(NamedTuple):
    """Where a vehicle was in one boot, on one side of the antimeridian."""

    boot: int
    """Number of the boot."""

    time: Array
    """Times (N,), s on the boot clock."""

    positions: Array
    """Longitude and latitude, degrees, and altitude above mean sea level, m (N, 3); (N, 2) without an altitude."""


def geographic_paths(vehicle: Telemetry) -> list[GeographicPath]:
    """Returns the paths that a vehicle flew, one for each boot with at least two positions.

    A path that crosses the antimeridian is cut there, as GeoJSON asks for (RFC 7946, section 3.1.9): a map would draw a
    line around the earth.

    Args:
        vehicle: messages of the vehicle.

    Returns:
        The paths in the order of time, all from the first of ``POSITION_MESSAGES`` that has any.

    Raises:
        Unreadable: no message has geographic positions.
    """
    # The autopilot's estimate is preferred to the fixes of the receiver.
    for message in POSITION_MESSAGES:
        columns = vehicle.messages.get(message, {})
        if "lat" in columns and "lon" in columns:
            paths = _paths_in_message(columns)
            if paths:
                return paths
    raise Unreadable(Fact(SourceFact.NO_GEOGRAPHIC_POSITION))


def _paths_in_message(columns: Columns) -> list[GeographicPath]:
    """Returns the paths in one message with geographic positions: its parts (:func:`geographic_paths`) of two or more.

    Positions without a fix, and those that are not finite, are left out.

    Args:
        columns: fields of the message, N rows, with ``lat`` and ``lon``; the altitude ``alt`` may be missing.
    """
    degrees, is_fix = global_positions(columns)
    # Maps have the longitude first.
    positions = np.round(degrees[:, ::-1], DEGREE_DECIMALS)
    if "alt" in columns:
        altitude = float_column(columns, "alt") / MILLIMETRES_PER_METRE
        positions = np.column_stack([positions, np.round(altitude, SECOND_DECIMALS)])
    is_usable = is_fix & np.isfinite(positions).all(axis=1)
    times = np.round(float_column(columns, "time"), SECOND_DECIMALS)
    paths = []
    for boot in np.unique(columns["boot"]):
        rows = np.flatnonzero(is_usable & (columns["boot"] == boot))
        longitude_steps = np.diff(positions[rows, 0])
        crossings = 1 + np.flatnonzero(abs(longitude_steps) > HALF_TURN)
        for rows_of_part in np.split(rows, crossings):
            if len(rows_of_part) > 1:
                paths.append(
                    GeographicPath(int(boot), times[rows_of_part], positions[rows_of_part])
                )
    return paths


def valid_name(name: str) -> str:
    r"""Returns the name of a file with escapes, such as ``\x01``, for characters that a map file cannot contain.

    XML does not allow control characters, and UTF-8 cannot encode the bytes of a name that is not valid Unicode.

    Args:
        name: name of the file.
    """
    characters = []
    for character in name:
        if character.isprintable():
            characters.append(character)
        else:
            characters.append(character.encode("unicode_escape").decode())
    return "".join(characters)


def write_geojson(file: BinaryIO, name: str, paths: Sequence[GeographicPath]) -> None:
    """Writes paths as GeoJSON: a line for each, whose properties have the boot and the time of each point.

    Args:
        file: open file to write to; it stays open.
        name: name of the log.
        paths: at least one path.
    """
    features = []
    name = valid_name(name)
    for path in paths:
        geometry = {"type": "LineString", "coordinates": path.positions.tolist()}
        properties = {"name": name, "boot": path.boot, "time_s": path.time.tolist()}
        features.append({"type": "Feature", "geometry": geometry, "properties": properties})
    collection = {"type": "FeatureCollection", "features": features}
    file.write(json.dumps(collection, ensure_ascii=False).encode())


def write_kml(file: BinaryIO, name: str, paths: Sequence[GeographicPath]) -> None:
    """Writes paths as KML: a line for each, at its altitude above mean sea level where that is known.

    Args:
        file: open file to write to; it stays open.
        name: name of the log.
        paths: at least one path.
    """
    root = ElementTree.Element("kml", xmlns=KML_NAMESPACE)
    document = ElementTree.SubElement(root, "Document")
    ElementTree.SubElement(document, "name").text = valid_name(name)
    for path in paths:
        placemark = ElementTree.SubElement(document, "Placemark")
        first_time, last_time = path.time[0], path.time[-1]
        title = f"Boot {path.boot + 1}, {first_time:.1f} to {last_time:.1f} s"
        ElementTree.SubElement(placemark, "name").text = title
        line = ElementTree.SubElement(placemark, "LineString")
        has_altitude = path.positions.shape[1] > 2
        mode = "absolute" if has_altitude else "clampToGround"
        ElementTree.SubElement(line, "altitudeMode").text = mode
        points = [",".join(f"{value:.10g}" for value in point) for point in path.positions.tolist()]
        ElementTree.SubElement(line, "coordinates").text = " ".join(points)
    ElementTree.ElementTree(root).write(file, encoding="utf-8", xml_declaration=True)
