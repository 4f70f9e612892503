"""What a file is known by."""

from __future__ import annotations

import hashlib
from pathlib import Path

WHOLE_BYTES = 1 << 23
_END_BYTES = 1 << 20


def fingerprint(path: Path) -> str:
    """Return `sha256:...` of a file's content.

    Of a file beyond WHOLE_BYTES only its size, its first and its last mebibyte are hashed
    (`sha256-ends:...`); a bag ends in checksums of everything in it.
    """
    size = path.stat().st_size
    digest = hashlib.sha256()
    with path.open("rb") as file:
        if size <= WHOLE_BYTES:
            digest.update(file.read())
            return f"sha256:{digest.hexdigest()}"
        digest.update(str(size).encode())
        digest.update(file.read(_END_BYTES))
        file.seek(size - _END_BYTES)
        digest.update(file.read(_END_BYTES))
    return f"sha256-ends:{digest.hexdigest()}"
