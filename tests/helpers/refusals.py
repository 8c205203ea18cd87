"""Reads hostile files, named as ``loader=path``, and prints what each costs.

shards/test_hostile.py runs it. A line for each: loader, path, name of the error, bytes of memory
that it took at most. All together they get two minutes of processor time, a hundred times what they
need.
"""

from __future__ import annotations

import json
import re
import resource
import sys
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import aiohttp  # noqa: F401  # what a fetch imports is not its memory
import fsspec.implementations.http  # noqa: F401

from mapdata import MapDataset, ProblemSet
from mapdata.formats import read_any
from mapdata.generators import as_recipe
from mapdata.models.pretrained.path_predictor import PathPredictor
from mapdata.shards import open_shard, read_manifest


def read_format(path: str) -> None:
    """Read a file; if it is left out, the error has the reason."""
    read_any(path)


class EndlessHandler(BaseHTTPRequestHandler):
    """Answers with the text of a file that is asked for by its path, again and again."""

    def do_GET(self) -> None:
        """Send it until the client is gone."""
        text = Path(self.path).parent.read_bytes() * 1000
        self.send_response(200)
        self.end_headers()
        try:
            while True:
                self.wfile.write(text)
        except OSError:
            pass

    def log_message(self, *_: object) -> None:
        """Print nothing."""


def fetch_endless(path: str) -> None:
    """Open a dataset at a URL whose manifest begins as the file, and has no end."""
    with ThreadingHTTPServer(("127.0.0.1", 0), EndlessHandler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            MapDataset(f"http://127.0.0.1:{server.server_port}{path}")
        finally:
            server.shutdown()


LOADERS: dict[str, Callable[[str], object]] = {
    "shard": open_shard,
    "manifest": lambda path: read_manifest(Path(path)),
    "dataset": lambda path: MapDataset(path)[:],
    "url": fetch_endless,
    "recipe": as_recipe,
    "format": read_format,
    "problems": ProblemSet.load,
    "model": PathPredictor.load,
}


def memory(what: str) -> int:
    """Return VmHWM, the most memory since it was reset, or VmRSS, what is held now, in bytes."""
    match = re.search(rf"{what}:\s+(\d+) kB", Path("/proc/self/status").read_text())
    return 1024 * int(match[1]) if match else 0


def main() -> None:
    """Read all files, in the order given."""
    # A loader that hangs ends here, and is seen.
    resource.setrlimit(resource.RLIMIT_CPU, (120, 120))
    for argument in sys.argv[1:]:
        loader, path = argument.split("=", 1)
        Path("/proc/self/clear_refs").write_text("5")  # resets VmHWM
        before = memory("VmRSS")
        name = "nothing"
        try:
            LOADERS[loader](path)
        except Exception as error:  # its name is what the test looks at
            name = type(error).__name__
            if "\n" in str(error):
                name += " of several lines"
        print(json.dumps([loader, path, name, memory("VmHWM") - before]))


if __name__ == "__main__":
    main()
