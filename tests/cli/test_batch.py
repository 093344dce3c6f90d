"""One command on many files: a table with a line for each, failures told, and a run that goes on where it ended."""

from __future__ import annotations

import csv

import pytest

import wafer_viewer as wv
from tests.support.datasets.samples import make_surface
from wafer_viewer.cli.app import main
from wafer_viewer.store.formats.conversion import export

REGION = ("--region", "105", "38", "115", "46")


@pytest.fixture
def parts(tmp_path):
    """Three surfaces, part_2 and part_10 good and part_3 damaged."""
    folder = tmp_path / "parts"
    folder.mkdir()
    for n in (2, 10):
        export(make_surface(), folder / f"part_{n}.x3p")
    (folder / "part_3.x3p").write_bytes(b"nothing")
    return folder


def lines(table):
    with table.open(newline="") as file:
        return list(csv.DictReader(file))


def test_measurements_fill_a_table_in_natural_order_and_a_damaged_file_stops_nothing(parts, tmp_path, capsys):
    table = tmp_path / "texture.csv"
    assert main(["batch", "measure texture", f"{parts}/*.x3p", "--table", str(table), "--", *REGION]) == 1
    found = lines(table)
    assert [line["source"].rsplit("_")[-1] for line in found] == ["2.x3p", "3.x3p", "10.x3p"]
    assert [line["status"] for line in found] == ["done", "failed", "done"]
    assert "part_3.x3p" in found[1]["message"]
    assert float(found[0]["sa, um"]) == float(found[2]["sa, um"]) > 0
    assert "U of sa, um" in found[0]
    assert "2 done, 1 failed" in capsys.readouterr().out


def test_a_batch_goes_on_where_it_ended(parts, tmp_path, capsys):
    (parts / "part_3.x3p").unlink()
    out, table = tmp_path / "out", tmp_path / "all.csv"
    words = ["batch", "convert", f"{parts}/*.x3p", "--to", str(out), "--ending", ".npz", "--table", str(table)]
    assert main(words) == 0
    assert sorted(path.name for path in out.iterdir()) == ["part_10.npz", "part_2.npz"]
    capsys.readouterr()
    assert main(words) == 0
    assert "0 done, 0 failed, 2 were done before" in capsys.readouterr().out

    (out / "part_2.npz").unlink()
    export(make_surface(), parts / "part_10.x3p")
    export(make_surface(), parts / "part_11.x3p")
    assert main(words) == 0
    assert "3 done, 0 failed" in capsys.readouterr().out
    assert main([*words, "--", "--every", "2"]) == 0
    assert "3 done, 0 failed" in capsys.readouterr().out


def test_sources_of_one_name_are_told_apart_by_their_folders(tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        export(make_surface(), tmp_path / folder / "part.x3p")
    out = tmp_path / "out"
    assert main(["batch", "convert", f"{tmp_path}/*/part.x3p", "--to", str(out), "--ending", ".npz"]) == 0
    assert sorted(path.name for path in out.iterdir()) == ["a_part.npz", "b_part.npz"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("convert", "*.none", "--to", "out", "--ending", ".npz"), "Nothing is named like"),
        (("convert", "a.x3p"), "--to FOLDER --ending"),
        (("convert", "a.x3p", "--to", "out", "--ending", ".npz", "--table", "notes.csv"), "no table of a batch"),
    ],
)
def test_what_cannot_begin_is_refused(tmp_path, monkeypatch, capsys, words, says):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "notes.csv").write_text("a,b\n1,2\n")
    assert main(["batch", *words]) == 2
    assert says in capsys.readouterr().err


def test_python_does_any_work_on_many_sources_and_stops_between_them(parts, tmp_path):
    (parts / "part_3.x3p").unlink()
    seen = []

    def work(path):
        seen.append(path.name)
        return {"points": wv.read_surface(path).z_um.size}

    report = wv.run_batch(
        [f"{parts}/*.x3p", parts / "gone.x3p"], work, tmp_path / "a.csv", should_stop=lambda: len(seen) > 2
    )
    assert (report.done, report.failed, report.stopped) == (2, 1, False)
    assert "does not exist" in report.rows[2]["message"]
    stopped = wv.run_batch([f"{parts}/*.x3p"], work, again=True, should_stop=lambda: len(seen) > 3)
    assert (stopped.done, stopped.stopped) == (1, True)
    assert int(lines(tmp_path / "a.csv")[0]["points"]) == report.rows[0]["points"]


def test_reports_are_written_for_many_datasets(tmp_path, parts):
    (parts / "part_3.x3p").unlink()
    data = tmp_path / "data"
    assert main(["batch", "import", f"{parts}/*.x3p", "--to", str(data)]) == 0
    assert main(["batch", "report", f"{data}/*.wafer", "--to", str(tmp_path / "reports")]) == 0
    assert sorted(path.name for path in (tmp_path / "reports").iterdir()) == ["part_10.html", "part_2.html"]
