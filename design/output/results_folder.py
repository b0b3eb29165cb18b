"""The folder that results go into: whose it is, known before a search begins, and what is left in it.

A folder is the plant's that the title of its report names. Results under the same title are replaced, what an
earlier design left there included; whatever else stands in the way is left as it is, and refused.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from html import unescape
from pathlib import Path

from hil.core.errors import HilError

REPORT = "report.html"
FIGURES = "figures"
CONTROLLERS = tuple(f"{stem}.json" for stem in ("controller", "hls", "pi", "zn", "tlc"))


@dataclass(frozen=True)
class ResultsFolder:
    """Where results go, and the title of their report."""

    directory: Path
    title: str

    def check(self) -> None:
        """Raises HilError where results could not be written or would overwrite what is not theirs."""
        try:
            nearest = next(path for path in (self.directory, *self.directory.parents) if path.exists())
            standing = self._standing()
            held = _title(self.directory / REPORT) if (self.directory / REPORT) in standing else None
        except OSError as error:
            raise _cannot(error, self.directory) from None
        if not nearest.is_dir():
            raise HilError(f"--out {self.directory}: {nearest} is a file, not a folder")
        if not os.access(nearest, os.W_OK | os.X_OK):
            raise HilError(
                f"--out {self.directory}: {nearest} cannot be written to (see its owner and rights)"
            )
        if not standing or held == self.title:
            return
        what = f'holds "{held}"' if held else f"has a {standing[0].name} that is of no design"
        raise HilError(
            f"{self.directory} {what}; it is left as it is: only results of the same plant's name are "
            "replaced. Name another folder with --out, or remove this one"
        )

    def replace(self, texts: Mapping[str, str]) -> None:
        """Write texts by file name, the report among them, in place of all earlier results."""
        try:
            for path in self._standing():
                if path.name != REPORT:
                    path.unlink()
            # The report first: it says whose the folder is.
            for name in sorted(texts, key=lambda name: name != REPORT):
                path = self.directory / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(texts[name], encoding="utf-8")
        except OSError as error:
            raise _cannot(error, self.directory) from None

    def _standing(self) -> list[Path]:
        """Files there that bear the names of results."""
        named = [self.directory / name for name in (REPORT, *CONTROLLERS)]
        return [path for path in named if path.exists()] + sorted(self.directory.glob(f"{FIGURES}/fig*.svg"))


def _title(report: Path) -> str | None:
    """The title of a report; None of another file."""
    found = re.search(r"<title>(.*?)</title>", report.read_text("utf-8", "replace"), re.DOTALL)
    return unescape(found[1]) if found else None


def _cannot(error: OSError, directory: Path) -> HilError:
    return HilError(f"{error.filename or directory}: cannot be read or written: {error.strerror}")
