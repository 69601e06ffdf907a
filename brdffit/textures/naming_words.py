"""The words in names of texture maps: roles, packings, layers, and words without a meaning."""

from __future__ import annotations

import re

#: Roles a map can have inside the program.
ROLES = (
    "base_color", "normal", "roughness", "gloss", "metallic", "specular", "specular_level", "specular_color",
    "anisotropy", "height", "ao", "opacity",
)  # fmt: skip

_ROLE_WORDS = {
    "base_color": "basecolor basecolour color colour col albedo alb diffuse diff dif diffusecolor basemap bc",
    "normal": "normal normals nor norm nrm nrml nml tangentnormal",
    "roughness": "roughness rough rgh roughnesses",
    "gloss": "gloss glossiness glossy smoothness smooth gls",
    "metallic": "metallic metalness metallicity metal met mtl",
    "specular": "specular spec spc specularcolor reflection refl",
    "height": "height heights displacement disp displace depth bump bmp ht dsp heightfield",
    "ao": "ao occlusion occ ambientocclusion ambientocc mixedao",
    "opacity": "opacity alpha alphamask cutout opac",
}
#: Packed maps: which role lies in which channel, red first; None is a channel without a role here.
_PACKED_WORDS: dict[str, tuple[str | None, ...]] = {
    # Whatever the order of the words: green and blue, as in glTF.
    **dict.fromkeys(
        (
            first + second
            for one in ("metal", "metallic", "metalness")
            for other in ("rough", "roughness")
            for first, second in ((one, other), (other, one))
        ),
        (None, "roughness", "metallic"),
    ),
    "mrao": ("metallic", "roughness", "ao"),
    "rmao": ("roughness", "metallic", "ao"),
    "ard": ("ao", "roughness", "height"),
    "arh": ("ao", "roughness", "height"),
    "ord": ("ao", "roughness", "height"),
    "ordp": ("ao", "roughness", "height"),
    "orh": ("ao", "roughness", "height"),
    "metallicgloss": ("metallic", None, None, "gloss"),
    "metallicglossmap": ("metallic", None, None, "gloss"),
    "metalgloss": ("metallic", None, None, "gloss"),
    "specularsmoothness": ("specular", None, None, "gloss"),
    "specsmooth": ("specular", None, None, "gloss"),
    "specularsmooth": ("specular", None, None, "gloss"),
    "maskmap": ("metallic", "ao", None, "gloss"),
    "metallicsmoothness": ("metallic", None, None, "gloss"),
    "specularglossiness": ("specular", None, None, "gloss"),
    "specgloss": ("specular", None, None, "gloss"),
}
_PACKED_PARTS = {
    "ao": ("o", "ao", "occlusion", "ambientocclusion"),
    "roughness": ("r", "rough", "roughness"),
    "metallic": ("m", "metal", "metallic", "metalness"),
}
LETTERS = {
    "d": "base_color",
    "c": "base_color",
    "b": "base_color",
    "a": "base_color",
    "n": "normal",
    "r": "roughness",
    "m": "metallic",
    "h": "height",
    "o": "ao",
    "s": "specular",
    "g": "gloss",
}
#: Words that may stand anywhere in a name, also before the material's, without being mistaken for its subject.
SAFE_ANYWHERE = frozenset(
    ("albedo", "basecolor", "diffuse", "normal", "roughness", "metallic", "metalness", "displacement", "height", "ao")
)
NOISE = re.compile(
    r"\d{1,2}k|\d+x\d+|png|jpe?g|exr|tiff?|tga|bmp|webp|hdr|dds|\d+bits?|maps?|tex|texture|seamless|tileable|raw"
    r"|linear|srgb|lossless|hires|lowres|copy|kopie|copia"
)
#: Words before a role's word, or in its place, that mark layers and mesh maps, which are no part of the surface.
LAYERS = frozenset(
    "emissive emission emit emissivecolor glow selfillumination illum lightmap sheen fuzz coat clearcoat cc coating"
    " transmission translucency subsurface sss scattering scatter thickness iridescence id ids matid materialid colorid"
    " idmap bent worldspace world ws objectspace object os curvature cavity position pos detail microdetail secondary"
    " flow edge edges".split()
)
#: Words that mark a picture as a preview of the whole.
PREVIEWS = frozenset("preview thumb thumbnail render sphere ball icon cover sample".split())
#: A variant of the map before it.
VARIANT = re.compile(r"var\d+|v\d{1,2}")
#: Letters of which packings are made.
PACKING_LETTERS = frozenset("aormdhsegtnpc")
OLD_CC0_WORDS = frozenset(("col", "rgh", "met", "disp"))


def _words() -> tuple[dict[str, str], dict[str, tuple[str | None, ...]], dict[str, str]]:
    words = {word: role for role, text in _ROLE_WORDS.items() for word in text.split()}
    normal_y = {}
    for word in [*_ROLE_WORDS["normal"].split(), "n"]:
        for tail, direction in (("gl", "gl"), ("opengl", "gl"), ("ogl", "gl"), ("dx", "dx"), ("directx", "dx")):
            words[word + tail] = "normal"
            normal_y[word + tail] = direction
    packed = dict(_PACKED_WORDS)
    # "arm" begins with the letter of "ambient"; elsewhere occlusion is "o" or a word.
    packed |= {"arm": ("ao", "roughness", "metallic"), "mra": ("metallic", "roughness", "ao")}
    packed |= {"ram": ("roughness", "ao", "metallic"), "rma": ("roughness", "metallic", "ao")}
    roles = tuple(_PACKED_PARTS)
    for order in [(i, j, k) for i in range(3) for j in range(3) for k in range(3) if {i, j, k} == {0, 1, 2}]:
        named = tuple(roles[i] for i in order)
        for first in _PACKED_PARTS[named[0]]:
            for second in _PACKED_PARTS[named[1]]:
                for third in _PACKED_PARTS[named[2]]:
                    if len({len(first) == 1, len(second) == 1, len(third) == 1}) == 1:
                        packed.setdefault(first + second + third, named)
    return words, packed, normal_y


WORDS, PACKED, NORMAL_Y = _words()
