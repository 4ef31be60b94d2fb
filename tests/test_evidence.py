"""The pages of docs/evidence: their tables are what commands printed, unchanged."""

import evidence


def test_no_table_was_changed_by_hand():
    assert not evidence.changed_by_hand()


def test_a_changed_figure_is_noticed(tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    page.write_text('<!-- [[[cog printed("echo 0.25") ]]] -->\n<!-- [[[end]]] -->\n')
    monkeypatch.setattr(evidence, "PAGES", [page])
    assert evidence.write_tables("echo") == 0
    (table,) = evidence.measured_tables()
    assert (table.command, table.output) == ("echo 0.25", "0.25")
    assert not evidence.changed_by_hand()
    page.write_text(page.read_text().replace("\n0.25\n", "\n0.26\n"))
    assert evidence.changed_by_hand()
    assert evidence.write_tables("echo") != 0
