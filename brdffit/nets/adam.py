"""Adam (Kingma and Ba 2015) for a flat vector of weights, as one kernel."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import kernel


@kernel
def _step(weights, gradient, mean, square, rate, beta1, beta2, epsilon):
    """One step; the gradient is cleared."""
    one = np.float32(1.0)
    for i in range(weights.size):
        g = gradient[i]
        mean[i] = beta1 * mean[i] + (one - beta1) * g
        square[i] = beta2 * square[i] + (one - beta2) * g * g
        weights[i] -= rate * mean[i] / (np.sqrt(square[i]) + epsilon)
        gradient[i] = np.float32(0.0)


class Adam:
    """State of the optimiser for a vector of ``size`` weights.

    With moments m and v of the gradient, a step subtracts rate * m' / (sqrt(v') + epsilon), m' = m / (1 - beta1^t) and
    v' = v / (1 - beta2^t); the corrections are folded into rate and epsilon.
    """

    def __init__(self, size: int, betas: tuple[float, float] = (0.9, 0.99), epsilon: float = 1e-8) -> None:
        self.betas, self.epsilon, self.steps = betas, epsilon, 0
        self.mean, self.square = np.zeros(size, np.float32), np.zeros(size, np.float32)

    def step(self, weights: NDArray, gradient: NDArray, rate: float) -> None:
        """One step on ``weights`` (size,) float32, in place; ``gradient`` is cleared."""
        self.steps += 1
        beta1, beta2 = self.betas
        root = math.sqrt(1.0 - beta2**self.steps)
        single = np.float32
        _step(
            weights, gradient, self.mean, self.square, single(rate * root / (1.0 - beta1**self.steps)), single(beta1),
            single(beta2), single(self.epsilon * root),
        )  # fmt: skip
