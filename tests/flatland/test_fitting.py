"""The light in the plane, fitted and rendered: as a model, from Python and from the command
line."""

import json

import imagecodecs
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from godfit import InputError, fit, read_image, write_image
from godfit.__main__ import main
from godfit.flatland import Canvas, Sky, read_canvas, render
from godfit.flatland.model import Flatland, basis
from godfit.search import multigrid
from tests.support.paths import DATA_SYNTHETIC as FOLDER

MANIFEST = json.loads((FOLDER / "manifest.json").read_text())["canvases"]
RAYS = 24
TRUTH = {
    "exposure": 0.8, "sun_angle": 130.0, "sun_width": 35.0, "sun_r": 1.4, "sun_g": 1.1,
    "sun_b": 0.7,
    "sky_r": 0.15, "sky_g": 0.25, "sky_b": 0.45,
}  # fmt: skip


def drawing(size=(36, 44), emits=True):
    """RGBA bytes: a wall with a gap, a block, and a lamp."""
    values = np.zeros((*size, 4), np.uint8)
    values[14:16, :, 3] = 255
    values[14:16, 20:27, 3] = 0
    values[25:31, 8:13, 3] = 255
    if emits:
        values[22:25, 33:36] = (240, 160, 60, 255)
    return values


def model(truth):
    sun, sky = (tuple(truth[f"{name}_{c}"] for c in "rgb") for name in ("sun", "sky"))
    return Flatland(truth["exposure"], Sky(truth["sun_angle"], truth["sun_width"], sun, sky), RAYS)


def pictured(values, truth=TRUTH, noise=0.0, seed=0):
    """Bytes of the canvas's picture."""
    a = values / 255
    made = Canvas(jnp.asarray(a[..., :3] * a[..., 3:]), jnp.asarray(a[..., 3]))
    sky = model(truth).sky
    image = np.asarray(render(made, sky, rays=RAYS, exposure=truth["exposure"]))
    image = 255 * image + noise * np.random.default_rng(seed).normal(size=image.shape)
    return np.clip(np.floor(image + 0.5), 0, 255).astype(np.uint8)


@pytest.fixture
def files(tmp_path):
    (tmp_path / "c.png").write_bytes(imagecodecs.png_encode(drawing()))
    write_image(tmp_path / "t.png", pictured(drawing()) / 255)
    return tmp_path


class TestModel:
    def test_is_the_render(self, files):
        made = read_canvas(files / "c.png")
        parts = basis(made, RAYS)
        assert parts.dtype == np.float32
        expected = render(made, model(TRUTH).sky, rays=RAYS, exposure=TRUTH["exposure"])
        found = model(TRUTH)(jnp.asarray(parts, float))
        np.testing.assert_allclose(found, expected, atol=1e-6)
        some = jnp.array([3, 700, 41])
        picked = model(TRUTH)(jnp.asarray(parts, float), pixels=some)
        np.testing.assert_allclose(picked, np.asarray(found).reshape(-1, 3)[some], atol=1e-12)

    def test_there_and_back(self):
        at = model(TRUTH)
        same = at.moved(at.coordinates())
        for name, value in same.values().items():
            np.testing.assert_allclose(value, TRUTH[name], rtol=1e-12)
        held = jnp.full(9, jnp.nan).at[jnp.array([0, 4])].set(jnp.array([2.0, 0.3]))
        moved = at.moved(at.coordinates(), held).values()
        assert float(moved["exposure"]) == 2
        assert float(moved["sun_g"]) == 0.3
        assert float(moved["sun_r"]) == pytest.approx(0.8 * 1.4 / 2)

    def test_derivatives_by_coordinates(self, files):
        parts = jnp.asarray(basis(read_canvas(files / "c.png"), RAYS), float)
        at = model(TRUTH)
        z = at.coordinates()

        @jax.jit
        def image(z):
            return at.moved(z)(parts)

        found = jax.jit(jax.jacfwd(lambda z: at.moved(z)(parts)))(z)
        for i in range(9):
            h = 1e-5 * max(1.0, abs(float(z[i])))
            expected = (image(z.at[i].add(h)) - image(z.at[i].add(-h))) / (2 * h)
            np.testing.assert_allclose(found[..., i], expected, atol=1e-6)

    def test_no_background(self):
        with pytest.raises(ValueError, match="expected no background"):
            Flatland(samples=1)(jnp.zeros((2, 2, 4)), jnp.zeros((2, 2)))


@pytest.mark.parametrize("seed", range(3))
def test_random_truths_are_recovered(seed):
    """From bytes, within the quoted errors; experiments/flatland/light_in_the_plane.py tries many
    more."""
    rng = np.random.default_rng(seed)
    truth = {
        "exposure": rng.uniform(0.6, 1.0), "sun_angle": rng.uniform(30, 150),
        "sun_width": rng.uniform(15, 70),
    } | {f"{n}_{c}": v for n, top in (("sun", 1.5), ("sky", 0.5))
         for c, v in zip("rgb", rng.uniform(0.2 * top, top, 3), strict=True)}  # fmt: skip
    values = drawing()
    target = pictured(values, truth, noise=0.5, seed=seed)
    a = values / 255
    made = Canvas(jnp.asarray(a[..., :3] * a[..., 3:]), jnp.asarray(a[..., 3]))
    result = fit(target, canvas=made, rays=RAYS)
    assert result.converged, result.message
    assert result.undetermined == ()
    assert result.model.name == "flatland"
    for name, estimate in result.params.items():
        assert estimate.stderr is not None
        assert abs(estimate.value - truth[name]) < 4 * estimate.stderr, name


def test_dark_canvas_says_what_is_not_known(files):
    """Without a lamp only exposure times radiance shows."""
    values = drawing(emits=False)
    made = Canvas(jnp.zeros((*values.shape[:2], 3)), jnp.asarray(values[..., 3] / 255))
    result = fit(pictured(values), canvas=made, rays=RAYS)
    assert result.params["exposure"].fixed
    assert any("exposure held at 1" in note for note in result.notes)
    assert result.params["sun_r"].value == pytest.approx(0.8 * 1.4, rel=0.01)
    assert result.params["sun_angle"].value == pytest.approx(130, abs=0.3)


def test_held_and_started(files):
    begun, climb = [], multigrid.climb

    def recorded(problem, starts, *rest, **options):
        begun.extend(starts)
        return climb(problem, starts, *rest, **options)

    # No compiled program holds what changes: without ``monkeypatch``, stored ones serve.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(multigrid, "climb", recorded)
        result = fit(
            files / "t.png", canvas=files / "c.png", rays=RAYS, fix={"sun_width": 35.0},
            start={"sun_angle": 100.0},
        )  # fmt: skip
    assert [start[1] for start in begun] == pytest.approx([100.0])
    assert result.params["sun_width"].fixed
    assert result.params["sun_width"].value == 35
    assert result.params["sun_angle"].value == pytest.approx(130, abs=0.3)


NO_CANVAS = "canvas: expected one with the model flatland, got none"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": "flatland"}, NO_CANVAS),
        ({"canvas": "c.png", "mask": "c.png"}, "mask: expected none with the model flatland"),
        ({"canvas": "c.png", "samples": 20}, "samples: expected none with the model flatland"),
        ({"canvas": "c.png", "shader": "babylon"}, "shader: expected none with the model flatland"),
        ({"canvas": "c.png", "fov": 30.0}, "fov: expected none with the model flatland"),
        ({"canvas": "c.png", "rays": 0}, "rays: expected a whole number from 1 to 1024, got 0"),
        ({"canvas": "c.png", "rays": 2000}, "rays: expected a whole number from 1 to 1024"),
        (
            {"canvas": "c.png", "fix": {"sun_width": 0.0}},
            "expected sun_width from 0.1 to 180, got 0",
        ),
        ({"canvas": "c.png", "fix": {"sun_wide": 3.0}}, "did you mean 'sun_width'"),
        ({"canvas": "s.png"}, "canvas: expected the target's 44x36 pixels, got 5x4"),
        ({"canvas": "t.png"}, "expected a canvas with alpha"),
        ({"canvas": "x.png"}, "x.png'?: cannot be read"),
        ({"mask": "t.png", "rays": 8}, "expected --model flatland with them, got mitchell"),
        ({"mask": "t.png", "canvas": "c.png", "model": "mitchell"}, "expected --model flatland"),
    ],
)
def test_nonsense_is_refused(files, options, message):
    (files / "s.png").write_bytes(imagecodecs.png_encode(drawing((4, 5))))
    options = {k: files / v if str(v).endswith(".png") else v for k, v in options.items()}
    with pytest.raises(InputError, match=message):
        fit(files / "t.png", **options)


def test_a_target_through_the_command_line(tmp_path, capsys):
    name = "plane_window"
    arguments = ["fit", str(FOLDER / f"{name}.png"), "-o", str(tmp_path / "o"), "--json", "-q"]
    assert main(arguments) == 0
    printed = capsys.readouterr()
    found = json.loads(printed.out)
    assert printed.err == ""
    assert found == json.loads((tmp_path / "o" / "fit.json").read_text())
    assert found["model"] == "flatland"
    assert found["rays"] == MANIFEST[name]["rays"]
    assert set(found["inputs"]) == {"target", "canvas"}
    assert len(found["inputs"]["canvas"]["sha256"]) == 64
    truth = MANIFEST[name]["params"]
    assert set(found["params"]) == set(truth)
    for parameter, estimate in found["params"].items():
        allowed = max(5 * estimate["stderr"], 1e-4 * abs(truth[parameter]))
        assert abs(estimate["value"] - truth[parameter]) < allowed, parameter
    assert read_image(tmp_path / "o" / "fit.png").values.ndim == 3
    # The fit renders again, to the level.
    again = ["render", str(FOLDER / f"{name}_canvas.png"), "-o", str(tmp_path / "again.png")]
    assert main([*again, "--params", str(tmp_path / "o" / "fit.json")]) == 0
    target = read_image(FOLDER / f"{name}.png").values
    off = 255 * np.abs(read_image(tmp_path / "again.png").values - target)
    assert np.mean(off > 1.01) < 2e-3


def says(capsys, status, *arguments):
    """The one line that a failing command leaves on stderr."""
    assert main([str(a) for a in arguments]) == status
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.splitlines()) == 1, printed.err
    return printed.err


class TestRender:
    def test_options(self, files):
        base = ["render", "--model", "flatland", str(files / "c.png"), "-o", str(files / "o.npy")]
        base += ["--sun-angle", "130", "--sun-width", "35", "--sun", "1.4,1.1,.7"]
        assert main([*base, "--sky", ".15,.25,.45", "--exposure", ".8", "--rays", str(RAYS)]) == 0
        found = read_image(files / "o.npy").values
        assert np.abs(255 * found - read_image(files / "t.png").values * 255).max() < 1
        pictures = [found]
        for more in (
            ["--method", "march", "--steps", "30"], ["--method", "cascades"], ["--published", "gi"],
            ["--jitter", "--seed", "4"], ["--film-grain", ".02"],
            ["--jitter", "--frames", "3"],
        ):  # fmt: skip
            assert main([*base, *more]) == 0
            pictures.append(read_image(files / "o.npy").values)
        for i, one in enumerate(pictures):
            assert all(np.abs(one - other).max() > 1e-3 for other in pictures[:i])

    def test_shapes(self, files):
        (files / "s.toml").write_text(
            "[image]\nwidth = 30\nheight = 20\n[sky]\nsun = [0, 0, 0]\nsky = [0, 0, 0]\n"
            '[[shape]]\nkind = "disc"\ncentre = [0.5, 0.5]\nradius = 0.2\nradiance = "#ff8000"\n'
        )
        out = files / "o.npy"
        assert main(["render", "--model", "flatland", str(files / "s.toml"), "-o", str(out)]) == 0
        image = read_image(out).values
        assert image.shape == (20, 30, 3)
        np.testing.assert_allclose(image[10, 10], [1, 128 / 255, 0], atol=1e-6)
        assert 0.01 < image[10, 28, 0] < 0.3

    @pytest.mark.parametrize(
        ("options", "status", "message"),
        [
            (["--rays", "0"], 1, "rays: expected a whole number from 1"),
            (["--method", "march", "--steps", "0"], 1, "steps: expected a whole number from 1"),
            (["--sun-width", "0"], 1, "sun width: expected degrees above 0, at most 180, got 0"),
            (["--sun-angle", "nan"], 1, "sun angle: expected a finite number"),
            (["--sun", "1,2"], 2, "expected R,G,B, got '1,2'"),
            (["--sky", "1,2,-1"], 1, "sky colour: expected three finite numbers of 0 or more"),
            (["--exposure", "-1"], 1, "exposure: expected a finite number of 0 or more"),
            (["--method", "fast"], 1, "method: expected one of distance, march, cascades"),
            (["--film-grain", "-1"], 1, "film grain: expected a finite number of 0 or more"),
            (
                ["--published", "gi", "--film-grain", "-1"],
                1,
                "film grain: expected a finite number",
            ),
            (
                ["--published", "gi", "--passes", "9"],
                1,
                "passes: expected a whole number from 0 to",
            ),
            (["--published", "gi", "--rays", "0"], 1, "rays: expected a whole number from 1"),
            (["--frames", "0"], 1, "frames: expected 1 or more, got 0"),
            (["--frames", "2"], 1, "frames: expected jitter or film grain, got neither"),
            (["--jitter", "--frames", "2", "--accumulate", "sum"], 1, "expected mean or mix, got"),
            (["--method", "cascades", "--jitter"], 1, "jitter: expected none with the method casc"),
        ],
    )
    def test_nonsense_is_refused(self, files, capsys, options, status, message):
        base = ["render", "--model", "flatland", files / "c.png", "-o", files / "o.png"]
        assert message in says(capsys, status, *base, *options)
        assert not (files / "o.png").exists()

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            (["--published"], "--published: expected --published naive or --published gi, got no"),
            (["--published", "march"], "expected --published naive or --published gi, got march"),
            (["--grain", ".05"], "noise laid on the picture is --film-grain .05"),
            (["--grain=.05"], "noise laid on the picture is --film-grain .05"),
            (["--grain"], "--grain: expected --published gi with it, got none"),
            (["--no-noise"], "expected --published naive or --published gi with it, got none"),
            (["--published", "naive", "--no-grain"], "--grain: expected --published gi with it"),
            (["--published", "naive", "--no-sun"], "--no-sun: expected --published gi with it"),
            (["--published", "naive", "--frames", "2"], "got --published naive"),
            (["--published", "gi", "--no-accumulate"], "expected --published naive with it"),
            (["--published", "gi", "--jitter"], "--jitter: expected no --published with it"),
            (["--accumulate", "mix"], "--accumulate: expected --frames with it, got none"),
        ],
    )
    def test_what_means_nothing_together(self, files, capsys, options, message):
        base = ["render", "--model", "flatland", files / "c.png", "-o", files / "o.png"]
        assert message in says(capsys, 2, *base, *options)
        assert message in says(capsys, 2, "render", *options, *base[1:])
        assert not (files / "o.png").exists()

    def test_frames_are_those_of_consecutive_seeds(self, files):
        base = ["render", "--model", "flatland", str(files / "c.png"), "-o", str(files / "o.npy")]
        base += ["--rays", "4", "--jitter"]

        def picture(*more):
            assert main([*base, *more]) == 0
            return read_image(files / "o.npy").values

        one, two, three = (picture("--seed", str(seed)) for seed in (5, 6, 7))
        mean = picture("--seed", "5", "--frames", "3")
        np.testing.assert_allclose(mean, (one + two + three) / 3, atol=1e-6)
        mixed = picture("--seed", "5", "--frames", "3", "--accumulate", "mix")
        expected = 0.1 * three + 0.9 * (0.1 * two + 0.9 * one)
        np.testing.assert_allclose(mixed, expected, atol=1e-6)

    def test_canvases_that_are_none(self, files, capsys):
        base = ["render", "--model", "flatland", "-o", files / "o.png"]
        assert "expected a canvas with alpha" in says(capsys, 1, *base, files / "t.png")
        values = np.zeros((4, 4, 4), np.float32)
        values[1, 1] = (-1, 0, 0, 1)
        np.save(files / "n.npy", values)
        assert "radiance of 0 or more" in says(capsys, 1, *base, files / "n.npy")

    @pytest.mark.parametrize("values", [
        np.zeros((5, 7, 4), np.uint8), np.full((5, 7, 4), 255, np.uint8),
        np.tile(np.uint8([0, 0, 0, 255]), (5, 7, 1)), np.zeros((1, 9, 4), np.uint8),
    ], ids=["empty", "all emits", "all hides", "one row"])  # fmt: skip
    @pytest.mark.parametrize("method", ["distance", "cascades"])
    def test_odd_canvases(self, files, values, method):
        (files / "o.png").write_bytes(imagecodecs.png_encode(values))
        out = str(files / "r.npy")
        command = ["render", "--model", "flatland", str(files / "o.png"), "-o", out]
        assert main([*command, "--method", method]) == 0
        image = read_image(out).values
        mean = np.array([0.02, 0.08, 0.2]) + np.array([0.95, 0.95, 0.9]) * 60 / 360
        expected = mean if values[0, 0, 3] == 0 else values[0, 0, :3] / 255
        np.testing.assert_allclose(image, np.broadcast_to(expected, image.shape), atol=1e-5)

    def test_options_of_the_plane_need_the_plane(self, files, capsys):
        base = ["render", files / "t.png", "-o", files / "o.png"]
        assert "--sun-angle: expected --model flatland" in says(capsys, 2, *base, "--sun-angle", 3)
        assert "--published: expected --model flatland" in says(
            capsys, 2, *base, "--published", "gi"
        )


class TestFitCommand:
    def test_canvas_beside_a_mask(self, files, capsys):
        base = ["fit", files / "t.png", "--canvas", files / "c.png"]
        message = says(capsys, 2, *base, "--mask", files / "t.png")
        assert "expected --mask, --scene or --canvas, got two" in message

    def test_a_mask_in_place_of_the_canvas_beside_the_target(self, files, capsys):
        """The names that may be fixed are those of the model that would be fitted."""
        (files / "t.toml").write_text('canvas = "c.png"\n[scattering]\nmodel = "flatland"\n')
        write_image(files / "m.png", 1 - drawing()[..., 3] / 255)
        base = ["fit", files / "t.png", "--shader", "mitchell", "--samples", 10, "--fix", "sun=3"]
        message = says(capsys, 1, *base, "--mask", files / "m.png")
        assert "expected one of exposure, decay, density, weight, light_x, light_y" in message

    def test_the_canvas_beside_the_target(self, files, capsys):
        (files / "t.toml").write_text(f'canvas = "c.png"\n[scattering]\nrays = {RAYS}\n')
        assert main(["fit", str(files / "t.png"), "-q", "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["model"] == "flatland"
        assert found["rays"] == RAYS

    def test_wrong_model(self, files, capsys):
        assert NO_CANVAS in says(
            capsys, 1, "fit", files / "t.png", "--mask", files / "t.png", "--model", "flatland"
        )

    def test_compare_includes_it(self, tmp_path, capsys):
        # The other models are fitted by the programs of studies/test_compare.py at this size.
        files, values = tmp_path, drawing((96, 96))
        (files / "c.png").write_bytes(imagecodecs.png_encode(values))
        write_image(files / "t.png", pictured(values) / 255)
        write_image(files / "m.png", 1 - values[..., 3] / 255)
        command = ["compare", files / "t.png", "--mask", files / "m.png", "--canvas",
                   files / "c.png", "--rays", RAYS, "--shader", "dawntime", "--samples", 20,
                   "--fov", 60, "--distance", 900, "-o", files / "o", "-q", "--json"]  # fmt: skip
        assert main([str(a) for a in command]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["preferred"] == "flatland"
        assert {each["fit"]["model"] for each in found["fits"]} == {
            "mitchell", "hoffman-preetham", "flatland",
        }  # fmt: skip
        assert (files / "o" / "compare.png").exists()
