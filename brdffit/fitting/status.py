"""How the fit of a texel ended: one status a texel, each with a sentence that says what to do."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import NDArray

KEPT = 0
FLAT = 1
CONVERGED = 2
REFINED = 3
ITERATION_LIMIT = 4
PRECISION_LIMIT = 5
FALLBACK = 6
NO_SPECULAR = 7
CLOSED_FORM = 8
NOT_REACHED = 9
FEW_NODES = 10
POOR = 11

#: Name and meaning of each status, with advice where there is any; ``Level.status`` holds the index.
STATUSES: tuple[tuple[str, str], ...] = (
    ("kept", "The texel was left as authored."),
    (
        "flat",
        "All lobes of the footprint are alike, or nearly so under lights with a size: nothing needed to be searched.",
    ),
    ("converged", "The search converged."),
    ("refined", "The quadrature's own error estimate was too large; more nodes were used and the search converged."),
    ("iteration limit", "The search was stopped at its iteration limit; try --quality fine."),
    ("precision limit", "No step lowered the error any more at the precision of the sums; as good as converged."),
    ("fallback", "The search failed; the texel holds its closed-form start."),
    ("no specular", "The footprint reflects nothing specularly; normal and roughness were fitted as if it were white."),
    ("closed form", "The closed-form lobe is within the tolerance that was asked for; nothing was searched."),
    ("not reached", "No pixel reads this level; its channels were averaged, each for itself."),
    ("few nodes", "The search converged on fewer nodes than usual, which the tolerance that was asked for allows."),
    (
        "poor",
        "More than half of the target is missed after every start and every peak was tried: no single lobe stands for "
        "this footprint under such lights; larger --lights ask for less.",
    ),
)

STATUS_NAMES = tuple(name for name, _ in STATUSES)


def doubts(statuses: Sequence[NDArray]) -> list[str]:
    """Sentences on texels whose lobes are not what was asked for; ``statuses``: arrays of any shape, one a level."""
    failed, poor = (sum(int((each == status).sum()) for each in statuses) for status in (FALLBACK, POOR))
    notes = []
    if failed:
        notes.append(f"The search failed for {failed} texels; they hold their closed-form start.")
    if poor:
        notes.append(f"No single lobe stands for {poor} texels: more than half of what they reflect is missed.")
    return notes
