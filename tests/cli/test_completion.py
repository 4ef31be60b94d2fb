"""Shell completion: commands, options, values and scenarios."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from mavdem.cli.commands import main


def offered(monkeypatch, capsys, *words: str) -> list[str]:
    monkeypatch.setenv("COMP_WORDS", " ".join(("mavdem", *words)).rstrip())
    monkeypatch.setenv("COMP_CWORD", str(len(words)))
    monkeypatch.setenv("_MAVDEM_COMPLETE", "bash_complete")
    assert main([]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    return said.out.split()


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_of_each_shell_is_printed(shell, monkeypatch, capsys):
    monkeypatch.setenv("_MAVDEM_COMPLETE", f"{shell}_source")
    assert main([]) == 0
    script = capsys.readouterr().out
    assert "_MAVDEM_COMPLETE" in script and "Usage" not in script


def test_commands_options_values_and_scenarios_are_offered(monkeypatch, capsys):
    assert offered(monkeypatch, capsys, "le") == ["plain,learn"]
    assert offered(monkeypatch, capsys, "learn", "x.tlog", "--o") == ["plain,--out", "plain,--order"]
    assert offered(monkeypatch, capsys, "info", "--axis", "") == ["plain,roll", "plain,pitch", "plain,yaw"]
    assert offered(monkeypatch, capsys, "info", "fli") == ["file,fli"]
    assert "plain,hover_blower" in offered(monkeypatch, capsys, "fly", "hover")
    assert offered(monkeypatch, capsys, "fly", "./my.toml") == ["file,./my.toml"]


def test_completing_a_command_imports_nothing_that_takes_time():
    program = (
        "import sys; from mavdem.__main__ import run; code = run();"
        "print(sorted({'numpy', 'scipy', 'pydantic', 'rerun'} & set(sys.modules)), file=sys.stderr); sys.exit(code)"
    )
    asked = {**os.environ, "COMP_WORDS": "mavdem le", "COMP_CWORD": "1", "_MAVDEM_COMPLETE": "zsh_complete"}
    done = subprocess.run([sys.executable, "-c", program], env=asked, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "[]\n") and "learn" in done.stdout


def test_the_closest_names_come_first(capsys):
    assert main(["learn", "x.tlog", "--ot", "y"]) == 2
    assert "Did you mean --out, --test or --json?" in capsys.readouterr().err
    assert main(["learm", "x.tlog"]) == 2
    assert "learn" in capsys.readouterr().err
