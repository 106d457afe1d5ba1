"""Light passes that are compositions of several sums, one after another."""

from __future__ import annotations

from godfit.scattering.conventions.convention import Convention

FAMILY = "compositions of several sums"
SUN_SHAFTS_REACH = 5 * (1 + 6 + 12 + 18) / 768
"""Reach of all passes of Unity's sun shafts at a blur radius of 1: five steps a pass, of 1, 6, 12
and 18 radii, each 1/768 of the ray."""
LIGHT_SHAFTS_PASSES = (0.1, 0.48, 1.0)
"""Lengths of the light shafts' passes, as shares of the ray: .1 x 4.8^p, at most 1."""

CONVENTIONS = (
    Convention(
        "three",
        "B + E (1 - box_3 box_2 box_1 (1 - M)), box_p: 6 taps, step 6^-p",
        box=(6.0**-1, 6.0**-2, 6.0**-3),
        defaults={"exposure": 0.69, "samples": 18},
        names={"exposure": "fGodRayIntensity", "light": "vSunPositionScreenSpace"},
        source="three.js, GodRaysShader; Sousa, CryEngine 2",
        family=FAMILY,
        remarks="Sousa, CryEngine 2; no decay, density or weight",
    ),
    Convention(
        "sun-shafts",
        "screen(B, E blur_18 blur_12 blur_6 blur_1 M), blur_m: mean of 6 taps, step m r/768",
        blurs=(1.0, 6.0, 12.0, 18.0),
        absent={"decay": 1.0, "weight": 1.0},
        defaults={"exposure": 1.15, "density": 2.5 * SUN_SHAFTS_REACH, "samples": 24},
        blend="screen",
        pass_scale=0.5,
        names={
            "exposure": "sunShaftIntensity", "density": "sunShaftBlurRadius * 185 / 768",
            "light": "sunTransform",
        },
        source="Unity Standard Assets, SunShafts",
        family=FAMILY,
        remarks="radialBlurIterations 2; density is the reach of all passes, 185/768 of the blur "
        "radius r, 2.5; half size (resolution Normal); the mask has sunThreshold and maxRadius "
        "applied",
    ),
    Convention(
        "light-shafts",
        "B + E mean_1 mean_.48 mean_.1 M, mean_a: 12 taps at a k/12",
        blurs=LIGHT_SHAFTS_PASSES,
        blur_taps=12,
        absent={"decay": 1.0, "density": 11 / 12 * sum(LIGHT_SHAFTS_PASSES), "weight": 1.0},
        defaults={"exposure": 1.0, "samples": 36},
        pass_scale=0.5,
        names={"exposure": "BloomScale", "light": "the light's place on the screen"},
        source="Unreal, light shaft bloom, as ports have it",
        family=FAMILY,
        remarks="r.LightShaftBlurPasses 3, r.LightShaftNumSamples 12; half size; the mask has "
        "BloomThreshold applied",
    ),
    Convention(
        "sun-beams",
        "B + E sum_{i=0..m} (1 - i/m)^2 M_i / sum (1 - i/m)^2, steps of a pixel",
        passes="sun-beams",
        absent={"decay": 1.0, "weight": 1.0},
        defaults={"exposure": 1.0, "density": 0.2, "samples": 512},
        names={"exposure": "the mix factor", "density": "ray_length", "light": "source"},
        source="Blender, Sun Beams node",
        family=FAMILY,
        remarks="m is the smaller of density times the picture's diagonal and the distance to the "
        "light, in pixels of the mask; samples is the most steps that are summed",
    ),
    Convention(
        "godot4",
        "B (1 + E s), s = Gauss(mean_{k=0..n-1} M at a (k/n) min(|x - l|/R, 1), nearest texel)",
        passes="godot4",
        pass_options={"radius": 150.0, "gaussian": 16.0},
        absent={"decay": 1.0, "weight": 1.0},
        defaults={"exposure": 1.5, "density": 0.9, "samples": 32},
        blend="modulate",
        pass_scale=0.5,
        names={
            "exposure": "the overlay's 1.5", "density": "radial_blur_effect_amount",
            "samples": "radial_blur_samples", "radius": "radial_blur_radius",
            "gaussian": "gaussian_blur_size", "light": "sun_location",
        },
        source="RERadialSunRays for Godot 4",
        family=FAMILY,
        remarks="R and the Gauss's size are in pixels of the light pass; the nearest texel has no "
        "derivative by light and density, so that a fit finds the exposure alone",
    ),
    Convention(
        "jmonkey",
        "B + mean(R) D (R - B), R = mean of n taps at 1 - b - W k/(n-1)",
        passes="jmonkey",
        pass_options={"start": 0.02},
        absent={"decay": 1.0, "weight": 1.0},
        defaults={"exposure": 1.4, "density": 0.9, "samples": 50},
        blend="towards",
        names={
            "exposure": "lightDensity * (1 - |u - .5|) (1 - |v - .5|)", "density": "blurWidth",
            "start": "blurStart", "samples": "nbSamples", "light": "lightPosition",
        },
        source="jMonkeyEngine, LightScatteringFilter",
        family=FAMILY,
        remarks="E is D, which the engine computes from lightDensity 1.4 and the light's place; "
        "b is blurStart, .02 unless a shader's file gives another",
    ),
)  # fmt: skip
