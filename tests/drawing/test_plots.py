"""Curves and boxes: files are written, axes hold what they should, bad numbers are refused."""

import sys

import numpy as np
import pytest

pytest.importorskip("matplotlib")

import matplotlib
from matplotlib.image import imread

from safe_ompl import DangerField, InputError, KinetostaticField, RateLimits, SafeOmplError, time_path
from safe_ompl.drawing.plots import plot_motion, plot_plan, plot_profiles
from safe_ompl.drawing.style import planner_styles
from safe_ompl.io import ACCELERATION

PROFILES = {
    "RRTConnect": np.tile(np.linspace(1.0, 3.0, 11), (4, 1)) + np.arange(4)[:, None],
    "SafeRRTConnect": np.ones((5, 21)),
    "BITstar": np.empty((0, 11)),
}


# ------------------------------------------------------------------------------------------------ pictures


def test_profiles_show_the_mean_of_each_planner_and_the_spread(tmp_path):
    before = dict(matplotlib.rcParams)
    figure = plot_profiles(PROFILES, tmp_path / "new" / "profiles.png")
    axes = figure.axes[0]
    curves = {line.get_label(): line for line in axes.get_lines()}
    assert list(curves) == ["RRTConnect", "SafeRRTConnect", "BITstar (no runs)"]
    assert curves["RRTConnect"].get_ydata() == pytest.approx(np.linspace(2.5, 4.5, 11))
    assert curves["RRTConnect"].get_xdata()[[0, -1]] == pytest.approx([0.0, 1.0])
    band, no_spread = (collection.get_paths()[0].get_extents() for collection in axes.collections)
    assert (band.y0, band.y1) == pytest.approx((1.0 + 0.15 * 3, 3.0 + 0.85 * 3))  # of the values 0 to 3 above a line
    assert (no_spread.y0, no_spread.y1) == pytest.approx((1.0, 1.0))
    assert axes.get_xlabel() == "along the path, from start to goal"
    assert imread(tmp_path / "new" / "profiles.png").shape[:2] == (660, 1050)
    assert dict(matplotlib.rcParams) == before  # the style of others is left alone


def test_of_many_profiles_two_are_large_and_each_other_one_stands_beside_the_first(tmp_path):
    profiles = {name: np.full((3, 5), float(k)) for k, name in enumerate("abcdef", 1)}
    upper, *small = plot_profiles(profiles, tmp_path / "profiles.png").axes
    assert [line.get_label() for line in upper.get_lines()] == ["a", "b"]
    assert [axes.get_title(loc="left") for axes in small] == ["c", "d", "e", "f"]
    for level, axes in enumerate(small, 3):
        assert [line.get_ydata().tolist() for line in axes.get_lines()] == [[1.0] * 5, [float(level)] * 5]
        assert axes.get_ylim() == upper.get_ylim()


def test_a_plan_shows_levels_and_the_closest_approach(tmp_path):
    danger, clearances = np.array([1.0, 4.0, 2.0]), {"people": [0.5, 0.4, 0.6], "things": [0.2, 0.03, 0.1]}
    figure = plot_plan(danger, tmp_path / "plan.png", clearance=clearances, planner="SafePRM")
    upper, lower = figure.axes
    assert upper.get_title(loc="left") == "SafePRM"
    assert {text.get_text(): text.get_position()[1] for text in upper.texts} == {"start": 1.0, "goal": 2.0}
    assert lower.get_title(loc="right") == "closest: 30 mm to things"
    shaded = upper.collections[0].get_datalim(upper.transData)
    assert (shaded.y0, shaded.y1) == pytest.approx((2.0, 4.0), abs=0.1)  # the danger that another path would avoid
    assert [line.get_ydata().tolist() for line in lower.get_lines()[:2]] == [[500, 400, 600], [200, 30, 100]]
    assert [text.get_text() for text in lower.get_legend().get_texts()] == ["to people", "to things"]


def test_safe_planners_are_drawn_stronger_than_those_without_and_no_two_lines_are_alike():
    styles = planner_styles(["SafePRM", "ClassicPRM", "PaperSafePRM", "PaperPRM", "OMPL PRM", "PRM"])
    assert [style.strong for style in styles.values()] == [True, False, True, False, True, False]
    safe, classic, printed, without, *_ = (style.colour for style in styles.values())
    assert (safe, classic) == (printed, without)
    assert len({(style.colour, style.dashes) for style in styles.values()}) == len(styles)
    assert len({style.colour for style in styles.values()}) == 4


# ----------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("danger", "message"), [([], "danger has no values"), ([1.0, np.nan], "finite"), (["a"], "danger: must be numbers")]
)
def test_what_cannot_be_drawn_is_named(danger, message, tmp_path):
    with pytest.raises(InputError, match=message):
        plot_plan(danger, tmp_path / "a.png")
    assert not list(tmp_path.iterdir())


def test_without_matplotlib_the_extra_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(SafeOmplError, match=r"safe-ompl\[plots\]"):
        plot_plan([1.0, 2.0], tmp_path / "a.png")


# -------------------------------------------------------------------------------------- the picture of a trajectory


PATH = [
    [0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.0],
    [1.2, 0.2, 0.4, -1.2, 0.3, 2.0, 0.5],
    [0.2, 0.4, -0.4, -1.8, 0.0, 1.0, 0.0],
]


@pytest.fixture(scope="module")
def trajectory(panda):
    return time_path(PATH, panda, RateLimits.of(panda, 1.0, 4.0), tool_speed=0.4)


def test_speed_and_what_binds_it(trajectory, tmp_path):
    speed, velocity, acceleration = plot_motion(trajectory, tmp_path / "motion.png").axes
    assert (tmp_path / "motion.png").stat().st_size > 10_000
    lines = {line.get_label(): line for line in speed.lines}
    whole, bound = lines[ACCELERATION].get_ydata(), lines["tool speed"].get_ydata()
    highest = np.sqrt(trajectory.law.squared_speeds.max())
    assert np.nanmax([whole, bound]) == pytest.approx(highest, rel=1e-2)
    assert 0 < np.isfinite(bound).mean() < 1
    assert np.isfinite(np.fmax(whole, bound)).all()  # each piece in the colour of what binds there
    assert np.isfinite(whole + bound).any()  # pieces meet
    times = np.linspace(0.0, trajectory.duration, len(whole))
    drawn = np.where(np.isfinite(bound), bound, whole)
    np.testing.assert_allclose(drawn, trajectory.law.at(times)[2], atol=1e-9)
    for axes in (velocity, acceleration):
        shares = np.concatenate([line.get_ydata() for line in axes.lines if len(line.get_ydata()) > 2])
        assert 0.3 < abs(shares).max() <= 1 + 1e-9


def test_danger_and_its_proven_peak(trajectory, panda, tmp_path):
    danger = trajectory.danger(KinetostaticField(DangerField(panda, [[0.6, 0.4, 0.5]])))
    figure = plot_motion(trajectory, tmp_path / "motion.svg", danger=danger, title="mine")
    axes = figure.axes
    assert figure.get_suptitle() == "mine"
    np.testing.assert_allclose(axes[3].lines[0].get_ydata(), danger.values)
    assert f"proven below {danger.proven_peak:.2f}" in axes[3].get_title(loc="right")
