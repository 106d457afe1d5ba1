"""The failures that ``experiments/stability/stability.py`` tries: what makes each, and how it must
end."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import optax
import optimistix as optx
from scipy import ndimage

import godfit
from godfit.models.mitchell import Mitchell
from godfit.scattering.radial import METHODS
from tests.support import random_targets, stability_pictures
from tests.support.stability_judges import (
    SAMPLES,
    TRUTH,
    Outcome,
    clean,
    finite,
    fit,
    honest,
    light_pass,
    mask_of,
    names,
    recovers,
    refuses,
    says,
    warns,
    wrong,
)


@dataclass(frozen=True)
class Case:
    """A row: the failure in formulas' words, the promise, and what tries it at a size."""

    failure: str
    name: str
    promise: str
    run: Callable[[int], Outcome]


def attempt(case: Case, size: int) -> Outcome:
    """The case's outcome; whatever it raises breaks its promise."""
    try:
        kept, words = case.run(size)
        return bool(kept), words
    except Exception as error:
        return False, f"{type(error).__name__}: {str(error).splitlines()[0][:60]}"


def off_screen(distance: float) -> Callable[[int], Outcome]:
    def run(size: int) -> Outcome:
        # The disc about the light is out of sight: bars before a sky.
        changes = {"light_x": 0.5 + distance, "light_y": 0.7}
        mask = mask_of(size, "lattice")
        image = light_pass(mask, **changes)
        return recovers(fit(random_targets.to_bytes(image), mask), **changes)

    return run


def behind(size: int) -> Outcome:
    """A light behind the camera is refused in one line, never mirrored."""
    text = f"""[image]
width = {size}
height = {size}
[camera]
position = [0, 0, 7]
[light]
position = [0, 0, 20]
radius = 1
"""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        path.write_text(text)
        try:
            godfit.fit(np.zeros((size, size), np.uint8), scene=path)
        except godfit.InputError as error:
            words = str(error)
            return "behind" in words and "\n" not in words, words[-60:]
    return False, "not refused"


def margin(share: float) -> Callable[[int], Outcome]:
    """The renderer saw more of the scene than the mask given shows."""

    def run(size: int) -> Outcome:
        more = round(size * share)
        whole = mask_of(size + 2 * more, "ellipses")
        scale = size / (size + 2 * more)
        wide = {k: 0.5 + (TRUTH[k] - 0.5) * scale for k in ("light_x", "light_y")}
        image = light_pass(whole, **wide)
        cut = slice(more, more + size)
        return recovers(
            fit(random_targets.to_bytes(image)[cut, cut], np.ascontiguousarray(whole[cut, cut]))
        )

    return run


def banding(size: int) -> Outcome:
    """Doubling the samples halves the error: the law of 1.8/n."""
    mask = mask_of(size, "clouds") / 255

    def of(n: int) -> np.ndarray:
        truth = TRUTH | {"samples": n, "decay": 0.97 ** (SAMPLES / n), "weight": 0.5 * SAMPLES / n}
        return random_targets.render64(mask, truth)

    exact = of(640)
    errors = [float(np.sqrt(np.mean((of(n) - exact) ** 2))) for n in (20, 40, 80)]
    ratio = [errors[0] / errors[1], errors[1] / errors[2]]
    return all(1.6 < r < 2.8 for r in ratio), f"halving ratios {ratio[0]:.2f}, {ratio[1]:.2f}"


def border(size: int) -> Outcome:
    """Rays stay between pixel and light, so that clamping touches nothing when it is in sight."""
    mask = mask_of(size) / 255
    inner = light_pass((mask * 255).astype(np.uint8))
    padded = np.pad(mask, size // 4, mode="edge")
    scale = size / padded.shape[0]
    wide = {k: 0.5 + (TRUTH[k] - 0.5) * scale for k in ("light_x", "light_y")}
    outer = random_targets.render64(padded, TRUTH | wide)[
        size // 4 : -(size // 4), size // 4 : -(size // 4)
    ]
    off = float(np.abs(inner - outer).max() * 255)
    return off < 1.0, f"clamp and padding differ by {off:.2f} levels"


def methods_agree(size: int) -> Outcome:
    """Exact methods differ by rounding; none gives a value that is not finite."""
    mask = jnp.asarray(mask_of(size) / 255, jnp.float32)
    worst, exact = 0.0, 0
    for light in ((0.55, 0.62), (0.5, 0.5), (1.4, -0.3)):
        model = Mitchell(0.09, 0.97, 0.8, 0.5, light, "dawntime", SAMPLES)
        reference = np.asarray(model.light_pass(mask, method="reference"))
        for method in METHODS:
            try:
                image = np.asarray(model.light_pass(mask, method=method))
            except godfit.InputError:
                continue
            if not np.isfinite(image).all():
                return False, f"{method} is not finite for {light}"
            off = float(np.abs(image - reference).max())
            exact += off < 1e-4
            worst = max(worst, off)
    return exact >= 9, f"{exact} of {3 * len(METHODS)} exact, worst {255 * worst:.0f} levels"


def shimmer(size: int) -> Outcome:
    """A mask moved in steps of a tenth of a pixel: the light follows without jumps."""
    base = ndimage.gaussian_filter(mask_of(size, "ellipses") / 255.0, 1.0)
    found = []
    for step in (0.0, 0.1, 0.2):
        moved = ndimage.shift(base, (0, step), order=1, mode="nearest")
        mask = np.floor(moved * 255 + 0.5).astype(np.uint8)
        result = fit(random_targets.to_bytes(light_pass(mask)), mask)
        if wrong(result) or not result.converged:
            return False, f"step {step}: {says(result)}"
        found.append(result.params["light_x"].value)
    return bool(np.ptp(found) < 1e-3), f"light within {np.ptp(found):.1e}"


def overexposed(exposure: float) -> Callable[[int], Outcome]:
    def run(size: int) -> Outcome:
        mask = mask_of(size)
        image = light_pass(mask, exposure=exposure)
        share = float(np.mean(image >= 1))
        kept, words = recovers(fit(random_targets.to_bytes(image), mask), exposure=exposure)
        return kept, f"{100 * share:.0f}% clipped: {words}"

    return run


def transfer(size: int) -> Outcome:
    mask = mask_of(size)
    return warns(fit(random_targets.to_bytes(light_pass(mask) ** (1 / 2.2)), mask), "gamma-encoded")


def black(size: int) -> Outcome:
    mask = mask_of(size)
    result = fit(random_targets.to_bytes(light_pass(mask)), np.zeros_like(mask))
    return not result.converged and bool(result.undetermined) and finite(result), says(result)


def product(size: int) -> Outcome:
    mask = mask_of(size)
    taps = random_targets.render64(mask / 255, TRUTH) - TRUTH["exposure"] * mask / 255
    result = fit(random_targets.to_bytes(taps), mask, shader="pmndrs")
    return names(result, "exposure*weight")


def left_open(*words: str, **changes: float) -> Callable[[int], Outcome]:
    def run(size: int) -> Outcome:
        mask = mask_of(size)
        result = fit(random_targets.to_bytes(light_pass(mask, **changes)), mask)
        kept = bool(result.undetermined) or any(e.at_bound for e in result.params.values())
        off = [n for n in wrong(result, **changes) if n not in words]
        told = [*result.undetermined, *(n for n, e in result.params.items() if e.at_bound)]
        return kept and finite(result) and not (result.converged and off), str(told)[:70]

    return run


def tie(size: int) -> Outcome:
    """Vesper fitted to DawnTime: the same picture, exposure weight over decay."""
    mask = mask_of(size)
    target = random_targets.to_bytes(light_pass(mask))
    ours, theirs = fit(target, mask), fit(target, mask, shader="vesper")
    gap = abs(ours.log_likelihood - theirs.log_likelihood)
    ratio = ours.params["weight"].value / theirs.params["weight"].value
    return gap < 5 and abs(ratio * 0.97 - 1) < 0.01, (
        f"log-likelihoods differ by {gap:.2g}, weights by {ratio:.4f}"
    )


def other_convention(size: int) -> Outcome:
    mask = mask_of(size)
    return warns(
        fit(random_targets.to_bytes(light_pass(mask)), mask, shader="pmndrs"), "another shader"
    )


def bound(size: int) -> Outcome:
    changes = {"decay": 1.0, "density": 1.0, "weight": 0.1}
    mask = mask_of(size, seed=5)
    result = fit(random_targets.to_bytes(light_pass(mask, **changes)), mask)
    kept, words = recovers(result, **changes)
    # Density goes on above 1, so that 1 is a value like others.
    return kept and not result.params["density"].at_bound, words


def faint(size: int) -> Outcome:
    changes = {"exposure": 0.004}
    mask = mask_of(size)
    return recovers(fit(random_targets.to_bytes(light_pass(mask, **changes)), mask), **changes)


def far_start(**start: float) -> Callable[[int], Outcome]:
    def run(size: int) -> Outcome:
        mask = mask_of(size)
        return recovers(fit(random_targets.to_bytes(light_pass(mask)), mask, start=start))

    return run


def marched(size: int) -> Outcome:
    """Light that falls off with the square of the distance, which no tap does."""
    mask = mask_of(size)
    x, y = random_targets._grid(size)
    far = (x - TRUTH["light_x"]) ** 2 + (y - TRUTH["light_y"]) ** 2
    image = light_pass(mask) * 0.15 / (0.15 + far) + 0.05 * np.abs(np.sin(9 * x))
    return refuses(fit(random_targets.to_bytes(image), mask))


def jpeg(quality: int) -> Callable[[int], Outcome]:
    def run(size: int) -> Outcome:
        mask = mask_of(size, "ellipses")
        result = fit(
            random_targets.encoded(random_targets.to_bytes(light_pass(mask)), quality), mask
        )
        heard = any("JPEG" in w for w in result.warnings)
        kept, words = honest(result)
        return kept and heard, f"{words}; {result.pixels_effective:,.0f} of {result.pixels} pixels"

    return run


def blind(size: int) -> Outcome:
    mask = mask_of(size)
    low = mask.reshape(size // 2, 2, size // 2, 2).mean((1, 3)) / 255
    target = random_targets.to_bytes(
        random_targets.enlarged(random_targets.render64(low, TRUTH), size)
    )
    return warns(fit(target, mask, pass_scale=1.0), "rendered at")


def shifted(size: int) -> Outcome:
    mask = mask_of(size)
    result = fit(random_targets.to_bytes(light_pass(mask)), np.roll(mask, (2, -2), (0, 1)))
    return warns(result, "shifted")


def two_lights(size: int) -> Outcome:
    mask = mask_of(size)
    both = light_pass(mask) + light_pass(mask, light_x=0.15, light_y=0.3)
    return warns(fit(random_targets.to_bytes(0.6 * both), mask), "second light")


def gradient_sky(size: int) -> Outcome:
    """A mask that varies only upwards and linearly shows neither the light's column nor, but for a
    trace, decay apart from density."""
    column = np.linspace(230, 30, size).round().astype(np.uint8)
    mask = np.tile(column[:, None], (1, size))
    result = fit(random_targets.to_bytes(light_pass(mask)), mask)
    said = " ".join(result.undetermined)
    off = wrong(result)
    return "light_x" in said and not result.converged and finite(
        result
    ), f"{says(result)}; off: {off}"


def solver(name: str) -> Callable[[int], Outcome]:
    """From a near start, by another solver: the truth, or a loss that says it did not arrive."""

    def run(size: int) -> Outcome:
        mask_bytes = mask_of(size, "clouds")
        target = jnp.asarray(light_pass(mask_bytes), jnp.float32)
        mask = jnp.asarray(mask_bytes / 255, jnp.float32)
        truth = Mitchell(
            TRUTH["exposure"], TRUTH["decay"], TRUTH["density"], TRUTH["weight"],
                         (TRUTH["light_x"], TRUTH["light_y"]), "dawntime", SAMPLES)  # fmt: skip
        z_true = truth.coordinates()
        scale = jnp.asarray(truth.scales(np.asarray(z_true)))

        def residuals(y, _):
            image = truth.moved(y * scale)(mask)
            return (image - target).ravel() * 255 / size

        start = (z_true + jnp.array([0.01, 0.1, -0.03, 0.1, 0.03, -0.03])) / scale
        end = arrive(name, residuals, start)
        loss = float(jnp.sum(residuals(end, None) ** 2))
        off = float(jnp.max(jnp.abs(end * scale - z_true)[jnp.array([2, 4, 5])]))
        good = bool(jnp.isfinite(end).all())
        # A small loss must mean a right answer, and no solver may leave the numbers.
        return good and (off < 5e-3 or loss > 1e-3), f"loss {loss:.1e} levels^2, off by {off:.1e}"

    return run


def arrive(name: str, residuals, start):
    """Where a solver ends after at most 60 steps (first order: 400)."""
    if name in ("LevenbergMarquardt", "GaussNewton", "Dogleg"):
        method = getattr(optx, name)(rtol=1e-6, atol=1e-8)
        return optx.least_squares(residuals, method, start, max_steps=60, throw=False).value
    if name == "BFGS":
        method, steps = optx.BFGS(rtol=1e-6, atol=1e-8), 60
    else:
        method, steps = optx.OptaxMinimiser(optax.adam(0.03), rtol=1e-6, atol=1e-8), 400

    def loss(y, args):
        return jnp.sum(residuals(y, args) ** 2)

    return optx.minimise(loss, method, start, max_steps=steps, throw=False).value


SOLVERS = ("LevenbergMarquardt", "GaussNewton", "Dogleg", "BFGS", "Adam")
CASES = [
    Case("light off screen", "light .7 off centre", "recovers", off_screen(0.7)),
    Case("light off screen", "light 1.5 off centre", "recovers", off_screen(1.5)),
    Case("light off screen", "light 3 off centre", "recovers", off_screen(3.0)),
    Case("light behind the camera", "a scene's light", "refuses", behind),
    Case("occluder off screen", "margin 0", "recovers", margin(0.0)),
    Case("occluder off screen", "margin 25%", "recovers", margin(0.25)),
    Case("occluder off screen", "margin 50%", "recovers", margin(0.5)),
    Case("banding", "error against n", "holds", banding),
    Case("border handling", "clamp against padding", "holds", border),
    Case("every radial method", "in and out of sight", "holds", methods_agree),
    Case("aliasing, flicker", "mask in .1 pixel steps", "recovers", shimmer),
    Case("clipping", "exposure .05", "recovers", overexposed(0.05)),
    Case("clipping", "exposure .3", "recovers", overexposed(0.3)),
    Case("clipping", "exposure 1", "recovers", overexposed(1.0)),
    Case("wrong transfer", "gamma read as linear", "warns", transfer),
    Case("unidentifiable", "mask is black", "refuses and names", black),
    Case("unidentifiable", "no tap at the pixel", "names", product),
    Case(
        "unidentifiable",
        "density near 0",
        "names",
        left_open("density", "decay", "weight", "light_x", "light_y", "exposure", density=0.002),
    ),
    Case(
        "unidentifiable",
        "decay near 0",
        "names",
        left_open("density", "weight", "decay", "exposure", "light_x", "light_y", decay=0.01),
    ),
    Case(
        "unidentifiable",
        "weight 0",
        "names",
        left_open("density", "decay", "light_x", "light_y", weight=0.0),
    ),
    Case("unidentifiable", "gradient sky", "names", gradient_sky),
    Case("wrong convention", "vesper for dawntime", "ties", tie),
    Case("wrong convention", "pmndrs for dawntime", "warns", other_convention),
    Case("bounds", "decay and density at 1", "recovers", bound),
    Case("bounds", "exposure .004", "recovers", faint),
    Case(
        "far start",
        "light a frame away",
        "recovers",
        far_start(light_x=1.55, light_y=-0.4),
    ),
    Case("far start", "decay .5", "recovers", far_start(decay=0.5)),
    Case("far start", "density .1", "recovers", far_start(density=0.1)),
    Case("model error", "inverse square light", "refuses", marched),
    Case("correlated pixels", "JPEG 60", "warns, errors hold", jpeg(60)),
    Case("correlated pixels", "JPEG 90", "warns, errors hold", jpeg(90)),
    Case("correlated pixels", "upsampled, another size given", "warns", blind),
    Case("wrong mask", "shifted by two pixels", "warns", shifted),
    Case("wrong model", "two lights", "warns", two_lights),
    *(Case("solver", name, "arrives or shows it", solver(name)) for name in SOLVERS),
    Case("noise", "1 level", "recovers", lambda size: clean(size, noise=1.0)),
    Case(
        "bare picture", "objects on a flat ground", "finds the light", stability_pictures.bare(1000)
    ),
    Case("bare picture", "no rays", "refuses", stability_pictures.rayless),
    Case("two screenshots", "dark objects", "finds the light", stability_pictures.pair),
    Case("two screenshots", "the same twice", "refuses", stability_pictures.same_pair),
    Case("clip", "four frames", "recovers", stability_pictures.clip_of_frames),
    Case("clip", "a frame of another density", "names", stability_pictures.odd_frame),
    Case(
        "Hoffman-Preetham", "bars before the sky", "recovers", stability_pictures.daylight("bars")
    ),
    Case("Hoffman-Preetham", "no sky in sight", "refuses", stability_pictures.no_sky),
    Case("light in the plane", "walls and a lamp", "recovers", stability_pictures.plane(True)),
    Case("light in the plane", "nothing drawn", "refuses", stability_pictures.plane(False)),
    Case(
        "scene placement", "a box .15 off", "recovers", stability_pictures.placed(-0.8, 0.2, 0.15)
    ),
    Case("scene placement", "out of sight", "names", stability_pictures.placed(30.0, 0.2, 0.15)),
]
