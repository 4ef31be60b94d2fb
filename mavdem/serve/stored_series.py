"""Time series of a flight, stored with its results, so that a comparison of two flights can plot them together."""

import zlib
from pathlib import Path
from zipfile import BadZipFile, ZipFile

import numpy as np

from mavdem.report.charts.chart import MAX_POINTS
from mavdem.report.charts.comparison_charts import FlightSeries, thinned_series
from mavdem.serve.stored_files import SERIES_FILE


def write_series(folder: Path, series: FlightSeries) -> None:
    """Writes the time series of a flight, with as many samples as a page draws.

    Args:
        folder: folder of the results.
        series: time series of the flight.
    """
    single_precision = {}
    for title, samples in thinned_series(series, MAX_POINTS).items():
        single_precision[title] = samples.astype(np.float32)
    with Path(folder, SERIES_FILE).open("wb") as file:
        np.savez_compressed(file, **single_precision)  # type: ignore[arg-type]


def read_series(folder: Path) -> FlightSeries | None:
    """Reads the time series of a flight.

    Args:
        folder: folder of the results.

    Returns:
        The time series; None if there are none, as of flights that an earlier version has read, or if the file is
        damaged.
    """
    path = Path(folder, SERIES_FILE)
    try:
        # The checksums are tested first, since NumPy raises many kinds of errors if the head of an array is damaged.
        with ZipFile(path) as archive:
            if archive.testzip() is not None:
                return None
        with np.load(path, allow_pickle=False) as file:
            return {title: file[title].astype(float) for title in file.files}
    except (OSError, ValueError, EOFError, RuntimeError, BadZipFile, zlib.error):
        return None
