"""Programs kept from one run to the next: the same answers, neither traced nor compiled again."""

import os
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from godfit import Mitchell
from godfit.flatland.model import Flatland
from godfit.inference.evaluate import model_at
from godfit.runtime import program_cache
from godfit.runtime.cache import CACHE_VARIABLE
from godfit.runtime.checked_files import write_checked
from godfit.scattering.radial.exact import EXACT

MODEL = Mitchell(0.05, 0.98, 0.8, 0.7, (0.5, 0.6), "dawntime", 20)
MASK = (np.random.default_rng(0).random((24, 32)) > 0.5).astype(float)


@pytest.fixture
def traced():
    """What was traced, in order."""
    return []


@pytest.fixture
def another_run(monkeypatch, tmp_path):
    """Begins one, with a folder of its own for what earlier ones have kept."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))

    def begin():
        program_cache.disable_program_cache()
        program_cache.enable_program_cache()
        return [file for file in tmp_path.rglob("*") if file.is_file()]

    yield begin
    program_cache.disable_program_cache()


def named(function):
    # Its name must be that of no other: it is found by it.
    function.__qualname__ = "light"
    return program_cache.cached_jit(function)


def made(traced):
    """A light pass, and a custom call of LAPACK beside the package's own."""

    def light(model, mask, times):
        traced.append(times)
        return times * model.light_pass(mask), jnp.linalg.qr(mask)[1]

    return named(light)


def made_small(traced):
    """With the same arguments, what compiles in no time: where files alone are tested."""

    def light(model, mask, times):
        traced.append(times)
        return times * model.exposure * mask, jnp.linalg.qr(mask)[1]

    return named(light)


def test_a_program_is_traced_once(traced, another_run):
    files = another_run()
    assert not files
    light = made(traced)
    first = light(MODEL, MASK, 2)
    # In a program, which is not stored as one that is called by itself is.
    expected = 2 * jax.jit(lambda mask: MODEL.light_pass(mask))(jnp.asarray(MASK))
    np.testing.assert_allclose(first[0], expected, rtol=1e-12)
    light(MODEL, MASK, 2)
    assert traced == [2]
    assert len(another_run()) == 1
    again = light(MODEL, MASK, 2)
    assert traced == [2]
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)


def test_what_it_depends_on_makes_another(traced, another_run):
    another_run()
    light = made(traced)
    light(MODEL, MASK, 1)
    for other in (
        (MODEL, MASK, 1.0),
        (MODEL, MASK[:12], 1),
    ):
        before = len(traced)
        expected = other[2] * other[0].light_pass(jnp.asarray(other[1]))
        np.testing.assert_allclose(light(*other)[0], expected, rtol=1e-12)
        assert len(traced) > before
    before = len(traced)
    with jax.enable_x64(False):
        single = Mitchell(0.05, 0.98, 0.8, 0.7, (0.5, 0.6), "dawntime", 20)
        # Twice, and of NumPy's own precision.
        for _ in range(2):
            assert light(single, MASK, 1)[0].dtype == jnp.float32
    assert len(traced) > before
    # Other numbers make none, the number of samples among them.
    moved = Mitchell(0.06, 0.97, 0.7, 0.6, (0.4, 0.5), "dawntime", 21)
    before = len(traced)
    np.testing.assert_allclose(
        light(moved, MASK, 1)[0], moved.light_pass(jnp.asarray(MASK)), rtol=1e-12
    )
    assert len(traced) == before


@pytest.mark.parametrize("content", [b"", b"half a program", b"cbuiltins\nexit\n(tR."])
def test_a_file_that_cannot_be_read_is_made_anew(traced, another_run, content):
    another_run()
    light = made_small(traced)
    expected = light(MODEL, MASK, 1)
    (file,) = another_run()
    whole = file.read_bytes()
    file.write_bytes(content or whole[: len(whole) // 2])
    np.testing.assert_array_equal(light(MODEL, MASK, 1)[0], expected[0])
    assert traced == [1, 1]
    (file,) = another_run()
    assert len(file.read_bytes()) == len(whole)


def test_a_flipped_bit_is_found_wherever_it_is(traced, another_run):
    """Machine code with another bit would end the process."""
    another_run()
    light = made_small(traced)
    light(MODEL, MASK, 1)
    (file,) = another_run()
    whole = file.read_bytes()
    for place in np.random.default_rng(0).integers(8 * len(whole), size=200):
        damaged = bytearray(whole)
        damaged[place // 8] ^= 1 << place % 8
        file.write_bytes(damaged)
        assert program_cache._load(file) is None
        assert not file.exists()
    file.write_bytes(whole)
    assert program_cache._load(file) is not None


def test_a_list_names_programs_alone(traced, another_run, loaded, tmp_path):
    another_run()
    light = made_small(traced)
    program_cache.preload_programs("a picture")
    light(MODEL, MASK, 1)
    program_cache.save_preload_list()
    needed = [*loaded]
    another_run()
    loaded.clear()
    (notes,) = tmp_path.rglob("needed-*")
    write_checked(notes, f"../x {tmp_path}/x {needed[0]}".encode())
    program_cache.preload_programs("a picture")
    assert loaded == needed


def test_a_full_disk_costs_time_alone(traced, another_run, monkeypatch):
    another_run()

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    program_cache.preload_programs("a picture")
    light = made_small(traced)
    np.testing.assert_allclose(light(MODEL, MASK, 1)[0], 0.05 * MASK, rtol=1e-12)
    program_cache.save_preload_list()
    assert not another_run()


def test_what_was_compiled_before_is_kept_whole(traced, another_run):
    """An executable out of JAX's own cache, where it may be from before, is not: parts of it are
    missing once it has been written again."""
    another_run()
    light = made(traced)
    expected = light(MODEL, MASK, 1)
    for _ in range(2):
        (file,) = another_run()
        file.unlink()
        light(MODEL, MASK, 1)
    another_run()
    np.testing.assert_array_equal(light(MODEL, MASK, 1)[0], expected[0])
    assert traced == [1, 1, 1]


def test_without_a_folder_nothing_is_kept(traced, another_run, monkeypatch, tmp_path):
    monkeypatch.setenv(CACHE_VARIABLE, "off")
    assert not another_run()
    light = made_small(traced)
    light(MODEL, MASK, 1)
    light(MODEL, MASK, 1)
    assert traced == [1]
    assert not another_run()


def test_it_is_differentiable_like_any_other(traced, another_run):
    another_run()
    light = made(traced)

    def exposed(exposure):
        model = Mitchell(exposure, 0.98, 0.8, 0.7, (0.5, 0.6), "dawntime", 20)
        return light(model, MASK, 1)[0].sum()

    slope = jax.jacfwd(exposed)(0.05)
    ahead, behind = exposed(0.05 + 1e-4), exposed(0.05 - 1e-4)
    np.testing.assert_allclose(slope, (ahead - behind) / 2e-4, rtol=1e-6)


def test_what_cannot_be_kept_is_compiled(traced, another_run):
    """A call into Python has no name that another run could find it by."""
    another_run()

    def called_back(x):
        traced.append(1)
        return jax.pure_callback(np.sin, jax.ShapeDtypeStruct(x.shape, x.dtype), x)

    sine = program_cache.cached_jit(called_back)
    np.testing.assert_allclose(sine(MASK), np.sin(MASK))
    assert not another_run()
    np.testing.assert_allclose(sine(MASK), np.sin(MASK))
    assert len(traced) == 2


@pytest.mark.skipif("strips" not in EXACT, reason="numba is not installed")
def test_foreign_functions_are_known_by_name():
    from godfit.runtime import xla_ffi
    from godfit.scattering.radial import strips

    assert xla_ffi.register(strips.STRIP_CALLS[False])
    assert not xla_ffi.register("nobody")


def test_a_model_comes_back_as_one(traced, another_run):
    def moved(model, z):
        traced.append("moved")
        return model.moved(z), (z, {"gain": z[3]})

    moved.__qualname__ = "moved"
    z = jnp.asarray([0.06, 2.0, 0.7, 0.5, 0.4, 0.3])
    expected = MODEL.moved(z)
    for _ in range(2):
        another_run()
        found, (same, named) = program_cache.cached_jit(moved)(MODEL, z)
        assert isinstance(found, Mitchell)
        assert (found.shader, found.samples) == (MODEL.shader, MODEL.samples)
        for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-12)
        np.testing.assert_array_equal(same, z)
        assert named["gain"] == z[3]
    assert traced == ["moved"]


@pytest.fixture
def loaded(monkeypatch):
    """The names of files that programs are read from, in order."""
    names = []
    load = program_cache._load
    monkeypatch.setattr(program_cache, "_load", lambda file: names.append(file.name) or load(file))
    return names


def test_what_was_needed_last_time_is_read_ahead(traced, another_run, loaded):
    another_run()
    light = made_small(traced)
    program_cache.preload_programs("a picture")
    expected = [light(MODEL, MASK, times)[0] for times in (3, 1, 2)]
    program_cache.save_preload_list()
    needed = [*loaded]
    loaded.clear()
    another_run()
    program_cache.preload_programs("a picture")
    assert loaded == needed
    # Asked in another order, and not all of them.
    for times, image in ((2, expected[2]), (3, expected[0])):
        np.testing.assert_array_equal(light(MODEL, MASK, times)[0], image)
    assert loaded == needed
    program_cache.save_preload_list()
    loaded.clear()
    another_run()
    program_cache.preload_programs("another picture")
    assert loaded == []
    program_cache.preload_programs("a picture")
    assert loaded == [needed[2], needed[0]]
    assert traced == [3, 1, 2]


def test_what_cannot_be_read_ahead_is_made_when_it_is_needed(traced, another_run, loaded):
    another_run()
    light = made_small(traced)
    program_cache.preload_programs("a picture")
    expected = light(MODEL, MASK, 1)[0]
    program_cache.save_preload_list()
    for file in another_run():
        if file.name == loaded[0]:
            file.write_bytes(b"half a program")
    program_cache.preload_programs("a picture")
    np.testing.assert_array_equal(light(MODEL, MASK, 1)[0], expected)
    assert traced == [1, 1]


def test_what_nobody_waits_for_is_not_read(traced, another_run, monkeypatch):
    another_run()
    light = made_small(traced)
    program_cache.preload_programs("a picture")
    for times in (1, 2, 3):
        light(MODEL, MASK, times)
    program_cache.save_preload_list()
    another_run()
    begun, go_on, names = threading.Event(), threading.Event(), []
    load = program_cache._load

    def slowly(file):
        names.append(file.name)
        if not begun.is_set():
            begun.set()
            assert go_on.wait(60)
        return load(file)

    monkeypatch.setattr(program_cache, "_load", slowly)
    reading = threading.Thread(target=program_cache.preload_programs, args=("a picture",))
    reading.start()
    assert begun.wait(60)
    # Who is in more of a hurry than the one who reads ahead reads for himself.
    light(MODEL, MASK, 2)
    # The command ends while the first is being read: it waits for that, and for no other.
    ending = threading.Thread(target=program_cache.save_preload_list)
    ending.start()
    ending.join(0.2)
    assert ending.is_alive()
    go_on.set()
    for thread in (ending, reading):
        thread.join(60)
        assert not thread.is_alive()
    assert len(names) == 2
    assert traced == [1, 2, 3]


def test_a_moved_model_is_whole_when_its_program_was_loaded(another_run):
    """Metadata of a module that comes out of a file does not compare equal to the caller's."""
    model = Flatland()
    z = np.asarray(model.coordinates()) * 1.25
    held = np.full(len(z), np.nan)
    for _ in range(2):
        another_run()
        moved = model_at(z, held, model)
        assert isinstance(moved, Flatland)
        np.testing.assert_allclose(moved.coordinates(), z, rtol=1e-6)
