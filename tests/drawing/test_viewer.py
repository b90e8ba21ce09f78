"""What a view shows, seen without a browser."""

import dataclasses

import numpy as np
import pytest

import safe_ompl
from safe_ompl import CollisionChecker, InputError, PlanResult, Scene
from safe_ompl.drawing import ViewerContent, save_page
from safe_ompl.planning.simplification import PathReport


@pytest.fixture(scope="module")
def result(beside_a_worker):
    return beside_a_worker


@pytest.fixture(scope="module")
def scene(result):
    return result.scene


def test_a_view_knows_where_a_path_goes(result, ur5, scene):
    content = ViewerContent.of_results([result])
    along = content.along(result.planner, np.array([0.0, 1.0]))
    np.testing.assert_allclose(along, result.path[[0, -1]], atol=1e-9)
    assert len(content.danger_field.points) > 100
    two = ViewerContent.of_results([result, dataclasses.replace(result, seed=7)])
    assert list(two.paths) == ["SafeRRTConnect", "SafeRRTConnect, seed 7"]
    bare = ViewerContent(ur5, scene, danger=None), ViewerContent(ur5, Scene())
    assert [content.danger_field for content in bare] == [None, None]


def test_what_paths_are_like_is_said_and_the_safest_is_named(result, ur5, scene, tmp_path):
    start, goal = result.path[[0, -1]]
    detour = np.array([start, [0.0, -0.6, 0.6, -1.0, -1.57, 0.0], goal])
    content = ViewerContent(ur5, scene, {"detour <b>": detour, "planned": result.path})
    report = PathReport.of(detour, CollisionChecker(ur5, scene), content.danger_field)
    assert content.facts("detour <b>") == [
        f"danger: mean {report.danger.mean:.1f}, peak {report.danger.max:.1f}",
        f"least clearance: {1e3 * report.clearance.min:.0f} mm",
        f"length: {report.length:.2f} rad",
    ]
    assert report.danger.mean > 1.1 * result.report.danger.mean
    assert content.safest == "planned"
    assert ViewerContent.of_results([result]).safest == "", "one path is compared with none"
    away = ViewerContent(ur5, scene, dict(content.paths), danger=None)
    assert away.safest == max(away.paths, key=lambda name: away.reports[name].clearance.min), "without danger"
    pytest.importorskip("viser")
    save_page(content, tmp_path / "view.html")
    page = (tmp_path / "view.html").read_text(encoding="utf-8")
    assert "<summary>Safest: planned</summary>" in page
    assert f"<b>detour &lt;b&gt;</b><br>{'<br>'.join(content.facts('detour <b>'))}</p>" in page


def test_results_that_cannot_be_shown_are_refused(result):
    bare = PlanResult("Timeout", None, None, "PRM", 0, result.joint_names, 0.1)
    with pytest.raises(InputError, match="the result of PRM has no robot and scene"):
        ViewerContent.of_results([bare])
    with pytest.raises(InputError, match="same robot and scene"):
        ViewerContent.of_results([result, dataclasses.replace(result, scene=Scene())])
    with pytest.raises(InputError, match="no result"):
        ViewerContent.of_results([])


def test_results_are_shown_from_the_package_and_still_by_themselves(result, monkeypatch):
    shown = []

    class Browser:
        def __init__(self, content, port):
            shown.append((list(content.paths), port))

        def run(self, browser):
            shown.append(browser)

    monkeypatch.setattr("safe_ompl.drawing.viewer.BrowserView", Browser)
    safe_ompl.view([result, dataclasses.replace(result, planner="PRM")], port=8081)
    safe_ompl.view(result, browser=False)
    assert shown == [(["SafeRRTConnect", "PRM"], 8081), True, (["SafeRRTConnect"], 8080), False]


@pytest.fixture
def view(result, browser_view):
    return browser_view(ViewerContent.of_results([result, dataclasses.replace(result, planner="RRTConnect")]))


def test_sliders_and_play_bar_move_the_robots(view, result):
    from safe_ompl.drawing.viewer import Controls

    places = np.array([path_view.root.position for path_view in view.path_views])
    assert np.linalg.norm(places[0] - places[1]) > 1.0, "paths stand apart"
    controls = Controls(view)
    controls.go_to(0.5)  # as when it plays
    middle = view.content.along("SafeRRTConnect", np.array([0.5]))[0]
    np.testing.assert_allclose(view.q, middle)
    np.testing.assert_allclose([slider.value for slider in controls.joints], middle)
    controls.bar.value = 1.0
    np.testing.assert_allclose(view.q, result.path[-1], atol=1e-9)
    controls.joints[0].value = 0.25
    assert view.q[0] == pytest.approx(0.25)
    assert len(view.describe()) == 2
    assert "worker" in view.describe()[0]


def test_playing_goes_on_by_itself_until_a_joint_is_moved(view):
    from safe_ompl.drawing.viewer import Controls

    now = 100.0
    controls = Controls(view, clock=lambda: now)
    before = view.share
    controls.advance()
    assert view.share == before
    controls.play(True)
    controls._speed.value = 2.0
    now += 1.0
    controls.advance()
    assert view.share == pytest.approx(before + 2.0 / view.content.playing_time)
    controls.joints[0].value = 0.25
    controls.advance()
    assert view.q[0] == pytest.approx(0.25)
