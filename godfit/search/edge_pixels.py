"""Edge pixels of a drawn mask whose side is uncertain: the target decides.

A mask drawn without anti-aliasing has, in every edge pixel, the colour at the pixel's centre. Where
an edge passes near the centre another renderer may take the other side: vertices are snapped to a
fraction of a pixel, spheres are polygons. Few pixels are uncertain, but each throws a streak across
the picture, which no other parameter explains. The light pass is linear in the mask, so that the
residual is a sum of such streaks. Least squares over the edge pixels, one unknown for each,
recovers the mask.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from godfit.inference.observation import Picture
from godfit.inference.problem import SEARCH_PIXELS, Problem
from godfit.inference.settle import settle
from godfit.inference.solver import solve, tangent_at
from godfit.inference.strategy import Report, refined_mask, starting_points
from godfit.io.filters import shrink
from godfit.io.image import LEVELS
from godfit.models.mitchell import Mitchell
from godfit.scattering.radial.coordinates import to_pixels
from godfit.scenes.scene import Scene
from godfit.scenes.view import drawn_mask
from godfit.search import beyond_light, density_minima
from godfit.search.multigrid import climb

if TYPE_CHECKING:
    from scipy import sparse

EDGE_ROUNDS = 4
"""Rounds of fitting and settling edge pixels, at most: they end once the mask stays."""
STREAK_TRIMS = 4
"""Times that pixels crossed by a streak are left out and the rest is solved."""
TRIMMED_PIXELS = 8192
"""Pixels of these solves: enough remain after those under streaks are left out."""
ROUNDING_LEVELS = 0.3
"""Standard deviation of rounding to bytes, in levels."""
WRONG_MASK_LEVELS = 1.0
"""Levels that an edge pixel is off by at least where the mask is of the wrong kind."""
FLIP_LOG_ODDS = 3.0
"""Log-odds against a pixel falling the other way."""
EDGE_DISAGREEMENT = 0.05
"""Share of a pixel by which renderers disagree about where an edge is."""
LEAST_OTHER_SHARE = 0.1
"""Share of an edge pixel that its other colour must have for the pixel to be uncertain."""
NEAR_LIGHT_SHARE = 0.05
"""Share of the ray next to the light that is left out: its taps spread single texels over too many
pixels."""


@refined_mask.register
def settled_edges(
    model: Mitchell, problem: Problem, scene: Scene, given: dict[str, float], report: Report
) -> Picture:
    """The picture with the scene's mask that agrees with the target: anti-aliased, or hard with
    each edge pixel on the side that the target supports. The ``problem`` has the hard mask."""
    picture = problem.picture
    if scene.antialias:
        return picture
    report("edge pixels")
    if not problem.free.any():
        return picture
    whole_range, problem = problem, beyond_light.up_to_light(problem, given)
    begun = starting_points(problem, given)
    start = climb(problem.small, begun, lambda text: None).coordinates
    z = _sharp(problem, start)
    if beyond_light.may_lie_beyond([z], problem):
        problem = whole_range
        start = beyond_light.searched(problem, z, given, lambda text: None)[0]
        z = _sharp(problem, start)
    smooth = problem.replaced(picture=dataclasses.replace(picture, mask=drawn_mask(scene, True)))
    if scene.antialias is None:
        soft = _sharp(smooth, start)
        hard_off, soft_off = (
            np.abs(_residual(drawn, at)).max(-1) for drawn, at in ((problem, z), (smooth, soft))
        )
        # The wrong mask is off at every edge pixel, the right one at the uncertain few.
        threshold = max(
            4 * min(float(np.median(hard_off)), float(np.median(soft_off))), WRONG_MASK_LEVELS
        )
        if np.count_nonzero(soft_off > threshold) < np.count_nonzero(hard_off > threshold):
            return smooth.picture
    if not model.convention.plain:
        return picture
    uncertain = _UncertainEdges.of(np.atleast_3d(picture.mask), np.atleast_3d(smooth.picture.mask))
    as_drawn = problem
    for _ in range(EDGE_ROUNDS):
        picture = problem.picture
        z, _ = _solved_off_streaks(problem, z)
        mask = uncertain.settled(problem, z).reshape(picture.mask.shape)
        if (mask == picture.mask).all():
            break
        problem = problem.replaced(picture=dataclasses.replace(picture, mask=mask))
    drawn, settled = (
        settle(z, one, one.observe(SEARCH_PIXELS))[0].log_likelihood for one in (as_drawn, problem)
    )
    # Where most of the rays near the light are clipped, streaks can be mistaken for each other.
    return problem.picture if settled > drawn else as_drawn.picture


def _sharp(problem: Problem, start: np.ndarray) -> np.ndarray:
    """Coordinates in the right minimum of density, from the pixels that no streak crosses."""
    picture = problem.picture
    z, off_streak = _solved_off_streaks(problem, start)
    trimmed = dataclasses.replace(picture, valid=picture.valid & off_streak)
    problem = problem.replaced(picture=trimmed)
    return density_minima.on_subset(problem, z, lambda text: None)[0]


def _solved_off_streaks(problem: Problem, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates solved from the pixels that no streak crosses, which have an ordinary residual;
    and (h, w) where these pixels are."""
    picture = problem.picture
    pixels = picture.informative(TRIMMED_PIXELS, problem.seed)
    off_streak = picture.valid
    for _ in range(STREAK_TRIMS):
        off = np.abs(_residual(problem, z)).max(-1)
        usual = 4 * float(np.median(off.reshape(-1)[pixels]))
        off_streak = off <= max(usual, 2 * ROUNDING_LEVELS)
        ordinary = pixels[off_streak.reshape(-1)[pixels]]
        # Repeated to the same number, so that nothing is compiled anew.
        observation = picture.observe(np.sort(np.resize(ordinary, len(pixels))))
        z = solve(z, problem, observation, ROUNDING_LEVELS).coordinates
    return z, off_streak


def _residual(problem: Problem, z: np.ndarray) -> np.ndarray:
    """(h, w, c) target minus fitted in levels, 0 where ignored or clipped."""
    picture = problem.picture
    fitted = picture.rendered(problem.at(z))
    known = picture.valid & ~picture.clipped
    return np.where(known[..., None], picture.levels - fitted, 0.0)


@dataclasses.dataclass(frozen=True, eq=False)
class _UncertainEdges:
    """Uncertain edge pixels: (k,) rows and columns in the ``hard`` mask (h, w, c), the change
    (k, c) of each if it falls on the other side, and the share of the pixel on that side."""

    hard: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    change: np.ndarray
    share: np.ndarray

    @staticmethod
    def of(hard: np.ndarray, smooth: np.ndarray) -> _UncertainEdges:
        """From the hard and the smooth mask (h, w, c). The other colour of a pixel is that of the
        neighbour that explains the largest share of it."""

        rows, columns = np.nonzero((smooth != hard).any(-1))
        h, w = hard.shape[:2]
        here, mean = hard[rows, columns], smooth[rows, columns]
        change, largest = np.zeros_like(here), np.zeros(len(here))
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                other = hard[np.clip(rows + i, 0, h - 1), np.clip(columns + j, 0, w - 1)] - here
                square = (other**2).sum(-1)
                share = ((mean - here) * other).sum(-1) / np.where(square > 0, square, 1)
                # A share above 1 means that the pixel contains a third colour, further away.
                closer = (square > 0) & (share > largest) & (share <= 1)
                change, largest = (
                    np.where(closer[:, None], other, change),
                    np.where(closer, share, largest),
                )
        keep = largest > LEAST_OTHER_SHARE
        return _UncertainEdges(hard, rows[keep], columns[keep], change[keep], largest[keep])

    def settled(self, problem: Problem, z: np.ndarray) -> np.ndarray:
        """The mask (h, w, c) with every uncertain pixel on the side that the residual supports."""
        from scipy import sparse

        picture, fitted = problem.picture, problem.at(z)
        assert isinstance(fitted, Mitchell)
        residual = _residual(problem, z)
        channels, size = residual.shape[-1], self.hard.shape[:2]
        # A streak is not visible where the target or the fitted picture is clipped.
        visible = picture.valid & ~picture.clipped
        visible &= (picture.rendered(fitted) < LEVELS).all(-1)
        visible = shrink(visible.astype(np.float32), size).reshape(-1, 1) == 1
        residual = np.where(visible, shrink(residual, size).reshape(-1, channels), 0.0)
        streaks = sparse.csr_array(self._streaks(fitted) * visible)
        now = np.atleast_3d(picture.mask)[self.rows, self.columns]
        taken = ((now - self.hard[self.rows, self.columns]) * self.change).sum(-1)
        taken = taken / (self.change**2).sum(-1)
        # The residual as it would be with no pixel on the other side.
        residual = residual + streaks @ (taken[:, None] * self.change)
        noise = max(ROUNDING_LEVELS, 1.5 * float(np.median(np.abs(residual))))
        gram = (streaks.T @ streaks).toarray() * (self.change @ self.change.T)
        pull = ((streaks.T @ residual) * self.change).sum(-1)
        # The other parameters adapt: the part of a streak that they explain is projected out.
        slopes = self._slopes(problem, z) * visible[..., None]
        cross = np.einsum("kcp,kc->kp", self._gather(streaks, slopes), self.change)
        inner = np.einsum("mcp,mcq->pq", slopes, slopes)
        adapted = np.linalg.lstsq(inner, cross.T, rcond=1e-6)[0]
        gram -= cross @ adapted
        pull -= np.einsum("mcp,mc->p", slopes, residual) @ adapted
        # The prior of each pixel's part on the other side: 0 with a standard deviation of 1/2.
        part = np.linalg.solve(gram + 4 * noise**2 * np.eye(len(pull)), pull)
        evidence = (2 * part - 1) * np.diag(gram) / (2 * noise**2)
        flipped = evidence > FLIP_LOG_ODDS + (1 - 2 * self.share) / (2 * EDGE_DISAGREEMENT)
        mask = self.hard.copy()
        mask[self.rows, self.columns] += flipped[:, None] * self.change
        return mask

    @staticmethod
    def _gather(streaks: sparse.csr_array, slopes: np.ndarray) -> np.ndarray:
        """(k, c, p) inner products of every streak with every slope."""
        flat = streaks.T @ slopes.reshape(len(slopes), -1)
        return flat.reshape(-1, *slopes.shape[1:])

    def _slopes(self, problem: Problem, z: np.ndarray) -> np.ndarray:
        """(h w, c, p) derivatives of the light pass's pixels by the free coordinates, scaled."""
        picture, free = problem.picture, problem.free
        everywhere = picture.observe(np.arange(picture.size[0] * picture.size[1]))
        slopes = tangent_at(z, problem, everywhere).jacobian[free].T
        slopes = slopes.reshape(*picture.size, -1)
        slopes = shrink(slopes, self.hard.shape[:2])
        return slopes.reshape(-1, picture.channels, int(free.sum())).astype(np.float64)

    def _streaks(self, model: Mitchell) -> sparse.csr_array:
        """(h w, k) levels that each pixel of the light pass gains with a unit of each texel."""
        from scipy import sparse

        h, w = self.hard.shape[:2]
        entries = []
        texels = np.arange(len(self.rows))
        for light in model.light:
            light_x, light_y = (float(z) for z in to_pixels(light, h, w))
            for t, weight in _weights(model):
                # Pixels that read texel p at t lie within one texel of (p - t light) / (1 - t).
                x, y = (
                    (p - t * centre) / (1 - t)
                    for p, centre in ((self.columns, light_x), (self.rows, light_y))
                )
                # Beyond the light the mask is mirrored: 1 - t is below 0.
                scale = abs(1 - t)
                reach = int(np.ceil(1 / scale))
                steps = np.arange(-reach, reach + 1)
                column = (np.round(x)[:, None, None] + steps[None, None, :]).astype(int)
                row = (np.round(y)[:, None, None] + steps[None, :, None]).astype(int)
                part = np.maximum(0, 1 - scale * np.abs(column - x[:, None, None]))
                part = part * np.maximum(0, 1 - scale * np.abs(row - y[:, None, None]))
                inside = (part > 0) & (column >= 0) & (column < w) & (row >= 0) & (row < h)
                which = np.broadcast_to(texels[:, None, None], part.shape)[inside]
                entries.append((weight * part[inside], (row * w + column)[inside], which))
        values, pixels, which = (np.concatenate(z) for z in zip(*entries, strict=True))
        shape = (h * w, len(texels))
        return sparse.csr_array(sparse.coo_array((LEVELS * values, (pixels, which)), shape=shape))


def _weights(model: Mitchell):
    """(t, weight) of every tap, the pixel's own among them."""
    (taps,) = model.convention.taps(
        model.exposure, model.decay, model.density, model.weight, model.samples
    )
    yield 0.0, float(taps.own)
    for k in range(1, taps.count + 1):
        t = (k - float(taps.lag)) * float(taps.step)
        if abs(1 - t) > NEAR_LIGHT_SHARE:
            yield t, float(taps.first) * float(taps.ratio) ** (k - 1)
