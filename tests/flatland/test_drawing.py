"""Shapes: exact distances, canvases drawn from them, their file and that of a picture."""

import functools

import jax.numpy as jnp
import numpy as np
import pytest

from godfit import write_image
from godfit.errors import InputError
from godfit.flatland import read_canvas
from godfit.flatland.drawing import Drawing, Shape, read_drawing

Y, X = np.meshgrid(np.linspace(-0.3, 1.4, 41), np.linspace(-0.2, 1.5, 37), indexing="ij")
BOX = np.array([[-0.15, -0.07], [0.15, -0.07], [0.15, 0.07], [-0.15, 0.07]])
TURN = np.deg2rad(25)
TURNED = BOX @ [[np.cos(TURN), np.sin(TURN)], [-np.sin(TURN), np.cos(TURN)]] + [0.6, 0.6]
STAR = np.array(
    [[0.2, 0.1], [0.5, 0.4], [0.9, 0.15], [0.7, 0.6], [0.8, 1.0], [0.45, 0.7], [0.1, 0.9]]
)
LINE = np.array([[0.2, 0.3], [0.7, 0.45]])


def to_outline(points, closed=True):
    """The least distance to many places on the lines between points."""
    ends = np.roll(points, -1, 0) if closed else points[1:]
    t = np.linspace(0, 1, 4001)[:, None, None]
    starts = points if closed else points[:-1]
    places = (starts + t * (ends - starts)).reshape(-1, 2)
    flat = np.stack([X.ravel(), Y.ravel()], -1)
    return np.array([np.hypot(*(places - p).T).min() for p in flat]).reshape(X.shape)


def inside(points):
    from matplotlib.path import Path

    return Path(points).contains_points(np.stack([X.ravel(), Y.ravel()], -1)).reshape(X.shape)


@functools.cache
def star():
    return np.where(inside(STAR), -1, 1) * to_outline(STAR)


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (Shape("disc", centre=(0.4, 0.5), radius=0.2), lambda: np.hypot(X - 0.4, Y - 0.5) - 0.2),
        (Shape("segment", start=LINE[0], end=LINE[1], thickness=0.1),
         lambda: to_outline(LINE, closed=False) - 0.05),
        (Shape("segment", start=(0.3, 0.3), end=(0.3, 0.3), thickness=0.1),
         lambda: np.hypot(X - 0.3, Y - 0.3) - 0.05),
        (Shape("box", centre=(0.6, 0.6), size=(0.3, 0.14), angle=25.0),
         lambda: np.where(inside(TURNED), -1, 1) * to_outline(TURNED)),
        (Shape("polygon", points=STAR), star),
        (Shape("polygon", points=STAR[::-1]), star),
    ],
    ids=["disc", "segment", "point", "box", "polygon", "polygon the other way"],
)  # fmt: skip
def test_distance_is_exact(shape, expected):
    found = shape.distance(jnp.asarray(X), jnp.asarray(Y))
    np.testing.assert_allclose(found, expected(), atol=2e-4)


def test_later_shapes_lie_over_earlier_ones():
    under = Shape("box", (1.0, 0.0, 0.0), centre=(0.5, 0.5), size=(0.8, 0.8), angle=0.0)
    over = Shape("disc", (0.0, 3.0, 0.0), 0.5, centre=(0.5, 0.5), radius=0.2)
    made = Drawing((under, over), (40, 40)).drawn()
    np.testing.assert_allclose(made.radiance[20, 20], [0.5, 3.0, 0.0])
    np.testing.assert_allclose(made.radiance[8, 20], [1.0, 0.0, 0.0])
    assert made.opacity[20, 20] == made.opacity[8, 20] == 1
    assert made.opacity[1, 1] == 0


def test_area_is_that_of_the_shape():
    """A soft edge hides as much outside as it lets through inside."""
    made = Drawing((Shape("polygon", points=STAR),), (400, 400), softness=2.0).drawn()
    x, y = STAR.T
    area = 0.5 * abs(x @ np.roll(y, 1) - y @ np.roll(x, 1))
    assert float(made.opacity.mean()) == pytest.approx(area, rel=2e-3)


SCENE = """
[image]
width = 30
height = 20
[sky]
sun_angle = 100
sky = "#336699"
[[shape]]
kind = "disc"
centre = [0.5, 0.5]
radius = 0.25
radiance = [2, 0.5, 0]
[[shape]]
kind = "polygon"
points = [[1, 0.2], [1.4, 0.2], [1.2, 0.8]]
opacity = 0.5
"""


def test_scene_of_shapes(tmp_path):
    (tmp_path / "a.toml").write_text(SCENE)
    drawing = read_drawing(tmp_path / "a.toml")
    assert dict(drawing.settings) == {"sun_angle": 100, "sky": pytest.approx((0.2, 0.4, 0.6))}
    made = read_canvas(tmp_path / "a.toml")
    assert made.size == (20, 30)
    np.testing.assert_allclose(made.radiance[10, 10], [2, 0.5, 0])
    assert made.opacity[11, 23] == 0.5


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('kind = "disc"', 'kind = "disk"', "shape\\[0\\].kind: expected one of disc, segment"),
        ('kind = "disc"', "", "shape\\[0\\].kind: expected one of .* got nothing; add it"),
        ("radius = 0.25", "", "shape\\[0\\].radius: expected a finite number above 0, got nothing"),
        ("radius = 0.25", "radius = -1", "radius: expected a finite number above 0, got -1"),
        (
            "centre = [0.5, 0.5]",
            "centre = [0.5]",
            "centre: expected two finite numbers, got \\[0.5\\]",
        ),
        ("centre = [0.5, 0.5]", 'centre = "a"', "centre: expected two finite numbers, got 'a'"),
        (", [1.2, 0.8]]", "]", "points: expected three or more places"),
        ("[2, 0.5, 0]", "[2, -0.5, 0]", "radiance: expected three numbers of 0 or more"),
        ("opacity = 0.5", "opacity = 1.5", "opacity: expected a number from 0 to 1, got 1.5"),
        ("width = 30", "width = 0", "image.width: expected a whole number from 1"),
        ("sun_angle = 100", "sun_angel = 100", "sky.sun_angel: .* did you mean 'sun_angle'"),
        ("[image]", "[[image]]", "image: expected a table"),
        ("[image]", "[image", "expected TOML, got"),
    ],
)
def test_bad_scenes(tmp_path, old, new, message):
    assert old in SCENE
    (tmp_path / "a.toml").write_text(SCENE.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read_canvas(tmp_path / "a.toml")


def test_no_scene(tmp_path):
    with pytest.raises(InputError, match="expected a scene of shapes, got no such file"):
        read_canvas(tmp_path / "a.toml")


def save_rgba(path, values):
    import imagecodecs

    path.write_bytes(imagecodecs.png_encode(values))


def test_picture_with_alpha(tmp_path):
    """Colour times alpha is emission; black and opaque hides; transparent is nothing, whatever its
    colour."""
    values = np.zeros((2, 2, 4), np.uint8)
    values[0, 0], values[0, 1], values[1, 0] = (255, 0, 51, 255), (0, 0, 0, 255), (255, 255, 255, 0)
    values[1, 1] = (255, 255, 255, 51)
    save_rgba(tmp_path / "c.png", values)
    made = read_canvas(tmp_path / "c.png")
    np.testing.assert_allclose(made.opacity, [[1, 1], [0, 0.2]], atol=1e-7)
    np.testing.assert_allclose(made.radiance[0, 0], [1, 0, 0.2], atol=1e-7)
    np.testing.assert_allclose(made.radiance[1], [[0, 0, 0], [0.2, 0.2, 0.2]], atol=1e-7)


def test_floats_above_one(tmp_path):
    values = np.array([[[7.5, 0, 0, 1], [0, 0, 0, 0.5]]], np.float32)
    np.save(tmp_path / "c.npy", values)
    made = read_canvas(tmp_path / "c.npy")
    assert made.radiance[0, 0, 0] == 7.5
    values[0, 0, 1] = -1
    np.save(tmp_path / "c.npy", values)
    with pytest.raises(InputError, match=r"c.npy'?: canvas: expected radiance of 0 or more"):
        read_canvas(tmp_path / "c.npy")


def test_exr_is_associated(tmp_path):
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    pixels = np.array([[[0.5, 0.25, 0, 0.5]]], np.float32)
    OpenEXR.File(header, {"RGBA": pixels}).write(str(tmp_path / "c.exr"))
    made = read_canvas(tmp_path / "c.exr")
    np.testing.assert_allclose(made.radiance[0, 0], [0.5, 0.25, 0])
    assert made.opacity[0, 0] == 0.5


def test_no_alpha(tmp_path):
    write_image(tmp_path / "c.png", np.zeros((3, 4, 3)))
    with pytest.raises(InputError, match="got an image without"):
        read_canvas(tmp_path / "c.png")
