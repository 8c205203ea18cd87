"""Temporary files and folders: what dead writers left is removed, and nothing else."""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mapdata.shards import write_output
from mapdata.shards.files import new_output, sweep_temporaries, temporary_folder, temporary_path

TARGET = "maps.npz"


def leave_folder(target: Path) -> Path:
    """Make what an export that was killed leaves beside ``target``."""
    folder = temporary_path(target)
    with temporary_folder(target) as living:
        (living / "export" / "train").mkdir(parents=True)
        (living / "export" / "train" / "map0.png").write_bytes(b"half a picture")
        shutil.copytree(living, folder)
    return folder


def leave_file(target: Path) -> Path:
    """Make what a write that was killed leaves beside ``target``."""
    path = temporary_path(target)
    path.write_bytes(b"half a file")
    return path


@pytest.mark.parametrize("name", ["m" * 255, "\N{GREEK SMALL LETTER PI}" * 127, "s" * 216 + ".npz"])
def test_the_longest_names_can_be_written(name: str, tmp_path: Path) -> None:
    """A file and a folder of up to 255 bytes; what a killed writer leaves of them is swept."""
    write_output(tmp_path / name, b"whole")
    assert (tmp_path / name).read_bytes() == b"whole"
    dead = [leave_file(tmp_path / name), leave_folder(tmp_path / name)]
    assert all(len(os.fsencode(path.name)) <= 255 for path in dead)
    with new_output(tmp_path / "folder" / name) as output:
        output.mkdir()
    assert (tmp_path / "folder" / name).is_dir()
    sweep_temporaries(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {name, "folder"}


def test_what_dead_writers_left_is_swept(tmp_path: Path) -> None:
    """Files and folders, of any target in the folder; those that are locked stay."""
    dead = [leave_file(tmp_path / TARGET), leave_folder(tmp_path / "export")]
    living = leave_file(tmp_path / TARGET)
    with open(living, "r+b") as file, temporary_folder(tmp_path / "export") as folder:
        fcntl.flock(file, fcntl.LOCK_EX)
        sweep_temporaries(tmp_path)
        assert [path.exists() for path in dead] == [False, False]
        assert set(tmp_path.iterdir()) == {living, folder}
    sweep_temporaries(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "name",
    [
        ".maps.npz.0123456789abcdef.tmp",  # without the mark of mapdata
        ".maps.npz.0123456789ABCDEF.mapdata.tmp",
        ".0123456789abcdef.mapdata.tmp",
        "maps.npz.0123456789abcdef.mapdata.tmp",
        ".maps.npz.0123456789abcdef.mapdata.tmp.bak",
    ],
)
def test_other_names_are_left_alone(name: str, tmp_path: Path) -> None:
    """A folder of the user may hold anything."""
    (tmp_path / name).touch()
    sweep_temporaries(tmp_path)
    assert (tmp_path / name).exists()


def test_links_and_pipes_are_left_alone(tmp_path: Path) -> None:
    """Neither is followed, nor waited for."""
    (tmp_path / "export").mkdir()
    (tmp_path / "export" / "lock").touch()
    links = [temporary_path(tmp_path / TARGET) for _ in range(3)]
    links[0].symlink_to(tmp_path / "export")
    links[1].symlink_to(tmp_path / "export" / "lock")
    os.mkfifo(links[2])
    sweep_temporaries(tmp_path)
    assert all(os.path.lexists(path) for path in links)
    assert (tmp_path / "export" / "lock").exists()


def test_a_kill_at_any_step_leaves_nothing_that_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each state that a writer's folder goes through, without its lock, is swept: that is what a
    killed writer leaves.
    """
    home = tmp_path / "home"
    home.mkdir()
    states: list[Path] = []
    copying: list[bool] = []

    def watched(true_function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            if not copying:
                copying.append(True)
                shutil.copytree(home, tmp_path / f"state {len(states)}")
                states.append(tmp_path / f"state {len(states)}")
                copying.clear()
            return true_function(*arguments, **options)

        return call

    with monkeypatch.context() as patch:
        for name in ("mkdir", "unlink", "rmdir", "scandir"):
            patch.setattr(os, name, watched(getattr(os, name)))
        patch.setattr("builtins.open", watched(open))
        with temporary_folder(home / "export") as folder:
            (folder / "output" / "train").mkdir(parents=True)
            for number in range(3):
                (folder / "output" / "train" / f"map{number}.png").write_bytes(b"picture")
            (folder / "notes").write_bytes(b"note")
    assert list(home.iterdir()) == []
    left = {len([*state.rglob("*")]) for state in states}
    assert left >= {0, 1, 2, 8}
    for state in states:
        sweep_temporaries(state)
        assert list(state.iterdir()) == []


def test_a_folder_whose_lock_is_lost_stays_for_a_day(tmp_path: Path) -> None:
    """Nothing says that its writer is dead, but its age."""
    folder = leave_folder(tmp_path / "export")
    (folder / "lock").unlink()
    sweep_temporaries(tmp_path)
    assert folder.exists()
    old = folder.stat().st_mtime - 90_000
    os.utime(folder, (old, old))
    sweep_temporaries(tmp_path)
    assert not folder.exists()


def test_an_empty_folder_that_is_swept_too_early_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sweep between making the folder and making its lock costs the writer nothing."""
    true_mkdir = os.mkdir
    swept: list[object] = []

    def mkdir(path: Any, *arguments: Any) -> None:
        true_mkdir(path, *arguments)
        if not swept:
            swept.append(path)
            sweep_temporaries(tmp_path)
            assert not Path(path).exists()

    monkeypatch.setattr("os.mkdir", mkdir)
    with temporary_folder(tmp_path / "export") as folder:
        assert list(tmp_path.iterdir()) == [folder]
    assert swept
    assert list(tmp_path.iterdir()) == []


def test_without_locks_the_age_tells(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was begun within a day may have a living writer."""

    def flock(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", flock)
    left = [leave_file(tmp_path / TARGET), leave_folder(tmp_path / "export")]
    for age, stays in ((80_000, True), (90_000, False)):
        for path in left:
            old = path.stat().st_mtime - age
            os.utime(path, (old, old))
        sweep_temporaries(tmp_path)
        assert [path.exists() for path in left] == [stays, stays]


def test_a_folder_that_is_swept_too_early_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between making it and having its lock, a writer looks like a dead one."""
    true_flock = fcntl.flock
    swept: list[Path] = []

    def flock(file: int, how: int) -> None:
        if not swept:
            swept.extend(tmp_path.iterdir())
            sweep_temporaries(tmp_path)
        true_flock(file, how)

    monkeypatch.setattr("fcntl.flock", flock)
    with temporary_folder(tmp_path / "export") as folder:
        assert not swept[0].exists()
        assert list(tmp_path.iterdir()) == [folder]
        (folder / "export").write_bytes(b"whole")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_goes_with_what_it_holds(tmp_path: Path) -> None:
    """When its writer fails, too."""

    def fail() -> None:
        with temporary_folder(tmp_path / "export") as folder:
            (folder / "export").write_bytes(b"half")
            raise OSError("disk")

    with pytest.raises(OSError, match="disk"):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_a_write_to_what_users_name_sweeps(tmp_path: Path) -> None:
    """Whatever the name, in a folder that is behind a link, too."""
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "folder" / TARGET)
    leave_file(tmp_path / "folder" / "other")
    write_output(tmp_path / "link", b"whole")
    assert list((tmp_path / "folder").iterdir()) == [tmp_path / "folder" / TARGET]
