"""Mapping a shard; hostile ones are in test_shard.py, changed ones in test_fuzzing.py."""

from __future__ import annotations

from pathlib import Path

import pytest

from mapdata.shards.reader import map_file


def test_a_system_that_maps_no_more_says_so(tmp_path: Path) -> None:
    """The system's own error, with what it was about."""
    (tmp_path / "file").write_bytes(b"data")
    with open(tmp_path / "file", "rb") as file:
        assert map_file(file.fileno(), 4).tobytes() == b"data"
        with pytest.raises(OSError, match="cannot map a shard"):
            map_file(file.fileno(), 2**62)
