"""Mitchell's sum with the pixel's own value, and what is blended as he blends it.

GPU Gems 3 (2007), ch. 13, listing 13-1, and its closest descendants: the slides' two programs, the
article, Babylon.js.
"""

from __future__ import annotations

from godfit.scattering.conventions.convention import Convention, defaults_of

FAMILY = "Mitchell's sum with the pixel's own value"
EQUATION_4 = "equation 4 of the slides divides by n: E there is n times E here"
"""What both decks' formula has and neither shader: a fitted exposure is that of the shader."""
UNIFORMS = {"exposure": "exposure", "decay": "decay", "density": "density", "weight": "weight"}

CONVENTIONS = (
    Convention(
        "mitchell",
        "B + E (M + w sum_{i=1..n} d^(i-1) M_i)",
        names={
            "exposure": "Exposure", "decay": "Decay", "density": "Density", "weight": "Weight",
            "samples": "NUM_SAMPLES", "light": "ScreenLightPos",
        },
        source="GPU Gems 3, ch. 13, listing 13-1",
        family=FAMILY,
        remarks="no defaults published, 100 samples assumed",
    ),
    Convention(
        "dawntime",
        "B + E (M + w sum_{i=1..n-1} d^i M_i)",
        drop=1,
        order=0,
        defaults=defaults_of(0.05, 0.99, 0.8, 0.8, 200),
        density_slider=1.0,
        pass_scale=0.5,
        names=UNIFORMS | {"samples": "samples", "light": "lightPosition"},
        source="DawnTime, slide 'Volumetric scattering fragment shader'",
        family=FAMILY,
        remarks=f"decay before use; light pass at half resolution by default; {EQUATION_4}",
    ),
    Convention(
        "vesper",
        "B + E (M + w sum_{i=1..n-1} d^(i-1) M_i)",
        drop=1,
        defaults=defaults_of(0.05, 0.99, 0.8, 0.8, 150),
        density_slider=1.0,
        pass_scale=0.5,
        names=UNIFORMS | {"samples": "samples", "light": "lightPosition"},
        source="Vesper, slide 'LightScatteringShader'",
        family=FAMILY,
        remarks=f"decay after use; light pass at half resolution by default; {EQUATION_4}",
    ),
    Convention(
        "article-glsl",
        "1.1 B + .4 E (M + w sum_{i=1..n} d^(i-1) M_i)",
        gain=0.4,
        defaults=defaults_of(0.2, 0.96815, 0.926, 0.58767, 100),
        background_gain=1.1,
        names=UNIFORMS | {"samples": "NUM_SAMPLES", "light": "lightPositionOnScreen"},
        source="the article's GLSL listings",
        family=FAMILY,
        remarks="the last line of the article; its second listing, B + .4 (M + w sum), is "
        "mitchell with E = .4, and its first the same without B",
    ),
    Convention(
        "article-hlsl",
        "1.1 B + .4 E (M + w sum_{i=1..n} d^(i-1) M_i)",
        gain=0.4,
        defaults=defaults_of(0.92, 0.97815, 0.966, 0.58767, 100),
        background_gain=1.1,
        names={
            "exposure": "Exposure", "decay": "Decay", "density": "Density", "weight": "Weight",
            "samples": "NUM_SAMPLES", "light": "ScreenLightPos",
        },
        source="the article's HLSL listing",
        family=FAMILY,
        remarks="v runs down in D3D: give a light so measured with --light-origin top",
    ),
    Convention(
        "babylon",
        "1.1 B + .4 E (M + w sum_{i=1..n} d^(i-1) M_i)",
        gain=0.4,
        defaults=defaults_of(0.3, 0.96815, 0.926, 0.58767, 100),
        background_gain=1.1,
        names=UNIFORMS | {"samples": "samples", "light": "customMeshPosition"},
        source="Babylon.js, VolumetricLightScatteringPostProcess",
        family=FAMILY,
        remarks="VolumetricLightScatteringPostProcess; samples are given to its constructor",
    ),
    Convention(
        "panda3d",
        "B + E (M + sum_{i=1..n} d^(i-1) M_i)",
        absent={"weight": 1.0},
        defaults={"exposure": 0.1, "decay": 0.1, "density": 5.0, "samples": 32},
        most_density=10.0,
        names={
            "exposure": "exposure", "decay": "decay", "density": "density",
            "samples": "numsamples", "light": "caster",
        },
        source="Panda3D, CommonFilters.setVolumetricLighting",
        family=FAMILY,
        remarks="no weight; the mask is rgb x alpha; density above 1 goes beyond the light",
    ),
)  # fmt: skip
