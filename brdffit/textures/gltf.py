"""The material of a glTF 2.0 file (.gltf, .glb) as a texture set.

It reads metallic-roughness and specular-glossiness materials with their factors, samplers and texture transforms, and
the extensions for anisotropy, specular and index of refraction. Other parts of a material are named in a note; of the
geometry it reads only which materials it uses.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from brdffit.errors import InputError
from brdffit.methods import one_of
from brdffit.textures.frames import IDENTITY, gltf_frame
from brdffit.textures.gltf_files import image_of, read_document
from brdffit.textures.texture_set import Map, TextureSet

_WRAPS = {10497: "tile", 33071: "clamp", 33648: "mirror"}
#: Extensions of a material that are not read, and their names in the note about it.
_LEFT_OUT = {
    "KHR_materials_clearcoat": "clearcoat",
    "KHR_materials_sheen": "sheen",
    "KHR_materials_transmission": "transmission",
    "KHR_materials_volume": "volume",
    "KHR_materials_iridescence": "iridescence",
    "KHR_materials_dispersion": "dispersion",
    "KHR_materials_diffuse_transmission": "diffuse transmission",
    "KHR_materials_unlit": "the wish to be unlit",
}
_READ = ("KHR_materials_pbrSpecularGlossiness", "KHR_materials_anisotropy", "KHR_materials_specular",
         "KHR_materials_ior", "KHR_materials_emissive_strength")  # fmt: skip


def read_gltf(path: Path, data: bytes, name: str | None = None) -> TextureSet:
    """The texture set of a glTF file's material; its name is the file's stem.

    Args:
        path: the file, for sentences and for what lies beside it.
        data: its bytes.
        name: of the material, or its number; None takes, of those that meshes use, the first with a normal map, or the
            first.

    Raises:
        InputError: when the file is damaged, requires what is not known, or has no material.
        UnknownNameError: for a name that no material has.
    """
    document, binary = read_document(path, data)
    try:
        materials = document.get("materials", [])
        if not materials:
            raise InputError(f"'{path}' has no materials, expected one with a normal texture.")
        names = _names(materials)
        used = _used(document)
        texture_set = TextureSet(name=path.stem, maps={}, normal_y="gl", normal_y_source="convention", entry=path)
        if name is not None:
            at = int(name) if name.isdigit() and int(name) < len(materials) and name not in names else None
            chosen = at if at is not None else names.index(one_of("material", name, names))
        else:
            chosen = next((k for k in used if "normalTexture" in materials[k]), used[0])
            others = [names[k] for k in range(len(materials)) if k != chosen]
            if others:
                texture_set.note(
                    f"'{path.name}' has {len(materials)} materials: '{names[chosen]}' is read, the others are left "
                    f"out ({', '.join(others[:8])}{', ...' if len(others) > 8 else ''}); --material NAME names another."
                )
        texture_set.material = chosen
        _Reader(texture_set, path, document, binary, materials[chosen]).read()
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise InputError(
            f"'{path}' is a damaged glTF file: its material refers to something missing ({error!r})."
        ) from error
    return texture_set


def gltf_material_names(path: Path) -> list[str]:
    """Names of the materials that the meshes of a file use; of all, where it has no meshes.

    Raises:
        InputError: when the file cannot be read.
    """
    try:
        document, _ = read_document(path, path.read_bytes())
        names = _names(document.get("materials", []))
        return [names[k] for k in _used(document)] if names else []
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror}.") from error
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"'{path}' is a damaged glTF file: its materials cannot be listed ({error!r}).") from error


def _names(materials: list[dict]) -> list[str]:
    """A name for each material: its own, or its number where it has none or shares it with one before."""
    names: list[str] = []
    for k, material in enumerate(materials):
        name = str(material.get("name") or k)
        names.append(name if name not in names else str(k))
    return names


def _used(document: dict) -> list[int]:
    """Materials that meshes use, in file order; all, where none is used."""
    found = {
        int(primitive["material"])
        for mesh in document.get("meshes", [])
        for primitive in mesh.get("primitives", [])
        if "material" in primitive
    }
    count = len(document["materials"])
    return sorted(k for k in found if 0 <= k < count) or list(range(count))


class _Reader:
    """Fills a texture set from one material."""

    def __init__(
        self, texture_set: TextureSet, path: Path, document: dict, binary: bytes | None, material: dict
    ) -> None:
        self.set, self.path, self.document, self.binary, self.material = texture_set, path, document, binary, material
        self.coordinates: dict[str, int] = {}
        self.wraps: dict[str, str] = {}

    def read(self) -> None:
        material, factors = self.material, self.set.factors
        extensions = material.get("extensions", {})
        glossiness = extensions.get("KHR_materials_pbrSpecularGlossiness")
        if glossiness is not None:
            colour, alpha = glossiness.get("diffuseTexture"), glossiness.get("diffuseFactor", [1, 1, 1, 1])
            self.add(glossiness.get("specularGlossinessTexture"), "specular")
            self.add(glossiness.get("specularGlossinessTexture"), "gloss", "A")
            factors["specular"] = _colour(glossiness.get("specularFactor", [1, 1, 1]))
            factors["gloss"] = _number(glossiness.get("glossinessFactor", 1.0))
            if "gloss" not in self.set.maps:
                factors["roughness"] = 1.0 - float(factors["gloss"])
        else:
            metallic_roughness = material.get("pbrMetallicRoughness", {})
            colour = metallic_roughness.get("baseColorTexture")
            alpha = metallic_roughness.get("baseColorFactor", [1, 1, 1, 1])
            self.add(metallic_roughness.get("metallicRoughnessTexture"), "roughness", "G")
            self.add(metallic_roughness.get("metallicRoughnessTexture"), "metallic", "B")
            factors["roughness"] = _number(metallic_roughness.get("roughnessFactor", 1.0))
            factors["metallic"] = _number(metallic_roughness.get("metallicFactor", 1.0))
            self.reflectance(extensions)
        self.add(colour, "base_color")
        factors["base_color"] = _colour(alpha)
        self.opacity(colour, float(alpha[3]) if len(alpha) > 3 else 1.0)
        normal, occlusion = material.get("normalTexture"), material.get("occlusionTexture")
        self.add(normal, "normal")
        self.add(occlusion, "ao", "R")
        factors["normal"] = _number((normal or {}).get("scale", 1.0))
        factors["occlusion"] = _number((occlusion or {}).get("strength", 1.0))
        self.anisotropy(extensions.get("KHR_materials_anisotropy"))
        self.name_the_rest(extensions)
        self.settle()

    def add(self, reference: dict | None, role: str, channel: str = "") -> None:
        """The map of a texture reference, with its place in texture space."""
        if reference is None:
            return
        file, data = image_of(self.path, self.document, self.binary, reference["index"])
        transform = reference.get("extensions", {}).get("KHR_texture_transform", {})
        frame = IDENTITY
        if transform:
            frame = gltf_frame(
                transform.get("offset", [0, 0]), _number(transform.get("rotation", 0.0)), transform.get("scale", [1, 1])
            )
        self.coordinates[role] = int(transform.get("texCoord", reference.get("texCoord", 0)))
        sampler = self.document["textures"][reference["index"]].get("sampler")
        modes = {} if sampler is None else self.document["samplers"][sampler]
        across, down = (_WRAPS.get(modes.get(key, 10497), "?") for key in ("wrapS", "wrapT"))
        self.wraps[role] = across if across == down else f"{across} across and {down} down"
        self.set.maps[role] = Map(role, file, channel, data, as_rgba=True, frame=frame, encoding=_encoding(role))

    def reflectance(self, extensions: dict) -> None:
        """F0 of a dielectric by KHR_materials_ior and KHR_materials_specular."""
        factors = self.set.factors
        ior = extensions.get("KHR_materials_ior")
        if ior is not None:
            n = _number(ior.get("ior", 1.5))
            # An index of 0 stands for a reflectance of one (backwards compatibility with specular-glossiness).
            factors["f0"] = 1.0 if n == 0.0 else ((n - 1.0) / (n + 1.0)) ** 2
        specular = extensions.get("KHR_materials_specular")
        if specular is not None:
            self.add(specular.get("specularTexture"), "specular_level", "A")
            self.add(specular.get("specularColorTexture"), "specular_color")
            factors["specular_level"] = _number(specular.get("specularFactor", 1.0))
            factors["specular_color"] = _colour(specular.get("specularColorFactor", [1, 1, 1]))

    def opacity(self, colour: dict | None, factor: float) -> None:
        """Coverage: alpha of the base colour, unless the material is opaque, which is glTF's default."""
        mode = self.material.get("alphaMode", "OPAQUE")
        if mode == "OPAQUE":
            return
        self.add(colour, "opacity", "A")
        self.set.factors["opacity"] = factor
        if mode == "MASK":
            self.set.alpha_cutoff = _number(self.material.get("alphaCutoff", 0.5))

    def anisotropy(self, extension: dict | None) -> None:
        """Strength and direction of KHR_materials_anisotropy."""
        if extension is not None:
            self.add(extension.get("anisotropyTexture"), "anisotropy")
            self.set.factors["anisotropy"] = _number(extension.get("anisotropyStrength", 0.0))
            self.set.factors["anisotropy_rotation"] = _number(extension.get("anisotropyRotation", 0.0))

    def name_the_rest(self, extensions: dict) -> None:
        """Note, in one sentence, the parts of the material that are not read."""
        left = [_LEFT_OUT.get(name, name) for name in extensions if name not in _READ]
        if "emissiveTexture" in self.material or any(self.material.get("emissiveFactor", [])):
            left.append("emission")
        if left:
            self.set.note(f"What the material of '{self.path.name}' has besides is left out: {', '.join(left)}.")

    def settle(self) -> None:
        """Hold the maps' coordinates and samplers against each other."""
        if len(set(self.coordinates.values())) > 1:
            each = ", ".join(f"{role} in set {number}" for role, number in self.coordinates.items())
            raise InputError(
                f"The maps of '{self.path}' lie in different texture coordinates ({each}), expected one set for all: "
                f"bake them into one first."
            )
        if len(set(self.wraps.values())) == 1:
            self.set.wrap = next(iter(self.wraps.values()))
        elif self.wraps:
            self.set.wrap = ", ".join(f"{role}: {wrap}" for role, wrap in self.wraps.items())


def _encoding(role: str) -> str:
    return "srgb" if role in ("base_color", "specular", "specular_color") else ""


def _number(value: Any) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{number} is no finite number")
    return number


def _colour(values: Any) -> np.ndarray:
    colour = np.array([_number(value) for value in values[:3]], np.float32)
    if colour.shape != (3,):
        raise ValueError(f"{values} is no colour")
    return colour
