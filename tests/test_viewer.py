"""The page: what is packed comes back, and in a browser its lobe is the renderer's and it draws without an error."""

import base64
import json
import re
import shutil
import subprocess
import zlib
from importlib.resources import files

import numpy as np
import pytest
from container_support import node
from export_support import averaged_pyramid, random_svbrdf

from brdffit.cli import main
from brdffit.colour import decode_srgb
from brdffit.errors import InputError, OutputError, UnknownNameError
from brdffit.export.manifest import build_manifest
from brdffit.export.writing import write_baked
from brdffit.files.image_io import write_png
from brdffit.methods import Baked
from brdffit.models.microfacet import brdf
from brdffit.viewer import page as viewer_page
from brdffit.viewer.command import view
from brdffit.viewer.packing import LOG_STEPS, MOST_SPECULAR, NORMAL_STEPS, pack_environment, pack_levels, planes

FLAGS = [
    "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--virtual-time-budget=60000", "--dump-dom",
]  # fmt: skip


def in_browser(page, query=""):
    """What a page has put into its element `result`; skips where no Chromium is installed."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("Chromium is not installed")
    found = subprocess.run(
        [browser, *FLAGS, f"file://{page}{query}"], capture_output=True, text=True, check=False, timeout=280
    )
    text = re.search(r'<pre id="result"[^>]*>(.*?)</pre>', found.stdout, re.S)
    assert text, found.stdout[-500:] + found.stderr[-500:]
    return json.loads(text.group(1))


def bake_folder(folder, size=(32, 32), **extra):
    baked = Baked.of_lobes(averaged_pyramid(random_svbrdf(size, **extra)))
    write_baked(baked, folder, name="set", manifest=build_manifest(baked, name="set"))
    return folder


def unpacked(text, dtype, size, at):
    """A plane as the page reads it."""
    data = zlib.decompress(base64.b64decode(text))
    count, width = size[0] * size[1], np.dtype(dtype).itemsize
    apart = np.frombuffer(data[at : at + count * width], np.uint8).reshape(width, *size)
    differences = np.ascontiguousarray(np.moveaxis(apart, 0, -1)).view(dtype)[..., 0]
    return np.cumsum(differences, axis=1, dtype=dtype)


def test_planes_come_back():
    for dtype in ("<i2", "u1"):
        values = np.random.default_rng(0).integers(0, 256, (5, 7)).astype(dtype) * np.dtype(dtype).type(101)
        text = base64.b64encode(zlib.compress(planes(values)))
        np.testing.assert_array_equal(unpacked(text, dtype, (5, 7), 0), values)


def test_levels_are_packed_in_the_order_in_which_the_page_reads_them():
    svbrdf = random_svbrdf((6, 8))
    packed = pack_levels([svbrdf, random_svbrdf((3, 4))])
    assert packed["sizes"] == [[6, 8], [3, 4]]
    x = unpacked(packed["shapes"], "<i2", (6, 8), 0) / NORMAL_STEPS
    np.testing.assert_allclose(x, svbrdf.normal[..., 0], atol=0.51 / NORMAL_STEPS)
    mean = unpacked(packed["shapes"], "<i2", (6, 8), 2 * 48 * 2) / LOG_STEPS
    np.testing.assert_allclose(mean, svbrdf.log_roughness[..., :2].mean(axis=-1), atol=0.51 / LOG_STEPS)


def test_the_stored_scale_times_the_stored_colour_is_the_specular_scale():
    svbrdf = random_svbrdf((6, 8))
    grey = np.linspace(1.0, 1.3, 48).reshape(6, 8, 1)
    svbrdf = svbrdf.replace(specular=(grey * [1.0, 0.5, 0.25]).astype(np.float32))
    packed = pack_levels([svbrdf])["colours"]
    codes = np.stack([unpacked(packed, "u1", (6, 8), channel * 48) for channel in range(4)], axis=-1)
    shown = decode_srgb(codes[..., :3] / 255.0) * codes[..., 3:] * (MOST_SPECULAR / 255.0)
    # Half a code of sRGB is at most 1.2 / 1.055 / 255 of the scale; over many texels it cancels.
    np.testing.assert_allclose(shown, svbrdf.specular, atol=0.0046 * 1.32)
    assert shown.mean() == pytest.approx(svbrdf.specular.mean(), rel=1e-3)


def test_an_environment_keeps_its_range():
    pixels = np.random.default_rng(1).lognormal(0, 3, (4, 8, 3)).astype(np.float32)
    packed = pack_environment(pixels)
    data = [unpacked(packed["data"], "u1", (4, 8), 32 * k).astype(float) for k in range(4)]
    seen = np.stack(data[:3], axis=-1) / 255.0 * np.exp2(data[3] - 128)[..., None]
    assert (np.abs(seen - pixels) <= 0.004 * pixels.max(axis=-1, keepdims=True)).all()


def test_a_page_of_a_baked_folder(tmp_path):
    folder = bake_folder(tmp_path / "</script>")
    page = view(folder, tmp_path / "view.html").read_text(encoding="utf-8")
    assert "{{" not in page and "{%" not in page
    data = json.loads(re.search(r'<script id="data"[^>]*>(.*?)</script>', page, re.S).group(1))
    assert [method["name"] for method in data["methods"]] == ["naive"]
    assert data["source"]["sizes"] == [[32, 32]]
    assert "http" not in page  # nothing is loaded from elsewhere


def test_what_cannot_be_shown_is_told(tmp_path):
    folder = bake_folder(tmp_path / "set", model="beckmann")
    with pytest.raises(InputError, match="the lobe beckmann"):
        view(folder, tmp_path / "view.html")
    with pytest.raises(UnknownNameError, match="did you mean 'lean'"):
        view(folder, tmp_path / "view.html", methods=["leann"])
    (tmp_path / "set" / "manifest.json").write_text("{}")
    with pytest.raises(InputError, match="no manifest"):
        view(folder, tmp_path / "view.html")
    assert not (tmp_path / "view.html").exists()


def test_the_middle_of_a_large_set_is_shown(monkeypatch):
    monkeypatch.setattr(viewer_page, "MOST_TEXELS", 4)
    base = random_svbrdf((6, 10))
    np.testing.assert_array_equal(viewer_page.middle(base).normal, base.normal[1:5, 3:7])


def test_the_lobe_of_the_page_is_the_renderer_s(tmp_path):
    """4096 random lobes and directions, in the browser and by brdffit.models.microfacet: equal to 1e-5."""
    random, count = np.random.default_rng(0), 4096

    def hemisphere(lowest):
        z, angle = random.uniform(lowest, 1, count), random.uniform(0, 2 * np.pi, count)
        r = np.sqrt(1 - z * z)
        return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=-1).astype(np.float32)

    light, seen_from, normal = hemisphere(0.02), hemisphere(0.02), hemisphere(0.6)
    major = 10 ** random.uniform(-4, -0.3, count)
    minor, angle = major * 10 ** random.uniform(-2, 0, count), random.uniform(0, np.pi, count)
    c, s = np.cos(angle), np.sin(angle)
    tensor = np.stack([major * c * c + minor * s * s, major * s * s + minor * c * c, (major - minor) * c * s], axis=-1)
    tensor = tensor.astype(np.float32)
    specular, diffuse = random.uniform(0, 1.2, (count, 3)), random.uniform(0, 1, (count, 3))
    specular, diffuse = specular.astype(np.float32), diffuse.astype(np.float32)
    wanted = brdf(normal, tensor, specular, diffuse, seen_from, light)

    lobe = (files("brdffit.viewer") / "templates" / "lobe.glsl").read_text(encoding="utf-8")
    stored = np.zeros((count, 6, 4), np.float32)
    for place, values in enumerate((light, seen_from, normal, tensor, specular, diffuse)):
        stored[:, place, :3] = values
    page = tmp_path / "lobe.html"
    text = _LOBE_PAGE.replace("LOBE", lobe).replace("DATA", base64.b64encode(stored.tobytes()).decode())
    page.write_text(text, encoding="utf-8")
    found = np.array(in_browser(page), np.float64).reshape(count, 4)[:, :3]
    assert ((found == 0) == (wanted == 0)).all(axis=-1).mean() > 0.999
    difference = np.abs(found - wanted) / np.maximum(np.abs(wanted), 1e-3)
    assert np.quantile(difference, 0.999) < 1e-5


_LOBE_PAGE = """<!doctype html><pre id="result"></pre><script>
const gl=document.createElement('canvas').getContext('webgl2');gl.getExtension('EXT_color_buffer_float');
const data=new Float32Array(Uint8Array.from(atob("DATA"),c=>c.charCodeAt(0)).buffer),p=gl.createProgram();
function shader(type,text){const s=gl.createShader(type);gl.shaderSource(s,text);gl.compileShader(s);
 if(!gl.getShaderParameter(s,gl.COMPILE_STATUS))throw Error(gl.getShaderInfoLog(s));gl.attachShader(p,s)}
shader(gl.VERTEX_SHADER,`#version 300 es
void main(){vec2 p=vec2((gl_VertexID<<1)&2,gl_VertexID&2);gl_Position=vec4(p*2.-1.,0,1);}`);
shader(gl.FRAGMENT_SHADER,`#version 300 es
precision highp float;uniform highp sampler2D t;out vec4 c;const float PI=3.14159265;
LOBE
vec3 get(int i,int k){int j=i*6+k;return texelFetch(t,ivec2(j%256,j/256),0).xyz;}
void main(){int i=int(gl_FragCoord.y)*64+int(gl_FragCoord.x);
 Texel x=Texel(get(i,2),get(i,3),get(i,4),get(i,5));c=vec4(brdf(get(i,0),get(i,1),x),1);}`);
gl.linkProgram(p);gl.useProgram(p);
function texture(w,h){const t=gl.createTexture();gl.bindTexture(gl.TEXTURE_2D,t);
 gl.texStorage2D(gl.TEXTURE_2D,1,gl.RGBA32F,w,h);
 for(const f of [gl.TEXTURE_MIN_FILTER,gl.TEXTURE_MAG_FILTER])gl.texParameteri(gl.TEXTURE_2D,f,gl.NEAREST);return t}
const out=texture(64,64),frame=gl.createFramebuffer();gl.bindFramebuffer(gl.FRAMEBUFFER,frame);
gl.framebufferTexture2D(gl.FRAMEBUFFER,gl.COLOR_ATTACHMENT0,gl.TEXTURE_2D,out,0);
texture(256,96);gl.texSubImage2D(gl.TEXTURE_2D,0,0,0,256,96,gl.RGBA,gl.FLOAT,data);
gl.viewport(0,0,64,64);gl.drawArrays(gl.TRIANGLES,0,3);const read=new Float32Array(4096*4);
gl.readPixels(0,0,64,64,gl.RGBA,gl.FLOAT,read);
document.getElementById('result').textContent=JSON.stringify(Array.from(read));
</script>"""


def test_the_command_writes_a_page_that_a_browser_draws(tmp_path):
    """A folder whose levels are averages: the panel of the browser's own averages looks the same; no error of WebGL."""
    folder = bake_folder(tmp_path / "set", size=(64, 64), slope=0.3, lowest=0.3)
    page = tmp_path / "view.html"
    main(["view", str(folder), "-o", str(page)], standalone_mode=False)
    found = in_browser(page, "?test=1&frames=4&width=300")
    assert found["error"] == 0
    assert found["names"] == ["averaged", "naive", "reference"]
    assert all(np.isfinite(found["rms"])) and found["rms"][-1] == 0
    # Both panels average the same maps; the browser and we do it alike.
    assert abs(found["rms"][0] - found["rms"][1]) < 2
    assert 0.3 < min(found["energy"]) <= max(found["energy"]) < 3


def test_the_page_answers_to_mouse_keys_and_fingers(tmp_path):
    if shutil.which("chromium") is None:
        pytest.skip("Chromium is not installed")
    page = view(bake_folder(tmp_path / "set", slope=0.3, lowest=0.4), tmp_path / "view.html")
    result = node("viewer.mjs", page)
    assert result.returncode == 0, result.stderr
    seen = json.loads(result.stdout)
    assert seen["console"] == []

    def change(after, before, name):
        return seen[after][name] - seen[before][name]

    assert change("drag", "start", "yaw") == pytest.approx(-0.32, abs=0.02)
    assert change("drag", "start", "pitch") > 0
    assert change("wheel", "drag", "distance") == pytest.approx(0.1, abs=0.002)
    assert change("left", "wheel", "yaw") == pytest.approx(0.05, abs=1e-6)
    assert change("nearer", "left", "distance") == pytest.approx(-0.02, abs=0.002)
    assert change("level", "nearer", "level") == 1
    assert (seen["difference"]["show"], seen["wipe"]["show"], seen["moving"]["move"]) == (1, 2, True)
    assert change("finger", "before", "yaw") == pytest.approx(-0.24, abs=0.05)
    # Fingers that part come nearer, and none is left behind.
    assert change("pinch", "finger", "distance") < -0.05
    assert seen["pinch"]["pointers"] == 0
    assert "RMS off, energy" in seen["figures"]


def test_an_environment_file_lights_the_page(tmp_path):
    """Light of one colour from all around: a white furnace, in every panel as bright as the reference."""
    sky = tmp_path / "sky.png"
    write_png(sky, np.full((16, 32, 3), 128, np.uint8))
    folder = bake_folder(tmp_path / "set", size=(16, 16), slope=0.2, lowest=0.4)
    page = view(folder, tmp_path / "view.html", environment=str(sky))
    found = in_browser(page, "?test=1&frames=4&width=200&light=1")
    assert found["error"] == 0
    assert all(abs(energy - 1.0) < 0.1 for energy in found["energy"])
    write_png(sky, np.full((16, 32, 1), 128, np.uint8))
    with pytest.raises(InputError, match="expected an RGB picture of light"):
        view(folder, tmp_path / "view.html", environment=str(sky))


def test_an_output_that_is_a_folder_is_told_before_the_bake(tmp_path):
    folder = bake_folder(tmp_path / "set")
    with pytest.raises(OutputError, match="is a folder, expected a file"):
        view(folder, tmp_path)


def test_a_bake_without_lobes_is_told(tmp_path):
    folder = bake_folder(tmp_path / "set")
    for name in ("normal", "roughness"):
        (folder / f"{name}.exr").unlink()
    with pytest.raises(InputError, match="holds no levels of lobes"):
        view(folder, tmp_path / "view.html")
