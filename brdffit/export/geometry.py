"""The geometry of a glTF file that uses a material, copied so that a GLB shows the baked material on it.

Nodes, meshes and their static vertices are taken; skins, morph targets, animations, cameras and lights are not. Source:
glTF 2.0, KHR_texture_transform, KHR_mesh_quantization (Khronos).
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from brdffit.errors import InputError
from brdffit.textures.gltf_files import read_document, view_bytes

#: References to textures that are read of a material.
_READ = frozenset(
    (
        "normalTexture", "occlusionTexture", "baseColorTexture", "metallicRoughnessTexture", "diffuseTexture",
        "specularGlossinessTexture", "anisotropyTexture", "specularTexture", "specularColorTexture",
    )
)  # fmt: skip
_QUANTIZED, _TRANSFORM = "KHR_mesh_quantization", "KHR_texture_transform"
#: Compressed vertices: their bytes say nothing without a decoder.
_COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")


class Writer(Protocol):
    """What takes bytes and accessors, see ``gltf``."""

    accessors: list[dict[str, Any]]

    def add(self, data: bytes, target: int | None = None, stride: int | None = None) -> int:
        """Append a buffer view; its index."""
        ...


@dataclass(frozen=True)
class Geometry:
    """The geometry that uses a material.

    Attributes:
        path: the glTF file.
        document, binary: its JSON, and its binary chunk if any.
        material: number of the material in it.
        place: "texCoord" and the texture transform of its references to textures, where there are such.
    """

    path: Path
    document: dict[str, Any]
    binary: bytes | None
    material: int
    place: dict[str, Any]

    @property
    def extensions(self) -> list[str]:
        """Extensions that the copied parts use and a reader must know."""
        quantized = _QUANTIZED in self.document.get("extensionsUsed", [])
        return ([_QUANTIZED] if quantized else []) + ([_TRANSFORM] if "extensions" in self.place else [])

    def copied(self, to: Writer) -> dict[str, Any]:
        """Nodes, meshes, scenes of a document whose only material is this one; vertices go to ``to``."""
        views: dict[int, int] = {}
        accessors: dict[int, int] = {}
        meshes: dict[int, int] = {}
        made: list[dict[str, Any]] = []
        for number, mesh in enumerate(self.document["meshes"]):
            primitives = [self._primitive(each, to, views, accessors) for each in self._wearing(mesh)]
            if primitives:
                meshes[number] = len(made)
                made.append({"primitives": primitives, **{key: mesh[key] for key in ("name",) if key in mesh}})
        nodes, roots = self._nodes(meshes)
        return {"meshes": made, "nodes": nodes, "scenes": [{"nodes": roots}], "scene": 0}

    def _wearing(self, mesh: dict[str, Any]) -> Iterator[dict[str, Any]]:
        return (each for each in mesh["primitives"] if each.get("material") == self.material)

    def _primitive(
        self, primitive: dict[str, Any], to: Writer, views: dict[int, int], accessors: dict[int, int]
    ) -> dict[str, Any]:
        def accessor(number: int) -> int:
            if number not in accessors:
                accessors[number] = self._accessor(number, to, views)
            return accessors[number]

        kept = {
            name: accessor(number)
            for name, number in primitive["attributes"].items()
            if not name.startswith(("JOINTS_", "WEIGHTS_"))
        }
        found: dict[str, Any] = {"attributes": kept, "material": 0}
        if "indices" in primitive:
            found["indices"] = accessor(primitive["indices"])
        return found | ({"mode": primitive["mode"]} if "mode" in primitive else {})

    def _accessor(self, number: int, to: Writer, views: dict[int, int]) -> int:
        """Copy an accessor with the views that it reads, once each; its new number."""
        accessor = copy.deepcopy(self.document["accessors"][number])
        sparse = accessor.get("sparse", {})
        for part in (accessor, sparse.get("indices", {}), sparse.get("values", {})):
            if "bufferView" in part:
                old = part["bufferView"]
                if old not in views:
                    view = self.document["bufferViews"][old]
                    data = view_bytes(self.path, self.document, self.binary, old)
                    views[old] = to.add(data, view.get("target"), view.get("byteStride"))
                part["bufferView"] = views[old]
        to.accessors.append(accessor)
        return len(to.accessors) - 1

    def _nodes(self, meshes: dict[int, int]) -> tuple[list[dict[str, Any]], list[int]]:
        """Nodes that lead to a mesh, and the roots among them, in the order of the file."""
        source: list[dict[str, Any]] = self.document.get("nodes", [])
        scenes = self.document.get("scenes", [])
        below = {child for node in source for child in node.get("children", [])}
        roots = [number for number in range(len(source)) if number not in below]
        if scenes:
            roots = scenes[self.document.get("scene", 0)].get("nodes", roots)
        nodes: list[dict[str, Any]] = []

        def keep(number: int, depth: int = 0) -> int | None:
            if depth > len(source):
                raise ValueError("nodes run in a circle")
            node = source[number]
            children = [kept for child in node.get("children", []) if (kept := keep(child, depth + 1)) is not None]
            if node.get("mesh") not in meshes and not children:
                return None
            place = ("name", "matrix", "translation", "rotation", "scale")
            found = {key: node[key] for key in place if key in node}
            found |= {"mesh": meshes[node["mesh"]]} if node.get("mesh") in meshes else {}
            nodes.append(found | ({"children": children} if children else {}))
            return len(nodes) - 1

        kept = [new for number in roots if (new := keep(number)) is not None]
        return nodes, kept


def geometry_of(path: Path, material: int) -> tuple[Geometry | None, str]:
    """The geometry that uses a material of a glTF file; or None, and why a rectangle is used instead."""
    try:
        document, binary = read_document(path, path.read_bytes())
        return _geometry(path, document, binary, material)
    except (OSError, InputError) as error:
        return None, f"it cannot be read ({error})"
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, RecursionError) as error:
        return None, f"its geometry is damaged ({error!r})"


def _geometry(path: Path, document: dict[str, Any], binary: bytes | None, material: int) -> tuple[Geometry | None, str]:
    places = [_place(each) for each in _references(document["materials"][material])]
    wearing = [
        primitive
        for mesh in document.get("meshes", [])
        for primitive in mesh["primitives"]
        if primitive.get("material") == material
    ]
    views = document.get("bufferViews", [])
    if not wearing:
        return None, "no mesh wears the material"
    if any(place != places[0] for place in places):
        return None, "its maps have texture transforms of their own"
    if any(name in part.get("extensions", {}) for part in (*wearing, *views) for name in _COMPRESSED):
        return None, "its vertices are compressed"
    found = Geometry(path, document, binary, material, places[0] if places else {})
    if not found.copied(_Nowhere())["scenes"][0]["nodes"]:
        return None, "the scene does not show what wears the material"
    return found, ""


class _Nowhere:
    """Takes vertices and forgets them."""

    def __init__(self) -> None:
        self.accessors: list[dict[str, Any]] = []

    def add(self, data: bytes, target: int | None = None, stride: int | None = None) -> int:
        del data, target, stride
        return 0


def _references(part: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """References to textures that are read, wherever in a material they are."""
    for key, value in part.items():
        if key in _READ:
            yield value
        elif isinstance(value, dict):
            yield from _references(value)


def _place(reference: dict[str, Any]) -> dict[str, Any]:
    found = {"texCoord": reference["texCoord"]} if reference.get("texCoord") else {}
    transform = reference.get("extensions", {}).get(_TRANSFORM)
    return found | ({"extensions": {_TRANSFORM: transform}} if transform else {})
