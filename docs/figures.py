"""Draws the pictures of README and the pages: python docs/figures.py [NAME ...].

Each is drawn twice, `docs/images/NAME.png` for light pages and `docs/images/NAME-dark.png` for
dark ones. Without names all are drawn, in some minutes of one core. `pip install -e ".[examples]"`
comes first, and a Chromium for the picture of the report.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from PIL import Image

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))  # mapdata, scripts

from mapdata import (  # noqa: E402
    Labels,
    MapGenerator,
    MapSpec,
    Maze,
    Movement,
    OnlineMapDataset,
    Random,
    Tiles,
    astar,
    build,
    check_path,
    generate,
    label,
)
from mapdata.describe import dataset_statistics  # noqa: E402
from mapdata.evaluation import Plan  # noqa: E402
from mapdata.formats import Collection, ForeignMap, import_maps  # noqa: E402
from mapdata.generators import PRESETS  # noqa: E402
from mapdata.plotting import (  # noqa: E402
    COLOURS,
    MARKERS,
    PALETTE,
    STYLE,
    plot_distributions,
    plot_gallery,
    plot_grid,
    plot_map,
    plot_matrix,
    plot_path,
    plot_planners,
    plot_prediction,
    plot_roadmap,
    report,
)
from mapdata.problems import ProblemSet  # noqa: E402
from mapdata.shards import Root  # noqa: E402

IMAGES = ROOT / "docs" / "images"
LARGEST = 150_000
"""Bytes of a picture."""

GREY = "#8b949e"
CLEAR = {"axes.facecolor": "none", "axes.titlesize": "medium", "figure.facecolor": "none"}
THEMES: dict[str, dict[Any, Any]] = {
    "": CLEAR,
    "-dark": {
        **CLEAR,
        "axes.labelcolor": "#d0d7de",
        "grid.color": GREY,
        "text.color": "#d0d7de",
        "xtick.color": GREY,
        "ytick.color": GREY,
    },
}
"""What a theme adds to `STYLE`."""

DUNGEON = MapSpec.preset("dungeon")
DIAGONAL = Movement(connectivity=8)
PICKED = 9
HARD = Random(hardness=(1.3, None), length=(60, None))
"""Problems to look at: the heuristic leads astray."""


def new_figure(rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """Return a figure of this size in inches and its axes, from left to right."""
    figure = Figure(figsize=size, layout="constrained")
    return figure, list(figure.subplots(rows, columns, squeeze=False).flat)


def bare(axes: Axes, title: str = "") -> None:
    """Leave nothing about a map but a title."""
    axes.set(xlabel="", ylabel="", xticks=[], yticks=[], title=title)
    if legend := axes.get_legend():
        legend.remove()


def mosaic(grids: list[npt.NDArray[np.uint8]], columns: int) -> npt.NDArray[np.float64]:
    """Return maps of one size side by side as one picture, each in a grey frame."""
    rows, wide = grids[0].shape
    gap = max(rows // 16, 2)
    lines = -(-len(grids) // columns)
    shape = (lines * (rows + gap) + gap, columns * (wide + gap) + gap)
    found = np.full(shape, 0.55)
    for k, grid in enumerate(grids):
        row = gap + k // columns * (rows + gap)
        column = gap + k % columns * (wide + gap)
        found[row : row + rows, column : column + wide] = grid
    return found


def overview() -> Figure:
    """Maps; the labels of one; a target to learn; what a network learnt."""
    figure, axes = new_figure(1, 4, (13, 3.5))
    narrow = MapSpec.preset("narrow")
    wide_maze = Maze((64, 64), corridor=3, reopened=0.1)
    chosen: list[tuple[MapGenerator, int]] = [(MapSpec(), 7), (narrow, 4), (DUNGEON, 3)]
    chosen += [(DUNGEON, 9), (Maze((64, 64)), 1), (wide_maze, 3)]
    chosen += [(MapGenerator.preset(name), 1) for name in ("cave", "forest", "noise")]
    grids = [generate(generator, 0, [index]).occupancy[0] for generator, index in chosen]
    plot_grid(mosaic(grids, 3), axes[0])
    bare(axes[0], "grid maps from a few lines of JSON")

    plot_map(label(generate(MapSpec(), 0, [7])), 0, axes[1])
    bare(axes[1], "routes through the rooms: BFS, A*")

    problem = hard_problems(("map", "start", "goal", "path", "cost_to_go"))[PICKED]
    cost_to_go(axes[2], problem)
    bare(axes[2], "cost to go, and a shortest path")

    prediction(axes[3], problem)
    bare(axes[3], "a path that a network predicts")
    return figure


def hard_problems(fields: tuple[str, ...]) -> list[Any]:
    """Return problems on maps that no training saw."""
    dataset = OnlineMapDataset(
        DUNGEON, 77, length=12, fields=fields, problems=HARD, movement=DIAGONAL
    )
    return [dataset[k] for k in range(len(dataset))]


def cost_to_go(axes: Axes, sample: Any) -> None:
    """Shade each cell by the cost of its shortest path to the goal."""
    plot_grid(sample.map[0], axes)
    costs = np.asarray(sample.cost_to_go[0])
    axes.imshow(np.ma.masked_less(costs, 0), cmap="viridis_r", interpolation="nearest")
    path = np.asarray(sample.path)
    path = path[path[:, 0] >= 0]
    axes.plot(path[:, 1], path[:, 0], color="white", linewidth=2)
    axes.plot(path[0, 1], path[0, 0], "o", color="white", markeredgecolor="black", markersize=8)
    axes.plot(path[-1, 1], path[-1, 0], "s", color="white", markeredgecolor="black", markersize=8)


def prediction(axes: Axes, sample: Any) -> None:
    """Draw the path that the shipped network predicts over a shortest one."""
    from mapdata.models.path_predictor import PathPredictor

    model = PathPredictor.pretrained()
    grid, start, goal = (np.asarray(sample[k]).astype(np.int64) for k in range(3))
    truth = astar(grid[0], start, goal, DIAGONAL).path
    with model.inference():
        shades = model(*model.tensors(grid[None].astype(np.uint8), goal[None]))[1][0].numpy()
    plot_prediction(grid[0], model.predict_path(grid, start, goal), truth, axes, scores=shades)


def run_first_block(page: str) -> dict[str, Any]:
    """Run the first Python of a page in an empty folder; return what it defines."""
    text = (ROOT / page).read_text(encoding="utf-8")
    code = re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)[0]
    session: dict[str, Any] = {"__name__": page}
    before = Path.cwd()
    with TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            exec(compile(code, page, "exec", dont_inherit=True), session)
        finally:
            os.chdir(before)
    return session


def batch() -> Figure:
    """Keep the picture that README's loop ends in."""
    figure = run_first_block("README.md")["figure"]
    assert isinstance(figure, Figure)
    return figure


def clearance() -> Figure:
    """Show the label of one's own that docs/howto/labels.md computes."""
    field = run_first_block("docs/howto/labels.md")["room"]
    dataset = OnlineMapDataset(DUNGEON, 0, length=20, fields=("map", field), problems=Random())
    figure, axes = new_figure(1, 3, (10.2, 3.6))
    for ax, k in zip(axes, (3, 9, 12), strict=True):
        sample: Any = dataset[k]
        plot_grid(sample.map[0], ax)
        values = np.asarray(sample.room[0])
        image = ax.imshow(np.ma.masked_equal(values, 0), cmap="viridis", interpolation="nearest")
        bare(ax)
    figure.colorbar(image, ax=axes, label="clearance, cells", shrink=0.8)
    return figure


def imported() -> Figure:
    """Show the floor plans that docs/howto/maps.md imports."""
    plans = run_first_block("docs/howto/maps.md")["plans"]
    source = Collection([ForeignMap(f"plan {k}", plan) for k, plan in enumerate(plans)])
    figure, axes = new_figure(1, 3, (10.2, 3.8))
    with TemporaryDirectory() as folder:
        import_maps(folder, source, seed_points=6)
        root = Root.open(folder)
        for ax, index in zip(axes, (3, 8, 13), strict=True):
            labels, i = root.locate(index)
            plot_map(labels, i, ax)
            bare(ax, f"plan {index}")
    return figure


def generators() -> Figure:
    """Show the maps that docs/howto/spec.md draws."""
    figure, axes = new_figure(1, 2, (11.5, 4))
    plot_map(run_first_block("docs/howto/spec.md")["labels"], 0, axes[0])
    bare(axes[0], "MapSpec(map_size=(48, 96), ...)")
    maze = Maze((45, 69), corridor=2, reopened=0.1)
    plot_map(label(generate(maze, 5, [0])), 0, axes[1])
    bare(axes[1], "Maze((45, 69), corridor=2, reopened=0.1)")
    return figure


def speed() -> Figure:
    """Show two tables of docs/benchmarks.md as bars."""
    page = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.splitlines()]
    paths = {"mapdata": 1.0}
    loading = {"mapdata": 1.0}
    for work, _, _, ratio, _, note in (row for row in rows if len(row) == 6):
        peer = re.split("[:,]", note)[0]
        factor = ratio.rstrip("x").replace(",", "")
        if work == "A* a path, 64 x 64, single calls":
            paths[peer] = float(factor)
        if work.endswith("map, start, goal, path_mask") and not peer.startswith("memset"):
            loading.setdefault(peer, float(factor))  # of 10,000 maps, the first rows
    figure, axes = new_figure(1, 2, (10.2, 3.6))
    titles = ("time of a path by A*, 64 x 64, log scale", "time of a sample, log scale")
    for ax, title, factors in zip(axes, titles, (paths, loading), strict=True):
        names = sorted(factors, key=lambda name: factors[name])
        colours = [COLOURS["bfs" if name == "mapdata" else "astar"] for name in names]
        bars = ax.barh(names, [factors[name] for name in names], color=colours)
        ax.bar_label(bars, [f" {factors[name]:,.3g} x" for name in names], fontsize="small")
        ax.set(
            xscale="log", title=title, xlim=(0.7 * min(factors.values()), 3 * max(factors.values()))
        )
        ax.invert_yaxis()
        ax.xaxis.set_visible(False)
        for side in ("top", "right", "bottom"):
            ax.spines[side].set_visible(False)
    return figure


def families() -> Figure:
    """Show two maps of each preset."""
    figure, axes = new_figure(2, len(PRESETS) // 2, (11, 11.4))
    for ax, (name, generator) in zip(axes, PRESETS.items(), strict=True):
        plot_grid(mosaic(list(generate(generator, 0, range(2)).occupancy), 1), ax)
        bare(ax, f"{name}, {generator.map_size[0]} x {generator.map_size[1]}")
    return figure


def presets() -> Figure:
    """Show one map of each preset in a row."""
    figure, axes = new_figure(1, len(PRESETS), (13, 1.9))
    for ax, (name, generator) in zip(axes, PRESETS.items(), strict=True):
        plot_grid(generate(generator, 0, [1]).occupancy[0], ax)
        bare(ax, name)
    return figure


def movements() -> Figure:
    """Show the shortest path under each rule of moves."""
    figure, axes = new_figure(1, 3, (9.5, 3))
    grid = np.zeros((9, 11), np.uint8)
    grid[2:7, 3] = 1
    grid[4, 3:8] = 1
    grid[1, 8] = 1
    rules = {
        "4-connected": Movement(),
        "8-connected": DIAGONAL,
        "8-connected, corners cut": Movement(connectivity=8, corner_cutting=True),
    }
    for ax, (name, movement) in zip(axes, rules.items(), strict=True):
        found = astar(grid, (6, 1), (2, 9), movement)
        plot_prediction(grid, np.empty((0, 2)), found.path, ax)
        bare(ax, f"{name}: cost {found.cost:.4g}")
        ax.set_xticks(np.arange(11) - 0.5, minor=True)
        ax.set_yticks(np.arange(9) - 0.5, minor=True)
        ax.grid(which="minor", color="0.85")
        ax.tick_params(which="minor", length=0)
    return figure


def one_map() -> Labels:
    """Return the map that the paper's figures are drawn for here."""
    return label(generate(MapSpec(), 0, [7]))


def figure_1() -> Figure:
    """Draw the paper's Figure 1: a map, its seed points and its routes."""
    figure, (ax,) = new_figure(1, 1, (5.6, 6.2))
    plot_map(one_map(), 0, ax)
    return figure


def gallery() -> Figure:
    """Draw the paper's Figure 2: examples."""
    with TemporaryDirectory() as folder:
        build(folder, MapSpec(), maps=1000, seed=0)
        figure, axes = new_figure(2, 4, (10.4, 6.2))
        plot_gallery(dataset_statistics(folder), axes)
    return figure


def figure_3() -> Figure:
    """Draw the paper's Figure 3: the route of each search and its iterations."""
    figure, axes = new_figure(1, 2, (11, 6.6))
    for search, ax in zip(("bfs", "astar"), axes, strict=True):
        plot_path(one_map(), 0, search, ax)
    return figure


def figure_4() -> Figure:
    """Draw the paper's Figure 4: a connection matrix."""
    figure, (ax,) = new_figure(1, 1, (6, 5.2))
    plot_matrix(one_map(), 0, axes=ax)
    return figure


def distributions() -> Figure:
    """Show what a dataset holds."""
    with TemporaryDirectory() as folder:
        build(folder, DUNGEON, maps=2000, seed=0)
        figure, axes = new_figure(2, 2, (9, 5.6))
        plot_distributions(dataset_statistics(folder), axes)
    return figure


def fields() -> Figure:
    """Show the fields of one problem that are pictures."""
    names = ("path_mask", "optimal_mask", "cost_to_go", "heuristic_ratio", "path_probability")
    sample = hard_problems(("map", "start", "goal", "path", *names, "optimal_moves"))[PICKED]
    figure, axes = new_figure(2, 3, (10.2, 7.2))
    free = np.asarray(sample.map[0]) == 0
    for ax, name in zip(axes, names, strict=False):
        plot_grid(sample.map[0], ax)
        values = np.asarray(getattr(sample, name)[0], np.float64)
        shown = np.where(free & (values > 0), values, np.nan)
        cmap = ListedColormap([COLOURS["astar"]]) if name.endswith("mask") else "viridis"
        ax.imshow(shown, cmap=cmap, interpolation="nearest")
        bare(ax, name)
    counts = np.zeros(free.shape)
    for move in range(8):
        counts += np.asarray(sample.optimal_moves[0]) >> move & 1
    plot_grid(sample.map[0], axes[5])
    axes[5].imshow(np.where(free & (counts > 0), counts, np.nan), cmap="viridis")
    bare(axes[5], "optimal_moves: how many a cell")
    return figure


def answers(family: str) -> tuple[tuple[Any, Plan], tuple[Any, Plan]]:
    """Return the first of a family's ``HARD`` problems, and the next not solved at least cost.

    Where all of 200 are, the one with most expansions is the second.
    """
    from mapdata.models.learned_planners import GuidedSearch
    from mapdata.models.path_predictor import PathPredictor

    search = GuidedSearch("search", PathPredictor.pretrained())
    dataset = OnlineMapDataset(
        MapGenerator.preset(family),
        77,
        length=200,
        fields=("map", "start", "goal", "path", "cost"),
        problems=HARD,
        movement=DIAGONAL,
    )
    answered: list[tuple[Any, Plan]] = []
    for k in range(len(dataset)):
        sample: Any = dataset[k]
        plan = search.plan(sample.map[0], sample.start, sample.goal)
        answered.append((sample, plan))
        cost = check_path(sample.map[0], plan.path, DIAGONAL)
        if k and cost > float(sample.cost) + 1e-3:
            return answered[0], answered[-1]
    return answered[0], max(answered, key=lambda answer: answer[1].expansions)


def predictions() -> Figure:
    """Show what the path predictor answers to hard problems of each family, failures included."""
    families = ("paper", "dungeon", "maze", "cave", "forest", "noise")
    figure, axes = new_figure(2, 6, (14, 5.8))
    for k, family in enumerate(families):
        for ax, (sample, plan) in zip((axes[k], axes[k + 6]), answers(family), strict=True):
            plot_grid(sample.map[0], ax)
            truth = np.asarray(sample.path[sample.path[:, 0] >= 0])
            for path, colour, width in ((truth, "astar", 4), (plan.path, "bfs", 1.8)):
                ax.plot(path[:, 1], path[:, 0], color=COLOURS[colour], linewidth=width)
            ends = {"o": sample.start, "s": sample.goal}
            for marker, (row, column) in ends.items():
                ax.plot(column, row, marker, color="white", markeredgecolor="black", markersize=7)
            best = astar(np.asarray(sample.map[0]), sample.start, sample.goal, DIAGONAL)
            cost = check_path(sample.map[0], plan.path, DIAGONAL) / float(sample.cost)
            expansions = plan.expansions / best.iterations
            bare(ax, f"{family}: cost x {cost:.3f},\nexpansions x {expansions:.2f}")
    return figure


def planner_table() -> pd.DataFrame:
    """Return the rows of the planners on 1,000 hard problems, which planner_tables.py measured."""
    rows = json.loads((ROOT / "docs" / "planner_results.json").read_text(encoding="utf-8"))["rows"]
    table = pd.DataFrame(rows)
    return table[(table["set"] == "dungeon-hard-1000") & table["opt_low"].notna()]


def planners() -> Figure:
    """Show what planners save and what that costs."""
    figure, (ax,) = new_figure(1, 1, (7.5, 5.6))
    plot_planners(planner_table(), ax)
    legend = ax.get_legend()
    assert legend is not None
    for line in (*ax.lines, *legend.get_lines()):
        if line.get_color() == "#000000":  # not seen on dark pages
            line.set_color(mpl.rcParams["text.color"])
    for bars in ax.collections:
        if not np.asarray(bars.get_edgecolor())[0, :3].any():
            bars.set_color(mpl.rcParams["text.color"])
    return figure


SAMPLERS = {
    "halton": "Halton",
    "corners_alone": "obstacle corners",
    "lego_cvae": "Halton and LEGO's autoencoder",
    "shortest_path_heatmap": "Halton and heat map of shortest paths",
    "lego_heatmap": "Halton and heat map of bottlenecks",
    "lego_heatmap_alone": "heat map of bottlenecks",
}


@cache
def sampler_table() -> pd.DataFrame:
    """Compare samplers of roadmaps on the problems of 300 maps of seed 77."""
    from mapdata.models.evaluate import learned_samplers
    from mapdata.models.lego.comparison import compare, contenders
    from mapdata.models.model import WEIGHTS

    rows = contenders(learned_samplers(WEIGHTS))
    problems = ProblemSet.sample(DUNGEON, seed=77, maps=300, movement=DIAGONAL)
    return compare({name: rows[name] for name in SAMPLERS}, problems)


def samplers() -> Figure:
    """Show how many hard problems roadmaps of each size solve, with 95 % intervals."""
    table = sampler_table()
    table = table[table["subset"] == "hard"]
    figure, (ax,) = new_figure(1, 1, (7.5, 5))
    for k, (name, words) in enumerate(SAMPLERS.items()):
        part = table[table["sampler"] == name]
        success = part["success"].to_numpy()
        low = success - part["success_low"].to_numpy()
        high = part["success_high"].to_numpy() - success
        # side by side, so that no interval covers another
        places = np.arange(len(part)) + 0.07 * (k - 2)
        look: dict[str, Any] = {"color": PALETTE[k], "marker": MARKERS[k], "capsize": 3}
        ax.errorbar(places, success, (low, high), linewidth=1.2, label=words, **look)
    sizes = table["n"].unique()
    ax.set_xticks(np.arange(len(sizes)), [str(n) for n in sizes])
    count = table["problems"].iloc[0]
    ax.set(xlabel="vertices of the roadmap", ylabel=f"share solved of {count} hard problems")
    ax.grid(axis="y", alpha=0.3)
    ax.legend(frameon=False, fontsize="small", loc="lower right")
    return figure


def roadmaps() -> Figure:
    """Show the roadmaps of two samplers on one problem, the first hard one."""
    from mapdata.models.lego.comparison import contenders
    from mapdata.models.lego.roadmap import roadmap_between
    from mapdata.models.lego.sampler import Heatmap

    rows = contenders({"lego_heatmap": Heatmap.pretrained()})
    problems = ProblemSet.sample(DUNGEON, seed=77, maps=12, movement=DIAGONAL)
    k = int(problems.hard.argmax())
    grid = problems.grids[k]
    start = problems.starts[k]
    goal = problems.goals[k]
    figure = Figure(figsize=(10, 5.2), layout="constrained")
    for ax, name in zip(figure.subplots(1, 2), ("halton", "lego_heatmap"), strict=True):
        samples = rows[name](grid[None], start[None], goal[None], 50, [k])[0]
        roadmap = roadmap_between(grid, start, goal, samples)
        length, path = roadmap.shortest_path()
        # a cell's centre is its coordinate + 0.5, but pictures have it at the coordinate
        points = roadmap.points - 0.5
        plot_roadmap(grid, points, roadmap.edges, ax, path=points[path])
        ax.plot(points[:2, 1], points[:2, 0], "*", color="#009E73", markersize=12, zorder=4)
        found = f"{length:.1f} cells" if len(path) else "no path"
        ax.set(title=f"{name}, {found}", xlabel="", ylabel="", xticks=[], yticks=[])
        ax.get_legend().remove()
    return figure


def images() -> Figure:
    """Show a map of the preset tiles, its picture, and its picture with alike tiles."""
    dataset = OnlineMapDataset("tiles", 0, length=20, fields=("terrain", "image"))
    alike = OnlineMapDataset("tiles", 0, length=20, fields=(Tiles(alike=True),))
    sample: Any = dataset[PICKED]
    alike_sample: Any = alike[PICKED]
    figure, axes = new_figure(1, 3, (10.2, 3.7))
    axes[0].imshow(sample.terrain[0], cmap="viridis", interpolation="nearest")
    bare(axes[0], "terrain")
    for ax, image, title in (
        (axes[1], sample.image, "image"),
        (axes[2], alike_sample.image, "Tiles(alike=True)"),
    ):
        ax.imshow(image.permute(1, 2, 0), interpolation="nearest")
        bare(ax, title)
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "overview": overview,
    "batch": batch,
    "speed": speed,
    "families": families,
    "presets": presets,
    "movements": movements,
    "figure-1": figure_1,
    "gallery": gallery,
    "figure-3": figure_3,
    "figure-4": figure_4,
    "distributions": distributions,
    "generators": generators,
    "imported": imported,
    "clearance": clearance,
    "fields": fields,
    "predictions": predictions,
    "planners": planners,
    "samplers": samplers,
    "roadmaps": roadmaps,
    "images": images,
}
NAMES = [*FIGURES, "report"]


def photograph_report(targets: dict[str, Path]) -> None:
    """Write pictures of the page that ``mapdata report`` makes, in a browser."""
    sys.path.insert(0, str(ROOT / "tests"))
    from helpers.browser import Browser

    with TemporaryDirectory() as folder:
        build(f"{folder}/maps", DUNGEON, maps=200, seed=0)
        page = Path(folder, "report.html")
        page.write_text(report(f"{folder}/maps"), encoding="utf-8")
        with Browser(Path(folder, "profile")) as browser:
            for ending, target in targets.items():
                browser.open(page)
                browser.run("$('thumbs').children[7].click()")
                browser.screenshot(target, dark=bool(ending))


def save(name: str, folder: Path = IMAGES) -> None:
    """Draw a picture in both themes, with at most 256 colours so that it is small."""
    targets = {ending: folder / f"{name}{ending}.png" for ending in THEMES}
    if name == "report":
        photograph_report(targets)
    else:
        for ending, theme in THEMES.items():
            with mpl.rc_context({**STYLE, **theme}):
                FIGURES[name]().savefig(targets[ending], dpi=110)
    for target in targets.values():
        with Image.open(target) as image:
            small = image.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        small.save(target, optimize=True)
        size = target.stat().st_size
        if size > LARGEST:
            raise ValueError(f"{target}: {size:,} bytes, expected at most {LARGEST:,}")
        print(
            f"{target.relative_to(ROOT) if target.is_relative_to(ROOT) else target}: {size:,} bytes"
        )


def main() -> None:
    """Draw the figures that are named, or all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(NAMES))
    names = parser.parse_args().names or NAMES
    if unknown := [name for name in names if name not in NAMES]:
        parser.error(f"no figure {', '.join(unknown)}: expected {', '.join(NAMES)}")
    for name in names:
        save(name)


if __name__ == "__main__":
    main()
