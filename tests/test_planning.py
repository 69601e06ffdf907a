"""Laws of plans: what is dropped loses no more than they say, the user's word wins, and nothing hangs on chance."""

import dataclasses
import json
from functools import cache

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from brdffit.cli import main
from brdffit.fitting.method import NonlinearFit
from brdffit.fitting.options import FitOptions
from brdffit.methods import Baked
from brdffit.planning.description import parse_scene, read_scene
from brdffit.planning.effects import BY_NAME, EFFECTS, setup
from brdffit.planning.facts import Fact, settled
from brdffit.planning.plan import Question, faster, verdicts
from brdffit.planning.run import plan_scene
from brdffit.planning.surface import SurfaceWork
from brdffit.planning.trial import Errors, Loss, loss, snr_db
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.procedural import make_set

SCENE = """
[[surfaces]]
set = "{set}"
repetitions = 8
[[cameras]]
distance = [0.5, 1.5]
resolution = [800, 600]
field_of_view = 30
[[lights]]
direction = [-0.4, 0.5, 1.0]
size = 2
[[lights]]
direction = [0.6, 0.1, 0.8]
irradiance = [0.5, 0.6, 0.8]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three small sets, each with a scene of its own name."""
    folder = tmp_path_factory.mktemp("scenes")
    for name in ("hammered-metal", "glossy-tiles", "plaster-wall"):
        make_set(name, folder / name, size=64)
        (folder / f"{name}.toml").write_text(SCENE.format(set=name), encoding="utf-8")
    return folder


SCENES = ["glossy-tiles", "hammered-metal", "plaster-wall"]


@pytest.fixture(scope="module")
def plan_of(folder):
    """A function that returns the plan of a scene by its name, seed 0; each is made once."""
    return cache(lambda name: plan_scene(read_scene(folder / f"{name}.toml"), name).surfaces[0])


def question(losses, asked=None, facts=None, budget=0.1):
    return Question(
        losses={n: Loss(*v) for n, v in losses.items()}, asked=asked or {}, facts=facts or {}, budget=budget
    )


def additive(question):
    """Losses that add up, and what was asked for along the way."""
    return lambda off: Loss(sum(max(question.losses[n].db, 0.0) for n in off if n in question.losses), 0.0)


def test_the_smallest_losses_go_first_within_the_budget():
    asked = question({"horizon": (0.0, 0.01), "coupling": (0.03, 0.0), "anisotropy": (0.06, 0.0), "scale": (0.5, 0.0)})
    off, lost = verdicts(asked, additive(asked))
    assert off == {"horizon", "coupling"} and lost.at_most <= 0.1
    assert verdicts(msgspec.structs.replace(asked, budget=1.0), additive(asked))[0] == set(asked.losses)


def test_what_is_too_much_together_comes_back():
    asked = question({"colour": (0.01, 0.0), "coupling": (0.02, 0.0), "anisotropy": (0.03, 0.0)})
    off, lost = verdicts(asked, lambda off: Loss(0.2 if {"colour", "anisotropy"} <= off else 0.05, 0.0))
    assert off == {"colour", "coupling"} and lost.db == 0.05


def test_the_users_word_wins_over_measurements_and_facts():
    facts = {"anisotropy": Fact(False, "", ""), "coupling": Fact(True, "", "")}
    words = {"anisotropy": "on", "coupling": "off", "scale": "off", "colour": "on"}
    asked = question({"scale": (9.0, 0.0), "colour": (0.0, 0.0), "horizon": (0.0, 0.0)}, words, facts)
    off, _ = verdicts(asked, lambda off: Loss(9.0, 0.0))
    assert {"coupling", "scale"} <= off and not {"anisotropy", "colour"} & off


def test_the_judges_effects_stand_by_themselves_and_passes_must_pay():
    asked = question(
        {"masking": (0.09, 0.0), "fresnel": (0.09, 0.0), "environment": (0.2, 0.0), "horizon": (0.09, 0.0)}
    )
    assert verdicts(asked, additive(question({"horizon": (0.09, 0.0)})))[0] == {"masking", "fresnel", "horizon"}
    for measured, on in (((2.0, 0.4), True), ((2.0, 0.6), False), ((0.9, 0.0), False)):
        asked = question({"refinement": measured})
        assert ("refinement" not in verdicts(asked, lambda off: Loss(0.0, 0.0))[0]) == on


def test_a_budget_of_seconds_takes_the_least_db_a_second():
    asked = question({"scale": (1.0, 0.0), "anisotropy": (1.0, 0.0), "colour": (3.0, 0.0), "level_0": (1.0, 0.0)})
    costs = {"scale": 1.0, "anisotropy": 2.0, "colour": 4.0, "level_0": -1.0}
    assert faster(asked, set(), costs, 2.5) == {"anisotropy", "colour"}
    assert faster(asked, set(), costs, 99.0) == {"anisotropy", "colour", "scale"}
    assert faster(asked, {"scale"}, costs, 0.0) == {"scale"}


def test_effects_are_the_defaults_but_for_the_extra_pass():
    usual = FitOptions()
    assert setup(usual, {effect.name for effect in EFFECTS if effect.extra}).options == usual
    assert setup(usual).options == dataclasses.replace(usual, refine=True)


@pytest.mark.parametrize("name", BY_NAME)
def test_an_effect_changes_what_is_its_own(name):
    on, off = setup(FitOptions()), setup(FitOptions(), {name})
    changed = {n for n, value in dataclasses.asdict(off.options).items() if value != getattr(on.options, n)}
    assert changed == set(BY_NAME[name].off)
    # What is traced changes neither a bake nor the judge of maps.
    assert (off == on) == BY_NAME[name].traced
    assert bool(changed) != BY_NAME[name].judge


def test_losses_are_those_of_pooled_errors():
    """A version with ten times the error, where neither is below what is seen, loses 10 dB; and nothing to itself."""
    random = np.random.default_rng(0)
    one = random.random((2, 100)) * 0.1 + 0.01
    found = Errors([np.stack([each, 10.0 * each]) for each in one], [np.ones(100), np.ones(100)])
    assert loss(found, 1).db == pytest.approx(10.0, abs=0.02) and loss(found, 0) == Loss(0.0, 0.0)
    assert 0.0 < loss(found, 1).error < 0.1, "in step: hardly any noise"
    apart = Errors([np.stack([a, 10.0 * b]) for a, b in zip(one, one[:, ::-1], strict=True)], found.reference)
    assert loss(apart, 1).error > loss(found, 1).error
    unseen = Errors([np.zeros((1, 100))], [np.ones(100)])
    assert snr_db(unseen, 0) == pytest.approx(40.0)


def test_facts_follow_target_set_and_reach(folder):
    scene = parse_scene(SCENE.format(set="x") + '[target]\npreset = "unity"\n', "x")
    base = to_svbrdf(
        SurfaceWork(
            read_scene(folder / "glossy-tiles.toml"), read_scene(folder / "glossy-tiles.toml").surfaces[0], 0
        ).texture_set
    )
    found = settled(scene, base, (2, 4))
    assert {name for name, fact in found.items() if not fact.on} >= {"scale", "level_0", "environment"}
    grey = base.replace(specular=np.repeat(base.specular[..., :1], 3, axis=2), diffuse=np.zeros_like(base.diffuse))
    found = settled(parse_scene(SCENE.format(set="x"), "x"), grey, (0, 4))
    assert "colour" in found and "coupling" in found and "level_0" not in found and "scale" not in found
    even = base.replace(specular=np.full_like(base.specular, 0.04))
    assert "correlation" in settled(scene, even, (0, 4))


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_what_is_dropped_loses_no_more_than_the_plan_says(folder, plan_of, name):
    """On texels and directions that the plan has not seen, within the noise of those."""
    scene, planned = read_scene(folder / f"{name}.toml"), plan_of(name)
    work = SurfaceWork(scene, scene.surfaces[0], seed=7)
    base = to_svbrdf(work.texture_set, without=planned.unread)
    pyramid = NonlinearFit().bake_lobes(base, FitOptions(**planned.options))
    _, lost = work.outcome(planned, Baked.of_lobes(pyramid), 0.0)
    assert lost.db <= planned.lost_at_most_db + 3.0 * lost.error
    assert planned.lost_at_most_db <= scene.budget.db


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_no_effect_does_harm(plan_of, name):
    """With an effect the SNR is no lower than without, but for noise."""
    for row in plan_of(name).effects:
        if row.contributes_db is not None and row.name != "refinement":
            assert row.contributes_db >= -3.0 * row.uncertain_db - 0.02, row.name


@pytest.mark.slow
def test_a_plan_depends_on_its_seed_alone_and_hardly_on_that(folder, plan_of):
    def verdicts_of(planned):
        return [(row.name, row.on, row.why, row.contributes_db) for row in planned.effects], planned.options

    scene = read_scene(folder / "glossy-tiles.toml")
    again = plan_scene(scene, "again", threads=1).surfaces[0]
    assert verdicts_of(again) == verdicts_of(plan_of("glossy-tiles"))
    other = plan_scene(scene, "other", seed=1).surfaces[0]
    budget = scene.budget.db
    for one, two in zip(again.effects, other.effects, strict=True):
        # Where a loss is about as large as what is left of the budget, either verdict is right.
        clear = (
            one.contributes_db is None or abs(one.contributes_db - 0.5 * budget) > 0.5 * budget + 2 * one.uncertain_db
        )
        assert one.on == two.on or not clear, one.name


@pytest.mark.slow
def test_scenes_that_differ_get_plans_that_differ(plan_of):
    assert len({plan_of(name).off for name in ("glossy-tiles", "hammered-metal", "plaster-wall")}) == 3


def test_a_scene_is_planned_and_baked_by_the_command_line(folder, tmp_path):
    scene = folder / "metal.toml"
    text = SCENE.format(set="hammered-metal") + '[effects]\nnormals = "off"\nrefinement = "off"\n'
    scene.write_text(text, encoding="utf-8")
    run = lambda *arguments: CliRunner().invoke(main, [str(each) for each in arguments])  # noqa: E731
    told = run("plan", scene, "-o", tmp_path / "plan.json")
    assert told.exit_code == 0 and "the scene file says so" in told.stdout, told.stderr
    planned = json.loads((tmp_path / "plan.json").read_text())["surfaces"][0]
    assert planned["unread"] == ["normal", "height"]
    told = run("bake", "--scene", scene, "-o", tmp_path / "out", "--no-preview")
    assert told.exit_code == 0, told.stderr
    manifest = json.loads((tmp_path / "out" / "hammered-metal" / "manifest.json").read_text())
    assert {each["role"] for each in manifest["inputs"]} == {"base_color", "metallic", "roughness"}
    assert set(manifest["plan"]["measured"]) == {"snr_db", "lost_db", "uncertain_db"}
    assert manifest["volatile"]["plan_seconds"]["measured"] > 0.0
    first, last = manifest["plan"]["reach"]
    for level in manifest["levels"]:
        assert ("not reached" in level["statuses"]) == (not first <= level["level"] <= last)
    for wrong in (["--scene", scene, "--quality", "fine"], ["--scene", scene, folder / "glossy-tiles"], []):
        assert run("bake", *wrong, "-o", tmp_path / "out").exit_code == 2


@pytest.mark.slow
def test_a_comparison_simulates_what_the_plan_has_on(folder, tmp_path):
    told = CliRunner().invoke(
        main, ["compare", "--scene", str(folder / "plaster-wall.toml"), "-o", str(tmp_path / "r"), "--quick",
               "--methods", "bfgs,naive"],
    )  # fmt: skip
    assert told.exit_code == 0, told.stderr
    records = json.loads((tmp_path / "r" / "records.json").read_text())
    (result,) = records["sets"]
    assert {view["lighting"] for view in result["views"]} == {"small lights"}, "there is no environment in the scene"
    first, last = map(int, records["options"]["reach"].split(","))
    assert all(first <= view["level"] <= last for view in result["views"] if view.get("level") is not None)
