"""Read text files that a user names."""

from __future__ import annotations

from pathlib import Path

from hil.core.errors import DocumentError


def read_text(path: Path) -> str:
    """The text of a file. Raises DocumentError where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise DocumentError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise DocumentError(f"{path}: is not text") from None
