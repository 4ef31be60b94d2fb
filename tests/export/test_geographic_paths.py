"""The flown path on maps: both formats hold the positions, and a log without any is refused."""

import io
import json
from xml.etree import ElementTree

import numpy as np
from hover import Hover, changed, columns
from numpy.testing import assert_allclose
from pytest import raises

from mavdem.errors import Unreadable
from mavdem.export.geographic_paths import geographic_paths, write_geojson, write_kml
from mavdem.facts.sources import SourceFact

KML = {"kml": "http://www.opengis.net/kml/2.2"}
TIME = np.arange(5.0)
LONGITUDE = 151.1234567 + 1e-6 * TIME
LATITUDE = -33.5 - 1e-6 * TIME
ALTITUDE = 40.0 + TIME


def telemetry_with_positions():
    """Returns telemetry of a hover with its positions; the first message is from before a fix."""
    positions = {
        "lat": np.append(0, np.rint(1e7 * LATITUDE)),
        "lon": np.append(0, np.rint(1e7 * LONGITUDE)),
        "alt": np.append(0, 1e3 * ALTITUDE),
    }
    telemetry = Hover().telemetry()
    return changed(telemetry, "GLOBAL_POSITION_INT", **columns(np.arange(-1.0, 5.0), **positions))


def test_a_path_comes_back_from_geojson_with_its_times():
    file = io.BytesIO()
    write_geojson(file, "flight <1>.tlog", geographic_paths(telemetry_with_positions()))
    (feature,) = json.loads(file.getvalue())["features"]
    path = np.array(feature["geometry"]["coordinates"])
    assert_allclose(path, np.column_stack([LONGITUDE, LATITUDE, ALTITUDE]), atol=1e-7)
    assert feature["properties"] == {"name": "flight <1>.tlog", "boot": 0, "time_s": TIME.tolist()}


def test_a_path_comes_back_from_kml_at_its_altitude():
    file = io.BytesIO()
    write_kml(file, "flight <1>.tlog", geographic_paths(telemetry_with_positions()))
    root = ElementTree.fromstring(file.getvalue())
    assert root.findtext("kml:Document/kml:name", namespaces=KML) == "flight <1>.tlog"
    line = root.find(".//kml:LineString", KML)
    assert line.findtext("kml:altitudeMode", namespaces=KML) == "absolute"
    points = line.findtext("kml:coordinates", namespaces=KML).split()
    path = [[float(value) for value in point.split(",")] for point in points]
    assert_allclose(path, np.column_stack([LONGITUDE, LATITUDE, ALTITUDE]), atol=1e-7)


def test_a_path_is_cut_at_the_antimeridian():
    """It flies east across 180°; a line from 180° to −180° would go around the earth."""
    longitude = [1799999998, 1799999999, 1800000000, -1799999999, -1799999998, -1799999997]
    crossing = changed(telemetry_with_positions(), "GLOBAL_POSITION_INT", lon=longitude)
    ends = [path.positions[[0, -1], 0].tolist() for path in geographic_paths(crossing)]
    assert ends == [[179.9999998, 180.0], [-179.9999999, -179.9999997]]


def test_a_log_without_geographic_positions_has_no_path():
    with raises(Unreadable) as refusal:
        geographic_paths(Hover().telemetry())
    assert refusal.value.fact.code is SourceFact.NO_GEOGRAPHIC_POSITION


def test_a_map_may_have_any_name():
    name = "a\x01\udcff<é>.tlog"
    geojson, kml = io.BytesIO(), io.BytesIO()
    write_geojson(geojson, name, geographic_paths(telemetry_with_positions()))
    write_kml(kml, name, geographic_paths(telemetry_with_positions()))
    shown_name = "a\\x01\\udcff<é>.tlog"
    (feature,) = json.loads(geojson.getvalue())["features"]
    assert feature["properties"]["name"] == shown_name
    document = ElementTree.fromstring(kml.getvalue())
    assert document.find("kml:Document/kml:name", KML).text == shown_name
