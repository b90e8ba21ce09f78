"""What the part `add_pull` of the danger's kernels adds up to, for batches."""

import numpy as np

from safe_ompl.common import FloatArray, IntArray, compiled
from safe_ompl.danger.kernels.field import Skeleton, add_pull, new_block
from safe_ompl.danger.link_field import by_length, columns
from safe_ompl.robot import plain


@compiled
def _pulls(places: FloatArray, links: IntArray, points: FloatArray, weights: FloatArray, by_length: bool) -> FloatArray:
    """Return the gradients (B, K, 3) of Σ_m w_m CDF(p_m) by the key points; weights (B, M)."""
    out, block = np.zeros(places.shape), new_block(places.shape[1])
    for b in range(len(places)):
        skeleton, at = Skeleton(places[b], links, by_length, block), points[b if len(points) > 1 else 0]
        for m in range(points.shape[2]):
            if weights[b, m] != 0.0:
                add_pull(skeleton, at, m, weights[b, m], out[b])
    return out


def keypoint_gradient(keypoints, segments, points, weights, *, weighting="unit"):
    """Return the gradient (B, K, 3) of Σ_m w_m CDF(p_m) by the key points, `weights: (B, M)`, with k₁ = 1."""
    return _pulls(plain(keypoints), segments.pairs, columns(points), plain(weights), by_length(weighting))
