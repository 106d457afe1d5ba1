"""Light and shadows together: against a general minimiser, and back from beside the truth."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import minimize

from godfit.blind import around, beside, elsewhere, first_look, glare, occluders, unaided
from godfit.blind import edge as edges
from godfit.blind import lasso as lasso_module
from godfit.blind.lasso import Along, lasso
from godfit.blind.occluders import FLIP, PULL, _sums, asked, light_read, price
from godfit.blind.turns import Read, Turns
from godfit.inference.evaluate import predicted
from godfit.inference.observation import Picture
from godfit.inference.solver import Point
from godfit.models.coordinates import DENSITY, EDGE, GAIN, LIGHT_X, LIGHT_Y, RADIUS, VEIL
from godfit.models.disc_light import DiscLight
from godfit.models.mitchell import Mitchell

SIZE = (90, 160)


@pytest.mark.parametrize("moving", [0, 3])
@pytest.mark.parametrize("flip", [0.0, 2.0])
def test_shadows_and_what_moves_along_are_the_best_together(moving, flip):
    """Against a general minimiser of the same function, texels split into what they open and what
    they close, so that it is smooth."""
    rng = np.random.default_rng(moving)
    design = sparse.csc_matrix(sparse.random_array((300, 40), density=0.2, rng=rng))
    moves, weight = rng.normal(size=(300, moving)), rng.uniform(0.2, 1, 300)
    goal = design @ rng.uniform(-0.5, 1.5, 40) + moves @ rng.normal(size=moving)
    thought, pull, noise = rng.uniform(size=40), 0.7, 0.5

    def function(z):
        opened, closed, step = z[:40], z[40:80], z[80:]
        change = opened - closed
        off = design @ (thought + change) + moves @ step - goal
        value = (weight * off**2).sum() + pull**2 * (change**2).sum() + noise**2 * (step**2).sum()
        slope = design.T @ (weight * off) + pull**2 * change
        by_step = moves.T @ (weight * off) + noise**2 * step
        return value / 2 + flip * (opened + closed).sum(), np.r_[
            slope + flip, flip - slope, by_step
        ]

    bounds = [(0, 1 - t) for t in thought] + [(0, t) for t in thought] + [(None, None)] * moving
    options = {"maxiter": 10_000, "maxfun": 100_000, "ftol": 1e-15, "gtol": 1e-9, "maxcor": 50}
    best = minimize(
        function, np.zeros(80 + moving), jac=True, method="L-BFGS-B", bounds=bounds, options=options
    ).x
    along = Along(moves, weight, noise)
    share = lasso(design, goal, along, thought, thought, pull**2, flip, short=1e-9)
    np.testing.assert_allclose(share, thought + best[:40] - best[40:80], atol=1e-5)
    np.testing.assert_allclose(along.step(goal - design @ share), best[80:], atol=1e-5)
    # Some are at either bound and, where changes cost by their size, some as they were thought.
    assert (share == 0).any()
    assert (share == 1).any()
    assert (share == thought).any() == (flip > 0)


def test_shares_that_are_nearly_alike_are_found(monkeypatch):
    """Texels along one ray add almost the same: one after the other they creep for thousands of
    sweeps, together they are found in a few."""
    rng = np.random.default_rng(0)
    apart = np.abs(np.arange(120)[:, None] * 4 - np.arange(480)) < 60
    design = sparse.csc_matrix(apart.T * rng.uniform(0.9, 1.1, (480, 120)))
    truth = np.where(rng.uniform(size=120) < 0.3, rng.uniform(0, 1, 120), 1)
    goal = design @ truth + 0.1 * rng.normal(size=480)
    along = Along(np.zeros((480, 0)), np.ones(480), 1.0)
    thought, pull, flip = np.ones(120), 1e-3, 0.05

    def cost(share):
        off, change = goal - design @ share, share - 1
        # None is more than it was thought to be, so that what it costs has one slope.
        slope = -design.T @ off + pull * change - flip
        return (off @ off + pull * change @ change) / 2 - flip * change.sum(), slope

    bounds = [(0, 1)] * 120
    options = {"maxiter": 100_000, "maxfun": 100_000, "ftol": 1e-15, "gtol": 1e-9}
    best = minimize(cost, thought, jac=True, bounds=bounds, options=options)
    above = []
    for many in (lasso_module.MANY, 0):
        monkeypatch.setattr(lasso_module, "MANY", many)
        found = lasso(design, goal, along, thought, thought, pull, flip)
        above.append((cost(found)[0] - best.fun) / flip)
    solved, swept = above
    assert solved < 0.25
    assert swept > 0.5


def test_many_shares_are_swept_while_that_is_worth_it(monkeypatch):
    """What is left, the best step taken, is that of plain least squares; where a batch of sweeps
    takes less than its share of that, no other follows."""
    rng = np.random.default_rng(1)
    apart = np.abs(np.arange(120)[:, None] * 4 - np.arange(480)) < 60
    design = sparse.csc_matrix(apart.T * rng.uniform(0.9, 1.1, (480, 120)))
    goal = design @ rng.uniform(0, 1, 120) + rng.normal(size=480)
    moves, weight = rng.normal(size=(480, 3)), rng.uniform(0.2, 1, 480)
    along = Along(moves, weight, 0.5)
    residual = goal - design @ np.ones(120)
    rows = np.concatenate([np.sqrt(weight)[:, None] * moves, 0.5 * np.eye(3)])
    aim = np.concatenate([np.sqrt(weight) * residual, np.zeros(3)])
    off = aim - rows @ np.linalg.lstsq(rows, aim, rcond=None)[0]
    left = along.left(weight * residual, along.step(residual))
    assert left == pytest.approx(off @ off / 2, rel=1e-9)

    lefts: list[float] = []
    asked = Along.left
    monkeypatch.setattr(lasso_module, "MANY", 0)
    monkeypatch.setattr(Along, "left", lambda *a: lefts.append(asked(*a)) or lefts[-1])
    for headway in (0.0, 0.01):
        monkeypatch.setattr(lasso_module, "HEADWAY", headway)
        lefts.clear()
        lasso(design, goal, along, np.ones(120), np.ones(120), 1e-3, 1e-6, short=1e-9)
        assert len(lefts) == lasso_module.SWEEPS or headway
    gains = 1 - np.array(lefts[1:]) / lefts[:-1]
    assert 1 < len(lefts) < lasso_module.SWEEPS
    assert (gains[:-1] >= 0.01).all()
    assert gains[-1] < 0.01


@pytest.mark.parametrize("scale", [1, 2])
def test_what_every_texel_adds_is_the_light_pass(scale):
    """Known and unknown texels together, of a pass of the picture's size and of half of it."""
    rng = np.random.default_rng(0)
    shading = Mitchell(0.06, 0.98, 0.8, 0.7, [0.45, 1.1], "dawntime", 40)
    model = DiscLight(shading, [0.3, 0.01, 0.06], np.zeros((1, 3)))
    low = SIZE[0] // scale, SIZE[1] // scale
    mask, unknown = rng.uniform(size=low), rng.uniform(size=low) < 0.4
    picture = Picture(
        np.zeros((*SIZE, 3), np.float32), 0.5, np.ones(SIZE, bool), mask, None, "none"
    )
    pixels = np.sort(rng.permutation(SIZE[0] * SIZE[1])[:500])
    texels = np.flatnonzero(unknown)
    known, design = _sums(model, pixels, picture, texels, np.arange(len(texels)))
    light = known + design @ mask[unknown] / 255
    right = model.light_pass(jnp.asarray(mask), size=SIZE, pixels=jnp.asarray(pixels))
    np.testing.assert_allclose(light, right, atol=1e-6)


@pytest.mark.usefixtures("single_precision")
def test_texels_of_a_large_mask_are_told_in_cells(monkeypatch):
    """What a cell adds is what its texels add together, and costs as much; none holds what was
    thought open and what was not, and those of the rim are told one by one."""
    picture, truth, turns = lit(1e-5, bar=True)
    thought = np.ones(SIZE, np.float32)
    thought[36:38, 62:91] = 0
    model = turns.model.moved(truth, turns.held)
    arguments = model, picture, turns.unknown, thought, 4000, 0
    single = asked(*arguments)
    monkeypatch.setattr(occluders, "TOLD", SIZE[0] // 3)
    question = asked(*arguments)
    texels, cell = question.texels, question.cell
    np.testing.assert_array_equal(texels, single.texels)
    assert cell.max() < len(texels) / 3
    of_cell = sparse.csr_matrix((np.ones(len(texels)), (np.arange(len(texels)), cell)))
    together = (single.design @ of_cell).toarray()
    np.testing.assert_allclose(question.design.toarray(), together, rtol=1e-5, atol=1e-4)
    for values in (thought.ravel()[texels], texels // SIZE[1] // 3, texels % SIZE[1] // 3):
        assert all(np.ptp(values[cell == c]) == 0 for c in range(cell.max() + 1))
    rim = np.asarray(model.rim(SIZE)).ravel()[texels]
    assert (np.bincount(cell)[cell[rim]] == 1).all()
    mask = question.answered().mask
    assert mask[34:40, 62:88].mean() < 0.2
    assert mask.mean() > 0.97


@pytest.mark.usefixtures("single_precision")
@pytest.mark.parametrize("scale", [1, 2])
def test_a_rim_may_be_cut_in_any_way(scale):
    """A disc a third of a texel larger than it is taken to be: texels outside it that are as bright
    as it are found from what they add, and what they cost is how much brighter they are."""
    shading = Mitchell(0.06, 0.98, 0.8, 0.7, [0.45, 0.6], "dawntime", 40)
    low = SIZE[0] // scale, SIZE[1] // scale
    open_, radii = np.ones(low, np.float32), (0.15, 0.15 + 0.35 / low[0])
    smaller, larger = (DiscLight(shading, [r, 1e-5, 0.06], np.zeros((1, 3))) for r in radii)
    levels = 255 * np.asarray(larger(jnp.asarray(open_), size=SIZE))
    levels = np.round(levels).clip(0, 255).astype(np.float32)
    picture = Picture(levels, 0.5, np.ones(SIZE, bool), open_, None, "none")
    question = asked(smaller, picture, np.zeros(low, bool), open_, 4000, 0)
    assert question is not None
    answer = question.answered()
    truth, thought, lit, again = (
        np.asarray(model.occlusion(jnp.asarray(mask)))
        for model, mask in (
            (larger, open_),
            (smaller, open_),
            (smaller, answer.mask),
            (smaller, question.answered(near=answer).mask),
        )
    )
    rim = truth != thought
    assert rim.sum() > 10
    # One round from an answer is no worse.
    for found in (lit, again):
        assert found.max() == 1
        assert np.abs(found - truth)[rim].mean() < 0.1 * np.abs(thought - truth)[rim].mean()
        assert np.abs(found - truth)[~rim].max() < 0.25
    brighter = np.where(rim, 1 / thought, 1)
    cost = rim.sum() * (FLIP * 0.94 + PULL / 2 * 0.94**2)
    np.testing.assert_allclose(price(smaller, brighter, open_, ~rim, 0.3), 0.3 * cost, rtol=1e-4)


def lit(edge, bar):
    """(picture of an open mask, coordinates of the truth, turns with edge and exposure held)."""
    shading = Mitchell(0.06, 0.98, 0.8, 0.7, [0.45, 0.6], "dawntime", 40)
    model = DiscLight(shading, [0.15, edge, 0.06], np.array([[0.1, 0.2, 0.3]]))
    open_ = np.ones(SIZE, np.float32)
    if bar:
        open_[34:40, 60:90] = 0
    levels = 255 * np.asarray(model(jnp.asarray(open_)))
    levels = np.round(levels).clip(0, 255).astype(np.float32)
    thought = np.ones_like(open_)
    picture = Picture(levels, 0.5, np.ones(SIZE, bool), thought, None, "none", 0.02)
    unknown = picture.clipped.copy()
    unknown[30:44, 56:94] = True
    truth = np.asarray(model.coordinates(), np.float32)
    held = np.full(len(truth), np.nan, np.float32)
    # The pixel's own value does not show, and edges are as sharp as they are.
    held[[0, EDGE]] = truth[0], truth[EDGE]
    turns = Turns(model, picture, unknown, 0.0, np.isnan(held), held, 0)
    return picture, truth, turns


@pytest.mark.usefixtures("single_precision")
def test_light_moves_along_with_the_shadows():
    """From beside the truth, with a bar in the glare of which only the shadows tell: each in turn,
    light and shadows wait for each other."""
    picture, truth, turns = lit(0.01, bar=True)
    model, unknown, held = turns.model, turns.unknown, turns.held
    start = truth.copy()
    start[4:7] += 0.006, -0.006, 0.01
    seen = picture.observe(picture.informative(4000, 0))
    together = apart = Read.of(Point(start, np.inf, False, 0), picture.mask, seen)
    for _ in range(4):
        together = turns.turn(together, turns.noise)
        at = model.moved(apart.point.coordinates, held)
        here = dataclasses.replace(picture, mask=apart.mask)
        question = asked(at, here, unknown, picture.mask, 4000, 0)
        assert question is not None
        mask = question.answered().mask
        apart = turns.descended(apart.with_mask(mask), turns.noise)

    def off(read):
        return np.abs(read.point.coordinates - truth)[4:7].max()

    assert off(together) < 0.3 * off(apart)
    assert off(together) < 0.002
    assert together.mask[34:40, 66:80].mean() < 0.3
    # What may not move stays where it is.
    still = dataclasses.replace(turns, free=np.zeros(len(truth), bool))
    shaded = still.shaded(together)
    assert np.array_equal(shaded.point.coordinates, together.point.coordinates)


def begun(turns, picture, z):
    """``turns`` with the edge of a disc that is drawn without anti-aliasing, and where they are
    after a first descent from ``z``."""
    held = turns.held.copy()
    held[EDGE] = edges.HARD / SIZE[0]
    turns = dataclasses.replace(turns, held=held)
    seen = picture.observe(picture.informative(4000, 0))
    read = Read.of(Point(z, np.inf, False, 0), picture.mask, seen)
    return turns, turns.descended(read, turns.noise)


@pytest.mark.usefixtures("single_precision")
@pytest.mark.parametrize("edge", [0.03, 1e-5], ids=["soft", "hard"])
def test_a_soft_edge_is_read_where_there_is_one(edge):
    picture, truth, turns = lit(edge, bar=False)
    turns, read = begun(turns, picture, truth)
    for soften in (edges.softened, edges.softer_at_once):
        softer, there = soften(turns, read)
        if edge > 1e-3:
            assert there.point.coordinates[EDGE] == pytest.approx(edge, rel=0.1)
            assert softer.total(there) < 0.5 * turns.total(read)
        else:
            assert softer is turns


@pytest.mark.parametrize(
    ("edge", "soft_left", "expected"), [(1e-4, 30, 50), (0.1, 30, 30), (0.1, 55, 50)]
)
def test_a_hard_edge_goes_on_from_where_a_soft_one_led(monkeypatch, edge, soft_left, expected):
    """A hard edge is stuck at 100; a soft one leads to where it leaves 50, and may leave less."""

    class Walk(Turns):
        noise = 1.0

        def __init__(self, turn, turned, at_edge):
            vars(self).update(left={"turn": turn, "turned": turned}, at_edge=at_edge)

        def to(self, read, how):
            z = read.point.coordinates.copy()
            elsewhere = z[RADIUS] == 0.5
            if self.at_edge is not None:
                z[RADIUS], z[EDGE] = 0.5, self.at_edge
            left = self.left[how] if self.at_edge is not None or elsewhere else 100
            return read._replace(point=Point(z, left, True, 1))

        def solved(self, read, _):
            return read

        def turn(self, read, _):
            return self.to(read, "turn")

        def turned(self, read, _):
            return self.to(read, "turned")

        def total(self, read):
            return read.point.cost

    hard, soft = Walk(60, 50, None), Walk(40, soft_left, edge)
    monkeypatch.setattr(edges, "with_edge", lambda turns, width: soft)
    mask = np.ones((100, 100), np.float32)
    begin = Read(Point(np.zeros(12, np.float32), 100, True, 1), mask, mask, None)
    turns, read = edges.softened(hard, begin)
    assert read.point.cost == expected
    assert turns is (soft if expected == soft_left else hard)
    # Where a soft edge explains no more, all stays as it is.
    soft.left["turn"] = 100
    assert edges.softened(hard, begin) == (hard, begin)


@pytest.mark.usefixtures("single_precision")
@pytest.mark.parametrize("known", [[DENSITY, RADIUS], [GAIN]], ids=["density and radius", "gain"])
def test_what_lies_beside_an_answer_is_found(known, monkeypatch):
    """From a light that is two texels off, with shadows that suit it, and what is known stays.
    Without clear rays and glare, which would tell at once, nor walks, which lead there too."""
    monkeypatch.setattr(around, "_walked", lambda place: place)
    monkeypatch.setattr(elsewhere, "seen_clearly", lambda *_: [])
    monkeypatch.setattr(glare, "circles", lambda *_: np.zeros((0, 3)))
    monkeypatch.setattr(beside, "BESIDE", {LIGHT_X: 1.3, DENSITY: 1.0, RADIUS: 0.2})
    picture, truth, turns = lit(1e-5, bar=True)
    held, free, z = turns.held.copy(), turns.free.copy(), truth.copy()
    held[known], free[known] = truth[known], False
    if GAIN in known:
        held[GAIN] = float(turns.model.shading.weight)
    turns = dataclasses.replace(turns, held=held, free=free)
    z[LIGHT_X] += 2 / SIZE[1]
    still = dataclasses.replace(turns, free=free & (np.arange(len(z)) != LIGHT_X))
    still, stuck = begun(still, picture, z)
    stuck = still.turned(stuck, 6)
    turns = dataclasses.replace(turns, held=still.held)
    _, read, _ = around.best_around(turns, [[stuck]], around=True)
    with monkeypatch.context() as patch:
        patch.setattr(beside, "BESIDE", {})
        _, alone, _ = around.best_around(turns, [[stuck]], around=True)
    off = np.abs(read.point.coordinates - truth)
    assert turns.total(read) < 0.5 * turns.total(alone)
    assert off[[LIGHT_X, LIGHT_Y]].max() < 0.5 / SIZE[1]
    assert (off[[i for i in known if i != GAIN]] == 0).all()
    if not known:
        # What was found elsewhere is as good a start, but for what sums in float32 leave open.
        _, again, _ = around.best_around(turns, [[stuck], [read]], around=True)
        assert turns.total(again) <= (1 + 1e-6) * turns.total(read)


@pytest.mark.usefixtures("single_precision")
def test_the_middle_of_glare_is_held_until_its_shadows_suit_it(monkeypatch):
    """From a light that is eight texels off, farther than is looked beside."""
    monkeypatch.setattr(elsewhere, "seen_clearly", lambda *_: [])
    monkeypatch.setattr(beside, "BESIDE", {})
    for walk in ("along_gain", "along_density"):
        monkeypatch.setattr(around, walk, lambda turns, read, *step: (read, []))
    picture, truth, turns = lit(1e-5, bar=True)
    z = truth.copy()
    z[LIGHT_X] += 8 / SIZE[1]
    still = dataclasses.replace(turns, free=turns.free & (np.arange(len(z)) != LIGHT_X))
    still, stuck = begun(still, picture, z)
    turns = dataclasses.replace(turns, held=still.held)
    _, read, _ = around.best_around(turns, [[stuck]], around=True)
    assert np.abs(read.point.coordinates - truth)[[LIGHT_X, LIGHT_Y]].max() < 1 / SIZE[1]
    # One that is given stays.
    turns = dataclasses.replace(turns, free=still.free)
    _, read, _ = around.best_around(turns, [[stuck]], around=True)
    assert read.point.coordinates[LIGHT_X] == z[LIGHT_X]


@pytest.mark.usefixtures("single_precision")
def test_what_other_frames_tell_is_held_until_the_rest_suits_it(monkeypatch):
    """From a disc half as large again and as much less bright, whose density is another; where
    others are wrong what explains more stays."""
    monkeypatch.setattr(elsewhere, "seen_clearly", lambda *_: [])
    monkeypatch.setattr(glare, "circles", lambda *_: np.zeros((0, 3)))
    monkeypatch.setattr(beside, "BESIDE", {})
    for walk in ("along_gain", "along_density"):
        monkeypatch.setattr(around, walk, lambda turns, read, *step: (read, []))
    picture, truth, turns = lit(1e-5, bar=True)
    z = truth.copy()
    z[[RADIUS, GAIN, DENSITY]] *= 1.5, 1 / 1.5, 0.9
    still = dataclasses.replace(turns, free=turns.free & (np.arange(len(z)) != RADIUS))
    still, stuck = begun(still, picture, z)
    stuck = still.turned(stuck, 2)
    turns = dataclasses.replace(turns, held=still.held, free=turns.free & still.free)
    turns.free[RADIUS] = True
    shared = np.array(truth[:4])
    shared[0], shared[GAIN] = np.nan, truth[GAIN] + truth[VEIL]
    (alone, _), (right, off), (wrong, _) = (
        (turns.total(read), np.abs(read.point.coordinates - truth))
        for like in (None, shared, shared * [1, 3, 0.7, 3])
        for _, read, _ in [around.best_around(turns, [[stuck]], around=True, like=like)]
    )
    assert right < 0.5 * alone
    assert off[RADIUS] < 0.01 * truth[RADIUS]
    assert off[DENSITY] < 0.002
    assert wrong <= (1 + 1e-6) * alone


@pytest.mark.usefixtures("single_precision")
@pytest.mark.parametrize("terms", [1, 3], ids=["constant", "varying"])
def test_what_is_explained_may_leave_a_few_values(terms):
    """Nearly all of what is seen is off by what rounding leaves, twice where the background was
    rounded too, and the rest is not far off."""
    picture, _, turns = lit(1e-5, bar=False)
    model = DiscLight(
        turns.model.shading, turns.model.shape, np.full((terms, picture.channels), 0.1)
    )
    z = np.asarray(model.coordinates())
    held = np.full(len(z), np.nan, np.float32)
    turns = dataclasses.replace(turns, model=model, held=held)
    pixels = np.flatnonzero(~picture.clipped)[::7]
    seen, rng = picture.observe(pixels), np.random.default_rng(0)
    levels = np.asarray(predicted(z, turns.held, model, seen))
    off = rng.uniform(-0.5, 0.5, (min(terms, 2), len(levels))).sum(0)

    def explained(share, by, cost):
        far = rng.uniform(size=len(levels)) < share
        there = levels + off + by * far
        lo, hi = (jnp.asarray(there + side, jnp.float32) for side in (-0.5, 0.5))
        moved = dataclasses.replace(seen, lo=lo, hi=hi)
        read = Read.of(Point(z, cost * len(levels) / 24, True, 0), picture.mask, moved)
        return beside.Place(turns, read, (read,), {}, {}).explained

    # Of the sum of two roundings nine tenths nearly reach the limit.
    few = 0.04 if terms == 1 else 0.005
    assert explained(0.0, 0.0, 1.0)
    assert explained(few, 5.0, 2.4)
    assert not explained(few, 5.0, 2.6)
    assert not explained(0.2, 2.5, 1.0)


def test_radius_and_density_go_from_dip_to_dip(monkeypatch):
    """A radius and the density with which it is seen from as far, by whole taps of the density."""
    picture, truth, turns = lit(1e-5, bar=False)
    seen = picture.observe(np.arange(100))
    read = Read.of(Point(truth, 1.0, True, 0), picture.mask, seen)
    tried = []

    def turn(self, read, sigma):
        tried.append((self.free, read.point.coordinates))
        return read

    monkeypatch.setattr(Turns, "turn", turn)
    monkeypatch.setattr(Turns, "solved", lambda self, read, sigma: read)
    monkeypatch.setattr(Turns, "total", lambda self, read: 2.0 if len(tried) else 1.0)
    # .2 of what is left of the ray, .2, are 2 of 40 taps over a density of .8.
    for by, taps in ((0.2, -2), (-0.2, 2), (0.02, -1)):
        tried.clear()
        assert beside._dips(turns, read, RADIUS, by) == abs(taps)
        beside._beside(turns, read, RADIUS, abs(taps), by)
        free, z = tried[0]
        assert not free[[RADIUS, DENSITY]].any()
        assert z[DENSITY] == pytest.approx(0.8 * (1 + taps / 40))
        assert z[RADIUS] / (1 - z[DENSITY]) == pytest.approx(0.15 / 0.2)
        assert z[GAIN] * z[RADIUS] == pytest.approx(truth[GAIN] * 0.15)


def test_nearer_and_then_far_dips_are_looked_at_and_then_no_more(monkeypatch):
    """Along the density, from one beside which nothing is better, and again from one that is."""
    picture, truth, turns = lit(1e-5, bar=False)
    seen = picture.observe(np.arange(100))
    tried = []

    def beside_it(turns, read, index, dips, by):
        tried.append((dips, by))
        return worse

    best, worse, other = (
        Read.of(Point(truth, cost, True, 0), picture.mask, seen) for cost in (1.0, 2.0, 0.5)
    )
    monkeypatch.setattr(beside, "BESIDE", {DENSITY: 2.0})
    monkeypatch.setattr(beside, "_beside", beside_it)
    monkeypatch.setattr(Turns, "total", lambda self, read: read.point.cost)
    place = beside.place_of(turns, best)
    for expected in (2, 1, beside.FARTHER):
        assert not place.finished
        tried.clear()
        place = beside.looked_around(place)
        assert place.read is best
        assert [dips for dips, _ in tried] == [expected] * 2
        assert [np.sign(by) for _, by in tried] == [-1, 1]
    assert place.finished
    # From another answer all of it is to be looked at again.
    place, worse = place._replace(steps={DENSITY: 2.0}), other
    place = beside.looked_around(place)
    assert place.read is other
    assert place._replace(steps={DENSITY: 1.0}).dips(DENSITY) == 1


@pytest.mark.usefixtures("single_precision")
def test_each_size_of_pass_begins_from_the_disc_of_the_other(monkeypatch):
    picture, truth, turns = lit(1e-5, bar=False)
    moved = truth.copy()
    moved[[DENSITY, LIGHT_X, RADIUS, GAIN]] += 0.01
    seen = picture.observe(np.arange(100))
    whole = Read.of(Point(truth, 1.0, True, 0), picture.mask, seen)
    half = Read.of(Point(moved, 1.0, True, 0), picture.mask[::2, ::2], seen)
    places = [beside.place_of(turns, read) for read in (whole, half)]
    monkeypatch.setattr(
        elsewhere, "_suited", lambda turns, read, z: beside.place_of(turns, read.at(z))
    )
    first, second = (place.read for place in elsewhere.crossed(places))
    assert (first.mask.shape, second.mask.shape) == (whole.mask.shape, half.mask.shape)
    by_half, by_whole = first.point.coordinates, second.point.coordinates
    discs = [DENSITY, LIGHT_X, LIGHT_Y, RADIUS]
    np.testing.assert_array_equal(by_half[discs], moved[discs])
    np.testing.assert_array_equal(by_whole[discs], truth[discs])
    assert by_half[GAIN] == truth[GAIN]
    assert elsewhere.crossed(places[:1]) == []


def test_a_pixel_is_read_from_what_is_not_clipped_of_it():
    """On a background that clips in one channel, then in two, under "screen" too."""
    for shader in ("dawntime", "pmndrs"):
        shading = Mitchell(0.06, 0.98, 0.8, 0.7, [0.45, 0.6], shader, 40)
        model = DiscLight(shading, [0.15, 0.01, 0.06], [[0.1, 0.6, 0.9]])
        light = np.asarray(model.light_pass(jnp.ones(SIZE)))
        levels = 255 * np.asarray(model.composite(jnp.asarray(light), SIZE)).clip(0, 1)
        whole = np.ones(SIZE, bool)
        picture = Picture(levels.astype(np.float32), 1e-3, whole, whole, None, "none")
        pixels = np.flatnonzero(picture.readable)
        above = picture.above.reshape(-1, 3)[pixels].sum(1)
        read, weights = light_read(model, picture, pixels)
        np.testing.assert_allclose(read, 255 * light.reshape(-1)[pixels], atol=0.01)
        assert (weights[picture.above.reshape(-1, 3)[pixels]] == 0).all()
        if shader == "dawntime":
            assert set(above) == {0, 1, 2}
            assert not picture.readable.all()


def test_a_cell_that_is_clipped_in_part_in_any_channel_is_left_out():
    levels = np.full((2, 8, 2), 100, np.float32)
    # All of a cell in one channel, and of the other nothing, half and all of it.
    levels[:, 2:, 0] = 255
    levels[:, 4, 1] = levels[:, 6:, 1] = 255
    small = Picture(
        levels, 0.5, np.ones((2, 8), bool), np.ones((2, 8), np.float32), None, "none"
    ).shrunk(2)
    assert small.valid.tolist() == [[True, True, False, True]]
    assert small.clipped.tolist() == [[False, True, True, True]]
    assert small.readable.tolist() == [[True, True, False, False]]


def test_shares_are_solved_for_in_double_precision_where_single_will_not_do():
    rng = np.random.default_rng(0)
    far = rng.normal(size=(6, 5))
    for noise in (1.0, 1e-5):
        gram = far @ far.T + noise**2 * np.eye(6)
        goal = gram @ np.ones(6)
        which = np.arange(6)
        found = lasso_module._solved(gram.astype(np.float32), gram, which, goal)
        np.testing.assert_allclose(found, 1, atol=1e-3)


@pytest.mark.usefixtures("single_precision")
def test_what_is_not_explained_is_searched_again(monkeypatch):
    """By other pixels, until one search explains the picture, and shows where the disc ends; the
    likeliest of all is the answer. Next to texture, or where another frame has told, one search is
    all."""
    picture, truth, turns = lit(0.01, bar=False)
    near = truth.copy()
    near[GAIN] *= 1.5
    every = picture.observe(picture.informative(1000, 0))
    looked = first_look.Look((), picture, 0.0, turns.model, np.zeros((0, 2)), 1.0)
    searched = []

    def search(ends, turns=turns, like=None):
        searched.clear()

        def found(other, *_):
            searched.append(other.seed)
            z = ends[min(len(searched), len(ends)) - 1]
            # What is not solved says nothing; the truth leaves nothing.
            point = Point(z, 0.0 if z is truth else np.inf, True, 0)
            return other, Read.of(point, np.asarray(picture.mask), every), []

        monkeypatch.setattr(unaided, "_searched", found)
        # As if nothing led from one to the other.
        monkeypatch.setattr(Turns, "descended", lambda self, read, sigma: stays(read))
        return unaided._searched_again(turns, looked, every, [1.0], print, like)

    def stays(read):
        levels = predicted(read.point.coordinates, turns.held, turns.model, every)
        cost = float(((levels - np.asarray(every.lo)) ** 2).sum())
        return read._replace(point=read.point._replace(cost=cost))

    monkeypatch.setattr(unaided, "hidden", lambda *_: False)
    end, read, _ = search([near, truth, near])
    assert searched == [0, 1]
    assert end.seed == 1
    assert read.point.coordinates is truth
    far = truth.copy()
    far[GAIN] *= 3
    _, read, _ = search([far, near, far])
    assert searched == list(range(unaided.TRIES))
    assert read.point.coordinates is near
    for one in ({"turns": dataclasses.replace(turns, texture=2.0)}, {"like": truth[:4]}):
        search([near, truth], **one)
        assert searched == [0]
    monkeypatch.setattr(unaided, "hidden", lambda *_: True)
    end, read, _ = search([near, truth, near])
    assert searched == list(range(unaided.TRIES))
    assert read.point.coordinates is truth
    assert end.noise == max(unaided.ROUNDING, turns.texture)
