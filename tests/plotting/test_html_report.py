"""The report, opened in a real browser: filters and clicks do what they say, the paths drawn are
the stored ones.
"""

from __future__ import annotations

import hashlib
import json
import re
import zlib
from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.browser import PROGRAM, Browser
from helpers.imported import NASTY, imported
from helpers.samples import SPEC, WIDE, build_small

from mapdata import Labels, MapSpec, build
from mapdata.cli import main
from mapdata.describe import dataset_statistics
from mapdata.formats import Collection, ForeignMap, import_maps
from mapdata.limits import SPLITS
from mapdata.plotting import report
from mapdata.plotting.html_report import _compressed_maps
from mapdata.shards import Root, read_manifest

needs_chromium = pytest.mark.skipif(PROGRAM is None, reason="no Chromium: apt-get install chromium")


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """Return a headless Chromium."""
    with Browser(tmp_path_factory.mktemp("profile")) as running:
        yield running


@pytest.fixture(
    scope="module",
    params=[
        "small",
        pytest.param("wide", marks=pytest.mark.slow),
        pytest.param("imported", marks=pytest.mark.slow),
    ],
)
def root(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a dataset: one of 4-connected maps, one with diagonals, one without rooms."""
    folder = tmp_path_factory.mktemp(request.param) / "d"
    if request.param == "imported":
        return imported(folder)
    return Path(build_small(folder, SPEC if request.param == "small" else WIDE))


@pytest.fixture
def page(browser: Browser, root: Path, tmp_path: Path) -> Iterator[Browser]:
    """Return the browser with the report of the dataset open, and check that nothing went wrong on
    it.
    """
    path = tmp_path / "report.html"
    path.write_text(report(root), encoding="utf-8")
    browser.open(path)
    yield browser
    assert browser.errors == []
    outside = [url for url in browser.requests if not url.startswith("data:")]
    assert outside == [path.as_uri()]  # the page asks for nothing else


def choose(page: Browser, name: str, value: object) -> list[int]:
    """Set a filter and return the numbers of the maps that are listed, on all pages."""
    page.run(
        f"$({name!r}).value = {str(value)!r}; $({name!r}).dispatchEvent(new Event('input', "
        f"{{bubbles: true}}))"
    )
    return listed(page)


def listed(page: Browser) -> list[int]:
    """Return the numbers of the maps on all pages."""
    script = """(() => {
        while (!$("back").disabled) $("back").click();
        const found = [];
        for (;;) {
            for (const button of $("thumbs").children) found.push(Number(button.textContent.replace("map", "")));
            if ($("next").disabled) break;
            $("next").click();
        }
        return found;
    })()"""
    return [int(number) for number in page.run(script)]


def clicked(page: Browser) -> list[dict[str, Any]]:
    """Click on every map; return what is shown of each."""
    script = """(() => {
        const rows = (id) => [...$(id).querySelectorAll("tbody tr")].map((row) =>
            [...row.querySelectorAll("td")].map((cell) => cell.textContent));
        const pixels = () => {
            const { width, height } = $("grid");
            const copy = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
            copy.drawImage($("grid"), 0, 0);
            const data = copy.getImageData(0, 0, width, height).data;
            return Array.from({length: width * height}, (_, k) => data[4 * k] < 128 ? 1 : 0);
        };
        const lines = (planner) => [...document.querySelectorAll(`#routes polyline.${planner}`)].map((line) =>
            [Number(line.dataset.segment), line.getAttribute("points")]);
        const choose = (value) => document.querySelector(`input[name=matrix][value=${value}]`).click();
        const found = [];
        for (;;) {
            for (const button of $("thumbs").children) {
                button.click();
                const one = { name: $("name").textContent, pressed: button.getAttribute("aria-pressed"),
                    pixels: pixels(), segments: rows("segments"), rooms: rows("rooms"),
                    seeds: [...document.querySelectorAll("#routes circle")].map(({ cx, cy }) =>
                        [cy.baseVal.value, cx.baseVal.value]),
                    facts: Object.fromEntries([...$("facts").querySelectorAll("dt")].map((term) =>
                        [term.textContent, term.nextSibling.textContent])) };
                for (const planner of ["bfs", "astar"]) {
                    choose(planner);
                    one[planner] = { lines: lines(planner), matrix: rows("matrix") };
                }
                found.push(one);
            }
            if ($("next").disabled) return found;
            $("next").click();
        }
    })()"""
    return list(page.run(script))


def number(text: str) -> float:
    """Read a cell of a table."""
    return -1.0 if text == "no connection" else float(text.replace(",", ""))


def assert_shown(one: dict[str, Any], labels: Labels, i: int, rooms: bool) -> None:
    """Compare what the page shows of a map with what is stored."""
    maps, n = labels.maps, int(labels.maps.rooms[i])
    assert one["pressed"] == "true"
    assert one["pixels"] == maps.occupancy[i].reshape(-1).tolist()
    np.testing.assert_array_equal(np.reshape(one["seeds"], (n, 2)) - 0.5, maps.seed_points[i, :n])
    assert one["facts"]["split"] == SPLITS[maps.split[i]]
    assert ("passage width" in one["facts"]) == rooms
    assert one["facts"]["connected"].startswith("all" if labels.all_connected[i] else "some")
    columns = [maps.seed_points[i, :n], *([maps.sizes[i, :n]] if rooms else [])]
    assert [[int(cell) for cell in row] for row in one["rooms"]] == np.concatenate(
        columns, axis=1
    ).tolist()
    for search in ("bfs", "astar"):
        route = labels.route(search, i)
        expected = {
            q: " ".join(f"{column + 0.5:g},{row + 0.5:g}" for row, column in path.tolist())
            for q, path in enumerate(route)
            if len(path)
        }
        assert dict(one[search]["lines"]) == expected
        found = np.array([[number(cell) for cell in row] for row in one[search]["matrix"]]).reshape(
            n, n
        )
        np.testing.assert_allclose(found, labels.matrix(search, i), atol=0.006)
    for search, column in (("bfs", -1), ("astar", -3)):
        assert [number(row[column]) for row in one["segments"]] == labels.iterations(
            search, i
        ).tolist()
    assert [("no path" in row) for row in one["segments"]] == [not len(path) for path in route]
    if rooms:
        assert [row[0] != "none" for row in one["segments"]] == maps.connected[i, : n - 1].tolist()


@needs_chromium
def test_a_click_shows_the_stored_labels_of_a_map(page: Browser, root: Path) -> None:
    """Cells, routes, iterations, matrices and facts in the page equal those of the dataset."""
    statistics = dataset_statistics(root)
    shown = clicked(page)
    assert [one["name"] for one in shown] == [f"map{index}" for index in statistics.index]
    for one, index in zip(shown, statistics.index.tolist(), strict=True):
        labels, i = statistics.root.locate(index)
        assert_shown(one, labels, i, statistics.rooms_known)


@needs_chromium
def test_filters_leave_the_maps_that_match(page: Browser, root: Path) -> None:
    """The filters are split, connection and hardness."""
    statistics = dataset_statistics(root)
    for code, split in enumerate(SPLITS):
        if (statistics.split == code).any():
            assert (
                choose(page, "split", split) == statistics.index[statistics.split == code].tolist()
            )
    assert choose(page, "split", "") == statistics.index.tolist()
    assert choose(page, "connected", 1) == statistics.index[statistics.all_connected].tolist()
    assert choose(page, "connected", 0) == statistics.index[~statistics.all_connected].tolist()
    choose(page, "connected", "")
    for value, low, high in (("1,1.05", 1, 1.05), ("1.05,1e9", 1.05, 1e9), ("2,1e9", 2, 1e9)):
        assert (
            choose(page, "hardness", value)
            == statistics.index[(statistics.hardest >= low) & (statistics.hardest < high)].tolist()
        )
    choose(page, "hardness", "")
    least, most = 3, 4
    choose(page, "least", least)
    assert (
        choose(page, "most", most)
        == statistics.index[(statistics.rooms >= least) & (statistics.rooms <= most)].tolist()
    )
    assert (
        choose(page, "split", "train")
        == statistics.index[
            (statistics.rooms >= 3) & (statistics.rooms <= 4) & (statistics.split == 0)
        ].tolist()
    )
    assert page.run("$('count').textContent").startswith(
        f"{len(listed(page))} of {len(statistics)} maps"
    )
    page.run("document.querySelector('[type=reset]').click()")
    page.run("new Promise((done) => setTimeout(done, 20))")
    assert listed(page) == statistics.index.tolist()
    assert choose(page, "least", 100) == []
    assert page.run("$('count').textContent") == "No map of the sample is like that."


@needs_chromium
def test_planners_and_segments_can_be_switched_off(page: Browser) -> None:
    """The lines of a hidden planner or segment disappear."""

    def lines() -> list[int]:
        return [
            int(page.run(f"document.querySelectorAll('#routes polyline.{p}').length"))
            for p in ("bfs", "astar")
        ]

    page.run("show(0)")
    both = lines()
    page.run("$('show-bfs').click()")
    assert lines() == [0, both[1]]
    page.run("$('show-bfs').click(); $('show-astar').click()")
    assert lines() == [both[0], 0]
    page.run("$('show-astar').click()")
    segment = page.run("document.querySelector('#routes polyline').dataset.segment")
    page.run(f"$('segment').value = '{segment}'; $('segment').dispatchEvent(new Event('input'))")
    assert lines() == [1, 1]


@needs_chromium
def test_maps_can_be_chosen_with_the_keyboard(page: Browser) -> None:
    """Arrow keys move the focus, and Enter shows the map."""
    page.run("$('thumbs').children[0].focus()")
    page.press("ArrowRight")
    page.press("ArrowRight")
    page.press("ArrowLeft")
    page.press("Enter")
    second = page.run("$('thumbs').children[1].textContent")
    assert page.run("$('name').textContent") == second
    assert page.run("document.activeElement.textContent") == second
    assert (
        page.run("[...$('thumbs').children].filter((button) => button.tabIndex === 0).length") == 1
    )


@needs_chromium
def test_every_control_has_a_name(page: Browser) -> None:
    """Screen readers need names of controls, the language, and identities that are unique."""
    unnamed = """[...document.querySelectorAll("input, select, button, [role=img], [role=region], table")].filter(
        (one) => !(one.labels && one.labels.length && one.labels[0].textContent.trim())
        && !one.getAttribute("aria-label") && !one.textContent.trim()).map((one) => one.outerHTML)"""
    assert page.run(unnamed) == []
    assert page.run("document.documentElement.lang") == "en"
    identities = page.run("[...document.querySelectorAll('[id]')].map((one) => one.id)")
    assert len(set(identities)) == len(identities)
    assert page.run("document.documentElement.scrollWidth <= innerWidth")


def test_a_source_whose_name_is_no_utf8_is_reported(tmp_path: Path) -> None:
    """Such names come from old archives; Python has their bytes as lone surrogates."""
    grid = np.zeros((5, 5), np.uint8)
    import_maps(tmp_path / "maps", Collection([ForeignMap("plan\udcff.png", grid)]))
    page = report(tmp_path / "maps").encode()
    assert b"<td>plan?.png</td>" in page


@needs_chromium
def test_text_from_files_stays_text(browser: Browser, tmp_path: Path) -> None:
    """A name in the dataset that looks like HTML is shown as text and runs no script."""
    folder = imported(tmp_path / "<img src=x onerror=alert(1)>@@DATA@@\"'")
    path = tmp_path / "report.html"
    path.write_text(report(folder), encoding="utf-8")
    browser.open(path)
    assert browser.errors == []
    assert browser.run("document.querySelectorAll('img:not(.charts img), b').length") == 0
    assert browser.run("document.querySelectorAll('script').length") == 2
    assert browser.run("document.title").startswith(folder.name)
    assert " ".join(NASTY.split()) in browser.run("$('card').innerText.replace(/\\s+/g, ' ')")
    # and were something to slip through, the policy stops it
    browser.run(
        "$('card').insertAdjacentHTML('beforeend', '<img src=x onerror=\"window.hit = 1\">')"
    )
    browser.run("new Promise((done) => setTimeout(done, 100))")
    assert browser.run("window.hit") is None
    assert browser.errors != []


@pytest.mark.slow
@needs_chromium
def test_a_large_report_is_small(browser: Browser, tmp_path: Path) -> None:
    """It is below 300 kB, with a sample of the maps."""
    build(tmp_path / "d", MapSpec(), maps=1200, workers=1)
    path = tmp_path / "report.html"
    main(["report", str(tmp_path / "d"), "-o", str(path)])
    assert path.stat().st_size < 300_000
    browser.open(path)
    assert browser.run("maps.length") == 500
    numbers = listed(browser)
    assert numbers[0] == 0
    assert set(np.diff(numbers).tolist()) == {2, 3}
    labels, i = Root.open(tmp_path / "d").locate(numbers[321])
    assert browser.run("path('bfs', 321, 0)") == labels.segment("bfs", i, 0).tolist()
    assert browser.run("path('astar', 321, 0)") == labels.segment("astar", i, 0).tolist()


@pytest.mark.slow
def test_the_page_is_self_contained_and_reproducible(root: Path) -> None:
    """It loads nothing from elsewhere, and equal datasets give equal pages."""
    text = report(root)
    assert text == report(root)
    page = re.sub("&[a-z]+;", "", text.split("<script>")[0]).replace("img src=x", "")
    assert not re.search(r"""(src|href)\s*=\s*["']?(?!#|data:image/svg)\w""", page)
    assert "@@" not in text.replace(read_manifest(root).content_hash, "")
    assert "default-src 'none'" in text


def test_several_resolutions_are_all_named(tmp_path: Path) -> None:
    """The report is of two datasets with different resolutions."""
    for name, resolution in (("a", 0.1), ("b", 0.05), ("c", 0.1)):
        build(tmp_path / name, MapSpec(resolution=resolution), maps=3)
    pages = [
        _compressed_maps(dataset_statistics([tmp_path / "a", tmp_path / name]), np.array([0]))
        for name in "bc"
    ]
    found = [json.loads(zlib.decompress(page))["resolution"] for page in pages]
    assert found == ["0.05/0.1", "0.1"]


@pytest.mark.slow
def test_the_security_policy_has_the_hashes_of_script_and_style(root: Path) -> None:
    """The hashes are those that browsers compute; after a change of the script or style the policy
    must be updated.
    """
    page = report(root)
    for tag in ("script", "style"):
        (text,) = re.findall(f"<{tag}>(.*?)</{tag}>", page, re.DOTALL)
        digest = b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{tag}-src 'sha256-{digest}';" in page


@pytest.mark.slow
def test_a_sample_is_evenly_spaced(root: Path) -> None:
    """The page says how many maps of the dataset it shows."""
    assert f"3 of {len(dataset_statistics(root)):,} maps, evenly spaced." in report(root, maps=3)


def test_command_refuses_no_maps(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A report of 0 maps is wrong usage."""
    with pytest.raises(SystemExit) as ended:
        main(["report", str(root), "--maps", "0"])
    assert ended.value.code == 2
    assert "maps: got 0, expected an integer of at least 1" in capsys.readouterr().err


@pytest.mark.slow
def test_charts_have_a_text_of_their_statistics(root: Path) -> None:
    """Each distribution has a picture, and the same text as its caption and as its alternative
    text.
    """
    figures = re.findall(
        r'<figure><img src="[^"]*" alt="([^"]*)"><figcaption>([^<]*)</figcaption>', report(root)
    )
    statistics = dataset_statistics(root)
    assert len(figures) == len(statistics.distributions())
    for (alt, caption), (name, values) in zip(
        figures, statistics.distributions().items(), strict=True
    ):
        assert alt == caption
        assert alt.startswith(
            f"{name}: mean {values.mean():.4g}, median {np.median(values):.4g}, from"
        )
