"""Files appear whole or not at all."""

import os
import stat
from pathlib import Path

import pytest

from guara_perception import InvalidInput, MissingFile
from guara_perception.files import check_target, whole_file, whole_folder


def test_file_appears_with_its_content(tmp_path: Path):
    """What was written under the temporary name has the wanted one, and nothing else is left."""
    target = tmp_path / "out.npz"
    with whole_file(target) as temporary:
        temporary.write_text("all of it")
        assert temporary.suffix == ".npz" and temporary.parent == tmp_path
        assert not target.exists()
    assert target.read_text() == "all of it"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_an_error_leaves_the_old_file_as_it_was(tmp_path: Path, error: type[BaseException]):
    """Whatever stops the writing, the old file stays and no half-written one is left beside it."""
    target = tmp_path / "out.json"
    target.write_text("old")
    with pytest.raises(error), whole_file(target) as temporary:
        temporary.write_text("half")
        raise error
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_an_error_leaves_nothing_where_nothing_was(tmp_path: Path):
    """A first file that fails is not there at all."""
    with pytest.raises(RuntimeError), whole_file(tmp_path / "out.json") as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_takes_no_files_is_told_by_the_name_given() -> None:
    """Not by the temporary name, which the user does not know."""
    with pytest.raises(OSError, match=r"'/proc/out\.json'"), whole_file("/proc/out.json"):
        pass


@pytest.mark.parametrize("mask", [0o022, 0o077])
def test_permissions_are_those_of_any_new_file(tmp_path: Path, mask: int):
    """The file is as readable as any that the user makes: mode 666 less the mask."""
    target = tmp_path / "out"
    old = os.umask(mask)
    try:
        with whole_file(target) as temporary:
            temporary.write_text("x")
    finally:
        os.umask(old)
    assert stat.S_IMODE(target.stat().st_mode) == 0o666 & ~mask


@pytest.mark.parametrize("use", [check_target, lambda path: whole_file(path).__enter__()])
def test_folder_that_does_not_exist_is_refused_at_once(tmp_path: Path, use):
    """The message names the file and the folder to create."""
    with pytest.raises(MissingFile, match="out.npz: the folder .*nowhere does not exist; create it first"):
        use(tmp_path / "nowhere" / "out.npz")


@pytest.mark.parametrize("use", [check_target, lambda path: whole_file(path).__enter__()])
def test_folder_in_place_of_a_file_is_refused(tmp_path: Path, use):
    """A folder is not overwritten."""
    with pytest.raises(InvalidInput, match="is a folder; give the name of a file"):
        use(tmp_path)


def test_two_writers_do_not_meet(tmp_path: Path):
    """Two that write the same file at once use different temporary names; the later one wins whole."""
    target = tmp_path / "out"
    with whole_file(target) as first, whole_file(target) as second:
        assert first != second
        first.write_text("first")
        second.write_text("second")
    assert target.read_text() == "first"


def test_a_folder_appears_whole(tmp_path: Path) -> None:
    """Its files are in it at once, it replaces an empty folder, and others may read it as any new folder."""
    target = tmp_path / "out"
    target.mkdir()
    with whole_folder(target) as temporary:
        (temporary / "file").write_text("all of it")
        assert not any(target.iterdir())
    assert (target / "file").read_text() == "all of it" and stat.S_IMODE(target.stat().st_mode) == 0o755
    assert list(tmp_path.iterdir()) == [target]


def test_a_folder_that_fails_leaves_nothing(tmp_path: Path) -> None:
    """Nothing is left of a folder whose writer fails, and a folder with files is never replaced."""
    with pytest.raises(RuntimeError), whole_folder(tmp_path / "out") as temporary:
        (temporary / "file").write_text("half")
        raise RuntimeError
    assert not any(tmp_path.iterdir())
    (tmp_path / "kept").write_text("old")
    with pytest.raises(OSError, match="not empty"), whole_folder(tmp_path) as temporary:
        (temporary / "file").write_text("new")
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]
    assert not list(tmp_path.parent.glob(f".{tmp_path.name}-*"))
