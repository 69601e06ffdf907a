"""Compilation: what a kernel that does not count references may return."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from brdffit import _jit


class Pair(NamedTuple):
    row: np.ndarray
    weight: float


def pair_of(array):
    return Pair(array[0], 2.0)


@pytest.mark.parametrize("decorate", [_jit.kernel, _jit.inline])
def test_a_tuple_of_arrays_that_nobody_counts_is_not_returned(decorate, monkeypatch):
    """The caller would free them too early, and the process would die much later. Numba refuses plain arrays itself."""
    monkeypatch.setitem(_jit._FLAGS, "cache", False)
    with pytest.raises(TypeError, match="pair_of returns an array without counting it"):
        decorate(pair_of)(np.ones((2, 2)))


def test_a_part_and_an_allocating_kernel_may_return_arrays(monkeypatch):
    monkeypatch.setitem(_jit._FLAGS, "cache", False)
    part = _jit.part(pair_of)

    def total(array):
        sums = np.zeros(2)
        for _ in range(1000):
            pair = part(array)
            sums += pair.weight * pair.row
        return sums

    array = np.ones((2, 2))
    np.testing.assert_array_equal(_jit.kernel(total)(array), [2000.0, 2000.0])
