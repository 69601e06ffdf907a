"""KTX2 and DDS files, and the blocks in them: read back by strict readers, by OpenImageIO and by npm ktx-parse."""

import io

import numpy as np
import OpenImageIO as oiio
import pytest
from container_support import node, read_dds, read_ktx2

from brdffit.errors import UnknownNameError
from brdffit.export.bc4 import decode_bc4, encode_bc4
from brdffit.export.compression import (
    COMPRESSIONS,
    MissingEncoderError,
    check_compression,
    encode_level,
    encode_uastc,
    pad_to_blocks,
)
from brdffit.export.dds import write_dds
from brdffit.export.formats import FORMATS, chain
from brdffit.export.ktx2 import write_ktx2

SIZES = [(64, 64), (60, 100), (1, 7), (1, 1)]
OF_DDS = [name for name, each in FORMATS.items() if each.dxgi is not None]


def random_levels(pixels, size, seed=0):
    random = np.random.default_rng(seed)
    return [random.bytes(pixels.level_bytes(each)) for each in chain(size)]


def as_ktx2(pixels, size, levels, zstd=None):
    file = io.BytesIO()
    write_ktx2(file, pixels, size, levels.__getitem__, zstd=zstd)
    return file.getvalue()


def as_dds(pixels, size, levels):
    file = io.BytesIO()
    write_dds(file, pixels, size, levels.__getitem__)
    return file.getvalue()


def colours_of_levels(size):
    """Levels of one colour each, no two alike."""
    random = np.random.default_rng(5)
    return [np.broadcast_to(random.integers(20, 235, 3, np.uint8), (*each, 3)) for each in chain(size)]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("zstd", [None, 3])
@pytest.mark.parametrize("name", FORMATS)
def test_a_ktx2_file_holds_the_levels_and_keeps_the_rules(name, zstd, size):
    pixels = FORMATS[name]
    levels = random_levels(pixels, size)
    data = as_ktx2(pixels, size, levels, zstd)
    assert read_ktx2(data) == (pixels, size, levels)
    assert data == as_ktx2(pixels, size, levels, zstd)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", OF_DDS)
def test_a_dds_file_holds_the_levels_and_keeps_the_rules(name, size):
    pixels = FORMATS[name]
    levels = random_levels(pixels, size)
    assert read_dds(as_dds(pixels, size, levels)) == (pixels, size, levels)


def test_a_file_may_begin_inside_another():
    pixels, size = FORMATS["bc7"], (12, 20)
    levels = random_levels(pixels, size)
    file = io.BytesIO(b"before")
    file.seek(6)
    write_ktx2(file, pixels, size, levels.__getitem__)
    assert file.tell() == len(file.getvalue())
    assert file.getvalue()[6:] == as_ktx2(pixels, size, levels)


def test_levels_are_asked_one_by_one():
    pixels, size, asked = FORMATS["rgba8"], (8, 4), []
    levels = random_levels(pixels, size)

    def level(k):
        asked.append(k)
        return levels[k]

    write_ktx2(io.BytesIO(), pixels, size, level)
    write_dds(io.BytesIO(), pixels, size, level)
    assert asked == [3, 2, 1, 0, 0, 1, 2, 3]


@pytest.mark.parametrize("write", [write_ktx2, write_dds])
def test_a_level_of_the_wrong_length_is_refused(write):
    pixels = FORMATS["bc7"]
    levels = random_levels(pixels, (8, 8))
    levels[2] = levels[2][:4]  # what an encoder returns that was not given whole blocks
    with pytest.raises(ValueError, match=r"level 2 \(2x2, bc7\) has 4 bytes, expected 16"):
        write(io.BytesIO(), pixels, (8, 8), levels.__getitem__)


@pytest.mark.parametrize("size", [(64, 64), (60, 100), (32, 128)])
@pytest.mark.parametrize("name", ["rgba8", "rgba8_srgb", "bc4", "bc5", "bc6h", "bc7", "bc7_srgb"])
def test_openimageio_reads_every_level_of_a_dds_file(tmp_path, name, size):
    pixels, colours = FORMATS[name], colours_of_levels(size)
    scale = 255.0 if pixels.is_float else 1
    levels = [encode_level(pixels, colour / scale if pixels.is_float else colour) for colour in colours]
    path = tmp_path / "levels.dds"
    path.write_bytes(as_dds(pixels, size, levels))
    for level, (expected, (height, width)) in enumerate(zip(colours, chain(size), strict=True)):
        image = oiio.ImageBuf(str(path), 0, level)
        assert (image.spec().height, image.spec().width) == (height, width)
        seen = np.asarray(image.get_pixels(oiio.FLOAT))[..., : pixels.channels][..., :3]
        wanted = expected[..., : seen.shape[-1]]
        if name == "bc5":
            seen, wanted = seen[..., :2], wanted[..., :2]
        np.testing.assert_allclose(seen * 255.0, wanted, atol=6)


def test_ktx_parse_reads_every_file_and_writes_it_back_alike(tmp_path):
    for name, pixels in FORMATS.items():
        for zstd in (None, 3):
            for size in ((64, 64), (60, 100), (32, 128)):
                data = as_ktx2(pixels, size, random_levels(pixels, size), zstd)
                (tmp_path / f"{name}-{zstd}-{size[0]}.ktx2").write_bytes(data)
    result = node("parse.mjs", *sorted(tmp_path.glob("*.ktx2")))
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.parametrize("effort", COMPRESSIONS)
@pytest.mark.parametrize("name", ["bc4", "bc5", "bc6h", "bc7"])
def test_blocks_are_the_same_for_any_number_of_threads(name, effort):
    pixels = FORMATS[name]
    texels = np.random.default_rng(1).integers(0, 256, (132, 68, 4)).astype(np.uint8)
    texels = texels / 255.0 if pixels.is_float else texels
    one = encode_level(pixels, texels, effort, threads=1)
    assert one == encode_level(pixels, texels, effort, threads=2)
    assert len(one) == pixels.level_bytes((132, 68))


@pytest.mark.parametrize("size", [(1, 1), (2, 2), (3, 5), (25, 15)])
@pytest.mark.parametrize("name", ["bc4", "bc5", "bc6h", "bc7"])
def test_sides_that_are_no_multiple_of_four_are_padded_by_their_border(name, size):
    pixels = FORMATS[name]
    texels = np.random.default_rng(2).integers(0, 256, (*size, 4)).astype(np.uint8)
    texels = texels / 255.0 if pixels.is_float else texels
    padded = pad_to_blocks(texels)
    np.testing.assert_array_equal(padded[: size[0], : size[1]], texels)
    assert (padded[size[0] :] == padded[size[0] - 1]).all()
    data = encode_level(pixels, texels)
    assert len(data) == pixels.level_bytes(size)
    assert data == encode_level(pixels, padded)


def test_bc7_keeps_full_alpha_and_stores_another():
    texels = np.random.default_rng(3).integers(0, 256, (16, 16, 4)).astype(np.uint8)
    for alpha in (255, 77):
        texels[..., 3] = alpha
        stored = [encode_level(FORMATS["bc7"], texels), *random_levels(FORMATS["bc7"], (8, 8))]
        seen = decoded_by_openimageio(as_dds(FORMATS["bc7"], (16, 16), stored))
        np.testing.assert_allclose(seen[..., 3] * 255.0, alpha, atol=0 if alpha == 255 else 8)


def decoded_by_openimageio(data):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "level.dds")
        path.write_bytes(data)
        image = oiio.ImageInput.open(str(path))
        config = image.spec()
        pixels = np.asarray(image.read_image(0, 0, 0, config.nchannels, oiio.FLOAT))
        image.close()
    return pixels


@pytest.mark.parametrize("span", [0.3, 2.0, 8.0, 40.0, 255.0])
def test_bc4_blocks_keep_floats_finer_than_codes(tmp_path, span):
    """Values within ``span`` codes: the error is at most that of 8 steps over the span, or of a step between codes."""
    channel = (0.5 + (np.random.default_rng(4).random((64, 64)) - 0.5) * span / 255.0).astype(np.float32)
    blocks = encode_bc4(channel)
    seen = decode_bc4(blocks)
    off = float(np.sqrt(np.mean(np.square((seen - channel) * 255.0))))
    assert off <= 1.1 * max(span, 2.0) / 7.0 / np.sqrt(12.0) + 0.03
    rounded = float(np.sqrt(np.mean(np.square(np.round(channel * 255.0) - channel * 255.0))))
    assert span > 5.0 or off < 0.5 * rounded
    # Another reader sees the same, to its 8 bits.
    pixels = FORMATS["bc4"]
    stored = [blocks.tobytes(), *random_levels(pixels, (32, 32))]
    theirs = decoded_by_openimageio(as_dds(pixels, (64, 64), stored))[..., 0]
    np.testing.assert_allclose(theirs, seen, atol=1.01 / 255.0)


def test_ends_of_bc4_blocks_are_near_the_best_of_all_pairs():
    """Eight blocks of noise against all 32,640 pairs of ends: 1.2 dB from the least error, and never below it."""
    channel = np.random.default_rng(6).random((4, 32), dtype=np.float32) * np.float32(0.2) + np.float32(0.4)
    seen = decode_bc4(encode_bc4(channel))
    low, high = np.triu_indices(256, 1)
    steps = low[:, None] + (high - low)[:, None] * np.arange(8) / 7.0
    least, found = 0.0, 0.0
    for block in range(8):
        texels = channel[:, 4 * block : 4 * block + 4].ravel().astype(np.float64) * 255.0
        best = np.square(np.abs(texels[None, :, None] - steps[:, None, :]).min(axis=-1)).sum(axis=-1).min()
        ours = np.square(seen[:, 4 * block : 4 * block + 4].ravel() * 255.0 - texels).sum()
        assert ours >= best * 0.999
        least, found = least + best, found + ours
    assert 10.0 * np.log10(found / least) < 1.2


def test_bc4_blocks_of_the_other_kind_are_refused():
    with pytest.raises(ValueError, match="e0 <= e1"):
        decode_bc4(np.zeros((1, 1, 8), np.uint8))


def test_uastc_blocks_decode_to_the_levels():
    pytest.importorskip("alktx2", reason="the extra [basis] is not installed")
    basisu = pytest.importorskip("opengl_basisu", reason="no decoder of UASTC is installed")
    size = (64, 32)
    colours = [np.dstack([level, np.full(level.shape[:2], 255, np.uint8)]) for level in colours_of_levels(size)]
    for name in ("uastc", "uastc_srgb"):
        pixels = FORMATS[name]
        blocks = encode_uastc(pixels, colours, threads=1)
        assert blocks == encode_uastc(pixels, colours, threads=2)
        for level, data in enumerate(blocks):
            assert len(data) == pixels.level_bytes(chain(size)[level])
        texture = basisu.open(as_ktx2(pixels, size, blocks))
        for level, expected in enumerate(colours):
            seen = np.frombuffer(texture.transcode("rgba8", level).data, np.uint8).reshape(expected.shape)
            np.testing.assert_allclose(seen.astype(int), expected, atol=6)


def test_names_are_checked():
    with pytest.raises(UnknownNameError, match="did you mean 'best'"):
        check_compression("bestt")


def test_an_encoder_that_is_missing_is_named_with_its_extra(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "alktx2", None)
    with pytest.raises(MissingEncoderError, match=r"pip install 'brdffit\[basis\]'"):
        encode_uastc(FORMATS["uastc"], [np.zeros((4, 4, 4), np.uint8)])
