"""Every test runs strictly: in float64 unless it asks for the program's float32, without silent
broadcasting between ranks, and with every annotation in godfit checked (jaxtyping, beartype)."""

import atexit
import gc
import importlib
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

os.environ["MPLBACKEND"] = "Agg"
# As the commands have it.
os.environ.setdefault("JAX_PLATFORMS", "cpu")
# Workers share the cores: threads of BLAS would wait for each other.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
# All that is run at once shares what is compiled; nothing of an earlier run is trusted.
os.environ["GODFIT_CACHE"] = (
    os.environ["GODFIT_CACHE"]
    if "PYTEST_XDIST_WORKER" in os.environ
    else tempfile.mkdtemp(prefix="godfit-")
)

import pytest

if "PYTEST_XDIST_WORKER" not in os.environ:
    atexit.register(shutil.rmtree, os.environ["GODFIT_CACHE"], ignore_errors=True)
    # Most of the time goes into compiling, of which XLA's newer emitter of fusions takes nearly
    # twice as much as the older one. A flag that XLA does not know, as since JAX 0.11, ends the
    # process, and the names of those that are gone are still in its library: another is asked.
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_use_fusion_emitters=false"
    asked = subprocess.run(
        [sys.executable, "-c", "import jax; jax.devices()"],
        env=os.environ | {"XLA_FLAGS": flags},
        capture_output=True,
    )
    if asked.returncode == 0:
        os.environ["XLA_FLAGS"] = flags


def pytest_configure(config):
    """Everything that tests run in is made where they run: a process that only starts others for
    them would load JAX and the package for nothing."""
    if hasattr(config, "workerinput") or not config.getoption("numprocesses", None):
        prepare()


# What numba compiles cannot be wrapped: it is loaded first, and all else once more.
COMPILED = (
    "godfit.scenes.projection",
    "godfit.scenes.pixel_lists",
    "godfit.scenes.visibility",
    "godfit.scenes.contours",
    "godfit.scenes.intersections",
    "godfit.scenes.shadow_maps",
    "godfit.blind.mask_kernel",
    "godfit.scattering.mask_jacobian",
    "godfit.blind.misfit_kernel",
    "godfit.models.disc_box",
    "godfit.models.disc_kernel",
    "godfit.flatland.kernel_records",
    "godfit.flatland.walk_kernel",
    "godfit.flatland.lane_kernel",
    "godfit.flatland.render_kernel",
    "godfit.flatland.derivative_kernel",
    "godfit.flatland.cascade_kernel",
    "godfit.flatland.published_kernel",
    "godfit.flatland.sand_kernel",
    "godfit.scattering.radial.strips_kernel",
    "godfit.runtime.xla_ffi",
    "godfit.runtime.call_frame",
    "godfit.runtime.machine_code",
)


def validated(make):
    """What makes the contents of fit.json; these are then held against their schema."""
    from jsonschema import Draft202012Validator

    schema = importlib.import_module("godfit.report.schema").schema("fit")
    validator = Draft202012Validator(schema)

    def made(*arguments):
        record = make(*arguments)
        validator.validate(json.loads(json.dumps(record)))
        return record

    return made


def prepare():
    """JAX and godfit as every test has them."""
    import jax
    from jaxtyping import install_import_hook

    from godfit.runtime.cache import enable_jax_cache

    # Tracing makes many objects, few of them garbage: looked through less often, a test that
    # compiles for a minute takes 7% less.
    gc.set_threshold(100_000, 10, 10)
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_numpy_rank_promotion", "raise")
    enable_jax_cache()
    compiled = {name: importlib.import_module(name) for name in COMPILED}
    # In the folder of the whole run, and not in that of the first test that calls a kernel.
    compiled["godfit.runtime.machine_code"]._folder()
    for name in [n for n in sys.modules if n.split(".")[0] == "godfit"]:
        del sys.modules[name]
    sys.modules |= compiled
    # Before any test module imports godfit: the hook rewrites modules as they are loaded.
    install_import_hook("godfit", "beartype.beartype")
    importlib.import_module("godfit.runtime.numba_jit")._folder()
    # A worker's heap is large, and giving it back after every compilation takes 1% of the time.
    importlib.import_module("godfit.runtime.malloc").TRIM_AFTER_SECONDS = math.inf
    # What is loaded by now stays, and need not be looked through either.
    gc.freeze()
    # What a command prints must not depend on the machine's speed.
    importlib.import_module("godfit.commands.progress").QUIET_SECONDS = threading.TIMEOUT_MAX
    # Every fit.json of the tests, those of clips as well.
    for module, name in (("result", "fit_record"), ("clip", "_record")):
        report = importlib.import_module(f"godfit.report.{module}")
        setattr(report, name, validated(getattr(report, name)))


# Files that take long, longest first: in the order of their names, or of how many tests they hold,
# one of these comes last, and half of the cores wait for it. The first two compile different
# functions: what both need at once is compiled twice.
LONG = (
    "flatland/test_fitting", "test_fitting", "models/test_staged", "blind/test_search",
    "search/test_conventions", "studies/test_compare", "commands/test_command_line",
    "test_data_synthetic", "scenes/test_raster", "studies/test_profile_likelihood",
    "test_problem", "search/test_suspects", "blind_pairs/test_two_screenshots", "test_stability",
    "inference/test_indirect_inference", "report/test_live", "test_synthetic_fits",
    "runtime/test_cache", "studies/batch/test_engine", "flatland/test_gradients",
    "models/test_disc_kernel", "runtime/test_guest", "test_public_names",
    "test_convention_fits", "commands/test_batch", "flatland/test_published",
    "flatland/test_rendering",
)  # fmt: skip


# Whole fits of bare pictures, photographs, light in the plane, caches and data_synthetic, and what
# else takes seconds for one answer: files, folders of them, or single tests of a file, that
# ``-m "not slow"`` leaves out.
SLOW = (
    "blind", "blind_pairs/test_two_screenshots.py", "search/test_suspects.py",
    "flatland/test_fitting.py", "flatland/test_gradients.py", "flatland/test_published.py",
    "flatland/test_rendering.py", "flatland/test_cascades.py", "flatland/test_jump_flood.py",
    "runtime/test_cache.py", "runtime/test_program_cache.py", "test_data_synthetic.py",
    "test_synthetic_fits.py", "test_stability.py", "test_lmfit.py", "test_experiments.py",
    "test_problem.py",
    "models/test_staged.py", "studies/test_clip.py", "studies/test_compare.py",
    "studies/test_select.py", "studies/test_profile_likelihood.py",
    "inference/test_indirect_inference.py", "inference/test_diagnostics.py",
    "commands/test_command_line.py", "commands/test_batch.py", "studies/batch/test_engine.py",
    "models/test_disc_kernel.py", "models/test_volume.py", "models/test_hoffman_preetham.py",
    "inference/test_arithmetic.py", "scattering/test_gradients.py",
    "scattering/radial/test_methods.py", "scattering/radial/test_radial.py",
    "scenes/test_raster.py", "test_convention_fits.py", "runtime/test_guest.py",
    "runtime/test_machine_code.py",
    "search/test_conventions.py::test_the_shader_is_found_and_ties_are_named",
    "search/test_conventions.py::"
    "test_another_shader_or_number_is_not_converged_and_names_what_is_right",
    "search/test_registration.py::test_a_cropped_target_is_fitted_with_a_note",
    "inference/test_settle.py::test_values_that_were_left_out_have_a_say",
    "report/test_figures.py::test_no_text_is_cut_or_overlaps_another",
    "report/test_live.py::test_every_convention_draws_the_programs_picture",
    "test_fitting.py::test_a_light_pass_of_half_the_size_is_found",
    "test_fitting.py::test_a_light_pass_of_the_mask_s_size_is_kept",
    "test_fitting.py::test_box_passes_are_found",
    "test_fitting.py::test_box_passes_are_not_searched_for_in_a_sum_along_rays",
    "test_fitting.py::test_constant_target_and_white_mask_are_no_error",
    "test_fitting.py::test_quoted_errors_cover",
    "test_fitting.py::test_taps_beyond_the_light_are_found",
    "test_fitting.py::test_tiny_images",
    "test_fitting.py::test_two_lights_in_a_picture_of_one_are_said_to_be_one",
    "test_fitting.py::test_values_that_many_pixels_share_at_an_end_are_clipped",
)  # fmt: skip


def pytest_collection_modifyitems(items):
    tests = Path(__file__).parent
    slow = {(tests / place, test) for place, _, test in (name.partition("::") for name in SLOW)}
    absent = [str(path) for path, _ in slow if not path.exists()]
    if absent:
        raise pytest.UsageError(f"SLOW: expected files or folders of tests, got {absent}")
    whole = {path for path, test in slow if not test}
    slow_files = {path for path in {item.path for item in items} if whole & {path, *path.parents}}
    for item in items:
        if item.path in slow_files or (item.path, item.originalname) in slow:
            item.add_marker(pytest.mark.slow)
    place = {tests / f"{name}.py": i for i, name in enumerate(LONG)}
    missing = [str(path) for path in place if not path.is_file()]
    if missing:
        raise pytest.UsageError(f"LONG: expected files of tests, got {', '.join(missing)}")
    items.sort(key=lambda item: place.get(item.path, len(LONG)))


# Bytes that a worker may hold.
MOST = 2 << 30


def resident() -> float:
    """Bytes of memory in use, infinite where nobody tells."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return float("inf")
    return pages * os.sysconf("SC_PAGE_SIZE")


@pytest.fixture(scope="module", autouse=True)
def programs(request):
    """What one file compiles is stored for all others and for the other worker. In memory it would
    be gigabytes. Tests of the stores themselves have their own."""
    cache = importlib.import_module("godfit.runtime.program_cache")
    if Path(__file__).parent / "runtime" not in request.path.parents:
        cache.enable_program_cache()
    yield
    cache.disable_program_cache()
    if resident() > MOST:
        importlib.import_module("jax").clear_caches()


# Rooms of which no function that a test replaces is part of a compiled program: none is left
# behind that others must not have. Tests of the stores, in ``runtime``, have stores of their own.
UNCOMPILED = ("commands", "studies", "report", "io", "fitting", "blind", "runtime")


class Patch(pytest.MonkeyPatch):
    """Programs are neither stored nor loaded once a function is replaced that may be part of one: a
    test that changes functions must not leave programs of them to others."""

    def setattr(self, target, *rest, **options):
        module = target if isinstance(target, str) else getattr(target, "__module__", None)
        place = (module or target.__name__).split(".")
        if place[0] == "jax" or (place[0] == "godfit" and place[1] not in UNCOMPILED):
            cache = importlib.import_module("godfit.runtime.program_cache")
            super().setattr(cache, "_folder", None)
        super().setattr(target, *rest, **options)


@pytest.fixture
def monkeypatch():
    patch = Patch()
    yield patch
    patch.undo()


@pytest.fixture
def single_precision():
    """float32, as the program runs: what the fit as a whole is made for."""
    import jax

    with jax.enable_x64(False):
        yield
