"""Reading and writing images: what is read is what was stored, and what is broken is told."""

from __future__ import annotations

import os
import struct
import time
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import PIL.Image
import PIL.ImageOps
import pytest
from pictures import write_image

from brdffit.errors import InputError, OutputError
from brdffit.files.exr_chunks import is_complete
from brdffit.files.image_io import IMAGE_SUFFIXES, read_image, read_info, read_mip_exr, write_mip_exr, write_png

RNG = np.random.default_rng(0)


def mip_levels(height: int, width: int, channels: int = 3) -> list[np.ndarray]:
    levels = [RNG.normal(size=(height, width, channels)).astype(np.float32)]
    while levels[-1].shape[:2] != (1, 1):
        h, w = (max(1, side // 2) for side in levels[-1].shape[:2])
        levels.append(RNG.normal(size=(h, w, channels)).astype(np.float32))
    return levels


@pytest.mark.parametrize("kind", ["uint8", "uint16"])
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_png_returns_its_codes(tmp_path: Path, kind: str, channels: int) -> None:
    codes = RNG.integers(0, np.iinfo(kind).max, (7, 5, channels), endpoint=True).astype(kind)
    write_png(tmp_path / "a.png", codes)
    image = read_image(tmp_path / "a.png")
    assert (image.bits, image.is_float) == (8 * codes.itemsize, False)
    # With alpha of zero too: premultiplied reading would lose the colours.
    np.testing.assert_array_equal(np.rint(image.pixels * np.iinfo(kind).max), codes)


@pytest.mark.parametrize(("kind", "bits"), [("half", 16), ("float", 32)])
def test_float_formats_are_flagged_and_unscaled(tmp_path: Path, kind: str, bits: int) -> None:
    stored = np.array([[[-3.5, 0.25, 1024.0]]])
    image = read_image(write_image(tmp_path / "a.exr", stored, kind))
    assert (image.bits, image.is_float) == (bits, True)
    np.testing.assert_array_equal(image.pixels, stored)


def test_header_alone_says_the_same(tmp_path: Path) -> None:
    path = write_image(tmp_path / "a.png", RNG.random((3, 9, 2)), "uint16")
    info, image = read_info(path), read_image(path)
    assert (info.width, info.height, info.bits, info.channels) == (9, 3, 16, image.channels)
    assert info.sha256 == image.sha256 != read_info(write_image(tmp_path / "b.png", np.zeros((3, 9, 2)))).sha256


@pytest.mark.parametrize("size", [(60, 100), (1, 1), (1, 37), (130, 3)])
def test_every_level_of_a_mip_exr_comes_back(tmp_path: Path, size: tuple[int, int]) -> None:
    levels = mip_levels(*size)
    write_mip_exr(tmp_path / "a.exr", levels, ("XX", "YY", "XY"), {"brdffit:model": "ggx"})
    read = read_mip_exr(tmp_path / "a.exr", ("XX", "YY", "XY"))
    assert len(read) == len(levels)
    for stored, back in zip(levels, read, strict=True):
        np.testing.assert_array_equal(stored, back)


def test_a_mip_exr_has_no_date_in_it(tmp_path: Path) -> None:
    levels = mip_levels(8, 8)
    write_mip_exr(tmp_path / "a.exr", levels, ("X", "Y", "Z"))
    time.sleep(1.1)
    write_mip_exr(tmp_path / "b.exr", levels, ("X", "Y", "Z"))
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


def test_a_chain_that_stops_short_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="last MIP level"):
        write_mip_exr(tmp_path / "a.exr", mip_levels(8, 8)[:-1], ("X", "Y", "Z"))


@pytest.mark.parametrize("size", [(1, 1), (130, 3), (100, 200)])
def test_a_mip_exr_is_complete_only_with_each_of_its_chunks(tmp_path: Path, size: tuple[int, int]) -> None:
    path = tmp_path / "a.exr"
    write_mip_exr(path, mip_levels(*size), ("X", "Y", "Z"))
    whole = path.read_bytes()
    assert is_complete(path)
    for kept in {*range(0, len(whole), max(len(whole) // 50, 1)), len(whole) - 1}:
        path.write_bytes(whole[:kept])
        assert not is_complete(path), kept
    # The last chunk is that of the level 1x1: three floats. A writer that stopped before it leaves its offset at 0.
    last = (len(whole) - 20 - 12).to_bytes(8, "little")
    assert whole.count(last) == 1
    path.write_bytes(whole.replace(last, bytes(8))[:-32])
    assert not is_complete(path)
    path.write_bytes(whole + bytes(1))
    assert not is_complete(path)


def test_a_missing_channel_is_told(tmp_path: Path) -> None:
    write_mip_exr(tmp_path / "a.exr", mip_levels(2, 2), ("X", "Y", "Z"))
    with pytest.raises(InputError, match="has the channels X, Y, Z, expected R, G, B"):
        read_mip_exr(tmp_path / "a.exr", ("R", "G", "B"))


@pytest.mark.parametrize(("suffix", "kind"), [("png", "uint8"), ("png", "uint16"), ("jpg", "uint8"), ("exr", "half")])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_a_truncated_image_is_told(tmp_path: Path, suffix: str, kind: str, share: float) -> None:
    path = write_image(tmp_path / f"a.{suffix}", RNG.random((40, 40, 3)), kind)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InputError, match=r"'.*a\..*' is (truncated or damaged|not an image)"):
        read_image(path)


def test_missing_empty_wrong_kind_and_folder_are_told(tmp_path: Path) -> None:
    (tmp_path / "empty.png").touch()
    (tmp_path / "text.png").write_text("no picture")
    cases = {
        "none.png": "does not exist, expected an image file",
        "empty.png": r"is empty \(0 bytes\), expected an image file",
        "text.png": "is not an image that can be read",
        ".": "is a folder, expected an image file",
    }
    for name, sentence in cases.items():
        with pytest.raises(InputError, match=sentence):
            read_image(tmp_path / name)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read everything")
def test_an_unreadable_file_is_told(tmp_path: Path) -> None:
    path = write_image(tmp_path / "a.png", np.zeros((2, 2, 3)))
    path.chmod(0)
    with pytest.raises(InputError, match="cannot be read: Permission denied"):
        read_image(path)


@pytest.mark.parametrize("suffix", ["png", "exr"])
def test_a_full_disk_and_a_missing_folder_are_told(tmp_path: Path, suffix: str) -> None:
    def write(path: Path) -> None:
        if suffix == "png":
            write_png(path, RNG.integers(0, 255, (64, 64, 3), dtype=np.uint8))
        else:
            write_mip_exr(path, mip_levels(64, 64), ("X", "Y", "Z"))

    with pytest.raises(OutputError, match="could not be written"):
        write(tmp_path / "nowhere" / f"a.{suffix}")
    if not Path("/dev/full").exists():
        pytest.skip("needs /dev/full")
    (tmp_path / f"a.{suffix}").symlink_to("/dev/full")
    with pytest.raises(OutputError, match="is the folder writable and the disk not full"):
        write(tmp_path / f"a.{suffix}")


# What files say of their pixels


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_picture_is_set_upright(tmp_path: Path, orientation: int) -> None:
    """Against Pillow, which has its own table."""
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8)
    path = tmp_path / "a.tif"
    PIL.Image.fromarray(pixels).save(path, tiffinfo={274: orientation})
    expected = np.asarray(PIL.ImageOps.exif_transpose(PIL.Image.open(path)))
    image = read_image(path)
    assert (image.height, image.width) == expected.shape[:2]
    np.testing.assert_array_equal(np.rint(image.pixels * 255), expected)


def test_colours_of_a_tiff_with_associated_alpha_are_divided_by_it(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    colour, alpha = rng.random((4, 5, 3)), rng.uniform(0.3, 1.0, (4, 5, 1))
    alpha[0, 0] = 0.0
    associated = np.concatenate([colour * alpha, alpha], axis=2).astype(np.float32)
    spec = oiio.ImageSpec(5, 4, 4, "uint16")
    writer = oiio.ImageOutput.create("tiff")
    assert writer.open(str(tmp_path / "a.tif"), spec)
    assert writer.write_image(associated)
    assert writer.close()
    image = read_image(tmp_path / "a.tif")
    assert image.associated
    np.testing.assert_allclose(image.pixels[1:, :, :3], colour[1:], atol=1e-4)
    np.testing.assert_allclose(image.pixels[..., 3:], alpha, atol=1e-4)
    np.testing.assert_array_equal(image.pixels[0, 0], 0.0)
    for suffix in ("tif", "png"):
        file = write_image(tmp_path / f"b.{suffix}", np.concatenate([colour, alpha], axis=2), "uint16")
        image = read_image(file)
        assert not image.associated
        np.testing.assert_allclose(image.pixels[..., :3], colour, atol=1e-4)


def test_a_tiff_in_which_white_is_zero_is_turned_over(tmp_path: Path) -> None:
    """The smallest such file, byte by byte: two texels, 0 and 200 of 255, PhotometricInterpretation 0."""
    entries = [(256, 3, 2), (257, 3, 1), (258, 3, 8), (259, 3, 1), (262, 3, 0), (273, 4, 8), (277, 3, 1), (278, 3, 1)]
    entries += [(279, 4, 2)]
    data = b"II*\0" + struct.pack("<I", 10) + bytes([0, 200]) + struct.pack("<H", len(entries))
    data += b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in entries) + struct.pack("<I", 0)
    (tmp_path / "a.tif").write_bytes(data)
    np.testing.assert_allclose(read_image(tmp_path / "a.tif").pixels[0, :, 0], [1.0, 55 / 255])


def test_of_parts_and_layers_the_first_with_colours_is_read_and_the_rest_said(tmp_path: Path) -> None:
    depth, beauty = np.full((2, 3, 1), 5.0, np.float32), np.random.default_rng(2).random((2, 3, 3)).astype(np.float32)
    specs = []
    for name, channels in (("depth", ("Z",)), ("beauty", ("R", "G", "B"))):
        spec = oiio.ImageSpec(3, 2, len(channels), "float")
        spec.channelnames = channels
        spec.attribute("name", name)
        specs.append(spec)
    writer = oiio.ImageOutput.create("openexr")
    assert writer.open(str(tmp_path / "parts.exr"), tuple(specs)), writer.geterror()
    assert writer.write_image(depth)
    assert writer.open(str(tmp_path / "parts.exr"), specs[1], "AppendSubimage")
    assert writer.write_image(beauty)
    assert writer.close()
    image = read_image(tmp_path / "parts.exr")
    np.testing.assert_array_equal(image.pixels, beauty)
    assert image.remark == " has 2 parts (depth, beauty): 'beauty' is read."
    spec = oiio.ImageSpec(3, 2, 5, "float")
    spec.channelnames = ("R", "G", "B", "Z", "spec.R")
    writer = oiio.ImageOutput.create("openexr")
    assert writer.open(str(tmp_path / "layers.exr"), spec)
    assert writer.write_image(np.concatenate([beauty, depth, depth], axis=2))
    assert writer.close()
    image = read_image(tmp_path / "layers.exr")
    np.testing.assert_array_equal(image.pixels, beauty)
    assert "left out" in image.remark and "spec.R" in image.remark


@pytest.mark.parametrize("suffix", ["jp2", "jfif", "psd", "bmp", "tga", "ppm", "sgi", "gif", "jxl"])
def test_what_the_library_reads_is_looked_at(tmp_path: Path, suffix: str) -> None:
    assert f".{suffix}" in IMAGE_SUFFIXES
    file = tmp_path / f"a.{suffix}"
    pixels = np.random.default_rng(3).integers(0, 256, (8, 8, 3), np.uint8)
    kind = {"jp2": "JPEG2000", "jfif": "JPEG", "gif": "GIF", "ppm": "PPM", "bmp": "BMP", "tga": "TGA", "sgi": "SGI"}
    if suffix not in kind:
        pytest.skip(f"nothing here writes .{suffix}")
    PIL.Image.fromarray(pixels).save(file, format=kind[suffix])
    assert read_image(file).pixels.shape[:2] == (8, 8)


def test_a_name_that_is_not_utf8_is_told(tmp_path: Path) -> None:
    file = os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9.png")
    Path(file).write_bytes(b"no matter")
    with pytest.raises(InputError) as told:
        read_image(file)
    assert "is not UTF-8" in str(told.value)
    str(told.value).encode("utf-8")
