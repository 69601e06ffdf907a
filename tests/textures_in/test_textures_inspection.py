"""What ``inspect`` finds, and what it calls wrong."""

from __future__ import annotations

import re

import numpy as np
import pytest
from pictures import bumps, encoded

from brdffit.textures.inspection import inspect_set
from brdffit.textures.reading import read_texture_set

HEIGHT, NORMAL = bumps()
GREY = (HEIGHT - HEIGHT.min()) / np.ptp(HEIGHT)
VARIED = np.random.default_rng(0).random((48, 64, 3))


def test_a_sound_set_has_nothing_wrong(make_folder) -> None:
    rough = np.linspace(0.2, 0.8, 64)[None].repeat(48, 0)
    metal = np.arange(64)[None].repeat(48, 0) >= 48
    folder = make_folder(
        a_NormalGL__png=(encoded(NORMAL), "uint16"), a_Color__png=VARIED, a_Roughness__png=rough, a_Metallic__png=metal
    )
    inspection = inspect_set(read_texture_set(folder))
    assert inspection.wrong == []
    assert [(m.role, m.file, m.width, m.height, m.bits, m.decoding) for m in inspection.maps] == [
        ("base_color", "a_Color.png", 64, 48, 8, "sRGB"),
        ("normal", "a_NormalGL.png", 64, 48, 16, "OpenGL (+Y)"),
        ("roughness", "a_Roughness.png", 64, 48, 8, "data"),
        ("metallic", "a_Metallic.png", 64, 48, 8, "data"),
    ]
    statistics = inspection.statistics
    np.testing.assert_allclose(statistics["mean_normal"], NORMAL.mean((0, 1)), atol=1e-4)
    slope = NORMAL[..., :2] / NORMAL[..., 2:]
    np.testing.assert_allclose(statistics["slope_spread"], slope.std((0, 1)), rtol=1e-3)
    blocks = NORMAL.reshape(6, 8, 8, 8, 3).mean((1, 3))
    assert statistics["normal_length_8x8"] == pytest.approx(np.linalg.norm(blocks, axis=2).mean(), abs=1e-4)
    assert statistics["roughness_mean"] == pytest.approx(0.5, abs=0.002)
    assert statistics["metallic_share"] == 0.25
    assert statistics["stored_normal_length"] == pytest.approx(1.0, abs=1e-4)


DITHER = (127 + np.random.default_rng(1).integers(0, 2, (48, 64, 3)) + [0, 0, 127]) / 255.0
STEEP = np.where(np.arange(64)[None, :, None] % 8 == 0, [0.995, 0.0, 0.1], [0.0, 0.0, 1.0]).repeat(48, 0)
LEANING = np.broadcast_to([0.2, 0.0, 0.98], (48, 64, 3))
WRONG = {
    "short": ({"a_NormalGL__png": encoded(0.7 * NORMAL)}, r"are short \(mean length 0\.70 at level 0"),
    "dither": ({"a_NormalGL__png": DITHER}, "is flat: it only dithers between neighbouring codes of its 8 bits"),
    "steep": ({"a_NormalGL__png": (encoded(STEEP), "uint16")}, r"12\.5% of the normals are steeper than 76 degrees"),
    "leaning": ({"a_NormalGL__png": encoded(LEANING)}, r"mean normal leans by 11\.\d degrees"),
    "wrong Y by height": (
        {"a_NormalDX__png": encoded(NORMAL), "a_Height__png": (GREY, "uint16")},
        "is read as DX, but the height map speaks for GL",
    ),
    "wrong Y by curl": (
        {"a_NormalGL__png": encoded(NORMAL, "dx")},
        "is read as GL, but the slopes' curl speaks for DX",
    ),
    "sRGB": ({"a_NormalGL__png": encoded(NORMAL) ** 2.2}, "was decoded as sRGB"),
    "sizes": (
        {"a_NormalGL__png": encoded(NORMAL), "a_Color__png": VARIED[::2, ::2]},
        "have different sizes: 32x24, 64x48",
    ),
    "constant": (
        {"a_NormalGL__png": encoded(NORMAL), "a_Roughness__png": np.full((48, 64), 0.4)},
        r"roughness of 'a_Roughness\.png' is constant \(0\.400\)",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_looks_wrong_is_said(make_folder, case: str) -> None:
    files, sentence = WRONG[case]
    inspection = inspect_set(read_texture_set(make_folder(**files)))
    assert len([wrong for wrong in inspection.wrong if re.search(sentence, wrong)]) == 1, inspection.wrong


def test_the_evidence_for_the_normals_y_is_shown(make_folder) -> None:
    files = {"a_NormalDX__png": encoded(NORMAL), "a_Height__png": (GREY, "uint16")}
    (sentence,) = [note for note in inspect_set(read_texture_set(make_folder(**files))).notes if "Correlations" in note]
    assert sentence.startswith("The normal's Y is read as DirectX; this is known from: name. Correlations: height for ")
    assert "slopes for OpenGL 0.9" in sentence
