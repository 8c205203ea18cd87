"""What a release holds: a wheel of `mapdata` alone that works outside the checkout, and sources
that can be tested.
"""

from __future__ import annotations

import os
import re
import runpy
import shutil
import subprocess
import sys
import tarfile
import zipfile
from email import message_from_bytes
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import yaml
from helpers.pages import DOCS, ROOT

import mapdata
from mapdata import PRESETS
from mapdata.cli.app import main

UNRELEASED_FOLDERS = {
    ".git",
    ".hypothesis",
    ".venv",
    "build",
    "data",
    "dist",
    "lightning_logs",
    "runs",
}
"""Folders that are neither in git nor in a release."""


def files(root: Path, *folders: str) -> set[str]:
    """Return the files of ``folders`` below ``root``, without what Python left."""
    found = (path for folder in folders for path in (root / folder).rglob("*") if path.is_file())
    return {str(path.relative_to(root)) for path in found if "__pycache__" not in path.parts}


def models() -> set[str]:
    """Return the files of the models under their names in the package."""
    return {f"mapdata/{name}" for name in files(ROOT, "models")}


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a copy of the sources, in which a build may leave its files."""
    if find_spec("build") is None or find_spec("setuptools") is None:
        pytest.skip('needs pip install -e ".[test]"')
    copy = tmp_path_factory.mktemp("release") / "mapdata"
    copy.mkdir()
    for path in ROOT.iterdir():
        if (
            path.is_dir()
            and path.name not in UNRELEASED_FOLDERS
            and not path.name.endswith(("_cache", ".egg-info"))
        ):
            ignore = shutil.ignore_patterns("__pycache__")
            shutil.copytree(path, copy / path.name, ignore=ignore, symlinks=True)
        elif path.is_file():
            shutil.copy(path, copy)
    return copy


@pytest.fixture(scope="module")
def dist(sources: Path) -> Path:
    """Return the folder of an sdist and of the wheel built from it."""
    command = [sys.executable, "-m", "build", "--no-isolation", "--skip-dependency-check"]
    command += ["--outdir", str(sources / "out"), str(sources)]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    if "BackendUnavailable" in process.stderr:
        pytest.skip("setuptools cannot build here")
    assert process.returncode == 0, process.stdout + process.stderr
    return sources / "out"


@pytest.fixture(scope="module")
def editable(sources: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with what ``pip install -e`` of the sources puts into an environment."""
    site = tmp_path_factory.mktemp("site")
    build = "import sys; from setuptools import build_meta; build_meta.build_editable(sys.argv[1])"
    command = [sys.executable, "-c", build, str(site)]
    subprocess.run(command, cwd=sources, capture_output=True, check=True)
    (wheel,) = site.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    return site


IMPORTS = """
import site
import sys
from importlib.util import find_spec
site.addsitedir(sys.argv[1])
import mapdata.models
names = sys.argv[2:]
found = [name for name in names if find_spec(name)]
print("found", *found)
for name in found:
    print(__import__(f"{name}.mine", fromlist=["NAME"]).NAME)
"""
"""Says which of the names can be imported beside mapdata.

It runs with -S, so the environment of the tests has no part in it.
"""


@pytest.mark.slow
@pytest.mark.parametrize("folders", [(), ("models", "benchmarks", "docs", "scripts", "tests")])
def test_an_editable_install_adds_the_name_mapdata_alone(
    editable: Path, folders: tuple[str, ...], tmp_path: Path
) -> None:
    """Folders of another project that have the name of one of ours are imported as before."""
    for name in folders:
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine.py").write_text(f"NAME = '{name} of another project'")
    ours = ["models", "benchmarks", "docs", "scripts", "tests", "helpers", "setup"]
    command = [sys.executable, "-E", "-S", "-c", IMPORTS, str(editable), *ours]
    process = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    expected = [" ".join(["found", *folders]), *(f"{name} of another project" for name in folders)]
    assert process.stdout.splitlines() == expected


@pytest.mark.slow
def test_the_wheel_holds_mapdata_only(dist: Path) -> None:
    """Every file of the package, the models and their weights among them, and nothing else but
    what pip needs. It is small enough for an e-mail.
    """
    (wheel,) = dist.glob("*.whl")
    assert wheel.stat().st_size < 20_000_000
    assert wheel.name == f"mapdata_torch-{mapdata.__version__}-py3-none-any.whl"
    about = f"mapdata_torch-{mapdata.__version__}.dist-info"
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        said = message_from_bytes(archive.read(f"{about}/METADATA"))
    assert {name.partition("/")[0] for name in names} == {"mapdata", about}
    info = {name for name in names if name.startswith(f"{about}/")}
    assert names - info == files(ROOT, "mapdata") | models()
    assert any(name.endswith("LICENSE") for name in info)
    assert (said["Name"], said["Version"]) == ("mapdata-torch", mapdata.__version__)
    assert said["Description-Content-Type"] == "text/markdown"
    assert "Paper, https://arxiv.org/abs/2110.13242" in said.get_all("Project-URL", [])


def test_what_is_missing_is_named_itself() -> None:
    """Nobody is sent to the other mapdata of the package index, nor from the wheel to a clone."""
    suffixes = {"mapdata": {".py"}, "models": {".py"}, "docs": {".md", ".ipynb"}}
    names = [
        name
        for folder, of_folder in suffixes.items()
        for name in files(ROOT, folder)
        if Path(name).suffix in of_folder
    ]
    assert {"mapdata/jit.py", "models/train.py", "docs/install.md"} <= set(names)
    for name in names:
        text = (ROOT / name).read_text(encoding="utf-8")
        assert not re.search(r"pip install ['\"]?mapdata", text), name
        assert not name.startswith("mapdata/") or "python scripts/" not in text, name


def workflow(name: str) -> tuple[dict[Any, Any], str]:
    """Return a workflow of GitHub, parsed and as text."""
    text = (ROOT / ".github" / "workflows" / f"{name}.yml").read_text(encoding="utf-8")
    return yaml.safe_load(text), text


def steps(job: dict[str, Any], key: str) -> list[str]:
    """Return what the steps of a job ``run`` or which action each ``uses``."""
    return [step[key] for step in job["steps"] if key in step]


def test_changes_are_tested_on_linux_and_tried_elsewhere() -> None:
    """Linux runs what a developer runs and must pass; the other systems run README's line and may
    fail.
    """
    tests, _ = workflow("ci")
    linux, others = tests["jobs"]["linux"], tests["jobs"]["other-systems"]
    assert steps(linux, "run") == [".ci/run"]
    assert "continue-on-error" not in linux
    assert others["continue-on-error"] is True
    assert others["strategy"]["matrix"]["system"] == ["macos-latest", "windows-latest"]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert steps(others, "run")[-1] in readme


def test_a_tag_is_published_without_a_password() -> None:
    """Only the job that publishes may ask for an identity, and it runs no code of ours."""
    publish, text = workflow("publish")
    assert publish[True] == {"push": {"tags": ["v*"]}}
    assert publish["permissions"] == {"contents": "read"}
    build, upload = publish["jobs"]["build"], publish["jobs"]["publish"]
    assert steps(build, "run") == [".ci/run", '.ci/release "$GITHUB_REF_NAME"']
    assert "permissions" not in build
    assert (upload["needs"], upload["permissions"]) == ("build", {"id-token": "write"})
    assert steps(upload, "run") == []
    assert steps(upload, "uses")[-1] == "pypa/gh-action-pypi-publish@release/v1"
    assert "secrets" not in text


def test_links_of_the_package_index_are_those_of_the_repository() -> None:
    """With an address each relative link and picture of README is a file of the tag; without one
    README is as it is.
    """
    names = runpy.run_path(str(ROOT / "setup.py"), run_name="setup")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert names["description"](readme, "", "1.2.3") == readme
    assert list(names["project_urls"]("", "1.2.3")) == ["Paper"]
    address = "https://host/owner/name"
    absolute = names["description"](readme, address, "1.2.3")
    links = re.findall(rf'[("]{address}/(blob|raw)/v1\.2\.3/([^)"#]+)', absolute)
    assert [path for _, path in links if not (ROOT / path).exists()] == []
    assert {path for folder, path in links if folder == "raw"} == {
        f"docs/images/{name}{theme}.png"
        for name in ("overview", "overview-phone", "batch")
        for theme in ("", "-dark")
    }
    assert ("blob", "CONTRIBUTING.md") in links
    assert not re.findall(r'(?:\]\(|src="|srcset=")(?!https?://|#)', absolute)
    assert (
        absolute.replace(f"{address}/blob/v1.2.3/", "").replace(f"{address}/raw/v1.2.3/", "")
        == readme
    )
    urls = names["project_urls"](address, "1.2.3")
    assert urls["Changelog"] == f"{address}/blob/v1.2.3/CHANGELOG.md"


def test_the_address_is_one_line_of_the_citation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The package and the site take it from there, and do without it."""
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    without = re.sub("^repository-code:.*\n", "", citation, flags=re.MULTILINE)
    address = "https://host/owner/name"
    for text, expected in ((without, ""), (f"{without}repository-code: {address}\n", address)):
        (tmp_path / "CITATION.cff").write_text(text, encoding="utf-8")
        package = runpy.run_path(str(ROOT / "setup.py"), run_name="setup")["citation_line"]
        monkeypatch.setitem(package.__globals__, "ROOT", tmp_path)
        assert package("repository-code") == expected
        assert package("version") == mapdata.__version__
        site = runpy.run_path(str(ROOT / "docs" / "hooks.py"))["on_config"]
        monkeypatch.setitem(site.__globals__, "CITATION", tmp_path / "CITATION.cff")
        config: dict[str, str] = {}
        site(config)
        assert config == ({"repo_url": address, "repo_name": "name"} if expected else {})


def test_the_newest_dependencies_are_tried_each_week() -> None:
    """By a command that looks at no constraints, with no secret and no right to write."""
    newest, text = workflow("newest")
    (entry,) = newest[True]["schedule"]  # to YAML 1.1, "on" is a bool
    assert re.fullmatch(r"\d+ \d+ \* \* \d", entry["cron"])
    (job,) = newest["jobs"].values()
    assert steps(job, "run") == [".ci/newest"]
    assert newest["permissions"] == {"contents": "read"}
    assert "secrets" not in text
    command = ROOT / ".ci" / "newest"
    assert os.access(command, os.X_OK)
    (install,) = re.findall("^pip install .*$", command.read_text(encoding="utf-8"), re.MULTILINE)
    assert "--upgrade " in install
    assert " -c " not in install


@pytest.mark.slow
def test_the_sdist_holds_what_the_tests_need(dist: Path) -> None:
    """All folders as they are, and what the tests read at the top. The models are there once, in
    the package, where git has a link to them.
    """
    (sdist,) = dist.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    wanted = files(ROOT, ".ci", ".github", "benchmarks", "docs", "mapdata", "scripts", "tests")
    wanted |= models()
    assert sdist.stat().st_size < 25_000_000
    assert not [name for name in names if name.startswith("models/")]
    wanted |= {
        path.name
        for path in ROOT.glob("*.*")
        if path.is_file() and path.suffix in {".md", ".py", ".toml", ".txt"}
    }
    assert wanted | {"LICENSE", "CITATION.cff", "mkdocs.yml"} <= names
    assert not [name for name in names if "__pycache__" in name]


OUTSIDE = """
import sys
site, checkout, *verbs = sys.argv[1:]
sys.path[:] = [site, *(path for path in sys.path if path not in ("", checkout))]
sys.meta_path[:] = [
    finder for finder in sys.meta_path if "editable" not in getattr(finder, "__module__", "")
]
import mapdata
from mapdata import PRESETS
from mapdata.cli.app import main
from mapdata.cli import main
for name in mapdata.__all__:
    getattr(mapdata, name)
for verb in verbs:
    try:
        main(verb.split())
    except SystemExit as stop:
        assert not stop.code, verb
sys.modules["scipy"] = None  # the planners do without it
from mapdata.models import PathPredictor
for name in PathPredictor.PRETRAINED:
    path = PathPredictor.pretrained(name).predict_path([[0, 0], [1, 0], [0, 0]], (0, 0), (2, 0))
    assert path[0].tolist() == [0, 0] and path[-1].tolist() == [2, 0], path
del sys.modules["scipy"]
from mapdata import models
for name in models.__all__:
    for weights in getattr(getattr(models, name), "PRETRAINED", ()):
        getattr(models, name).pretrained(weights)
from mapdata.models import evaluate, train
packages = ("mapdata", "models", "scripts")
ours = [module for name, module in sys.modules.items() if name.split(".")[0] in packages]
assert not [module.__file__ for module in ours if not module.__file__.startswith(site)]
"""
"""Uses the wheel unpacked in a folder, and nothing of the checkout but a .venv that may lie in it.
"""


@pytest.mark.parametrize(
    "verbs",
    [
        ("--version", "--help", "build --help", "import --help", "export --help"),
        pytest.param(  # compiles all kernels: their files are elsewhere
            (
                "build maps --maps 20",
                "info maps --card",
                "verify maps",
                "show maps --index 3",
                "report maps -o report.html",
                "export maps release --format movingai",
                "import release again",
            ),
            marks=pytest.mark.soak,
        ),
    ],
)
@pytest.mark.slow
def test_the_wheel_works_outside_the_checkout(
    verbs: tuple[str, ...], dist: Path, tmp_path: Path
) -> None:
    """Unpacked elsewhere all public names are there, all weights load and the command runs;
    nothing comes from the checkout.
    """
    (wheel,) = dist.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "site")
    command = [sys.executable, "-c", OUTSIDE, str(tmp_path / "site"), str(ROOT), *verbs]
    process = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr


def test_the_citation_is_that_of_the_readme() -> None:
    """Title, authors, number and version, said twice and alike."""
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert (citation["cff-version"], citation["version"]) == ("1.2.0", mapdata.__version__)
    assert {"title", "message", "authors"} <= set(citation)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    paper = citation["preferred-citation"]
    (title,) = re.findall(r"^  title += \{(.*)\},$", readme, re.MULTILINE)
    assert paper["title"] == title.replace("{", "").replace("}", "")
    assert paper["url"] in readme
    (authors,) = re.findall(r"^  author += \{(.*?)\},$", readme, re.MULTILINE | re.DOTALL)
    accents = {r"{\'i}": "í", r"{\'o}": "ó", r"{\~n}": "ñ", r"{\'u}": "ú"}
    for written, letter in accents.items():
        authors = authors.replace(written, letter)
    cited = [f"{one['family-names']}, {one['given-names']}" for one in paper["authors"]]
    assert cited == [" ".join(one.split()) for one in authors.split(" and ")]


def test_the_changelog_knows_this_version() -> None:
    """It is the first section below the unreleased one, and of the day of the citation."""
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    sections = re.findall(r"^## \[(.*?)\](?: - (\S+))?$", changelog, re.MULTILINE)
    released = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))["date-released"]
    assert sections[:2] == [("Unreleased", ""), (mapdata.__version__, str(released))]


@pytest.mark.slow
def test_the_three_sets_of_the_page_can_be_made(tmp_path: Path) -> None:
    """Each command of the page with a count of two; the loop over presets with its first one."""
    pytest.importorskip("pyarrow")
    text = (DOCS / "howto" / "publish.md").read_text(encoding="utf-8")
    section = text.partition("### Three sets")[2].partition("### ")[0]
    (presets,) = re.findall(r"^    for preset in (.*); do$", section, re.MULTILINE)
    assert set(presets.split()) <= set(PRESETS)
    commands = re.findall(r"^ +mapdata (export .*)$", section, re.MULTILINE)
    assert len(commands) == 3
    for command in commands:
        small = command.replace("--count 1000", "--count 2")
        assert small != command
        arguments = small.replace("$preset", presets.split()[0]).split()
        arguments[2] = str(tmp_path / arguments[2].replace("/", "-"))
        main(arguments)
        card = (Path(arguments[2]) / "README.md").read_text(encoding="utf-8")
        assert 'license: "cc-by-4.0"' in card
        assert "## Known limits" in card
