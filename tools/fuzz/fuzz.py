#!/usr/bin/env python
"""Searches for a log that crashes its reader.

Usage: tools/fuzz/fuzz.py dataflash|mcap|tlog|ulog [CORPUS] [OPTIONS]

Coverage-guided, by atheris (``pip install atheris``, Linux and macOS). OPTIONS are libFuzzer's: ``-max_total_time=480``
stops after eight minutes, ``-artifact_prefix=FOLDER/`` names the folder for failing inputs. Useful inputs gather in
the folder CORPUS, which begins with those of ``FORMAT_inputs.py``. An input that fails is run again by naming its
file, and becomes a test of ``tests/ingest``.

atheris 3.0 keeps the result of every traced comparison of arrays, so memory grows by up to 0.3 MB a run. Several runs
with ``-max_total_time=100`` and one corpus do more than one long run.
"""

from __future__ import annotations

import importlib
import sys
import warnings
from pathlib import Path

import atheris
import click

with atheris.instrument_imports(include=["mavdem", "pyulog"]):
    import mavdem.condition.inventory
    import mavdem.ingest.dataflash.log
    import mavdem.ingest.mcap.log
    import mavdem.ingest.ulog  # noqa: F401


@click.command(help=__doc__, context_settings={"ignore_unknown_options": True})
@click.argument("kind", metavar="FORMAT", type=click.Choice(["dataflash", "mcap", "tlog", "ulog"]))
@click.argument("arguments", metavar="[CORPUS] [OPTIONS]", nargs=-1, type=click.UNPROCESSED)
def main(kind: str, arguments: tuple[str, ...]) -> None:
    sys.path.append(str(Path(__file__).parents[2] / "tests/ingest"))
    inputs = importlib.import_module(f"{kind}_inputs")
    warnings.simplefilter("ignore")
    folders = [Path(argument) for argument in arguments if not argument.startswith("-")]
    if folders and not folders[0].is_file():
        folders[0].mkdir(parents=True, exist_ok=True)
        for name, content in inputs.seeds().items():
            (folders[0] / name).write_bytes(content)
    atheris.Setup([__file__, *arguments], inputs.check)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
