"""With a limit of the jerk accelerations are continuous: in commands, in their stops, and from one to the next."""

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings, strategies as st
from swinging import HOME, JERKS, NOTHING, SWING, SWINGING, check_stops, drive_replanner, drive_shield, proposing

from safe_ompl import Pose, RateLimits, Replanner, Surroundings, time_path
from safe_ompl.live.replanning import Action
from safe_ompl.live.replanning.bounded_path import averaging_window

SIDE = np.eye(7)[0]
FAR = np.array([3.0, 0.0, 0.0])
ACCELERATIONS = [15, 7.5, 10, 12.5, 15, 20, 20]


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 2**31),
    jerk=st.sampled_from(JERKS),
    kinds=st.lists(st.integers(0, NOTHING), min_size=1, max_size=3),
    near=st.booleans(),
)
@example(seed=0, jerk=JERKS[0], kinds=[SWINGING], near=True)
@example(seed=1, jerk=JERKS[2], kinds=[0, SWINGING, NOTHING], near=True)
def test_whatever_is_proposed_all_rates_are_kept_and_stops_are_proven(shield_for, seed, jerk, kinds, near):
    rng = np.random.default_rng(seed)
    shield = shield_for(jerk=jerk)

    def ball(time):
        return np.array([0.75, 0.3 * np.sin(4 * time + seed), 0.5]) if near else FAR

    commands, _ = drive_shield(shield, proposing(rng, kinds), ball, 1.0)
    check_stops(shield, commands[2::5], ball)


@pytest.mark.parametrize(("jerk", "blends"), [(JERKS[0], True), (JERKS[1], False)])
def test_a_replanner_keeps_the_jerk_of_its_trajectory_in_corners_and_detours_too(panda, table, jerk, blends):
    replanner = Replanner(panda, Surroundings(table, objects={"ball": 1.6}))
    limits = RateLimits.of(panda, acceleration=ACCELERATIONS, jerk=jerk)
    way = [HOME, HOME + 0.5 * SWING, HOME + 0.8 * SWING + 0.3 * SIDE, HOME + 1.2 * SIDE]
    trajectory = time_path(way, panda, limits, motion=replanner.prover if blends else None)

    def see(now):
        return {}, {"ball": Pose((0.75 + 2 * (now > 2), 0.2 * np.sin(3 * now), 0.5))}

    commands = drive_replanner(replanner, trajectory, see, 6.0)
    assert commands[-1].action is Action.DONE
    assert any(command.action in (Action.SLOWED, Action.STANDING, Action.BRAKING) for command in commands)
    assert averaging_window(limits) == pytest.approx({7500: 15 / 3500, 800: 20 / (800 * 0.7 * 2 / 3)}[jerk[0]], rel=0.2)
