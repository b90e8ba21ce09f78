"""Obstacles that are added, removed and moved in a setup, which then plans in the scene as it is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.separation import Separation
from safe_ompl.errors import InputError
from safe_ompl.scene.obstacle import Obstacle
from safe_ompl.scene.scene import Scene
from safe_ompl.setup.wiring import WiredSetup


class SceneSetup(WiredSetup):
    """The part of `SafeSetup` whose scene changes; parameters as there.

    What a change makes untrue is forgotten: the solution, and what the planner has built. Whether start and goals are
    still free is found out when planning begins.
    """

    def addObstacle(self, obstacle: Obstacle) -> None:
        """Put one more obstacle into the scene.

        Raises
        ------
        InputError
            If it is none, or its name is taken.
        UnknownNameError
            If a limit is about an obstacle that there is not any more; so do the others.
        """
        self.setScene(self.scene.with_obstacles(obstacle))

    def removeObstacle(self, name: str) -> None:
        """Take an obstacle out of the scene; raise UnknownNameError if there is none of that name."""
        self.setScene(self.scene.without(name))

    def moveObstacle(self, name: str, place: Any) -> None:
        """Move one obstacle; errors as `Scene.moved`.

        Parameters
        ----------
        name : str
            Its name.
        place : Pose, pin.SE3, array_like or mapping
            As in `Scene.moved`: a pose, or the key points of a person, or the points of a cloud.
        """
        self.moveObstacles({name: place})

    def moveObstacles(self, places: Mapping[str, Any]) -> None:
        """Move several obstacles at once; places and errors as `Scene.moved`."""
        self.setScene(self.scene.moved(places))

    def setScene(self, scene: Scene) -> None:
        """Plan in another scene from here on, with all limits that are set.

        Where nothing differs but places of obstacles that were `movable`, or have moved before, it takes a millisecond;
        else the checker is made anew.

        Raises
        ------
        InputError
            If it is no scene.
        UnknownNameError
            If a limit is about an obstacle that it does not have. Then the scene stays what it was.
        """
        if not isinstance(scene, Scene):
            raise InputError(f"must be a Scene, got {scene!r}")
        before = self.checker
        try:
            self.checker.move(scene)
        except InputError:  # more than places of movable obstacles differs
            self._take_checker_of(scene)
        if self.field is not None:
            self.field.stand_in(scene)
        self.scene = scene
        self.clear()
        self._scene_changed(same_checker=self.checker is before)

    def _take_checker_of(self, scene: Scene) -> None:
        """Make a checker for a scene, to whom those obstacles may move that have done so."""
        moved = {o.name for o in self.scene if o.name in scene.names and o != scene[o.name]}
        movable = [name for name in scene.names if name in moved | self.checker.movable]
        checker = CollisionChecker(self.robot, scene, self.counts, movable=movable)
        separation = self._separation_in(checker)
        for plugin in (self._validity, self._validator):
            plugin.setChecker(checker, separation)
        self.checker = checker

    def _separation_in(self, checker: CollisionChecker) -> Separation:
        """Return what must be kept from obstacles in another scene; raise UnknownNameError where one is gone."""
        raise NotImplementedError  # see `LimitedSetup`

    def _scene_changed(self, *, same_checker: bool) -> None:
        """Forget what followed from another scene; see the classes above."""
