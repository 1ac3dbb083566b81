"""Files that are replaced whole."""

import os

import pytest
from commands import files
from mi_ellipse.files import atomic


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "table.csv"
    atomic.write_text(path, "old")

    def fail():
        with atomic.replacement(path) as temporary:
            temporary.write_text("new, but")
            raise RuntimeError("halfway")

    with pytest.raises(RuntimeError, match="halfway"):
        fail()
    assert path.read_text() == "old"
    assert files(tmp_path) == ["table.csv"]


def test_the_temporary_file_keeps_the_suffix_and_the_folder(tmp_path):
    with atomic.replacement(tmp_path / "figure.pdf") as temporary:
        assert (temporary.parent, temporary.suffix) == (tmp_path.resolve(), ".pdf")
        temporary.write_text("drawn")
    assert files(tmp_path) == ["figure.pdf"]


def test_text_is_utf_8_with_the_line_ends_that_it_has(tmp_path):
    atomic.write_text(tmp_path / "a.txt", "Größe\r\n±1\n")
    assert (tmp_path / "a.txt").read_bytes() == b"Gr\xc3\xb6\xc3\x9fe\r\n\xc2\xb11\n"


def test_a_link_stays_a_link(tmp_path):
    target = tmp_path / "target.txt"
    target.write_text("old")
    (tmp_path / "link.txt").symlink_to(target)
    atomic.write_text(tmp_path / "link.txt", "new")
    assert (tmp_path / "link.txt").is_symlink()
    assert target.read_text() == "new"


def test_check_writable(tmp_path):
    atomic.check_writable(tmp_path / "new.txt")
    assert files(tmp_path) == []
    with pytest.raises(IsADirectoryError, match="is a folder"):
        atomic.check_writable(tmp_path)
    with pytest.raises(FileNotFoundError, match=r"nowhere does not exist"):
        atomic.check_writable(tmp_path / "nowhere" / "new.txt")


@pytest.mark.skipif(os.name != "posix", reason="needs a folder that nobody can write to")
def test_check_writable_tries_to_write():
    with pytest.raises(OSError, match="proc"):
        atomic.check_writable("/proc/new.txt")
