"""Roles of the maps of a texture set, told from file names.

Names are split at separators and at changes of case; resolution and file-type words are dropped wherever they stand;
the role is the longest known phrase that ends the rest. Conventions covered: ambientCG, the older CC0Textures, Poly
Haven, Unreal, Substance, glTF, bare role names, and a second role in the alpha channel (``alb_ht``, ``nrm_rgh``).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

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
}
#: Packed maps: which role lies in which channel, red first; None is a channel without a role here.
_PACKED_WORDS: dict[str, tuple[str | None, ...]] = {
    "metallicroughness": (None, "roughness", "metallic"),
    "roughnessmetallic": (None, "roughness", "metallic"),
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
_SAFE_ANYWHERE = frozenset(
    ("albedo", "basecolor", "diffuse", "normal", "roughness", "metallic", "metalness", "displacement", "height", "ao")
)
_NOISE = re.compile(
    r"\d{1,2}k|\d+x\d+|png|jpe?g|exr|tiff?|tga|bmp|webp|hdr|dds|\d+bits?|maps?|tex|texture|seamless|tileable|raw"
    r"|linear|srgb|lossless|hires|lowres"
)
_OLD_CC0_WORDS = frozenset(("col", "rgh", "met", "disp"))


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


_WORDS, _PACKED, _NORMAL_Y = _words()


@dataclass(frozen=True)
class NamedMap:
    """A file with one of the roles its name gives it.

    Attributes:
        file: the file name as given.
        role: one of ``ROLES``.
        channel: "" for all or the obvious one, else "R", "G", "B" or "A".
        word: the word of the name that told.
        normal_y: "gl" or "dx" where the name says it, else "".
    """

    file: str
    role: str
    channel: str = ""
    word: str = ""
    normal_y: str = ""


@dataclass
class NamedSet:
    """Roles found in a list of file names.

    Attributes:
        maps: one file a role.
        ignored: files that have no role, or gave way to another file of the same role.
        notes: what was assumed, one sentence each.
        rivals: for a role that files of differently named materials claim, all these files.
    """

    maps: dict[str, NamedMap]
    ignored: list[str]
    notes: list[str]
    rivals: dict[str, list[str]]


def packed_roles(word: str) -> tuple[str | None, ...] | None:
    """Roles by channel, red first, of a packing's name such as "orm" or "arm"; None when it is no packing."""
    return _PACKED.get(re.sub(r"[^a-z]", "", word.lower()))


def name_tokens(stem: str) -> list[str]:
    """Lower-case words of a file's stem without resolution and file-type words.

    Numbers stay between words, so that "rusty_metal_05_rough" does not join to "metal rough", and go at the end.
    """
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|(?<=\d)(?=[A-Z][a-z])", " ", stem)
    tokens = [token.lower() for token in re.split(r"[^A-Za-z0-9]+", spaced) if token]
    kept = [token for token in tokens if not _NOISE.fullmatch(token)]
    # "NormalMap" and "MaskMap": the word alone is noise, the phrase is not.
    for i in range(len(tokens) - 1):
        if tokens[i] + tokens[i + 1] in ("maskmap",):
            return [*[token for token in kept if token != "mask"], "maskmap"]
    while kept and kept[-1].isdigit():
        kept.pop()
    return kept


def roles_from_names(files: Iterable[str], alpha: Iterable[str] = ()) -> NamedSet:
    """Assign roles to file names.

    Args:
        files: file names with suffix; those of images only.
        alpha: the files among them that have an alpha channel; only these can carry a second role in it.
    """
    files, alpha = sorted(files), set(alpha)
    found: list[NamedMap] = []
    stems: dict[str, str] = {}
    letters: list[NamedMap] = []
    nameless: list[tuple[str, list[str]]] = []
    for file in files:
        tokens = name_tokens(file.rsplit(".", 1)[0])
        named, used = _maps_of(file, tokens, file in alpha)
        stems[file] = "".join(tokens[: len(tokens) - used])
        if named:
            found += named
        elif tokens and tokens[-1] in LETTERS:
            stems[file] = "".join(tokens[:-1])
            letters.append(NamedMap(file, LETTERS[tokens[-1]], "", tokens[-1]))
        else:
            nameless.append((file, tokens))
    notes: list[str] = []
    found += _agreeing_letters(letters, found, stems)
    for file, tokens in nameless:
        _second_chance(file, tokens, found, notes)
    maps = _choose(found, notes)
    chosen = {choice.file for choice in maps.values()}
    rivals: dict[str, list[str]] = {}
    for role in maps:
        claims = {claim.file: stems[claim.file] for claim in found if claim.role == role}
        if len(set(claims.values())) > 1:
            rivals[role] = list(claims)
    return NamedSet(maps, [file for file in files if file not in chosen], notes, rivals)


def old_cc0textures(named: NamedSet) -> bool:
    """Whether names follow the older CC0Textures habit (``_col _nrm _rgh _met _disp``, ``_varN``): DirectX normals."""
    words = {found.word for role, found in named.maps.items() if role != "normal" and found.channel == ""}
    normal = named.maps.get("normal")
    if normal is None or normal.normal_y:
        return False
    if any(re.fullmatch(r"var\d+", word) for word in words):
        return True
    return normal.word == "nrm" and bool(words & _OLD_CC0_WORDS)


def _maps_of(file: str, tokens: list[str], has_alpha: bool) -> tuple[list[NamedMap], int]:
    """Maps told by the end of the name, and how many tokens told it."""
    for start in range(len(tokens)):
        phrase = "".join(tokens[start:])
        if phrase in _PACKED:
            channels = zip("RGBA", _PACKED[phrase], strict=False)
            maps = [NamedMap(file, role, channel, phrase) for channel, role in channels if role]
            if maps[0].role == "specular":
                maps[0] = NamedMap(file, "specular", "", phrase)
            return maps, len(tokens) - start
        if phrase in _WORDS:
            first = NamedMap(file, _WORDS[phrase], "", phrase, _NORMAL_Y.get(phrase, ""))
            used = len(tokens) - start
            # Two role words and an alpha channel: the first in the colours, the second in alpha.
            if has_alpha and first.role not in ("base_color", "normal"):
                before, more = _maps_of(file, tokens[:start], False)
                if before and before[0].role in ("base_color", "normal"):
                    return [before[0], NamedMap(file, first.role, "A", phrase)], used + more
            return [first], used
    return [], 0


def _agreeing_letters(letters: list[NamedMap], found: list[NamedMap], stems: dict[str, str]) -> list[NamedMap]:
    """Single letters count only where two or more roles of one stem agree."""
    roles: dict[str, set[str]] = {}
    for named in [*letters, *found]:
        roles.setdefault(stems[named.file], set()).add(named.role)
    return [named for named in letters if len(roles[stems[named.file]]) >= 2]


def _second_chance(file: str, tokens: list[str], found: list[NamedMap], notes: list[str]) -> None:
    """A role word before the material's name, or an older CC0Textures imperfection map, if the role is still free."""
    taken = {named.role for named in found}
    for i in range(len(tokens)):
        for j in range(len(tokens), i, -1):
            phrase = "".join(tokens[i:j])
            if (phrase in _NORMAL_Y or phrase in _SAFE_ANYWHERE) and _WORDS[phrase] not in taken:
                found.append(NamedMap(file, _WORDS[phrase], "", phrase, _NORMAL_Y.get(phrase, "")))
                return
    if tokens and re.fullmatch(r"var\d+", tokens[-1]) and "roughness" not in taken:
        found.append(NamedMap(file, "roughness", "", tokens[-1]))
        notes.append(
            f"'{file}' is taken as roughness: '_{tokens[-1]}' is an imperfection map of the older CC0Textures."
        )


def _choose(found: list[NamedMap], notes: list[str]) -> dict[str, NamedMap]:
    """One file a role: GL before DX, a map of its own before a packed one, the longer word before the shorter."""
    rank = {"gl": 0, "dx": 1, "": 2}
    formats = ("exr", "tif", "tiff", "png")
    maps: dict[str, NamedMap] = {}
    for role in ROLES:
        candidates = [named for named in found if named.role == role]
        if not candidates:
            continue
        candidates.sort(
            key=lambda named: (
                rank[named.normal_y],
                bool(named.channel),
                named.file.rsplit(".", 1)[-1].lower() not in formats,
                -len(named.word),
                named.file,
            )
        )
        maps[role] = candidates[0]
        others = [named.file for named in candidates[1:] if named.normal_y == candidates[0].normal_y]
        if others:
            notes.append(f"'{maps[role].file}' is taken as {role}; {', '.join(repr(o) for o in others)} is left out.")
    if "roughness" in maps and "gloss" in maps:
        notes.append(
            f"'{maps['roughness'].file}' is taken as roughness; the gloss in '{maps['gloss'].file}' is left out."
        )
        del maps["gloss"]
    return maps
