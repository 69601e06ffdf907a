"""What engines load: container, format, roughness curve, size, levels, and the axis that their look-ups mirror."""

from __future__ import annotations

from dataclasses import dataclass

from brdffit.errors import UnknownNameError
from brdffit.probes.curves import get_curve


@dataclass(frozen=True)
class ProbePreset:
    """How a probe is stored for an engine.

    Attributes:
        name, summary: as on the command line.
        container: "ktx2", "ktx1", "dds" or "exr" (one lat-long picture a level).
        texel_format: a name of ``containers.RADIANCE_FORMATS``; "float" for EXR.
        curve: a name of ``curves.CURVES``.
        size: texels along a face of level 0.
        levels: how many, level 0 counted.
        mirror: axis that the engine negates in its look-ups ("x", "z" or ""); the stored cube is mirrored to match.
        note: a sentence for users of the engine, or "".
        centre: direction of the middle of a lat-long picture in the engine's own tools, see ``reading.CENTRES``.
    """

    name: str
    summary: str
    container: str
    texel_format: str
    curve: str
    size: int
    levels: int
    mirror: str = ""
    note: str = ""
    centre: str = "-z"

    @property
    def turning(self) -> str:
        """Whether and how the stored cube is mirrored, for captions."""
        return f"{self.mirror} mirrored" if self.mirror else "not mirrored"


_ALL = (
    ProbePreset("plain", "KTX2, no engine in mind", "ktx2", "rgb9e5", "quadratic", 256, 7),
    ProbePreset(
        "bevy", "Bevy's EnvironmentMapLight", "ktx2", "rgb9e5", "linear", 256, 9, "z",
        "Bevy negates z when it looks up a cube map.",
    ),
    ProbePreset("khronos", "glTF Sample Viewer", "ktx2", "rgba16f", "linear", 256, 9),
    ProbePreset(
        "filament", "Filament's indirect light, harmonics in the file", "ktx1", "r11g11b10f", "quadratic", 256, 5, "",
        "The cube is the one that cmgen writes: Filament looks it up without turning.", "+z",
    ),
    ProbePreset(
        "three", "three.js", "dds", "bc6h", "quadratic", 256, 7, "x",
        "three.js filters a cube again unless texture.isPMREMTexture is set; its CubeTexture look-ups negate x.",
    ),
    ProbePreset(
        "babylon", "Babylon.js", "dds", "rgba16f", "babylon", 256, 7, "",
        "lodGenerationScale 0.8, as Babylon has it by itself.",
    ),
    ProbePreset("unity", "Unity", "dds", "bc6h", "unity", 256, 7),
    ProbePreset("unreal", "Unreal", "dds", "rgba16f", "unreal", 256, 8),
    ProbePreset("activision", "The curve of Manson and Sloan's tables", "ktx2", "rgb9e5", "activision", 128, 7),
    ProbePreset(
        "godot", "Godot and DCC tools: lat-long EXR pictures", "exr", "float", "linear", 256, 7, "",
        "Godot filters by itself: use specular-0.exr as the sky, with --split and the sun as a light.",
    ),
)  # fmt: skip
PRESETS = {preset.name: preset for preset in _ALL}


#: Presets of ``brdffit bake`` whose probe preset has another name; all others have the same name.
_OF_MATERIALS = {"gltf": "khronos"}


def probe_of_materials(preset: str) -> dict[str, str] | None:
    """Preset, curve and shader's line of the probes of an engine, for the manifest of a material.

    ``preset`` is one of ``brdffit bake``; the result is None where its engine loads no filtered probes.
    """
    found = PRESETS.get(_OF_MATERIALS.get(preset, preset))
    if found is None or found.container == "exr":
        return None
    curve = get_curve(found.curve, found.levels, found.size)
    return {"preset": found.name, "curve": curve.name, "lod": curve.formula}


def get_probe_preset(name: str) -> ProbePreset:
    """The preset of a name.

    Raises:
        UnknownNameError: when there is none.
    """
    if name not in PRESETS:
        raise UnknownNameError("preset of a probe", name, PRESETS)
    return PRESETS[name]
