"""The page of a batch: what it holds, and that it is sorted and filtered in a browser."""

import io
import json
import re
import shutil

import numpy as np
import pytest
from PIL import Image

from godfit.report.batch_page import PageRow, page
from godfit.report.outliers import OUTLYING, outlying
from godfit.studies.batch.worker import _thumbnail

COUNT = 300
ODD = 123
BROWSERS = ("chromium-headless-shell", "chromium", "google-chrome", "chrome")


def rows():
    """Frames whose decay drifts, one of them away from those around it, and one that failed."""
    rng = np.random.default_rng(0)
    made = []
    for i in range(COUNT):
        decay = 0.9 + 1e-4 * i + 1e-5 * rng.normal() + (0.01 if i == ODD else 0)
        numbers = {"decay": {"value": decay, "stderr": 1e-5}, "a*b": {"value": 0.5, "stderr": None}}
        made.append(PageRow(f"f_{i}.png", "converged", numbers, "", _thumbnail(np.ones((9, 9)))))
    made.append(PageRow("f_</script>.png", "failed", {}, "expected an image"))
    return made


def data(written: bytes):
    found = re.search(rb'<script type="application/json" id="data">(.*?)</script>', written, re.S)
    return json.loads(found[1])


def test_a_frame_that_differs_from_those_around_it_is_named():
    found = data(page(rows(), "run"))
    assert [(i, name) for i, name, _ in found["outliers"]] == [(ODD, "decay")]
    assert found["summary"] == "301 frames: 300 converged, 1 failed"
    assert found["path"][-1] == "f_</script>.png"
    assert found["numbers"]["decay"]["value"][-1] is None
    # Equal thumbnails are one, and a frame without one has none.
    assert set(found["thumb"]) == {0, -1}


def test_normal_scatter_has_no_outliers():
    rng = np.random.default_rng(1)
    values = np.sin(np.arange(2000) / 200) + 0.01 * rng.normal(size=2000)
    for errors in (np.full(2000, 0.01), np.full(2000, np.nan), np.zeros(2000)):
        away = outlying(values, errors)
        assert away.max() < OUTLYING
    values[700] += 0.2
    assert np.flatnonzero(outlying(values, np.full(2000, 0.01)) > OUTLYING).tolist() == [700]
    assert not outlying(np.full(50, np.nan), np.zeros(50)).any()
    assert not outlying(np.ones(50), np.zeros(50)).any()


def test_thumbnails_are_small_pictures():
    for shape in ((300, 200), (300, 200, 1), (40, 400, 3)):
        made = _thumbnail(np.full(shape, 0.5, np.float32))
        with Image.open(io.BytesIO(made)) as image:
            assert image.height <= 32
            assert image.width <= 64
            assert abs(np.asarray(image).mean() - 128) < 4


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    """The page in a browser."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        pytest.skip("no Chromium is installed")
    file = tmp_path_factory.mktemp("page") / "report.html"
    file.write_bytes(page(rows(), "run"))
    with playwright.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=program, args=["--no-sandbox"])
        opened = browser.new_page()
        errors = []
        opened.on("pageerror", lambda error: errors.append(str(error)))
        opened.goto(file.as_uri())
        opened.wait_for_selector("body[data-ready]")
        yield opened
        browser.close()
    assert errors == []


def first_frames(opened):
    return [cells.split("\t")[1] for cells in opened.evaluate(
        "[...document.querySelectorAll('#rows .row')].map(r => [...r.children]"
        ".map(c => c.textContent).join('\\t'))"
    )]  # fmt: skip


def test_the_page_is_sorted_and_filtered(opened):
    assert first_frames(opened)[0] == "f_0.png"
    head = opened.locator("#head .cell")
    for click, first in ((1, "f_0.png"), (2, f"f_{COUNT - 1}.png")):
        head.get_by_text("decay").click()
        assert first_frames(opened)[0] == first, click
    opened.fill("#filter", "decay < 0.9005")
    assert opened.inner_text("#count") in {f"{n} of 301 frames" for n in (4, 5, 6)}
    opened.fill("#filter", "f_29")
    assert opened.inner_text("#count") == "11 of 301 frames"
    opened.fill("#filter", "")
    opened.select_option("#status", "failed")
    assert first_frames(opened) == ["f_</script>.png"]
    opened.select_option("#status", "")
    opened.check("#odd")
    assert first_frames(opened) == [f"f_{ODD}.png"]
    opened.uncheck("#odd")
    opened.click("#outliers a")
    assert opened.locator(".chosen").count() == 1
    # Only the rows that are in sight are in the page.
    assert opened.locator("#rows .row").count() < 100
