"""Shader conventions by name: (exposure, decay, density, weight, samples) -> taps.

Every god-ray shader in use evaluates, for a pixel x and a light l in texture coordinates,

    out(x) = c_0 M(x) + sum_{k=1..K} c_k M(x + t_k (l - x))

with its own c and t (Mitchell, GPU Gems 3, ch. 13, listing 13-1, and its descendants), or composes
several such sums. A family of conventions has a file here. A user's own convention is a TOML file.
"""

from __future__ import annotations

import dataclasses
import difflib
import re
from pathlib import Path

from godfit.errors import InputError
from godfit.scattering.conventions import additive, article, composed, means
from godfit.scattering.conventions.convention import Convention
from godfit.scattering.conventions.shader_file import SHADER_SUFFIX, read_shader

AUTO = "auto"
"""Stands for the convention that explains the picture best."""
CONVENTIONS: dict[str, Convention] = {
    c.name: c for family in (article, additive, means, composed) for c in family.CONVENTIONS
}
"""The shipped conventions, family by family."""

ENGINE_NAMES = {
    "godrayseffect": "pmndrs", "godrays": "pmndrs", "postprocessing": "pmndrs",
    "reactpostprocessing": "pmndrs", "threejs": "three", "sousa": "three", "cryengine": "three",
    "babylonjs": "babylon", "volumetriclightscatteringpostprocess": "babylon",
    "gpugems": "mitchell", "gpugems3": "mitchell", "mitchell2007": "mitchell",
    "article": "article-glsl", "irrlicht": "article-glsl",
    "volumetriclightscattering": "mean", "urp": "mean", "unityurp": "mean", "libgdx": "mean",
    "cinder": "mean", "lightscatteringfilter": "jmonkey", "jmonkeyengine": "jmonkey",
    "jme": "jmonkey", "love": "moonshine", "godsray": "moonshine", "tsl": "radial-blur",
    "ppfx": "reshade", "ppfxgodrays": "reshade", "panda": "panda3d", "unitysunshafts": "sun-shafts",
    "unitystandardassets": "sun-shafts", "unreal": "light-shafts", "unrealengine": "light-shafts",
    "lightshaftbloom": "light-shafts", "blender": "sun-beams", "blendersunbeams": "sun-beams",
    "reradialsunrays": "godot4", "godotgodraysplugin": "godot3", "handwritten": "additive",
    "erkaman": "glsl-godrays",
}  # fmt: skip
"""Conventions by the names that engines, effects and books have, without case and punctuation."""
AMBIGUOUS = {
    "unity": "'sun-shafts' (Standard Assets) or 'mean' (URP's VolumetricLightScattering)",
    "godot": "'godot3' (Godot-God-Rays-Plugin) or 'godot4' (RERadialSunRays)",
}
"""Engines that have two sums."""
# Conventions of users' files, by their key: a model finds its own by that.
_OWN: dict[str, Convention] = {}


def convention(name: str | Path | Convention) -> Convention:
    """The convention of this name or key, of the engine or effect of this name, or of a user's
    file, whose name ends in .toml. Raises InputError for an unknown one, naming the closest."""
    if isinstance(name, Convention):
        if CONVENTIONS.get(name.name) is name:
            return name
        own = dataclasses.replace(name, own_file=True)
        return _OWN.setdefault(own.key, own)
    name = str(name)
    if name in CONVENTIONS:
        return CONVENTIONS[name]
    if name in _OWN:
        return _OWN[name]
    if name.lower().endswith(SHADER_SUFFIX):
        return convention(read_shader(name))
    plain = re.sub("[^a-z0-9]", "", name.lower())
    short = {re.sub("[^a-z0-9]", "", other): other for other in CONVENTIONS}
    if plain in ENGINE_NAMES or plain in short:
        return CONVENTIONS[short.get(plain) or ENGINE_NAMES[plain]]
    expected = f"shader: expected one of {', '.join(CONVENTIONS)} or a file.toml, got '{name}'"
    if plain in AMBIGUOUS:
        raise InputError(f"{expected}; give {AMBIGUOUS[plain]}")
    closest = difflib.get_close_matches(name, CONVENTIONS, n=1, cutoff=0.0)
    raise InputError(f"{expected}; did you mean '{closest[0]}'?")


def families() -> dict[str, list[Convention]]:
    """The shipped conventions by family, in the order in which they are printed."""
    found: dict[str, list[Convention]] = {}
    for shader in CONVENTIONS.values():
        found.setdefault(shader.family, []).append(shader)
    return found
