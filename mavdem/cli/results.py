"""Results: the folder that review and learn write, with the page, the documents and the recordings of a log."""

from pathlib import Path

from mavdem.assessment import Assessment
from mavdem.cli.output import files_in, json_text
from mavdem.heading import Values
from mavdem.results import RESULT_FILES, result_files, write_result_files


def named_after(source: str) -> Path:
    """Returns the folder named after a log, the ``source``, in the current one; not the log's own name."""
    name = Path(source).name
    stem = name.removesuffix(".xz")
    stem = stem.removesuffix(Path(stem).suffix)
    return Path(stem if stem.strip(".") and stem != name else f"{name}-learned")


def files_of(folder: Path, assessment: Assessment) -> dict[str, str]:
    """Returns the paths of the result files in a ``folder``, by name."""
    return {name: str(folder / name) for name in result_files(assessment)}


def write_results(folder: Path, document: Values, assessment: Assessment) -> None:
    """Writes the result files, as :func:`files_in` does, with this report. Those of a run before go."""
    names = result_files(assessment)
    with files_in(folder, names) as paths:
        write_result_files(dict(zip(names, paths, strict=True)), json_text(document), assessment)
    for name in set(RESULT_FILES) - set(names):
        (folder / name).unlink(missing_ok=True)
