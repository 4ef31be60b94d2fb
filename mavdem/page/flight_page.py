"""The page of one flight of a fleet: the report of ``learn`` for each axis with few pictures, small enough for many."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from mavdem.analysis import LogAnalysis
from mavdem.files import atomic_write
from mavdem.page.document import Chapter, render_page
from mavdem.page.pictures import PicturePlan, picture_chapter
from mavdem.report.details import detail_blocks
from mavdem.report.names import Labels, listed
from mavdem.report.screen import analysis_blocks, key_figures

COARSE = 1.5  # points in which a line keeps its extremes: about a pixel of what is seen
INDEX = "../index.html"
"""The index of the fleet, as seen from a flight's page."""


def flight_page(file: str, analyses: Mapping[str, LogAnalysis], index: str = INDEX) -> str:
    """The HTML of a flight.

    Args:
        file: the log's name.
        analyses: what the log says of one vehicle, by axis; one at least.
        index: where the link back leads.
    """
    (_, first), *others = analyses.items()
    name = next((one.learned for one in analyses.values() if one.learned is not None), None)
    strip = key_figures(first.learned, first.held_out) if first.learned is not None else []
    blocks = analysis_blocks(first)
    # Vehicle, battery and balance are the same on each axis.
    chapters = [
        Chapter(axis.capitalize(), [block for block in analysis_blocks(one) if block not in blocks])
        for axis, one in others
    ]
    chapters += [_pictures(axis, one) for axis, one in analyses.items() if one.learned is not None]
    chapters += [
        Chapter(f"The model of {axis}, and how it was learnt", detail_blocks(one.learned, one.as_dict()), folded=True)
        for axis, one in analyses.items()
        if one.learned is not None
    ]
    subtitle = f"{listed(analyses).capitalize()} of a flight."
    if name is None:
        subtitle = "No model could be learnt from this flight; what it holds nevertheless."
    return render_page(file, subtitle, blocks, chapters, strip, back=("Fleet", index))


def write_flight_page(file: str, analyses: Mapping[str, LogAnalysis], path: Path) -> None:
    """Writes :func:`flight_page`, whole or not at all; raises ``OSError`` where it cannot."""
    with atomic_write(path) as page:
        # The name of a file need not be Unicode.
        page.write(flight_page(file, analyses).encode(errors="replace"))


def _pictures(axis: str, one: LogAnalysis) -> Chapter:
    """The pictures that say most; ``mavdem learn`` draws all."""
    learned, held_out = one.learned, one.held_out
    assert learned is not None and held_out is not None  # a model comes with its test

    def plans() -> list[PicturePlan]:
        from mavdem import plot

        labels = Labels.of(learned)
        forecast = PicturePlan(
            f"Forecast of {labels.output_names[0]}",
            "Windows that no model saw which forecasts them, with the motors as recorded.",
            lambda: plot.forecast(held_out, labels),
        )
        return [
            forecast,
            PicturePlan(
                "Wind's torque",
                "Angular acceleration by neither the motors nor the damping, with its 90 % band.",
                lambda: plot.disturbance(learned),
            ),
            PicturePlan(
                "Motors",
                "The effect of each motor with its 90 % interval, and how hard each works where that is known.",
                lambda: plot.motors(learned, one.vehicle.hover),
            ),
        ]

    return picture_chapter(plans, f"Pictures of {axis}", axis, COARSE)
