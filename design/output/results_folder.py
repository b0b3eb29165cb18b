"""The folder that results are written into: whether it may be used, and the replacement of earlier results.

A folder belongs to the title of the report in it. Results under the same title are replaced, those that only
the earlier design had included. A folder that holds anything else under the names of results is refused and
left as it is; other files in it are never touched.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from html import unescape
from pathlib import Path

from hil.core.errors import HilError

REPORT = "report.html"
"""File name of the report."""


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

    def replace(self, texts: Mapping[str, str]) -> None:
        """Write texts by file name, the report among them, and remove all other earlier results.

        Raises HilError if a file cannot be written.
        """
        try:
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

    def _existing(self) -> list[Path]:
        """Return the files in the folder that have the names of results."""
        return [path for path in (self.directory / name for name in (REPORT, *self.names)) if path.exists()]


def _title(report: Path) -> str | None:
    """Return the title of an HTML file; None if it has none."""
    found = re.search(r"<title>(.*?)</title>", report.read_text("utf-8", "replace"), re.DOTALL)
    return unescape(found[1]) if found else None


def _file_error(error: OSError, directory: Path) -> HilError:
    return HilError(f"{error.filename or directory}: cannot be read or written: {error.strerror}")
