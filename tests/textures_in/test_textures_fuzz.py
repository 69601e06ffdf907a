"""Mutated files and names end in a set or in a sentence: no traceback, no hang, no file left over."""

from __future__ import annotations

import json
import os
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pictures import bumps, encoded, write_image

from brdffit.errors import BrdffitError
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.inspection import inspect_set
from brdffit.textures.naming import roles_from_names
from brdffit.textures.naming_words import LAYERS, LETTERS, PACKED, WORDS
from brdffit.textures.reading import read_texture_set

#: Longest that any one mutated input may take, in seconds.
HANG = 10.0
WORD = st.sampled_from(
    [*sorted(WORDS), *sorted(PACKED), *sorted(LAYERS), *LETTERS, "4K", "var1", "(1)", "Wood", "é", ""]
)
NAME = st.lists(WORD, min_size=1, max_size=5).map("_".join)


@settings(deadline=None, max_examples=300)
@given(st.lists(NAME, min_size=1, max_size=8, unique=True), st.booleans())
def test_any_names_give_roles_or_none(names: list[str], alpha: bool) -> None:
    files = [f"{name}.png" for name in names]
    named = roles_from_names(files, files if alpha else [])
    chosen = {choice.file for choice in named.maps.values()}
    assert chosen <= set(files)
    assert sorted(chosen | set(named.ignored)) == sorted(files)
    assert roles_from_names(reversed(files), files if alpha else []).maps == named.maps


GLTF = {
    "asset": {"version": "2.0"},
    "images": [{"uri": "c.png"}, {"uri": "n.png"}],
    "textures": [{"source": 0, "sampler": 0}, {"source": 1}],
    "samplers": [{"wrapS": 10497}],
    "meshes": [{"primitives": [{"material": 0}]}],
    "materials": [
        {
            "name": "m",
            "alphaMode": "MASK",
            "alphaCutoff": 0.4,
            "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "baseColorFactor": [1, 1, 1, 1]},
            "normalTexture": {
                "index": 1,
                "scale": 0.5,
                "extensions": {"KHR_texture_transform": {"scale": [2, 2], "rotation": 0.0}},
            },
            "extensions": {"KHR_materials_ior": {"ior": 1.4}, "KHR_materials_specular": {"specularFactor": 0.5}},
        }
    ],
}
MTLX = """<?xml version="1.0"?><materialx version="1.38">
<image name="c" type="color3"><input name="file" type="filename" value="c.png" colorspace="srgb_texture"/></image>
<image name="n" type="vector3"><input name="file" type="filename" value="n.png"/></image>
<normalmap name="m" type="vector3"><input name="in" type="vector3" nodename="n"/></normalmap>
<invert name="i" type="float"><input name="in" type="float" nodename="x"/></invert>
<image name="x" type="float"><input name="file" type="filename" value="c.png"/></image>
<standard_surface name="S" type="surfaceshader"><input name="base_color" type="color3" nodename="c"/>
<input name="normal" type="vector3" nodename="m"/><input name="specular_roughness" type="float" nodename="i"/>
</standard_surface>
<surfacematerial name="M" type="material"><input name="surfaceshader" type="surfaceshader" nodename="S"/>
</surfacematerial></materialx>"""


def _originals(folder: Path) -> dict[str, bytes]:
    """Small files of all kinds that are read."""
    rng = np.random.default_rng(0)
    _, normal = bumps(8, 8)
    write_image(folder / "c.png", rng.random((8, 8, 3)))
    write_image(folder / "n.png", encoded(normal))
    for suffix, kind in (("jpg", "uint8"), ("tif", "uint16"), ("exr", "half"), ("tga", "uint8"), ("bmp", "uint8")):
        write_image(folder / f"x_NormalGL.{suffix}", encoded(normal), kind)
    write_image(folder / "x_Color.png", rng.random((8, 8, 4)))
    (folder / "s.gltf").write_text(json.dumps(GLTF))
    (folder / "s.mtlx").write_text(MTLX)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def _mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Truncated, with flipped bits, with a stretch repeated, zeroed or taken out, or with numbers exchanged."""
    kind, size = int(rng.integers(6)), len(data)
    at, length = int(rng.integers(size)), int(rng.integers(1, max(2, size // 4)))
    if kind == 0:
        return data[:at]
    if kind == 1:
        flipped = bytearray(data)
        for place in rng.integers(0, size, int(rng.integers(1, 12))):
            flipped[place] ^= 1 << int(rng.integers(8))
        return bytes(flipped)
    if kind == 2:
        return data[:at] + data[at : at + length] * 2 + data[at + length :]
    if kind == 3:
        return data[:at] + bytes(min(length, size - at)) + data[at + length :]
    if kind == 4:
        return data[:at] + data[at + length :]
    digit = str(int(rng.choice([0, 1, 9, -1, 99999999999]))).encode()
    places = [k for k, byte in enumerate(data) if chr(byte).isdigit()] or [at]
    place = int(rng.choice(places))
    return data[:place] + digit + data[place + 1 :]


def _bake(target: Path) -> str:
    """What comes of a file or folder: "set" or a sentence."""
    start = time.perf_counter()
    try:
        texture_set = read_texture_set(target)
        to_svbrdf(texture_set)
        outcome = "set"
    except BrdffitError as error:
        outcome = str(error)
        assert outcome.endswith((".", '"')) and "\n" not in outcome
    assert time.perf_counter() - start < HANG
    return outcome


def _fuzz(folder: Path, count: int, seed: int) -> dict[str, int]:
    originals, rng = _originals(folder), np.random.default_rng(seed)
    before = sorted(os.listdir(folder))
    outcomes = {"set": 0, "sentence": 0}
    for _ in range(count):
        name = str(rng.choice(sorted(originals)))
        (folder / name).write_bytes(_mutated(originals[name], rng))
        if name in ("c.png", "n.png", "s.gltf", "s.mtlx"):
            target = folder / ("s.mtlx" if name == "s.mtlx" or rng.random() < 0.5 else "s.gltf")
        else:
            # A folder of names alone: the mutated file, and what else is needed.
            target = folder.parent / "named"
            shutil.rmtree(target, ignore_errors=True)
            target.mkdir()
            shutil.copy(folder / name, target)
            if "Normal" not in name:
                shutil.copy(folder / "n.png", target / "x_NormalGL.png")
        outcomes["set" if _bake(target) == "set" else "sentence"] += 1
        (folder / name).write_bytes(originals[name])
    assert sorted(os.listdir(folder)) == before
    return outcomes


def test_a_hundred_mutated_files_end_in_a_set_or_a_sentence(tmp_path: Path) -> None:
    folder = tmp_path / "all"
    folder.mkdir()
    outcomes = _fuzz(folder, 100, seed=1)
    assert min(outcomes.values()) > 5, "mutations that break nothing, or everything, test little"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_two_thousand_mutated_files_end_in_a_set_or_a_sentence(tmp_path: Path, seed: int) -> None:
    folder = tmp_path / "all"
    folder.mkdir()
    _fuzz(folder, 500, seed=100 + seed)


@pytest.mark.slow
def test_random_names_of_files_end_in_a_set_or_a_sentence(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    _, normal = bumps(8, 8)
    words = [*sorted(WORDS), *sorted(PACKED), *sorted(LAYERS), *LETTERS, "wood", "4K", "var1", "1001", "u1_v1"]
    for _ in range(200):
        folder = tmp_path / "named"
        shutil.rmtree(folder, ignore_errors=True)
        for _ in range(int(rng.integers(1, 6))):
            name = "_".join(rng.choice(words, int(rng.integers(1, 4))))
            pixels = encoded(normal) if rng.random() < 0.5 else rng.random((8, 8, int(rng.integers(1, 5))))
            write_image(folder / f"{name}.png", pixels)
        _bake(folder)
        try:
            inspect_set(read_texture_set(folder))
        except BrdffitError:
            pass
