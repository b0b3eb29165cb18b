"""The folder that results are written into: whether it may be used, and the replacement of earlier results.

A folder belongs to the title of the report in it. Results under the same title are replaced, those that only
the earlier design had included. Earlier results that differ, in more than the report, are first moved into a
folder ``earlier-1``, ``earlier-2``, ... beside them. A folder that holds anything else under the names of
results is refused and left as it is; other files in it are never touched.
"""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from html import unescape
from pathlib import Path

from hil.core.errors import HilError

REPORT = "report.html"
"""File name of the report."""
EARLIER = "earlier-"
"""Beginning of the names of the folders that earlier results are moved to."""


@dataclass(frozen=True)
class ResultsFolder:
    """A folder for the results of one plant."""

    directory: Path
    title: str
    """Title of the report."""
    names: Collection[str]
    """File names that results may have, relative to the folder, besides the report."""

    def check(self) -> None:
        """Raise HilError if results cannot be written, or would overwrite files that are not this plant's."""
        try:
            nearest = next(path for path in (self.directory, *self.directory.parents) if path.exists())
            existing = self._existing()
            held = _title(self.directory / REPORT) if (self.directory / REPORT) in existing else None
        except OSError as error:
            raise _file_error(error, self.directory) from None
        if not nearest.is_dir():
            raise HilError(
                f"results folder {self.directory}: {nearest} is a file, not a folder; name another folder "
                "with --out"
            )
        if not os.access(nearest, os.W_OK | os.X_OK):
            raise HilError(
                f"results folder {self.directory}: no permission to write into {nearest}; change its owner "
                "or mode, or name another folder with --out"
            )
        if not existing or held == self.title:
            return
        content = f'holds "{held}"' if held else f"contains {existing[0].name}, which no design has written"
        raise HilError(
            f"results folder {self.directory} {content}; it is left as it is, because only results for the "
            "same plant name are replaced. Name another folder with --out, or remove this one"
        )

    def replace(self, texts: Mapping[str, str], *, keeps_earlier: bool = False) -> Path | None:
        """Write texts by file name, the report among them, and remove all other earlier results.

        With ``keeps_earlier``, earlier results that differ are moved instead, and the folder that they are
        in now is returned. Raises HilError if a file cannot be written.
        """
        kept = None
        try:
            if keeps_earlier and self._differ(texts):
                kept = self._move_earlier()
            for path in self._existing():
                if path.name != REPORT:
                    path.unlink()
            # The report is written first, since its title says to whom the folder belongs.
            for name in sorted(texts, key=lambda name: name != REPORT):
                path = self.directory / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(texts[name], encoding="utf-8")
        except OSError as error:
            raise _file_error(error, self.directory) from None
        return kept

    def _differ(self, texts: Mapping[str, str]) -> bool:
        """Return True if there are earlier results other than these. A report has a date, and is ignored."""
        earlier = {
            str(path.relative_to(self.directory)): path.read_text("utf-8", "replace")
            for path in self._existing()
        }
        report = earlier.pop(REPORT, None)
        return report is not None and earlier != {n: text for n, text in texts.items() if n != REPORT}

    def _move_earlier(self) -> Path:
        """Move all earlier results into a new folder beside them, and return it."""
        numbers = itertools.count(1)
        kept = next(p for n in numbers if not (p := self.directory / f"{EARLIER}{n}").exists())
        for path in self._existing():
            place = kept / path.relative_to(self.directory)
            place.parent.mkdir(parents=True, exist_ok=True)
            path.rename(place)
        return kept

    def _existing(self) -> list[Path]:
        """Return the files in the folder that have the names of results."""
        return [path for path in (self.directory / name for name in (REPORT, *self.names)) if path.exists()]


def _title(report: Path) -> str | None:
    """Return the title of an HTML file; None if it has none."""
    found = re.search(r"<title>(.*?)</title>", report.read_text("utf-8", "replace"), re.DOTALL)
    return unescape(found[1]) if found else None


def _file_error(error: OSError, directory: Path) -> HilError:
    return HilError(f"{error.filename or directory}: cannot be read or written: {error.strerror}")
