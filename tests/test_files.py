"""A file that is written appears whole, in place of one that was there, with its mode and where its link leads."""

from __future__ import annotations

import os
import stat

import pytest

from mavdem.files import atomic_write, atomic_writes


def test_a_file_keeps_its_mode(tmp_path):
    old = tmp_path / "f"
    old.write_bytes(b"old")
    old.chmod(0o640)
    with atomic_write(old) as file:
        file.write(b"new")
    assert old.read_bytes() == b"new"
    assert stat.S_IMODE(old.stat().st_mode) == 0o640


@pytest.mark.parametrize("there", [True, False])
def test_a_link_is_followed(there, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    target, link = tmp_path / "elsewhere" / "f", tmp_path / "link"
    if there:
        target.write_bytes(b"old")
    link.symlink_to("elsewhere/f")
    with atomic_write(link) as file:
        file.write(b"new")
    assert link.is_symlink() and target.read_bytes() == b"new"
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["elsewhere", "f", "link"]


def test_several_files_change_together_or_not_at_all(tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    one.write_bytes(b"old")
    with pytest.raises(RuntimeError), atomic_writes(one, two) as (first, second):
        first.write_bytes(b"new")
        second.write_bytes(b"new")
        raise RuntimeError
    assert one.read_bytes() == b"old" and not two.exists()
    with atomic_writes(one, two) as (first, second):
        first.write_bytes(b"new")
        second.write_bytes(b"new")
    assert one.read_bytes() == two.read_bytes() == b"new"
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("obstacle", ["a folder", "no plain file", "too long", "no folder", "symbolic links"])
def test_what_cannot_be_replaced_is_said_before_anything_is_made(obstacle, tmp_path):
    path = tmp_path / "f"
    if obstacle == "a folder":
        path.mkdir()
    elif obstacle == "no plain file":
        os.mkfifo(path)
    elif obstacle == "too long":
        path = tmp_path / ("f" * 300)
    elif obstacle == "no folder":
        path = tmp_path / "none" / "f"
    else:
        path.symlink_to(path)
    before = list(tmp_path.iterdir())
    with pytest.raises(OSError, match=obstacle), atomic_writes(tmp_path / "other", path):
        pass
    assert list(tmp_path.iterdir()) == before


def test_two_names_of_one_file_are_refused(tmp_path):
    (tmp_path / "link").symlink_to("f")
    with pytest.raises(OSError, match="the same file"), atomic_writes(tmp_path / "f", tmp_path / "link"):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["link"]
