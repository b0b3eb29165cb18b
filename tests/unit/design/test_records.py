"""Records for identification, from tables: what is read, and what is refused with a reason."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from design.records import read_record
from hil.core.errors import DocumentError

TS = 0.01


def write(path: Path, rows: list[str], header: str = "time_s,u,y") -> Path:
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def rows(count: int = 200) -> list[str]:
    return [f"{k * TS:.4f},{k % 3},{0.001 * k}" for k in range(count)]


class TestCsv:
    def test_columns_and_sample_time_are_read(self, tmp_path: Path) -> None:
        record = read_record(str(write(tmp_path / "data.csv", rows())), unit="rad")
        experiment = record.experiment
        assert experiment.sample_time_s == pytest.approx(TS)
        assert experiment.u[:4].tolist() == [0.0, 1.0, 2.0, 0.0]
        assert experiment.y[100] == pytest.approx(0.1)
        assert (record.unit, record.axis, record.findings) == ("rad", "", ())
        assert len(record.sha256) == 64

    def test_unusual_units_are_findings(self, tmp_path: Path) -> None:
        lines = [f"{1000 * k * TS:.4f},{k % 3},{0.001 * k}" for k in range(200)]
        (finding,) = read_record(write(tmp_path / "ms.csv", lines)).findings
        assert "10 s is unusual for a pneumatic axis (limit 1 s); if the times are in ms" in str(finding)

    def test_other_names_and_further_columns(self, tmp_path: Path) -> None:
        lines = [f"x,{line}" for line in rows()]
        path = write(tmp_path / "data.csv", lines, "note,t,valve,position")
        record = read_record(path, columns=("t", "valve", "position"))
        assert record.experiment.u[1] == 1.0
        assert record.experiment.names.u == "valve"

    def test_without_times_a_sample_time_is_enough(self, tmp_path: Path) -> None:
        path = write(tmp_path / "data.csv", ["1,2", "3,4", "5,6"], "u,y")
        record = read_record(path, sample_time_s=0.5)
        assert record.experiment.sample_time_s == 0.5
        assert record.experiment.y.tolist() == [2.0, 4.0, 6.0]

    def test_a_missing_row_and_an_empty_cell_are_gaps(self, tmp_path: Path) -> None:
        lines = rows()
        lines[50] = f"{50 * TS:.4f},1,"
        del lines[100]
        experiment = read_record(write(tmp_path / "data.csv", lines)).experiment
        assert len(experiment) == 200
        assert np.isnan(experiment.y[[50, 100]]).all()
        assert np.isnan(experiment.u[100]) and not np.isnan(experiment.u[50])
        assert np.isfinite(experiment.y).sum() == 198

    def test_the_input_of_a_missing_row_can_be_stated_to_be_held(self, tmp_path: Path) -> None:
        lines = rows()
        lines[50] = f"{50 * TS:.4f},,0.05"
        del lines[100]
        path = write(tmp_path / "data.csv", lines)
        experiment = read_record(path, input_held_in_gaps=True).experiment
        assert experiment.u[[50, 100]].tolist() == experiment.u[[49, 99]].tolist()
        assert np.isnan(experiment.y[100])

    @pytest.mark.parametrize(
        ("lines", "header", "complaint"),
        [
            ([], "", "the file is empty"),
            (
                ["0,1,2"],
                "time,u,y",
                r"no column time_s; it has time, u, y.*or give --sample-time",
            ),
            (["0;1;2"], "time_s;u;y", r"separated by semicolons, not by commas: 'time_s;u;y'"),
            (["0\t1\t2"], "time_s\tu\ty", r"separated by tabs, not by commas"),
            (["0,1,2"], "time_s,u,yy", r"no column y; it has time_s, u, yy"),
            (["0,1,2", "0.01,x,2"], "time_s,u,y", r"line 3: u is 'x', not a number"),
            (["0,1,2", "0.02,1,2", "0.01,1,2"], "time_s,u,y", r"row 3: the time goes back"),
        ],
    )
    def test_an_unreadable_table_is_refused(
        self, tmp_path: Path, lines: list[str], header: str, complaint: str
    ) -> None:
        with pytest.raises(Exception, match=complaint):
            read_record(write(tmp_path / "data.csv", lines, header))


def test_a_matlab_file_gives_the_same_record(tmp_path: Path) -> None:
    t = np.arange(200) * TS
    savemat(tmp_path / "data.mat", {"time_s": t, "u": np.sin(t), "y": np.cos(t)})
    experiment = read_record(tmp_path / "data.mat").experiment
    np.testing.assert_allclose(experiment.y, np.cos(t))
    assert experiment.sample_time_s == pytest.approx(TS)


def test_a_parquet_file_gives_the_same_record(tmp_path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    t = np.arange(200) * TS
    parquet.write_table(pa.table({"time_s": t, "u": np.sin(t), "y": np.cos(t)}), tmp_path / "data.parquet")
    experiment = read_record(tmp_path / "data.parquet").experiment
    np.testing.assert_allclose(experiment.u, np.sin(t))


@pytest.mark.parametrize(
    ("name", "complaint"),
    [
        ("data.xls", "unknown kind of file; give a .mcap, .csv, .mat or .parquet file"),
        ("data.mat", "not a MATLAB file"),
        ("data.parquet", "not a Parquet file"),
        ("data.mcap", "data.mcap"),
    ],
)
def test_a_file_of_another_kind_is_refused(tmp_path: Path, name: str, complaint: str) -> None:
    (tmp_path / name).write_bytes(b"nonsense that is no such file at all")
    with pytest.raises(DocumentError, match=complaint):
        read_record(tmp_path / name)
