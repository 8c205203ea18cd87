"""Draws the pictures of README and the pages: python docs/figures.py [NAME ...].

Each is drawn twice, `docs/images/NAME.png` for light pages and `docs/images/NAME-dark.png` for
dark ones; wide ones again with fewer columns, `NAME-phone.png`. Without names all are drawn, in
some minutes of one core. `pip install -e ".[examples]"` comes first, and a Chromium for the picture
of the report.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from collections.abc import Callable
from functools import cache, partial
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
from matplotlib.image import AxesImage
from PIL import Image

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))  # mapdata, scripts

from mapdata import (  # noqa: E402
    Labels,
    MapGenerator,
    Maps,
    MapSpec,
    Maze,
    Movement,
    OnlineMapDataset,
    ProblemSetDataset,
    Random,
    Tiles,
    astar,
    build,
    check_path,
    generate,
    label,
    search_order,
)
from mapdata.describe import dataset_statistics  # noqa: E402
from mapdata.evaluation import Plan  # noqa: E402
from mapdata.formats import Collection, ForeignMap, import_maps  # noqa: E402
from mapdata.generators import PRESETS  # noqa: E402
from mapdata.models import CostPredictor  # noqa: E402
from mapdata.plotting import (  # noqa: E402
    COLOURS,
    MARKERS,
    STYLE,
    plot_distributions,
    plot_ends,
    plot_gallery,
    plot_grid,
    plot_map,
    plot_matrix,
    plot_path,
    plot_planners,
    plot_prediction,
    plot_roadmap,
    plot_search,
    report,
)
from mapdata.plotting.search_figures import plot_both_searches  # noqa: E402
from mapdata.problems import ProblemSet  # noqa: E402
from mapdata.shards import Root  # noqa: E402

Floats = npt.NDArray[np.float64]

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


def colours_of(maps: Maps, i: int) -> Floats:
    """Return map ``i`` as a picture (H, W, 3) in the colours of `plot_grid`."""
    free = 1.0 - 0.8 * maps.occupancy[i][..., None]
    if maps.terrain is None:
        return np.repeat(free, 3, axis=2)
    terrain = maps.terrain[i]
    shades = mpl.colormaps["YlOrBr"](terrain / terrain.max())[..., :3]
    return np.asarray(np.where(terrain[..., None] > 0, 0.4 + 0.6 * shades, free))


def picture(name: str, index: int) -> Floats:
    """Return a map of a preset, with seed 0."""
    return colours_of(generate(PRESETS[name], 0, [index]), 0)


def mosaic(pictures: list[Floats], columns: int) -> Floats:
    """Return pictures side by side as one, in cells of one size and each in a grey frame."""
    side = max(64, *(max(small.shape[:2]) for small in pictures))
    gap = max(side // 16, 2)
    lines = -(-len(pictures) // columns)
    size = (lines * (side + gap) + gap, columns * (side + gap) + gap, 3)
    whole = np.full(size, 0.55)
    for k, small in enumerate(pictures):
        scale = side // max(small.shape[:2])
        large = small.repeat(scale, axis=0).repeat(scale, axis=1)
        rows, wide = large.shape[:2]
        row = gap + k // columns * (side + gap) + (side - rows) // 2
        column = gap + k % columns * (side + gap) + (side - wide) // 2
        whole[row : row + rows, column : column + wide] = large
    return whole


def overview(columns: int = 4) -> Figure:
    """Maps; the labels of one; a target to learn; what a network learnt."""
    rows = 4 // columns
    figure, axes = new_figure(rows, columns, (2.4 * columns, 2.75 * rows))
    wide_maze = Maze((64, 64), corridor=3, reopened=0.1)
    chosen: list[tuple[MapGenerator, int]] = [
        (PRESETS["paper"], 7),
        (PRESETS["narrow"], 28),
        (DUNGEON, 3),
        (Maze((64, 64)), 1),
        (wide_maze, 3),
        (PRESETS["cave"], 1),
        (PRESETS["forest"], 1),
        (PRESETS["noise"], 1),
        (PRESETS["terrain"], 4),
    ]
    pictures = [colours_of(generate(generator, 0, [index]), 0) for generator, index in chosen]
    axes[0].imshow(mosaic(pictures, 3), interpolation="nearest")
    bare(axes[0], "maps")

    plot_map(one_map(), 0, axes[1])
    bare(axes[1], "routes: BFS orange, A* blue")

    problem = hard_problems(("map", "start", "goal", "path", "cost_to_go"))[PICKED]
    plot_grid(problem.map[0], axes[2])
    shade(axes[2], np.asarray(problem.cost_to_go[0]), problem.map[0])
    shortest_path(axes[2], problem)
    bare(axes[2], "costs to go, a shortest path")

    prediction(axes[3], problem)
    bare(axes[3], "a predicted path (purple)")
    return figure


def shortest_path(axes: Axes, sample: Any) -> None:
    """Draw the path of a problem between its ends."""
    rows, columns = np.asarray(sample.path[sample.path[:, 0] >= 0]).T
    axes.plot(columns, rows, color=COLOURS["astar"], linewidth=2.2)
    plot_ends(sample.start, sample.goal, axes)


def hard_problems(fields: tuple[Any, ...]) -> list[Any]:
    """Return problems on maps that no training saw."""
    dataset = OnlineMapDataset(
        DUNGEON, 77, length=12, fields=fields, problems=HARD, movement=DIAGONAL
    )
    return [dataset[k] for k in range(len(dataset))]


def prediction(axes: Axes, sample: Any) -> None:
    """Draw the path that the shipped network predicts over a shortest one."""
    from mapdata.models.pretrained.path_predictor import PathPredictor

    model = PathPredictor.pretrained()
    grid, start, goal = (np.asarray(sample[k]).astype(np.int64) for k in range(3))
    truth = astar(grid[0], start, goal, DIAGONAL).path
    with model.inference():
        shades = model(*model.tensors(grid[None].astype(np.uint8), goal[None]))[1][0].numpy()
    plot_prediction(grid[0], model.predict_path(grid, start, goal), truth, axes, scores=shades)


def shade(axes: Axes, numbers: npt.NDArray[Any], grid: Any) -> AxesImage:
    """Shade the free cells with a positive number, in the colours that `plot_sample` uses."""
    is_hidden = (np.asarray(grid) == 1) | ~(numbers > 0)
    return axes.imshow(
        np.ma.masked_where(is_hidden, numbers), "YlOrBr", alpha=0.6, vmin=0, interpolation="nearest"
    )


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
    """Show the label that docs/howto/labels.md computes."""
    field = run_first_block("docs/howto/labels.md")["steps_to_wall"]
    dataset = OnlineMapDataset(DUNGEON, 0, length=20, fields=("map", field), problems=Random())
    figure, axes = new_figure(1, 3, (8, 2.8))
    for ax, k in zip(axes, (3, 9, 12), strict=True):
        sample: Any = dataset[k]
        plot_grid(sample.map[0], ax)
        image = shade(ax, np.asarray(sample.steps_to_wall[0]), sample.map[0])
        bare(ax)
    figure.colorbar(image, ax=axes, label="steps to a wall", shrink=0.8)
    return figure


def imported() -> Figure:
    """Show the floor plans that docs/howto/maps.md imports."""
    plans = run_first_block("docs/howto/maps.md")["plans"]
    source = Collection([ForeignMap(f"plan {k}", plan) for k, plan in enumerate(plans)])
    figure, axes = new_figure(1, 3, (8, 3))
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
    figure, axes = new_figure(1, 2, (8, 2.8))
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
        if work == "A*, per path, 64 x 64, single calls":
            paths[peer] = float(factor)
        if work.endswith("map, start, goal, path_mask") and not peer.startswith("memset"):
            loading.setdefault(peer, float(factor))  # of 10,000 maps, the first rows
    figure, axes = new_figure(1, 2, (8.6, 3.4))
    titles = ("time of a path by A*, 64 x 64, log scale", "time of a sample, log scale")
    for ax, title, factors in zip(axes, titles, (paths, loading), strict=True):
        names = sorted(factors, key=lambda name: factors[name])
        ink = mpl.rcParams["text.color"]
        colours = [ink if name == "mapdata" else GREY for name in names]
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


SHOWN = {"paper": (9, 19), "narrow": (28, 20)}
"""Numbers of the maps that show a preset well; of most presets any do."""


def families(columns: int = 7) -> Figure:
    """Show two maps of each preset."""
    rows = -(-len(PRESETS) // columns)
    figure, axes = new_figure(rows, columns, (1.55 * columns, 3.3 * rows))
    for ax in axes[len(PRESETS) :]:
        ax.set_axis_off()
    for ax, name in zip(axes, PRESETS, strict=False):
        pair = [picture(name, index) for index in SHOWN.get(name, (0, 1))]
        ax.imshow(mosaic(pair, 1), interpolation="nearest")
        bare(ax, f"{name}\n{' x '.join(map(str, PRESETS[name].map_size))}")
    return figure


def presets(columns: int = 7) -> Figure:
    """Show one map of each preset."""
    rows = -(-len(PRESETS) // columns)
    figure, axes = new_figure(rows, columns, (1.55 * columns, 1.75 * rows))
    for ax in axes[len(PRESETS) :]:
        ax.set_axis_off()
    for ax, name in zip(axes, PRESETS, strict=False):
        ax.imshow(picture(name, SHOWN.get(name, (1,))[0]), interpolation="nearest")
        bare(ax, name)
    return figure


def samples(preset: str) -> Figure:
    """Show six maps of a preset."""
    figure, axes = new_figure(1, 6, (9.3, 1.7))
    for index, ax in enumerate(axes):
        ax.imshow(picture(preset, index), interpolation="nearest")
        bare(ax, "")
    return figure


def movements() -> Figure:
    """Show the shortest path under each rule of moves."""
    figure, axes = new_figure(1, 3, (8.4, 2.7))
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
        bare(ax, f"{name}\ncost {found.cost:.4g}")
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
        figure, axes = new_figure(2, 4, (8.4, 5.2))
        plot_gallery(dataset_statistics(folder), axes)
    return figure


def figure_3() -> Figure:
    """Draw the paper's Figure 3: the route of each search and its iterations."""
    figure, axes = new_figure(1, 2, (9.6, 6))
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


def fields(columns: int = 3) -> Figure:
    """Show fields that are pictures: of one problem, then of one on terrain."""
    names = ("path_mask", "optimal_mask", "cost_to_go", "heuristic_ratio", "path_probability")
    ends = ("map", "start", "goal")
    sample = hard_problems((*ends, "path", "waypoints", *names, "optimal_moves"))[PICKED]
    rows = -(-9 // columns)
    figure, axes = new_figure(rows, columns, (2.7 * columns, 2.9 * rows))
    for unused in axes[9:]:
        unused.remove()
    grid = sample.map[0]
    for ax, name in zip(axes, names, strict=False):
        plot_grid(grid, ax)
        values = np.asarray(getattr(sample, name)[0], np.float64)
        if name.endswith("mask"):
            blue = ListedColormap([COLOURS["astar"]])
            ax.imshow(np.where(values > 0, values, np.nan), cmap=blue, interpolation="nearest")
        else:
            shade(ax, values, grid)
        bare(ax, name)
    moves = np.asarray(sample.optimal_moves[0])
    plot_grid(grid, axes[5])
    shade(axes[5], np.unpackbits(moves[..., None], axis=2).sum(axis=2), grid)
    bare(axes[5], "optimal_moves (their number)")
    plot_grid(grid, axes[6])
    rows_of_points, columns_of_points = np.asarray(sample.waypoints).T - 0.5
    axes[6].plot(columns_of_points, rows_of_points, ".-", color=COLOURS["seed"])
    bare(axes[6], "waypoints")
    for ax in axes[:7]:
        plot_ends(sample.start, sample.goal, ax)

    on_tiles = OnlineMapDataset(
        "tiles", 3, length=40, fields=(*ends, "path", "terrain", Tiles(pixels=8)), problems="pairs"
    )
    # the path that leaves the diagonal most
    tiles: Any = max((on_tiles[k] for k in range(40)), key=lambda one: len(one.path))
    plot_grid(tiles.map[0], axes[7])
    shade(axes[7], np.asarray(tiles.terrain[0]), tiles.map[0])
    shortest_path(axes[7], tiles)
    bare(axes[7], "terrain, and path on it")
    axes[8].imshow(np.asarray(tiles.image).transpose(1, 2, 0))
    bare(axes[8], "image of that terrain")
    return figure


def answers(family: str) -> tuple[tuple[Any, Plan], tuple[Any, Plan]]:
    """Return the first of a family's ``HARD`` problems, and the next not solved at least cost.

    Where all of 200 are, the one with most expansions is the second.
    """
    from mapdata.models import PathPredictor, planners

    _, search = planners(PathPredictor.pretrained())
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


def predictions(columns: int = 6) -> Figure:
    """Show what the path predictor answers to hard problems of each family, failures included."""
    names = ("paper", "dungeon", "maze", "cave", "forest", "noise")
    figure, axes = new_figure(12 // columns, columns, (1.9 * columns, 2.5 * 12 // columns))
    answered = [answers(name) for name in names]
    if columns == len(names):  # a family is a column, else a row
        panels = [
            (name, pair[k]) for k in range(2) for name, pair in zip(names, answered, strict=True)
        ]
    else:
        panels = [(name, one) for name, pair in zip(names, answered, strict=True) for one in pair]
    for ax, (name, (sample, plan)) in zip(axes, panels, strict=True):
        plot_grid(sample.map[0], ax)
        truth = np.asarray(sample.path[sample.path[:, 0] >= 0])
        for path, colour, width in ((truth, "astar", 4), (plan.path, "predicted", 1.8)):
            ax.plot(path[:, 1], path[:, 0], color=COLOURS[colour], linewidth=width)
        plot_ends(sample.start, sample.goal, ax)
        best = astar(np.asarray(sample.map[0]), sample.start, sample.goal, DIAGONAL)
        cost = check_path(sample.map[0], plan.path, DIAGONAL) / float(sample.cost)
        expansions = plan.expansions / best.iterations
        bare(ax, f"{name}: cost x {cost:.3f}\nexpansions x {expansions:.2f}")
    return figure


def planner_table() -> pd.DataFrame:
    """Return the rows of the planners on 1,000 hard problems, which planner_tables.py measured."""
    rows = json.loads((ROOT / "docs" / "planner_results.json").read_text(encoding="utf-8"))["rows"]
    table = pd.DataFrame(rows)
    return table[(table["set"] == "dungeon-hard-1000") & table["opt_low"].notna()]


def planners(columns: int = 2) -> Figure:
    """Show what planners save and what that costs; those that learn have colours of their own."""
    from mapdata.models import PathPredictor
    from mapdata.models import planners as learned

    figure, (ax,) = new_figure(1, 1, (3.75 * columns, 5))
    table = planner_table()
    table = table[table["planner"] != "path_predictor of the tutorial"]
    names = {planner.name for planner in learned(PathPredictor.pretrained())}
    plot_planners(table, ax, own=sorted(names & set(table["planner"])))
    return figure


SAMPLERS = {
    "halton": "Halton",
    "corners_alone": "obstacle corners",
    "lego_cvae": "Halton + LEGO's autoencoder",
    "shortest_path_heatmap": "Halton + heat map of shortest paths",
    "lego_heatmap": "Halton + heat map of bottlenecks",
    "lego_heatmap_alone": "heat map of bottlenecks",
}
"""Names in tables, and in the picture; the first two do not learn."""


@cache
def sampler_table() -> pd.DataFrame:
    """Compare samplers of roadmaps on the problems of 300 maps of seed 77."""
    from mapdata.models.evaluate import learned_samplers
    from mapdata.models.pretrained.model import WEIGHTS
    from mapdata.roadmaps import compare, contenders

    rows = contenders(learned_samplers(WEIGHTS))
    problems = ProblemSet.sample(DUNGEON, seed=77, maps=300, movement=DIAGONAL)
    return compare({name: rows[name] for name in SAMPLERS}, problems)


def samplers() -> Figure:
    """Show how many hard problems roadmaps of each size solve, with 95 % intervals."""
    table = sampler_table()
    table = table[table["subset"] == "hard"]
    figure, (ax,) = new_figure(1, 1, (8.4, 5))
    last = {}
    for k, (name, words) in enumerate(SAMPLERS.items()):
        part = table[table["sampler"] == name]
        success = part["success"].to_numpy()
        low = success - part["success_low"].to_numpy()
        high = part["success_high"].to_numpy() - success
        # side by side, so that no interval covers another
        places = np.arange(len(part)) + 0.07 * (k - 2)
        colour = GREY if k < 2 else COLOURS["predicted"]
        look: dict[str, Any] = {"color": colour, "marker": MARKERS[k], "capsize": 3}
        ax.errorbar(places, success, (low, high), linewidth=1.2, **look)
        last[words] = (float(places[-1]), float(success[-1]), colour)
    height = np.inf
    for words, (x, y, colour) in sorted(last.items(), key=lambda entry: -entry[1][1]):
        height = min(y, height - 0.045)
        line = {"arrowstyle": "-", "color": colour, "linewidth": 0.7, "relpos": (0, 0.5)}
        ax.annotate(words, (x, y), (2.32, height), va="center", fontsize="small", arrowprops=line)
    sizes = table["n"].unique()
    ax.set_xticks(np.arange(len(sizes)), [str(n) for n in sizes])
    count = table["problems"].iloc[0]
    ax.set(xlabel="vertices of the roadmap", ylabel=f"share solved of {count} hard problems")
    ax.set_xlim(-0.25, 3.75)
    ax.grid(axis="y", alpha=0.3)
    return figure


def roadmaps() -> Figure:
    """Show the roadmaps of two samplers on one problem, the first hard one."""
    from mapdata.models.pretrained.lego.sampler import Heatmap
    from mapdata.roadmaps import contenders, roadmap_between

    rows = contenders({"lego_heatmap": Heatmap.pretrained()})
    problems = ProblemSet.sample(DUNGEON, seed=77, maps=12, movement=DIAGONAL)
    k = int(problems.hard.argmax())
    grid = problems.grids[k]
    start = problems.starts[k]
    goal = problems.goals[k]
    figure = Figure(figsize=(8.4, 4.5), layout="constrained")
    for ax, name in zip(figure.subplots(1, 2), ("halton", "lego_heatmap"), strict=True):
        samples = rows[name](grid[None], start[None], goal[None], 50, [k])[0]
        roadmap = roadmap_between(grid, start, goal, samples)
        length, path = roadmap.shortest_path()
        # a cell's centre is its coordinate + 0.5, but pictures have it at the coordinate
        points = roadmap.points - 0.5
        plot_roadmap(grid, points, roadmap.edges, ax, path=points[path])
        plot_ends(points[0], points[1], ax)
        found = f"{length:.1f} cells" if len(path) else "no path"
        ax.set(title=f"{SAMPLERS[name]}: {found}", xlabel="", ylabel="", xticks=[], yticks=[])
        ax.get_legend().remove()
    return figure


def images() -> Figure:
    """Show a map of the preset tiles, its picture, and its picture with alike tiles."""
    dataset = OnlineMapDataset("tiles", 0, length=20, fields=("terrain", "image"))
    alike = OnlineMapDataset("tiles", 0, length=20, fields=(Tiles(alike=True),))
    sample: Any = dataset[PICKED]
    alike_sample: Any = alike[PICKED]
    figure, axes = new_figure(1, 3, (8.4, 3.1))
    plot_grid(sample.terrain[0] == 0, axes[0])
    shade(axes[0], np.asarray(sample.terrain[0]), sample.terrain[0] == 0)
    bare(axes[0], "terrain")
    for ax, image, title in (
        (axes[1], sample.image, "image"),
        (axes[2], alike_sample.image, "Tiles(alike=True)"),
    ):
        ax.imshow(image.permute(1, 2, 0), interpolation="nearest")
        bare(ax, title)
    return figure


def costs() -> Figure:
    """Show an image, the costs that a model reads from it, the true costs, and both paths."""
    movement = Movement(8, corner_cutting=True, diagonal_cost=1)
    problems = ProblemSet.sample("tiles", seed=77, maps=20, movement=movement, problems="route")
    fields = ("map", Tiles(alike=True, noise=8))
    batch: Any = ProblemSetDataset(problems, fields=fields)[:]
    predicted = CostPredictor.pretrained().predict(batch.image, problems.grids)
    assert problems.terrain is not None
    problem = problems.grids[PICKED], problems.starts[PICKED], problems.goals[PICKED], movement
    figure, axes = new_figure(1, 3, (10.2, 3.7))
    side = batch.image.shape[-1] / problems.grids.shape[-1]
    axes[0].imshow(batch.image[PICKED].permute(1, 2, 0), interpolation="nearest")
    bare(axes[0], "image")
    for ax, terrain, title in (
        (axes[1], predicted[PICKED], "predicted costs"),
        (axes[2], problems.terrain[PICKED], "true costs"),
    ):
        ax.imshow(terrain, cmap="viridis", interpolation="nearest")
        bare(ax, title)
    planned = astar(*problem, terrain=predicted[PICKED]).path
    shortest = astar(*problem, terrain=problems.terrain[PICKED]).path
    for ax, scale in ((axes[0], side), (axes[1], 1), (axes[2], 1)):
        for path, colour, width in (
            (shortest, COLOURS["astar"], 4.5),
            (planned, COLOURS["predicted"], 2.0),
        ):
            rows, columns = (scale * (path + 0.5) - 0.5).T
            ax.plot(columns, rows, color=colour, linewidth=width)
        start, goal = (scale * (end + 0.5) - 0.5 for end in (shortest[0], shortest[-1]))
        plot_ends(start, goal, ax)
    return figure


def search() -> Figure:
    """Draw BFS and A* on map 7 of the tutorial's dataset, as its command does."""
    labels = label(generate(MapSpec.preset("dungeon"), 0, [7]))
    figure = plot_both_searches(labels, 0)[0].figure
    assert isinstance(figure, Figure)
    figure.set_size_inches(8.4, 4.2)
    return figure


def searches() -> Figure:
    """Draw what three heuristics expand: the last picture of docs/howto/teach.md."""
    movement = Movement(connectivity=4)
    detours = Random(hardness=(1.5, None))
    problems = ProblemSet.sample("dungeon", seed=7, maps=30, movement=movement, problems=detours)
    grid, start, goal = problems.grids[0], problems.starts[0], problems.goals[0]
    rows, columns = np.indices(grid.shape)
    manhattan = abs(rows - goal[0]) + abs(columns - goal[1])
    figure, axes = new_figure(1, 3, (8.4, 3))
    heuristics = {"nothing": 0 * manhattan, "manhattan": manhattan, "too_much": 3 * manhattan}
    for ax, (name, heuristic) in zip(axes, heuristics.items(), strict=True):
        found = search_order(grid, start, goal, movement, heuristic=heuristic)
        plot_search(grid, found.order, found.path, ax)
        ax.set_title(f"{name}: {found.iterations:,} expansions")
    return figure


FIGURES: dict[str, Callable[..., Figure]] = {
    "overview": overview,
    "batch": batch,
    "speed": speed,
    "families": families,
    "presets": presets,
    "movements": movements,
    **{f"preset-{name}": partial(samples, name) for name in PRESETS},
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
    "costs": costs,
    "search": search,
    "searches": searches,
}
NAMES = [*FIGURES, "report"]
FOR_PHONES = {
    "overview": 2,
    "families": 3,
    "presets": 4,
    "predictions": 2,
    "planners": 1,
    "fields": 2,
}
"""Pictures that phones get with fewer columns, as `NAME-phone.png`."""

VARIANTS = {name: ("", "-phone") if name in FOR_PHONES else ("",) for name in NAMES}


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
    """Draw a picture in both themes, and for phones; 256 colours at most keep it small."""
    targets = []
    if name == "report":
        targets = [folder / f"report{theme}.png" for theme in THEMES]
        photograph_report(dict(zip(THEMES, targets, strict=True)))
    else:
        for theme, look in THEMES.items():
            for variant in VARIANTS[name]:
                columns = {"columns": FOR_PHONES[name]} if variant else {}
                targets.append(folder / f"{name}{variant}{theme}.png")
                with mpl.rc_context({**STYLE, **look}):
                    FIGURES[name](**columns).savefig(targets[-1], dpi=110)
    for target in targets:
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
