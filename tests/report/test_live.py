"""Pages in a browser: the shader there against the program's sum, and what a user does to it."""

import dataclasses
import tomllib

import equinox as eqx
import numpy as np
import pytest

from godfit.errors import InputError
from godfit.inference.estimates import Estimate
from godfit.inference.observation import Picture
from godfit.models.disc_light import DiscLight
from godfit.models.mitchell import Mitchell
from godfit.models.tinted import Tinted
from godfit.report.live.data import Shown, clip_frame, packed, page_data
from godfit.report.live.glsl import fragment_shader, is_drawn
from godfit.report.live.page import Page, Section, framed
from godfit.report.live.widget import viewer_widget
from godfit.report.pages import clip_page, compare_page, fit_page, select_page
from godfit.scattering.conventions import CONVENTIONS, convention
from godfit.scattering.engines import ENGINES
from godfit.studies.export import for_engine
from tests.support.browser import DRAWN, READY, launching, levels, opened, wait_for
from tests.support.shown_results import clip_result, comparison, fit_result, selection

SIZE = (24, 40)
LIGHTS = ((0.62, 0.55), (-0.2, 0.8))
TOLERANCE = 0.1
"""Levels by which a page may differ from the program."""


def mask_of(size, seed=0):
    """Bars and discs of several levels, and noise: edges in every direction."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: size[0], : size[1]] / max(size)
    bars = ((8 * x).astype(int) % 2 == 0) & (np.hypot(x - 0.6, y - 0.3) > 0.12)
    return (np.round(200 * bars + 55 * rng.random(size)) / 255).astype(np.float32)


def shown_of(shader, half=False, background=False, lights=1):
    """A model of a convention on a small picture, in colour where it has a background."""
    low = (SIZE[0] // 2, SIZE[1] // 2) if half else SIZE
    mask = mask_of(low)
    if half:
        # As a mask that was scaled down: values between the levels.
        mask = 0.5 * (mask + mask_of(low, 1))
    exposure = 0.9 if convention(shader).box else 0.09
    model = Mitchell(exposure, 0.93, 0.83, 0.5, LIGHTS[:lights], shader, 20)
    rng = np.random.default_rng(2)
    back = rng.random((*SIZE, 3)).astype(np.float32) * 0.3 if background else None
    channels, transfer = (3, "srgb") if background else (1, "none")
    target = np.full((*SIZE, channels), 100, np.float32)
    picture = Picture(target, 0.5, np.ones(SIZE, bool), mask, back, transfer)
    params = {name: Estimate(float(v), 1e-3) for name, v in model.values().items()}
    return Shown(model, picture, params, picture.rendered(model), command="godfit fit x.png")


def bare_shown():
    """A bare picture in colour: a disc on a veil, on a background of its own."""
    shading = Mitchell(0.09, 0.93, 0.83, 0.5, LIGHTS[:1], "dawntime", 20)
    background = [[0.1, 0.15, 0.2], [0.05, -0.02, 0.03], [0.02, 0.01, -0.04]]
    model = DiscLight(shading, (0.2, 0.02, 0.1), background, (1.2, 0.7))
    target = np.full((*SIZE, 3), 100, np.float32)
    open_ = (mask_of(SIZE) > 0.5).astype(np.float32)
    picture = Picture(target, 0.5, np.ones(SIZE, bool), open_, None, "none", 0.01)
    params = {name: Estimate(float(v), 1e-3) for name, v in model.values().items()}
    return Shown(model, picture, params, picture.rendered(model))


def tinted_shown():
    """A coloured light over a grey mask."""
    one = shown_of("dawntime")
    model = Tinted(one.model, (1.5, 0.5))
    picture = dataclasses.replace(one.picture, levels=np.full((*SIZE, 3), 100, np.float32))
    params = {name: Estimate(float(v), 1e-3) for name, v in model.values().items()}
    return Shown(model, picture, params, picture.rendered(model))


def page_of(*shown, side=1024):
    sections = [Section(str(i), viewer=page_data(one, side)) for i, one in enumerate(shown)]
    return Page("pages", "good", True, tuple(sections)).html()


def stored(folder, html):
    path = folder / "page.html"
    path.write_text(html, encoding="utf-8")
    return path.as_uri()


@pytest.fixture(scope="module")
def launch():
    with launching() as found:
        yield found


@pytest.fixture(scope="module")
def browser(launch):
    return launch()


NAMES = [name for name, shader in CONVENTIONS.items() if is_drawn(shader)]


# A page keeps 16 contexts.
@pytest.mark.parametrize("names", [NAMES[::2], NAMES[1::2]], ids=["even", "odd"])
def test_every_convention_draws_the_programs_picture(names, browser, tmp_path):
    shown = [shown_of(name) for name in names]
    with opened(browser, stored(tmp_path, page_of(*shown))) as page:
        for i, one in enumerate(shown):
            off = np.abs(levels(page, i) - one.levels).max()
            assert one.levels.std() > 2, one.model.shader
            assert off < TOLERANCE, (one.model.shader, off)


def test_half_size_passes_backgrounds_and_lights(browser, tmp_path):
    shown = [
        shown_of("dawntime", half=True),
        shown_of("three", half=True, lights=2),
        shown_of("pmndrs", background=True, lights=2),
        shown_of("babylon", half=True, background=True),
    ]
    with opened(browser, stored(tmp_path, page_of(*shown))) as page:
        for i, one in enumerate(shown):
            off = np.abs(levels(page, i) - one.levels).max()
            assert off < TOLERANCE, (one.model.shader, off)


def test_bare_pictures_and_coloured_lights(browser, tmp_path, single_precision):
    shown = [bare_shown(), tinted_shown()]
    with opened(browser, stored(tmp_path, page_of(*shown))) as page:
        for i, one in enumerate(shown):
            off = np.abs(levels(page, i) - one.levels).max()
            assert np.ptp(one.levels[..., 0] - one.levels[..., 2]) > 5
            assert off < TOLERANCE, (i, off)


def test_a_large_picture_is_drawn_at_every_other_pixel(browser, tmp_path):
    one = shown_of("vesper")
    with opened(browser, stored(tmp_path, page_of(one, side=20))) as page:
        drawn = levels(page)
    assert drawn.shape == (12, 20, 3)
    assert np.abs(drawn - one.levels[::2, ::2]).max() < TOLERANCE


def test_a_slider_and_a_dragged_light_change_the_picture_as_the_model_says(browser, tmp_path):
    one = shown_of("dawntime")
    with opened(browser, stored(tmp_path, page_of(one))) as page:
        levels(page)
        page.locator("input[name=density]").evaluate(
            "(e) => { e.value = .7; e.dispatchEvent(new Event('input')); }"
        )
        denser = eqx.tree_at(lambda m: m.density, one.model, np.float32(0.7))
        assert np.abs(levels(page) - one.picture.rendered(denser)).max() < TOLERANCE
        box = page.locator(".stage").bounding_box()
        page.locator(".light").hover()
        page.mouse.down()
        page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 0.75 * box["height"], steps=2)
        page.mouse.up()
        values = page.evaluate("document.querySelector('.viewer').viewer.state.values")
        u, v = values["light_x"], values["light_y"]
        assert (u, v) == pytest.approx((0.25, 0.25), abs=0.01)
        moved = eqx.tree_at(lambda m: m.light, denser, np.float32([[u, v]]))
        expected = one.picture.rendered(moved)
        assert np.abs(levels(page) - expected).max() < TOLERANCE
        stats = page.evaluate("document.querySelector('.viewer').viewer.stats")
        off = expected - one.picture.levels
        assert stats["worst"] == pytest.approx(np.abs(off).max(), abs=TOLERANCE)
        assert stats["rms"] == pytest.approx(np.sqrt((off**2).mean()), abs=TOLERANCE)
        # The state is in the address, and an address restores it.
        assert "density=0.7" in page.url
        address, before = page.url, levels(page)
    with opened(browser, address) as page:
        np.testing.assert_allclose(levels(page), before, atol=1e-3)


def copied(page, shader):
    """The text that the button copies once the page has drawn another shader."""
    page.select_option("select[name=convention]", shader)
    levels(page)
    page.get_by_role("button", name="copy").click()
    return page.locator("textarea").input_value()


def test_copied_text_is_what_export_prints_with_the_numbers_on_the_page(browser, tmp_path):
    one = shown_of("dawntime", lights=2)
    values = {name: e.value for name, e in one.params.items()} | {"density": 0.7}
    with opened(browser, stored(tmp_path, page_of(one))) as page:
        page.locator("input[name=density]").evaluate(
            "(e) => { e.value = .7; e.dispatchEvent(new Event('input')); }"
        )
        for name in ("vesper", "three", "pmndrs", "moonshine", "mean", "sun-shafts", "mitchell"):
            numbers = [values[n] for n in ("exposure", "decay", "density", "weight")]
            lights = [(values[f"{n}_x"], values[f"{n}_y"]) for n in ("light", "light2")]
            model = Mitchell(*numbers, lights, name, 20)
            engine = next(e for e in ENGINES.values() if e.convention == name)
            comments, *code = copied(page, name).rpartition("40x24 pixels\n")
            assert "".join(code[1:]) == for_engine(model, engine, None).code, name
            assert "godfit fit x.png" in comments
        page.select_option("select[name=convention]", "three")
        levels(page)
        assert page.locator("input[name=decay]").is_disabled()


def test_copied_text_of_a_users_own_shader_is_the_settings_of_a_fit(browser, tmp_path):
    own = dataclasses.replace(CONVENTIONS["dawntime"], name="mine.toml", gain=0.7)
    one = shown_of(convention(own).key)
    with opened(browser, stored(tmp_path, page_of(one))) as page:
        text = copied(page, one.model.shader)
    found = tomllib.loads(text)
    assert text.startswith("# godfit fit x.png\n")
    assert (found.pop("shader"), found.pop("samples")) == (one.model.shader, 20)
    assert found == pytest.approx({name: e.value for name, e in one.params.items()}, rel=1e-6)


def test_without_webgl_there_are_pictures_and_the_reason(launch, tmp_path):
    one = shown_of("dawntime")
    blind = launch("--disable-3d-apis", "--no-sandbox")
    with opened(blind, stored(tmp_path, page_of(one))) as page:
        assert "No live shader: this browser has no WebGL2" in page.locator(".why").inner_text()
        drawn = page.evaluate(
            "() => { const c = document.querySelector('.picture');"
            " return Array.from(c.getContext('2d').getImageData(0, 0, c.width, c.height).data); }"
        )
    drawn = np.array(drawn).reshape(*SIZE, 4)[..., 0]
    assert np.abs(drawn - one.levels[..., 0]).max() <= 1.0


def test_pages_of_every_kind_open(browser, tmp_path):
    shots = [shown_of("dawntime"), shown_of("dawntime", half=True)]
    shots = tuple(clip_frame(f"{i}.png", shot) for i, shot in enumerate(shots))
    ladder = selection(SIZE)
    row = ladder.rows[ladder.chosen]
    rung = dataclasses.replace(
        row.rung, model=shown_of("dawntime").model, free=np.ones(6, bool), held=np.full(6, np.nan)
    )
    rows = list(ladder.rows)
    rows[ladder.chosen] = dataclasses.replace(row, rung=rung)
    ladder = dataclasses.replace(ladder, rows=tuple(rows))
    pages = {
        "fit": fit_page(fit_result(SIZE, wordy=True)),
        "compare": compare_page(comparison(SIZE)),
        "select": select_page(ladder),
        "clip": clip_page(dataclasses.replace(clip_result(SIZE), pages=shots)),
    }
    for kind, found in pages.items():
        with opened(browser, stored(tmp_path, found.html())) as page:
            assert page.locator("table").count() > 0, kind
            assert page.locator(".viewer .picture").count() == page.locator(".viewer").count() > 0
            if kind == "clip":
                first = levels(page)
                page.locator("input[name=frame]").evaluate(
                    "(e) => { e.value = 1; e.dispatchEvent(new Event('input')); }"
                )
                assert np.abs(levels(page) - first).max() > 1


def test_a_page_in_a_frame_starts_at_the_first_touch(browser, tmp_path):
    inner = Page(
        "inner", "good", True, (Section("", viewer=page_data(shown_of("dawntime"), 512, False)),)
    )
    outer = (
        f"<html data-ready='yes'><head><link rel='icon' href='data:,'></head>{framed(inner.html())}"
    )
    with opened(browser, stored(tmp_path, outer)) as page:
        frame = page.frames[1]
        wait_for(frame, READY)
        assert frame.evaluate("document.querySelector('.viewer').viewer.engine()") is None
        page.locator("iframe").hover()
        wait_for(frame, DRAWN, 0)


def test_the_widget_and_the_page_share_their_values(browser, tmp_path):
    pytest.importorskip("anywidget")
    widget = viewer_widget(page_data(shown_of("dawntime")))
    html = page_of(shown_of("dawntime"))
    # The page's model is the widget's: both ways through functions of the test.
    html = html.replace(
        "return {get: (name) => values[name], set: (name, value) => (values[name] = value), "
        "save_changes() {}, on() {}};",
        "window.fromPython = (v) => { values.values = v; window.changed(); };"
        "return {get: (name) => values[name], set: (name, value) => (values[name] = value), "
        "save_changes: () => window.toPython(values.values), on: (_, f) => (window.changed = f)};",
    )
    assert "fromPython" in html
    with opened(browser, stored(tmp_path, html)) as page:
        page.expose_function("toPython", lambda values: setattr(widget, "values", values))
        page.locator("input[name=weight]").evaluate(
            "(e) => { e.value = .45; e.dispatchEvent(new Event('input')); }"
        )
        levels(page)
        assert widget.values["weight"] == pytest.approx(0.45)
        page.evaluate("(v) => window.fromPython(v)", widget.values | {"decay": 0.9})
        assert float(page.locator("input[name=decay]").input_value()) == pytest.approx(0.9)
    widget.close()


def test_a_title_cannot_break_the_page():
    html = Page("</title><script>alert(1)</script> [[data]]", "&", False, ()).html()
    assert "<script>alert" not in html
    assert "&lt;script&gt;alert(1)&lt;/script&gt; [[data]]" in html


def test_packed_arrays_lose_nothing():
    rng = np.random.default_rng(0)
    levels_ = rng.integers(0, 256, (5, 7, 3)).astype(np.float32) / np.float32(255)
    assert packed(levels_).kind == "uint8"
    assert packed(rng.random((5, 7)).astype(np.float32)).kind == "uint16"
    assert packed(4 * rng.random((5, 7)).astype(np.float32)).kind == "float32"


def test_a_page_of_a_noisy_frame_stays_below_a_megabyte():
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, (720, 1280, 3)).astype(np.float32)
    result = fit_result((8, 8))
    picture = Picture(noise, 0.5, np.ones((720, 1280), bool), noise[..., 0] / 255, None, "none")
    data = page_data(Shown(result.model, picture, result.params, noise))
    assert data["note"].endswith("of 1280x720: levels differ a little")
    assert "note" not in page_data(shown_of("dawntime"))
    assert len(Page("", "", True, (Section("", viewer=data),)).html()) < 1 << 20


def test_shaders_are_generated_from_the_fields():
    text = fragment_shader(CONVENTIONS["dawntime"])
    assert "samples - 1" in text
    assert "ratio = decay, heavy = weight" in text
    assert "c = ratio" in text
    assert "exposure * (1. - sum)" in fragment_shader(CONVENTIONS["three"])
    assert "0.4 * exposure" in fragment_shader(CONVENTIONS["babylon"])


def test_a_widget_without_its_package_is_one_line(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "anywidget", None)
    with pytest.raises(InputError, match=r"godfit\[notebook\]"):
        viewer_widget({"params": []})
