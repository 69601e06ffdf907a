"""The container of a glTF 2.0 file: its JSON, its buffers, and where the bytes of its images lie."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from brdffit.errors import InputError

#: Extensions that a file may require and still be read: those of geometry and light are not needed here, those of
#: materials are read or named in a note.
KNOWN_EXTENSIONS = frozenset(
    (
        "KHR_texture_transform", "KHR_materials_pbrSpecularGlossiness", "KHR_materials_anisotropy",
        "KHR_materials_specular", "KHR_materials_ior", "KHR_materials_clearcoat", "KHR_materials_sheen",
        "KHR_materials_transmission", "KHR_materials_volume", "KHR_materials_iridescence", "KHR_materials_dispersion",
        "KHR_materials_diffuse_transmission", "KHR_materials_emissive_strength", "KHR_materials_unlit",
        "KHR_materials_variants", "KHR_lights_punctual", "KHR_mesh_quantization", "KHR_draco_mesh_compression",
        "KHR_animation_pointer", "KHR_node_visibility", "KHR_xmp", "KHR_xmp_json_ld", "KHR_texture_basisu",
        "EXT_texture_webp", "EXT_texture_avif", "EXT_meshopt_compression", "EXT_mesh_gpu_instancing",
        "EXT_lights_image_based", "MSFT_texture_dds", "MSFT_lod", "MSFT_packing_occlusionRoughnessMetallic",
        "MSFT_packing_normalRoughnessMetallic",
    )
)  # fmt: skip
#: Extensions of a texture that name another source for it.
_SOURCES = ("EXT_texture_webp", "EXT_texture_avif", "MSFT_texture_dds", "KHR_texture_basisu")


def read_document(path: Path, data: bytes) -> tuple[dict[str, Any], bytes | None]:
    """The JSON of a .gltf or .glb file and the binary chunk of the latter.

    Raises:
        InputError: when it is damaged, of another version, or requires an extension that is not known here.
    """
    text, binary = chunks_of(path, data) if data[:4] == b"glTF" else (data, None)
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"'{path}' is no glTF file: its JSON cannot be read ({error}).") from error
    if not isinstance(document, dict):
        raise InputError(f"'{path}' is no glTF file: its JSON is no object.")
    asset = document.get("asset")
    version = str(asset.get("version", "")) if isinstance(asset, dict) else ""
    if version and not version.startswith("2."):
        raise InputError(f"'{path}' is a glTF file of version {version}, expected 2.0.")
    required = document.get("extensionsRequired", [])
    unknown = [str(each) for each in required if each not in KNOWN_EXTENSIONS] if isinstance(required, list) else []
    if unknown:
        raise InputError(f"'{path}' requires {', '.join(unknown)}, which is not read here, expected a file without.")
    return document, binary


def image_of(path: Path, document: dict, binary: bytes | None, index: int) -> tuple[Path, bytes | None]:
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
        return path, view_bytes(path, document, binary, image["bufferView"])
    if image["uri"].startswith("data:"):
        return path, _data_uri(path, image["uri"])
    return path.parent / unquote(image["uri"]), None


def view_bytes(path: Path, document: dict, binary: bytes | None, index: int) -> bytes:
    """The bytes of a buffer view.

    Raises:
        InputError: when they are not all there.
    """
    view = document["bufferViews"][index]
    buffer = document["buffers"][view["buffer"]]
    data = _buffer(path, buffer["uri"]) if "uri" in buffer else binary
    start, length = view.get("byteOffset", 0), view["byteLength"]
    if data is None or start + length > len(data):
        raise InputError(f"'{path}' is truncated: the bytes of its buffer view {index} are missing.")
    return data[start : start + length]


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


def chunks_of(path: Path, data: bytes) -> tuple[bytes, bytes | None]:
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
