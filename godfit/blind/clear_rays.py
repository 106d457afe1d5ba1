"""Rays that meet nothing on their way, or nothing that is not known, show the disc alone.

Where any ray may meet an object, shadows explain almost any light: place, radius and density trade
until single texels of the disc's rim tell them apart. Along clear rays no object has a say: there
the right disc, cut into texels as the renderer cut it, leaves several times less than any other,
but only within an eighth of a texel, half a tap of the density and a hundredth of the radius. So
sharp a dip cannot be gone down, and all of them are tried. Texels join in the order of how far they
are from the light, so that one pass over the taps gives the sums for every radius; gain and
attenuation are solved for (variable projection: Golub & Pereyra, SIAM J. Numer. Anal. 10 (1973),
413).
"""

from __future__ import annotations

import functools
import itertools
from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.special import factorial

from godfit.blind.disc_sums import best_discs, disc_sums, is_clear, open_sums
from godfit.blind.occluders import light_read, texels_of
from godfit.blind.turns import Read, Turns
from godfit.inference.evaluate import model_at, taps_of
from godfit.io.filters import shrink
from godfit.io.image import LEVELS
from godfit.models.background import terms
from godfit.models.coordinates import DENSITY, GAIN, KAPPA, LIGHT_X, LIGHT_Y, RADIUS, VEIL
from godfit.models.disc_light import DiscLight
from godfit.runtime.parallel import parallel_map

# Clear rays that are asked at first and later, least, and pixels among which they are looked for.
FEW, MORE, LEAST, AMONG = 300, 1000, 150, 8192
# Texels from where one was found to which lights are tried, and by which lights, radii and, at a
# pass's height from the light, ends of rays are apart.
FAR, APART, THIN, DENSE = 1.25, 0.25, 0.125, 1.5
# Discs by how much smaller and larger, if seen from as far, how far densities are off for one that
# is as large, and by what factor radii are.
SMALLER, LARGER, NEARBY, OFF = 0.5, 1.3, 0.04, 1.08
# Radii, in heights of the pass, most: what is larger fills the picture.
LARGEST = 0.5
# Of the best, what is looked at more closely, and how often, twice as closely each time.
CLOSER, TIMES = 12, 3
# Of these, under how many every density is tried, from how far off, and how many dips apart.
COMBED, COMB, TEETH = 4, 0.1, 0.25
# Radii from the light where rays that say something of the disc end, most.
SHORT = 1.5
# What is left of the usual by a disc that stands out, most.
STANDS = 0.75
# Share of the rays that are explained worst and left out, for something hidden stands in their way,
# and discs that judge.
ODD, JUDGES = 0.15, 8
# By how much shadows have changed what is not known, and texels about that, and about what stands
# in the way, that are not either.
CHANGED, ABOUT = 0.1, 2
# Levels that are as good as none, and by how much, of all it is, a veil varies that does.
LEVEL, VARIES = 0.1, 1e-3
# Powers to which attenuation is expanded, by how much it grows along a ray, at first and later.
POWER, GROWN, LATER = 3, np.linspace(-1.2, 1.2, 13), np.linspace(-0.8, 0.8, 9)


class Disc(NamedTuple):
    """What one leaves of the levels (rms), its light's column and row and its radius, in texels,
    the density, its gain as a multiple of what it was and by what the attenuation grows."""

    left: float
    column: float
    row: float
    radius: float
    density: float
    gain: float
    kappa: float


class Starts(NamedTuple):
    """Row-major ``pixels`` (n,) of the picture, at columns ``x`` and rows ``y`` (n,) in texels of a
    pass that are ``open_`` (h, w), and those through which rays are ``avoided`` (h, w)."""

    pixels: np.ndarray
    x: np.ndarray
    y: np.ndarray
    avoided: np.ndarray
    open_: np.ndarray


class Rays(NamedTuple):
    """Columns ``x`` and rows ``y`` (n,) where rays start, in texels of a pass that are ``open_``
    (h, w), and whether (n,) their way is ``clear``; ``levels`` (n,) and ``terms`` (n, k) of the
    background there; by how many parts a side texels at the rim are ``cut``; what a disc
    ``usual``ly leaves."""

    x: np.ndarray
    y: np.ndarray
    clear: np.ndarray
    levels: np.ndarray
    terms: np.ndarray
    open_: np.ndarray
    cut: int
    usual: float = 1.0

    def only(self, which) -> Rays:
        x, y, clear, levels, terms = (a[which] for a in self[:5])
        return self._replace(x=x, y=y, clear=clear, levels=levels, terms=terms)


def seen_clearly(turns: Turns, read: Read, cut: int, clear: bool, shaded: bool) -> list[np.ndarray]:
    """Coordinates (p,) of the disc about that of ``read`` that stands out most along ``clear``
    rays; none where too few are clear, or none stands out. A texel at its rim is in or out, or a
    mean of ``cut`` by ``cut`` parts that are. Where rays that are partly ``shaded`` are asked, also
    of the disc that stands out most along these: what is in their way is as first seen, but for
    where shadows have changed that, which they avoid.

    Where glare leaves nothing else of the disc, also rays that are clipped in some channels start:
    there it is so bright that among discs as far apart as these the right one may be missed.
    """
    picture = turns.picture
    found: list[np.ndarray | None] = []
    if clear:
        found.append(_seen(turns, read, cut, picture.valid & ~picture.clipped, False))
        if found[0] is None and (picture.readable & picture.clipped).any():
            found.append(_seen(turns, read, cut, picture.readable, False))
    if shaded:
        found.append(_seen(turns, read, cut, picture.readable, True))
    return [z for z in found if z is not None]


def _seen(
    turns: Turns, read: Read, cut: int, usable: np.ndarray, shaded: bool
) -> np.ndarray | None:
    """The same by rays of one kind, from pixels that are ``usable`` (h, w)."""
    z, free = read.point.coordinates, turns.free
    h, w = read.mask.shape[:2]
    at = model_at(z, turns.held, turns.model)
    starts = _starts(turns, read, at, usable, shaded)
    column, row = np.asarray(at.light[0], np.float64) * (w, -h) + (-0.5, h - 0.5)
    dense = DENSE / h
    away = np.arange(-FAR, FAR + APART / 2, APART)
    columns, rows = np.unique(column + away * free[LIGHT_X]), np.unique(row + away * free[LIGHT_Y])

    def about(pair: tuple[float, float]) -> tuple[Disc, Rays] | None:
        density, radius = pair
        rays = _clear_rays(turns, starts, at, (column, row), density, radius, cut)
        if len(rays.x) < LEAST:
            return None
        radii = np.arange(radius / OFF, radius * OFF, THIN) if free[RADIUS] else np.array([radius])
        tried = _tried(turns, z, rays.only(slice(FEW)), density, 0.0, GROWN)
        first = sorted(tried(columns[::2], rows[::2], radii))[:JUDGES]
        rays = rays.only(_usual(turns, z, rays, first))
        tried = _tried(turns, z, rays.only(slice(FEW)), density, 0.0, GROWN)
        all_ = tried(columns, rows, radii)
        usual = float(np.median([disc.left for disc in all_]))
        return min(all_), rays._replace(usual=usual)

    pairs = _sizes(float(at.shading.density), float(at.shape[0]) * h, dense, free)
    pairs = [(density, radius) for density, radius in pairs if radius < LARGEST * h]
    found = [each for each in parallel_map(about, pairs) if each is not None]
    if not found:
        return None
    # Where hardly any disc fits, anything stands out.
    usual = float(np.median([rays.usual for _, rays in found]))
    if usual < LEVEL:
        return None
    found = [(disc, rays._replace(usual=min(rays.usual, usual))) for disc, rays in found]
    found = _closer(turns, z, sorted(found, key=_stands_out)[:CLOSER])
    if free[DENSITY]:
        # Light and radius show before the density is right to a part of a tap.
        combed = parallel_map(functools.partial(_combed, turns, z), _apart(found)[:COMBED])
        found = sorted(found + _closer(turns, z, combed), key=_stands_out)
    if _stands_out(found[0]) > STANDS:
        return None
    best, _ = found[0]
    z = z.copy()
    z[LIGHT_X], z[LIGHT_Y] = (best.column + 0.5) / w, 1 - (best.row + 0.5) / h
    z[RADIUS], z[DENSITY] = best.radius / h, best.density
    z[KAPPA] += best.kappa
    z[GAIN] *= best.gain
    return turns.inside(z)


def _closer(turns: Turns, z: np.ndarray, found: list[tuple[Disc, Rays]]):
    """These, best first, after what lies beside them was looked at, twice as closely each time."""
    free, steps, share = turns.free, np.array([-1.0, 0.0, 1.0]), 1.0

    def closer(each: tuple[Disc, Rays]) -> tuple[Disc, Rays]:
        disc, rays = each
        columns, rows = (
            np.unique(c + share * APART * steps * free[i])
            for c, i in ((disc.column, LIGHT_X), (disc.row, LIGHT_Y))
        )
        radii = np.unique(disc.radius + share * THIN * np.arange(-4, 5) * free[RADIUS])
        dense = DENSE / rays.open_.shape[0]
        densities = np.unique(disc.density + share * dense * steps * free[DENSITY]).clip(0, 1)
        near = [
            _tried(turns, z, rays, d, disc.kappa, share * LATER)(columns, rows, radii)
            for d in densities
        ]
        return min(itertools.chain.from_iterable(near)), rays

    for _ in range(TIMES):
        share /= 2
        found = parallel_map(closer, found)
    return sorted(found, key=_stands_out)


def _apart(found: list[tuple[Disc, Rays]]) -> list[tuple[Disc, Rays]]:
    """These without those of nearly the light and the radius of one before them."""
    kept: list[tuple[Disc, Rays]] = []
    for disc, rays in found:
        here = np.array(disc[1:4])
        if all(np.abs(here - other[1:4]).max() > APART / 2 for other, _ in kept):
            kept.append((disc, rays))
    return kept


def _combed(turns: Turns, z: np.ndarray, each: tuple[Disc, Rays]) -> tuple[Disc, Rays]:
    """The best disc of the same light and nearly the same radius under densities about its own."""
    disc, rays = each
    by = TEETH * disc.density / turns.model.samples
    densities = disc.density + by * np.arange(-np.ceil(COMB / by), COMB / by + 1)
    radii = disc.radius + THIN / 2 * np.arange(-2, 3) * turns.free[RADIUS]
    few = rays.only(slice(FEW))
    tried = (
        _tried(turns, z, few, d, disc.kappa, LATER)([disc.column], [disc.row], np.unique(radii))
        for d in densities
        if 0 < d <= 1
    )
    return min(itertools.chain.from_iterable(tried)), rays


def looks_alike(read: Read, other: Read) -> bool:
    """Whether ``other``, of a light pass of the same size, is so near that the same is looked at
    from there."""
    if read.mask.shape != other.mask.shape:
        return False
    z, there = read.point.coordinates, other.point.coordinates
    h, w = read.mask.shape[:2]
    off = np.abs((z - there)[[LIGHT_X, LIGHT_Y]] * (w, h)).max()
    larger = max(z[RADIUS] / there[RADIUS], there[RADIUS] / z[RADIUS])
    denser = abs(z[DENSITY] - there[DENSITY])
    return bool(off < FAR / 4 and larger < np.sqrt(OFF) and denser < NEARBY / 2)


def _stands_out(each: tuple[Disc, Rays]) -> float:
    """What a disc leaves of what is usually left. Where there is no light nothing is left."""
    disc, rays = each
    return (disc.left + LEVEL) / (rays.usual + LEVEL)


def _tried(turns: Turns, z: np.ndarray, rays: Rays, density: float, kappa: float, grown):
    """What finds the best discs of some radii (r,), at each of some columns and rows, by least
    squares."""
    t, c = _taps(turns, z, density, kappa)
    basis = np.ascontiguousarray(np.linalg.qr(_under(rays, z, t, c))[0].T)
    goal = rays.levels - (basis @ rays.levels) @ basis
    grown = np.unique(np.maximum(grown / density, -z[KAPPA] - kappa) * turns.free[KAPPA])
    powers = np.arange(POWER + 1)
    expanded = (-grown[:, None]) ** powers / factorial(powers)

    def tried(columns, rows, radii) -> list[Disc]:
        lights = np.array(list(itertools.product(columns, rows)))
        best = best_discs(
            rays.x, rays.y, rays.clear, rays.open_, lights, t, c, radii, rays.cut, goal, basis,
            expanded,
        )  # fmt: skip
        left = np.sqrt(np.maximum(goal @ goal - best[:, 0], 0) / len(goal))
        radius, more = radii[best[:, 2].astype(int)], grown[best[:, 3].astype(int)]
        # What is as bright at the end of the ray, where the disc is.
        gain = best[:, 1] * np.exp(more * t[-1])
        each = zip(left, *lights.T, radius, gain, kappa + more, strict=True)
        return [Disc(left, x, y, radius, density, *rest) for left, x, y, radius, *rest in each]

    return tried


def _under(rays: Rays, z: np.ndarray, t: np.ndarray, c: np.ndarray) -> np.ndarray:
    """(n, k) what lies under what the disc adds: the background and, where objects stand in its
    way, the veil."""
    h, w = rays.open_.shape
    if rays.clear.all():
        return rays.terms
    light = np.array([z[LIGHT_X] * w - 0.5, (1 - z[LIGHT_Y]) * h - 0.5])
    veil = open_sums(rays.x, rays.y, rays.open_, light, t, c)
    if np.ptp(veil) < VARIES * np.abs(veil).max():
        return rays.terms
    return np.column_stack([rays.terms, veil])


def _sizes(density: float, radius: float, dense: float, free: np.ndarray) -> list[tuple]:
    """Densities, and with each a radius in texels: discs that are seen from as far, and discs that
    are as large."""
    if not free[DENSITY]:
        return [(density, radius)]
    most, least = 1 - SMALLER * (1 - density) + dense, 1 - LARGER * (1 - density) - dense
    steps = np.arange(np.ceil((least - density) / dense), (most - density) / dense)
    pairs = [(d, radius * (1 - d) / max(1 - density, dense)) for d in density + dense * steps]
    steps = np.arange(-np.ceil(NEARBY / dense), NEARBY / dense + 1)
    pairs += [(d, radius) for d in density + dense * steps]
    return [(d, r) for d, r in pairs if 0 < d <= 1 and r > 0]


def _starts(turns: Turns, read: Read, at: DiscLight, usable: np.ndarray, shaded: bool) -> Starts:
    """Where rays may start, of pixels that are ``usable`` (h, w), in no order."""
    picture, size = turns.picture, read.mask.shape[:2]
    rng = np.random.default_rng(turns.seed)
    pixels = rng.permutation(np.flatnonzero(usable))
    # As first seen: of objects that glare hides there are few.
    open_ = shrink(np.asarray(picture.mask), size)
    if shaded:
        avoided = (np.abs(read.mask - open_) > CHANGED) & ~np.asarray(at.rim(size))
    else:
        avoided, open_ = open_ < 0.5, np.ones(size)
    avoided = ndimage.binary_dilation(avoided, iterations=ABOUT)
    return Starts(pixels, *texels_of(pixels, picture.size, size), avoided, open_.astype(np.float64))


def _clear_rays(
    turns: Turns, starts: Starts, at: DiscLight, light, density: float, radius: float, cut: int
) -> Rays:
    """Rays that reach the disc, or nearly, and meet nothing that is to be avoided."""
    pixels, x, y, avoided, open_ = starts
    light, samples = np.asarray(light), turns.model.samples
    near = (1 - density) * np.hypot(x - light[0], y - light[1]) < SHORT * radius
    near = np.flatnonzero(near)[:AMONG]
    known = near[is_clear(x[near], y[near], light, density, samples, avoided)][:MORE]
    solid = ndimage.binary_dilation(open_ < 1, iterations=ABOUT + 1)
    clear = is_clear(x[known], y[known], light, density, samples, solid)
    back = terms(pixels[known], turns.picture.size, at.background.shape[0])
    levels, _ = light_read(at, turns.picture, pixels[known])
    return Rays(x[known], y[known], clear, levels, np.asarray(back), open_, cut)


def _taps(turns: Turns, z: np.ndarray, density: float, kappa: float):
    """Places and weights (k,), in levels, of what the disc adds."""
    z = z.copy()
    z[DENSITY] = density
    z[KAPPA] = max(z[KAPPA] + kappa, 0.0)
    there = model_at(z, turns.held, turns.model)
    t, c = (np.asarray(a, np.float64) for a in taps_of(there))
    return t, c * (z[GAIN] / max(z[GAIN] + z[VEIL], 1e-9) * LEVELS)


def _usual(turns: Turns, z: np.ndarray, rays: Rays, discs: list[Disc]) -> np.ndarray:
    """Which rays (n,) these discs, none of which need be right, explain as they do the most."""
    off = []
    for disc in discs:
        t, c = _taps(turns, z, disc.density, disc.kappa)
        place, radii = np.array([disc.column, disc.row]), np.array([disc.radius])
        sums = disc_sums(rays.x, rays.y, rays.clear, rays.open_, place, t, c, radii, rays.cut, 0)
        design = np.column_stack([_under(rays, z, t, c), sums[:, 0, 0]])
        found = np.linalg.lstsq(design, rays.levels, rcond=None)[0]
        off.append(np.abs(rays.levels - design @ found))
    off = np.median(off, 0)
    return off <= np.quantile(off, 1 - ODD)
