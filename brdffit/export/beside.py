"""Files that some presets write beside their pictures: .meta files for Unity, MaterialX and USD documents."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from brdffit.export.presets import Preset
from brdffit.svbrdf import Svbrdf

#: Name, type and node (by name) or number of a MaterialX node's input.
_Input = tuple[str, str, str | float]


class Alpha(NamedTuple):
    """Alpha of a base colour; a mask is cut out below ``cutoff``, which is None where alpha is blended."""

    cutoff: float | None


def write_beside(preset: Preset, folder: Path, name: str, base: Svbrdf, roles: Sequence[str]) -> None:
    """Write what the preset wants beside the pictures ``roles`` that are in ``folder``; ``base`` is level 0."""
    if preset.beside == "unity":
        srgb = {picture.role: picture.srgb for picture in preset.pictures}
        for role in roles:
            file = f"{name}_{role}.dds"
            (folder / f"{file}.meta").write_text(
                unity_meta(file, srgb[role], base.wrap), encoding="utf-8", newline="\n"
            )
    elif preset.beside == "documents":
        for suffix, document in ((".mtlx", materialx), (".usda", usda)):
            text = document(name, base.wrap, set(roles), alpha_of(base))
            (folder / f"{name}{suffix}").write_text(text, encoding="utf-8", newline="\n")


def alpha_of(base: Svbrdf) -> Alpha | None:
    """How the base colour's alpha is used (blended, or tested against a cutoff); None where it has none."""
    if base.opacity is None or not base.alpha:
        return None
    return Alpha(base.cutoff if base.alpha == "mask" else None)


def unity_meta(file: str, srgb: bool, wrap: str) -> str:
    """Settings of Unity's importer of DDS files, which reads here, not in the header, whether a picture is sRGB.

    The identifier is made of the file's name, so that baking again keeps what refers to it.
    """
    identifier = hashlib.md5(f"brdffit/{file}".encode(), usedforsecurity=False).hexdigest()
    mode = 0 if wrap == "tile" else 1
    return f"""fileFormatVersion: 2
guid: {identifier}
IHVImageFormatImporter:
  externalObjects: {{}}
  textureSettings:
    serializedVersion: 2
    filterMode: 2
    aniso: 8
    mipBias: 0
    wrapU: {mode}
    wrapV: {mode}
    wrapW: {mode}
  isReadable: 0
  sRGBTexture: {int(srgb)}
  streamingMipmaps: 0
  streamingMipmapsPriority: 0
  ignoreMipmapLimit: 0
  mipmapLimitGroupName:
  userData:
  assetBundleName:
  assetBundleVariant:
"""


def materialx(name: str, wrap: str, roles: set[str], alpha: Alpha | None = None) -> str:
    """A MaterialX 1.38 document: Standard Surface with the MIP-mapped EXR files as its images.

    Its roughness_anisotropy node has alpha_y / alpha_x = 1 - A. The pictures hold Blender's (1 - ratio) / 0.9, so A is
    0.9 of them. The rotation is the angle of the interpolated direction, for angles themselves do not filter.
    """
    mode = "periodic" if wrap == "tile" else "clamp"
    identifier = _identifier(name)

    def image(role: str, kind: str, node: str = "") -> str:
        space = ' colorspace="lin_rec709"' if role == "baseColor" else ""
        return (
            f'    <image name="{node or role}" type="{kind}">\n'
            f'      <input name="file" type="filename" value="{name}_{role}.exr"{space} />\n'
            f'      <input name="uaddressmode" type="string" value="{mode}" />\n'
            f'      <input name="vaddressmode" type="string" value="{mode}" />\n'
            "    </image>\n"
        )

    nodes = image("baseColor", "color3") + image("normal", "vector3")
    nodes += image("roughness", "float") + image("metallic", "float")
    nodes += '    <normalmap name="bumps" type="vector3">\n      <input name="in" type="vector3" nodename="normal" />\n'
    nodes += "    </normalmap>\n"
    outputs = [
        ("color3", "baseColor", "base_color"), ("vector3", "bumps", "normal"),
        ("float", "roughness", "specular_roughness"), ("float", "metallic", "metalness"),
    ]  # fmt: skip
    if alpha is not None:
        nodes += image("baseColor", "color4", "baseColorAndAlpha") + _opacity_nodes(alpha)
        outputs.append(("color3", "opacity", "opacity"))
    if "anisotropic" in roles:
        nodes += image("anisotropic", "float") + image("direction", "vector3") + _anisotropy_nodes()
        outputs += [("float", "anisotropy", "specular_anisotropy"), ("float", "turn", "specular_rotation")]
    declared = "".join(
        f'    <output name="{to}_out" type="{kind}" nodename="{node}" />\n' for kind, node, to in outputs
    )
    inputs = "".join(
        f'    <input name="{to}" type="{kind}" nodegraph="{identifier}_maps" output="{to}_out" />\n'
        for kind, _, to in outputs
    )
    return (
        '<?xml version="1.0"?>\n<materialx version="1.38">\n'
        f'  <nodegraph name="{identifier}_maps">\n{nodes}{declared}  </nodegraph>\n'
        f'  <standard_surface name="{identifier}_surface" type="surfaceshader">\n'
        '    <input name="base" type="float" value="1.0" />\n'
        f"{inputs}  </standard_surface>\n"
        f'  <surfacematerial name="{identifier}" type="material">\n'
        f'    <input name="surfaceshader" type="surfaceshader" nodename="{identifier}_surface" />\n'
        "  </surfacematerial>\n</materialx>\n"
    )


def _opacity_nodes(alpha: Alpha) -> str:
    """Nodes from the picture baseColorAndAlpha to the colour ``opacity``."""
    nodes = _node("extract", "alpha", "float", [("in", "color4", "baseColorAndAlpha"), ("index", "integer", 3)])
    shown = "alpha"
    if alpha.cutoff is not None:
        test: list[_Input] = [("value1", "float", "alpha"), ("value2", "float", alpha.cutoff)]
        nodes += _node("ifgreatereq", "cut", "float", [*test, ("in1", "float", 1.0), ("in2", "float", 0.0)])
        shown = "cut"
    return nodes + _node("convert", "opacity", "color3", [("in", "float", shown)])


def _anisotropy_nodes() -> str:
    """Nodes from the pictures anisotropic and direction to ``anisotropy`` and ``turn``."""
    nodes = _node("multiply", "anisotropy", "float", [("in1", "float", "anisotropic"), ("in2", "float", 0.9)])
    nodes += _node("multiply", "doubled", "vector3", [("in1", "vector3", "direction"), ("in2", "float", 2.0)])
    nodes += _node("subtract", "signed", "vector3", [("in1", "vector3", "doubled"), ("in2", "float", 1.0)])
    for axis, letter in enumerate("xy"):
        along: list[_Input] = [("in", "vector3", "signed"), ("index", "integer", axis)]
        nodes += _node("extract", f"along_{letter}", "float", along)
    nodes += _node("atan2", "angle", "float", [("iny", "float", "along_y"), ("inx", "float", "along_x")])
    return nodes + _node("multiply", "turn", "float", [("in1", "float", "angle"), ("in2", "float", 0.15915494)])


def usda(name: str, wrap: str, roles: set[str], alpha: Alpha | None = None) -> str:
    """A USD document: UsdPreviewSurface, which has no anisotropy, with the MIP-mapped EXR files as its textures."""
    mode, identifier = "repeat" if wrap == "tile" else "clamp", _identifier(name)
    readers, inputs = [], []
    for role, target, kind, channel in (
        ("baseColor", "diffuseColor", "color3f", "rgb"), ("normal", "normal", "normal3f", "rgb"),
        ("roughness", "roughness", "float", "r"), ("metallic", "metallic", "float", "r"),
    ):  # fmt: skip
        scale = (
            "            float4 inputs:scale = (2, 2, 2, 1)\n            float4 inputs:bias = (-1, -1, -1, 0)\n"
            if role == "normal"
            else ""
        )
        inputs.append(f"            {kind} inputs:{target}.connect = </{identifier}/{role}.outputs:{channel}>\n")
        readers.append(
            f'        def Shader "{role}"\n        {{\n'
            '            uniform token info:id = "UsdUVTexture"\n'
            f"            asset inputs:file = @./{name}_{role}.exr@\n"
            f'            token inputs:wrapS = "{mode}"\n            token inputs:wrapT = "{mode}"\n'
            f'            token inputs:sourceColorSpace = "raw"\n{scale}'
            f"            float2 inputs:st.connect = </{identifier}/coordinates.outputs:result>\n"
            f"            {'float' if channel == 'r' else 'float3'} outputs:{channel}\n"
            + ("            float outputs:a\n" if role == "baseColor" and alpha is not None else "")
            + "        }\n"
        )
    if alpha is not None:
        inputs.append(f"            float inputs:opacity.connect = </{identifier}/baseColor.outputs:a>\n")
        if alpha.cutoff is not None:
            inputs.append(f"            float inputs:opacityThreshold = {alpha.cutoff}\n")
    return (
        f'#usda 1.0\n(\n    defaultPrim = "{identifier}"\n)\n\ndef Material "{identifier}"\n{{\n'
        f"        token outputs:surface.connect = </{identifier}/surface.outputs:surface>\n"
        '        def Shader "surface"\n        {\n            uniform token info:id = "UsdPreviewSurface"\n'
        f"{''.join(inputs)}            token outputs:surface\n        }}\n"
        '        def Shader "coordinates"\n        {\n            uniform token info:id = "UsdPrimvarReader_float2"\n'
        '            string inputs:varname = "st"\n            float2 outputs:result\n        }\n'
        f"{''.join(readers)}}}\n"
    )


def _node(kind: str, name: str, of: str, inputs: Sequence[_Input]) -> str:
    """A MaterialX node whose inputs are other nodes (by name) or numbers."""
    lines = "".join(
        f'      <input name="{place}" type="{what}" '
        + (f'nodename="{value}"' if isinstance(value, str) else f'value="{value}"')
        + " />\n"
        for place, what, value in inputs
    )
    return f'    <{kind} name="{name}" type="{of}">\n{lines}    </{kind}>\n'


def _identifier(name: str) -> str:
    """A name that MaterialX and USD accept: letters, digits and underscores."""
    plain = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in name)
    return plain if plain and not plain[0].isdigit() else f"_{plain}"
