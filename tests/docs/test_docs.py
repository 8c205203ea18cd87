"""The documentation runs, names what exists, lists all that is public, and builds without a
warning.
"""

from __future__ import annotations

import json
import re
import runpy
import shutil
import subprocess
import sys
import textwrap
import zlib
from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from typing import get_args

import matplotlib as mpl
import numpy as np
import pytest
import yaml
from helpers import pages
from helpers.pages import DOCS, ROOT
from matplotlib.figure import Figure
from PIL import Image

import mapdata
from mapdata.datasets import FIELDS

ELSEWHERE = {
    "benchmarks.md",
    "command.md",
    "format.md",
    "formats.md",
    "howto/ompl.md",
    "howto/robot.md",
    "promises.md",
    "recipes.md",
    "scale.md",
}
"""Pages with a test of their own."""

SOAK = {"tutorial.md"}
"""Pages whose code takes minutes."""

SLOW = {
    *("distributed.md", "families.md", "gallery.md", "loading.md", "pretrained.md", "suite.md")
} | {
    f"howto/{name}.md"
    for name in (
        "coming_from",
        "costmap",
        "images",
        "labels",
        "maps",
        "maze_hard",
        "planner",
        "publish",
        "spec",
        "teach",
        "terrain",
        "text",
        "training",
        "waypoints",
    )
}
"""Pages whose code takes seconds."""


def marks(page: str) -> pytest.MarkDecorator | tuple[()]:
    """Return the mark of a page's test."""
    if page in SOAK:
        return pytest.mark.soak
    return pytest.mark.slow if page in SLOW else ()


PAGES = sorted(str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md"))
NOTEBOOK = DOCS / "first_look.ipynb"

quiet = pytest.mark.filterwarnings(
    "ignore:.*does not have many workers which may be a bottleneck",
    "ignore:.*isinstance.treespec, LeafSpec.* is deprecated",
    "ignore:The number of training batches .* is smaller than the logging interval",
    "ignore:Starting from v1.9.0, `tensorboardX` has been removed",
    "ignore:Checkpoint directory .* exists and is not empty",
    "ignore:.*TF32",
    "ignore:`torch.jit.script_method` is deprecated",  # which torch.compile itself uses
    "ignore:Precision bf16-mixed is not supported by the model summary",
)


@pytest.fixture
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@quiet
@pytest.mark.usefixtures("_in_an_empty_folder")
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=marks(name)) for name in PAGES if name not in ELSEWHERE],
)
def test_every_block_runs(name: str) -> None:
    """In an empty folder, in the order of the page, and the pictures that it names are there."""
    page = DOCS / name
    pages.run(page)
    for picture in re.findall(
        r'(?:savefig\(|-o )"?([\w.]+\.png)', page.read_text(encoding="utf-8")
    ):
        assert Path(picture).read_bytes().startswith(b"\x89PNG"), picture


@pytest.mark.usefixtures("_in_an_empty_folder")
def test_what_cannot_run_is_no_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The runner itself can fail: another language, another output, a failing command."""
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    for text in (
        "yaml\na: 1",
        "python\nprint(1)\n```\n```text\n2",
        "sh\nmapdata info nowhere",
        "sh\nrm -r /",
    ):
        page = tmp_path / "page.md"
        page.write_text(f"```{text}\n```\n", encoding="utf-8")
        with pytest.raises(AssertionError):
            pages.run(page)


def test_pages_that_use_the_samplers_say_what_to_install() -> None:
    """Scipy is in this environment, so that running their blocks would not tell."""
    users = []
    for page in [ROOT / "README.md", *DOCS.rglob("*.md")]:
        text = page.read_text(encoding="utf-8")
        imported = r"^ *from mapdata\.models\b.*(lego|Heatmap|CVAE|Sampler)"
        command = r"^ {4}python -m mapdata\.models\.(train lego|evaluate samplers)"
        if re.search(f"{imported}|{command}", text, re.MULTILINE):
            users.append(page.name)
            assert re.search("pip install .*scipy", text), page
    assert {"ompl.md", "samplers.md"} <= set(users)


def test_pages_use_the_models_without_a_checkout() -> None:
    """They import `mapdata.models`, and run its commands in place of the scripts."""
    users = []
    for page in [ROOT / "README.md", *DOCS.rglob("*.md")]:
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"^ *(from|import) models\b|/weights/", text, re.MULTILINE), page
        assert not re.search(r"python scripts/(train|evaluate)", text), page
        if "mapdata.models" in text:
            users.append(page.name)
    assert {"tutorial.md", "planners.md", "samplers.md", "robot.md", "ompl.md"} <= set(users)


def test_the_table_of_fields_is_complete() -> None:
    """Each field has a row, each row a field, with the types that the code's docstrings state."""
    table = (DOCS / "fields.md").read_text(encoding="utf-8").split("## ")[0]
    rows = re.findall(r"^\| (`.*?) \| \((.*?)\) (\w+) \|", table, re.MULTILINE)
    found = {
        name: (shape, dtype)
        for names, shape, dtype in rows
        for name in re.findall(r"`(\w+)`", names)
    }
    assert set(found) == set(FIELDS)
    for name, (shape, dtype) in found.items():
        assert f"({shape}) {dtype}" in (FIELDS[name].__doc__ or ""), name


def test_the_reference_has_every_public_name() -> None:
    """Each once, as users import it, and nothing that is not there; the first page lists them."""
    pages_of_reference = {
        page.name: re.findall(
            r"^::: (mapdata\.[\w.]+)$", page.read_text(encoding="utf-8"), re.MULTILINE
        )
        for page in (DOCS / "reference").glob("*.md")
    }
    listed = [name for names in pages_of_reference.values() for name in names]
    assert len(listed) == len(set(listed))
    top = {name for name in listed if name.count(".") == 1}
    assert top == {f"mapdata.{name}" for name in mapdata._HOME}
    for name in listed:
        documented = lookup(name)
        is_type_alias = bool(get_args(documented))  # Its docstring is for readers of the source.
        assert isinstance(documented, Mapping) or is_type_alias or documented.__doc__, name
        assert name.rpartition(".")[2] not in mapdata._HOME or name in top, name
    rows = (DOCS / "reference" / "index.md").read_text(encoding="utf-8")
    table = dict(re.findall(r"^\| \[.*\]\((\w+\.md)\) \| (.*) \|$", rows, re.MULTILINE))
    for page, names in pages_of_reference.items():
        if names:
            assert [f"mapdata.{name}" for name in re.findall("`(.*?)`", table[page])] == names


def lookup(name: str) -> object:
    """Return what a dotted public name names: a module, or something in one.

    A field of a dataclass without a default counts as an attribute of its class.
    """
    parts = name.split(".")
    assert not any(part.startswith("_") for part in parts), name
    target: object = import_module(parts[0])
    for k, part in enumerate(parts[1:], start=2):
        if not hasattr(target, part):
            if part in getattr(target, "__dataclass_fields__", {}):
                return target
            target = import_module(".".join(parts[:k]))
        else:
            target = getattr(target, part)
    return target


def test_the_paper_page_names_what_exists() -> None:
    """Every function, attribute and test."""
    page = (DOCS / "paper.md").read_text(encoding="utf-8")
    names = re.findall(r"`((?:mapdata|models)\.[\w.]+)`", page)
    assert len(names) > 50
    for name in names:
        lookup(name)
    tests = re.findall(r"`([\w/]+\.py)::(\w+)`", page)
    assert len(tests) > 40
    for file, test in tests:
        assert f"def {test}(" in (ROOT / "tests" / file).read_text(encoding="utf-8"), (
            f"{file}::{test}"
        )


@pytest.mark.slow
def test_the_paper_page_counts_seed_points_and_detours() -> None:
    """Of the first 10,000 maps of seed 0; a segment without a detour is as long as |dr| + |dc|."""
    page = (DOCS / "paper.md").read_text(encoding="utf-8")
    found = re.search(
        r"Of the same maps, (\d+) have two rooms with one seed point, and (\d+) %", page
    )
    assert found is not None
    labels = mapdata.label(mapdata.generate("paper", 0, range(10_000)))
    shared = 0
    has_no_detour = []
    for k, (points, rooms) in enumerate(
        zip(labels.maps.seed_points.tolist(), labels.maps.rooms.tolist(), strict=True)
    ):
        cells = points[:rooms]
        shared += len(set(map(tuple, cells))) < rooms
        costs = labels.matrix("bfs", k).diagonal(1).tolist()
        for (row, column), (next_row, next_column), cost in zip(
            cells[:-1], cells[1:], costs, strict=True
        ):
            if cost > 0:
                has_no_detour.append(cost == abs(row - next_row) + abs(column - next_column))
    share = np.mean(has_no_detour)
    assert found.groups() == (str(shared), f"{100 * share:.0f}")


@pytest.mark.slow
@pytest.mark.usefixtures("_in_an_empty_folder")
def test_ariadne_reads_the_pictures_of_the_page() -> None:
    """Its loader takes the mean of three channels; the 128th pixel of 208 is the start, of cells
    that are free, and no free cell touches the edge.
    """
    page = (DOCS / "howto" / "coming_from.md").read_text(encoding="utf-8")
    code = page.split("## Exploration and Mars")[1].split("```python\n")[1].split("```")[0]
    exec(code, {})
    generator = replace(
        mapdata.MapSpec.preset("dungeon"),
        map_size=(46, 62),
        passage_width=(3, 4),
        skip_probability=0.0,
    )
    paths = sorted(Path("DungeonMaps/train").iterdir())
    assert len(paths) == 10
    for path in paths:
        with Image.open(path) as picture:
            pixels = np.asarray(picture)
        assert pixels.shape == (480, 640, 3)
        grey = pixels.mean(axis=2)
        rows, columns = np.nonzero(grey == 208)
        maps = mapdata.generate(generator, 0, [int(path.stem)])
        cells = maps.occupancy[0, rows // 10 - 1, columns // 10 - 1]
        assert len(rows) > 127
        assert not cells.any()
        assert abs(rows[127] / 10 - maps.seed_points[0, 0, 0] - 1) <= 2
        assert abs(columns[127] / 10 - maps.seed_points[0, 0, 1] - 1) <= 2
        is_free = grey > 150
        assert np.array_equal(is_free[10:-10:10, 10:-10:10], maps.occupancy[0] == 0)
        assert not is_free[[0, -1]].any()
        assert not is_free[:, [0, -1]].any()


def test_the_paper_page_has_every_column() -> None:
    """The columns that formats/paper.py writes, and no other."""
    table = (DOCS / "paper.md").read_text(encoding="utf-8").split("the CSV")[1].split("## ")[0]
    cells = re.findall(r"^\| [^|]* \| (`[^|]*) \|", table, re.MULTILINE)
    written = {name for cell in cells for name in cell.split(", ")}
    doc = import_module("mapdata.formats.paper").__doc__ or ""
    columns = {
        name
        for line in re.findall(r"^\| ([a-z_, ]+) \|", doc, re.MULTILINE)[1:]
        for name in line.split(", ")
    }
    assert {name.strip("`") for name in written} == columns


@pytest.mark.slow
@quiet
@pytest.mark.usefixtures("_in_an_empty_folder")
def test_the_notebook_runs_and_ends_in_pictures() -> None:
    """Cell by cell, with the text that is kept in it, up to a figure with something in each of its
    axes.
    """
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert notebook["nbformat"] == 4
    session: dict[str, object] = {"__name__": "__main__"}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            output = StringIO()
            with redirect_stdout(output), mpl.rc_context({"backend": "Agg"}):
                exec(
                    compile("".join(cell["source"]), NOTEBOOK.name, "exec", dont_inherit=True),
                    session,
                )
            kept = "".join(
                "".join(out["text"]) for out in cell["outputs"] if out["output_type"] == "stream"
            )
            assert output.getvalue() == kept
    figure = session["figure"]
    assert isinstance(figure, Figure)
    assert len(figure.axes) >= 4
    assert all(axes.has_data() for axes in figure.axes)
    assert "image/png" in notebook["cells"][-1]["outputs"][-1]["data"]


def test_each_picture_is_one_that_the_script_draws() -> None:
    """`docs/figures.py` draws all that lie there, for both themes; each is shown, in words, too."""
    script = runpy.run_path(str(DOCS / "figures.py"))
    drawn = {
        f"{name}{variant}{theme}.png"
        for name, variants in script["VARIANTS"].items()
        for variant in variants
        for theme in ("", "-dark")
    }
    assert {file.name for file in (DOCS / "images").iterdir()} == drawn
    assert all(
        file.stat().st_size <= script["LARGEST"] <= 150_000 for file in (DOCS / "images").iterdir()
    )
    texts = {page: page.read_text(encoding="utf-8") for page in DOCS.rglob("*.md")}
    shown = {
        (page.parent / place).resolve(): words
        for page, text in texts.items()
        for words, place in re.findall(r"!\[(.*?)\]\((.*?)\)", text)
    }
    assert all(words for words in shown.values())
    shown[DOCS / "images" / "batch.png"] = "in README"
    assert set(shown) == {DOCS / "images" / f"{name}.png" for name in script["NAMES"]}


@pytest.mark.slow
@pytest.mark.usefixtures("_in_an_empty_folder")
def test_a_picture_is_drawn_in_both_themes(tmp_path: Path) -> None:
    """Its words are dark on light pages and light on dark ones, its paper is that of the page."""
    script = runpy.run_path(str(DOCS / "figures.py"))
    script["save"]("movements", tmp_path)
    darkest, lightest = (
        np.asarray(Image.open(tmp_path / f"movements{theme}.png").convert("RGBA"))
        for theme in ("", "-dark")
    )
    for picture in (darkest, lightest):
        assert picture[0, 0, 3] == 0
    titles = slice(0, 24)
    assert darkest[titles][..., :3][darkest[titles][..., 3] > 200].mean() < 80
    assert lightest[titles][..., :3][lightest[titles][..., 3] > 200].mean() > 150


NEEDS_MKDOCS = pytest.mark.skipif(
    not all(map(find_spec, ("material", "mkdocstrings_handlers", "mkdocs_jupyter"))),
    reason='needs pip install -e ".[docs]"',
)


def build_site(checkout: Path) -> subprocess.CompletedProcess[str]:
    """Build the site of a checkout by the command that docs/howto/publish.md prints."""
    page = (DOCS / "howto" / "publish.md").read_text(encoding="utf-8")
    (line,) = re.findall(r"^    (mkdocs build.*)$", page, re.MULTILINE)
    command = [sys.executable, "-m", *line.split()]
    return subprocess.run(command, cwd=checkout, capture_output=True, text=True, check=False)


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Give a copy of the checkout, whose site may be built and spoiled."""
    return copy_checkout(tmp_path)


def copy_checkout(folder: Path) -> Path:
    """Copy the checkout into a folder, without what the site does not need."""
    left_out = shutil.ignore_patterns(".*", "build", "data", "tests", "__pycache__", "*.egg-info")
    return Path(shutil.copytree(ROOT, folder / "checkout", symlinks=True, ignore=left_out))


@NEEDS_MKDOCS
@pytest.mark.slow
def test_a_warning_stops_the_site(checkout: Path) -> None:
    """One of the reader of docstrings, too: of a parameter that the function does not have."""
    module = checkout / "mapdata" / "datasets" / "datamodule.py"
    text = module.read_text(encoding="utf-8")
    spoiled = text.replace("        num_workers: as in", "        workers, others: as in")
    assert spoiled != text
    module.write_text(spoiled, encoding="utf-8")
    process = build_site(checkout)
    assert process.returncode == 1
    said = process.stdout + process.stderr
    assert re.search(r"Aborted with \d warnings? in strict mode", said)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site without a warning: strict makes each of them an error.

    Of the inventories of other projects one is there, and the others cannot be reached.
    """
    checkout = copy_checkout(tmp_path_factory.mktemp("site"))
    inventory = checkout / "objects.inv"
    lines = b"torch.utils.data.DataLoader py:class 1 data.html#$ -\n"
    header = b"# Sphinx inventory version 2\n# Project: torch\n# Version: 1\n# compressed\n"
    inventory.write_bytes(header + zlib.compress(lines))
    config = checkout / "mkdocs.yml"
    text = config.read_text(encoding="utf-8")
    assert text.count("/objects.inv") > 1
    text = re.sub("https://.*/objects.inv", "http://127.0.0.1:9/objects.inv", text)
    text = text.replace("http://127.0.0.1:9/objects.inv", inventory.as_uri(), 1)
    config.write_text(text, encoding="utf-8")
    process = build_site(checkout)
    assert process.returncode == 0, textwrap.shorten(process.stderr, 4000)
    return checkout / "build" / "site"


@NEEDS_MKDOCS
@pytest.mark.slow
def test_the_site_has_each_public_name(site: Path) -> None:
    """Each has its place, and a signature that a reader can read."""
    reference = "".join(
        page.read_text(encoding="utf-8") for page in (site / "reference").rglob("*.html")
    )
    for name in mapdata._HOME:
        assert f'<h2 id="mapdata.{name}"' in reference, name
    assert not re.search(r"<h\d[^>]*>[^<]*__\w+__", reference)  # no methods such as __len__
    assert "<blockquote>" not in reference  # >>> is a doctest
    # Long signatures are broken into lines.
    signature = reference.split('id="mapdata.export.export_problems"')[1].split("<pre>")[1]
    assert signature.split("</pre>")[0].count("\n") > 10
    # The signature of a constructor, whose types lead to their own entries and pages.
    datasets = (site / "reference" / "datasets" / "index.html").read_text(encoding="utf-8")
    heading, constructor = datasets.split('id="mapdata.MapDataset"')[1].split("<pre>", 1)
    assert len(heading) < 1000
    for name in ("datasets.FieldFunction", "datasets.Transform", "problems.SourceLike"):
        assert f'#mapdata.{name}"' in constructor.split("</pre>")[0], name
    assert 'data.html#torch.utils.data.DataLoader"' in datasets
    loading = (site / "loading" / "index.html").read_text(encoding="utf-8")
    assert "LightningModule" in loading  # scripts are included
    # In Markdown the stars of two A* in a paragraph may become emphasis.
    pages_of_site = [page.read_text(encoding="utf-8") for page in site.rglob("*.html")]
    assert not any(re.search(r"\bA<em>", page) for page in pages_of_site)
    notebook = (site / "first_look" / "index.html").read_text(encoding="utf-8")
    assert "data:image/png;base64" in notebook
    front = (site / "index.html").read_text(encoding="utf-8")
    body = front.split("<article", 1)[1].split("</h1>", 1)[1]
    text, _, _ = body.partition("<p><picture>")
    assert len(re.sub(r"<[^>]*>", "", text)) > 200  # Text first: a phone shows a sentence at once.
    assert re.search(
        r'<p><picture><source media="[^"]*" srcset="images/overview-phone.png">'
        r"<img [^>]*images/overview.png#only-light",
        body,
    )
    assert "images/overview-dark.png#only-dark" in body
    assert 'srcset="images/overview-phone-dark.png"' in body


PAGES_OF_QUERIES = {
    "A*": "planners/",
    "GPU": "howto/coming_from/",
    "MapDataset": "reference/datasets/",
    "U-Net": "loading/",
    "add a family": "howto/spec/",
    "batch size": "loading/",
    "cite": "faq/",
    "contest": "howto/teach/",
    "corner cutting": "words/",
    "custom dataset": "loading/",
    "custom heuristic": "howto/teach/",
    "draw search tree": "howto/teach/",
    "export": "export/",
    "gymnasium": "faq/",
    "hard problems": "problems/",
    "hugging face": "howto/coming_from/",
    "huggingface": "howto/coming_from/",
    "hydra": "recipes/",
    "install": "install/",
    "language model": "howto/text/",
    "license": "faq/",
    "lightning": "loading/",
    "mixed precision": "howto/training/",
    "movingai": "formats/movingai/",
    "normalize": "faq/",
    "num_workers": "howto/training/",
    "number of workers": "howto/training/",
    "optimal_moves": "fields/",
    "out of memory": "faq/",
    "own map png": "howto/maps/",
    "own planner": "howto/planner/",
    "pretrained": "pretrained/",
    "random problems": "problems/",
    "robot map": "formats/ros/",
    "samples per second": "howto/training/",
    "tensorboard": "howto/training/",
    "terrain cost": "howto/terrain/",
    "torch.compile": "howto/training/",
    "unet": "loading/",
    "visualize": "gallery/",
    "wandb": "howto/training/",
    "waypoints": "howto/waypoints/",
    "windows": "install/",
}
"""What newcomers type into the search box, and the page that answers it."""


NEEDS_NODE = pytest.mark.skipif(
    shutil.which("node") is None, reason="needs node, to run the search of the site"
)


def searched(
    site: Path, queries: list[str], folder: Path
) -> tuple[dict[str, list[str]], list[str]]:
    """Search the site for each query.

    Returns:
        The pages that each query finds, best first, and the queries that end in an error.
    """
    (folder / "queries.json").write_text(json.dumps(queries), encoding="utf-8")
    program = Path(__file__).parent / "search_site.js"
    command = ["node", str(program), str(site), str(folder / "queries.json")]
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    answer = json.loads(process.stdout)
    return answer["pages"], answer["errors"]


@NEEDS_MKDOCS
@NEEDS_NODE
@pytest.mark.slow
def test_the_search_finds_the_right_page(site: Path, tmp_path: Path) -> None:
    """It is the first hit of the site's own search."""
    hits, errors = searched(site, [*PAGES_OF_QUERIES], tmp_path)
    assert errors == []
    found = {query: hits[query][:1] for query in PAGES_OF_QUERIES}
    assert found == {query: [page] for query, page in PAGES_OF_QUERIES.items()}


@NEEDS_MKDOCS
@NEEDS_NODE
@pytest.mark.slow
def test_no_word_stops_the_search(site: Path, tmp_path: Path) -> None:
    """Every beginning of every word of the site, as it is typed, is answered without an error."""
    index = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))
    texts = [re.sub("<[^>]*>", " ", f"{doc['title']} {doc['text']}") for doc in index["docs"]]
    words = {word for text in texts for word in re.findall("[a-z][a-z0-9_]+", text.lower())}
    typed = {word[:length] for word in words for length in range(1, len(word) + 1)}
    assert len(typed) > 10_000
    _, errors = searched(site, sorted(typed), tmp_path)
    assert errors == []


def test_the_index_has_the_sections_of_the_sidebar() -> None:
    """The same six sections in the same order, and each page of a section in its table."""
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    nav = yaml.safe_load(text[text.index("\nnav:") :])["nav"]
    sections = [next(iter(section)) for section in nav]
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    parts = re.split(r"^## (.*)$", index, flags=re.MULTILINE)
    tables = dict(zip(parts[1::2], parts[2::2], strict=True))
    assert [title for title in tables if title in sections] == sections
    for section in nav:
        ((title, pages),) = section.items()
        for page in pages:
            if isinstance(page, str) and page != "index.md" and not page.startswith("reference/"):
                assert f"]({page})" in tables[title], page


def test_no_two_pages_have_one_title() -> None:
    """A reader of the search or of the sidebar could not tell them apart."""
    titles = [page.read_text(encoding="utf-8").partition("\n")[0] for page in DOCS.rglob("*.md")]
    assert len(titles) == len(set(titles))


PAGES_OF_0_3_0 = """
    benchmarks command costs distributed export families faq fields first_look format formats
    formats/images formats/maze-hard formats/movingai formats/paper formats/planning-datasets
    formats/ros formats/text formats/tilebased formats/transpath formats/warcraft gallery
    howto/coming_from howto/costmap howto/images howto/labels howto/maps howto/maze_hard howto/ompl
    howto/planner howto/publish howto/robot howto/spec howto/teach howto/terrain howto/text
    howto/training howto/waypoints index install layout leaks limits loading paper planner_tables
    planners pretrained problems promises recipes reference/costmaps reference/datasets
    reference/evaluation reference/export reference/families reference/formats reference/index
    reference/maps reference/models reference/plotting reference/problems reference/search
    reference/shards samplers scale tutorial urls versions which_problems words
"""
"""The pages of the site of version 0.3.0, which others may have linked, without ``.md``."""


def moved_pages() -> dict[str, str]:
    """Return the pages that have moved, and where to."""
    moved: dict[str, str] = runpy.run_path(str(DOCS / "hooks.py"))["MOVED"]
    return moved


def test_no_page_of_an_earlier_version_is_lost() -> None:
    """Each is a page still, or leads to the heading of one."""
    now = {str(page.relative_to(DOCS).with_suffix("")) for page in DOCS.rglob("*.md")}
    now.add(NOTEBOOK.stem)
    moved = moved_pages()
    gone = {name.removesuffix(".md") for name in moved}
    assert gone.isdisjoint(now)
    assert set(PAGES_OF_0_3_0.split()) <= now | gone
    for place in moved.values():
        page, _, anchor = place.partition("#")
        headings = re.findall(r"^#+ (.*)$", (DOCS / page).read_text(encoding="utf-8"), re.MULTILINE)
        assert anchor in [re.sub(r"\W+", "-", heading.lower()) for heading in headings], place


@NEEDS_MKDOCS
@pytest.mark.slow
def test_every_address_of_an_earlier_version_is_answered(site: Path) -> None:
    """By a page, or by one that leads to a page with the anchor in it, with and without scripts."""
    moved = moved_pages()
    for name in PAGES_OF_0_3_0.split():
        is_front = name.rpartition("/")[2] == "index"
        answer = site / (f"{name}.html" if is_front else f"{name}/index.html")
        text = answer.read_text(encoding="utf-8")
        if f"{name}.md" not in moved:
            assert "<article" in text, name
            continue
        (address,) = set(re.findall(r'(?:url=|href=")([^"#]*#[^"]*)"', text))
        folder, _, anchor = address.partition("#")
        assert f'location.replace("{folder}" + (location.hash || "#{anchor}"))' in text
        target = (answer.parent / folder / "index.html").resolve()
        assert target.is_relative_to(site.resolve())
        assert f'id="{anchor}"' in target.read_text(encoding="utf-8"), name


def test_every_page_that_the_sources_name_is_there() -> None:
    """Docstrings, error messages and comments name pages by their place."""
    named = {
        (page, file.name)
        for folder in ("mapdata", "models", "scripts", "benchmarks", "docs", "tests", ".ci")
        for file in (ROOT / folder).rglob("*")
        if file.suffix in ("", ".py") and file.is_file()
        for page in re.findall(r"\bdocs/[\w/-]+\.md\b", file.read_text(encoding="utf-8"))
    }
    assert len(named) > 30
    assert [one for one in sorted(named) if not (ROOT / one[0]).exists()] == []
