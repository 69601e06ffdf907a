"""The HTML page of `brdffit probe compare`, made from its records."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np

from brdffit.probes.published import TABLE_2
from brdffit.probes.table_files import LEVELS
from brdffit.probes.tables import BASE_SIZE


def page(records: dict[str, Any]) -> str:
    """The report as one HTML page; ``records`` as ``compare.compare_to_folder`` writes them."""
    environments = records["environments"]
    sections = [
        "<h1>Reflection probes, compared</h1>",
        f"<p>brdffit {records['brdffit']}, {len(environments)} environment{'s' * (len(environments) != 1)} of "
        f"{BASE_SIZE}&sup2;, "
        "Activision's roughness curve. Error: sum |a - b| / sum b against brute force, mean of levels 1 to 6. "
        "Seconds are processor time on this machine; compare ratios.</p>",
        '<img src="front.png" alt="error over time">',
        _methods_table(records["methods"], environments),
        *_preimages_section(records["preimages"]),
        "<h2>One bright texel in the middle of a face, on an edge, at a corner (figure 8)</h2>",
        '<img src="points.png" alt="point responses">',
        *_seam_section(records["seams"]),
        *_cmgen_section(records["cmgen"]),
        "<h2>What the engine's look-up adds</h2>",
        "<p>Exact texels read trilinearly at 12 roughnesses from 0.05 to 1, in random directions. "
        "<code>--fit lookup</code> moves the texels to what reads best.</p>",
        _lookup_table(records["lookup"], environments),
        *_split_sum_section(records["split_sum"]),
        "<h2>Levels 1, 3 and 5 (figure 7)</h2>",
        *(f'<h3>{escape(name)}</h3><img src="levels-{escape(name)}.png" alt="levels">' for name in environments),
    ]
    return _PAGE.replace("BODY", "\n".join(sections))


def _methods_table(methods: list[dict[str, Any]], environments: list[str]) -> str:
    by = {(each["environment"], each["method"]): each for each in methods}
    rows = []
    for name in dict.fromkeys(each["method"] for each in methods):
        found = [by[environment, name] for environment in environments]
        rows.append(
            [
                name, *(_percent(each["error"]) for each in found), _mean(found, "error"),
                _percent(max(each["worst"] for each in found)), f"{np.mean([each['seconds'] for each in found]):.2f}",
            ]
        )  # fmt: skip
    return _html_table(["method", *environments, "mean", "99% of texels within", "seconds"], rows)


def _preimages_section(preimages: dict[str, Any]) -> list[str]:
    """The paper's tables 1 to 3, irradiance, and how the searches went."""

    def row(name: str, found: dict[str, Any], seconds: str) -> list[str]:
        levels = (_number(found["levels"].get(str(level))) for level in range(1, LEVELS))
        return [name, *levels, _number(found["mean"]), _number(found["paper"]), seconds]

    tables = [row(each["table"], each, f"{each['seconds']:.0f}") for each in preimages["tables"]]
    tables += [row(f"importance sampling, {each['samples']}", each, "") for each in preimages["importance"]]
    tables += [
        [f"paper: {name}", *map(_number, errors[1:]), _number(float(np.mean(errors[1:]))), "", ""]
        for name, errors in TABLE_2.items()
    ]
    named = [(f"harmonics of order {each['order']}", each) for each in preimages["harmonics"]]
    named += [(each["table"], each) for each in preimages["irradiance"]]
    return [
        "<h2>The paper's tables, beside ours</h2>",
        "<p>L1 between preimages of unit integral, over the sphere (Manson and Sloan 2016, tables 1 to 3). Ours on "
        "held-out texels. The tables are fitted by <code>brdffit probe table</code>; no number of the "
        "paper's is used.</p>",
        _html_table(
            ["table", *(f"level {level}" for level in range(1, LEVELS)), "mean", "paper", "processor s to fit"], tables
        ),
        _html_table(
            ["irradiance", "error", "paper"],
            [[name, _number(each["error"]), _number(each["paper"])] for name, each in named],
        ),
        "<p>How the searches went: the best error on the searched texels over processor time, and as a dot the error "
        "on held-out texels at the end.</p>",
        '<img src="searches.png" alt="error over time of the searches">',
    ]


def _split_sum_section(split: dict[str, Any]) -> list[str]:
    rows = zip(split["roughness"], split["errors"], strict=True)
    return [
        "<h2>What the split sum adds</h2>",
        "<p>Filtered radiance times the table, against the true integral of a white mirror of GGX (F0 = 1). No filter "
        "mends this.</p>",
        _html_table(
            ["roughness", *(f"n.v {nv:g}" for nv in split["cosines"])],
            [[f"{roughness:g}", *map(_percent, errors)] for roughness, errors in rows],
        ),
    ]


def _seam_section(records: list[dict[str, Any]]) -> list[str]:
    levels = records[0]["levels"]
    rows = [
        [each["environment"], *(f"{value:.2f}" for value in [*each["upright"], *each["turned"]])] for each in records
    ]
    head = [f"level {level}{how}" for how in ("", ", turned") for level in levels]
    return [
        "<h2>Seams</h2>",
        "<p>Steps of the relative error across the edges of the cube over those just inside of them, the tree at a "
        "tolerance of 0.005. As the environment stands, and summed over "
        f"{records[0]['turns']} random orientations: one alone tells as much of where its lamps lie as of seams.</p>",
        _html_table(["environment", *head], rows),
    ]


def _cmgen_section(records: list[dict[str, Any]]) -> list[str]:
    if not records:
        return []
    rows = [
        [
            f"{each['environment']}, {name}",
            *map(_percent, each[name]["errors"]),
            _percent(each[name]["error"]),
            _percent(each[name]["energy"]),
            f"{each[name]['seconds']:.2f}",
        ]
        for each in records
        for name in ("cmgen", "brdffit")
    ]
    return [
        "<h2>Filament's cmgen</h2>",
        "<p>The same file and the same curve, a cube of 128, four levels; ours at a tolerance of 0.005. Energy is that "
        "of level 0 over the picture's. Seconds are processor time from the file to the levels; cmgen's hold writing "
        "them.</p>",
        _html_table(["environment", "level 1", "level 2", "level 3", "mean", "energy", "seconds"], rows),
    ]


def _lookup_table(records: list[dict[str, Any]], environments: list[str]) -> str:
    rows = []
    for curve, levels in dict.fromkeys((each["curve"], each["levels"]) for each in records):
        found = [each for each in records if (each["curve"], each["levels"]) == (curve, levels)]
        rows.append([f"{curve}, {levels} levels", *(_percent(each["error"]) for each in found), _mean(found, "error")])
        if "fitted" in found[0]:
            rows.append(
                [f"{curve}, {levels} levels, fitted", *(_percent(e["fitted"]) for e in found), _mean(found, "fitted")]
            )
    return _html_table(["curve", *environments, "mean"], rows)


def _mean(found: list[dict[str, Any]], key: str) -> str:
    return _percent(float(np.mean([each[key] for each in found])))


def _percent(value: float) -> str:
    return f"{100.0 * value:.2f}%"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.4f}"


def _html_table(head: list[str], rows: list[list[str]]) -> str:
    top = "".join(f"<th>{escape(each)}</th>".replace("_", "_<wbr>") for each in head)
    body = "\n".join("<tr>" + "".join(f"<td>{escape(each)}</td>" for each in row) + "</tr>" for row in rows)
    return f'<div class="scroll"><table><tr>{top}</tr>\n{body}</table></div>'


_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>Reflection probes, compared</title>
<style>
body { font: 15px/1.5 sans-serif; max-width: 76em; margin: 2em auto; padding: 0 1em; color: #222; background: #fff }
.scroll { overflow-x: auto }
table { border-collapse: collapse; margin: 1em 0; font-size: 13px; font-variant-numeric: tabular-nums }
th { vertical-align: bottom }
th, td { padding: .2em .5em; border-bottom: 1px solid #ddd; text-align: right }
th:first-child, td:first-child { text-align: left }
img { max-width: 100% }
</style></head><body>
BODY
</body></html>
"""
