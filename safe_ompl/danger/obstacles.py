"""The obstacles whose surfaces are dangerous to approach, and their danger points wherever they go."""

from __future__ import annotations

from safe_ompl.arrays import FloatArray
from safe_ompl.errors import InputError
from safe_ompl.scene.scene import Scene


class DangerousObstacles:
    """The danger points of a scene, and of scenes in which nothing but places of obstacles differs.

    Parameters
    ----------
    scene : Scene
        The obstacles.
    spacing : float, optional
        Distance between danger points [m]; default: the scene's own.
    """

    def __init__(self, scene: Scene, spacing: float | None = None) -> None:
        self._scene = scene
        self._spacing = spacing

    @property
    def points(self) -> tuple[FloatArray, FloatArray]:
        """Points (M, 3) [m] and their weights (M,), as `Scene.danger_points`."""
        return self._scene.danger_points(self._spacing)[:2]

    def move(self, scene: Scene) -> bool:
        """Take the places of another scene; return whether a dangerous obstacle is elsewhere.

        Raises
        ------
        InputError
            If anything but places differs. Then all stays as it was.
        """
        before = self._scene
        if scene.names != before.names or scene.spacing != before.spacing:
            raise InputError(f"must have the same obstacles and spacing as {before!r}, got {scene!r}")
        moved = [(old, new) for old, new in zip(before, scene, strict=True) if old is not new and old != new]
        for old, new in moved:
            if not old.same_but_for_place(new):
                raise InputError(f"{old.name!r} may move, but not become another: {old!r} to {new!r}")
        self._scene = scene
        return any(new.weight > 0 for _, new in moved)

    def replace(self, scene: Scene) -> bool:
        """Take any other scene; return whether what is dangerous differs."""
        known = [[o for o in s if o.weight > 0] for s in (self._scene, scene)]
        changed = known[0] != known[1] or scene.spacing != self._scene.spacing
        self._scene = scene
        return changed
