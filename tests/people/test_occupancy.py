"""Nothing that keeps to the speed is ever outside of what a grid holds occupied; points of the robot are left out."""

from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import (
    Box,
    InputError,
    Obstacle,
    People,
    Pose,
    RateLimits,
    Scene,
    Shield,
    Surroundings,
    Tracker,
    UnknownNameError,
    check,
    time_path,
)
from safe_ompl.collision import robot_points
from safe_ompl.geometry import STANDING, bounding_hull, hull_planes
from safe_ompl.people import (
    DepthCamera,
    DepthFrame,
    OccupancyGrid,
    OccupancyOptions,
    TrackedBody,
    looking,
    read_cameras,
)
from safe_ompl.people.kernels.cells import Cells, opened, spread
from safe_ompl.people.kernels.depth import NODE, SeenImage, View, clear_seen, cloud_blocks, image_blocks, pyramid
from safe_ompl.people.occupancy import _packed
from safe_ompl.people.simulation.movers import ALL_KEYPOINTS

SIZE = 160, 120
Q = np.array([0.3, -0.5, 0.2, -2.0, 0.1, 1.8, 0.7])
WALL = 5.5  # [m] depth behind all
BODY = TrackedBody()
FLOOR = Scene((Obstacle("floor", Box((4, 4, 0.1)), Pose((0, 0, -0.6))),))


def camera(place, at, **more):
    """Return a camera at a place that looks at a point."""
    own = {"block": 2, "noise": (0.0, 0.0), **more}
    return DepthCamera(*SIZE, (110.0, 110.0), (79.5, 59.5), looking(place, at), **own)


CAMERAS = {"left": camera((1.8, -1.2, 1.2), (0, 0, 0.3)), "right": camera((1.8, 1.2, 1.2), (0, 0, 0.3))}
SMALL = {"width": 64, "height": 48, "focal": (44.0, 44.0), "middle": (31.5, 23.5), "block": 1}
EYES = {name: replace(one, **SMALL) for name, one in CAMERAS.items()}  # which see the same in fewer pixels


def rays_of(camera):
    """Return the way to what each pixel sees at a depth of 1 m, (height, width, 3)."""
    v, u = np.mgrid[: camera.height, : camera.width]
    slopes = (u - camera.middle[0]) / camera.focal[0], (v - camera.middle[1]) / camera.focal[1]
    return np.stack([*slopes, np.ones_like(u)], axis=-1)


def image(of, balls):
    """Return the depths of balls (centre, radius) in front of a wall, without the robot."""
    place, rays = of.pose.se3.inverse(), rays_of(of)
    depths = np.full((of.height, of.width), WALL)
    for centre, radius in balls:
        c = place.act(np.array(centre, dtype=float))
        a, b = (rays**2).sum(axis=-1), rays @ c
        inside = b * b - a * (c @ c - radius**2)
        near = (b - np.sqrt(np.maximum(inside, 0))) / a
        depths = np.where((inside >= 0) & (near > 0), np.minimum(depths, near), depths)
    return depths


def robot_image(of, robot, q):
    """Return the depths of the robot's convex bodies, infinite beside them."""
    data, place, rays = robot.model.createData(), of.pose.se3.inverse(), rays_of(of)
    pin.forwardKinematics(robot.model, data, robot.pinocchio_configuration(q))
    depths = np.full((of.height, of.width), np.inf)
    for body in robot.collision_model.geometryObjects:
        if isinstance(body.geometry, coal.Convex):
            normals, heights = hull_planes(body.geometry)
            there = place * data.oMi[int(body.parentJoint)] * body.placement
            normals, heights = normals @ there.rotation.T, heights + normals @ there.rotation.T @ there.translation
            slopes = rays @ normals.T
            with np.errstate(divide="ignore"):
                crossed = heights / slopes
            enter = np.where(slopes < 0, crossed, -np.inf).max(axis=-1)
            leave = np.where(slopes > 0, crossed, np.inf).min(axis=-1)
            depths = np.where(enter < leave, np.minimum(depths, enter), depths)
    return depths


def skin(robot, step=1):
    """Return corners of the robot's hulls in the world."""
    data, found = robot.model.createData(), []
    pin.forwardKinematics(robot.model, data, robot.pinocchio_configuration(Q))
    for body in robot.collision_model.geometryObjects:
        place = data.oMi[int(body.parentJoint)] * body.placement
        found.append(bounding_hull(body.geometry).points[::step] @ place.rotation.T + place.translation)
    return np.concatenate(found)


def grid_of(robot, scene=FLOOR, cameras=CAMERAS, **more):
    return OccupancyGrid(robot, scene, cameras, OccupancyOptions(**{"min_points": 1, "edge": 0.1, **more}))


@pytest.mark.parametrize("seed", range(4))
def test_nothing_that_keeps_to_the_speed_leaves_what_may_be_occupied(panda, seed):
    rng, speed = np.random.default_rng(seed), 1.0
    grid = grid_of(panda, speed=speed)
    radius, times = 0.15, {"left": 0.0, "right": 0.0}
    way = np.array([[1.5, 0.8 * (-1) ** seed, 0.8], [0.6, -0.6, 0.9], [0.5, 0.9, 0.1], [0.7, -0.1, 0.5]])
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1)))

    def place(t):
        return np.array([np.interp(speed * t, lengths, along) for along in way.T])

    directions = rng.normal(size=(400, 3))
    points = radius * directions / np.linalg.norm(directions, axis=1)[:, None]
    now, covered = 0.0, 0
    while speed * now < lengths[-1]:
        now += rng.uniform(0.01, 0.12)
        which = str(rng.choice(["left", "right", "none", "both"]))
        for name in {"both": ["left", "right"], "none": []}.get(which, [which]):
            late = now - rng.choice([0.0, 0.05])
            if late > times[name]:
                times[name] = late
                grid.observe(name, DepthFrame(image(CAMERAS[name], [(place(late), radius)]), late, Q), now)
        if not grid.known:
            continue
        sets, body = grid.sets(now), place(now) + points
        least = np.full(len(body), np.inf)
        for centre, r, grown in zip(sets.points, sets.radii, sets.grown(0.0), strict=True):
            least = np.minimum(least, np.linalg.norm(body - centre, axis=1) - r - grown)
        index = np.floor((body - grid.cells.low) / grid.cells.edge).astype(int)
        within = ((index >= 0) & (index < grid.cells.side)).all(axis=1)
        deep = np.zeros(len(body), dtype=bool)
        deep[within] = grid.occupied[tuple(index[within].T)]
        free = within & ~deep & (least > 1e-9)
        shell = np.sqrt(3) * grid.cells.edge + grid.options.margin  # which may be taken for the robot's, unseen
        free[free] = ~robot_points(body[free], panda, Q, shell) if free.any() else False
        assert not free.any(), (now, body[free][0])
        covered += int((within & (least <= 1e-9)).sum())
    assert covered > 1000


def test_what_is_left_out_is_a_shell_about_the_robot_and_no_more(panda):
    rng = np.random.default_rng(0)
    eye = camera((2.4, 0.0, 0.6), (0, 0, 0.5), error=0.0, block=1)
    margin = 0.03
    points = skin(panda)[rng.integers(0, len(skin(panda)), 600)] + rng.normal(0, 0.04, (600, 3))
    seen = np.zeros(len(points), dtype=int)
    grid = grid_of(panda, Scene(()), {"eye": eye}, unseen="free", margin=margin)
    for k, point in enumerate(points):
        own = eye.pose.se3.actInv(point)
        pixel = np.rint([own[0] / own[2] * 110 + 79.5, own[1] / own[2] * 110 + 59.5]) - (79.5, 59.5)
        points[k] = eye.pose.se3.act(np.array([*(pixel / 110 * own[2]), own[2]]))  # where a pixel can be
        grid.observe("eye", DepthFrame(eye.pose.se3.actInv(points[k])[None], float(k), Q), 1e3)
        seen[k] = grid.occupied.sum()
    near, far = (robot_points(points, panda, Q, m) for m in (0.9 * margin, margin + 1e-4))  # to 0.9 of it bounds decide
    assert not seen[near].any()
    assert (seen[~far] == 1).all()
    assert min(near.sum(), (~far).sum()) > 100


def test_a_robot_goes_on_until_something_may_come_to_it_seen_or_not(panda):
    """A ball comes nearer, then no camera sees anything any more."""
    arm = panda.with_accelerations(dict.fromkeys(panda.joint_names, 10.0))

    def drive(ball, blind):
        shield = Shield(arm, Surroundings(FLOOR, depth=grid_of(panda, FLOOR, EYES, clear=2.0, edge=0.1)))
        shield.start(Q)
        for k in range(14):
            now = 0.1 * k
            q = Q if shield._last is None else shield._last.at(now).q
            seen = {n: np.minimum(robot_image(eye, panda, q), image(eye, ball(now))) for n, eye in EYES.items()}
            shield.update({}, {}, now, {} if now >= blind else {n: DepthFrame(seen[n], now, q) for n in seen})
            shield.propose_velocity([0.3, 0, 0, 0, 0, 0, 0])
            command = shield.command(now + 0.01)
        return command

    assert drive(lambda now: [], np.inf).follows
    near = drive(lambda now: [((1.3 - 0.5 * now, 0.1, 0.5), 0.15)], np.inf)
    assert not near.follows
    assert "may come to panda" in near.reason
    unseen = drive(lambda now: [], 0.4)
    assert not unseen.follows
    assert unseen.reason.startswith("'unseen space' may come to")


def person_at(x, y):
    """Return key points (17, 3) of a person who stands there with raised arms, and balls that fill the limbs."""
    points = np.array(list(STANDING.values())) * BODY.height
    points = points - [0, 0, points[:, 2].max() - 1.0] + [x, y, 0.0]
    ends = BODY.ends(points)
    shares = np.linspace(0, 1, 8)[:, None]
    balls = [
        (at, radius)
        for (start, end), radius in zip(ends, BODY.radii(ends).tolist(), strict=True)
        for at in start + shares * (end - start)
    ]
    return points, balls


def test_a_tracked_person_bounds_only_what_is_seen_of_them(panda):
    points, balls = person_at(0.75, 0.1)
    rules = People(speed=0.5)
    track, seen = Tracker(ALL_KEYPOINTS, BODY, noise=0.01), {n: image(eye, balls) for n, eye in CAMERAS.items()}

    def both(shift):
        """Return the sets of the cells without and with the track."""
        grid = grid_of(panda, speed=2.0, clear=2.0, edge=0.05)
        around = Surroundings(FLOOR, {"anna": track}, people=rules, depth=grid)
        for k in range(6):  # the person has come from somewhere
            now = 0.05 * k
            around.update({"anna": points + shift}, {}, now + 0.02, {n: DepthFrame(seen[n], now, Q) for n in seen})
        alone = grid.sets(now + 0.02)
        k = len(around.sets.names) - len(alone.names)
        assert around.sets.names[k:] == alone.names
        np.testing.assert_array_equal(around.sets.points[-len(alone.points) :], alone.points)
        np.testing.assert_array_equal(around.sets.radii[k:], alone.radii)
        return alone, around.sets.grown(0.3)[k:]

    alone, sharp = both(np.zeros(3))
    known = sharp < alone.grown(0.3) - 1e-9
    np.testing.assert_allclose(sharp[known], 0.01 + 0.5 * (0.3 + 0.02))  # noise and age of the image
    assert (alone.grown(0.3)[~known] == sharp[~known]).all()
    centres = np.array([centre for centre, _ in balls])
    away = np.linalg.norm(alone.points[known, None] - centres, axis=2) - np.array([radius for _, radius in balls])
    assert (away.min(axis=1) < 0.01 + CAMERAS["left"].error + 2 * np.sqrt(0.75) * 0.05 + alone.radii[known]).all()
    assert known.sum() > 30
    for way in [*np.eye(3), *-np.eye(3)]:  # a track that is wrong bounds nothing
        alone, sharp = both(way)
        np.testing.assert_array_equal(sharp, alone.grown(0.3))


def test_a_robot_does_no_less_beside_a_person_who_is_tracked_besides(panda):
    arm = panda.with_accelerations(dict.fromkeys(panda.joint_names, 10.0))

    def turned(tracked, shift=0.0):
        """Return how far the first joint turns in 1 s."""
        trackers = {"anna": Tracker(ALL_KEYPOINTS, BODY)} if tracked else {}
        grid = grid_of(panda, FLOOR, EYES, clear=2.0, speed=2.0, edge=0.05)
        shield = Shield(arm, Surroundings(FLOOR, trackers, people=People(speed=0.2), depth=grid))
        shield.start(Q)
        for k in range(10):
            now = 0.1 * k
            q = Q if shield._last is None else shield._last.at(now).q
            points, balls = person_at(1.15 - 0.02 * now, 0.1)
            seen = {n: np.minimum(robot_image(eye, panda, q), image(eye, balls)) for n, eye in EYES.items()}
            people = {"anna": points + shift} if tracked else {}
            shield.update(people, {}, now, {n: DepthFrame(seen[n], now, q) for n in seen})
            shield.propose_velocity([0.8, 0, 0, 0, 0, 0, 0])
            command = shield.command(now + 0.01)
        return command.at(now + 0.1).q[0] - Q[0]

    alone = turned(False)
    assert 0.1 < alone <= turned(True) + 1e-9
    assert turned(True, 1.0) <= alone + 1e-9


def test_what_cannot_be_is_one_line_and_changes_nothing(panda):
    grid = grid_of(panda, FLOOR, CAMERAS)
    around = Surroundings(FLOOR, depth=grid)
    good = image(CAMERAS["left"], [])
    for name, frame, message in (
        ("top", DepthFrame(good, 0.0, Q), "unknown camera 'top'; known: left, right"),
        ("left", DepthFrame(good[:10], 0.0, Q), r"depth\.left\.depths: must have shape \(120, 160\) or \(N, 3\), got"),
        ("left", DepthFrame(np.full_like(good, np.nan), 0.0, Q), r"left\.depths: shows nothing between 0\.2 and 6 m"),
        ("left", DepthFrame(np.zeros((0, 3)), 0.0, Q), r"left\.depths: shows nothing"),
        ("left", DepthFrame(np.full((5, 3), np.inf), 0.0, Q), r"left\.depths: shows nothing"),
        ("left", DepthFrame(good > 1, 0.0, Q), r"left\.depths: must be numbers, got bool"),
        ("left", DepthFrame(good, np.nan, Q), r"left\.time: must be a finite number, got nan"),
        ("left", DepthFrame(good, 2.0, Q), r"left\.time: is 1\.000 s in the future"),
        ("left", DepthFrame(good, 0.0, Q[:3]), r"left\.q: must have shape \(7\), got \(3,\)"),
    ):
        with pytest.raises(InputError, match=message):
            around.update({}, {}, 1.0, {name: frame})
    assert not grid.known
    assert around.trouble(1.0, 0.5) == "'left' shows nothing yet"
    around.update({}, {}, 1.0, {"left": DepthFrame(good, 1.0, Q)})
    with pytest.raises(InputError, match=r"left\.time: must not go backwards: 0\.9 s after 1 s"):
        around.update({}, {}, 1.1, {"left": DepthFrame(good, 0.9, Q)})
    for values, message in (
        ({"focal": (0.0, 110.0)}, "focal: must be a positive number, got 0"),
        ({"middle": (300.0, 59.5)}, r"middle: \[300.0, 59.5\] lies outside of the image of 160 × 120 pixels"),
        ({"noise": (0.1,)}, "noise"),
        ({"far": 0.1}, "far: must be a finite number > 0.2"),
    ):
        with pytest.raises(InputError, match=message):
            DepthCamera(**{"width": 160, "height": 120, "focal": (110.0, 110.0), "middle": (79.5, 59.5), **values})
    for values, message in (
        ({"unseen": "maybe"}, "unseen: must be 'occupied' or 'free', got 'maybe'"),
        ({"edge": 0.01}, "edge: must be at least 0.025 for a reach of 1.6 m"),
        ({"min_points": 9}, "min_points: is more than the 4 pixels of a block of 'left'"),
    ):
        with pytest.raises(InputError, match=message):
            grid_of(panda, **values)
    with pytest.raises(InputError, match=r"depth: stand still for the grid: \('floor',\), but here: \(\)"):
        Surroundings(Scene(()), depth=grid)
    with pytest.raises(UnknownNameError):
        Surroundings(FLOOR).update({}, {}, 0.0, {"left": DepthFrame(good, 0.0, Q)})


def test_a_camera_that_sees_through_the_robot_or_falls_silent_stops_it(panda):
    around = Surroundings(FLOOR, depth=grid_of(panda, FLOOR, CAMERAS, unseen="free"))
    seen = {name: DepthFrame(image(one, []), 0.0, Q) for name, one in CAMERAS.items()}
    around.update({}, {}, 0.0, seen)
    assert "sees through panda_link" in around.trouble(0.0, 0.5)
    around = Surroundings(FLOOR, depth=grid_of(panda, FLOOR, EYES, unseen="free"))
    images = {name: np.minimum(robot_image(one, panda, Q), WALL) for name, one in EYES.items()}
    for k in range(7):
        millimetres = {name: np.rint(1e3 * depths).astype(np.uint16) for name, depths in images.items()}
        if k > 0:
            del millimetres["right"]
        frames = {name: DepthFrame(depths, 0.1 * k, Q) for name, depths in millimetres.items()}
        assert not around.update({}, {}, 0.1 * k, frames)
        assert around.trouble(0.1 * k, 0.5) == (None if k < 6 else "'right' shows nothing for 0.60 s")


def test_what_is_behind_a_camera_is_not_seen(panda):
    eye = camera((0.0, -1.0, 0.5), (0.0, 0.0, 0.5))
    grid = grid_of(panda, Scene(()), {"eye": eye}, clear=0.0)
    grid.observe("eye", DepthFrame(image(eye, []), 0.0, Q), 0.0)
    middles = grid.cells.low[1] + (np.arange(grid.cells.side) + 0.5) * grid.cells.edge
    assert grid.occupied[:, middles < -1.0].all()
    assert not grid.occupied.all()


@pytest.mark.parametrize("seed", range(3))
def test_cells_are_cleared_exactly_where_a_look_at_all_depths_says_so(seed):
    rng, edge, side, block = np.random.default_rng(seed), 0.1, 32, 2
    eye = camera(rng.uniform(-1.5, 1.5, 3), rng.uniform(-0.3, 0.3, 3))
    place = eye.pose.se3
    view = View(eye.focal, eye.middle, block, np.array(place.rotation, order="C"), np.array(place.translation))
    cells, radius = Cells(np.full(3, -1.6), edge, side), np.sqrt(0.75) * edge + 0.01
    windows = np.zeros(side**3 + (side // NODE) ** 3, dtype=np.intp)
    middles = -1.6 + edge * (np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1) + 0.5)
    x, y, z = np.moveaxis((middles - view.origin) @ view.rotation, -1, 0)
    near, far = z - radius, z + radius
    cleared = 0
    for _ in range(3):  # the same camera: windows are remembered
        balls = [(rng.uniform(-1.2, 1.2, 3), 0.3) for _ in range(4)]
        depths = image(eye, balls)[::block, ::block] - rng.uniform(0, 0.1, (60, 80)) * (rng.random((60, 80)) < 0.3)
        least, most = pyramid(depths)
        occupied = rng.random((side,) * 3) < 0.7
        expected = occupied.copy()
        for cell in np.argwhere(occupied).tolist():
            k = tuple(cell)
            if min(cell) == 0 or max(cell) == side - 1 or near[k] <= 0.1 * radius:
                continue
            spans = []
            for f, c, at in zip(eye.focal, eye.middle, (x[k], y[k]), strict=True):
                low, high = at - radius, at + radius
                spans += [(f * low / (near[k] if low < 0 else far[k]) + c + 0.5) / block]
                spans += [(f * high / (far[k] if high < 0 else near[k]) + c + 0.5) / block]
            a, b, c, d = spans
            if a < 0 or b >= 80 or c < 0 or d >= 60:
                continue
            j, i, level = np.array([a, b]).astype(int), np.array([c, d]).astype(int), 0
            while max(j[1] - j[0], i[1] - i[0]) > 4:
                j, i, level = j // 2, i // 2, level + 1
            expected[k] = least[level, 0, i[0] : i[1] + 1, j[0] : j[1] + 1].min() < far[k]
        words = _packed(occupied)
        clear_seen(SeenImage(view, least, most), cells, radius, windows, words)
        np.testing.assert_array_equal(words, _packed(expected))
        cleared += (~expected).sum()
    assert cleared > 0.35 * 3 * side**3


def test_blocks_have_their_smallest_depths():
    rng = np.random.default_rng(0)
    depths = np.round(rng.uniform(0, 7, (12, 20)), 1).astype(np.float32)
    depths[rng.random(depths.shape) < 0.1] = np.nan
    found, where = image_blocks(depths, 4, 3, 0.2, 6.0)
    used = np.where(depths >= np.float32(0.2), np.minimum(depths, np.float32(6.0)), np.float32(0))
    for i, j in np.ndindex(3, 5):
        block = used[4 * i : 4 * i + 4, 4 * j : 4 * j + 4]
        smallest = np.sort(block, axis=None)
        assert found[i, j] == smallest[2]
        v, u = np.argwhere(block == smallest[2])[0]
        assert where[i, j] == (4 * i + v) * 20 + 4 * j + u - depths.size * (smallest[2] - smallest[0] > 0.05)


def test_blocks_of_a_cloud_have_their_smallest_depths():
    rng = np.random.default_rng(0)
    depths = rng.uniform(0, 7, (48, 80))
    depths[rng.random(depths.shape) < 0.6] = np.nan
    view = View((60.0, 60.0), (39.5, 23.5), 4, np.eye(3), np.zeros(3))
    v, u = np.mgrid[:48, :80]
    points = np.stack([(u - 39.5) / 60 * depths, (v - 23.5) / 60 * depths, depths], axis=-1).reshape(-1, 3)
    points = np.concatenate([points, [[np.inf, 0, 1], [0, np.nan, 1], [50, 0, 1], [0, 0, -1], [0, 0, np.inf]]])
    found, where = cloud_blocks(rng.permutation(points), view, (48, 80), 3, 0.2, 6.0)
    kept = np.where(depths >= 0.2, np.minimum(depths, 6.0), np.inf)
    shown = 0
    for i, j in np.ndindex(12, 20):
        block = kept[4 * i : 4 * i + 4, 4 * j : 4 * j + 4]
        first, _, third = np.sort(block, axis=None)[:3]
        assert found[i, j] == pytest.approx(third if third < np.inf else 0.0, rel=2**-28)
        assert found[i, j] <= third
        if third < 6.0:
            row, column = np.argwhere(block == third)[0]
            assert where[i, j] == (4 * i + row) * 80 + 4 * j + column - depths.size * (third - first > 0.05)
            shown += 1
    assert 100 < shown < 240


@pytest.mark.parametrize("side", [32, 80])
def test_cells_grow_to_all_neighbours_and_thin_ones_are_left_out(side):
    rng = np.random.default_rng(0)
    cells, among = rng.random((side,) * 3) < 0.01, rng.random((side,) * 3) < 0.8
    words, shifts = _packed(cells), list(np.ndindex(3, 3, 3))
    spread(words, _packed(among), 2)
    for _ in range(2):
        wide = np.pad(cells, 1)
        near = [wide[i : i + side, j : j + side, k : k + side] for i, j, k in shifts]
        cells = np.logical_or.reduce(near) & among
    np.testing.assert_array_equal(words, _packed(cells))
    cubes, wide = list(np.ndindex(2, 2, 2)), rng.random((side,) * 3) < 0.7
    core = np.logical_and.reduce([wide[i : side - 1 + i, j : side - 1 + j, k : side - 1 + k] for i, j, k in cubes])
    thick = np.zeros_like(wide)
    for i, j, k in cubes:
        thick[i : side - 1 + i, j : side - 1 + j, k : side - 1 + k] |= core
    np.testing.assert_array_equal(opened(_packed(wide)), _packed(thick))
    assert thick.any()


def test_a_motion_is_proven_to_stop_beside_what_cameras_see_and_do_not_see(panda):
    limits, end = RateLimits.of(panda, acceleration=10.0), Q + np.array([0.8, 0, 0, 0, 0, 0, 0])
    motion = time_path([Q, end], panda, limits)

    def seen(*balls, **options):
        grid = grid_of(panda, FLOOR, CAMERAS, **{"clear": 2.0, "speed": 1.0, **options})
        for name, eye in CAMERAS.items():
            depths = np.minimum(robot_image(eye, panda, Q), image(eye, balls))
            grid.observe(name, DepthFrame(depths, 0.0, Q), 0.0)
        return grid

    free = seen()
    assert check(motion, panda, FLOOR, limits=limits, people=free)
    near = check(motion, panda, FLOOR, limits=limits, people=seen(((0.75, 0.3, 0.45), 0.1)))
    assert {violation.kind for violation in near.violations} == {"separation"}
    assert near.violations[0].names[1].startswith("something seen")
    unseen = check(motion, panda, FLOOR, limits=limits, people=seen(clear=0.2))
    assert any(violation.names[1].startswith("unseen space") for violation in unseen.violations)
    scene, people = free.people(People(clearance=0.5, reaction_time=0.3))
    assert (people.clearance, people.reaction_time, people.speed) == (0.5, 0.3, 1.0)
    assert not check(motion, panda, scene, limits=limits, people=people)
    with pytest.raises(InputError, match="depth: 'left' shows nothing yet"):
        check(motion, panda, FLOOR, limits=limits, people=grid_of(panda))
    with pytest.raises(InputError, match=r"depth: stand still for the grid: \('floor',\), but here: \(\)"):
        check(motion, panda, Scene(()), limits=limits, people=free)


def test_cameras_of_a_file_are_those_it_says_or_one_line(tmp_path):
    good = {"size": "[160, 120]", "focal": "[110, 110]", "position": "[1.8, -1.2, 1.2]", "at": "[0, 0, 0.3]"}

    def read(**changes):
        keys = {key: value for key, value in {**good, **changes}.items() if value is not None}
        text = "".join(f"    {key}: {value}\n" for key, value in keys.items())
        (tmp_path / "cameras.yaml").write_text(f"cameras:\n  left:\n{text}")
        return read_cameras(tmp_path / "cameras.yaml")["left"]

    assert read(block="2", noise="[0, 0]") == CAMERAS["left"]
    turned = read(at=None, quaternion_xyzw="[-0.5, -0.5, 0.5, 0.5]", rate="15", middle="[80, 60]")
    assert (turned.pose.quaternion_xyzw, turned.rate, turned.middle) == ((-0.5, -0.5, 0.5, 0.5), 15.0, (80.0, 60.0))
    for changes, message in (
        ({"position": None}, "cameras.left.position: missing, but needed"),
        ({"focal": "[0, 110]"}, r"cameras\.left\.focal: must be a positive number, got 0"),
        ({"focal": "[.nan, 110]"}, r"cameras\.left\.focal: must be a finite number, got nan"),
        ({"middle": "[200, 60]"}, r"middle: \[200\.0, 60\.0\] lies outside of the image of 160 × 120 pixels"),
        ({"size": "[160.5, 120]"}, r"size\[0\]: must be a whole number"),
        ({"rate": "0"}, "rate: must be a positive number, got 0"),
        ({"at": "[1.8, -1.2, 0]"}, r"at: must not be above or below \[1\.8, -1\.2, 1\.2\]"),
        ({"colour": "red"}, r"cameras.yaml:7: cameras\.left\.colour: unknown key"),
    ):
        with pytest.raises(InputError, match=message):
            read(**changes)
