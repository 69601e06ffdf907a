"""Filament's cmgen and brdffit on the same picture, curve and cube of 128, where cmgen is installed."""

from __future__ import annotations

import resource
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.files.image_io import read_image
from brdffit.probes.cubemap import mean_radiance
from brdffit.probes.curves import get_curve
from brdffit.probes.direct import packed_source
from brdffit.probes.filtering import Exact, FilterOptions, filter_levels, level_requests
from brdffit.probes.reading import as_cube, read_surroundings, reoriented

_SIZE = 128
#: cmgen's smallest level is 16^2, and it spreads Filament's curve over the levels that it makes.
_LEVELS = 4
_FACES = ("px", "nx", "py", "ny", "pz", "nz")
#: In cmgen's world the middle of a lat-long picture is +Z, and its cube maps are seen from outside.
_CENTRE, _MIRROR = "+z", np.diag([-1, 1, 1])


def installed() -> str | None:
    """Path of cmgen, or None where it is not on the PATH."""
    return shutil.which("cmgen")


def run_cmgen(path: Path) -> tuple[list[NDArray], float]:
    """Levels (6, n, n, 3) of a lat-long picture in cmgen's world, unmirrored, and processor seconds of the whole run.

    Raises:
        InputError: when cmgen cannot be started or refuses the picture.
    """
    with tempfile.TemporaryDirectory() as folder:
        command = ["cmgen", "-q", "--no-mirror", "-f", "hdr", f"--size={_SIZE}", f"--ibl-ld={folder}", str(path)]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        except OSError as error:
            raise InputError(f"cmgen could not be started: {error.strerror}.") from error
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        made = next(iter(Path(folder).iterdir()), None)
        if done.returncode != 0 or made is None:
            raise InputError(f"cmgen could not filter '{path}': {done.stderr.strip() or 'it wrote nothing'}.")
        levels = [
            np.stack([read_image(made / f"m{level}_{face}.hdr").pixels[..., :3] for face in _FACES])
            for level in range(_LEVELS)
        ]
    return levels, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def beside_cmgen(path: Path, tolerance: float, threads: int, count: int) -> dict[str, Any]:
    """Errors of levels 1 to 3 of cmgen and of the tree at ``tolerance``, against brute force on ``count`` texels.

    Seconds are processor time from the file to the levels; those of cmgen include writing its levels.

    Raises:
        InputError: as ``run_cmgen``, and when the picture is not lat-long.
    """
    theirs, their_seconds = run_cmgen(path)
    began = time.process_time()
    surroundings = read_surroundings(path)
    if surroundings.layout != "latlong":
        raise InputError(f"'{path}' is no lat-long picture, which cmgen turns as we know.")
    cube = reoriented(as_cube(surroundings, _SIZE, _CENTRE, threads=threads), _MIRROR)
    requests = level_requests(get_curve("quadratic", _LEVELS, _SIZE), _SIZE, _SIZE, keep_narrow=True)
    ours = filter_levels(cube, requests, FilterOptions(tolerance=tolerance, threads=threads), measure=False)
    our_seconds = time.process_time() - began
    source, energy = packed_source(cube), mean_radiance(cube).sum()
    exact = [Exact(source, request, threads, count) for request in requests[1:]]
    record: dict[str, Any] = {"environment": path.stem, "tolerance": tolerance}
    for name, levels, seconds in (
        ("cmgen", theirs, their_seconds),
        ("brdffit", [level.radiance for level in ours], our_seconds),
    ):
        errors = [known.error_and_bias(level)[0] for known, level in zip(exact, levels[1:], strict=True)]
        record[name] = {
            "errors": [round(error, 5) for error in errors],
            "error": float(np.mean(errors)),
            "energy": round(float(mean_radiance(levels[0]).sum() / energy), 4),
            "seconds": round(seconds, 3),
        }
    return record
