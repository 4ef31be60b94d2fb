"""The layouts for PlotJuggler and Foxglove show what is in the flight.mcap that ``learn`` writes."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
from mcap.reader import make_reader

import mavdem
from mavdem.evaluate import held_out_test
from mavdem.export.channels import write_channels

ROOT = Path(__file__).parents[2]
LAYOUTS = ROOT / "docs" / "layouts"


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> set[tuple[str, str]]:
    """Topics and fields of the channels of a learnt flight."""
    path = tmp_path_factory.mktemp("layouts") / "flight.mcap"
    flight = mavdem.read_flight(ROOT / "logs" / "ardupilot_wind5_steps.tlog")
    train, test = flight[:800], flight[800:900]
    learned = mavdem.learn(train, mavdem.Settings(order=2, window=9, parameter_precision=0.1, iterations=3))
    write_channels(path, [train], learned, held_out_test(train, test, learned))
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        return {
            (channel.topic, field)
            for channel in summary.channels.values()
            for field in json.loads(summary.schemas[channel.schema_id].data)["properties"]
        }


@pytest.mark.slow
def test_plotjuggler_s_layout(series: set[tuple[str, str]]) -> None:
    layout = ElementTree.parse(LAYOUTS / "plotjuggler.xml")
    names = [curve.attrib["name"] for curve in layout.iter("curve")]
    assert len(names) >= 10 and set(names) <= {f"{topic}/{field}" for topic, field in series}
    for splitter in layout.iter("DockSplitter"):
        sizes = [float(size) for size in splitter.attrib["sizes"].split(";")]
        assert len(sizes) == len(splitter.findall("DockArea")) == int(splitter.attrib["count"])
        assert sum(sizes) == pytest.approx(1.0)


@pytest.mark.slow
def test_foxglove_s_layout(series: set[tuple[str, str]]) -> None:
    layout = json.loads((LAYOUTS / "foxglove.json").read_text())
    paths = [path["value"] for panel in layout["configById"].values() for path in panel["paths"]]
    assert len(paths) >= 10
    assert {path.split(".@")[0] for path in paths} <= {f"{topic}.{field}" for topic, field in series}

    def panels(place: str | dict[str, object]) -> list[str]:
        return [place] if isinstance(place, str) else [*panels(place["first"]), *panels(place["second"])]

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
