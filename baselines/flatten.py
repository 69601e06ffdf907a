"""A common wrong way, shown by Baker (2011, "Spectacular Specular"): fade the normal to (0, 0, 1) with level.

    n' ~ (1 - t) E[n] / |E[n]| + t z,   t = k / (K - 1) at level k of the K levels down to 1x1

Bumps vanish in the distance and nothing is added to the roughness for them. Perceptual roughness is averaged as stored,
colours linearly.
"""

from __future__ import annotations

from collections.abc import Mapping

from numpy.typing import NDArray

from baselines._filtering import LevelContext, unit_normal_and_length
from baselines.naive import Naive


class FadeToFlat(Naive):
    """Fade the normal to z with level."""

    name = "flatten"
    summary = "fade the normal to (0, 0, 1) with level: a common wrong way"

    def finish(self, filtered: Mapping[str, NDArray], context: LevelContext) -> tuple[NDArray, NDArray]:
        """The naive level with its normal faded."""
        normal, log_roughness = super().finish(filtered, context)
        fade = context.mip_level / max(1, context.chain_length - 1)
        normal = (1.0 - fade) * normal
        normal[..., 2] += fade
        return unit_normal_and_length(normal)[0], log_roughness
