"""Pages, docstrings and notebooks: what they show to be typed runs, and what they must say is said."""

import ast
import dataclasses
import doctest
import importlib
import inspect
import itertools
import json
import os
import pkgutil
import re
import shlex
import sys
import tomllib
from functools import cache
from pathlib import Path
from types import FunctionType

import numpy as np
from command_line import run, unknown_options
from pytest import fixture, mark, param
from recorded_flights import FLIGHT, short_flight
from simulated import simulated

import mavdem
import mavdem.evaluate
import sitl_scenarios
from mavdem.experiments.methods import maximum_likelihood
from mavdem.loops.axis_loops import MARGIN_TARGETS
from sitl_scenarios.files import names as scenarios

ROOT = Path(__file__).parents[1]
PAGES = {name: (ROOT / name).read_text() for name in ("README.md", "CONTRIBUTING.md")}
PAGES |= {
    str(path.relative_to(ROOT)): path.read_text() for path in sorted((ROOT / "docs").rglob("*.md"))
}


@mark.slow
@mark.parametrize(
    "page, printed",
    {
        "docs/engine.md": "True ",
        "docs/comparison.md": "\nconstant mean 1.0\n",
        "docs/scenarios.md": "[[0. 1.]",
        "docs/python.md": "(2, 2)\n(3, 3)\n(4, 4)\n",
    }.items(),
)
def test_examples_run(page, printed, here, monkeypatch, capsys):
    """The Python examples of each page are executed in turn, with fewer methods and iterations than a user has."""
    (here / "logs").symlink_to(ROOT / "logs")
    (here / "flight.tlog").symlink_to(ROOT / "logs" / "ardupilot_wind5_steps.tlog")
    # All methods are in tests/cli/test_compare.py.
    monkeypatch.setattr(mavdem.evaluate, "METHODS", mavdem.evaluate.METHODS[-3:])
    # To the end PEM takes twelve seconds.
    monkeypatch.setattr(maximum_likelihood, "MAX_ITERATIONS", 20)
    names = {"__name__": "__main__"}
    for code in re.findall(r"```python\n(.*?)```", PAGES[page], re.DOTALL):
        exec(code, names)
        if page == "docs/python.md":
            # The learner has a model of these samples, too.
            names["flight"] = names["flight"][:800]
    assert printed in capsys.readouterr().out


@mark.slow
def test_every_command_that_is_shown_exists_with_its_options():
    blocks = [
        re.findall(r"^```\n(.*?)^```", text, re.DOTALL | re.MULTILINE) for text in PAGES.values()
    ]
    lines = re.findall(r"^mavdem .*?(?=   #|$)", "\n".join(sum(blocks, [])), re.MULTILINE)
    assert len(lines) > 20
    for line in lines:
        _, name, *words = shlex.split(re.sub(r" > \S+$", "", line.strip()))
        assert unknown_options([name, *words]) == set(), line
        if name == "fly" and not words[0].startswith("--"):
            if not words[0].endswith(".toml"):
                assert words[0] in scenarios(), line


def test_the_reference_has_every_public_name():
    shown = set(re.findall(r"^\.\. auto\w+:: mavdem\.(\w+)$", PAGES["docs/api.md"], re.MULTILINE))
    assert shown == {*mavdem.__all__, "dem"}
    # And the site every page.
    contents = (ROOT / "docs" / "contents.txt").read_text()
    listed = set(re.findall(r"<(.*)>$", contents, re.MULTILINE))
    pages = {
        page.removeprefix("docs/").removesuffix(".md")
        for page in PAGES
        if re.match("docs/(?!reference)", page)
    }
    assert pages | {f"notebooks/{path.stem}" for path in NOTEBOOKS} == listed - {
        "reference/index"
    } | {"index"}


def test_every_file_that_is_named_is_there():
    """Paths in code font and links in the pages must exist."""
    missing = []
    for page, text in PAGES.items():
        linked_paths = [
            ROOT / name
            for name in re.findall(
                r"`((?:tools|tests|logs|docs|mavdem|sitl_scenarios)/[\w./]+)`", text
            )
        ]
        linked_paths += [
            (ROOT / page).parent / link for link in re.findall(r"\]\(([\w./]+)(?:#[\w-]*)?\)", text)
        ]
        missing += [
            f"{page}: {path.relative_to(ROOT)}" for path in linked_paths if not path.exists()
        ]
    assert not missing


def test_the_written_pages_can_be_read_in_under_two_hours():
    """The pages have at most 25,000 words."""
    # The pages of the reference are made from the code, tables and blocks of cog are printed by commands: these are
    # looked up.
    written = [
        re.sub(r"<!-- \[\[\[cog.*?\[\[\[end\]\]\].*?-->", "", text, flags=re.DOTALL)
        for page, text in PAGES.items()
        if not page.startswith("docs/reference/")
    ]
    lines = [line for text in written for line in text.splitlines() if not line.startswith("|")]
    assert sum(len(line.split()) for line in lines) <= 25_000


def test_the_goals_of_tune_are_those_of_its_page():
    for name, goal in MARGIN_TARGETS.items():
        row = f"| `{name}` | {goal.phase_margin:g}° | {goal.gain_margin:g} dB | {goal.ms} |\n"
        assert row in PAGES["docs/tune.md"]


def test_the_citation_names_the_version_of_the_package():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"version: {project['version']}\n" in citation


TEXTS = (
    "mavdem/**/*.py",
    "mavdem/report/**/*.toml",
    "sitl_scenarios/**/*.py",
    "tools/**/*.py",
    "README.md",
    "CONTRIBUTING.md",
    "docs/**/*.md",
)
REPLACED = (
    "are news to",
    "leant on",
    "rotors stand",
    "beyond all numbers",
    "believed",
    "of them their past",
    "is another since",
    "what is wrong with it",
    "in the places of",
    "learnt from / tried on",
    "how they stand",
    "climb higher",
    "climbs higher",
    "feel how warm",
    "near it are",
    "its thrust again",
    "discarded again",
    "hold the mean with",
)
"""Phrases that the vocabulary replaces. To look for each of them is faster than for a pattern of all."""
REPLACED_WORDS = re.compile(
    r"\bwithout measure\b|\b(?:is|are|was|were) (?:not )?told\b|\berrs [0-9.]+ times|\bstretches\b"
)


def replaced_words(text):
    """Returns the words of a text that the vocabulary replaces."""
    lower_case = text.lower()
    phrases = [phrase for phrase in REPLACED if phrase in lower_case]
    return phrases + REPLACED_WORDS.findall(lower_case)


@mark.slow
def test_texts_use_the_vocabulary():
    assert replaced_words("Figures that are news to a pilot, who is told.") == [
        "are news to",
        "is told",
    ]
    found = {}
    for pattern in TEXTS:
        for path in ROOT.glob(pattern):
            words = replaced_words(path.read_text())
            if words:
                found[str(path.relative_to(ROOT))] = words
    assert not found


def module_names():
    """The names of all modules; to walk over them imports the rooms only."""
    for package in (mavdem, sitl_scenarios):
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            yield found.name


def public(owner):
    """The public functions and methods that a class itself defines."""
    for name, value in vars(owner).items():
        value = getattr(value, "__func__", value)
        if not name.startswith("_") and isinstance(value, FunctionType):
            yield f"{owner.__name__}.{name}", value


def exported():
    """What ``__all__`` of each room names, and the methods of the classes among it."""
    for room in [mavdem, *map(importlib.import_module, module_names())]:
        for name in getattr(room, "__all__", ()):
            value = getattr(room, name)
            yield f"{room.__name__}.{name}", value
            if inspect.isclass(value):
                yield from public(value)


def arguments(value):
    """What a caller passes or reads by name."""
    if dataclasses.is_dataclass(value):
        names = value.__dataclass_fields__
    elif inspect.isfunction(value):
        names = inspect.signature(value).parameters.keys() - {"self", "cls"}
    else:
        names = getattr(value, "_fields", ())
    return [name for name in names if not name.startswith("_")]


@cache
def class_bodies(path):
    """The statements of each class of a file, by the name of the class."""
    nodes = ast.walk(ast.parse(Path(path).read_text(encoding="utf-8")))
    return {node.name: node.body for node in nodes if isinstance(node, ast.ClassDef)}


def fields_with_docstrings(owner):
    """The fields of a class, its bases included, that a docstring of their own follows."""
    if not inspect.isclass(owner):
        return set()
    names = set()
    for base in owner.__mro__:
        if not base.__module__.startswith(("mavdem", "sitl_scenarios")):
            continue
        body = class_bodies(sys.modules[base.__module__].__file__)[base.__name__]
        for field, docstring in itertools.pairwise(body):
            is_docstring = isinstance(docstring, ast.Expr) and isinstance(
                docstring.value, ast.Constant
            )
            if isinstance(field, ast.AnnAssign) and is_docstring:
                names.add(field.target.id)
    return names


def undocumented(value):
    """The arguments or fields that neither the docstring of a value mentions nor one of their own describes."""
    docstring = value.__doc__ or ""
    unmentioned = [name for name in arguments(value) if not re.search(rf"\b{name}\b", docstring)]
    if not unmentioned:
        return []
    described = fields_with_docstrings(value)
    return [name for name in unmentioned if name not in described]


@mark.slow
def test_arguments_and_attributes_are_documented():
    missing = {name: undocumented(value) for name, value in exported()}
    assert {name: names for name, names in missing.items() if names} == {}


def modules_with_examples():
    """The modules whose docstrings have examples: to import all would take every worker of the tests seconds."""
    for package in (mavdem, sitl_scenarios):
        folder = Path(package.__file__).parent
        for path in sorted(folder.rglob("*.py")):
            if ">>> " in path.read_text("utf-8"):
                parts = (package.__name__, *path.relative_to(folder).with_suffix("").parts)
                yield importlib.import_module(".".join(parts).removesuffix(".__init__"))


EXAMPLES = {
    one.name: one
    for module in modules_with_examples()
    for one in doctest.DocTestFinder().find(module, extraglobs={"mavdem": mavdem, "np": np})
    # The loop of a model takes the parameters of a log, which this flight does not have.
    if one.examples and not one.name.endswith("Learned.loop")
}


FLOWN = simulated(wind=1.0)
EXAMPLE_OF_A_REVIEW = "mavdem.assessment.assess.review"
"""It says the same of the first third of the log, in less time."""


@fixture(scope="module")
def learned():
    return mavdem.learn(FLOWN[:700])


@mark.slow
@mark.parametrize("name", EXAMPLES)
def test_an_example_does_what_it_says(name, learned, here):
    """In a folder with a log, ``flight.tlog``; with ``train``, what is ``learned`` of it, and ``test``."""
    if name == EXAMPLE_OF_A_REVIEW:
        short_flight(here).rename("flight.tlog")
    else:
        os.symlink(FLIGHT, "flight.tlog")
    test = EXAMPLES[name]
    test.globs |= {"learned": learned, "train": FLOWN[:700], "test": FLOWN[700:]}
    printed_output = []
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    assert runner.run(test, out=printed_output.append).failed == 0, "".join(printed_output)


ENOUGH_SAMPLES = {"log_to_bode_plot": 1300}
"""Samples of a notebook's flight of which all can be said that it says."""

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


@mark.slow
@mark.parametrize(
    "path",
    [
        param(path, marks=mark.in_full if path.stem in ENOUGH_SAMPLES else (), id=path.stem)
        for path in NOTEBOOKS
    ],
)
def test_a_notebook_runs_and_shows_what_is_stored_in_it(path, monkeypatch, capsys):
    """What a cell prints, and the value of its last statement; of few samples of its flight."""
    monkeypatch.chdir(path.parent)
    # Whether there are pictures shows at any resolution, and however their parts are laid out.
    monkeypatch.setattr("mavdem.report.figures.style.NOTEBOOK_RESOLUTION_FACTOR", 0.2)
    monkeypatch.setattr("mavdem.report.figures.style.ConstrainedLayoutEngine", lambda **_: None)
    # The flight that it starts is flown here, and shorter: to import everything anew takes seconds.
    monkeypatch.setattr("subprocess.run", lambda words, **_: run(*words[3:], "--duration", 33))
    values = []
    monkeypatch.setattr("sys.displayhook", values.append)
    names = {"__name__": "__main__"}
    pictures = 0
    for cell in json.loads(path.read_text())["cells"]:
        if cell["cell_type"] == "code":
            source = "".join(cell["source"])
            for statement in ast.parse(source).body:
                values.clear()
                if path.stem in ENOUGH_SAMPLES and "flight" in names:
                    names["flight"] = names["flight"][: ENOUGH_SAMPLES[path.stem]]
                exec(compile(ast.Interactive([statement]), "cell", "single"), names)
            shown = [value for value in values if value is not None]
            has_picture = any(getattr(value, "_repr_png_", str)() for value in shown)
            has_output = bool(shown or capsys.readouterr().out)
            kinds = {
                kind for output in cell["outputs"] for kind in output.get("data", {"stream": ""})
            }
            assert (has_picture, has_output) == ("image/png" in kinds, bool(kinds)), source
            pictures += has_picture
    assert pictures >= 3
