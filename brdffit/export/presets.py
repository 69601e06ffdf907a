"""What each engine loads: a table of presets, one entry an engine.

An entry names the files, what their channels hold (`channels.Channels` says what each name means), in which container
and pixel format they are written, and what the engine's user has to do. A new engine is a new entry. Sources: see
`channels`, and docs/engines.md.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from brdffit.methods import one_of


@dataclass(frozen=True)
class Picture:
    """One picture of a preset.

    Attributes:
        role: ending of the file's name in that engine.
        channels: names of properties of `Channels`, in the file's order.
        srgb: whether the (first three) channels are encoded as sRGB.
        needs: "anisotropy", "occlusion" or "specular" (a colour that base colour and metallic do not give): written
            only where the pyramid has it; "" always.
        pixels: pixel format in DDS and KTX2, see `formats`, without the ending "_srgb".
    """

    role: str
    channels: tuple[str, ...]
    srgb: bool = False
    needs: str = ""
    pixels: str = "bc7"


@dataclass(frozen=True)
class Preset:
    """The files that an engine expects.

    Attributes:
        name: as on the command line.
        summary: one line.
        normal_y: "gl" (+Y up in the picture) or "dx".
        roughness: what the roughness channel holds, in words.
        lobe: "anisotropic", or "isotropic" where the engine has none (then the bake fits isotropic lobes).
        specular: "free", or "held" where the pictures have no room for a specular scale (metallic-roughness).
        pictures: the files.
        container: "png" (a file a level), or "exr", "dds", "ktx2" or "glb" (all levels in one).
        zstd: level of Zstandard in KTX2 files, or None.
        beside: what else is written: "unity" (.meta files), "documents" (.mtlx and .usda), or "".
        factors: whether a material is written whose factors multiply its pictures, see `factors`.
        note: what the engine's user has to set, one sentence or two.
    """

    name: str
    summary: str
    normal_y: str
    roughness: str
    lobe: str
    specular: str
    pictures: tuple[Picture, ...]
    container: str = "png"
    zstd: int | None = None
    beside: str = ""
    factors: bool = False
    note: str = ""


_NORMAL = ("normal_x", "normal_y", "normal_z")
_TANGENT = ("tangent_x", "tangent_y", "half")
_BASE_COLOR = ("base_color_r", "base_color_g", "base_color_b")
_GEOMETRIC = "perceptual roughness, alpha = r^2, of the isotropic lobe with the same determinant"
_OF_GLTF = "perceptual roughness of the smaller alpha, alpha_b = r^2; alpha_t = mix(alpha_b, 1, strength^2)"
_OF_MEAN = "perceptual roughness, r^2 (1 + A) and r^2 (1 - A) are the two alphas"

_PLAIN = Preset(
    name="plain",
    summary="every parameter for itself, a PNG a level",
    normal_y="gl",
    roughness=_GEOMETRIC,
    lobe="anisotropic",
    specular="free",
    pictures=(
        Picture("normal", _NORMAL),
        Picture("roughness", ("roughness",)),
        Picture("anisotropy", ("direction_x", "direction_y", "ratio_strength"), needs="anisotropy"),
        Picture("specular", ("specular_r", "specular_g", "specular_b"), srgb=True),
        Picture("diffuse", ("diffuse_r", "diffuse_g", "diffuse_b"), srgb=True),
        Picture("occlusion", ("occlusion",), needs="occlusion"),
    ),
)
_SPECULAR_COLOR = Picture(
    "specularColor", ("specular_color_r", "specular_color_g", "specular_color_b"), True, "specular", "uastc"
)


def _gltf(pixels: str, normal: Picture) -> tuple[Picture, ...]:
    strength = ("direction_x", "direction_y", "gltf_strength")
    return (
        Picture("baseColor", _BASE_COLOR, srgb=True, pixels=pixels),
        normal,
        Picture("occlusionRoughnessMetallic", ("occlusion", "gltf_roughness", "metallic"), pixels=pixels),
        Picture("anisotropy", strength, needs="anisotropy", pixels=pixels),
    )


_SURFACE = (
    Picture("baseColor", _BASE_COLOR),
    Picture("normal", _NORMAL),
    Picture("roughness", ("roughness",)),
    Picture("metallic", ("metallic",)),
    Picture("anisotropic", ("godot_strength",), needs="anisotropy"),
    Picture("direction", ("direction_x", "direction_y", "half"), needs="anisotropy"),
)

_PRESETS = (
    _PLAIN,
    Preset(
        name="gltf",
        summary="one .glb with UASTC textures: three.js, PlayCanvas, Filament, Babylon.js, viewers of glTF",
        normal_y="gl",
        roughness=_OF_GLTF,
        lobe="anisotropic",
        specular="held",
        pictures=(*_gltf("uastc", Picture("normal", _NORMAL, pixels="uastc")), _SPECULAR_COLOR),
        container="glb",
        zstd=10,
        factors=True,
        note="The loader needs a Basis transcoder (KTX2Loader in three.js).",
    ),
    Preset(
        name="three",
        summary="KTX2 with BC7 and BC5 for three.js and Bevy: channels as glTF has them",
        normal_y="gl",
        roughness=_OF_GLTF,
        lobe="anisotropic",
        specular="held",
        pictures=_gltf("bc7", Picture("normal", _NORMAL[:2], pixels="bc5")),
        container="ktx2",
        zstd=10,
        note="Desktop GPUs alone read BC7; `gltf` serves the others.",
    ),
    Preset(
        name="unreal",
        summary="Unreal 5: uncompressed DDS, DirectX normal, ORM with anisotropy in alpha, tangent map",
        normal_y="dx",
        roughness=_OF_MEAN,
        lobe="anisotropic",
        specular="held",
        pictures=(
            Picture("D", _BASE_COLOR, srgb=True, pixels="rgba8"),
            Picture("N", _NORMAL, pixels="rgba8"),
            Picture("ORM", ("occlusion", "mean_roughness", "metallic", "mean_anisotropy"), pixels="rgba8"),
            Picture("T", _TANGENT, needs="anisotropy", pixels="rgba8"),
        ),
        container="dds",
        note="Import the .dds files: Unreal keeps their levels (Mip Gen Settings: Leave Existing Mips) and compresses "
        "them itself. Turn sRGB off for N, ORM and T.",
    ),
    Preset(
        name="unity",
        summary="Unity HDRP: DDS with blocks and .meta files: base map, normal, mask, tangent and anisotropy maps",
        normal_y="gl",
        roughness="smoothness = 1 - r in alpha; " + _OF_MEAN,
        lobe="anisotropic",
        specular="held",
        pictures=(
            Picture("BaseMap", _BASE_COLOR, srgb=True),
            Picture("Normal", _NORMAL[:2], pixels="bc5"),
            Picture("MaskMap", ("metallic", "occlusion", "one", "mean_smoothness")),
            Picture("TangentMap", _TANGENT[:2], needs="anisotropy", pixels="bc5"),
            Picture("AnisotropyMap", ("mean_anisotropy",), needs="anisotropy", pixels="bc4"),
        ),
        container="dds",
        beside="unity",
        note="Copy .dds and .meta files together; the .meta files say which are sRGB. Set Anisotropy to 1.",
    ),
    Preset(
        name="godot",
        summary="Godot 4: DDS with blocks: albedo, normal, ORM, anisotropy flow map",
        normal_y="gl",
        roughness="perceptual roughness, alpha_x alpha_y = r^4; alpha_y / alpha_x = 1 - 0.9 anisotropy",
        lobe="anisotropic",
        specular="held",
        pictures=(
            Picture("albedo", _BASE_COLOR, srgb=True),
            Picture("normal", _NORMAL[:2], pixels="bc5"),
            Picture("orm", ("occlusion", "roughness", "metallic")),
            Picture("flowmap", ("direction_x", "direction_y", "zero", "godot_strength"), needs="anisotropy"),
        ),
        container="dds",
        note="Use an ORMMaterial3D; turn Anisotropy on, give it the flow map, and set it to 1.",
    ),
    Preset(
        name="filament",
        summary="KTX2 with UASTC for materials of Filament: anisotropy as its shaders have it",
        normal_y="gl",
        roughness=_OF_MEAN,
        lobe="anisotropic",
        specular="held",
        pictures=(
            Picture("baseColor", _BASE_COLOR, srgb=True, pixels="uastc"),
            Picture("normal", _NORMAL, pixels="uastc"),
            Picture("orm", ("occlusion", "mean_roughness", "metallic"), pixels="uastc"),
            Picture(
                "anisotropy", ("direction_x", "direction_y", "mean_anisotropy"), needs="anisotropy", pixels="uastc"
            ),
        ),
        container="ktx2",
        zstd=10,
        note="In the material: anisotropyDirection = vec3(2 t.rg - 1, 0), anisotropy = t.b of the anisotropy map.",
    ),
    Preset(
        name="blender",
        summary="Blender 5.2 and later (Cycles): MIP-mapped EXR, with MaterialX and USD documents",
        normal_y="gl",
        roughness=_GEOMETRIC,
        lobe="anisotropic",
        specular="held",
        pictures=_SURFACE,
        container="exr",
        beside="documents",
        note="In Render Properties turn Texture Cache on and its Auto Generate off, or Cycles reads level 0 alone.",
    ),
    dataclasses.replace(
        _PLAIN, name="ntc", summary="a PNG a level, mips/NAME.LEVEL.png, as NVIDIA's RTXNTC tools load them"
    ),
)

PRESETS = {preset.name: preset for preset in _PRESETS}


def preset_names() -> list[str]:
    """Names of the presets, the default first."""
    return list(PRESETS)


def get_preset(name: str) -> Preset:
    """The preset of this name.

    Raises:
        UnknownNameError: with the nearest known name.
    """
    return PRESETS[one_of("preset", name, preset_names())]
