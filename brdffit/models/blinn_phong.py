"""Blinn-Phong (Blinn 1977), normalised: D(h) = (p + 2) / (2 pi) (n.h)^p with alpha^2 = 2 / (p + 2).

It is the isotropic case of Ashikhmin-Shirley, whose profile it shares: q = (1 - C) / alpha^2 turns exp(q L(C)) / C into
C^(1 / alpha^2 - 1) = (n.h)^p. The fit keeps its tensor isotropic.
"""

from __future__ import annotations

from brdffit.models import Model
from brdffit.models.ashikhmin_shirley import log_normalisation, profile, profile_gradient

MODEL = Model(
    name="blinn-phong",
    summary="Blinn-Phong, normalised, isotropic",
    profile=profile,
    profile_gradient=profile_gradient,
    log_normalisation=log_normalisation,
    source="Blinn, Models of Light Reflection for Computer Synthesized Pictures, SIGGRAPH 1977",
    isotropic=True,
)
