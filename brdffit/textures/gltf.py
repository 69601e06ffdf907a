"""The material of a glTF 2.0 file (.gltf, .glb) as a texture set.

Only what a metallic-roughness or specular-glossiness material says of its maps is read; geometry, scenes and
procedural nodes are not.
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from brdffit.errors import InputError
from brdffit.methods import one_of
from brdffit.textures.texture_set import Map, TextureSet


def read_gltf(path: Path, data: bytes, name: str | None = None) -> TextureSet:
    """The texture set of a glTF file's material; its name is the file's stem.

    Raises:
        InputError: when the file is damaged or has no material with maps.
    """
    text, binary = _glb_chunks(path, data) if data[:4] == b"glTF" else (data, None)
    try:
        document = json.loads(text)
        materials = document.get("materials", [])
    except (ValueError, AttributeError) as error:
        raise InputError(f"'{path}' is no glTF file: its JSON cannot be read ({error}).") from error
    if not materials:
        raise InputError(f"'{path}' has no materials, expected one with a normal texture.")
    if name is None:
        material = next((candidate for candidate in materials if "normalTexture" in candidate), materials[0])
    else:
        names = [str(candidate.get("name", at)) for at, candidate in enumerate(materials)]
        material = materials[names.index(one_of("material", name, names))]
    texture_set = TextureSet(name=path.stem, maps={}, normal_y="gl", normal_y_source="convention", entry=path)
    if len(materials) > 1:
        read = material.get("name", materials.index(material))
        texture_set.note(f"'{path.name}' has {len(materials)} materials: '{read}' is read, the others are left out.")
    try:
        _gltf_maps(texture_set, path, document, binary, material)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InputError(
            f"'{path}' is a damaged glTF file: its material refers to something missing ({error!r})."
        ) from error
    return texture_set


def _gltf_maps(texture_set: TextureSet, path: Path, document: dict, binary: bytes | None, material: dict) -> None:
    maps, factors = texture_set.maps, texture_set.factors

    def add(reference: dict | None, role: str, channel: str = "") -> None:
        if reference is not None:
            file, data = _gltf_image(path, document, binary, reference["index"])
            maps[role] = Map(role, file, channel, data, as_rgba=True)

    extensions = material.get("extensions", {})
    glossiness = extensions.get("KHR_materials_pbrSpecularGlossiness")
    if glossiness is not None:
        add(glossiness.get("diffuseTexture"), "base_color")
        add(glossiness.get("specularGlossinessTexture"), "specular")
        add(glossiness.get("specularGlossinessTexture"), "gloss", "A")
        factors["base_color"] = np.array(glossiness.get("diffuseFactor", [1, 1, 1, 1])[:3], np.float32)
        factors["specular"] = np.array(glossiness.get("specularFactor", [1, 1, 1]), np.float32)
        factors["gloss"] = float(glossiness.get("glossinessFactor", 1.0))
        if "gloss" not in maps:
            factors["roughness"] = 1.0 - float(factors["gloss"])
    else:
        metallic_roughness = material.get("pbrMetallicRoughness", {})
        add(metallic_roughness.get("baseColorTexture"), "base_color")
        add(metallic_roughness.get("metallicRoughnessTexture"), "roughness", "G")
        add(metallic_roughness.get("metallicRoughnessTexture"), "metallic", "B")
        factors["base_color"] = np.array(metallic_roughness.get("baseColorFactor", [1, 1, 1, 1])[:3], np.float32)
        factors["roughness"] = float(metallic_roughness.get("roughnessFactor", 1.0))
        factors["metallic"] = float(metallic_roughness.get("metallicFactor", 1.0))
    add(material.get("normalTexture"), "normal")
    add(material.get("occlusionTexture"), "ao", "R")
    factors["normal"] = float(material.get("normalTexture", {}).get("scale", 1.0))
    factors["occlusion"] = float(material.get("occlusionTexture", {}).get("strength", 1.0))


def _gltf_image(path: Path, document: dict, binary: bytes | None, index: int) -> tuple[Path, bytes | None]:
    """The file of a texture, or the glTF file and the bytes embedded in it."""
    texture = document["textures"][index]
    source: Any = texture.get("source")
    for extension in ("EXT_texture_webp", "KHR_texture_basisu"):
        if source is None:
            source = texture.get("extensions", {}).get(extension, {}).get("source")
    image = document["images"][source]
    if image.get("mimeType") == "image/ktx2":
        raise InputError(f"'{path}' keeps its textures as KTX2, expected PNG, JPEG or WebP.")
    if "uri" not in image:
        view = document["bufferViews"][image["bufferView"]]
        buffer = document["buffers"][view["buffer"]]
        data = _buffer(path, buffer["uri"]) if "uri" in buffer else binary
        start, length = view.get("byteOffset", 0), view["byteLength"]
        if data is None or start + length > len(data):
            raise InputError(f"'{path}' is truncated: the bytes of its image {source} are missing.")
        return path, data[start : start + length]
    if image["uri"].startswith("data:"):
        return path, _data_uri(path, image["uri"])
    return path.parent / unquote(image["uri"]), None


def _buffer(path: Path, uri: str) -> bytes:
    if uri.startswith("data:"):
        return _data_uri(path, uri)
    file = path.parent / unquote(uri)
    try:
        return file.read_bytes()
    except OSError as error:
        raise InputError(f"'{file}', a buffer of '{path}', cannot be read: {error.strerror}.") from error


def _data_uri(path: Path, uri: str) -> bytes:
    try:
        return base64.b64decode(uri.split(",", 1)[1], validate=True)
    except (IndexError, binascii.Error) as error:
        raise InputError(f"'{path}' has a data URI that is not base64 ({error}).") from error


def _glb_chunks(path: Path, data: bytes) -> tuple[bytes, bytes | None]:
    """The JSON and the binary chunk of a .glb file."""
    try:
        _, version, length = struct.unpack_from("<4sII", data)
        chunks, offset = [], 12
        while offset < length:
            size, kind = struct.unpack_from("<I4s", data, offset)
            if offset + 8 + size > len(data):
                raise InputError(f"'{path}' is truncated: it has {len(data)} bytes, expected {length}.")
            chunks.append((kind, data[offset + 8 : offset + 8 + size]))
            offset += 8 + size
    except struct.error as error:
        raise InputError(f"'{path}' is truncated: it has {len(data)} bytes and its chunks go on.") from error
    if version != 2 or not chunks or chunks[0][0] != b"JSON":
        raise InputError(f"'{path}' is a .glb file of version {version}, expected version 2 with a JSON chunk first.")
    binary = next((chunk for kind, chunk in chunks[1:] if kind == b"BIN\0"), None)
    return chunks[0][1], binary
