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


def test_the_engine_s_example_learns(monkeypatch, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "engine.md").read_text(), re.DOTALL)
    monkeypatch.chdir(ROOT)
    names: dict[str, object] = {}
    exec(code, names)
    assert names["learned"].converged
    assert capsys.readouterr().out.startswith("True ")


@pytest.mark.slow
def test_the_comparison_s_examples_run(monkeypatch, capsys):
    examples = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "comparison.md").read_text(), re.DOTALL)
    monkeypatch.chdir(ROOT)
    # All of them are in tests/cli/test_compare.py.
    monkeypatch.setattr(mavdem.evaluate, "METHODS", mavdem.evaluate.METHODS[-3:])
    for code in examples:
        exec(code, {"__name__": "__main__"})
    assert len(examples) == 2
    assert "\nconstant mean 1.0\n" in capsys.readouterr().out


@pytest.mark.slow
def test_the_scenarios_example_flies(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "scenarios.md").read_text(), re.DOTALL)
    names: dict[str, object] = {}
    exec(code, names)
    assert capsys.readouterr().out.startswith("[[0. 1.]")


@pytest.mark.slow
def test_the_baselines_example_forecasts(monkeypatch, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "baselines.md").read_text(), re.DOTALL)
    monkeypatch.chdir(ROOT)
    exec(code, {})
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["DEM", "subspace(4,", "PEM(4)"]


@pytest.mark.slow
def test_the_readme_s_example_runs(tmp_path, monkeypatch, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flight.tlog").symlink_to(ROOT / "logs" / "ardupilot_wind5_steps.tlog")
    names: dict[str, object] = {}
    exec(code, names)
    assert names["learned"].physical.status["effect"] == "reported"
    assert "motor effectiveness" in capsys.readouterr().out


COMMANDS = [
    (page, line.split("   #")[0].strip())
    for page in ("README.md", *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")))
    for block in re.findall(r"^```\n(.*?)^```", (ROOT / page).read_text(), re.DOTALL | re.MULTILINE)
    for line in block.splitlines()
    if line.startswith("mavdem ")
]


@pytest.mark.parametrize(("page", "line"), COMMANDS)
def test_every_command_that_is_shown_exists_with_its_options(page, line):
    _, name, *words = shlex.split(re.sub(r" > \S+$", "", line))
    command = imported_command(name)
    known = {option for parameter in command.params for option in parameter.opts}
    assert {word for word in words if word.startswith("--")} <= known
    if name == "fly" and not words[0].startswith("--"):
        assert words[0] in scenarios() or words[0].endswith(".toml")


@pytest.mark.slow
def test_the_examples_from_python_run(tmp_path, monkeypatch, capsys):
    examples = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "python.md").read_text(), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "logs").symlink_to(ROOT / "logs")
    names: dict[str, object] = {"__name__": "__main__"}
    for code in examples:
        exec(code, names)
        names["flight"] = names["flight"][:1000]  # of which the learner has a model, too
    assert len(examples) == 5 and names["again"].model.A.shape == (3, 3)
    assert capsys.readouterr().out.splitlines()[-3:] == ["(2, 2)", "(3, 3)", "(4, 4)"]


def test_the_reference_has_every_public_name():
    page = (ROOT / "docs" / "api.md").read_text()
    shown = set(re.findall(r"^\.\. auto\w+:: mavdem\.(\w+)$", page, re.MULTILINE))
    assert shown == {*mavdem.__all__, "dem"}


def test_every_page_is_in_the_site():
    index = (ROOT / "docs" / "index.md").read_text()
    listed = set(re.findall(r"^(?:.*<)?(\w+)>?$", index, re.MULTILINE))
    assert {path.stem for path in (ROOT / "docs").glob("*.md")} - {"index"} <= listed


PAGES = ["README.md", "CONTRIBUTING.md", *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("page", [page for page in PAGES if page != "docs/glossary.md"])
def test_every_file_that_is_named_is_there(page):
    text = (ROOT / page).read_text()
    named = set(re.findall(r"`((?:tools|tests|logs|docs|mavdem|sitl_scenarios)/[\w./]+\.?\w*)`", text))
    named |= {str((ROOT / page).parent.relative_to(ROOT) / link) for link in re.findall(r"\]\(([\w./]+)\)", text)}
    missing = [name for name in named if not (ROOT / name).exists()]
    assert not missing


SCRIPTS = [path for path in sorted((ROOT / "tools").rglob("*.py")) if '__name__ == "__main__"' in path.read_text()]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_every_script_says_by_help_what_its_docstring_says(script):
    assert "@click.command(help=__doc__" in script.read_text()


def test_the_package_says_who_made_it_and_what_it_is():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation = (ROOT / "CITATION.cff").read_text()
    assert project["readme"] == "README.md"
    assert all(f"name: {author['name']}\n" in citation for author in project["authors"])
    assert project["urls"] and all(f"url: {url}\n" in citation for url in project["urls"].values())
    assert f"version: {project['version']}\n" in citation and f"license: {project['license']}\n" in citation
