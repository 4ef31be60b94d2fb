"""A file that is written appears whole, in place of one that was there, with its mode and where its link leads."""

import os
import stat

from pytest import mark, raises

from mavdem.files import atomic_write, atomic_writes


def test_a_file_keeps_its_mode(tmp_path):
    old = tmp_path / "f"
    old.write_bytes(b"old")
    old.chmod(0o640)
    with atomic_write(old) as file:
        file.write(b"new")
    assert old.read_bytes() == b"new"
    assert stat.S_IMODE(old.stat().st_mode) == 0o640


def test_a_link_is_followed(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    target = tmp_path / "elsewhere" / "f"
    link = tmp_path / "link"
    link.symlink_to("elsewhere/f")
    for content in (b"made", b"replaced"):
        with atomic_write(link) as file:
            file.write(content)
        assert link.is_symlink() and target.read_bytes() == content
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["elsewhere", "f", "link"]


def test_several_files_change_together_or_not_at_all(tmp_path):
    """An error while two files are written leaves both as they were."""
    one = tmp_path / "one"
    two = tmp_path / "two"
    one.write_bytes(b"old")
    with raises(RuntimeError), atomic_writes(one, two) as (first, second):
        first.write_bytes(b"new")
        second.write_bytes(b"new")
        raise RuntimeError
    assert one.read_bytes() == b"old" and not two.exists()
    with atomic_writes(one, two) as (first, second):
        first.write_bytes(b"new")
        second.write_bytes(b"new")
    assert one.read_bytes() == two.read_bytes() == b"new"
    assert len(list(tmp_path.iterdir())) == 2


OBSTACLES = {
    "a folder": lambda path: path.mkdir(),
    "no plain file": os.mkfifo,
    "symbolic links": lambda path: path.symlink_to(path),
    "the same file": lambda path: path.symlink_to("other"),
    "too long": lambda path: None,
    "no folder": lambda path: None,
}


@mark.parametrize("obstacle", OBSTACLES)
def test_what_cannot_be_replaced_is_said_before_anything_is_made(obstacle, tmp_path):
    path = tmp_path / {"too long": "f" * 300, "no folder": "none/f"}.get(obstacle, "f")
    OBSTACLES[obstacle](path)
    before = list(tmp_path.iterdir())
    with raises(OSError, match=obstacle), atomic_writes(tmp_path / "other", path):
        pass
    assert list(tmp_path.iterdir()) == before
