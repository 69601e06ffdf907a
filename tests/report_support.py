"""A comparison made by hand: two sets, three methods of which one cannot do the second set; and its pictures."""

import numpy as np

from brdffit.report import records
from brdffit.report.records import KEPT_SUFFIX, PICTURES

SIDE = 9
#: SNR of pictures by (set, method): near, mid, far; small lights. Under the environment all are one dB higher.
PICTURE_SNR = {
    ("alpha", "bfgs"): (20.0, 15.0, 12.0),
    ("alpha", "naive"): (8.0, 5.0, -3.0),
    ("alpha", "height"): (30.0, 30.0, 30.0),
    ("beta </script>", "bfgs"): (22.0, 11.0, 10.0),
    ("beta </script>", "naive"): (10.0, 13.0, -1.0),
}


def figures(snr):
    return records.Figures(snr_db=snr, relative_l2=0.1, flip_hdr=0.2, flip_ldr=0.1, ssim=0.9, energy_kept=0.98)


def lobe(methods):
    values = np.linspace(0.0, 1.0, SIDE * SIDE).reshape(SIDE, SIDE)
    names = ["reference", *methods]
    return records.LobeView(
        level=1, column=0, row=0, u=0.25, v=0.25, side=SIDE, centre=(0.0, 0.0), extent=0.2, peak=10.0,
        peak_at=(0.0, 0.0), axis=(1.0, 0.0), grids={name: records.pack(values) for name in names},
        cuts={name: records.pack(values[:2]) for name in names}, snr_db={name: 12.0 for name in methods},
    )  # fmt: skip


def one_set(name, methods, skipped=()):
    slug = "".join(letter for letter in name if letter.isalnum())
    pictures = {}

    def picture(of, shape=(8, 8, 3)):
        path = f"{PICTURES}/{slug}/{of.replace(' ', '-').replace(',', '')}.png"
        pictures[path] = np.random.default_rng(len(pictures)).integers(0, 256, shape, dtype=np.uint8)
        return path

    views = []
    for lit, more in (("small lights", 0.0), ("environment", 1.0)):
        for k, distance in enumerate(("near", "mid", "far")):
            key = f"{distance}-{lit.replace(' ', '-')}"
            shots = [
                records.Shot(method=m, picture=picture(f"{key}-{m}"), figures=figures(PICTURE_SNR[name, m][k] + more))
                for m in methods
            ]
            if k == 0:
                kept = "bfgs" + KEPT_SUFFIX
                shots.append(records.Shot(method=kept, picture=picture(f"{key}-{kept}"), figures=figures(4.0)))
            views.append(
                records.View(
                    key=key, group="distance", title=f"Plane, {distance}, {lit}", lighting=lit, distance=distance,
                    level=float(k), reference=picture(f"{key}-reference"), shots=shots,
                )
            )  # fmt: skip
    moving = [records.Shot(method=m, picture=picture(f"shift-{m}"), change=1.25) for m in methods]
    views.append(
        records.View(
            key="shift", group="motion", title="Half a pixel", lighting="small lights",
            reference=picture("shift-reference"), shots=moving,
        )
    )  # fmt: skip
    results = [
        records.MethodResult(
            method=m, seconds=1.0 + i, maps=picture(f"maps-{m}", (16, 24)),
            levels=[
                records.LevelFigures(level=k, size=(4 >> k, 4 >> k), half_angle_snr_db=10.0 - k + i, energy_kept=0.9,
                                     pair_snr_db=20.0 - i if k < 2 else None)
                for k in range(3)
            ],
        )
        for i, m in enumerate(methods)
    ]  # fmt: skip
    result = records.SetResult(
        name=name, size=(4, 4), wrap="tile", distances={"near": 0, "mid": 1, "far": 2}, methods=results,
        skipped=[records.Skipped(method=m, reason="It has no height map.") for m in skipped], views=views,
        lobes=[lobe(methods)], overview=picture("overview"), maps_levels=3, seconds={"baking": 1.5},
    )  # fmt: skip
    return result, pictures


def comparison():
    """(Comparison, pictures)."""
    one, pictures = one_set("alpha", ["bfgs", "naive", "height"])
    other, more = one_set("beta </script>", ["bfgs", "naive"], skipped=["height"])
    names = ["bfgs", "naive", "height"]
    whole = records.Comparison(
        created="2026-01-01T00:00:00+00:00", command="brdffit compare 'a & b' -o report", machine={"cores": 2},
        options={"quality": "draft", "levels": None}, seconds=12.0, sets=[one, other],
        methods=[records.MethodInfo(name=n, summary=f"about {n}", fit=n == "bfgs") for n in names],
    )  # fmt: skip
    return whole, pictures | more
