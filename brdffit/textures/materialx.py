"""MaterialX (.mtlx) documents: what a surface shader says, evaluated on the pixels of its images.

Names, versions and defaults are those of the MaterialX package; the graph behind each input is walked by
``materialx_graph``. An input that is one image as it stands becomes a plain map; one that is computed becomes a map
that is computed when it is read; one that cannot be evaluated is named, with what is taken instead.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import MaterialX as mx
import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.methods import one_of
from brdffit.textures.computed import ComputedMap, computed_frame
from brdffit.textures.materialx_graph import ERRORS, Constant, Expression, Graph, NotEvaluated, Picture, constant_of
from brdffit.textures.naming import roles_from_names
from brdffit.textures.texture_set import Map, TextureSet

#: Inputs of the surface shaders that are understood, by role; "*" names an input that multiplies it.
_SHADERS: dict[str, dict[str, str]] = {
    "standard_surface": {
        "base_color": "base_color*base", "roughness": "specular_roughness", "metallic": "metalness",
        "normal": "normal", "specular_level": "specular", "specular_color": "specular_color", "f0": "specular_IOR",
        "opacity": "opacity",
    },
    "open_pbr_surface": {
        "base_color": "base_color*base_weight", "roughness": "specular_roughness", "metallic": "base_metalness",
        "normal": "geometry_normal", "specular_level": "specular_weight", "specular_color": "specular_color",
        "f0": "specular_ior", "opacity": "geometry_opacity",
    },
    "gltf_pbr": {
        "base_color": "base_color", "roughness": "roughness", "metallic": "metallic", "normal": "normal",
        "ao": "occlusion", "specular_level": "specular", "specular_color": "specular_color", "f0": "ior",
        "opacity": "alpha",
    },
    "UsdPreviewSurface": {
        "base_color": "diffuseColor", "roughness": "roughness", "metallic": "metallic", "normal": "normal",
        "ao": "occlusion", "height": "displacement", "f0": "ior", "opacity": "opacity",
    },
    "disney_principled": {
        "base_color": "baseColor", "roughness": "roughness", "metallic": "metallic",
    },
}  # fmt: skip
#: Weights of layers that are not read; a note names those that are not zero.
_LAYERS = {
    "standard_surface": ("coat", "sheen", "transmission", "subsurface", "emission", "thin_film_thickness",
                         "specular_anisotropy"),
    "open_pbr_surface": ("coat_weight", "fuzz_weight", "transmission_weight", "subsurface_weight", "thin_film_weight",
                         "emission_luminance", "specular_roughness_anisotropy"),
    "gltf_pbr": ("clearcoat", "sheen_color", "transmission", "iridescence", "emissive", "anisotropy_strength"),
    "UsdPreviewSurface": ("clearcoat", "emissiveColor", "useSpecularWorkflow"),
    "disney_principled": ("clearcoat", "sheen", "specTrans", "subsurface", "anisotropic"),
}  # fmt: skip
_COLOURS = ("base_color", "specular_color")


@cache
def _library() -> Any:
    """Node definitions and graphs of the MaterialX package."""
    library = mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), library)
    return library


def _document(path: Path, data: bytes) -> Any:
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise InputError(f"'{path}' declares a document type, expected plain MaterialX.")
    if b"<materialx" not in data:
        raise InputError(f"'{path}' has no <materialx> element, expected a MaterialX document.")
    document = mx.createDocument()
    try:
        mx.readFromXmlString(document, data.decode("utf-8"), mx.FileSearchPath(str(path.parent)))
        document.importLibrary(_library())
    except (*ERRORS, ValueError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"'{path}' is no MaterialX file: its XML cannot be read ({reason}).") from error
    return document


def read_materialx(path: Path, data: bytes, name: str | None = None) -> TextureSet:
    """The texture set of a material in a MaterialX document.

    Args:
        path: the document, for sentences and for what lies beside it.
        data: its bytes.
        name: of the material or of its shader; None takes, of those whose shader is understood, the first with a
            connected input, or the first.

    Raises:
        InputError: when the document is damaged or has no surface shader that is understood.
        UnknownNameError: for a name that no material has.
    """
    document = _document(path, data)
    shaders = _shaders(document)
    known = {key: node for key, (node, _) in shaders.items() if node.getCategory() in _SHADERS}
    if not known:
        found = ", ".join(f"<{node.getCategory()}>" for node, _ in shaders.values()) or "none"
        raise InputError(f"'{path}' has no surface shader of {', '.join(_SHADERS)}, expected one (found: {found}).")
    chosen = one_of("material", name, list(known)) if name is not None else _first(known)
    texture_set = TextureSet(name=path.stem, maps={}, normal_y="gl", normal_y_source="convention", entry=path)
    others = [key for key in shaders if key != chosen]
    if name is None and others:
        texture_set.note(
            f"'{path.name}' has {len(shaders)} materials: '{chosen}' is read, the others are left out "
            f"({', '.join(others[:8])}{', ...' if len(others) > 8 else ''}); --material NAME names another."
        )
    _Reader(texture_set, Graph(path, document), shaders[chosen][0]).read(shaders[chosen][1])
    return texture_set


def materialx_material_names(path: Path) -> list[str]:
    """Names of the materials of a document whose shader is understood.

    Raises:
        InputError: when the document cannot be read.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror}.") from error
    shaders = _shaders(_document(path, data))
    return [key for key, (node, _) in shaders.items() if node.getCategory() in _SHADERS]


def _shaders(document: Any) -> dict[str, tuple[Any, Any]]:
    """Surface shader and displacement (or None) by the name of their material; of lone shaders, by their own."""
    found: dict[str, tuple[Any, Any]] = {}
    own = [node for node in document.getMaterialNodes() if not node.hasSourceUri()]
    try:
        for material in own:
            parts = [mx.getShaderNodes(material, kind) for kind in ("surfaceshader", "displacementshader")]
            if parts[0]:
                found[material.getName()] = (parts[0][0], parts[1][0] if parts[1] else None)
        if not found:
            alone = [node for node in document.traverseTree() if node.getCategory() in _SHADERS and node.isA(mx.Node)]
            displaced = [node for node in document.getNodes("displacement")]
            for node in alone:
                found[node.getName()] = (node, displaced[0] if displaced else None)
    except ERRORS:
        return {}
    return found


def _first(known: dict[str, Any]) -> str:
    """The first material with an input that is connected, or the first."""
    for key, node in known.items():
        if any(port.getConnectedNode() is not None or port.getNodeGraphString() for port in node.getInputs()):
            return key
    return next(iter(known))


class _Reader:
    """Fills a texture set from one surface shader."""

    def __init__(self, texture_set: TextureSet, graph: Graph, shader: Any) -> None:
        self.set, self.graph, self.shader = texture_set, graph, shader
        self.path, self.kind = graph.path, shader.getCategory()
        self.found: dict[str, Any] = {}
        self.coat_is_specular = False

    def read(self, displacement: Any) -> None:
        for role, names in _SHADERS[self.kind].items():
            name, _, weight = names.partition("*")
            self.found[role] = self.weighted(role, name, weight)
        if displacement is not None and self.found.get("height") is None:
            self.found["height"] = self.evaluated("height", displacement, "displacement")
        self.coat_for_specular()
        pictures = [p for value in self.found.values() if hasattr(value, "pictures") for p in value.pictures()]
        self.settle(list({id(picture): picture for picture in pictures}.values()))
        for role, value in self.found.items():
            if value is not None:
                self.add(role, value)
        if self.kind == "gltf_pbr":
            self.alpha_mode()
        self.name_layers()

    def evaluated(self, role: str, node: Any, name: str) -> Any:
        """The expression that feeds an input; where it cannot be evaluated, a note and the shader's default or None."""
        try:
            if role == "normal" and node.getInput(name) is None:
                return None
            return self.graph.of_input(node, name)
        except NotEvaluated as error:
            default = self.shader.getNodeDef().getActiveInput(name) if self.shader.getNodeDef() is not None else None
            value = default.getValueString() if default is not None else ""
            taken = f"the default of {self.kind}, {value}, is taken" if value else "none is taken"
            self.set.note(f"The {role} of '{self.path.name}' hangs on {error}: not evaluated on pixels, {taken}.")
            return constant_of(default) if value and role != "normal" else None

    def weighted(self, role: str, name: str, weight: str) -> Any:
        value = self.evaluated(role, self.shader, name)
        factor = self.evaluated(role, self.shader, weight) if weight else None
        if value is None or factor is None:
            return value
        if isinstance(factor, Constant) and (factor.value == 1.0).all():
            return value
        if isinstance(value, Constant) and isinstance(factor, Constant):
            return Constant(value.value * factor.value)
        return Expression("multiply", np.multiply, (value, factor))

    def coat_for_specular(self) -> None:
        """A shader without specular under a full coat (as ambientCG writes it) has its specular reflection there."""
        level = self.found.get("specular_level")
        if self.kind != "standard_surface" or not isinstance(level, Constant) or level.value.any():
            return
        coat = self.evaluated("coat", self.shader, "coat")
        if isinstance(coat, Constant) and coat.value.any():
            self.coat_is_specular = True
            self.found["specular_level"] = coat
            self.found["f0"] = self.evaluated("f0", self.shader, "coat_IOR")
            self.found["specular_color"] = self.evaluated("specular_color", self.shader, "coat_color")
            self.set.note(f"The material of '{self.path.name}' has no specular but a coat: that is read as it.")

    def settle(self, pictures: list[Picture]) -> None:
        """Bring all pictures to one frame, and their address modes to the set's."""
        wraps = {picture.wrap for picture in pictures}
        self.set.wrap = next(iter(wraps)) if len(wraps) == 1 else ", ".join(sorted(wraps)) or "tile"
        frames = {picture.frame for picture in pictures}
        if len(frames) <= 1:
            if any(not frame.is_identity for frame in frames):
                self.set.note("All maps share a texture transform: it stays with the renderer.")
            for picture in pictures:
                picture.frame = type(picture.frame)()
            return
        common = computed_frame([picture.frame for picture in pictures])
        back = common.inverse() if common is not None else None
        if back is None:
            files = ", ".join(sorted({picture.path.name for picture in pictures}))
            raise InputError(
                f"The images of '{self.path}' are scaled or turned against each other so that they do not tile "
                f"together ({files}), expected one tiling, or such that each repeats a whole number of times."
            )
        self.set.note("Images are tiled differently: each is read as it lies under the slowest of them.")
        for picture in pictures:
            picture.frame = picture.frame.after(back)

    def add(self, role: str, value: Any) -> None:
        """The map or the factor of a role."""
        if isinstance(value, Constant):
            self.add_constant(role, value.value.ravel())
            return
        if not isinstance(value, Expression | Picture):
            return
        if role == "normal":
            self.add_normal(value)
            return
        if role == "f0":
            self.set.note(f"The index of refraction of '{self.path.name}' is a map, which is not read: 1.5 is taken.")
            return
        picture, channel = _plain(value)
        if role in _COLOURS and isinstance(value, Picture) and value.color_space in ("srgb_texture", "lin_rec709", ""):
            encoding = {"srgb_texture": "srgb", "lin_rec709": "linear", "": ""}[value.color_space]
            self.set.maps[role] = Map(role, value.path, frame=value.frame, encoding=encoding)
        elif role not in _COLOURS and picture is not None and picture.color_space in ("", "none", "lin_rec709", "raw"):
            self.set.maps[role] = Map(role, picture.path, channel, as_rgba=True, frame=picture.frame)
        else:
            self.set.maps[role] = ComputedMap(role, self.path, expression=value, encoding="linear")
        if role == "opacity":
            self.set.factors.setdefault("opacity", 1.0)

    def add_constant(self, role: str, numbers: NDArray) -> None:
        factors = self.set.factors
        if role in _COLOURS:
            colour = np.broadcast_to(numbers, 3) if numbers.size == 1 else numbers[:3]
            factors[role] = np.asarray(colour, np.float32)
        elif role == "f0":
            n = float(numbers[0])
            factors["f0"] = ((n - 1.0) / (n + 1.0)) ** 2
        elif role == "opacity":
            if float(numbers.mean()) != 1.0:
                factors["opacity"] = float(numbers.mean())
        elif role not in ("normal", "height", "ao"):
            factors[role] = float(numbers[0])

    def add_normal(self, value: Any) -> None:
        if isinstance(value, Picture):
            self.set.note(f"The normal of '{self.path.name}' has no <normalmap>: its image is read as a normal map.")
            value = Expression("normalmap", np.add, (value, Constant(np.ones((1, 1, 1)))))
        picture, channel = _plain(value.inputs[0]) if value.kind == "normalmap" else (None, "")
        scale = value.inputs[1] if value.kind == "normalmap" else None
        if (
            picture is not None
            and not channel
            and isinstance(scale, Constant)
            and picture.color_space != "srgb_texture"
        ):
            self.set.maps["normal"] = Map("normal", picture.path, frame=picture.frame)
            self.set.factors["normal"] = np.asarray(scale.value.ravel(), np.float32)
            named = roles_from_names([picture.path.name]).maps.get("normal")
            if named is not None and named.normal_y:
                self.set.normal_y, self.set.normal_y_source = named.normal_y, "name"
        else:
            self.set.maps["normal"] = ComputedMap("normal", self.path, expression=value, encoding="signed")

    def alpha_mode(self) -> None:
        """Opacity counts in the modes 1 (mask) and 2 (blend) alone."""
        mode = self.evaluated("opacity", self.shader, "alpha_mode")
        number = int(mode.value.flat[0]) if isinstance(mode, Constant) else 0
        if number == 0:
            self.set.maps.pop("opacity", None)
            self.set.factors.pop("opacity", None)
        elif number == 1:
            cutoff = self.evaluated("opacity", self.shader, "alpha_cutoff")
            self.set.alpha_cutoff = float(cutoff.value.flat[0]) if isinstance(cutoff, Constant) else 0.5

    def name_layers(self) -> None:
        """Note, in one sentence, the layers of the shader that are not read."""
        left = []
        for name in _LAYERS[self.kind]:
            if name == "coat" and self.coat_is_specular:
                continue
            try:
                value = self.graph.of_input(self.shader, name) if self.shader.getInput(name) is not None else None
            except NotEvaluated:
                left.append(name)
                continue
            if value is not None and not (isinstance(value, Constant) and not value.value.any()):
                left.append(name)
        if left:
            self.set.note(f"What the material of '{self.path.name}' has besides is left out: {', '.join(left)}.")


def _plain(value: Any) -> tuple[Picture | None, str]:
    """The picture that a value is, as it stands, and its channel; (None, "") where it is computed."""
    if isinstance(value, Picture):
        return value, "R" if value.type in ("float", "integer") else ""
    if isinstance(value, Expression) and value.kind.startswith("channel ") and isinstance(value.inputs[0], Picture):
        return value.inputs[0], "RGBA"[int(value.kind[8:])]
    return None, ""
