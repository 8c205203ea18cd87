"""The card: its numbers are the data's, its command makes them again, text stays text."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.cards import table
from helpers.imported import imported
from helpers.samples import SPEC, WIDE, build_small

from mapdata import (
    MapDataset,
    MapSpec,
    Maze,
    Movement,
    Pairs,
    Route,
    Terrain,
    build,
    generate,
    verify,
)
from mapdata.cli import main
from mapdata.describe import card
from mapdata.describe.dataset_card import TERRAIN_RULE, movement_text
from mapdata.formats import Collection, ForeignMap, import_maps
from mapdata.limits import SPLITS
from mapdata.shards import MANIFEST, PROVENANCE, read_manifest


def block(text: str, language: str) -> str:
    """Return the block of code in this language."""
    return text.split(f"```{language}\n")[1].split("\n```", maxsplit=1)[0]


def front_matter(text: str) -> dict[str, object]:
    """Return the YAML at the top of the card."""
    empty, matter, _ = text.split("---\n", 2)
    assert empty == ""
    return dict(yaml.safe_load(matter))


@pytest.mark.slow
@pytest.mark.parametrize("generator", [SPEC, WIDE], ids=["small", "wide"])
def test_the_card_rebuilds_the_dataset_bit_for_bit(tmp_path: Path, generator: MapSpec) -> None:
    """The card rebuilds the dataset bit for bit."""
    build(tmp_path / "it's mine", generator, maps=20, seed=2**64 - 1, shard_size=16, workers=1)
    text = card(tmp_path / "it's mine")
    (tmp_path / "again").mkdir()
    run = f"{sys.executable} -c 'from mapdata.cli import main; main()' build"
    script = block(text, "sh").replace("mapdata build", run)
    subprocess.run(["bash", "-ec", script], check=True, cwd=tmp_path / "again", capture_output=True)
    first, second = (read_manifest(tmp_path / folder / "it's mine") for folder in (".", "again"))
    assert [entry.sha256 for entry in first.shards] == [entry.sha256 for entry in second.shards]
    facts = table(text, "What it is")
    assert facts["identity"] == [first.identity]
    assert facts["content hash"] == [first.content_hash]
    assert facts["seed"] == [str(2**64 - 1)]


def test_numbers_are_those_of_the_data(tmp_path: Path) -> None:
    """Numbers are those of the data."""
    root = build_small(tmp_path / "d")
    text = card(root)
    rows = table(text, "Splits")
    for split in SPLITS:
        counts = [int(cell.replace(",", "")) for cell in rows[split]]
        frame = MapDataset(root, split=split).table()
        solvable = [
            len(MapDataset(root, split=split, problems=source())) for source in (Route, Pairs)
        ]
        all_problems = [
            len(MapDataset(root, split=split, problems=source(unsolvable=True)))
            for source in (Route, Pairs)
        ]
        assert counts == [
            len(frame),
            solvable[0],
            all_problems[0] - solvable[0],
            solvable[1],
            all_problems[1] - solvable[1],
        ]
    frame = MapDataset(root, split=None).table()
    shares = table(text, "Shares")
    for name, column in (("drawn passages", "connected"), ("reachable segments", "reachable")):
        flags = [flag for row in frame[column] for flag in row]
        assert shares[name][1] == f"{np.mean(flags):.1%} ({sum(flags):,} of {len(flags):,})"
    assert shares["fully connected maps"][1].startswith(f"{frame['all connected'].mean():.1%}")
    rooms = table(text, "Distributions")["rooms a map"]
    assert [float(cell) for cell in rooms[1::3]] == [
        frame["rooms"].min(),
        *np.quantile(frame["rooms"], (0.5,)),
        5,
    ]
    assert float(rooms[0]) == pytest.approx(frame["rooms"].mean(), rel=1e-3)


def test_front_matter_is_what_the_hub_reads(tmp_path: Path) -> None:
    """Front matter is what the hub reads."""
    values = front_matter(card(build_small(tmp_path / 'a "b": c', maps=5)))
    assert values["pretty_name"] == 'a "b": c: 5 grid maps of 20 x 20 cells'
    assert values["task_categories"] == ["robotics"]
    assert values["size_categories"] == ["n<1K"]
    assert "license" not in values  # the publisher's choice


def test_polarity_movement_and_citation_are_stated(tmp_path: Path) -> None:
    """Polarity movement and citation are stated."""
    text = card(build_small(tmp_path / "d", WIDE, maps=5))
    facts = table(text, "What it is")
    assert facts["polarity"] == ["1 occupied, 0 free"]
    assert "8-connected" in facts["movement"][0]
    assert facts["cells"] == ["(row, col), origin upper left"]
    assert "2110.13242" in block(text, "bibtex")


def test_movements_have_different_words() -> None:
    """Movements have different words."""
    movements = [
        Movement(),
        Movement(8),
        Movement(8, corner_cutting=True),
        Movement(8, diagonal_cost=1),
        Movement(8, corner_cutting=True, diagonal_cost=1),
    ]
    assert len({movement_text(movement) for movement in movements}) == len(movements)


def test_imported_maps_have_an_origin_instead_of_a_recipe(tmp_path: Path) -> None:
    """Imported maps have an origin instead of a recipe."""
    root = imported(tmp_path / "d")
    text = card(root)
    assert "```sh" not in text
    assert "drawn passages" not in text
    assert table(text, "What it is")["identity"][0].startswith("none")
    assert len(table(text, "Where it comes from")) == 1 + 1 + 6
    assert "seed points a map" in text
    assert "Some maps are in more than one split" in text
    repeats = table(text, "Duplicates")
    assert repeats["of test, also in train"] == ["1", "1"]
    assert repeats["of val, also in train"] == ["0", "1"]
    record = (root / PROVENANCE).read_text()
    (root / PROVENANCE).write_text(record.replace('"seed": 0', '"seed": 1'))
    assert (root / PROVENANCE).read_text() != record
    assert "no sound record of the source" in card(root)
    (root / PROVENANCE).unlink()
    assert "no sound record of the source" in card(root)
    for damaged in ("[1]", '{"sources": 3}', "x", '"text"'):
        (root / PROVENANCE).write_text(damaged)
        assert "no sound record of the source" in card(root)


def test_a_source_whose_name_is_no_utf8_is_on_the_card(tmp_path: Path) -> None:
    """Such names come from old archives; Python has their bytes as lone surrogates."""
    grid = np.zeros((5, 5), np.uint8)
    import_maps(tmp_path / "maps", Collection([ForeignMap("plan\udcff.png", grid)]))
    main(["info", str(tmp_path / "maps"), "--card"])
    assert "| 0 | plan?.png |\n" in (tmp_path / "maps/README.md").read_text(encoding="utf-8")


def test_text_from_files_stays_text(tmp_path: Path) -> None:
    """Text from files stays text."""
    text = card(imported(tmp_path / "<b>a|b`"))
    outside = text.replace(block(text, "python"), "")
    assert "<img" not in outside
    assert "<b>" not in outside.split("---\n", 2)[2]
    assert "\n# head" not in outside
    assert r"\*\*bold\*\* \[a\](b) \`code\` \# head" in outside
    assert front_matter(text)["pretty_name"] == "<b>a|b`: 6 grid maps of 20 x 20 cells"


def test_an_unfinished_dataset_says_so(tmp_path: Path) -> None:
    """An unfinished dataset says so."""
    root = Path(build_small(tmp_path / "d"))
    manifest = read_manifest(root)
    (root / MANIFEST).write_text(replace(manifest, shards=manifest.shards[:2]).to_json())
    text = card(root)
    assert "32 grid maps" in text
    assert "Not finished: 60 maps were asked for." in text
    recipe = json.loads(block(text, "sh").split("END'\n")[1].split("\nEND")[0])
    assert (recipe["maps"], "content_hash" in recipe) == (60, False)
    (root / MANIFEST).write_text(replace(manifest, shards=()).to_json())
    with pytest.raises(ValueError, match="holds none of its 60 maps yet"):
        card(root)


def test_command_writes_the_card_beside_the_data(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Command writes the card beside the data, with the statistics of what is served."""
    root = build_small(tmp_path / "d")
    main(["info", root, "--card"])
    assert capsys.readouterr().out == f"wrote {Path(root) / 'README.md'}\n"
    statistics = MapDataset(root).problem_statistics()
    expected = card(root, problems=statistics)
    assert (Path(root) / "README.md").read_text(encoding="utf-8") == expected
    main(["info", root, "--card", str(tmp_path / "card.md")])
    assert (tmp_path / "card.md").read_text(encoding="utf-8") == expected
    low, high = statistics.single_path.low, statistics.single_path.high
    share = f"{statistics.single_path.value:.1%}"
    rows = table(expected, "Problems that are served")
    assert rows["one shortest path"] == [f"{share} ({low:.1%} to {high:.1%})"]
    assert rows["problems"][0].startswith("route; 4-connected")
    section = expected.split("## Problems that are served\n")[1].split("\n## ")[0]
    assert f"{share} of the problems have one shortest path." in section
    assert r"optimal\_mask and optimal\_moves hold all" in section
    assert "Problems that are served" not in card(root)
    main(["info", root, "--card", "-", "--problems", "random", "--split", "val"])
    rows = table(capsys.readouterr().out, "Problems that are served")
    assert rows["problems"][0].startswith("random; 4-connected")
    assert rows["problems"][0].endswith("split val")
    assert verify(root) == []
    build_small(Path(root), maps=70)  # it still grows
    with pytest.raises(SystemExit) as ended:
        main(["info", root, "--card", "--recipe"])
    assert ended.value.code == 2


def test_only_maps_of_the_paper_are_cited_as_its_maps(tmp_path: Path) -> None:
    """Mazes have no passages to count either."""
    build(tmp_path / "mazes", Maze(), maps=5)
    text = card(tmp_path / "mazes")
    assert "The labels are those that this paper computes:" in text
    assert "mazes made by a random depth-first search, made by mapdata" in text
    assert "drawn passages" not in text
    assert "whose maps these are" in card(build_small(tmp_path / "d", maps=5))


def test_the_card_of_terrain_states_its_costs(tmp_path: Path) -> None:
    """The rule, the share of each cost, the cost of segments; the code loads the terrain."""
    generator = Terrain((12, 15), costs=(2, 9, 200), obstacles=0.2, movement=Movement(8))
    build(tmp_path / "hills", generator, maps=10, seed=1, workers=1)
    text = card(tmp_path / "hills")
    facts = table(text, "What it is")
    assert facts["terrain"] == [TERRAIN_RULE]
    assert facts["movement"] == [
        "8-connected: straight steps of length 1, diagonal steps of length sqrt 2, only beside two "
        "free cells"
    ]
    assert "least cost by A\\* between consecutive seed points" in text
    shares = table(text, "Terrain")
    terrain = generate(generator, 1, range(10)).terrain
    assert terrain is not None
    for cost in (2, 9, 200):
        count = int((terrain == cost).sum())
        assert f"({count:,} of {(terrain > 0).sum():,})" in shares[str(cost)][0]
    assert list(shares) == ["cost of a cell", "---", "2", "9", "200"]
    assert "cost of a segment" in table(text, "Distributions")
    assert not any(name.startswith("hard segments") for name in table(text, "Shares"))
    code = block(text, "python").replace("'hills'", repr(str(tmp_path / "hills")))
    names: dict[str, object] = {}
    exec(code, names)
    np.testing.assert_array_equal(
        MapDataset(tmp_path / "hills", split="train", fields=("terrain",))[0][0], names["terrain"]
    )


def test_many_costs_are_put_together_in_ranges(tmp_path: Path) -> None:
    """The table of costs stays short; its counts add up to all free cells."""
    generator = Terrain((40, 50), costs=tuple(range(1, 256)), obstacles=0.1)
    build(tmp_path / "hills", generator, maps=2, seed=1, workers=1)
    rows = table(card(tmp_path / "hills"), "Terrain")
    names = list(rows)[2:]
    assert len(names) <= 32
    assert (names[0], names[-1]) == ("1 to 8", "249 to 255")
    counts = [
        int(cells[0].split("(")[1].split(" ")[0].replace(",", ""))
        for name, cells in rows.items()
        if name in names
    ]
    assert sum(counts) == int((generate(generator, 1, range(2)).occupancy == 0).sum())
