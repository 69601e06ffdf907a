"""Read environments: lat-long pictures, crosses, strips, six faces, and cube maps in KTX2, KTX1 or DDS.

Axes: +Y up. The middle column of a lat-long picture looks along -Z and the column a quarter of the width further right
along +X, unless ``centre`` says otherwise. Crosses and strips hold the faces as OpenGL looks them up.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from brdffit.colour import decode_srgb
from brdffit.errors import InputError
from brdffit.files.image_io import IMAGE_SUFFIXES, read_image
from brdffit.probes.cubemap import directions, face_coordinates, halved, look_up, resized
from brdffit.probes.kernels.cube import average_equirect
from brdffit.probes.parallel import over_rows

LAYOUTS = ("latlong", "horizontal-cross", "vertical-cross", "strip", "column", "faces", "cube")
#: Directions (x, z) along which the middle column of a lat-long picture may look.
CENTRES = {"-z": (0.0, -1.0), "+x": (1.0, 0.0), "+z": (0.0, 1.0), "-x": (-1.0, 0.0)}
_FACE_NAMES = (
    ("px", "nx", "py", "ny", "pz", "nz"),
    ("posx", "negx", "posy", "negy", "posz", "negz"),
    ("right", "left", "top", "bottom", "front", "back"),
    ("right", "left", "up", "down", "front", "back"),
    ("x+", "x-", "y+", "y-", "z+", "z-"),
)
#: Cells (row, column) of +X -X +Y -Y +Z -Z; in a vertical cross -Z is turned by 180 degrees.
CELLS = {
    "horizontal-cross": ((1, 2), (1, 0), (0, 1), (2, 1), (1, 1), (1, 3)),
    "vertical-cross": ((1, 2), (1, 0), (0, 1), (2, 1), (1, 1), (3, 1)),
    "strip": tuple((0, k) for k in range(6)),
    "column": tuple((k, 0) for k in range(6)),
}


@dataclass(frozen=True)
class Surroundings:
    """An environment as it was read.

    Attributes:
        path: file or folder.
        layout: one of LAYOUTS.
        pixels: (H, W, 3) of a lat-long picture, else a cube map (6, n, n, 3); float32, linear.
        on_border: whether the outer pixel centres of a lat-long picture lie on its border (OpenEXR's convention).
        notes: sentences for the user.
    """

    path: Path
    layout: str
    pixels: NDArray
    on_border: bool = False
    notes: list[str] = field(default_factory=list)

    @property
    def natural_size(self) -> int:
        """Texels along a face, rounded up to a power of two, at which a cube map resolves what the picture does."""
        texels = self.pixels.shape[1] / (4 if self.layout == "latlong" else 1)
        return 1 << max(int(np.ceil(np.log2(max(texels, 1.0)) - 1e-6)), 0)


def read_surroundings(path: str | Path, layout: str | None = None, clamp: bool = False) -> Surroundings:
    """Read an environment.

    Args:
        path: a picture, a KTX2, KTX1 or DDS cube map, a folder of six faces, or "procedural" or "letters", which ship.
        layout: one of LAYOUTS, for a picture; None guesses it from the shape. The notes tell it.
        clamp: set negative values and NaN to 0 and infinite ones to the largest finite value, instead of refusing them.

    Raises:
        InputError: when it cannot be read, has no known layout, or holds values that are negative or not finite.
    """
    path = Path(path)
    notes: list[str] = []
    if is_built_in(path) and path.name == "letters":
        from brdffit.probes.letters import lettered_cube

        notes.append("A cube whose faces bear their names: shows how a tool or an engine turns cube maps.")
        pixels, layout = lettered_cube(256), "cube"
    elif is_built_in(path):
        from brdffit.render.environment import procedural_environment

        notes.append("The environment that comes with brdffit: a studio of soft boxes and lamps.")
        pixels, layout = procedural_environment(512).radiance, "latlong"
    elif path.is_dir():
        pixels, layout = _six_faces(path, notes), "faces"
    elif path.suffix.lower() in (".ktx2", ".ktx", ".dds"):
        from brdffit.probes.containers import read_cube_file

        pixels, layout = read_cube_file(path).levels[0], "cube"
    else:
        picture = _linear_picture(path, notes)
        layout = layout or _guessed(path, picture.shape)
        pixels = picture if layout == "latlong" else _cut(path, picture, layout)
    pixels = _checked(path, np.ascontiguousarray(pixels, np.float32), clamp, notes)
    on_border = layout == "latlong" and _repeats_its_border(pixels)
    if on_border:
        notes.append("First and last column are the same: pixel centres are taken to lie on the border.")
    shape = "x".join(str(size) for size in pixels.shape[1::-1])
    notes.insert(0, f"Read as {layout}, {shape}.")
    return Surroundings(path, layout, pixels, on_border, notes)


def as_cube(surroundings: Surroundings, n: int, centre: str = "-z", degrees: float = 0.0, threads: int = 1) -> NDArray:
    """The cube map (6, n, n, 3) float32 of an environment; each texel is a mean over its area.

    Args:
        surroundings: what was read.
        n: texels along a face; a power of two, unless the environment is a cube map of this size already.
        centre: a name of CENTRES, for lat-long pictures.
        degrees: rotation about +Y, from +X towards -Z.
        threads: workers.
    """
    angle = np.radians(degrees)
    if surroundings.layout == "latlong":
        x, z = CENTRES[centre]
        ahead = (x * np.cos(angle) + z * np.sin(angle), z * np.cos(angle) - x * np.sin(angle))
        picture, out = surroundings.pixels, np.empty((6, n, n, 3), np.float32)
        samples = int(np.clip(6 * np.ceil(picture.shape[1] / (4.0 * n)), 6, 96))

        def rows(first: int, last: int) -> None:
            average_equirect(picture, surroundings.on_border, *ahead, samples, first, last, out)

        over_rows(rows, 6 * n, threads)
        return out
    cube = surroundings.pixels
    if degrees % 360.0 == 0.0 and (cube.shape[1] & (cube.shape[1] - 1) == 0 or cube.shape[1] == n):
        return resized(cube, n)
    # Look up the source direction of each texel, on a grid finer than both cube maps.
    fine = n
    while fine < 2 * max(n, cube.shape[1]):
        fine *= 2
    at = directions(fine)
    x = at[..., 0] * np.cos(angle) - at[..., 2] * np.sin(angle)
    z = at[..., 0] * np.sin(angle) + at[..., 2] * np.cos(angle)
    cube = look_up(cube, np.stack([x, at[..., 1], z], axis=-1)).astype(np.float32)
    while cube.shape[1] > n:
        cube = halved(cube)
    return cube


def reoriented(cube: NDArray, matrix: NDArray) -> NDArray:
    """The cube map whose value along d is that of ``cube`` along ``matrix`` d; ``matrix`` is a signed permutation."""
    n = cube.shape[1]
    face, u, v = face_coordinates(directions(n) @ np.asarray(matrix, np.float64).T)
    i = np.clip(np.floor((u + 1.0) * 0.5 * n).astype(int), 0, n - 1)
    j = np.clip(np.floor((1.0 - v) * 0.5 * n).astype(int), 0, n - 1)
    return cube[face, j, i]


def _linear_picture(path: Path, notes: list[str]) -> NDArray:
    """(H, W, 3) linear pixels; integer formats are decoded from sRGB, and a note tells of their small range."""
    image = read_image(path)
    pixels = image.pixels[..., :3] if image.pixels.shape[2] >= 3 else image.pixels[..., :1].repeat(3, axis=2)
    if not image.is_float:
        pixels = decode_srgb(pixels)
        notes.append(
            f"{image.bits} bits a channel, decoded from sRGB: lamps are clipped at 1, highlights will be dull."
        )
    return pixels


def _guessed(path: Path, shape: tuple[int, ...]) -> str:
    height, width = shape[:2]
    if abs(width - 2 * height) <= min(2, height // 8):
        return "latlong"
    for layout, cells in CELLS.items():
        rows, columns = np.max(cells, axis=0) + 1
        if width * rows == height * columns and height % rows == 0:
            return layout
    raise InputError(
        f"'{path}' is {width}x{height}, "
        "expected a lat-long picture (2:1), a cross (4:3 or 3:4) or a strip (6:1 or 1:6)."
    )


def _cut(path: Path, picture: NDArray, layout: str) -> NDArray:
    if layout not in CELLS:
        raise InputError(f"'{path}' is one picture, which cannot be read as '{layout}'.")
    rows, columns = np.max(CELLS[layout], axis=0) + 1
    n = picture.shape[0] // rows
    if picture.shape[:2] != (rows * n, columns * n):
        raise InputError(
            f"'{path}' is {picture.shape[1]}x{picture.shape[0]}, expected square faces in {columns}x{rows} cells."
        )
    faces = [picture[r * n : (r + 1) * n, c * n : (c + 1) * n] for r, c in CELLS[layout]]
    if layout == "vertical-cross":
        faces[5] = faces[5][::-1, ::-1]
    return np.stack(faces)


def _six_faces(folder: Path, notes: list[str]) -> NDArray:
    pictures = {path.stem.lower(): path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES}
    best: tuple[str, ...] = ()
    for names in _FACE_NAMES:
        found = {name: path for name in names for stem, path in pictures.items() if _is_face(stem, name)}
        if len(found) == 6:
            faces = [_linear_picture(found[name], notes) for name in names]
            shapes = {face.shape for face in faces}
            if len(shapes) != 1 or faces[0].shape[0] != faces[0].shape[1]:
                raise InputError(f"The six faces in '{folder}' are {sorted(shapes)}, expected equal squares.")
            return np.stack(faces)
        missing = tuple(name for name in names if name not in found)
        if found and (not best or len(missing) < len(best)):
            best = missing
    lacking = f"lacks the face{'s' * (len(best) > 1)} {', '.join(best)}" if best else "holds no faces of a cube"
    raise InputError(f"'{folder}' {lacking}, expected six pictures as px.hdr, nx.hdr, py.hdr, ny.hdr, pz.hdr, nz.hdr.")


def is_built_in(path: Path) -> bool:
    """Whether a path is the name of an environment that ships, and no file of that name exists."""
    return str(path) in ("procedural", "letters") and not path.exists()


def is_folder_of_faces(folder: Path) -> bool:
    """Whether a folder holds at least three pictures that are named as faces of a cube."""
    stems = [path.stem.lower() for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES]
    return any(sum(any(_is_face(stem, name) for stem in stems) for name in names) >= 3 for names in _FACE_NAMES)


def _is_face(stem: str, name: str) -> bool:
    return stem == name or stem.endswith(("_" + name, "-" + name, "." + name))


def _checked(path: Path, pixels: NDArray, clamp: bool, notes: list[str]) -> NDArray:
    not_finite, negative = int((~np.isfinite(pixels)).sum()), int((pixels < 0.0).sum())
    if not (not_finite or negative):
        return pixels
    found = " and ".join(
        f"{count} {what}" for count, what in ((not_finite, "not finite"), (negative, "negative")) if count
    )
    if not clamp:
        raise InputError(f"'{path}' holds values that are no radiance: {found}; `brdffit probe --clamp` mends them.")
    largest = float(pixels[np.isfinite(pixels)].max(initial=0.0))
    notes.append(f"Values that are no radiance were clamped: {found}.")
    return np.maximum(np.nan_to_num(pixels, nan=0.0, posinf=largest, neginf=0.0), 0.0).astype(np.float32)


def _repeats_its_border(pixels: NDArray) -> bool:
    """Whether the last column repeats the first, judged against the step between the first two columns."""
    first, last = pixels[:, 0], pixels[:, -1]
    step = float(np.abs(pixels[:, 0] - pixels[:, 1]).mean())
    return float(np.abs(first - last).mean()) < 0.05 * step
