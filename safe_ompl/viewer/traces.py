"""Ways of the tip in a view: plain, and in stripes of the intervals that prove them."""

from __future__ import annotations

from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.exchange.timed_motion import ACCELERATION, TimedMotion
from safe_ompl.pictures.style import Colour, cap_colours
from safe_ompl.robot.robot import Robot
from safe_ompl.viewer import colours
from safe_ompl.viewer.proof import Proof


def add_trace(view: Any, name: str, points: FloatArray, colour: Colour) -> Any:
    """Add a line through `points: (P, 3)` [m]."""
    segments = np.stack([points[:-1], points[1:]], axis=1)
    return view.add_line_segments(name, segments, colours.rgb(colour), thickness=0.008)


def add_timed_trace(view: Any, name: str, motion: TimedMotion) -> Any:
    """Add the way of the tip, each piece in the colour of what bounds the speed there."""
    points = np.asarray(motion.robot.keypoints_batch(motion.configurations)[:, -1])
    paints = cap_colours([*motion.bounds, *filter(None, motion.binding)])
    paint = colours.as_bytes(np.array([paints[bound or ACCELERATION] for bound in motion.binding[:-1]]))
    segments = np.stack([points[:-1], points[1:]], axis=1)
    return view.add_line_segments(name, segments, np.repeat(paint[:, None], 2, axis=1), thickness=0.014)


def add_proof(view: Any, name: str, robot: Robot, samples: FloatArray, proof: Proof) -> Any:
    """Add the way of the tip, in stripes of the proof's intervals: the warmer, the nearer two bodies come.

    Parameters
    ----------
    samples : (S, n) array
        The path at equal steps of its length.
    """
    points = np.asarray(robot.keypoints_batch(samples)[:, -1])
    middles = (np.arange(len(samples) - 1) + 0.5) / max(1, len(samples) - 1)
    numbers = np.clip(np.searchsorted(proof.stops, middles, side="right") - 1, 0, len(proof.intervals) - 1)
    gaps = np.array([interval.distance for interval in proof.intervals])[numbers]
    paint = colours.of_gaps(gaps)
    paint = np.where((numbers % 2 == 0)[:, None], paint, (0.72 * paint).astype(np.uint8))
    segments = np.stack([points[:-1], points[1:]], axis=1)
    return view.add_line_segments(name, segments, np.repeat(paint[:, None], 2, axis=1), thickness=0.02)
