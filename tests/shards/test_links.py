"""Datasets whose files are links, as tools that keep files by their hashes lay them out."""

from __future__ import annotations

import hashlib
import os
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.builds import Built
from helpers.imported import imported
from helpers.wild import cli

from mapdata import MapDataModule, MapDataset, Movement, ProblemSet, repair, verify
from mapdata.describe import card
from mapdata.export import export_problems
from mapdata.formats import export
from mapdata.shards import MANIFEST, PROVENANCE, Root, ShardError, read_manifest
from mapdata.shards.errors import LinkError


def hub(path: Path, real: Path) -> Path:
    """Link ``real`` as the cache of huggingface_hub does: ``snapshots/REVISION`` and ``blobs``."""
    folder = path / "datasets--me--maps" / "snapshots" / "0123abcd"
    return linked(folder, real, lambda digest, _: Path("..", "..", "blobs", digest))


def dvc(path: Path, real: Path) -> Path:
    """Link ``real`` as DVC does with ``cache.type symlink``: to absolute paths."""
    cache = path / ".dvc" / "cache" / "files" / "md5"
    return linked(path / "data", real, lambda digest, _: cache / digest[:2] / digest[2:32])


def annex(path: Path, real: Path) -> Path:
    """Link ``real`` as git-annex does in a subfolder of a repository."""

    def target(digest: str, name: str) -> Path:
        key = f"SHA256E-s1--{digest}{Path(name).suffix}"
        return Path("..", ".git", "annex", "objects", digest[:2], digest[2:4], key, key)

    return linked(path / "maps", real, target)


def linked(folder: Path, real: Path, target_of: Callable[[str, str], Path]) -> Path:
    """Move copies of the files of ``real`` to targets, and link them in ``folder``."""
    folder.mkdir(parents=True)
    for path in real.iterdir():
        target = target_of(hashlib.sha256(path.read_bytes()).hexdigest(), path.name)
        stored = Path(os.path.normpath(folder / target))
        stored.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, stored)
        (folder / path.name).symlink_to(target)
    return folder


@pytest.fixture(scope="module")
def real(built: Built) -> Path:
    """A built dataset without links."""
    return built("paper", maps=8, shard_size=4)


LAYOUTS = {"hub": hub, "dvc": dvc, "annex": annex}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_dataset_of_links_is_refused_by_name_and_followed_on_demand(
    layout: str, real: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It opens, is pickled, verifies and is described as the same dataset without links."""
    root = LAYOUTS[layout](tmp_path, real)
    refusal = "a link out of its folder, expected a plain file; 'cp -rL FOLDER COPY'"
    with pytest.raises(LinkError, match=refusal):
        MapDataset(root)
    (fault,) = verify(root)
    assert fault.startswith(f"{root / MANIFEST}: {refusal}")
    assert repair(root) == [fault]
    code, output, errors = cli(capsys, "verify", root)
    assert code == 1
    assert "damaged" not in output + errors
    assert "--follow-links" in output
    dataset = MapDataset(root, follow_links=True)
    expected = MapDataset(real)
    assert len(pickle.loads(pickle.dumps(dataset))) == len(expected)
    assert (dataset[3].map == expected[3].map).all()
    assert verify(root, follow_links=True) == []
    code, output, _ = cli(capsys, "verify", root, "--follow-links")
    assert (code, output) == (0, f"{root}: no faults found\n")
    assert repair(root, follow_links=True) == []
    assert all(path.is_symlink() for path in root.iterdir())
    shutil.copytree(root, tmp_path / "copy")  # as 'cp -rL' does
    assert verify(tmp_path / "copy") == []


@pytest.mark.slow
def test_every_door_follows_links_on_demand(
    real: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What takes a dataset takes one of links, too; the command line as well as Python."""
    root = hub(tmp_path, real)
    assert card(root, follow_links=True).count("\n") == card(real).count("\n")
    problems = ProblemSet.read(root, movement=Movement(8), split="train", follow_links=True)
    expected = ProblemSet.read(real, movement=Movement(8), split="train")
    assert problems.content_hash == expected.content_hash
    export(root, tmp_path / "release", "movingai", follow_links=True)
    export_problems(root, tmp_path / "set", split="train", follow_links=True)
    with pytest.raises(ValueError, match="follow_links: does nothing for a recipe"):
        export_problems("paper", tmp_path / "none", follow_links=True)
    module = MapDataModule(root, batch_size=2, follow_links=True)
    module.setup("fit")
    assert next(iter(module.train_dataloader())).map.shape[0] == 2
    with pytest.raises(ValueError, match="follow_links: has no effect beside build="):
        MapDataModule(root, build="paper", follow_links=True)
    for arguments in (
        ("info", root),
        ("info", root, "--card", "-"),
        ("show", root, "-o", tmp_path / "map.png"),
        ("report", root, "-o", tmp_path / "report.html", "--maps", 1),
        ("export", root, tmp_path / "gppn", "--format", "paper"),
        ("export", root, tmp_path / "arrays", "--format", "arrays", "--split", "train"),
    ):
        code, _, errors = cli(capsys, *arguments)
        assert code == 1
        assert "a link out of its folder" in errors
        code, _, errors = cli(capsys, *arguments, "--follow-links")
        assert code == 0, errors


def test_one_link_among_files_is_its_fault_alone(real: Path, tmp_path: Path) -> None:
    """A shard, one whose content is elsewhere (as before 'git annex get'), an import's record."""
    root = tmp_path / "maps"
    shutil.copytree(real, root)
    first, second = sorted(root.glob("*.h5"))
    for path in (first, second):
        shutil.move(path, tmp_path / path.name)
        path.symlink_to(tmp_path / path.name)
    one, two = verify(root)
    assert one.startswith(f"{first}: a link out of its folder")
    assert two.startswith(f"{second}: a link out of its folder")
    with pytest.raises(ShardError, match="a link out of its folder"):
        Root.open(root).open_shard(0)
    (tmp_path / second.name).unlink()
    (fault,) = verify(root, follow_links=True)
    target = tmp_path / second.name
    assert fault == f"{second}: a link to {target}, where there is no file, expected a plain file"
    brought = imported(tmp_path / "imported")
    (tmp_path / "record").write_bytes((brought / PROVENANCE).read_bytes())
    (brought / PROVENANCE).unlink()
    (brought / PROVENANCE).symlink_to(tmp_path / "record")
    (fault,) = verify(brought)
    assert fault.startswith(f"{brought / PROVENANCE}: a link out of its folder")
    assert verify(brought, follow_links=True) == []


def test_damage_behind_links_is_found(real: Path, tmp_path: Path) -> None:
    """The manifest or a shard is damaged where it is kept; the shards of a lost manifest count."""
    root = hub(tmp_path, real)
    shard = min(root.glob("*.h5"))
    content = bytearray(shard.read_bytes())
    content[len(content) // 2] ^= 255
    kept = shard.resolve()
    sound = kept.read_bytes()
    kept.write_bytes(content)
    (fault,) = verify(root, follow_links=True)
    assert str(shard) in fault
    kept.write_bytes(sound)
    (root / MANIFEST).resolve().write_bytes(b"{}")
    (fault,) = verify(root, follow_links=True)
    assert MANIFEST in fault
    assert "not a manifest" in fault or "damaged" in fault
    assert read_manifest(real).maps == 8


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("lost", ["a shard", "the manifest"])
def test_repair_replaces_a_link_and_leaves_its_target(
    layout: str, lost: str, real: Path, tmp_path: Path
) -> None:
    """A dataset with damage behind a link becomes the one that was built, byte for byte."""
    root = LAYOUTS[layout](tmp_path, real)
    path = min(root.glob("*.h5")) if lost == "a shard" else root / MANIFEST
    target = path.resolve()
    target.write_bytes(b"{}")
    assert repair(root, follow_links=True) == []
    assert {file.name: file.read_bytes() for file in root.iterdir() if file.name != ".lock"} == {
        file.name: file.read_bytes() for file in real.iterdir() if file.name != ".lock"
    }
    assert not path.is_symlink()
    assert target.read_bytes() == b"{}"


def test_the_command_repairs_behind_links(
    real: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A shard whose content is elsewhere, as before 'git annex get', is built anew."""
    root = annex(tmp_path, real)
    shard = min(root.glob("*.h5"))
    shard.resolve().unlink()
    code, output, _ = cli(capsys, "verify", root, "--repair", "--follow-links")
    assert code == 0
    assert f"{root}: 1 repaired" in output
    assert shard.read_bytes() == (real / shard.name).read_bytes()
