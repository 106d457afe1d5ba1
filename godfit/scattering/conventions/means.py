"""Means over the ray: all taps weigh the same."""

from __future__ import annotations

from godfit.scattering.conventions.convention import Convention

FAMILY = "means over the ray"

CONVENTIONS = (
    Convention(
        "mean",
        "B + (E/n) sum_{k=0..n-1} M_{k/(n-1)}",
        drop=1,
        step_drop=1,
        averaged=True,
        absent={"decay": 1.0, "weight": 1.0},
        defaults={"exposure": 1.0, "density": 0.85, "samples": 100},
        names={
            "exposure": "_Intensity", "density": "_BlurWidth", "samples": "NUM_SAMPLES",
            "light": "_Center",
        },
        source="Unity URP, VolumetricLightScattering; libGDX, Cinder and Android ports",
        family=FAMILY,
        remarks="the pixel's own value counts like the others; no decay and no weight",
    ),
    Convention(
        "godot3",
        "B + E (mean_{k=0..n-1} M_{(k+1/2)/n})^a",
        own=0.0,
        lag=0.5,
        averaged=True,
        absent={"decay": 1.0, "density": 1.0, "weight": 1.0},
        defaults={"exposure": 1.0, "samples": 100},
        names={
            "exposure": "exposure", "power": "attenuate", "samples": "num_samples",
            "light": "light_pos",
        },
        source="Godot-God-Rays-Plugin, GodRays.tres",
        family=FAMILY,
        remarks="E is the plugin's exposure times the squared cosine between view and light; "
        "a is attenuate, 1 unless a file gives another; its taps are jittered by a hash of "
        "the pixel, and the sum has their mean places without the jitter",
    ),
)  # fmt: skip
