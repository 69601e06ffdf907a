"""Roles of the maps of a texture set, from file names.

Names are split at separators and at changes of case; resolution and file-type words are dropped wherever they stand;
the role is the longest known phrase that ends the rest. Only what differs between the names of one set counts: a word
that all of them have is no role, and a picture named by their common stem alone is a preview. Conventions covered:
ambientCG, the older CC0Textures, Poliigon, Poly Haven, Unreal, Unity, Substance, glTF, bare role names, and a second
role in the alpha channel (``alb_ht``, ``nrm_rgh``).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

from brdffit.textures.naming_words import (
    LAYERS,
    LETTERS,
    NOISE,
    NORMAL_Y,
    OLD_CC0_WORDS,
    PACKED,
    PACKING_LETTERS,
    PREVIEWS,
    ROLES,
    SAFE_ANYWHERE,
    VARIANT,
    WORDS,
)  # fmt: skip

__all__ = ("LETTERS", "ROLES", "NamedMap", "NamedSet", "name_tokens", "old_cc0textures", "packed_roles",
           "roles_from_names")  # fmt: skip


@dataclass(frozen=True)
class NamedMap:
    """A file with one of the roles its name gives it.

    Attributes:
        file: the file name as given.
        role: one of ``ROLES``.
        channel: "" for all or the obvious one, else "R", "G", "B" or "A".
        word: the word of the name that gave the role.
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
        stems: of each file, what its name has beside its role.
    """

    maps: dict[str, NamedMap]
    ignored: list[str]
    notes: list[str]
    rivals: dict[str, list[str]]
    stems: dict[str, str] = field(default_factory=dict)


def packed_roles(word: str) -> tuple[str | None, ...] | None:
    """Roles by channel, red first, of a packing's name such as "orm" or "arm"; None when it is no packing."""
    return PACKED.get(re.sub(r"[^a-z]", "", word.lower()))


def name_tokens(stem: str) -> list[str]:
    """Lower-case words of a file's stem without resolution and file-type words.

    Numbers between words are kept, so that "rusty_metal_05_rough" does not join to "metal rough"; those at the end are
    dropped.
    """
    stem = re.sub(r"ORDp", "Ordp", stem)
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|(?<=\d)(?=[A-Z][a-z])", " ", stem)
    tokens = [token.lower() for token in re.split(r"[^A-Za-z0-9]+", spaced) if token]
    kept = [token for token in tokens if not NOISE.fullmatch(token)]
    # "MaskMap" is a packing, though "map" alone says nothing.
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
    tokens = _subject_stripped({file: name_tokens(file.rsplit(".", 1)[0]) for file in files}, alpha)
    shared = set.intersection(*map(set, tokens.values())) if len(files) > 1 else set()
    found: list[NamedMap] = []
    stems: dict[str, str] = {}
    letters: list[NamedMap] = []
    nameless: list[str] = []
    layers: list[str] = []
    for file in files:
        words = tokens[file]
        named, used = _maps_of(file, words, file in alpha)
        if used > 1 and words[-used] == "metal" and _is_shared(words[: 1 - used], file, tokens):
            named, used = _maps_of(file, words[1 - used :], file in alpha)  # the metal is the subject's
        stems[file] = "".join(words[: len(words) - used])
        if _is_layer(words, used, shared):
            layers.append(file)
        elif named:
            found += named
        elif words and words[-1] in LETTERS:
            stems[file] = "".join(words[:-1])
            letters.append(NamedMap(file, LETTERS[words[-1]], "", words[-1]))
        else:
            nameless.append(file)
    notes: list[str] = []
    found = _without_previews(found, tokens, stems, notes)
    found += _agreeing_letters(letters, found, stems)
    for file in nameless:
        _second_chance(file, tokens[file], found, notes)
    maps = _choose(found, notes)
    chosen = {choice.file for choice in maps.values()}
    _name_packings([file for file in nameless if file not in chosen], tokens, found, stems, notes)
    if layers and maps:
        notes.append(f"Layers and mesh maps that are no part of the surface are left out: {', '.join(layers)}.")
    rivals: dict[str, list[str]] = {}
    for role in maps:
        claims = {claim.file: stems[claim.file] for claim in found if claim.role == role}
        if len(set(claims.values())) > 1:
            rivals[role] = list(claims)
    return NamedSet(maps, [file for file in files if file not in chosen], notes, rivals, stems)


def old_cc0textures(named: NamedSet) -> bool:
    """Whether names follow the older CC0Textures habit (``_col _nrm _rgh _met _disp``, ``_varN``): DirectX normals."""
    words = {found.word for role, found in named.maps.items() if role != "normal" and found.channel == ""}
    normal = named.maps.get("normal")
    if normal is None or normal.normal_y:
        return False
    if any(re.fullmatch(r"var\d+", word) for word in words):
        return True
    return normal.word == "nrm" and bool(words & OLD_CC0_WORDS)


def _subject_stripped(tokens: dict[str, list[str]], alpha: set[str]) -> dict[str, list[str]]:
    """Tokens without the last word, where it is a workflow's and not a role: ``X_COL_METALNESS``, ``X_NRM_METALNESS``.

    Several files end with the same word, and what stands before it are different roles.
    """
    before: dict[str, dict[str, str]] = {}
    for file, words in tokens.items():
        if file not in alpha and len(words) > 1 and words[-1] in WORDS:
            role = _maps_of(file, words[:-1], False)[0]
            if role:
                before.setdefault(words[-1], {})[file] = role[0].role
    stripped = dict(tokens)
    for roles in before.values():
        if len(set(roles.values())) > 1:
            stripped |= {file: tokens[file][:-1] for file in roles}
    return stripped


def _is_shared(words: list[str], file: str, tokens: dict[str, list[str]]) -> bool:
    """Whether another file's name begins with these words."""
    return any(other != file and each[: len(words)] == words for other, each in tokens.items())


def _is_layer(words: list[str], used: int, shared: set[str]) -> bool:
    """Whether a name is that of a layer or a mesh map; a word that all names share is the subject's."""
    role, rest = words[len(words) - used :], words[: len(words) - used]
    ends = [rest[-1], "".join(rest[-2:]), rest[-1] + (role[0] if role else "")] if rest else []
    return any(end in LAYERS and not set(rest[-2:]) <= shared and rest[-1] not in shared for end in ends)


def _without_previews(
    found: list[NamedMap], tokens: dict[str, list[str]], stems: dict[str, str], notes: list[str]
) -> list[NamedMap]:
    """Leave out pictures named by the stem of two or more other files alone, or with a word for previews."""
    owners = Counter(stems[file] for file in {named.file for named in found})
    previews = {
        named.file
        for named in found
        if owners["".join(tokens[named.file])] - (stems[named.file] == "".join(tokens[named.file])) >= 2
        or PREVIEWS & set(tokens[named.file][-2:])
    }
    for file in sorted(previews):
        notes.append(f"'{file}' bears the name of the whole set: it is taken as a preview, not as a map.")
    return [named for named in found if named.file not in previews]


def _name_packings(
    files: list[str], tokens: dict[str, list[str]], found: list[NamedMap], stems: dict[str, str], notes: list[str]
) -> None:
    """A sentence for each file without a role whose last word looks like letters of a packing."""
    known = {stems[named.file] for named in found}
    for file in files:
        words = tokens[file]
        letters = words[-1] if words else ""
        if 3 <= len(letters) <= 5 and len(set(letters)) == len(letters) and set(letters) <= PACKING_LETTERS:
            if "".join(words[:-1]) in known:
                notes.append(
                    f"'{file}' looks like a packing of several maps and is not used: name what it holds, as in "
                    f"--role orm={file}, or one channel, as in --role roughness={file}:G."
                )


def _maps_of(file: str, tokens: list[str], has_alpha: bool) -> tuple[list[NamedMap], int]:
    """Maps by the end of the name, and how many tokens gave them."""
    if len(tokens) > 1 and VARIANT.fullmatch(tokens[-1]):
        named, used = _maps_of(file, tokens[:-1], has_alpha)
        return named, used + 1 if named else 0
    for start in range(len(tokens)):
        phrase = "".join(tokens[start:])
        # "HammeredMetal_Roughness" is the roughness of a metal; "MetalRough" in one word is a packing.
        if phrase in PACKED and not (tokens[start] == "metal" and phrase not in file.lower()):
            channels = zip("RGBA", PACKED[phrase], strict=False)
            maps = [NamedMap(file, role, channel, phrase) for channel, role in channels if role]
            if maps[0].role == "specular":
                maps[0] = NamedMap(file, "specular", "", phrase)
            return maps, len(tokens) - start
        if phrase in WORDS:
            first = NamedMap(file, WORDS[phrase], "", phrase, NORMAL_Y.get(phrase, ""))
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
            if (phrase in NORMAL_Y or phrase in SAFE_ANYWHERE) and WORDS[phrase] not in taken:
                found.append(NamedMap(file, WORDS[phrase], "", phrase, NORMAL_Y.get(phrase, "")))
                return
    if tokens and re.fullmatch(r"var\d+", tokens[-1]) and "roughness" not in taken:
        found.append(NamedMap(file, "roughness", "", tokens[-1]))
        notes.append(
            f"'{file}' is taken as roughness: '_{tokens[-1]}' is an imperfection map of the older CC0Textures."
        )


#: A copy that a file manager made.
_COPY = re.compile(r"\(\d+\)\.|[ _-](copy|kopie|copia)\b", re.IGNORECASE)


def _resolution(file: str) -> int:
    """Side in texels that a name says (4K, 2048, 2048x2048), or 0."""
    sides = [1024 * int(number) for number in re.findall(r"(?<![A-Za-z0-9])(\d{1,2})[kK](?![A-Za-z])", file)]
    sides += [int(number) for number in re.findall(r"(?<!\d)(256|512|1024|2048|4096|8192|16384)(?!\d)", file)]
    return max(sides, default=0)


def _choose(found: list[NamedMap], notes: list[str]) -> dict[str, NamedMap]:
    """One file a role, by rank.

    GL goes before DX, a map of its own before a packed one, an original before its copy, the larger resolution before
    the smaller, EXR, TIFF and PNG before other formats, the longer word before the shorter.
    """
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
                bool(_COPY.search(named.file)),
                -_resolution(named.file),
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
