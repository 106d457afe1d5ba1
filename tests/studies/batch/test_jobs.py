"""What a batch fits, and by which keys equal fits are recognised."""

import json
import os
import shutil

import pytest

from godfit.errors import InputError
from godfit.studies.batch.engine import Queue
from godfit.studies.batch.jobs import jobs_of
from tests.support.batch_work import write_frames
from tests.support.paths import DATA_SYNTHETIC


@pytest.fixture
def frames(tmp_path, monkeypatch):
    """Three frames with masks in the working folder."""
    write_frames(tmp_path, 3, 16)
    monkeypatch.chdir(tmp_path)
    return tmp_path


MASKS = {"mask": "masks/{stem}.png", "shader": "dawntime"}


def test_a_pattern_in_natural_order_with_a_mask_each(frames):
    shutil.copy("frames/f_1.png", "frames/f_10.png")
    shutil.copy("masks/f_1.png", "masks/f_10.png")
    jobs = jobs_of(["frames/*.png"], MASKS)
    assert [job.path for job in jobs] == [f"frames/f_{i}.png" for i in (0, 1, 2, 10)]
    assert [job.options["mask"] for job in jobs] == [f"masks/f_{i}.png" for i in (0, 1, 2, 10)]
    # Equal bytes are one fit, whatever their names; the first three differ.
    assert jobs[3].key == jobs[1].key
    assert len({job.key for job in jobs}) == 3
    assert {job.pixels for job in jobs} == {256}
    assert len({job.group for job in jobs}) == 1


def test_keys_depend_on_all_that_is_fitted(frames):
    def key(**options):
        return jobs_of(["frames/f_0.png"], MASKS | options)[0].key

    keys = [key(), key(samples=9), key(fix={"decay": 1.0}), key(mask="masks/f_1.png"), key(seed=1)]
    assert len(set(keys)) == len(keys)
    assert key() == keys[0]
    os.rename("masks", "others")
    assert key(mask="others/{stem}.png") == keys[0]
    shutil.copy("frames/f_1.png", "frames/f_0.png")
    assert key(mask="others/{stem}.png") != keys[0]


def test_the_key_of_a_scene_depends_on_its_meshes(frames):
    (frames / "scene.toml").write_text('[[object]]\nmesh = "a.obj"\n')
    (frames / "a.obj").write_text("v 0 0 0\n")
    before = jobs_of(["frames/f_0.png"], {"scene": "scene.toml"})[0].key
    (frames / "a.obj").write_text("v 0 0 1\n")
    assert jobs_of(["frames/f_0.png"], {"scene": "scene.toml"})[0].key != before


def test_side_files_count_and_files_that_serve_are_no_targets(tmp_path, monkeypatch):
    for stem in ("disc", "bars"):
        for name in (f"{stem}.png", f"{stem}_mask.png", f"{stem}.toml"):
            shutil.copy(DATA_SYNTHETIC / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    jobs = jobs_of(["*.png"], {})
    assert [job.path for job in jobs] == ["bars.png", "disc.png"]
    assert jobs[1].options["mask"] == "disc_mask.png"
    assert jobs_of(["disc.png"], {"samples": 7})[0].options["samples"] == 7
    # One that is named is a target all the same.
    assert len(jobs_of(["*.png", "disc_mask.png"], {})) == 3


def test_folders_as_clips(frames):
    shutil.copytree("frames", "more")
    jobs = jobs_of(["frames/*.png", "more/*.png"], MASKS, clips=True)
    assert [job.path for job in jobs] == ["frames", "more"]
    assert jobs[0].targets == tuple(f"frames/f_{i}.png" for i in range(3))
    assert jobs[0].key == jobs[1].key
    wrong = jobs_of(["frames/*.png"], MASKS | {"lights": 2}, clips=True)[0]
    assert "--lights: expected pictures" in wrong.error


def test_shards_are_a_partition(frames):
    whole = jobs_of(["frames/*.png"], MASKS)
    parts = [jobs_of(["frames/*.png"], MASKS, shard=(i, 2)) for i in (1, 2)]
    assert sorted(parts[0] + parts[1]) == sorted(whole)
    assert list(map(len, parts)) == [2, 1]


def test_what_is_wrong_with_one_frame_is_its_own_error(frames):
    os.remove("masks/f_1.png")
    (frames / "frames" / "f_2.toml").write_text("maks = 1\n")
    jobs = jobs_of(["frames/*.png"], MASKS)
    assert jobs[0].error == ""
    assert "'masks/f_1.png'" in jobs[1].error
    assert "mask" in jobs[2].error


@pytest.mark.parametrize(
    ("patterns", "words"),
    [
        (["frames/*.jpg"], "expected files of this pattern"),
        (["frames"], "got a folder; give 'frames/\\*.png'"),
        (["frames/f_9.png"], "no such file"),
    ],
)
def test_patterns_without_files(frames, patterns, words):
    with pytest.raises(InputError, match=words):
        jobs_of(patterns, MASKS)


def test_one_of_each_group_first_and_the_others_after_it(frames):
    jobs = jobs_of(["frames/*.png"], MASKS)
    jobs = [jobs[0], jobs[1], jobs[2]._replace(group="other")]
    queue = Queue(jobs, hold=True)
    assert [queue.next(), queue.next(), queue.next()] == [jobs[0], jobs[2], None]
    queue.release(jobs[0].group)
    assert [queue.next(), queue.next()] == [jobs[1], None]
    assert list(Queue(jobs, hold=False).ready) == [jobs[0], jobs[2], jobs[1]]


def test_options_are_plain_json(frames):
    for job in jobs_of(["frames/*.png"], MASKS | {"fix": {"decay": None}, "ignore": ("0,0,1,1",)}):
        json.dumps(job.options)
