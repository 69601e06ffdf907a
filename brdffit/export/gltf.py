"""A GLB whose material holds our own MIP levels: KTX2 pictures under KHR_texture_basisu.

The material is applied to a rectangle, or to the input's own geometry. Source: glTF 2.0, KHR_texture_basisu,
KHR_materials_anisotropy, KHR_materials_specular (Khronos).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from brdffit.export.factors import Factors
from brdffit.export.geometry import Geometry

_ARRAY, _ELEMENTS = 34962, 34963
_FLOAT, _UNSIGNED_SHORT = 5126, 5123
_PLAIN = Factors()
_LINEAR, _TRILINEAR, _REPEAT, _CLAMP = 9729, 9987, 10497, 33071


def write_glb(
    file: BinaryIO, textures: Mapping[str, bytes], name: str, size: tuple[int, int], wrap: str, *, alpha: str = "",
    cutoff: float | None = None, factors: Factors = _PLAIN, geometry: Geometry | None = None,
) -> None:  # fmt: skip
    """Write a GLB.

    Args:
        file: opened for writing in binary.
        textures: KTX2 files by role: baseColor, normal, occlusionRoughnessMetallic and, if there are such, anisotropy
            and specularColor.
        name: of the material.
        size: (height, width) of level 0; the square becomes a rectangle of these proportions, its longer side 2 wide.
        wrap: "tile" or "clamp".
        alpha: "mask", "blend" or "": how the base colour's alpha is used.
        cutoff: of a mask.
        factors: by which the pictures are divided, and which the material multiplies.
        geometry: the geometry that the material is applied to; None for the rectangle.

    Raises:
        OSError: when the file cannot be written.
    """
    binary = _Binary()
    if geometry is None:
        document = {
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0, "name": name}],
            "meshes": [{"primitives": [_rectangle(binary, size)]}],
        }
    else:
        document = geometry.copied(binary)
    mode = _REPEAT if wrap == "tile" else _CLAMP
    document |= {
        "asset": {"version": "2.0", "generator": "brdffit"},
        "accessors": binary.accessors,
        "bufferViews": binary.views,
        "samplers": [{"magFilter": _LINEAR, "minFilter": _TRILINEAR, "wrapS": mode, "wrapT": mode}],
    }
    document["images"] = [
        {"bufferView": binary.add(data), "mimeType": "image/ktx2", "name": f"{name}_{role}"}
        for role, data in textures.items()
    ]
    document["textures"] = [
        {"sampler": 0, "extensions": {"KHR_texture_basisu": {"source": place}}} for place in range(len(textures))
    ]
    place = {} if geometry is None else geometry.place
    references = {role: {"index": number, **place} for number, role in enumerate(textures)}
    material = _material(name, references, factors, alpha, cutoff)
    document["materials"] = [material]
    required = ["KHR_texture_basisu", *(() if geometry is None else geometry.extensions)]
    document["extensionsRequired"] = sorted(required)
    document["extensionsUsed"] = sorted([*required, *material.get("extensions", {})])
    document["buffers"] = [{"byteLength": len(binary.data)}]
    _write_chunks(file, document, binary.data)


def _write_chunks(file: BinaryIO, document: Mapping[str, Any], binary: bytes | bytearray) -> None:
    """The container of glTF 2.0: a header, the document as JSON, its buffer; each chunk a multiple of 4 bytes long."""
    text = json.dumps(document, separators=(",", ":"), sort_keys=True).encode()
    text += b" " * (-len(text) % 4)
    file.write(struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(binary)))
    file.write(struct.pack("<I4s", len(text), b"JSON") + text)
    file.write(struct.pack("<I4s", len(binary), b"BIN\0"))
    file.write(binary)


def _material(
    name: str, references: Mapping[str, dict[str, Any]], factors: Factors, alpha: str, cutoff: float | None
) -> dict[str, Any]:
    """A material of some references to textures, by role."""
    packed = references["occlusionRoughnessMetallic"]
    material: dict[str, Any] = {
        "name": name,
        "pbrMetallicRoughness": {
            "baseColorTexture": references["baseColor"],
            "metallicRoughnessTexture": packed,
            "roughnessFactor": factors.roughness,
        },
        "normalTexture": {**references["normal"], "scale": factors.normal},
        "occlusionTexture": packed,
    }
    extensions: dict[str, Any] = {}
    if "anisotropy" in references:
        extensions["KHR_materials_anisotropy"] = {
            "anisotropyStrength": factors.strength,
            "anisotropyRotation": 0.0,
            "anisotropyTexture": references["anisotropy"],
        }
    if "specularColor" in references:
        extensions["KHR_materials_specular"] = {
            "specularColorFactor": [factors.specular] * 3,
            "specularColorTexture": references["specularColor"],
        }
    if alpha:
        # Cut-outs are mostly thin, as leaves are, and seen from both sides.
        material |= {"alphaMode": "BLEND" if cutoff is None else "MASK", "doubleSided": True}
        material |= {} if cutoff is None else {"alphaCutoff": cutoff}
    return material | ({"extensions": extensions} if extensions else {})


class _Binary:
    """The binary chunk and what the document says of its parts."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, int]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, data: bytes, target: int | None = None, stride: int | None = None) -> int:
        """Append a buffer view; its index."""
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)}
        view |= {} if target is None else {"target": target}
        self.views.append(view | ({} if stride is None else {"byteStride": stride}))
        self.data += data + bytes(-len(data) % 4)
        return len(self.views) - 1

    def add_array(self, array: NDArray, kind: str, bounds: bool = False) -> int:
        """Append an accessor of an array of vertices, or of indices; its index."""
        indices = array.dtype == np.uint16
        accessor: dict[str, Any] = {
            "bufferView": self.add(array.tobytes(), _ELEMENTS if indices else _ARRAY),
            "componentType": _UNSIGNED_SHORT if indices else _FLOAT,
            "count": len(array),
            "type": kind,
        }
        if bounds:
            accessor |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def _rectangle(binary: _Binary, size: tuple[int, int]) -> dict[str, Any]:
    """A rectangle that faces +Z, row 0 of the pictures at its top."""
    height, width = np.array(size) / max(size)
    position = np.array([[-width, -height, 0], [width, -height, 0], [width, height, 0], [-width, height, 0]], "<f4")
    normal = np.tile(np.array([0, 0, 1], "<f4"), (4, 1))
    tangent = np.tile(np.array([1, 0, 0, 1], "<f4"), (4, 1))
    coordinates = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], "<f4")
    return {
        "attributes": {
            "POSITION": binary.add_array(position, "VEC3", bounds=True),
            "NORMAL": binary.add_array(normal, "VEC3"),
            "TANGENT": binary.add_array(tangent, "VEC4"),
            "TEXCOORD_0": binary.add_array(coordinates, "VEC2"),
        },
        "indices": binary.add_array(np.array([0, 1, 2, 0, 2, 3], np.uint16), "SCALAR"),
        "material": 0,
    }
