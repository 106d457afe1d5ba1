"""``godfit batch`` and ``godfit rerun`` with fits that are fits, and what they refuse."""

import csv
import json

import jsonschema
import pytest

import godfit
from godfit.__main__ import main
from godfit.commands.batch import slurm_place
from godfit.report.schema import schema
from tests.support.batch_work import SAMPLES, write_frames

COUNT = 3
SIZE = 96
"""Pixels of a side: those of the picture that tests share, whose programs others compile."""
OPTIONS = (
    "--mask", "masks/{stem}.png", "--shader", "dawntime", "--samples", str(SAMPLES),
    "--arithmetic", "exact",
)  # fmt: skip
BATCH = ("batch", "frames/*.png", *OPTIONS, "-o", "run", "--workers", "1", "-q")


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """The folder of a run of three frames, with a table, a page and the pictures of the fits."""
    folder = tmp_path_factory.mktemp("batch")
    write_frames(folder, COUNT, SIZE)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        files = ("--table", "t.csv", "--report", "--html")
        assert main([*BATCH, *files]) == 0
    return folder


@pytest.fixture(autouse=True)
def there(fitted, monkeypatch):
    monkeypatch.chdir(fitted)


def said(capsys, status, *arguments):
    assert main([str(a) for a in arguments]) == status
    printed = capsys.readouterr()
    return printed.err if status in (1, 2) else printed.out


def test_the_table_has_the_truths(fitted):
    with open("t.csv") as file:
        lines = list(csv.DictReader(file))
    assert [line["path"] for line in lines] == [f"frames/f_{i}.png" for i in range(COUNT)]
    for line in lines:
        for name, truth in (("decay", 0.975), ("density", 0.85), ("exposure*weight", 0.03)):
            error = float(line[f"{name}_stderr"])
            assert abs(float(line[name]) - truth) < 5 * error + 1e-5, (line["path"], name)
    assert (fitted / "run" / "report.html").stat().st_size > 10_000


def test_each_record_is_that_of_a_fit_alone(fitted):
    with godfit.studies.batch.journal.Journal("run/journal.sqlite", writes=False) as journal:
        records = {row.path: row.outcome.record for row in journal.rows()}
    record = records["frames/f_1.png"]
    jsonschema.validate(record, schema("fit"))
    assert record["inputs"]["mask"]["path"] == "masks/f_1.png"
    (folder,) = fitted.glob("run/frames/f_1-*")
    assert sorted(p.name for p in folder.iterdir()) == [
        "fit.json", "fit.png", "render.png", "report.html",
    ]  # fmt: skip
    assert json.loads((folder / "fit.json").read_text()) == record
    result = godfit.fit(
        "frames/f_1.png", mask="masks/f_1.png", shader="dawntime", samples=SAMPLES,
        arithmetic="exact",
    )  # fmt: skip
    for name, estimate in result.params.items():
        found = record["params"][name]
        # The number of threads changes last digits.
        assert abs(found["value"] - estimate.value) < 0.2 * (found["stderr"] or 1e-6)


def test_nothing_is_fitted_twice_and_what_changed_is_fitted_again(fitted, monkeypatch, capsys):
    from godfit.studies.batch import engine

    monkeypatch.setattr(engine, "fit_one", None)
    assert "3 frames: 3 converged" in said(capsys, 0, *BATCH)
    record = json.loads(said(capsys, 0, *BATCH, "--json"))
    assert record["converged"] == record["frames"] == COUNT
    with pytest.raises(TypeError):
        main([*BATCH, "--fix", "decay=0.97"])
    # The frames are those of the new options now; the same command as before has its fits.
    assert said(capsys, 0, *BATCH)


def test_a_rerun_changes_nothing_and_names_what_did(fitted, capsys):
    out = said(capsys, 0, "rerun", "run", "--workers", "1", "-q")
    assert "0 of 3 fits changed by more than 0.1" in out
    (file,) = fitted.glob("run/frames/f_2-*/fit.json")
    record = json.loads(file.read_text())
    record["params"]["decay"]["value"] += 3 * record["params"]["decay"]["stderr"]
    record["inputs"]["mask"]["sha256"] = "0" * 64
    (fitted / "old.json").write_text(json.dumps(record))
    assert main(["rerun", "old.json"]) == 3
    printed = capsys.readouterr()
    assert "mask: 'masks/f_2.png' has changed since" in printed.err
    assert "the largest change is 3.0" in printed.out
    found = json.loads(said(capsys, 3, "rerun", "old.json", "--json", "-q"))
    assert found[0]["changes"]["decay"]["errors"] == pytest.approx(3, abs=0.1)
    assert found[0]["changes"]["density"]["errors"] < 0.1


def test_a_rerun_of_a_single_fit_takes_its_command(fitted, capsys, monkeypatch):
    command = ["fit", "frames/f_0.png", *OPTIONS, "--light", "0.5,0.5", "-o", "single", "-q"]
    monkeypatch.setattr("sys.argv", ["godfit", *[a.replace("{stem}", "f_0") for a in command]])
    import sys

    assert main(sys.argv[1:]) == 0
    capsys.readouterr()
    assert "as before" in said(capsys, 0, "rerun", "single", "-q")
    record = json.loads((fitted / "single" / "fit.json").read_text())
    (fitted / "lost.json").write_text(json.dumps(record | {"command": ""}))
    assert "does not say how it was made" in said(capsys, 1, "rerun", "lost.json")
    record["inputs"]["target"]["path"] = "gone.png"
    (fitted / "gone.json").write_text(json.dumps(record))
    assert "target: expected 'gone.png'" in said(capsys, 1, "rerun", "gone.json")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "expected TARGETs, --table or --report"),
        (("frames/*.png", "--shard", "4/3"), "--shard: expected I/N with I from 1 to N"),
        (("frames/*.png", "--shard", "slurm"), "expected SLURM_ARRAY_TASK_ID"),
        (("run", "--merge", "--workers", "2"), "--merge: expected no --workers"),
        (("masks", "--merge"), "--merge: expected the folder of a run"),
    ],
)
def test_bad_usage(capsys, monkeypatch, arguments, words):
    monkeypatch.delenv("SLURM_ARRAY_TASK_ID", raising=False)
    assert words in said(capsys, 2, "batch", "-o", "other", *arguments)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("nothing*.png",), "expected files of this pattern"),
        (("frames/*.png", "--table", "t.xls"), ".csv or .parquet"),
        (("frames/*.png", "--mask", "a", "--scene", "b"), "expected a mask or a scene"),
    ],
)
def test_bad_input(capsys, arguments, words):
    assert words in said(capsys, 1, "batch", "-o", "other", *arguments)


def test_a_frame_without_its_mask_fails_alone(fitted, capsys):
    arguments = ["batch", "frames/f_[01].png", "--mask", "masks/{stem}x.png", "-o", "lacking"]
    err = said(capsys, 1, *arguments, "--workers", "1")
    assert err.count("no such file") + err.count("cannot be read") == 2


def test_shards_of_three_merged_equal_the_whole(fitted, capsys):
    for i in (1, 2, 3):
        assert main([*BATCH[:-5], "-o", "parts", "--workers", "1", "-q", "--shard", f"{i}/3"]) == 0
    assert main(["batch", "parts", "--merge", "-o", "parts", "--table", "m.csv", "-q"]) == 0
    assert (fitted / "m.csv").read_bytes() == (fitted / "t.csv").read_bytes()


def test_the_place_in_slurm_s_array():
    names = ("ID", "COUNT", "MIN", "MAX")
    for numbers, place in (
        (("0", "4", "0", "3"), (1, 4)),
        (("7", "4", "1", "7"), (4, 4)),
        (("2", "2"), (2, 2)),
    ):
        environment = dict(zip((f"SLURM_ARRAY_TASK_{n}" for n in names), numbers, strict=False))
        assert slurm_place(environment) == place
