"""The loss by storing a pyramid in a preset's pictures: they are decoded again and compared with what was baked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.colour import decode_srgb
from brdffit.export.channels import decode
from brdffit.export.decompression import decode_blocks
from brdffit.export.factors import Factors
from brdffit.export.formats import PixelFormat
from brdffit.export.judging import HIGHEST_DB, degrees_between, random_places, signal_to_noise, texels_of
from brdffit.export.presets import Picture
from brdffit.svbrdf import Svbrdf


class Cost:
    """Collects pictures, before and after compression, at random texels of each level.

    Args:
        levels: what was baked.
        normal_y: the preset's convention.
        factors: of the material that is written.
    """

    def __init__(self, levels: Sequence[Svbrdf], normal_y: str, factors: Factors) -> None:
        self._normal_y = normal_y
        self._factors = factors
        self._sizes = [level.size for level in levels]
        self._places = [random_places(size, k) for k, size in enumerate(self._sizes)]
        self._baked = [texels_of(level, places) for level, places in zip(levels, self._places, strict=True)]
        self._before: list[dict[str, NDArray]] = [{} for _ in levels]
        self._after: list[dict[str, NDArray]] = [{} for _ in levels]
        self._compressed = False

    def add(
        self, picture: Picture, srgb: bool, encoded: Sequence[NDArray], pixels: PixelFormat | None = None,
        data: Sequence[bytes] | None = None,
    ) -> dict[str, Any]:  # fmt: skip
        """Record a picture: its codes or floats (H, W, C) of each level, and its compressed blocks if it has any.

        Returns:
            ``psnr_db`` of each level after compression, over all its texels and channels; nothing without blocks.
        """
        psnr = []
        for level, places in enumerate(self._places):
            codes = encoded[level]
            exact = codes if codes.dtype == np.float32 else codes / np.float32(np.iinfo(codes.dtype).max)
            self._keep(self._before[level], picture, srgb, exact[places])
            if pixels is None or data is None:
                self._keep(self._after[level], picture, srgb, exact[places])
                continue
            self._compressed = True
            decoded = decode_blocks(pixels, self._sizes[level], data[level])[..., : exact.shape[2]]
            self._keep(self._after[level], picture, srgb, decoded[places])
            squared = float(np.square(decoded - exact, dtype=np.float64).mean())
            psnr.append(round(min(-10.0 * float(np.log10(max(squared, 1e-30))), HIGHEST_DB), 2))
        return {"psnr_db": psnr} if psnr else {}

    def figures(self) -> list[dict[str, float]]:
        """Of each level, rounded:

        ``appearance_db`` and ``lobe_db``: SNR of the decoded pictures against what was baked, with colours and of the
        lobe alone; ``normal_degrees``: mean angle between normals. Where there are blocks also ``compression_lobe_db``,
        ``compression_roughness_db`` (with the normals as they were) and ``compression_normal_degrees``: the same of the
        decoded pictures against what was compressed; and ``floor_lobe_db`` and ``floor_normal_degrees``, of that
        against what was baked: no encoder of blocks of 8 bits can be expected to keep more.
        """
        found = []
        for baked, before, after in zip(self._baked, self._before, self._after, strict=True):
            stored = decode(after, self._normal_y, self._factors)
            record = {
                "appearance_db": signal_to_noise(baked, stored),
                "lobe_db": signal_to_noise(baked, stored, lobe_alone=True),
                "normal_degrees": float(degrees_between(baked.normal, stored.normal).mean()),
            }
            if self._compressed:
                codes = decode(before, self._normal_y, self._factors)
                record["compression_lobe_db"] = signal_to_noise(codes, stored, lobe_alone=True)
                # With the same normals: what is left is the roughness tensor.
                held = stored.replace(normal=codes.normal)
                record["compression_roughness_db"] = signal_to_noise(codes, held, lobe_alone=True)
                record["compression_normal_degrees"] = float(degrees_between(codes.normal, stored.normal).mean())
                record["floor_lobe_db"] = signal_to_noise(baked, codes, lobe_alone=True)
                record["floor_normal_degrees"] = float(degrees_between(baked.normal, codes.normal).mean())
            # Rounded well above the noise of sums, so that manifests agree to the byte.
            found.append({name: round(value, 3 if "degrees" in name else 2) for name, value in record.items()})
        return found

    @staticmethod
    def _keep(kept: dict[str, NDArray], picture: Picture, srgb: bool, values: NDArray) -> None:
        """Channels by name, linear, as a column of texels."""
        for place, channel in enumerate(picture.channels):
            linear = values[:, place].astype(np.float64)
            kept[channel] = (decode_srgb(linear) if srgb and place < 3 else linear)[:, None]
