"""Scene files: what is left out has a default, and each mistake is told with its field."""

import re
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner

from brdffit.cli import main
from brdffit.errors import InputError, OutputError
from brdffit.planning.description import PROCEDURAL, Camera, SceneFile, Surface, parse_scene, read_scene
from brdffit.planning.effects import NAMES
from brdffit.planning.reach import reached_levels
from brdffit.planning.template import template, write_template
from brdffit.textures.procedural import SETS, make_set

SCENES = Path(__file__).parent.parent / "data" / "scenes"
SHIPPED = ("close-up", "panel", "pebbles-far", "pebbles-near", "terrain", "wall")
SURFACE = '[[surfaces]]\nset = "oak"\n'


@pytest.fixture
def folder(tmp_path):
    """A folder with two sets, as far as a scene file looks at them, and a picture of a sky."""
    for name in ("oak", "walls/brick"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "sky.hdr").touch()
    (tmp_path / "jar.gltf").touch()
    return tmp_path


def read(folder, text):
    (folder / "scene.toml").write_text(text, encoding="utf-8")
    return read_scene(folder / "scene.toml")


def test_one_surface_is_a_scene():
    scene = parse_scene(SURFACE, "scene.toml")
    assert scene == SceneFile(surfaces=(Surface(set="oak"),))
    assert scene.cameras == (Camera(),)
    assert all(scene.switch(effect) == "auto" for effect in NAMES)


def test_the_template_says_the_defaults():
    assert parse_scene(template(), "scene.toml") == SceneFile(surfaces=(Surface(set="textures"),))


def test_the_template_names_every_field():
    """With every comment that is a field made one: nothing is left out, and what is shown can be said."""
    bare = re.sub(r"(?m)^# (?=\[\[lights|\w+ = )", "", template())
    data = tomllib.loads(bare)
    assert data.keys() == set(SceneFile.__struct_fields__)
    assert data["surfaces"][0].keys() | {"texel_size"} == set(Surface.__struct_fields__)
    assert data["cameras"][0].keys() == set(Camera.__struct_fields__)
    assert data["lights"][0].keys() == {"direction", "irradiance", "size"}
    assert list(data["effects"]) == list(NAMES)
    assert parse_scene(bare, "scene.toml").budget.seconds == 60.0


def test_what_is_said_is_read(folder):
    scene = read(
        folder,
        """
        environment = "sky.hdr"
        effects = { anisotropy = "off", refinement = "on" }
        [[surfaces]]
        set = "walls/brick"
        texel_size = 0.002
        [[surfaces]]
        set = "jar.gltf"
        radius = 0.2
        [[cameras]]
        distance = 3
        tilt = 45
        [[cameras]]
        name = "far"
        distance = [10, 20]
        [[lights]]
        direction = [0, 0, 2]
        irradiance = 3
        """,
    )
    assert [Path(each.set) for each in scene.surfaces] == [folder / "walls" / "brick", folder / "jar.gltf"]
    assert scene.environment == str(folder / "sky.hdr")
    assert [each.name for each in scene.surfaces] == ["brick", "jar"]
    assert [each.name for each in scene.cameras] == ["camera 1", "far"]
    assert scene.cameras[0].distances == (3.0, 3.0) and scene.cameras[0].tilts == (45.0, 45.0)
    assert scene.cameras[1].distances == (10.0, 20.0) and scene.cameras[1].tilts == Camera().tilts
    assert scene.lights[0].rgb == (3.0, 3.0, 3.0)
    assert [scene.switch(each) for each in ("anisotropy", "refinement", "normals")] == ["off", "on", "auto"]
    assert scene.surfaces[0].texel((512, 256)) == 0.002
    assert scene.surfaces[1].texel((512, 256)) == 1.0 / 256


def test_without_a_light_there_is_the_environment_that_ships(folder):
    assert read(folder, SURFACE).environment == PROCEDURAL
    assert read(folder, SURFACE + "[[lights]]\ndirection = [0, 0, 1]\n").environment is None


MISTAKES = {
    "": ("", "`surfaces` is missing"),
    "surfaces = []": ("surfaces", "a list of length >= 1, found []"),
    "model = 'gxx'\n" + SURFACE: ("model", "did you mean 'ggx'"),
    "quality = 'best'\n" + SURFACE: ("quality", "found 'best', expected one of draft, standard, fine"),
    "environment = 'night.hdr'\n" + SURFACE: ("environment", "there is nothing at"),
    "enviroment = 'sky.hdr'\n" + SURFACE: ("", "no field 'enviroment' (did you mean 'environment'?)"),
    "[[surfaces]]\nset = 'elm'": ("surfaces[0].set", "there is nothing at"),
    "[[surfaces]]\nset = ''": ("surfaces[0]", "`set` is empty"),
    "[[surfaces]]\nname = 'x'": ("surfaces[0]", "`set` is missing"),
    SURFACE + "name = 'a/b'": ("surfaces[0]", "one that a folder can have"),
    SURFACE + SURFACE: ("surfaces[1].name", "'oak' is the name of surfaces[0] too"),
    SURFACE + "radius = 0": ("surfaces[0].radius", "a number > 0.0, found 0"),
    SURFACE + "radius = nan": ("surfaces[0].radius", "a number > 0.0, found nan"),
    SURFACE + "radius = inf": ("surfaces[0].radius", "found inf"),
    SURFACE + "wrap = 'mirror'": ("surfaces[0].wrap", "found 'mirror', expected one of tile, clamp"),
    SURFACE + "texel_size = 1\nrepetitions = 2": ("surfaces[0]", "`texel_size` and `repetitions` are both given"),
    SURFACE + "[[cameras]]\ndistnace = 2": ("cameras[0]", "no field 'distnace' (did you mean 'distance'?)"),
    SURFACE + "[[cameras]]\ndistance = -3": ("cameras[0].distance", "a number > 0.0, found -3"),
    SURFACE + "[[cameras]]\ndistance = 'far'": ("cameras[0].distance", "a number or a list, found 'far'"),
    SURFACE + "[[cameras]]\ndistance = [5, 2]": ("cameras[0]", "`distance` goes from 5 to 2"),
    SURFACE + "[[cameras]]\ndistance = [1, 2, 3]": ("cameras[0].distance", "found [1, 2, 3]"),
    SURFACE + "[[cameras]]\ntilt = [0, 90]": ("cameras[0].tilt[1]", "a number < 90.0, found 90"),
    SURFACE + "[[cameras]]\n[[cameras]]\nresolution = [0, 9]": ("cameras[1].resolution[0]", "a whole number >= 1"),
    SURFACE + "[[cameras]]\nfield_of_view = 180": ("cameras[0].field_of_view", "a number < 180.0, found 180"),
    SURFACE + "[[lights]]\nsize = 2": ("lights[0]", "`direction` is missing"),
    SURFACE + "[[lights]]\ndirection = [0, 0, 0]": ("lights[0]", "`direction` is zero"),
    SURFACE + "[[lights]]\ndirection = [0, 0, 1]\nirradiance = [1, 2, -1]": ("lights[0].irradiance[2]", "found -1"),
    SURFACE + "[target]\npreset = 'unrael'": ("target.preset", "did you mean 'unreal'"),
    SURFACE + "[target]\nbits = 12": ("target.bits", "found 12, expected one of 8, 16"),
    SURFACE + "[budget]\ndb = 0": ("budget.db", "a number > 0.0, found 0"),
    SURFACE + "[effects]\nanisotropi = 'off'": ("effects", "no effect 'anisotropi' (did you mean 'anisotropy'?)"),
    SURFACE + "[effects]\nnormal = 'on'\nanisotropy = 'no'": ("effects.anisotropy", "found 'no', expected one of auto"),
}


@pytest.mark.parametrize("text", MISTAKES, ids=lambda text: MISTAKES[text][0] or text[:12] or "nothing")
def test_a_mistake_is_told_with_its_field_in_one_sentence(folder, text):
    where, what = MISTAKES[text]
    with pytest.raises(InputError) as told:
        read(folder, text)
    sentence = str(told.value)
    assert sentence.startswith(
        f"The scene '{folder / 'scene.toml'}' is not as expected{', at ' * bool(where)}{where}: "
    )
    assert what in sentence
    assert sentence.endswith(".") and "\n" not in sentence and "$" not in sentence


def test_what_is_no_toml_is_told_with_its_line(folder):
    with pytest.raises(InputError, match=r"scene\.toml' is not TOML: .*\(at line 2, column \d\)"):
        read(folder, "# a scene\nmodel =\n")
    with pytest.raises(InputError, match="cannot be read: No such file"):
        read_scene(folder / "none.toml")
    (folder / "scene.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="cannot be read: .*utf-8"):
        read_scene(folder / "scene.toml")


def test_a_scene_is_started_from_the_sets_below(tmp_path, monkeypatch):
    """Sets of one name in two places get names that differ; the file reads as it is."""
    for place in ("a/oak", "b/oak", "b/pine's"):
        make_set("plaster-wall", tmp_path / place, size=4)
    monkeypatch.chdir(tmp_path)
    run = lambda *arguments: CliRunner().invoke(main, ["scene", "init", *arguments])  # noqa: E731
    (tmp_path / "file").touch()
    told = run("file/scene.toml")
    assert told.exit_code == 1 and "'file/scene.toml' could not be written: " in told.stderr
    told = run()
    assert told.exit_code == 0 and "scene.toml: 3 texture sets found." in told.stdout
    scene = read_scene("scene.toml")
    assert [each.set for each in scene.surfaces] == [str(tmp_path / place) for place in ("a/oak", "b/oak", "b/pine's")]
    assert [each.name for each in scene.surfaces] == ["a.oak", "b.oak", "pine's"]
    assert sorted(path.name for path in tmp_path.iterdir() if path.name.startswith(".")) == []


def test_a_scene_is_not_replaced_unasked(folder):
    path = folder / "scene.toml"
    path.write_text("mine", encoding="utf-8")
    with pytest.raises(OutputError, match=r"scene\.toml' is there already, .* --force"):
        write_template(path)
    assert path.read_text(encoding="utf-8") == "mine"
    write_template(path, [folder / "walls" / "brick"], force=True)
    assert read_scene(path).surfaces[0].set == str(folder / "walls" / "brick")


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_scene_reads(name, tmp_path):
    """Beside the sets that `make data` makes; each one sees a shipped set, and levels of it."""
    for each in SETS:
        (tmp_path / "sets" / each).mkdir(parents=True)
    (tmp_path / "scenes").mkdir()
    path = tmp_path / "scenes" / f"{name}.toml"
    path.write_bytes((SCENES / path.name).read_bytes())
    scene = read_scene(path)
    reach = [reached_levels(scene, surface, (512, 512)) for surface in scene.surfaces]
    assert all(each.last > 0 for each in reach)
    assert all((each.first > 0) == (name in ("terrain", "pebbles-far")) for each in reach)


def test_the_shipped_scenes_are_all_there():
    assert sorted(path.stem for path in SCENES.glob("*.toml")) == list(SHIPPED)


def test_a_scene_may_name_the_engine_whose_probe_lights_it():
    text = 'probe = "unity"\n[[surfaces]]\nset = "oak"\n'
    assert parse_scene(text, "scene.toml").probe == "unity"
    with pytest.raises(InputError, match="no engine 'unitty'.*unity"):
        parse_scene(text.replace("unity", "unitty"), "scene.toml")
