"""A search that failed says so and is mended: mirror lobes in clusters, where descents end beside their target."""

import math
import sys

import numpy as np
import pytest
from lobe_oracle import disc_grid, normal_of_slopes, unit

from brdffit.fitting.losses import balance_of
from brdffit.fitting.options import FitOptions
from brdffit.fitting.sampling import LevelSample, Lobes
from brdffit.fitting.status import FALLBACK, POOR
from brdffit.halfangle.measure import random_texels
from brdffit.roughness import log_tensor_from_perceptual
from brdffit.svbrdf import Svbrdf
from hard_cases.displayed_oracle import SQUARES, Lobe, Target, footprint, knee_of, mixture, search

#: Error by which the fit may be behind the best of a scan; and the share of texels that may be.
SLACK, MAY_FAIL = 0.1, 0.01
#: Specular colour of each channel of all bases here.
GREY = 0.5


def mirrors(side, clusters, spread, wide, seed, diffuse=0.0):
    """Texels at the roughness floor, normals in clusters; a share ``wide`` of the texels is rough instead."""
    rng = np.random.default_rng(seed)
    centres = rng.normal(0, spread, (clusters, 2))
    slopes = centres[rng.integers(0, clusters, (side, side))] + rng.normal(0, 0.001, (side, side, 2))
    rough = np.where(rng.random((side, side)) < wide, 0.5, 0.045).astype(np.float32)
    grey = np.full((side, side, 3), GREY, np.float32)
    normal = normal_of_slopes(slopes[..., 0], slopes[..., 1]).astype(np.float32)
    return Svbrdf(
        normal=normal, log_roughness=log_tensor_from_perceptual(rough), specular=grey,
        diffuse=np.full_like(grey, diffuse),
    )  # fmt: skip


def says_so(output):
    """Whether nothing that misses most of its target goes by another name."""
    return (output.residual <= 0.5) | (output.status == POOR) | (output.status >= FALLBACK)


def scan(sample, base, found):
    """Errors (n,) of the best of many lobes, none of them searched: on normals of the base, of many widths."""
    rng = np.random.default_rng(1)
    scale = base.size[0] // sample.size[0]
    lobes = []
    for _ in range(4):
        rows = sample.rows * scale + rng.integers(0, scale, len(sample))
        columns = sample.columns * scale + rng.integers(0, scale, len(sample))
        normal = base.normal[rows, columns].astype(np.float64)
        for alpha in (0.002, 0.004, 0.02, 0.1, 0.3):
            theta = np.zeros((len(sample), 6))
            theta[:, 0:2] = -normal[:, 0:2] / normal[:, 2:3]
            theta[:, 2:4] = 2.0 * np.log(alpha)
            lobes += [Lobes(theta, np.full((len(sample), 3), GREY * share)) for share in (0.3, 0.6, 1.0)]
    errors = sample.measure([found, *lobes], nodes=2048, samples=(8, 32)).error
    return errors[0], errors[1:].min(axis=0)


def check_under_points(count, spread, clusters, level, wide):
    base = mirrors(2**level * 16, clusters, spread, wide, seed=0)
    options = FitOptions(lights="point")
    sample = LevelSample(base, level, *random_texels((16, 16), count, seed=0), options, threads=2)
    found, output = sample.fit()
    error, best = scan(sample, base, found)
    assert says_so(output).all()
    assert (error > best + SLACK).sum() <= MAY_FAIL * count


@pytest.mark.parametrize("clusters, wide", [(2, 0.0), (5, 0.3)])
def test_a_few_mirrors_are_found_under_points(clusters, wide):
    check_under_points(64, 0.1, clusters, 2, wide)


@pytest.mark.slow
@pytest.mark.parametrize("spread", [0.02, 0.1, 0.5])
@pytest.mark.parametrize("clusters, level, wide", [(2, 1, 0.0), (3, 2, 0.3), (5, 3, 0.0), (4, 4, 0.1)])
def test_mirrors_are_found_under_points(spread, clusters, level, wide):
    check_under_points(256, spread, clusters, level, wide)


#: Samples of a footprint along an axis and half vectors for each light: of the scan, of searches, of the last check.
SCANNED, SEARCHED, CHECKED = (48, 320), (64, 640), (96, 2048)
#: Widths (alpha^2) of the scan; its normals are taken from the footprint and from peaks of the target, this many each.
WIDTHS, NORMALS = np.array([0.002, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7]) ** 2, 5
#: Searches of the oracle for one texel, evaluations of each.
STARTS, EVALUATIONS = 3, 150
#: Texels of a base; bases of each level: 10,240 texels in all, with footprints of 4 to 4096 base texels.
TEXELS, BASES = 64, {1: 48, 2: 40, 3: 32, 4: 20, 5: 12, 6: 8}
#: The fit is mistaken where the error is more than twice what it believes, and this much more.
MISTAKEN = 0.1
#: Found by this law and mended but for a few: mirrors, alone or nearly so, whose normals lie further apart than two
#: widths of a lobe as the smallest light shows it. Between two such texels the normals form a streak; a lobe that
#: follows it shines beyond its ends, where the fit takes the target for brighter than it is. Large footprints scatter
#: their samples along it (``Strata.scatter``); small ones cut it, and each part is the mean over its normals
#: (``quadrature.mean_over_normals``). Largest share of such texels, by level, whose lobe is
#: behind, and whose error the fit mistakes.
APART = 0.025
STREAKS = {1: (0.015, 0.015)} | dict.fromkeys(range(2, 7), (0.005, 0.005))


class RandomMirrors:
    """Texels of one random base, fitted by default: two to five clusters, alone or mixed with rough texels."""

    def __init__(self, level, seed):
        self.rng = rng = np.random.default_rng((level, seed))
        self.spread = 0.02 * 25.0 ** rng.random()
        self.wide, self.diffuse = rng.choice([0.0, 0.0, 0.1, 0.3]), rng.choice([0.0, 0.1])
        self.base = mirrors(2**level * 8, rng.integers(2, 6), self.spread, self.wide, seed, self.diffuse)
        self.sample = LevelSample(self.base, level, *random_texels((8, 8), TEXELS, seed), threads=1)
        rules, settings = self.sample.settings()
        # What the search finds, not what is moved towards LEAN's lobe afterwards (brdffit.fitting.near_lean).
        _, self.output = self.sample.fit(settings=(rules, settings._replace(within=0.0)))
        self.found = [Lobe(*each) for each in zip(self.output.normal, self.output.log_roughness, strict=True)]

    @property
    def streaks(self):
        # Where rough texels are few, or a footprint of four may hold none, or the streaks are long, mirrors decide.
        return self.spread > APART and (self.wide < 0.2 or self.sample.mip_level == 1 or self.spread > 0.2)

    def target(self, i, lobes, rule):
        """(target, normals of the footprint) of texel i, on half vectors of its own and of these lobes."""
        row, column = self.sample.rows[i], self.sample.columns[i]
        normals, alpha_squared = footprint(self.base, self.sample.size, row, column, rule[0], self.rng)
        diffuse = self.diffuse * np.linalg.norm(normals.mean(axis=0))
        balance = balance_of("balanced", self.sample.mip_level)
        return Target(normals, alpha_squared, GREY, diffuse, lobes, rule[1], self.rng, *balance), normals

    def scan(self, i, rule):
        """(target, errors of isotropic lobes, ascending, and these lobes) at texel i."""
        target, normals = self.target(i, [self.found[i]], rule)
        picked = normals[self.rng.integers(0, len(normals), NORMALS)]
        tried = np.concatenate([picked, target.peaks(NORMALS), normals.mean(axis=0, keepdims=True)])
        tried = unit(np.maximum(tried, [-1, -1, 0.05]))
        errors = target.errors(tried, WIDTHS).ravel()
        order = errors.argsort()[:STARTS]
        lobes = [Lobe(tried[k // len(WIDTHS)], [math.log(WIDTHS[k % len(WIDTHS)])] * 2 + [0.0]) for k in order]
        return target, errors[order], lobes

    def rivals(self, i):
        """Lobes that may be better than what was found, or none."""
        target, errors, lobes = self.scan(i, SCANNED)
        own = target.error(self.found[i])
        suspect = own > errors[0] + SLACK or own > 2 * self.output.residual[i] + MISTAKEN
        return lobes[:1] if suspect else []

    def searched(self, i):
        """Where NLopt ends, from the best of the scan and from what was found."""
        target, _, lobes = self.scan(i, SEARCHED)
        return [search(target, start, EVALUATIONS) for start in (*lobes, self.found[i])]

    def judged(self, i, rivals):
        """(behind, mistaken) of texel i on fresh half vectors, which all of these lobes drew."""
        target, _ = self.target(i, [self.found[i], *rivals], CHECKED)
        own = target.error(self.found[i])
        behind = own > min(map(target.error, rivals)) + SLACK
        return np.array([behind, own > 2 * self.output.residual[i] + MISTAKEN])


@pytest.mark.slow
@pytest.mark.parametrize("level", BASES)
def test_ten_thousand_mirrors_are_found_under_lights_with_a_size(level, capsys):
    """By default, against an oracle that shares no code with the fit (``displayed_oracle``).

    It proves for every texel a necessary condition: the lobe that was found is no more than ``SLACK`` behind the best
    of 77 isotropic lobes, on the target's peaks, on its texels and on their mean; and its error is what the fit
    believes. For one texel a base, the one with the largest residual, four searches without gradients may find any
    lobe. What fails is checked again on half vectors that all rivals drew. It does not prove that no better lobe
    exists elsewhere.
    """
    failed, tried = {True: np.zeros(2), False: np.zeros(2)}, {True: 0, False: 0}
    for seed in range(BASES[level]):
        made = RandomMirrors(level, seed)
        assert says_so(made.output).all()
        worst = int(made.output.residual.argmax())
        for i in range(TEXELS):
            rivals = made.rivals(i) + (made.searched(i) if i == worst else [])
            if rivals:
                failed[made.streaks] += made.judged(i, rivals)
        tried[made.streaks] += TEXELS
    shares = {streaks: failed[streaks] / max(tried[streaks], 1) for streaks in tried}
    with capsys.disabled():
        sys.stdout.write(
            f"\nlevel {level}: {tried[True]} texels with streaks, behind and mistaken {shares[True]}; "
            f"{tried[False]} others, {shares[False]}\n"
        )
    assert (shares[False] <= MAY_FAIL).all()
    assert (shares[True] <= STREAKS[level]).all()


def test_the_oracle_agrees_with_a_dense_grid():
    """Sums over 350,000 half vectors instead of random ones: two clusters, and a lobe along the streak between them."""
    base = mirrors(16, 2, 0.1, 0.2, seed=1)
    rng = np.random.default_rng(2)
    normals, alpha_squared = footprint(base, (4, 4), 1, 2, 32, rng)
    lobe = Lobe(unit(normals.mean(axis=0)), [2 * math.log(0.2), 2 * math.log(0.05), 0.8])
    h, solid = disc_grid(0.003)
    weight = 2 / math.pi * h[:, 2] ** 3 * solid
    td = dd = 0.0
    for square in SQUARES:
        shape, _ = mixture(
            h.astype(np.float32), normals.astype(np.float32), (alpha_squared + square).astype(np.float32)
        )
        light = 3 * GREY * shape
        knee = knee_of((weight * light).sum() / weight.sum(), 0.1)
        seen = weight * (knee / (light + knee)) ** 1.5
        values, whole = lobe.values(h, square), (seen * shape * shape).sum()
        td, dd = td + (seen * shape * values).sum() / whole / 3, dd + (seen * values**2).sum() / whole / 3
    scale = min(max(td / dd, 0.9), 1.1)
    exact = 1 - 2 * scale * td + scale**2 * dd
    found = [Target(normals, alpha_squared, GREY, 0.1, [lobe], 2048, rng).error(lobe) for _ in range(8)]
    # Four standard errors of the mean of eight.
    assert np.mean(found) == pytest.approx(exact, abs=4 * np.std(found) / math.sqrt(8))
    assert np.std(found) < 0.1 * exact
