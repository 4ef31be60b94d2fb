"""What the documentation shows to be typed runs."""

import re
import shlex
import tomllib
from pathlib import Path

import pytest

import mavdem.evaluate
from mavdem.cli.commands import imported_command
from sitl_scenarios.files import names as scenarios

ROOT = Path(__file__).parents[1]


def examples(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "printed"),
    [
        ("docs/engine.md", "True "),
        ("docs/comparison.md", "\nconstant mean 1.0\n"),
        ("docs/scenarios.md", "[[0. 1.]"),
        ("docs/baselines.md", "subspace(4,"),
        ("README.md", "control effectiveness"),
        ("docs/python.md", "(2, 2)\n(3, 3)\n(4, 4)\n"),
    ],
)
def test_examples_run(page, printed, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "logs").symlink_to(ROOT / "logs")
    (tmp_path / "flight.tlog").symlink_to(ROOT / "logs" / "ardupilot_wind5_steps.tlog")
    # All methods are in tests/cli/test_compare.py.
    monkeypatch.setattr(mavdem.evaluate, "METHODS", mavdem.evaluate.METHODS[-3:])
    names: dict[str, object] = {"__name__": "__main__"}
    for code in examples(page):
        exec(code, names)
        if page == "docs/python.md":
            names["flight"] = names["flight"][:1000]  # of which the learner has a model, too
    assert printed in capsys.readouterr().out


COMMANDS = [
    (page, line.split("   #")[0].strip())
    for page in ("README.md", *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")))
    for block in re.findall(r"^```\n(.*?)^```", (ROOT / page).read_text(), re.DOTALL | re.MULTILINE)
    for line in block.splitlines()
    if line.startswith("mavdem ")
]


def test_every_command_that_is_shown_exists_with_its_options():
    for page, line in COMMANDS:
        _, name, *words = shlex.split(re.sub(r" > \S+$", "", line))
        known = {option for parameter in imported_command(name).params for option in parameter.opts}
        assert {word for word in words if word.startswith("--")} <= known, (page, line)
        if name == "fly" and not words[0].startswith("--"):
            assert words[0] in scenarios() or words[0].endswith(".toml"), (page, line)


def test_the_reference_has_every_public_name():
    page = (ROOT / "docs" / "api.md").read_text()
    shown = set(re.findall(r"^\.\. auto\w+:: mavdem\.(\w+)$", page, re.MULTILINE))
    assert shown == {*mavdem.__all__, "dem"}


def test_every_page_is_in_the_site():
    index = (ROOT / "docs" / "index.md").read_text()
    listed = set(re.findall(r"^(?:.*<)?(\w+)>?$", index, re.MULTILINE))
    assert {path.stem for path in (ROOT / "docs").glob("*.md")} - {"index"} <= listed


def test_every_file_that_is_named_is_there():
    missing = []
    for page in ["README.md", "CONTRIBUTING.md", *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))]:
        text, folder = (ROOT / page).read_text(), (ROOT / page).parent
        named = [
            ROOT / name for name in re.findall(r"`((?:tools|tests|logs|docs|mavdem|sitl_scenarios)/[\w./]+)`", text)
        ]
        named += [folder / link for link in re.findall(r"\]\(([\w./]+)\)", text)]
        missing += [f"{page}: {path.relative_to(ROOT)}" for path in named if not path.exists()]
    assert not missing


def test_every_script_says_by_help_what_its_docstring_says():
    scripts = [path.read_text() for path in sorted((ROOT / "tools").rglob("*.py"))]
    assert all("@click.command(help=__doc__" in text for text in scripts if '__name__ == "__main__"' in text)


def test_the_package_says_who_made_it_and_what_it_is():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation = (ROOT / "CITATION.cff").read_text()
    assert project["readme"] == "README.md"
    assert all(f"name: {author['name']}\n" in citation for author in project["authors"])
    assert project["urls"] and all(f"url: {url}\n" in citation for url in project["urls"].values())
    assert f"version: {project['version']}\n" in citation and f"license: {project['license']}\n" in citation


TEXTS = ("mavdem/**/*.py", "sitl_scenarios/**/*.py", "tools/**/*.py", "README.md", "CONTRIBUTING.md", "docs/*.md")
REPLACED = re.compile(
    r"are news to|leant on|rotors stand|beyond all numbers|without measure|believed"
    r"|\b(?:is|are|was|were) (?:not )?told\b|of them their past|is another since|what is wrong with it"
    r"|\berrs [0-9.]+ times|in the places of|\bstretches\b|learnt from / tried on|how they stand|climbs? higher",
    re.IGNORECASE,
)


def test_texts_use_the_vocabulary():
    assert [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for pattern in TEXTS
        for path in sorted(ROOT.glob(pattern))
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if REPLACED.search(line)
    ] == []
