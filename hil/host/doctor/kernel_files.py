"""The files in which the kernel shows its state."""

from pathlib import Path

SYS = Path("/sys")
PROC = Path("/proc")


def read_line(path: Path) -> str:
    """Return a file's text without surrounding white space; an empty text if the file cannot be read."""
    try:
        return path.read_text().strip()
    except OSError:
        return ""
