"""A checked request for a fit: every option in one frozen record."""

from __future__ import annotations

import dataclasses
import difflib
import filecmp
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from godfit.errors import InputError, shown
from godfit.flatland.canvas import MODEL_NAME as FLATLAND
from godfit.flatland.canvas import Canvas
from godfit.inference.observation import ARITHMETICS
from godfit.inference.problem import MAX_VALUES
from godfit.io.image import Image
from godfit.io.sources import FLIPS, Source
from godfit.models.hoffman_preetham import HoffmanPreetham
from godfit.models.mitchell import Mitchell
from godfit.scattering.conventions import AUTO
from godfit.scenes.scene import Scene, read_scene
from godfit.scenes.view import in_single_precision

MODELS = (Mitchell.name, HoffmanPreetham.name, FLATLAND)
"""Names of the models that can be fitted."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Request:
    """The arguments of ``godfit.fit``, which explains each of them."""

    target: Source
    mask: Source | None = None
    scene: Scene | str | os.PathLike[str] | None = None
    canvas: str | os.PathLike[str] | Canvas | None = None
    model: str | None = None
    free: Sequence[str] = ()
    background: Source | None = None
    occluder: Source | None = None
    bright_pass: bool = False
    shader: str | None = None
    samples: int | None = None
    rays: int | None = None
    lights: int = 1
    pass_scale: float | None = None
    fov: float | None = None
    distance: float | np.ndarray | None = None
    fix: Mapping[str, float | None] | Sequence[str] | None = None
    start: Mapping[str, float] | None = None
    prior: Any = None
    light_near: tuple[float, float] | None = None
    valid: np.ndarray | None = None
    transfer: str = "none"
    arithmetic: str | None = None
    flip: str | None = None
    border: str | None = None
    tint: bool = False
    register: bool = False
    channels: int | None = None
    inquire: bool = True
    max_values: int = MAX_VALUES
    seed: int = 0
    progress: Callable[[str], None] | None = None

    @property
    def bare(self) -> bool:
        """Whether the picture comes without mask, scene and canvas."""
        return self.mask is None and self.scene is None and self.canvas is None

    @property
    def pair(self) -> bool:
        """Whether it comes with its ordinary pass alone: the effect on, and off."""
        return self.bare and self.background is not None

    @property
    def kind(self) -> str:
        """The name of the model."""
        return self.model or (Mitchell.name if self.canvas is None else FLATLAND)

    @property
    def settings(self) -> dict[str, Any]:
        """Settings that were given here, or in the scene's file."""
        scene = self.scene.settings if isinstance(self.scene, Scene) else {}
        given = {
            "shader": self.shader, "samples": self.samples, "pass_scale": self.pass_scale,
            "border": self.border, "tint": self.tint or None,
        }  # fmt: skip
        return dict(scene) | {name: value for name, value in given.items() if value is not None}

    @property
    def automatic(self) -> bool:
        """Whether the shader is to be found."""
        return self.settings.get("shader") == AUTO

    @property
    def held_at(self) -> dict[str, float | None]:
        """The parameters that are held, by name."""
        assert self.fix is None or isinstance(self.fix, Mapping)
        return dict(self.fix or {})

    def report(self, text: str) -> None:
        """Report that a stage begins."""
        if self.progress is not None:
            self.progress(text)

    def checked(self) -> Request:
        """The request, with its scene loaded. Raises InputError for options that exclude each
        other."""
        check_model(self.kind, self.free, self.shader, self.lights, self.fov, self.distance)
        if self.arithmetic not in (None, *ARITHMETICS):
            raise InputError(
                f"arithmetic: expected {' or '.join(ARITHMETICS)}, got '{self.arithmetic}'"
            )
        if self.fix is not None and not isinstance(self.fix, Mapping):
            # Names alone are held where the search starts.
            names = [self.fix] if isinstance(self.fix, str) else list(self.fix)
            return dataclasses.replace(self, fix=dict.fromkeys(names)).checked()
        if self.kind == FLATLAND:
            self._check_plane()
        elif self.canvas is not None or (self.rays is not None and not self.bare):
            raise InputError(
                f"canvas, rays: expected --model {FLATLAND} with them, got {self.kind}"
            )
        elif self.mask is not None and self.scene is not None:
            raise InputError("fit: expected a mask or a scene, got both")
        elif self.mask is None and self.scene is None:
            self._check_bare()
        if self.prior and self.bare:
            raise InputError("prior: expected a mask, a scene or a canvas with it, got none")
        self._check_treatment()
        if self.bright_pass and not self.bare:
            raise InputError("bright pass: expected no mask, scene or canvas with it, got one")
        self._check_light_near()
        for role in ("mask", "background"):
            if is_same(self.target, getattr(self, role)):
                raise InputError(
                    f"{role}: expected another image than the target, got the same one; give what "
                    f"the light pass reads"
                )
        if self.scene is None:
            return self
        scene = self.scene if isinstance(self.scene, Scene) else read_scene(self.scene)
        return dataclasses.replace(self, scene=in_single_precision(scene))

    def _check_treatment(self) -> None:
        """Raise InputError for options that only a sum over a known mask has."""
        if self.flip is not None and self.flip not in FLIPS:
            raise InputError(f"flip: expected one of {', '.join(FLIPS)}, got {shown(self.flip)}")
        options = {
            "border": self.border, "tint": self.tint, "register": self.register,
            "shader auto": self.shader == AUTO,
        }  # fmt: skip
        for name, given in options.items():
            if given and (self.bare or self.kind != Mitchell.name):
                raise InputError(
                    f"{name}: expected --mask or --scene and the model mitchell with it"
                )
        for name in ("tint", "register"):
            if options[name] and self.free:
                raise InputError(f"{name}: expected no --free with it; leave one of them out")
        if self.register and self.mask is None:
            raise InputError("register: expected --mask with it, got a scene; leave it out")

    def _check_bare(self) -> None:
        """Raise InputError for options that a fit without mask and scene does not have."""
        if self.kind != Mitchell.name:
            raise InputError(
                f"mask: expected --mask or --scene with the model {self.kind}, got neither"
            )
        if self.background is not None and (self.bright_pass or self.occluder is not None):
            option = "bright pass" if self.bright_pass else "occluder"
            raise InputError(
                f"{option}: expected none with two screenshots, got one; leave it out, or leave "
                "out --background"
            )
        if self.bright_pass and self.occluder is not None:
            raise InputError("occluder: expected none with --bright-pass, got one; give either")

    def _check_light_near(self) -> None:
        """Raise InputError for a light's rough position that is no position, or has no use."""
        if self.light_near is None:
            return
        if not self.bare:
            raise InputError(
                "light near: expected no mask, scene or canvas with it, got one; start the light "
                "with --light U,V"
            )
        if np.shape(self.light_near) != (2,) or not np.isfinite(self.light_near).all():
            raise InputError(
                f"light near: expected two finite numbers U,V, got {self.light_near!r}"
            )

    def _check_plane(self) -> None:
        """Raise InputError for options that the light in the plane does not have."""
        name = FLATLAND
        if self.canvas is None:
            raise InputError(f"canvas: expected one with the model {name}, got none; give one")
        for option in ("mask", "scene", "background", "samples", "pass_scale"):
            if getattr(self, option) is not None:
                raise InputError(
                    f"{option}: expected none with the model {name}, got one; leave it out"
                )


def is_same(target: Source, other: Source | None) -> bool:
    """Whether two images are one: one array, one file, or files of the same bytes."""
    if other is None:
        return False
    if target is other:
        return True
    paths = [s.path if isinstance(s, Image) else s for s in (target, other)]
    if not all(isinstance(path, (str, os.PathLike)) and os.fspath(path) for path in paths):
        return False
    try:
        return os.path.samefile(*paths) or filecmp.cmp(*paths, shallow=False)
    except (OSError, ValueError):
        # A file that cannot be read is reported where it is read.
        return False


def check_model(
    model: str,
    free: Sequence[str],
    shader: str | None,
    lights: int,
    fov: float | None,
    distance: float | np.ndarray | None,
) -> None:
    """Raise InputError for a model that does not exist, and for options that it does not have."""
    if model not in MODELS:
        closest = difflib.get_close_matches(model, MODELS, n=1, cutoff=0.0)[0]
        raise InputError(
            f"model: expected one of {', '.join(MODELS)}, got '{model}'; did you mean '{closest}'?"
        )
    if model == Mitchell.name:
        for name, value in (("fov", fov), ("distance", distance)):
            if value is not None:
                raise InputError(f"{name}: expected --model {HoffmanPreetham.name} with it")
        return
    for name, wrong in (("free", free), ("shader", shader), ("lights", lights != 1)):
        if wrong:
            raise InputError(f"{name}: expected none with the model {model}, got one; leave it out")
    if model == FLATLAND:
        for name, value in (("fov", fov), ("distance", distance)):
            if value is not None:
                raise InputError(f"{name}: expected none with the model {model}; leave it out")
        return
    if fov is not None and not 0 < fov < 180:
        raise InputError(f"fov: expected degrees above 0 and below 180, got {fov:g}")
    distances = np.asarray(1.0 if distance is None else distance)
    if distances.ndim not in (0, 2) or not ((distances > 0) & (distances < np.inf)).all():
        got = (
            f"{distances:g}"
            if distances.ndim == 0
            else f"an array {distances.shape} with others in it"
        )
        raise InputError(f"distance: expected a finite number above 0 or (h, w) of them, got {got}")
