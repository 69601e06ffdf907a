"""The terms of the BRDF that are simulated; those switched off are left out of the compiled loops."""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(frozen=True)
class Terms:
    """Terms of the BRDF; a term that is off is left out as if it were 1 (`lobe` and `diffuse`: 0).

    With all of them on the radiance is that of ``models.microfacet.brdf``. With ``LOBE_ONLY`` it is rho D(h) exactly,
    the function whose error the half-angle integral measures.

    Attributes:
        lobe: the lobe rho D(h), with its masking and Fresnel factors.
        masking: G2 / (4 n.l n.v), height-correlated Smith masking and shadowing with its denominator.
        fresnel: Schlick's growth of the lobe, and loss of the diffuse part, towards grazing angles.
        diffuse: diffuse (1 - specular) / pi; without ``cosine`` it is what a facet turned to the light reflects.
        cosine: n.l.
    """

    lobe: bool = True
    masking: bool = True
    fresnel: bool = True
    diffuse: bool = True
    cosine: bool = True

    @property
    def clips(self) -> bool:
        """Whether a texel is dark when the light is below its own horizon: with masking or cosine."""
        return self.masking or self.cosine

    @property
    def suffix(self) -> str:
        """A name for kernels: the letters of the terms that are on."""
        return "_" + ("".join(field.name[0] for field in fields(self) if getattr(self, field.name)) or "none")


#: Exactly rho D(h).
LOBE_ONLY = Terms(masking=False, fresnel=False, diffuse=False, cosine=False)
