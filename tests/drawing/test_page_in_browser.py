"""The page of a view in a real browser: it opens offline, shows something, and its play bar moves the robot."""

import io
import json
import shutil
import time

import numpy as np
import pytest

from safe_ompl import Box, Motion, Obstacle, Pose, Robot, Scene
from safe_ompl.drawing import ViewerContent, save_page
from safe_ompl.drawing.content import Movers
from safe_ompl.geometry import STANDING
from safe_ompl.io import EmbeddedProblem, MotionRecord

BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
OPTIONS = (
    "headless no-sandbox use-angle=swiftshader enable-unsafe-swiftshader disable-quic no-first-run "
    "disable-background-networking disable-component-update disable-sync lang=en-US window-size=480,480"
)
BAR = "input[inputmode=decimal]"
PATIENCE = 120.0  # [s] a picture takes seconds without a graphics card, on a busy machine many


@pytest.fixture(scope="module")
def browser():
    pytest.importorskip("viser")
    webdriver = pytest.importorskip("selenium.webdriver")
    if not (BROWSER and DRIVER):
        pytest.skip("no chromium and chromedriver here; Debian has them as chromium and chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for option in OPTIONS.split():
        options.add_argument(f"--{option}")
    options.set_capability("goog:loggingPrefs", {"performance": "ALL", "browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def page(browser, tmp_path_factory, data_folder):
    robot = Robot.from_urdf(data_folder / "gripper_arm.urdf")
    middle = 0.5 * (robot.lower + robot.upper)
    path = np.array([middle - 0.25 * (robot.upper - robot.lower), middle + 0.25 * (robot.upper - robot.lower)])
    scene = Scene((Obstacle("box", Box((0.1, 0.1, 0.1)), Pose((0.6, 0.0, 0.3)), weight=1.0),))
    file = tmp_path_factory.mktemp("page") / "view.html"
    save_page(drive(robot, scene, path), file)
    browser.get(file.as_uri())
    wait_for(browser, lambda: browser.find_elements("css selector", BAR))
    wait_for(browser, lambda: np.ptp(picture(browser)) > 60)
    return browser


def drive(robot, scene, path):
    """Return a motion in time beside a person who walks."""
    times = np.linspace(0.0, 8.0, 9)
    shares = np.linspace(0.0, 1.0, 9)[:, None]
    states = ("moving",) * 6 + ("braking",) * 2 + ("standing",)
    moved = Motion.through(path[0] + shares * (path[1] - path[0]), times)
    motion = MotionRecord(EmbeddedProblem(robot, scene, None), moved, np.ones(9), {}, states)
    body = {name: 1.75 * np.array(point) + [1.2, 0.0, -0.5] for name, point in STANDING.items()}
    walk = [{"anna": {name: np.add(p, [0.0, 0.2 * k, 0.0]).tolist() for name, p in body.items()}} for k in range(9)]
    movers = Movers(times, {"anna": 1.75}, walk, [{}] * 9)
    return ViewerContent(robot, scene, danger=None, motions={"live": motion}, movers=movers)


def wait_for(browser, condition):
    """Wait until a condition holds. On a busy machine a picture may take too long, and is taken once more."""
    wait = pytest.importorskip("selenium.webdriver.support.wait")
    ignored = [pytest.importorskip("selenium.common.exceptions").TimeoutException]
    wait.WebDriverWait(browser, PATIENCE, ignored_exceptions=ignored).until(lambda _: condition())


def picture(browser):
    """Return what the 3D canvas shows, coarsely and in grey: (24, 32)."""
    from PIL import Image

    canvas = browser.find_element("css selector", "canvas")
    image = Image.open(io.BytesIO(canvas.screenshot_as_png)).convert("L").resize((32, 24))
    return np.asarray(image, dtype=float)


def shown_time(browser):
    """Return where the play bar is [s]."""
    return float(browser.find_element("css selector", BAR).get_attribute("value"))


def seek(browser, seconds):
    bar = browser.find_element("css selector", BAR)
    bar.send_keys("\ue009a\ue000")  # Ctrl+A
    bar.send_keys(f"{seconds}\ue007")


def test_it_asks_nothing_of_the_network(page):
    events = [json.loads(entry["message"])["message"] for entry in page.get_log("performance")]
    asked = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
    assert asked
    assert {url.split(":")[0] for url in asked} <= {"file", "data", "blob"}
    assert not [entry for entry in page.get_log("browser") if entry["level"] == "SEVERE"]


def test_it_stands_at_the_start_until_it_is_played(page):
    assert shown_time(page) == 0.0
    time.sleep(1.0)
    assert shown_time(page) == 0.0
    page.find_element("css selector", BAR).find_element("xpath", "./preceding::button[1]").click()
    wait_for(page, lambda: shown_time(page) > 0.0)


def test_the_play_bar_moves_the_robot(page):
    seek(page, 0.0)
    time.sleep(1.0)
    start = picture(page)
    again = picture(page)
    seek(page, 8.0)
    wait_for(page, lambda: np.abs(picture(page) - start).max() > 30)
    assert np.abs(again - start).max() < 10
    seek(page, 0.0)
    wait_for(page, lambda: np.abs(picture(page) - start).max() < 10)
