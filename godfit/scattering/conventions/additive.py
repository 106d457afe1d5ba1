"""Sums without the pixel's own value, added to the picture or screened with it.

The plain added sum is the commonest of all hand-written shaders. Without a tap of the pixel itself
only exposure*weight is determined.
"""

from __future__ import annotations

from godfit.scattering.conventions.convention import Convention, defaults_of

FAMILY = "sums without the pixel's own value"
PRODUCT = "no own-pixel tap: only exposure*weight is determined"
UNIFORMS = {"exposure": "exposure", "decay": "decay", "density": "density", "weight": "weight"}

CONVENTIONS = (
    Convention(
        "additive",
        "B + E w sum_{i=1..n} d^(i-1) M_i",
        own=0.0,
        names=UNIFORMS | {"samples": "NUM_SAMPLES", "light": "lightPos"},
        source="hand-written shaders: VulkanDemos, 572godrays, glium, LightShafts, GameMaker",
        family=FAMILY,
        remarks=f"{PRODUCT}; no defaults are common to all, 100 samples assumed",
    ),
    Convention(
        "glsl-godrays",
        "B + E w sum_{i=1..min(n+1,100)} d^(i-1) M_i",
        own=0.0,
        drop=-1,
        most_taps=100,
        defaults=defaults_of(1.0, 1.0, 1.0, 0.01, 100),
        names=UNIFORMS | {"samples": "numSamples", "light": "screenSpaceLightPos"},
        source="glsl-godrays, index.glsl",
        family=FAMILY,
        remarks=f"{PRODUCT}; its loop makes one tap more than numSamples, and 100 at most",
    ),
    Convention(
        "moonshine",
        "B + E w sum_{i=1..n} d^i B_i",
        own=0.0,
        order=0,
        defaults=defaults_of(0.25, 0.95, 0.15, 0.5, 70),
        names=UNIFORMS | {"samples": "samples", "light": "light_position"},
        source="LÖVE, moonshine, godsray.lua",
        family=FAMILY,
        remarks=f"{PRODUCT}; the picture is its own mask: give it as mask and as background",
    ),
    Convention(
        "pmndrs",
        "screen(B, E w sum_{i=1..n} d^(i-1) M_i)",
        own=0.0,
        defaults=defaults_of(0.6, 0.9, 0.96, 0.4, 60),
        blend="screen",
        half_floats=True,
        names=UNIFORMS | {"samples": "samples", "light": "lightSource"},
        source="pmndrs/postprocessing, GodRaysEffect",
        family=FAMILY,
        remarks=f"GodRaysEffect; {PRODUCT}",
    ),
    Convention(
        "radial-blur",
        "M + (E/2n) w sum_{i=1..n} d^(i-1) M_{i/n}",
        gain=0.5,
        own_scaled=False,
        averaged=True,
        absent={"density": 1.0},
        defaults={"exposure": 5.0, "decay": 0.95, "weight": 0.9, "samples": 32},
        names={
            "exposure": "exposure", "decay": "decay", "weight": "weight", "samples": "count",
            "light": "center",
        },
        source="three.js, TSL display node radialBlur",
        family=FAMILY,
        remarks="the pixel's own value has no factor: only exposure*weight is determined; its taps "
        "are jittered by up to a step, and the sum has their mean places without the jitter",
    ),
    Convention(
        "reshade",
        "B + luma(E sum_{i=1..n-1} d^(i-1) max(M_i - T, 0)) / (1 + E S - T), S = sum d^(i-1)",
        own=0.0,
        drop=1,
        saturated=True,
        threshold=0.65,
        luma=True,
        absent={"weight": 1.0},
        defaults={
            "exposure": 0.1, "decay": 1 / 1.06, "density": 1 / 1.2, "samples": 64,
        },
        names={
            "exposure": "pGodraysExposure", "decay": "1 / pGodraysFalloff",
            "density": "1 / pGodraysFreq", "samples": "pGodraysSampleAmount",
            "threshold": "pGodraysThreshold", "light": "pGodraysSource",
        },
        source="ReShade, PPFX_Godrays.fx",
        family=FAMILY,
        remarks="T is pGodraysThreshold, .65 unless a shader's file gives another; v runs down; "
        "ReShade's border is black where godfit's is clamped",
    ),
)  # fmt: skip
