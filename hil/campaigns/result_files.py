"""The results of a campaign on disk.

``results.jsonl`` has one line for each finished case, in the order of the cases. A campaign that was
interrupted goes on after its last complete line. ``results.parquet`` is the same as a table; without pyarrow
it is ``results.csv``.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any, Final

import msgspec

from hil.campaigns.case import CaseResult
from hil.core.errors import HilError
from hil.host.text_file import read_text

LINES: Final = "results.jsonl"
CAMPAIGN: Final = "campaign.toml"
_ROWS_AT_ONCE: Final = 10_000
_COLUMNS: Final = tuple(field.name for field in msgspec.structs.fields(CaseResult))


class ResultFolder:
    """The folder of one campaign's results."""

    def __init__(self, path: Path, campaign_text: str, cases: int) -> None:
        """Create the folder, or continue in it. Raises HilError if it holds another campaign's results.

        ``cases`` is the number of cases of the campaign. The folder may have results of more cases, from a
        campaign with more draws. They are kept, but they are not among the results.
        """
        self.path = path
        self._cases = cases
        self._lines = path / LINES
        copy = path / CAMPAIGN
        try:
            if not copy.exists():
                path.mkdir(parents=True, exist_ok=True)
                copy.write_text(campaign_text, encoding="utf-8")
        except OSError as error:
            raise HilError(f"{path}: cannot be created: {error.strerror}; see --output") from None
        if read_text(copy) != campaign_text:
            raise HilError(
                f"{path}: has results of another campaign, or of another version of this file; choose "
                "another folder with --output, or remove this one"
            )
        self.finished = min(self._drop_incomplete_line(), cases)
        """Number of cases of the campaign whose results are complete."""

    def append(self, results: Iterable[CaseResult]) -> None:
        """Add the results of the next cases."""
        with self._lines.open("ab") as file:
            for result in results:
                file.write(msgspec.json.encode(result) + b"\n")
                self.finished += 1

    def results(self) -> Iterator[CaseResult]:
        """Yield all results in the order of the cases."""
        if self._lines.exists():
            with self._lines.open("rb") as file:
                for line in islice(file, self._cases):
                    yield msgspec.json.decode(line, type=CaseResult)

    def write_table(self) -> Path:
        """Write all results as a Parquet table, or as CSV without pyarrow. Returns the file."""
        if find_spec("pyarrow") is None:
            return self._write_csv()
        import pyarrow as pa
        import pyarrow.parquet as pq

        path = self.path / "results.parquet"
        schema = pa.schema([(name, _arrow_type(pa, name)) for name in _COLUMNS])
        rows = self.results()
        with pq.ParquetWriter(path, schema) as writer:
            while batch := list(islice(rows, _ROWS_AT_ONCE)):
                columns = {name: [getattr(row, name) for row in batch] for name in _COLUMNS}
                writer.write_table(pa.table(columns, schema=schema))
        return path

    def _write_csv(self) -> Path:
        path = self.path / "results.csv"
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(_COLUMNS)
            writer.writerows(msgspec.structs.astuple(row) for row in self.results())
        return path

    def _drop_incomplete_line(self) -> int:
        """Cut off a line that an interrupted process did not finish. Returns the number of complete lines."""
        if not self._lines.exists():
            return 0
        count = size = 0
        with self._lines.open("r+b") as file:
            for line in file:
                if line.endswith(b"\n"):
                    count, size = count + 1, size + len(line)
            file.truncate(size)
        return count


def _arrow_type(pa: Any, name: str) -> Any:
    """Return the column type of a field of CaseResult."""
    kinds = {int: pa.int64(), float: pa.float64(), bool: pa.bool_(), str: pa.string()}
    hint = next(field.type for field in msgspec.structs.fields(CaseResult) if field.name == name)
    plain = next((kind for kind in getattr(hint, "__args__", (hint,)) if kind in kinds), str)
    return kinds[plain]
