"""MaterialX documents held against an evaluation by hand: read right, or named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pictures import bumps, encoded, write_image

from brdffit.colour import decode_srgb
from brdffit.errors import InputError
from brdffit.roughness import perceptual_from_log_tensor
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.materialx import materialx_material_names
from brdffit.textures.reading import read_texture_set

SIZE = 16
HEIGHT, NORMAL = bumps(SIZE, SIZE)
RNG = np.random.default_rng(5)
#: What is stored in 8 bits: grey one and two, and colours.
ONE, TWO = (np.rint(RNG.random((SIZE, SIZE)) * 255) / 255 for _ in range(2))
RGB, OTHER = (np.rint(RNG.random((SIZE, SIZE, 3)) * 255) / 255 for _ in range(2))
FILES = {"one.png": ONE, "two.png": TWO, "rgb.png": RGB, "other.png": OTHER}
IMAGE = '<image name="{name}" type="{type}"><input name="file" type="filename" value="{file}" {more}/></image>'


def image(name: str, file: str, kind: str = "float", more: str = "") -> str:
    return IMAGE.format(name=name, type=kind, file=file, more=more)


def inputs(**values: str) -> str:
    return "".join(f'<input name="{name.rstrip("_")}" {value}/>' for name, value in values.items())


def node(category: str, name: str, kind: str = "float", **values: str) -> str:
    return f'<{category} name="{name}" type="{kind}">{inputs(**values)}</{category}>'


def from_(name: str, kind: str = "float", output: str = "") -> str:
    return f'type="{kind}" nodename="{name}"' + (f' output="{output}"' if output else "")


def value(text: object, kind: str = "float") -> str:
    return f'type="{kind}" value="{text}"'


@pytest.fixture
def read(tmp_path: Path):
    """Write a document of these nodes and shader inputs beside the pictures, and read it."""
    for name, pixels in FILES.items():
        write_image(tmp_path / name, pixels)
    write_image(tmp_path / "n.png", encoded(NORMAL), "uint16")

    def made(nodes: str = "", shader: str = "standard_surface", rest: str = "", **ports: str):
        text = f'<?xml version="1.0"?><materialx version="1.39" colorspace="lin_rec709">{nodes}'
        text += node(shader, "S", "surfaceshader", **ports)
        text += f'<surfacematerial name="M" type="material">{inputs(surfaceshader=from_("S", "surfaceshader"))}'
        path = tmp_path / "doc.mtlx"
        path.write_text(f"{text}</surfacematerial>{rest}</materialx>")
        texture_set = read_texture_set(path)
        return texture_set, to_svbrdf(texture_set, min_roughness=0.001)

    return made


def rough(svbrdf) -> np.ndarray:
    return perceptual_from_log_tensor(svbrdf.log_roughness)


def close(found: np.ndarray, expected: np.ndarray, floor: float = 0.001) -> None:
    np.testing.assert_allclose(found, np.clip(expected, floor, 1.0), atol=2e-6, rtol=1e-5)


#: Nodes behind the roughness, and its value by hand.
GRAPHS = {
    "inverted gloss": (node("invert", "r", in_=from_("one")), 1.0 - ONE),
    "multiplied": (node("multiply", "r", in1=from_("one"), in2=value(0.3)), 0.3 * ONE),
    "sum": (node("add", "r", in1=from_("one"), in2=from_("two")), ONE + TWO),
    "mixed": (node("mix", "r", fg=from_("one"), bg=from_("two"), mix=value(0.25)), 0.25 * ONE + 0.75 * TWO),
    "mixed all": (node("mix", "r", fg=from_("one"), bg=from_("two"), mix=value(0)), TWO),
    "mixed by a map": (
        node("mix", "r", fg=value(0.9), bg=value(0.2), mix=from_("one")),
        0.9 * ONE + 0.2 * (1 - ONE),
    ),
    "remapped": (
        node("remap", "r", in_=from_("one"), outlow=value(0.2), outhigh=value(0.4)),
        0.2 + 0.2 * ONE,
    ),
    "ranged": (
        node("range", "r", in_=from_("one"), outlow=value(0.2), outhigh=value(0.4), gamma=value(2.0)),
        0.2 + 0.2 * np.sqrt(ONE),
    ),
    "contrast": (node("contrast", "r", in_=from_("one"), amount=value(0.5)), 0.5 * (ONE - 0.5) + 0.5),
    "clamped": (node("clamp", "r", in_=from_("one"), low=value(0.3), high=value(0.6)), np.clip(ONE, 0.3, 0.6)),
    "power": (node("power", "r", in1=from_("one"), in2=value(2.0)), ONE**2),
    "smooth": (node("smoothstep", "r", in_=from_("one")), ONE * ONE * (3 - 2 * ONE)),
    "greater": (
        node("ifgreater", "r", value1=from_("one"), value2=value(0.5), in1=from_("two"), in2=value(0.1)),
        np.where(ONE > 0.5, TWO, 0.1),
    ),
    "screen": (node("screen", "r", fg=from_("one"), bg=from_("two"), mix=value(1.0)), 1 - (1 - ONE) * (1 - TWO)),
    "channel": (
        image("v", "rgb.png", "vector3") + node("extract", "r", in_=from_("v", "vector3"), index=value(2, "integer")),
        RGB[..., 2],
    ),
    "separated": (
        image("v", "rgb.png", "vector3")
        + node("separate3", "s", "multioutput", in_=from_("v", "vector3"))
        + node("dot", "r", in_=from_("s", "float", "outy")),
        RGB[..., 1],
    ),
    "length": (
        image("v", "rgb.png", "vector3")
        + node("multiply", "h", "vector3", in1=from_("v", "vector3"), in2=value(0.5))
        + node("magnitude", "r", in_=from_("h", "vector3")),
        0.5 * np.linalg.norm(RGB, axis=2),
    ),
    "luminance": (
        image("c", "rgb.png", "color3")
        + node("luminance", "l", "color3", in_=from_("c", "color3"), lumacoeffs=value("0.2, 0.7, 0.1", "color3"))
        + node("extract", "r", in_=from_("l", "color3"), index=value(0, "integer")),
        RGB @ [0.2, 0.7, 0.1],
    ),
}


@pytest.mark.parametrize("case", GRAPHS)
def test_what_is_exact_on_pixels_is_evaluated(read, case: str) -> None:
    nodes, expected = GRAPHS[case]
    texture_set, svbrdf = read(image("one", "one.png") + image("two", "two.png") + nodes, specular_roughness=from_("r"))
    close(rough(svbrdf), expected)
    assert not any("not evaluated" in note for note in texture_set.notes)


def test_a_normalmap_has_its_scale(read) -> None:
    for scale, kind in ((0.25, "float"), ("0.25, 0.5", "vector2")):
        _, svbrdf = read(
            image("n", "n.png", "vector3")
            + node("normalmap", "m", "vector3", in_=from_("n", "vector3"), scale=value(scale, kind)),
            normal=from_("m", "vector3"),
        )
        slope = svbrdf.normal[..., :2] / svbrdf.normal[..., 2:]
        factor = [0.25, 0.25 if kind == "float" else 0.5]
        np.testing.assert_allclose(slope, factor * NORMAL[..., :2] / NORMAL[..., 2:], atol=1e-4)


def test_names_belong_to_their_graph(read) -> None:
    graphs = "".join(
        f'<nodegraph name="{graph}">{image("tex", file)}<output name="out" type="float" nodename="tex"/></nodegraph>'
        for graph, file in (("other", "two.png"), ("mine", "one.png"))
    )
    _, svbrdf = read(graphs, specular_roughness='type="float" nodegraph="mine" output="out"')
    close(rough(svbrdf), ONE)


def test_defaults_are_those_of_the_node_definition(read) -> None:
    colour = dict(base_color=from_("c", "color3"))
    nodes = image("c", "rgb.png", "color3", 'colorspace="srgb_texture"')
    texture_set, svbrdf = read(nodes, **colour)
    close(rough(svbrdf), np.full((SIZE, SIZE), 0.2))
    np.testing.assert_allclose(svbrdf.specular, 0.04, rtol=1e-5)
    assert any("its surface is flat" in note for note in texture_set.notes)


@pytest.mark.parametrize(
    ("space", "expected"),
    [("srgb_texture", decode_srgb(RGB)), ("lin_rec709", RGB), ("g22_rec709", RGB**2.2)],
)
def test_colour_spaces_are_those_of_the_images(read, space: str, expected: np.ndarray) -> None:
    nodes = image("c", "rgb.png", "color3", f'colorspace="{space}"')
    _, svbrdf = read(nodes, base_color=from_("c", "color3"), base=value(0.8))
    np.testing.assert_allclose(svbrdf.diffuse, 0.8 * expected, atol=1e-5)
    _, svbrdf = read(nodes, base_color=from_("c", "color3"), base=value(1))
    np.testing.assert_allclose(svbrdf.diffuse, expected, atol=1e-5)


def test_an_unknown_colour_space_is_refused(read) -> None:
    with pytest.raises(InputError, match="colour space 'camera_log', expected srgb_texture"):
        read(image("c", "rgb.png", "color3", 'colorspace="camera_log"'), base_color=from_("c", "color3"))


@pytest.mark.parametrize("category", ["noise3d", "fractal3d", "position", "nosuchnode"])
def test_what_has_no_meaning_on_pixels_is_named_with_what_is_taken(read, category: str) -> None:
    texture_set, svbrdf = read(
        image("c", "rgb.png", "color3") + node(category, "grain"),
        base_color=from_("c", "color3"),
        specular_roughness=from_("grain"),
    )
    (note,) = [note for note in texture_set.notes if "not evaluated" in note]
    assert f"'grain' (<{category}>)" in note and "the default of standard_surface, 0.2" in note
    close(rough(svbrdf), np.full((SIZE, SIZE), 0.2))


def test_nodes_in_a_circle_are_named(read) -> None:
    nodes = node("invert", "a", in_=from_("b")) + node("invert", "b", in_=from_("a")) + image("c", "rgb.png", "color3")
    texture_set, _ = read(nodes, base_color=from_("c", "color3"), specular_roughness=from_("a"))
    assert any("in a circle" in note for note in texture_set.notes)


def test_a_material_of_constants_alone_is_refused_with_what_it_hangs_on(read) -> None:
    with pytest.raises(InputError, match="constants alone.*'grain'"):
        read(node("noise2d", "grain"), specular_roughness=from_("grain"))


def test_tiling_that_maps_share_stays_outside_and_other_tiling_is_read_as_it_lies(read) -> None:
    def tiled(name: str, file: str, times: object, kind: str = "float") -> str:
        return node("tiledimage", name, kind, file=f'type="filename" value="{file}"', uvtiling=value(times, "vector2"))

    texture_set, svbrdf = read(
        tiled("r", "one.png", "4, 4") + tiled("c", "rgb.png", "4, 4", "color3"),
        specular_roughness=from_("r"), base_color=from_("c", "color3"),
    )  # fmt: skip
    close(rough(svbrdf), ONE)
    assert any("stays with the renderer" in note for note in texture_set.notes)
    texture_set, svbrdf = read(
        tiled("r", "one.png", "3, 2") + tiled("c", "rgb.png", "1, 1", "color3"),
        specular_roughness=from_("r"), base_color=from_("c", "color3"),
    )  # fmt: skip
    # Three times across, in full detail; twice down, enlarged to keep its proportions.
    assert svbrdf.size == (3 * SIZE, 3 * SIZE)
    np.testing.assert_allclose(rough(svbrdf)[:, :SIZE], rough(svbrdf)[:, SIZE : 2 * SIZE], rtol=1e-6)
    with pytest.raises(InputError, match="do not tile together"):
        read(
            tiled("r", "one.png", "1.5, 1.5") + tiled("c", "rgb.png", "1, 1", "color3"),
            specular_roughness=from_("r"), base_color=from_("c", "color3"),
        )  # fmt: skip


def test_a_whole_number_of_repeats_is_exact(read) -> None:
    nodes = image("c", "rgb.png", "color3", 'colorspace="lin_rec709"')
    nodes += node("tiledimage", "r", file='type="filename" value="one.png"', uvtiling=value("2, 2", "vector2"))
    _, svbrdf = read(nodes, specular_roughness=from_("r"), base_color=from_("c", "color3"))
    close(rough(svbrdf), np.tile(ONE, (2, 2)))


def test_gltf_pbr_and_usd_textures(read) -> None:
    file = 'type="filename" value="{}"'
    _, svbrdf = read(
        node("gltf_image", "orm", "vector3", file=file.format("rgb.png"))
        + node("separate3", "s", "multioutput", in_=from_("orm", "vector3"))
        + node("gltf_normalmap", "n", "vector3", file=file.format("n.png")),
        "gltf_pbr",
        roughness=from_("s", "float", "outy"), metallic=from_("s", "float", "outz"), normal=from_("n", "vector3"),
        occlusion=from_("s", "float", "outx"),
    )  # fmt: skip
    close(rough(svbrdf), RGB[..., 1])
    np.testing.assert_allclose(svbrdf.occlusion, RGB[..., 0], atol=1e-6)
    np.testing.assert_allclose(svbrdf.normal, NORMAL, atol=1e-4)
    bias = dict(scale=value("2, 2, 2, 1", "color4"), bias=value("-1, -1, -1, 0", "color4"))
    _, svbrdf = read(
        node("UsdUVTexture", "n", "multioutput", file=file.format("n.png"), **bias)
        + node("convert", "v", "vector3", in_=from_("n", "color3", "rgb"))
        + node("UsdUVTexture", "r", "multioutput", file=file.format("one.png")),
        "UsdPreviewSurface",
        normal=from_("v", "vector3"), roughness=from_("r", "float", "r"),
    )  # fmt: skip
    close(rough(svbrdf), ONE)
    np.testing.assert_allclose(svbrdf.normal, NORMAL, atol=1e-4)


def test_layers_and_other_materials_are_named_and_a_material_can_be_chosen(read, tmp_path: Path) -> None:
    second = node("standard_surface", "S2", "surfaceshader", specular_roughness=from_("two"))
    second += f'<surfacematerial name="Second" type="material">{inputs(surfaceshader=from_("S2", "surfaceshader"))}'
    texture_set, _ = read(
        image("one", "one.png") + image("two", "two.png"),
        rest=f"{second}</surfacematerial>",
        specular_roughness=from_("one"), coat=value(0.5), sheen=value(0.0), emission=from_("two"),
    )  # fmt: skip
    assert any("left out: coat, emission" in note for note in texture_set.notes)
    assert any("'M' is read" in note and "Second" in note for note in texture_set.notes)
    path = tmp_path / "doc.mtlx"
    assert materialx_material_names(path) == ["M", "Second"]
    close(rough(to_svbrdf(read_texture_set(path, material="Second"), min_roughness=0.001)), TWO)


def test_udim_and_a_missing_file_are_told(read) -> None:
    texture_set, _ = read(
        image("c", "rgb.png", "color3") + image("one", "one_&lt;UDIM&gt;.png"),
        base_color=from_("c", "color3"), specular_roughness=from_("one"),
    )  # fmt: skip
    assert any("stands for several tiles" in note for note in texture_set.notes)
    with pytest.raises(InputError, match=r"none\.png' does not exist"):
        read(image("one", "none.png"), specular_roughness=from_("one"))
