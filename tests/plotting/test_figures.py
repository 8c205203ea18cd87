"""Figures of a dataset: the gallery shows what its captions say, the distributions show every
value.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.figures import assert_tidy, figure_of
from helpers.samples import SPEC, WIDE, build_small

from mapdata import MapSpec, generate
from mapdata.cli import main
from mapdata.describe import DatasetStatistics, dataset_statistics
from mapdata.formats import Collection, ForeignMap, import_maps
from mapdata.plotting import plot_distributions, plot_gallery
from mapdata.plotting.figures import FIGURES, pick_examples, plot_figure


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> DatasetStatistics:
    """Return a look at a small dataset."""
    return dataset_statistics(build_small(tmp_path_factory.mktemp("small") / "d"))


def test_examples_are_what_their_captions_say(small: DatasetStatistics) -> None:
    """The rooms, connection or hardness of each example are those that its caption states."""
    examples = pick_examples(small)
    assert list(examples) == [
        "2 rooms",
        "3 rooms",
        "4 rooms",
        "not connected",
        "redundant",
        "5 rooms",
        f"hardness {small.hardest.max():.2f}",
    ]
    assert len(set(examples.values())) == len(examples)
    for caption, index in examples.items():
        labels, i = small.root.locate(index)
        n = int(labels.maps.rooms[i])
        if caption.endswith("rooms"):
            assert caption == f"{n} rooms"
        if caption not in {"not connected", "5 rooms"} and not caption.startswith("hardness"):
            assert (labels.matrix("astar", i) >= 0).all()
        if caption == "not connected":
            assert (labels.matrix("astar", i) < 0).any()
        if caption == "redundant":
            assert not labels.maps.connected[i, : n - 1].all()
    assert pick_examples(dataset_statistics(small.root.locations)) == examples


def test_gallery_draws_the_maps(small: DatasetStatistics) -> None:
    """Each example is drawn with its caption, and axes without an example are switched off."""
    axes, examples = plot_gallery(small), pick_examples(small)
    for ax, (caption, index) in zip(axes, examples.items(), strict=False):
        assert ax.get_title() == f"{caption}\nmap{index}"
        np.testing.assert_array_equal(
            ax.get_images()[0].get_array(), generate(SPEC, 5, [index]).occupancy[0]
        )
    assert not axes[-1].axison
    assert_tidy(figure_of(axes[0]))


@pytest.mark.slow
def test_distributions_draw_every_value(small: DatasetStatistics) -> None:
    """The bars of a histogram count all maps or segments."""
    axes = plot_distributions(small)
    for ax, (name, values) in zip(axes, small.distributions().items(), strict=True):
        assert ax.get_xlabel() == name
        assert sum(bar.get_height() for bar in ax.containers[0].patches) == len(values)  # type: ignore[attr-defined]
    assert_tidy(figure_of(axes[0]))


@pytest.mark.slow
@pytest.mark.parametrize(
    "generator", [WIDE, MapSpec((70, 9), (2, 9), (3, 12), (2, 4), (1, 2))], ids=["wide", "tall"]
)
def test_all_figures_are_tidy_and_reproducible(tmp_path: Path, generator: MapSpec) -> None:
    """No texts overlap, and a figure that is drawn twice has the same bytes."""
    root = build_small(tmp_path / "d", generator)
    for figure in FIGURES:
        assert_tidy(plot_figure(root, figure, index=7))
    first, second = (tmp_path / name for name in ("a.png", "b.png"))
    for path in (first, second):
        plot_figure(root, "map", index=3).savefig(path, dpi=50)
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.slow
def test_imported_maps_are_drawn_without_rooms(tmp_path: Path) -> None:
    """Captions and axes speak of seed points, and a map may have only one, but then no search."""
    grids = generate(WIDE, 5, range(6)).occupancy
    one = ForeignMap("one", grids[5], seed_points=np.argwhere(grids[5] == 0)[:1], rooms_known=True)
    maps = [*(ForeignMap(str(k), grid) for k, grid in enumerate(grids[:5])), one]
    import_maps(tmp_path / "d", Collection(maps), seed_points=3)
    for figure in FIGURES:
        for index in (0,) if figure == "search" else (0, 5):
            assert_tidy(plot_figure(tmp_path / "d", figure, index=index))
    statistics = dataset_statistics(tmp_path / "d")
    assert [axes.get_title().split("\n")[0] for axes in plot_gallery(statistics)][:2] == [
        "1 seed point",
        "3 seed points",
    ]


def test_the_gallery_of_equally_many_seed_points_goes_from_easy_to_hard(tmp_path: Path) -> None:
    """Each map is shown once, and the only number of seed points is the only tick."""
    grids = generate(MapSpec.preset("dungeon"), 5, range(40)).occupancy
    import_maps(
        tmp_path / "d",
        Collection([ForeignMap(str(k), grid) for k, grid in enumerate(grids)]),
        seed_points=4,
    )
    statistics = dataset_statistics(tmp_path / "d")
    examples = pick_examples(statistics)
    captions = [caption for caption in examples if caption.startswith("hardness")]
    assert len(captions) == 6
    assert captions == sorted(captions)
    assert len(set(examples.values())) == len(examples)
    for caption in captions:
        assert caption == f"hardness {statistics.hardest[examples[caption]]:.2f}"
    (rooms, *_) = plot_distributions(statistics)
    figure_of(rooms).canvas.draw()
    low, high = rooms.get_xlim()
    assert [tick for tick in rooms.get_xticks() if low <= tick <= high] == [4]


@pytest.mark.slow
@pytest.mark.parametrize("figure", FIGURES)
def test_command_writes_every_figure(small: DatasetStatistics, tmp_path: Path, figure: str) -> None:
    """``mapdata show`` writes each figure as a PNG."""
    path = tmp_path / f"{figure}.png"
    main(["show", str(small.root), "--figure", figure, "-o", str(path)])
    assert path.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--figure", "gallery", "--index", "3"], "--index: does nothing"),
        (["--figure", "matrix", "--paper-colours"], "--paper-colours: does nothing"),
        (["--figure", "pie"], "invalid choice"),
        (["--figure", "galery"], "; did you mean gallery?"),
        (["--index", "60"], "holds maps 0 to 59"),
        (["-o", "map.xyz"], "xyz"),
    ],
)
def test_the_command_refuses_wrong_usage(
    small: DatasetStatistics,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    complaint: str,
) -> None:
    """Flags that would do nothing and unknown figures are refused in one line."""
    with pytest.raises(SystemExit) as ended:
        main(["show", str(small.root), *arguments])
    assert ended.value.code == 2
    assert complaint in capsys.readouterr().err


def test_unknown_figure_is_refused(small: DatasetStatistics) -> None:
    """The message lists the figures."""
    with pytest.raises(ValueError, match="expected one of map, gallery"):
        plot_figure(small.root.locations, "pie")
