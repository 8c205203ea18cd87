"""Plain values as JSON, and their hashes."""

from __future__ import annotations

import hashlib
import json
from typing import Any


def canonical_json(values: object) -> str:
    """Return the one JSON text of ``values``, to hash: sorted keys, no white space, ASCII."""
    return json.dumps(
        values, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False
    )


def parsed_json(name: str, text: str | bytes) -> Any:
    """Return the value of a JSON text.

    Raises:
        ValueError: it is none.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:  # or no UTF-8
        raise ValueError(f"{name}: not JSON ({error})") from None


def hash_of(values: object) -> str:
    """Return the SHA-256 of the canonical JSON of ``values``, as hex."""
    return sha256_of(canonical_json(values).encode())


def sha256_of(data: bytes | memoryview) -> str:
    """Return the SHA-256 of ``data``, as hex."""
    return hashlib.sha256(data).hexdigest()
