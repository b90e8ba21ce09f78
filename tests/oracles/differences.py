"""Slopes of functions by central differences."""

import numpy as np


def slopes(function, x, step=1e-6):
    """Return the derivatives of a function at `x` by each of its numbers: an array of the shape of x, then of f(x)."""
    found = []
    for at in np.ndindex(x.shape):
        aside = np.zeros(x.shape)
        aside[at] = step
        found.append((function(x + aside) - function(x - aside)) / (2 * step))
    return np.reshape(found, x.shape + np.shape(found[0]))
