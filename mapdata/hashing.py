"""Hashes of bytes and of JSON values, and the canonical JSON text that is hashed."""

from __future__ import annotations

import hashlib
import json
import re
from typing import Any


def canonical_json(values: object) -> str:
    """Return JSON text that depends on the values only: sorted keys, no white space, ASCII.

    Equal values have equal text, so they have equal hashes.
    """
    return json.dumps(
        values, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False
    )


def parsed_json(name: str, text: str | bytes) -> Any:
    """Return the value of a JSON text; ``name`` begins the error message.

    Raises:
        ValueError: the text is not JSON.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:  # ValueError also for bytes that are not UTF-8
        raise ValueError(f"{name}: not JSON ({error})") from None


def json_hash(values: object) -> str:
    """Return the SHA-256 of the canonical JSON text of ``values`` as 64 hexadecimal digits."""
    return sha256_hex(canonical_json(values).encode())


def sha256_hex(content: bytes | memoryview) -> str:
    """Return the SHA-256 of ``content`` as 64 hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def is_sha256_hex(text: str) -> bool:
    """Return whether ``text`` has the form of a SHA-256: 64 hexadecimal digits."""
    return re.fullmatch(r"[0-9a-f]{64}", text) is not None
