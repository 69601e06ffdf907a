"""The report: records survive the disk, means are means, and the page asks for nothing but itself."""

import json
import math
import re
import shutil
import subprocess
from html.parser import HTMLParser

import msgspec
import numpy as np
import pytest
from report_support import PICTURE_SNR, comparison

from brdffit.errors import InputError, OutputError
from brdffit.files.image_io import write_png
from brdffit.report import histograms, page, plots, records, side_by_side, summary
from brdffit.report.writing import check_report_folder, read_report, write_report

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.fixture(scope="module")
def made():
    return comparison()


@pytest.fixture(scope="module")
def html(made):
    return page.render_page(*made)


def test_records_survive_the_disk(made, tmp_path):
    path = tmp_path / "records.json"
    path.write_bytes(records.to_json(made[0]))
    assert records.read_records(path) == made[0]


def test_packed_arrays_survive():
    values = np.array([[0.0, 0.5], [1.0, 1e9]])
    found = records.unpack(records.pack(values), (2, 2))
    assert found.tolist() == [[0.0, 0.5], [1.0, 65504.0]]


@pytest.mark.parametrize(("value", "expected"), [(math.inf, 99.0), (-math.inf, -99.0), (math.nan, -99.0), (12.5, 12.5)])
def test_decibels_are_capped(value, expected):
    assert records.capped(value) == expected


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("{", "is no record of a comparison"),
        ("[]", "is no record of a comparison"),
        ('{"format": 99}', "is of format 99, expected 1"),
        ('{"format": 1, "sets": []}', "is no record of a comparison"),
    ],
)
def test_what_is_no_record_is_told_in_a_sentence(tmp_path, text, sentence):
    path = tmp_path / "records.json"
    path.write_text(text)
    with pytest.raises(InputError, match=sentence) as caught:
        records.read_records(path)
    assert str(caught.value).endswith(".") and "records.json" in str(caught.value)


def test_missing_records(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        records.read_records(tmp_path / "none.json")


def test_means_by_hand(made):
    rows = {row.method: row for row in summary.summary(made[0])}
    lit = [(cell.value, cell.sets) for cell in rows["bfgs"].cells[3:]]
    assert lit == [(21.0, 2), (13.0, 2), (11.0, 2), (22.0, 2), (14.0, 2), (12.0, 2)]
    # Pairs: 20 and 20 at near and mid; not measured at far.
    assert [cell.value for cell in rows["bfgs"].cells[:3]] == [20.0, 20.0, None]
    # The second method of the hand-made sets has 1 dB more of the half-angle figure, at every level.
    assert rows["naive"].gain == 0.0 and rows["bfgs"].gain == pytest.approx(-1.0)
    assert rows["bfgs"].seconds == 1.0


def test_a_method_that_lacks_a_set_is_first_nowhere(made):
    rows = {row.method: row for row in summary.summary(made[0])}
    assert rows["height"].cells[3].value == 30.0 and rows["height"].cells[3].sets == 1
    assert not any(cell.best for cell in rows["height"].cells)
    assert all(cell.best for cell in rows["bfgs"].cells[3:])


def test_nothing_is_first_where_all_is_wrong(made):
    worst = msgspec.json.decode(msgspec.json.encode(made[0]), type=records.Comparison)
    for result in worst.sets:
        for shot in result.views[0].shots:
            shot.figures.snr_db = -records.MOST_DB
    assert not any(row.cells[3].best for row in summary.summary(worst))


def test_views_are_counted_by_hand(made):
    """Over all stills of two sets: who is first how often, where each is worst, and how far energy strays."""
    comparison = msgspec.json.decode(msgspec.json.encode(made[0]), type=records.Comparison)
    first = comparison.sets[0].views[0]
    by_name = {shot.method: shot.figures for shot in first.shots}
    for figures in by_name.values():
        figures.flip_ldr, figures.ssim, figures.energy_kept = 0.2, 0.5, 1.0
    by_name["naive"].snr_db, by_name["naive"].flip_ldr, by_name["naive"].energy_kept = 90.0, 0.1, 4.0
    by_name["bfgs"].snr_db = -7.0
    rows = {row.method: row for row in summary.overall(comparison)}
    stills = sum(view.group != "motion" for result in comparison.sets for view in result.views)
    assert rows["bfgs"].views == rows["naive"].views == stills > rows["height"].views
    assert rows["bfgs"].worst == (f"alpha, {first.key}", -7.0)
    assert rows["naive"].energy[1] == 4.0
    assert not rows["height"].best
    # Everybody is first in SSIM there, and naive alone in SNR and FLIP.
    comparison.sets = comparison.sets[:1]
    comparison.sets[0].views = [first]
    rows = {row.method: row for row in summary.overall(comparison)}
    assert rows["bfgs"].firsts == (0, 0, 1) and rows["naive"].firsts == (1, 1, 1)
    assert rows["naive"].best == {"snr_db", "flip", "ssim", "snr_firsts", "flip_firsts", "ssim_firsts"}
    assert rows["bfgs"].best == {"ssim", "ssim_firsts"}


def test_only_lights_that_there_are_have_columns(made):
    assert [group for group, _ in summary.groups(made[0])] == ["light and viewer pairs", "small lights", "environment"]


def test_differences_are_those_of_each_set_and_lighting(made):
    found = summary.differences(made[0], "naive")
    expected = [PICTURE_SNR[name, "bfgs"][1] - PICTURE_SNR[name, "naive"][1] for name in ("alpha", "beta </script>")]
    assert sorted(found["mid"]) == sorted(2 * expected)
    assert len(summary.differences(made[0], "height")["near"]) == 2
    turned = summary.differences(made[0], "bfgs", "naive")
    assert turned == {distance: [-value for value in values] for distance, values in found.items()}


def test_each_learned_method_has_a_histogram_of_its_own(made):
    assert len(histograms.all_histograms(made[0])) == 1
    infos = [msgspec.structs.replace(info, name="latent" if info.name == "naive" else info.name)
             for info in made[0].methods]  # fmt: skip
    sets = msgspec.json.decode(
        msgspec.json.encode(made[0].sets).replace(b'"naive"', b'"latent"'), type=list[records.SetResult]
    )
    both = histograms.all_histograms(msgspec.structs.replace(made[0], methods=infos, sets=sets))
    assert len(both) == 2 and "bfgs less latent" in both[0] and "latent less bfgs" in both[1]


def test_methods_side_by_side_from_the_simplest_to_the_fit(made):
    whole, pictures = made
    result = whole.sets[0]
    assert side_by_side.ordered(whole, result) == ["naive", "height", "bfgs"]
    drawn = dict(side_by_side.all_side_by_side(whole, result, pictures))
    assert list(drawn) == ["small lights", "environment"]
    sheet, step = drawn["small lights"], side_by_side.CELL + 24
    # The last cell is the reference from afar, its 8x8 pixels enlarged 22 times.
    far = pictures[summary.view_of(result, "small lights", "far").reference]
    top, left = sheet.shape[0] - step, sheet.shape[1] - side_by_side.CELL - 6
    cell = sheet[top : top + side_by_side.CELL, left : left + side_by_side.CELL]
    np.testing.assert_array_equal(cell[11::22, 11::22], far)
    views = [view for view in result.views if view.distance != "mid"]
    assert side_by_side.all_side_by_side(whole, msgspec.structs.replace(result, views=views), pictures) == []


def test_a_cell_is_the_middle_of_a_larger_picture():
    picture = np.arange(200 * 300 * 3, dtype=np.uint32).astype(np.uint8).reshape(200, 300, 3)
    np.testing.assert_array_equal(side_by_side.cropped(picture, 100), picture[50:150, 100:200])


class References(HTMLParser):
    """Everything that a page points to, and how its elements nest."""

    VOID = frozenset(("meta", "link", "img", "input", "br", "path", "use"))

    def __init__(self):
        super().__init__()
        self.found, self.stack, self.tables = [], [], 0

    def handle_starttag(self, tag, attributes):
        named = dict(attributes)
        self.found += [named[name] for name in ("src", "href", "xlink:href", "data", "action") if named.get(name)]
        self.tables += tag == "table"
        if tag not in self.VOID:
            self.stack.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.found += [value for name, value in attributes if name in ("src", "href", "xlink:href")]

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            assert self.stack.pop() == tag


def test_the_page_asks_for_nothing_but_itself(html):
    parser = References()
    parser.feed(html)
    parser.close()
    assert not parser.stack
    assert parser.found
    assert [reference for reference in parser.found if not reference.startswith(("#", "data:"))] == []
    styles = "".join(re.findall(r"<style.*?</style>", html, re.S))
    assert "@import" not in styles
    assert all(address.startswith(("#", "'#", '"#')) for address in re.findall(r"url\(([^)]*)\)", html))
    script = html[html.rindex("<script>") :]
    assert not re.search(r"fetch\(|XMLHttpRequest|import\(|WebSocket", script)


def test_the_page_holds_what_the_records_say(made, html):
    # Losers stay in, skipped methods are told with their sentence, names and commands are escaped.
    assert "<b>height</b> is not here: It has no height map." in html
    assert "beta &lt;/script&gt;" in html
    assert "brdffit compare &#39;a &amp; b&#39; -o report" in html
    # Mean over both sets, marked as first; and that of a method which lacks one.
    assert re.search(r'class="first"[^>]*>13\.0<', html)
    assert "(1 of 2 sets)" in html
    assert "<b>bfgs</b> is first in" in html


def test_the_data_of_the_page_is_json_that_no_name_can_end(html):
    text = re.search(r'<script type="application/json" id="data">(.*?)</script>', html, re.S)[1]
    data = json.loads(text)
    assert [each["name"] for each in data["sets"]] == ["alpha", "beta </script>"]
    assert data["sets"][0]["views"][0]["methods"]["naive"].startswith("data:image/jpeg;base64,")
    assert data["sets"][0]["lobes"][0]["heat"]["reference"].startswith("data:image/png;base64,")
    assert len(data["sets"][0]["lobes"][0]["cuts"]["bfgs"][0]) == 9


def test_a_page_of_one_method_and_of_no_lobes(made):
    """Nothing to hold against each other: no histogram, and still a page."""
    one = msgspec.json.decode(msgspec.json.encode(made[0].sets[0]), type=records.SetResult)
    one.methods, one.lobes = one.methods[:1], []
    for view in one.views:
        view.shots = view.shots[:1]
    alone = msgspec.structs.replace(made[0], sets=[one], methods=made[0].methods[:1])
    assert "Set by set" not in page.render_page(alone, made[1])


@pytest.mark.parametrize(
    ("value", "text"), [(None, "\u2013"), (99.0, "\u221e"), (-99.0, "\u2212\u221e"), (-3.25, "\u22123.2"), (7.0, "7.0")]
)
def test_decibels_as_text(value, text):
    assert page.decibels(value) == text


def test_report_and_drawing_it_anew_give_the_same_page(made, tmp_path):
    folder = tmp_path / "report"
    path = write_report(*made, folder)
    first = path.read_text(encoding="utf-8")
    read, pictures, _ = read_report(folder / "records.json")
    assert all(np.array_equal(pictures[name], made[1][name]) for name in records.picture_names(made[0]))
    path.unlink()
    assert page.render_page(read, pictures) == first
    # A second report takes the place of the first; what others put there is not touched.
    check_report_folder(folder)
    (folder / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"mine\.txt"):
        check_report_folder(folder)
    with pytest.raises(OutputError, match=r"mine\.txt"):
        write_report(*made, folder)
    assert (folder / "mine.txt").read_text() == "mine"


def test_a_report_that_fails_leaves_what_was_there(made, tmp_path, monkeypatch):
    folder = tmp_path / "report"
    monkeypatch.setattr("brdffit.report.writing.render_page", lambda *arguments: "a page")
    before = write_report(*made, folder).read_bytes()

    def interrupted(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr("brdffit.report.writing.render_page", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_report(*made, folder)
    assert (folder / "index.html").read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == ["report"]


def test_a_missing_or_foreign_picture_is_told(made, tmp_path, monkeypatch):
    monkeypatch.setattr("brdffit.report.writing.render_page", lambda *arguments: "a page")
    folder = tmp_path / "report"
    write_report(*made, folder)
    name = records.picture_names(made[0])[0]
    (folder / name).unlink()
    with pytest.raises(InputError, match=re.escape(name.rpartition("/")[2])):
        read_report(folder)
    text = (folder / "records.json").read_text().replace(name, "../" + name)
    (folder / "records.json").write_text(text)
    write_png(tmp_path / "secret.png", np.zeros((2, 2, 3), np.uint8))
    with pytest.raises(InputError, match="expected one beside it"):
        read_report(folder)


def test_maps_are_coloured_and_addresses_hold_the_picture():
    strip = np.array([[0, 255], [0, 255]], np.uint8)
    found = plots.map_picture(strip)
    assert found.shape == (2, 2, 3)
    assert found[0].tolist() == [[0, 0, 0], [255, 255, 255]]
    assert plots.data_address(strip, lossless=True).startswith("data:image/png;base64,")


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: the page is not opened in a browser")
def test_a_browser_opens_the_page_without_a_complaint(made, tmp_path):
    """The script runs to its end (it then marks the document) and the console stays empty."""
    path = write_report(*made, tmp_path / "report")
    command = [
        CHROMIUM, "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu",
        "--enable-logging=stderr", "--virtual-time-budget=5000", f"--user-data-dir={tmp_path / 'profile'}",
        "--dump-dom", path.resolve().as_uri(),
    ]  # fmt: skip
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert re.search(r'<html[^>]* data-ready="yes"', result.stdout), result.stderr[-2000:]
    assert "CONSOLE" not in result.stderr
    # Lobes, pictures and pressed buttons were made by the script.
    assert result.stdout.count('aria-pressed="true"') > 4
