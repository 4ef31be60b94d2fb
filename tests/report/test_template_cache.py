"""Compiled templates: kept while their text stays the same, and not where Python keeps no compiled modules."""

from importlib.metadata import version

from jinja2 import DictLoader, Environment

from mavdem.report.template_cache import CompiledTemplates


def compiled_templates(folder, text):
    """Renders a template with compiled ones kept in a folder, and returns what it says and how many are kept."""
    cache = CompiledTemplates()
    cache.directory = str(folder)
    environment = Environment(loader=DictLoader({"greeting": text}), bytecode_cache=cache)
    return environment.get_template("greeting").render(name="roll"), len([*folder.glob("*")])


def test_a_template_is_kept_compiled_until_its_text_changes(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.dont_write_bytecode", True)
    folder = tmp_path / "kept"
    assert compiled_templates(folder, "{{ name }} good") == ("roll good", 0)
    monkeypatch.setattr("sys.dont_write_bytecode", False)
    assert compiled_templates(folder, "{{ name }} good") == ("roll good", 1)
    (compiled_file,) = folder.iterdir()
    assert f"jinja-{version('jinja2')}" in compiled_file.name
    before = compiled_file.read_bytes()
    assert compiled_templates(folder, "{{ name }} good") == ("roll good", 1)
    assert compiled_file.read_bytes() == before
    assert compiled_templates(folder, "{{ name }} bad") == ("roll bad", 1)
    compiled_file.write_bytes(b"damaged")
    assert compiled_templates(folder, "{{ name }} bad") == ("roll bad", 1)
