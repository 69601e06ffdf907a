"""MaterialX (.mtlx) documents: which image feeds which input of a surface shader."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from brdffit.errors import InputError
from brdffit.methods import one_of
from brdffit.textures.naming import roles_from_names
from brdffit.textures.texture_set import Map, TextureSet

#: Inputs of the surface shaders that are understood, by role.
_SHADER_INPUTS = {
    "standard_surface": {
        "base_color": "base_color",
        "specular_roughness": "roughness",
        "metalness": "metallic",
        "normal": "normal",
    },
    "open_pbr_surface": {
        "base_color": "base_color",
        "specular_roughness": "roughness",
        "base_metalness": "metallic",
        "geometry_normal": "normal",
    },
    "gltf_pbr": {
        "base_color": "base_color",
        "roughness": "roughness",
        "metallic": "metallic",
        "normal": "normal",
        "occlusion": "ao",
    },
    "UsdPreviewSurface": {
        "diffuseColor": "base_color",
        "roughness": "roughness",
        "metallic": "metallic",
        "normal": "normal",
        "occlusion": "ao",
        "displacement": "height",
    },
}
#: What a node's outputs or an index are called, by channel.
_OUTPUT_CHANNELS = {
    "outr": "R",
    "outg": "G",
    "outb": "B",
    "outa": "A",
    "outx": "R",
    "outy": "G",
    "outz": "B",
    "outw": "A",
}
_IMAGE_NODES = (
    "image",
    "tiledimage",
    "gltf_image",
    "gltf_colorimage",
    "gltf_normalmap",
    "UsdUVTexture",
    "hextiledimage",
)
_MAX_DEPTH = 32


def read_materialx(path: Path, data: bytes, name: str | None = None) -> TextureSet:
    """The texture set of the first surface shader in a MaterialX document.

    Raises:
        InputError: when the document is damaged or has no surface shader that is understood.
    """
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise InputError(f"'{path}' declares a document type, expected plain MaterialX.")
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise InputError(f"'{path}' is no MaterialX file: its XML cannot be read ({error}).") from error
    if root.tag != "materialx":
        raise InputError(f"'{path}' is an XML file of <{root.tag}>, expected <materialx>.")
    shaders = [node for node in root.iter() if node.tag in _SHADER_INPUTS]
    if name is not None:
        names = [node.get("name", "") for node in shaders]
        shaders = [shaders[names.index(one_of("material", name, names))]]
    shader = next(iter(shaders), None)
    if shader is None:
        raise InputError(f"'{path}' has no surface shader of {', '.join(_SHADER_INPUTS)}, expected one.")
    graph = _Graph(path, root)
    texture_set = TextureSet(name=path.stem, maps={}, normal_y="gl", normal_y_source="convention", entry=path)
    try:
        for port, role in _SHADER_INPUTS[shader.tag].items():
            graph.follow_into(texture_set, shader, port, role)
        for node in root.iter("displacement"):
            graph.follow_into(texture_set, node, "displacement", "height")
    except (ValueError, IndexError) as error:
        raise InputError(
            f"'{path}' has an input that cannot be read ({error}), expected numbers and channels."
        ) from error
    normal = texture_set.maps.get("normal")
    if normal is not None:
        named = roles_from_names([normal.path.name]).maps.get("normal")
        if named is not None and named.normal_y:
            texture_set.normal_y, texture_set.normal_y_source = named.normal_y, "name"
    return texture_set


class _Graph:
    """Nodes of a document by name, and the walk from a shader's input to the image that feeds it."""

    def __init__(self, path: Path, root: ElementTree.Element) -> None:
        self.path, self.root = path, root
        self.parents = {child: parent for parent in root.iter() for child in parent}

    def follow_into(self, texture_set: TextureSet, node: ElementTree.Element, name: str, role: str) -> None:
        """Add the map or the constant that feeds an input."""
        port = _input(node, name)
        if port is None:
            return
        found = self._image(port, "", 0)
        if found is not None:
            file, channel = found
            texture_set.maps[role] = Map(role, file, "" if role in ("base_color", "normal") else channel)
        elif port.get("value") and role in ("base_color", "roughness", "metallic"):
            numbers = np.array([float(part) for part in re.split(r"[,\s]+", port.get("value", "").strip())], np.float32)
            texture_set.factors[role] = numbers if role == "base_color" else float(numbers[0])

    def _image(self, port: ElementTree.Element, channel: str, depth: int) -> tuple[Path, str] | None:
        """File and channel of the image upstream of an input."""
        channel = _OUTPUT_CHANNELS.get(port.get("output", ""), channel)
        node = self._source(port)
        if node is None or depth > _MAX_DEPTH:
            return None
        if node.tag == "output":
            return self._image(node, channel, depth + 1)
        if node.tag in _IMAGE_NODES:
            file = _input(node, "file")
            if file is None or not file.get("value"):
                return None
            return self.path.parent / (self._prefix(node) + file.get("value", "")), channel
        index = _input(node, "index")
        if node.tag == "extract" and index is not None:
            channel = "RGBA"[int(index.get("value", "0"))]
        for upstream in node.iter("input"):
            found = self._image(upstream, channel, depth + 1)
            if found is not None:
                return found
        return None

    def _source(self, port: ElementTree.Element) -> ElementTree.Element | None:
        """The node, or the output of a node graph, that an input is connected to."""
        graph_name, node_name = port.get("nodegraph"), port.get("nodename")
        if graph_name:
            graph = next((g for g in self.root.iter("nodegraph") if g.get("name") == graph_name), None)
            outputs = [] if graph is None else [o for o in graph.iter("output")]
            named = [o for o in outputs if o.get("name") == port.get("output")]
            return next(iter(named or outputs), None)
        if node_name:
            return next((n for n in self.root.iter() if n.get("name") == node_name and n.tag != "input"), None)
        return None

    def _prefix(self, node: ElementTree.Element) -> str:
        """File prefix of the nearest element that gives one."""
        element: ElementTree.Element | None = node
        while element is not None:
            if element.get("fileprefix"):
                return element.get("fileprefix", "")
            element = self.parents.get(element)
        return ""


def _input(node: ElementTree.Element, name: str) -> ElementTree.Element | None:
    return next((port for port in node.findall("input") if port.get("name") == name), None)
