"""A journal survives what happens to it, and the table is what it holds."""

import csv
import json
import sqlite3

import jsonschema
import pyarrow.csv
import pyarrow.parquet
import pytest

from godfit.errors import InputError
from godfit.report.schema import column_types, schema
from godfit.studies.batch.journal import Journal, on_local_disk
from godfit.studies.batch.table import columns_of, lines_of, write_table
from godfit.studies.batch.worker import CRASHED, FAILED, Outcome
from tests.support.batch_work import made_up


def fitted(name):
    record = made_up(name.encode())
    return Outcome("converged" if record["converged"] else "not converged", record, "", 1.0, "a")


@pytest.fixture
def journal(tmp_path):
    with Journal(tmp_path / "journal.sqlite") as journal:
        journal.plan([("f_10.png", "a"), ("f_2.png", "b"), ("x.png", "a"), ("y.png", "c")])
        journal.add("a", fitted("a"))
        journal.add("b", Outcome(FAILED, error="'f_2.png': a; b, \"c\""))
        yield journal


def test_rows_in_natural_order_and_equal_keys_share_a_fit(journal):
    rows = list(journal.rows())
    assert [row.path for row in rows] == ["f_2.png", "f_10.png", "x.png", "y.png"]
    assert rows[1].outcome == rows[2].outcome == fitted("a")
    assert rows[3].outcome is None
    assert journal.failed_paths() == {"f_2.png"}
    assert sum(journal.counts().values()) == 4
    # A file that has changed has another key, and is to be fitted again.
    journal.plan([("f_2.png", "d")])
    assert journal.counts()["to do"] == 2


def test_what_was_committed_is_there_for_a_reader_and_the_next_process(journal):
    with Journal(journal.path, writes=False) as reader:
        assert reader.done() == journal.done()
    journal.close()
    with Journal(journal.path) as again:
        assert len(again.done()) == 2


def test_a_second_writer_is_refused(journal):
    with pytest.raises(InputError, match="nothing else works on, got one of process"):
        Journal(journal.path)
    journal.close()
    Journal(journal.path).close()


def test_a_full_disk_is_one_line_and_loses_nothing(journal):
    pages = journal.connection.execute("pragma page_count").fetchone()[0]
    journal.connection.execute(f"pragma max_page_count = {pages}")
    big = Outcome(FAILED, error="x" * 100_000)
    with pytest.raises(InputError, match="No space left on device; free some space"):
        journal.add("e", big)
    assert len(journal.done()) == 2
    journal.connection.execute(f"pragma max_page_count = {2 * pages + 100}")
    journal.add("e", big)
    assert len(journal.done()) == 3


def test_files_that_are_no_journal(tmp_path):
    (tmp_path / "a").write_bytes(b"no database" * 100)
    with pytest.raises(InputError, match="expected the journal of a run, got"):
        Journal(tmp_path / "a", writes=False)
    with pytest.raises(InputError, match="no such file"):
        Journal(tmp_path / "b", writes=False)
    with sqlite3.connect(tmp_path / "c") as newer:
        newer.execute("pragma user_version = 99")
    with pytest.raises(InputError, match="made by a newer godfit"):
        Journal(tmp_path / "c")


def test_shards_merged_equal_the_whole(tmp_path):
    frames = [(f"f_{i}.png", f"key {i}") for i in range(7)]
    with Journal(":memory:") as whole, Journal(tmp_path / "merged") as merged:
        for part in (whole, *(Journal(tmp_path / str(i)) for i in range(3))):
            mine = frames
            if part is not whole:
                number = int(part.path[-1])
                mine = frames[number::3]
                part.plan(mine, (number + 1, 3))
            part.plan(mine)
            for path, key in mine:
                part.add(key, fitted(path))
            if part is not whole:
                merged.merge(part)
                part.close()
                assert merged.missing_shards() == [2, 3][number:]
        for name, journal in (("a", whole), ("b", merged)):
            write_table(f"{tmp_path}/{name}.csv", journal.rows())
        assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_a_merged_failure_replaces_no_fit(journal, tmp_path):
    with Journal(tmp_path / "other") as other:
        other.add("a", Outcome(CRASHED, error="ended"))
        other.add("b", fitted("b"))
        journal.merge(other)
    assert journal.outcome("a") == fitted("a")
    assert journal.outcome("b") == fitted("b")


def test_tables_in_both_formats_are_equal(journal, tmp_path):
    assert write_table(f"{tmp_path}/t.csv", journal.rows()) == 4
    write_table(f"{tmp_path}/t.parquet", journal.rows())
    parquet = pyarrow.parquet.read_table(tmp_path / "t.parquet")
    options = pyarrow.csv.ConvertOptions(column_types=parquet.schema)
    assert pyarrow.csv.read_csv(tmp_path / "t.csv", convert_options=options).equals(parquet)
    assert parquet["exposure"].to_pylist()[1] == fitted("a").record["params"]["exposure"]["value"]
    assert parquet["error"].to_pylist()[0] == "'f_2.png': a; b, \"c\""
    assert parquet["status"].to_pylist()[3] == "to do"
    with open(tmp_path / "t.csv") as file:
        assert next(row["path"] for row in csv.DictReader(file)) == "f_2.png"


def test_lines_and_columns_are_as_the_schema_has_them(journal):
    lines = [line for row in journal.rows() for line in lines_of(row)]
    for line in lines:
        jsonschema.validate(line, schema("table"))
    types = column_types(columns_of(lines))
    assert types["samples"] == "integer"
    assert types["exposure*weight_stderr"] == types["exposure"] == "number"
    assert types["decay_at_bound"] == "boolean"
    broken = lines[1] | {"exposure": "much"}
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(broken, schema("table"))


def test_a_clip_has_a_line_for_each_frame(journal):
    record = fitted("a").record
    light = {"value": 0.25, "stderr": 0.01}
    record["frames"] = [
        {"path": f"c#{i}", "light_x": light, "light_y": light, "params": {}, "used": i == 1,
         "message": "" if i == 1 else "left out"}
        for i in (1, 2)
    ]  # fmt: skip
    journal.plan([("c.mp4", "clip")])
    journal.add("clip", Outcome("converged", record))
    lines = [line for row in journal.rows() if row.path == "c.mp4" for line in lines_of(row)]
    assert [line["frame"] for line in lines] == ["c#1", "c#2"]
    assert [line["message"] for line in lines] == [record["message"], "left out"]
    assert {line["light_x"] for line in lines} == {0.25}


def test_made_up_records_are_valid():
    jsonschema.validate(json.loads(json.dumps(made_up(b"x"))), schema("fit"))


@pytest.mark.parametrize("schema_name", ["fit", "table"])
def test_the_schemas_are_schemas(schema_name):
    jsonschema.Draft202012Validator.check_schema(schema(schema_name))


def test_disks_whose_kind_is_not_known_have_no_write_ahead_log(tmp_path, monkeypatch):
    mounts = "server:/x {} nfs4 rw 0 0\n/dev/a / ext4 rw 0 0\n"
    monkeypatch.setattr("pathlib.Path.read_text", lambda path, **_: mounts.format(tmp_path))
    assert not on_local_disk(f"{tmp_path}/journal.sqlite")
    assert on_local_disk("/other/journal.sqlite")
