"""Contact: what limbs bear, and an adversary who puts a hand into every gap of the robot."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import People, Scenario
from safe_ompl.motions import BodySpeeds, ContactLimits, RateLimits, contact_speed, time_path
from safe_ompl.motions.contact import limb_thickness
from safe_ompl.scene.constraints import CONTACT_TABLE

LIMBS = (("anna", "right_hand"), ("anna", "torso"), ("anna", "head"), ("box", ""))


def cells_of(robot, path, step=0.05):
    curve = time_path(path, robot, RateLimits.of(robot, 1.0, 1.0)).curve
    cells = curve.cells(step)
    return curve, cells, BodySpeeds(robot).bounds(curve, cells)


def speeds_of(limits, robot, curve, cells, bodies):
    moving = [k for k, body in enumerate(robot.collision_model.geometryObjects) if body.parentJoint]
    return limits.speeds(curve.places(cells.centres).q, cells.sizes, cells.dq_ds, bodies[:, moving])


class Adversary:
    """Puts balls as thick as a limb between a link and whatever is near it, at corners of the link and in between."""

    def __init__(self, robot, still):
        self.robot, self.model = robot, robot.model
        self.geometry = robot.collision_model.copy()
        for obstacle in still:
            for part, shape, place in obstacle.geometries():
                self.geometry.addGeometryObject(pin.GeometryObject(f"still {part}", 0, place, shape))
        self.bodies = list(self.geometry.geometryObjects)
        self.moving = [k for k, body in enumerate(self.bodies) if body.parentJoint]
        self.kinematics, self.data = self.model.createData(), self.geometry.createData()

    def place(self, q, slope):
        full, rates = self.robot.pinocchio_configuration(q), self.robot.coupling.motions(slope)
        pin.forwardKinematics(self.model, self.kinematics, full, rates)
        pin.updateGeometryPlacements(self.model, self.kinematics, self.geometry, self.data)

    def velocity(self, body, point):
        motion = pin.getVelocity(self.model, self.kinematics, self.bodies[body].parentJoint, pin.WORLD)
        return motion.linear + np.cross(motion.angular, point)

    def nearest(self, shape, place, body):
        """Return distance and nearest points of a shape and a body."""
        there, result = self.data.oMg[body], coal.DistanceResult()
        first, second = (coal.Transform3s(at.rotation, at.translation) for at in (place, there))
        distance = coal.distance(shape, first, self.bodies[body].geometry, second, coal.DistanceRequest(), result)
        return distance, np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())

    def corners(self, body, rng):
        shape, place = self.bodies[body].geometry, self.data.oMg[body]
        if isinstance(shape, coal.Box):
            half = shape.halfSide
            return [place.act(half * sign) for sign in rng.choice([-1.0, 1.0], (3, 3))]
        if not isinstance(shape, coal.ConvexBase):
            return []
        return [place.act(shape.point(int(k))) for k in rng.integers(0, shape.num_points, 3)]

    def closing(self, body, thickness, rng):
        """Return how fast gaps of a body close in which a limb fits, per unit of arc length [m/rad]."""
        found = 0.0
        for other in range(len(self.bodies)):
            if self.bodies[other].parentJoint == self.bodies[body].parentJoint:
                continue
            places = [self.nearest(self.bodies[body].geometry, self.data.oMg[body], other)]
            if places[0][0] > thickness:
                continue
            for corner in self.corners(body, rng):
                point = pin.SE3(np.eye(3), corner)
                distance, _, there = self.nearest(coal.Sphere(1e-6), point, other)
                places.append((distance, corner, there))
            for distance, here, there in places:
                if 1e-4 < distance <= thickness:
                    toward = (there - here) / np.linalg.norm(there - here)
                    rate = self.velocity(body, here) - self.velocity(other, there)
                    found = max(found, float(rate @ toward))
        return found


def swings(robot, slopes=6):
    """Return a path through random configurations."""
    rng = np.random.default_rng(3)
    return rng.uniform(robot.lower, robot.upper, (slopes, robot.n)) * 0.7


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_no_gap_in_which_a_hand_fits_closes_faster_than_it_bears(robot_named, name):
    robot = robot_named(name)
    scenario = Scenario.load({"panda": "panda_shelf", "ur5": "ur5_handover"}[name])
    still = scenario.scene.without(*(o.name for o in scenario.scene if o.weight > 0))
    limits = ContactLimits(robot, still, People(contact=True), LIMBS, {"anna": 1.75})
    curve, cells, bodies = cells_of(robot, swings(robot))
    most, free = speeds_of(limits, robot, curve, cells, bodies)
    assert (most <= free).all()
    assert (most[:, :, 2:] == 0).all()  # heads, and what is no person
    adversary, rng = Adversary(robot, still), np.random.default_rng(0)
    worst, unclamped, met = 0.0, 0.0, 0
    for k in rng.choice(len(cells), 40, replace=False):
        s = rng.uniform(cells.edges[k], cells.edges[k + 1])
        place = curve.places(np.array([s]))
        adversary.place(place.q[0], place.dq_ds[0])
        for g, body in enumerate(adversary.moving):
            closing = adversary.closing(body, limits.thickness[0], rng)
            worst = max(worst, closing * most[k, g, 0] / limits.bears_clamped[0])
            unclamped = max(unclamped, closing * free[k, g, 0] / limits.bears_clamped[0])
            met += closing > 0
    assert met > 50
    assert 0.2 < worst <= 1 + 1e-6
    assert unclamped > 1  # the adversary can win


def test_far_from_everything_a_hand_is_not_clamped_and_beside_movers_always(panda, shelf):
    still = shelf.scene.without("operator")
    # A heavy trunk bears no more free than clamped.
    arguments = panda, still, People(contact=True, regions={"chest": (280, 4, 25)}), LIMBS, {"anna": 1.75}
    path = [[0.0, -0.4, 0, -2.0, 0, 2.0, 0.785], [0.4, -0.4, 0, -2.0, 0, 2.0, 0.785]]
    found = cells_of(panda, path)
    most, free = speeds_of(ContactLimits(*arguments), panda, *found)
    tip = -1
    np.testing.assert_array_equal(most[:, tip, 0], free[:, tip, 0])
    assert (most[:, tip, 1] < free[:, tip, 1]).any()  # the trunk is as thick as the gap to the table
    everywhere, _ = speeds_of(ContactLimits(*arguments, always_clamped=True), panda, *found)
    assert (everywhere[..., :2] < free[..., :2]).all()
    assert (everywhere[..., :2] <= most[..., :2] * (1 + 1e-9)).all()


def test_speeds_that_are_borne():
    hand, chest = CONTACT_TABLE["hand"], CONTACT_TABLE["chest"]
    assert contact_speed(hand) == pytest.approx(280 / np.sqrt(0.6 * 75e3))
    assert contact_speed(hand, clamped_by=9.4) == pytest.approx(140 / np.sqrt(9.4 * 75e3))
    assert contact_speed(chest) == pytest.approx(280 / np.sqrt(40 * 25e3))
    assert contact_speed(CONTACT_TABLE["head"]) == 0
    assert limb_thickness("right_hand", 2.0) == pytest.approx(0.096)
    assert limb_thickness("torso", 1.75) == limb_thickness("left_flank", 1.75) > 0.5
    assert limb_thickness("", 1.75) == np.inf
