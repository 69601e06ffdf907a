"""Textures packed texel by texel, as the compiled loops of the renderer read them, and the compiled loops."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import numba_type, specialise, types
from brdffit.models import get_model
from brdffit.render import _environment_kernels, _kernels
from brdffit.render.terms import Terms
from brdffit.roughness import perceptual_from_log_tensor, tensor_from_log
from brdffit.svbrdf import Svbrdf


class Packed(NamedTuple):
    """Images of one lobe model: texels (N, 16) float32 row by row, and of each image its begin, height and width."""

    texels: NDArray
    levels: NDArray
    roughness_kind: int
    has_shape: bool
    tile: bool
    model: str


def pack_base(base: Svbrdf) -> Packed:
    """A base as a reference interpolates it: perceptual roughness, or the log tensor where it is anisotropic."""
    log = base.log_roughness
    isotropic = bool(np.array_equal(log[..., 0], log[..., 1]) and not np.any(log[..., 2]))
    roughness = perceptual_from_log_tensor(log)[..., None] if isotropic else log
    return _pack([base], [roughness], _kernels.PERCEPTUAL if isotropic else _kernels.LOG_TENSOR)


def pack_levels(levels: Sequence[Svbrdf]) -> Packed:
    """MIP levels as a renderer interpolates them: what the files store, the tensor in alpha^2."""
    return _pack(levels, [tensor_from_log(level.log_roughness) for level in levels], _kernels.PLAIN_TENSOR)


def _pack(levels: Sequence[Svbrdf], roughness: Sequence[NDArray], kind: int) -> Packed:
    texels = np.zeros((sum(level.size[0] * level.size[1] for level in levels), _kernels.PACKED), np.float32)
    places = np.zeros((len(levels), 3), np.int64)
    shape = get_model(levels[0].model).default_shape
    begin = 0
    for place, level, rough in zip(places, levels, roughness, strict=True):
        height, width = level.size
        place[:] = begin, height, width
        view = texels[begin : begin + height * width].reshape(height, width, _kernels.PACKED)
        view[..., _kernels.P_NORMAL : _kernels.P_NORMAL + 3] = level.normal
        view[..., _kernels.P_ROUGHNESS : _kernels.P_ROUGHNESS + rough.shape[2]] = rough
        view[..., _kernels.P_SPECULAR : _kernels.P_SPECULAR + 3] = level.specular
        view[..., _kernels.P_DIFFUSE : _kernels.P_DIFFUSE + 3] = level.diffuse
        view[..., _kernels.P_SHAPE] = shape if level.shape is None else level.shape
        begin += height * width
    first = levels[0]
    return Packed(texels, places, kind, first.shape is not None, first.wrap == "tile", first.model)


@cache
def shading_kernels(model: str, terms: Terms) -> tuple[Any, Any]:
    """(log_normalisation, shade) of a model and some terms, in the order that the drivers take them."""
    log_normalisation = get_model(model).log_normalisation
    _compile(log_normalisation, (types.float64,))
    return log_normalisation, _specialised(_kernels.shade_block, _kernels.shade_type, model, terms)


@cache
def environment_kernels(model: str, terms: Terms, lamps: bool = False) -> tuple[Any, Any, Any, Any]:
    """(log_normalisation, shade_directions, shade_matt, look_around), for lamps or an environment."""
    loops = _environment_kernels
    look_around = loops.light_of_lamps if lamps else loops.light_of_picture
    _compile(look_around, loops.look_around_type.signature.args)
    return (
        shading_kernels(model, terms)[0],
        _specialised(loops.shade_directions, loops.shade_directions_type, model, terms),
        _specialised(loops.shade_matt, loops.shade_matt_type, model, terms),
        look_around,
    )


def _specialised(loop: Any, kind: Any, model: str, terms: Terms) -> Any:
    """A shading loop for a model and some terms, compiled (or loaded) for its one signature."""
    shade = specialise(
        loop,
        f"_{model.replace('-', '_')}{terms.suffix}",
        profile=get_model(model).profile,
        LOBE=terms.lobe,
        MASKING=terms.masking,
        FRESNEL=terms.fresnel,
        DIFFUSE=terms.diffuse,
        COSINE=terms.cosine,
    )
    _compile(shade, kind.signature.args)
    return shade


def _compile(dispatcher: Any, arguments: tuple[Any, ...]) -> None:
    """Compile (or load) one signature, so that the function can be handed over as a value of function type."""
    if arguments not in dispatcher.overloads:
        dispatcher.compile(arguments)


_FUNCTIONS = (_kernels.log_normalisation_type, _kernels.shade_type)
_TEXELS, _LEVEL = np.zeros((1, _kernels.PACKED), np.float32), np.zeros(3, np.int64)
_IMAGE, _LINE, _INDEX = np.zeros((1, 3)), np.zeros(1), np.zeros(1, np.int64)


def _driver(loop: Any, *example: Any, functions: tuple[Any, ...] = _FUNCTIONS) -> Any:
    """A loop compiled for function-typed kernels: once for all models and terms, and it reaches the disk cache."""
    _compile(loop, (*map(numba_type, example), *functions))
    loop.disable_compile()
    return loop


@cache
def reference_loop() -> Any:
    """``reference_rows``."""
    return _driver(
        _kernels.reference_rows, _TEXELS, _LEVEL, 0, False, False, _IMAGE, _INDEX, _INDEX, _IMAGE, _IMAGE[None], _IMAGE,
        _IMAGE, 0.0, _LINE, _LINE, _LINE, _LINE, 0, _IMAGE,
    )  # fmt: skip


@cache
def pyramid_loop() -> Any:
    """``pyramid_rows``."""
    return _driver(
        _kernels.pyramid_rows, _TEXELS, _LEVEL[None], False, _IMAGE, _LINE, _LINE, _IMAGE, _IMAGE[None], _IMAGE, _IMAGE,
        0.0, _IMAGE,
    )  # fmt: skip


@cache
def pair_loop() -> Any:
    """``pair_rows``."""
    return _driver(
        _kernels.pair_rows, _TEXELS, _LEVEL, 0, False, False, _IMAGE, _INDEX, _IMAGE[None], _IMAGE[None], _IMAGE,
        _LINE, _LINE, _LINE, _LINE, _TEXELS[None, None], _IMAGE, _LINE, functions=(*_FUNCTIONS, _kernels.shade_type),
    )  # fmt: skip


_SURROUNDINGS = (np.zeros((9, 1), np.float32), np.zeros((1, 1, 4), np.float32), np.zeros((1, 2, 9, 3), np.float32))
_AROUND = (
    _kernels.log_normalisation_type,
    _environment_kernels.shade_directions_type,
    _environment_kernels.shade_matt_type,
    _environment_kernels.look_around_type,
)


@cache
def environment_reference_loop() -> Any:
    """``environment_reference_rows``."""
    return _driver(
        _environment_kernels.environment_reference_rows, _TEXELS, _LEVEL, 0, False, False, _IMAGE, _INDEX, _INDEX,
        _INDEX, _INDEX, _IMAGE, _IMAGE[None], *_SURROUNDINGS, _LINE, _LINE, _LINE, _LINE, 0, _IMAGE, functions=_AROUND,
    )  # fmt: skip


@cache
def environment_pyramid_loop() -> Any:
    """``environment_pyramid_rows``."""
    return _driver(
        _environment_kernels.environment_pyramid_rows, _TEXELS, _LEVEL[None], False, _IMAGE, _LINE, _LINE, _INDEX,
        _INDEX, _IMAGE, _IMAGE[None], *_SURROUNDINGS, 0, 0, _IMAGE, functions=_AROUND,
    )  # fmt: skip
