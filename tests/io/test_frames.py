"""The frames of a clip: files in their order, a video's, and what cannot be read."""

import sys

import imageio.v3 as iio
import numpy as np
import pytest

from godfit.commands.study import common_name
from godfit.errors import InputError
from godfit.io.frames import frames, is_video
from godfit.io.image import write_image


@pytest.fixture
def files(tmp_path):
    names = [str(tmp_path / f"shot_{i:02}.png") for i in range(5)]
    for i, name in enumerate(names):
        write_image(name, np.full((8, 12), i / 10, np.float32))
    return names


@pytest.mark.parametrize(("every", "which"), [(1, [0, 1, 2, 3, 4]), (2, [0, 2, 4])])
def test_files_come_in_their_order(files, every, which):
    found = list(frames(files, every))
    assert [f.path for f in found] == [files[i] for i in which]
    assert [f.values[0, 0] for f in found] == pytest.approx([i / 10 for i in which], abs=1 / 500)


def test_a_missing_file_is_found_missing_before_the_first_is_read(files):
    with pytest.raises(InputError, match=r"nothing\.png"):
        frames([*files, "nothing.png"], 1)


def test_frames_of_a_video(tmp_path):
    """Smooth pictures survive the codec to a level or two."""
    x = np.linspace(0, 1, 64)
    shots = [np.broadcast_to(200 * x + 5 * i, (48, 64)).astype(np.uint8) for i in range(6)]
    path = str(tmp_path / "clip.mp4")
    rgb = np.stack([np.stack([s] * 3, -1) for s in shots])
    iio.imwrite(path, rgb, plugin="pyav", codec="libx264", fps=10)
    assert is_video(path)
    found = list(frames([path], 2))
    assert [f.path.rsplit("#")[-1] for f in found] == ["1", "3", "5"]
    for image, shot in zip(found, shots[::2], strict=True):
        assert image.quantum == 1 / 255
        assert np.abs(255 * image.values[..., 1] - shot).mean() < 3


def test_a_video_that_is_none(tmp_path):
    path = tmp_path / "broken.mp4"
    path.write_bytes(b"not a video")
    with pytest.raises(InputError, match=r"broken\.mp4.*expected a video"):
        list(frames([str(path)], 1))


def test_without_the_package_a_video_says_what_it_needs(tmp_path, monkeypatch):
    path = tmp_path / "clip.mp4"
    path.write_bytes(b"")
    for name in [n for n in sys.modules if n.split(".")[0] == "av" or n.endswith("plugins.pyav")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(InputError, match=r"godfit\[video\]"):
        list(frames([str(path)], 1))


def test_the_folder_is_named_by_what_the_frames_have_in_common():
    assert common_name(("a/shot_01.png", "a/shot_02.png")) == "a/shot"
    assert common_name(("a/01.png", "a/02.png")) == "a/clip"
    assert common_name(("clip.mp4",)) == "clip.mp4"
