"""Several frames of one clip: they share the shader's parameters; light and occluders are each
frame's own.

Frames are fitted one after another, each alone: with its mask or scene, or as a bare picture, whose
light is searched about that of the frame before it. Only a frame's estimate
and covariance are kept, so that memory does not grow with their number. The shader's parameters are
pooled one by one, see ``pooling.py``.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from godfit.blind import bare_fit
from godfit.errors import InputError
from godfit.fitting.found import found_for
from godfit.inference.estimates import Solution, estimates
from godfit.inference.fitted import Found
from godfit.inference.noise import WITHIN_ROUNDING
from godfit.inference.problem import given_and_held
from godfit.io.filters import shrink
from godfit.io.image import Image
from godfit.io.sources import Source, read_source
from godfit.models.base import FAINTEST, AbstractModel, Vector
from godfit.models.build import mitchell_template
from godfit.models.coordinates import LIGHT_X, LIGHT_Y
from godfit.models.disc_light import DiscLight
from godfit.report.clip import ClipResult, Frame
from godfit.report.live.data import CLIP_FRAMES, Shown, clip_frame
from godfit.report.verdict import spread
from godfit.request import Request
from godfit.runtime.guest import as_guest
from godfit.runtime.program_cache import cached_jit
from godfit.scattering.parameters import SCATTERING
from godfit.studies.pooling import Pool, pooled

SHARED_COUNT = len(SCATTERING)
"""Parameters that all frames share: exposure, decay, density and weight."""
CLIP_SIDE = 640
"""Pixels of the longer side of the first frame's copy, at most: the report shows no more."""
REPORTED_GROWTH = 2.0
"""Growth of the pooled variance from which a warning is given: less is chance."""
TOO_FEW = "only {} of {} frames agree on the shader; inspect the fits of single frames"
"""Message with the number of frames that agree, and of all."""
LEFT_OUT = "{} of {} frames are left out, as they do not agree with the others"
"""Warning with the number of frames left out, and of all."""
SCATTERED = "frames scatter {:.2g} times as much as their errors; errors are widened by that"
"""Warning with the ratio."""


UNLIKE_NOISE = "its residual is not noise"
"""Message of a frame with a mask that its shader does not explain."""


class Shot(NamedTuple):
    """A frame and what it comes with, each as in ``godfit.fit``."""

    image: Source
    mask: Source | None = None
    scene: Any = None
    background: Source | None = None


class _Answer(NamedTuple):
    """The fit of one frame alone: coordinates ``at`` (6,) of scattering and light, their
    ``covariance`` (6, 6), zero for those that are held, and ``open_`` as in ``Found``."""

    name: str
    at: np.ndarray
    covariance: np.ndarray
    open_: list[tuple[int, list[int]]]
    message: str

    @property
    def determined(self) -> np.ndarray:
        """(4,) which coordinates of the scattering the frame determines."""
        determined = (np.diag(self.covariance)[:SHARED_COUNT] > 0) & (not self.message)
        determined[[index for index, _ in self.open_]] = False
        return determined


def fit_clip(
    frames: Iterable[Source | Shot],
    *,
    shader: str | None = None,
    samples: int | None = None,
    pass_scale: float | None = None,
    arithmetic: str | None = None,
    valid: np.ndarray | None = None,
    fix: Mapping[str, float | None] | None = None,
    start: Mapping[str, float] | None = None,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> ClipResult:
    """Fit one shader, and a light for each frame, to several pictures.

    **Arguments:** as of ``godfit.fit``. `frames` are images, or `Shot`s where they come with a mask
    or a scene. They are taken one at a time, so that a generator will do. `valid` (h, w) holds for
    all of them. A `pass_scale` that is not given is estimated from each bare frame.

    **Returns:** a `ClipResult`. Raises `InputError`, a ValueError of one line, for frames that
    cannot be read, and for fewer than two.

    >>> import godfit
    >>> godfit.fit_clip(["frame.png"], start={"densty": 0.8})
    Traceback (most recent call last):
    ...
    godfit.errors.InputError: start: expected one of exposure, ...; did you mean 'density'?
    """
    began = time.perf_counter()
    shading = mitchell_template(shader or "mitchell", samples, 1)
    fix, start, say = fix or {}, start or {}, progress or (lambda text: None)
    answers: list[_Answer] = []
    notes: list[str] = []
    warnings: list[str] = []
    shown = np.zeros((0, 0, 3))
    pages: list[dict[str, Any]] = []
    with as_guest():
        held = given_and_held(shading, fix, start)[1]
        for source in frames:
            shot = source if isinstance(source, Shot) else Shot(source)
            image = read_source(shot.image, "none")
            count = len(answers) + 1
            name = image.path or f"frame {count}"
            _check_size(name, image, valid)

            def report(text: str, at: int = count) -> None:
                say(f"frame {at}: {text}")

            if shot.mask is None and shot.scene is None:
                asked = bare_fit.Settings(
                    valid=valid, pass_scale=pass_scale, fix=fix, start=start,
                    near=_last_light(answers), seed=seed,
                )  # fmt: skip
                found, messages = bare_fit.found_in(image, shading, asked, report)
            else:
                request = Request(
                    target=image, mask=shot.mask, scene=shot.scene, background=shot.background,
                    shader=shading.shader, samples=int(shading.samples), pass_scale=pass_scale,
                    fix=fix, start=start, valid=valid, transfer=image.transfer,
                    arithmetic=arithmetic, seed=seed, progress=report,
                ).checked()  # fmt: skip
                found, messages, _ = found_for(request)
            notes += [f"{name}: {note}" for note in (*image.notes, *messages)]
            warnings += found.remarks
            answers.append(_answer(name, found))
            if count <= CLIP_FRAMES:
                pages.append(_page(name, found))
            if count == 1:
                shown = _small(image)
        if len(answers) < 2:
            raise InputError(f"frames: expected at least two, got {len(answers)}")
        said = tuple(notes), tuple(dict.fromkeys(warnings))
        result = _pooled_result(answers, shading, held, said, shown)
    seconds = {"solve": time.perf_counter() - began}
    return dataclasses.replace(result, timing_s=seconds, pages=tuple(pages))


def _page(name: str, found: Found) -> dict[str, Any]:
    """The frame as the live page has it: packed, so that no picture stays in memory."""
    model, picture = found.problem.at(found.settled.coordinates), found.problem.picture
    return clip_frame(Path(name).name, Shown(model, picture, {}, picture.rendered(model)))


def _check_size(name: str, image: Image, valid: np.ndarray | None) -> None:
    if valid is not None and image.values.shape[:2] != valid.shape:
        (h, w), (height, width) = valid.shape, image.values.shape[:2]
        raise InputError(
            f"{name}: expected the first frame's {w}x{h} pixels, with --ignore, got "
            f"{width}x{height}"
        )


def _small(image: Image) -> np.ndarray:
    """(h, w, 3) copy of a frame for the report, at most CLIP_SIDE pixels a side."""
    values = image.encoded if image.encoded.ndim == 3 else image.encoded[..., None]
    values = np.broadcast_to(values, (*values.shape[:2], 3))
    factor = -(-max(values.shape[:2]) // CLIP_SIDE)
    return shrink(values, (values.shape[0] // factor, values.shape[1] // factor))


def _answer(name: str, found: Found) -> _Answer:
    if not isinstance(found.problem.model, DiscLight):
        z = np.asarray(found.settled.coordinates, np.float64)
        known = spread(found)
        trusted = found.settled.sigma <= WITHIN_ROUNDING or known.residual_misfit.like_noise
        message = found.objection or ("" if trusted else UNLIKE_NOISE)
        return _Answer(name, z, known.covariance, list(found.opened), message)
    z, held = found.settled.coordinates, np.asarray(found.problem.held, np.float32)
    at, slopes = (
        np.asarray(a, np.float64) for a in _shader_coordinates(found.problem.model, z, held)
    )
    # What else a bare picture leaves open, its disc's radius and veil, is no part of the shader.
    open_ = [
        (index, [i for i in others if i < len(at)])
        for index, others in found.opened
        if index < SHARED_COUNT
    ]
    covariance = slopes @ spread(found).covariance @ slopes.T
    return _Answer(name, at, covariance, open_, found.objection)


@cached_jit
def _shader_coordinates(model: DiscLight, coordinates: Vector, held: Vector):
    """Coordinates (6,) of scattering and light and their derivatives (6, p) by those of a picture,
    whose gain is without the veil's share."""

    def shading(z):
        return model.moved(z, held).shading.coordinates()

    return shading(coordinates), jax.jacfwd(shading)(coordinates)


def _shared(at: np.ndarray) -> np.ndarray:
    """(4,) the pooled quantities, from coordinates (6,): exposure; attenuation along the whole ray,
    which depends on decay alone; density; and the logarithm of gain times density, which depends
    on exposure times weight alone, and which frames determine to within a factor."""
    exposure, kappa, density, gain = at[:SHARED_COUNT]
    return np.array([exposure, kappa * density, density, np.log(max(gain * density, FAINTEST))])


def _slopes(at: np.ndarray) -> np.ndarray:
    """(4, 4) derivatives of ``_shared`` by the coordinates."""
    _, kappa, density, gain = at[:SHARED_COUNT]
    out = np.eye(SHARED_COUNT)
    out[1, 1:3] = density, kappa
    out[3, 2:] = 1 / density, 1 / max(gain, FAINTEST)
    return out


def _information(answer: _Answer) -> np.ndarray:
    """(4, 4) inverse variances of the shared quantities, 0 where the frame does not determine them.
    Their covariances are not used. Where masks are estimated for each frame they claim to determine
    combinations better than they do; and where frames vary alike, the mean does not depend on
    them."""
    block, slopes = answer.covariance[:SHARED_COUNT, :SHARED_COUNT], _slopes(answer.at)
    variance = np.diag(slopes @ block @ slopes.T)
    return np.diag(np.where(answer.determined, 1 / np.where(answer.determined, variance, 1.0), 0.0))


def _pooled(answers: list[_Answer]) -> Pool:
    """The pooled estimate of the scattering, in coordinates (4,)."""
    pool = pooled(
        np.stack([_shared(a.at) for a in answers]), np.stack([_information(a) for a in answers])
    )
    exposure, along, density, product = pool.mean
    mean = np.array([exposure, along / density, density, np.exp(product) / density])
    determined = np.isfinite(np.diag(pool.covariance))
    known = np.where(determined[:, None] & determined, pool.covariance, 0.0)
    back = np.linalg.inv(_slopes(mean))
    covariance = np.where(determined[:, None] & determined, back @ known @ back.T, 0.0)
    covariance[~determined, ~determined] = np.inf
    return pool._replace(mean=mean, covariance=covariance)


def _last_light(answers: list[_Answer]) -> tuple[float, float] | None:
    """The light (u, v) of the last frame, about which the next one is searched; None where that
    frame's is not known."""
    if not answers or answers[-1].message:
        return None
    u, v = answers[-1].at[LIGHT_X : LIGHT_Y + 1]
    return float(u), float(v)


def _pooled_result(
    answers: list[_Answer],
    shading: AbstractModel,
    held: np.ndarray,
    said: tuple[tuple[str, ...], tuple[str, ...]],
    shown: np.ndarray,
) -> ClipResult:
    """What the frames determine together; ``said`` are notes and warnings on single frames."""
    notes, warnings = said
    pool = _pooled(answers)
    determined = np.isfinite(np.diag(pool.covariance))
    agreeing = pool.agrees & [a.determined.any() for a in answers]
    first = answers[int(agreeing.argmax())]
    spread = np.zeros((SHARED_COUNT + 2, SHARED_COUNT + 2))
    spread[:SHARED_COUNT, :SHARED_COUNT] = np.where(
        determined[:, None] & determined, pool.covariance, 0.0
    )
    open_ = [o for o in first.open_ if not determined[o[0]]]
    held[SHARED_COUNT:] = first.at[SHARED_COUNT:]
    for index, _ in open_:
        held[index] = first.at[index]
    free, used = (
        np.append(determined, [False, False]),
        np.append(shading.used[:SHARED_COUNT], [False, False]),
    )
    z = np.append(pool.mean, first.at[SHARED_COUNT:])
    solution = Solution(z.astype(np.float32), spread, free, held, open_)
    result = estimates(shading, solution, used)
    frames = tuple(
        Frame(
            a.name,
            a.at[SHARED_COUNT:],
            np.sqrt(np.diag(a.covariance)[SHARED_COUNT:]),
            *_alone(a, shading, used),
            _why(a, bool(ok)),
        )
        for a, ok in zip(answers, agreeing, strict=True)
    )
    count, whole = int(agreeing.sum()), len(answers)
    converged = count >= max(2, whole / 2)
    if count < whole:
        warnings += (LEFT_OUT.format(whole - count, whole),)
    if pool.growth > REPORTED_GROWTH:
        warnings += (SCATTERED.format(np.sqrt(pool.growth)),)
    return ClipResult(
        converged=converged,
        message="converged" if converged else TOO_FEW.format(count, whole),
        model=result.model,
        params=result.params,
        combined=result.combined,
        covariance=result.covariance,
        frames=frames,
        undetermined=result.undetermined,
        warnings=warnings,
        notes=notes,
        timing_s={},
        shown=shown,
    )


def _why(answer: _Answer, agreeing: bool) -> str:
    if answer.message or agreeing:
        return answer.message
    return "its shader differs from that of the other frames"


def _alone(answer: _Answer, shading: AbstractModel, used: np.ndarray):
    """Parameters and products as one frame alone has them."""
    determined = np.diag(answer.covariance) > 0
    held = np.full(len(determined), np.nan)
    for index, _ in answer.open_:
        held[index] = answer.at[index]
    z = answer.at.astype(np.float32)
    found = estimates(shading, Solution(z, answer.covariance, determined, held, answer.open_), used)
    return found.params, found.combined
