"""Results of every kind without a fit: pictures of any shape, sentences of any length."""

import numpy as np

from godfit.inference.estimates import Estimate
from godfit.inference.observation import Picture
from godfit.inference.settle import Settled, Tangent
from godfit.models.mitchell import Mitchell
from godfit.report import clip, compare, select
from godfit.report.result import FitResult

LONG = "a remark with a_name_of_a_file_without_any_blank_in_it_" + "that_goes_on_" * 12
SENTENCE = "the residual is not noise: the shader, the mask or the transfer may be another; " * 4


def fit_result(size, wordy=False, colour=False) -> FitResult:
    """A fit of a picture of ``size`` (h, w); ``wordy`` with many parameters and long remarks."""
    rng = np.random.default_rng(0)
    (h, w), channels = size, 3 if colour else 1
    levels = rng.integers(0, 256, (h, w, channels)).astype(np.float32)
    mask = (rng.random((h, w)) > 0.5).astype(np.float32)
    picture = Picture(levels, 0.5, np.ones((h, w), bool), mask, None, "none")
    model = Mitchell(0.05, 0.99, 0.8, 0.8, (0.4, 1.2 if wordy else 0.6), "dawntime", 200)
    params = {n: Estimate(float(v), 1e-4) for n, v in model.values().items()}
    if wordy:
        extra = [f"object[{i}].position.{axis}" for i in range(9) for axis in "xyz"]
        params |= {name: Estimate(-123.456, None, fixed=True) for name in extra}
    where = {n: rng.random((6, 8)).astype(np.float32) for n in ("decay", "density", "light_x")}
    result = FitResult(
        converged=not wordy, message=SENTENCE if wordy else "converged", model=model,
        params=params, combined={}, covariance=np.eye(6), correlations={}, undetermined=(),
        warnings=(LONG, SENTENCE) if wordy else (), notes=(), noise_levels=0.005, rmse_levels=0.29,
        psnr_db=58.0, pixels=h * w, pixels_effective=float(h * w), pixels_clipped=0,
        residual_correlation=0.0, residual_tails=3.0, log_likelihood=-1.0,
        timing_s={"solve": 1.0, "compile": 0.0}, picture=picture, free=np.ones(6, bool),
        held=np.full(6, np.nan), where=where, inputs={"target": {"path": "a/$frame_{x}$.png"}},
    )  # fmt: skip
    # What the model would compute, so that no program is compiled.
    noise = rng.normal(0, 0.3, levels.shape).astype(np.float32)
    vars(result)["levels"] = np.clip(levels + noise, 0, 255)
    return result


def comparison(size, wordy=False) -> compare.Comparison:
    """A comparison of four fits."""
    names = ("mitchell", "mitchell, light free", "hoffman-preetham", "hoffman-preetham, light free")
    rows = [
        compare.Row(name, fit_result(size, wordy), 7, 1.0 + i, 2.0 + 20 * i, 0.1)
        for i, name in enumerate(names)
    ]
    return compare.Comparison(tuple(rows), rows[0].result.picture.levels)


def selection(size, wordy=False) -> select.Selection:
    """A ladder of seven rungs."""
    base = fit_result(size, wordy)
    names = [
        "constant veil",
        "no decay",
        "all taps reach the light",
        "one light",
        "the whole shader",
    ]
    names += ["a coloured light", "two lights of two colours" + (" and more" * 12 if wordy else "")]
    settled = Settled(np.zeros(1), 0.3, -1.0, True)
    tangent = Tangent(np.zeros(1), np.zeros(1), np.zeros(1))
    rows = []
    for i, name in enumerate(names):
        coordinates = settled._replace(coordinates=np.full(1, 128.0))
        shape = np.ones(1, bool), np.full(1, np.nan)
        # A veil everywhere: other models would be compiled for every shape.
        rung = select.Rung(name, name, None, coordinates, tangent, *shape, i + 2)
        rows.append(select.Row(rung, 5.0 / (i + 1), 1.0, 10.0 ** (7 - i), 0.0, 0.0, 0.0, i > 3))
    return select.Selection(tuple(rows), 4, {"dawntime": {"exposure": 0.05}}, base, None, 1.0)


def clip_result(size, wordy=False) -> clip.ClipResult:
    """A clip of six frames, the last of which is left out."""
    base = fit_result(size, wordy)
    shader = {
        n: e for n, e in base.params.items() if n in ("exposure", "decay", "density", "weight")
    }
    frames = tuple(
        clip.Frame(
            f"{i}.png", np.array([i / 5, 2.5 if wordy and i == 3 else 0.5]), np.array([1e-3, 1e-3]),
            {n: Estimate(e.value * (1 + 1e-4 * i), 1e-4) for n, e in shader.items()}, {},
            "" if i < 5 else SENTENCE,
        )
        for i in range(6)
    )  # fmt: skip
    return clip.ClipResult(
        not wordy, base.message, base.model, shader, {}, np.eye(6), frames, (), base.warnings, (),
        {"solve": 1.0}, np.repeat(base.picture.levels / 255, 3, -1),
    )  # fmt: skip


KINDS = {"fit": fit_result, "compare": comparison, "select": selection, "clip": clip_result}
"""What makes a result of each kind, from the size of its picture and whether it is wordy."""
