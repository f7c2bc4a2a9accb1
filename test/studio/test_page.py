# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser: a site drawn from scratch, recovery, runs, keys, foreign text."""
from __future__ import annotations

import shutil

import numpy as np
import pytest
from stereo_speed.core.units import MPH_MPS
from stereo_speed.io.truth import read_truth
from stereo_speed.pipeline.assembly import MeasuringSite
from stereo_speed.pipeline.config import PipelineConfig
from stereo_speed.pipeline.run import run
from stereo_speed.site.file import load_site
from stereo_speed.site.init_file import load_init
from stereo_speed.studio.guard import Guard
from stereo_speed.studio.live import LiveHealth, LiveReading, LiveState, STALE_S
from stereo_speed.studio.opening import open_runs
from stereo_speed.studio.serve import served
from stereo_speed.studio.server import Studio
from stereo_speed.studio.workspace import Workspace

headless = pytest.importorskip('headless', reason='playwright is not installed; make venv')
pytestmark = [pytest.mark.slow, pytest.mark.skipif(
    not headless.find(), reason='no headless Chromium here; make browser gets one')]


@pytest.fixture(scope='module')
def browser():
    """Return a browser; starting one takes a second."""
    with headless.browsing() as browser:
        yield browser


@pytest.fixture
def visit(browser):
    """Return the function that opens a page; no page may log an error."""
    faults, contexts = [], []

    def open_page(guard):
        context = browser.new_context(viewport=headless.SIZE)
        contexts.append(context)
        page = context.new_page()
        page.on('pageerror', lambda error: faults.append(str(error)))
        page.on('console', lambda message: faults.append(message.text)
                if message.type == 'error' and 'net::ERR' not in message.text else None)
        page.goto(guard.url)
        assert 'token' not in page.url
        return headless.Hands(page)
    yield open_page
    for context in contexts:
        context.close()
    assert faults == []


@pytest.fixture
def drawing(space):
    """Return a server with an empty draft on the sample."""
    guard = Guard()
    with guard.bind(0) as sock, served(Studio(guard, space), sock):
        yield guard


def measured_mph(scene, path):
    """Measure the sample with the site in a file."""
    place = MeasuringSite.of(load_site(path), scene.rig)

    def work(bag):
        return run(place.pipeline(PipelineConfig()), bag.pairs())
    result, = scene.thread.submit(scene.run_over, work).result().passes
    return result.speed_mps / MPH_MPS


def test_site_drawn_from_scratch_measures_like_a_handmade_one(
        visit, drawing, space, scene, sample):
    """Clicked on the picture to half a screen pixel, at 1280x720, snapped to the markings."""
    hands = visit(drawing)
    page = hands.page
    hand = load_site(sample / 'site.yaml')
    for line in list(hand.picked.values())[:2]:
        hands.line({'left': line.left_px[::3].tolist(), 'right': line.right_px[::3].tolist()})
    page.click('#lanes-between')
    hands.judged()
    page.fill('[data-lane] [aria-label^=Limit]', '45 mph')
    page.keyboard.press('Tab')
    page.wait_for_function('() => document.querySelector("#worth").textContent.includes("off px")')
    page.click('#save')
    page.wait_for_function('() => document.querySelector("#save").disabled')
    site = load_site(space.site_path)
    assert site.lanes[0].speed_limit_mps == pytest.approx(45 * MPH_MPS)
    assert measured_mph(scene, space.site_path) == pytest.approx(
        measured_mph(scene, sample / 'site.yaml'), abs=0.1)


def test_reload_second_tab_and_lost_connection_lose_nothing(visit, drawing, space):
    hands = visit(drawing)
    page = hands.page
    page.click('#add-line')
    page.wait_for_selector('[data-line].on')
    hands.click('left', (400.0, 350.0))
    page.reload()
    page.wait_for_selector('[data-line].on')
    assert hands.points() == 1
    other = page.context.new_page()
    other.goto(page.url)
    second = headless.Hands(other)
    other.wait_for_selector('[data-line].on')
    second.click('left', (420.0, 380.0))
    page.wait_for_function(headless.DRAWN, arg=2)
    # the connection is lost: steps are kept, over a reload as well, and sent once
    page.context.set_offline(True)
    page.route('**/api/step', lambda route: route.abort())
    page.mouse.click(*hands.place('left', (440.0, 420.0)))
    page.wait_for_function('() => document.querySelector("#link").textContent !== ""')
    assert len(space.draft.lines[0].left) == 2
    page.unroute('**/api/step')
    page.context.set_offline(False)
    page.wait_for_function(headless.DRAWN, arg=3)
    other.wait_for_function(headless.DRAWN, arg=3)
    assert len(space.draft.lines[0].left) == 3
    page.keyboard.press('Control+z')
    other.wait_for_function(headless.DRAWN, arg=2)


def test_line_can_be_drawn_by_keyboard_alone(visit, drawing, space):
    hands = visit(drawing)
    page = hands.page
    page.wait_for_selector('canvas[data-transform]')
    page.keyboard.press('n')
    page.wait_for_selector('[data-line].on')
    page.keyboard.press('s')  # no snapping
    page.keyboard.press('v')
    assert page.evaluate('() => document.activeElement.dataset.view') == 'left'
    for key in ('ArrowRight', 'Shift+ArrowDown', 'Alt+ArrowUp', 'Enter'):
        page.keyboard.press(key)
    page.wait_for_function(headless.DRAWN, arg=1)
    point, = space.draft.lines[0].left
    assert (point.u, point.v) == pytest.approx((513.0, 393.9))
    page.keyboard.press('ArrowDown')
    page.keyboard.press('Enter')
    page.wait_for_function(headless.DRAWN, arg=2)
    page.keyboard.press('v')
    assert page.evaluate('() => document.activeElement.dataset.view') == 'right'
    page.keyboard.press('v')
    page.keyboard.press('.')  # the first point
    page.keyboard.press('Delete')
    page.wait_for_function(headless.DRAWN, arg=1)
    assert space.draft.lines[0].left[0].v == pytest.approx(394.9)
    page.keyboard.press('Control+z')
    page.wait_for_function(headless.DRAWN, arg=2)
    # every tool can be reached by Tab
    reached = set()
    for _ in range(40):
        page.keyboard.press('Tab')
        reached.add(page.evaluate('() => document.activeElement.id'))
    assert {'undo', 'redo', 'snap', 'keys', 'save', 'add-line', 'add-lane'} <= reached


def move(page, view, at):
    """Move the keyboard cursor of a view to a place, to half a pixel."""
    for axis, keys in enumerate((('ArrowLeft', 'ArrowRight'), ('ArrowUp', 'ArrowDown'))):
        gap = round(at[axis] - view['cursor'][axis])
        view['cursor'][axis] += gap
        for step, modifier in ((10, 'Shift+'), (1, '')):
            for _ in range(abs(gap) // step):
                page.keyboard.press(modifier + keys[gap > 0])
            gap = abs(gap) % step * (1 if gap > 0 else -1)


def tab_to(page, name, most=80):
    """Press Tab until an element of a name has the focus."""
    for _ in range(most):
        if page.evaluate('() => document.activeElement.id || document.activeElement.ariaLabel'
                         ) == name:
            return
        page.keyboard.press('Tab')
    raise AssertionError(f'{name} is not reached by Tab')


def test_whole_site_can_be_drawn_by_keyboard_alone(visit, drawing, space, sample):
    """Lines, lanes, names, a limit, the calibration's day and a save; without a mouse."""
    hands = visit(drawing)
    page = hands.page
    page.wait_for_selector('canvas[data-transform]')
    hand = load_site(sample / 'site.yaml')
    views = [{'cursor': [512.0, 384.0]} for _ in range(2)]
    points = 0
    for number, line in enumerate(list(hand.picked.values())[:2], 1):
        page.keyboard.press('n')
        page.wait_for_function('n => document.querySelectorAll("[data-line]").length === n &&'
                               ' document.querySelector("[data-line].on")', arg=number)
        for view, uv in zip(views, line.views_px):
            page.keyboard.press('v')
            for at in uv[1:13:5].tolist():
                move(page, view, at)
                page.keyboard.press('Enter')
                points += 1
                page.wait_for_function(headless.DRAWN, arg=points)
    page.keyboard.press('l')
    hands.judged()
    tab_to(page, 'Name of the site')
    page.keyboard.press('Control+a')
    page.keyboard.type('north gate')
    page.keyboard.press('Tab')
    page.wait_for_function('() => document.activeElement.dataset.key === "calibrated"')
    tab_to(page, 'Limit of lane_0')
    page.keyboard.press('Control+a')
    page.keyboard.type('45 mph')
    page.keyboard.press('Enter')
    wait_until(page, lambda: space.draft.lanes[0].speed_limit == '45 mph')
    page.keyboard.press('Control+s')
    page.wait_for_function('() => document.querySelector("#save").disabled')
    site = load_site(space.site_path)
    assert site.name == 'north gate' and len(site.picked) == 2
    assert site.lanes[0].speed_limit_mps == pytest.approx(45 * MPH_MPS)
    lane = space.judged(space.draft, None).data['lanes'][str(space.draft.lanes[0].number)]
    assert abs(lane['width_m'] - 3.5) < 4 * lane['width_std_m'] < 0.6  # three clicks a line


def wait_until(page, condition):
    """Wait for an automatic action of the server."""
    for _ in range(200):
        if condition():
            return
        page.wait_for_timeout(50)
    raise AssertionError('the awaited event has not come')


def test_passes_are_sorted_and_filtered_and_foreign_text_is_escaped(visit, tmp_path, make_run):
    evil = '<img src=x onerror="document.title=1">,=1+1'
    folder = make_run(tmp_path / '<b>run', count=200, lane=evil)
    guard = Guard()
    with guard.bind(0) as sock, served(Studio(guard, runs=open_runs([folder, folder])), sock):
        hands = visit(guard)
        page = hands.page
        page.wait_for_selector('#passes tbody tr')
        assert page.locator('#passes tbody tr').count() == 200
        for _ in range(2):  # falling, the second time
            page.click('#passes th:nth-child(4) button')
        first = page.inner_text('#passes tbody tr:first-child td:nth-child(4)')
        assert float(first) == pytest.approx((20.0 + 0.05 * 199) / MPH_MPS, abs=0.006)
        speeds = np.array([20.0 + 0.05 * k for k in range(200) if k % 10 != 9]) / MPH_MPS
        assert float(page.inner_text('#v85')) == pytest.approx(
            np.percentile(speeds, 85), abs=0.006)
        page.select_option('#filter-verdict', 'rejected')
        assert page.locator('#passes tbody tr').count() == 20
        page.focus('#passes tbody tr:first-child')
        page.keyboard.press('ArrowDown')
        page.wait_for_function('() => document.querySelector("#passes tr:nth-child(2)'
                               '[aria-selected=true]")')
        with page.expect_download() as waiting:
            page.click('#export')
        lines = waiting.value.path().read_text().splitlines()
        assert len(lines) == 21 and lines[0].startswith('track,lane,first_ns')
        page.select_option('#run', '1')
        page.wait_for_function('() => document.querySelector("#count").textContent === "180"')
        # none of the file's text has become markup of the page
        assert page.title() == 'stereo_speed studio'
        assert page.locator('#passes img, #run b, #detail img').count() == 0
        assert evil in page.inner_text('#passes tbody tr:first-child')


def test_record_of_a_violation_shows_its_verification(visit, replayed, tmp_path):
    guard, folder = Guard(), shutil.copytree(replayed, tmp_path / 'run')
    with guard.bind(0) as sock, served(Studio(guard, runs=open_runs([folder])), sock):
        page = visit(guard).page
        page.wait_for_selector('#estimates')
        page.select_option('#run', '1')
        page.wait_for_function('() => document.querySelector("#verification").textContent'
                               '.startsWith("1 record, sound.")')
        assert page.inner_text('#passes tbody tr td:last-child') == 'sound'
        assert page.locator('.pictures img').count() == 7  # three pairs and the close-up
        page.wait_for_function('() => [...document.querySelectorAll(".pictures img")].every('
                               '(image) => image.naturalWidth > 0)')
        page.click('details summary')
        with page.expect_download() as waiting:
            page.click('text=record.schema.json')
        assert waiting.value.path().read_text().startswith('{')
        record, = (path for path in (folder / 'evidence').iterdir() if path.is_dir())
        (record / 'close_up.jpg').write_bytes(b'another')
        page.click('#again')
        page.wait_for_function('() => document.querySelector("#verification").textContent'
                               '.startsWith("NOT SOUND: 1 fault")')
        page.wait_for_function('() => document.querySelector("#detail").textContent.includes('
                               '"close_up.jpg was changed")')
        assert page.inner_text('#passes tbody tr td:last-child') == 'not sound'


def test_live_data_is_shown_with_its_growing_age(visit):
    live, guard = LiveState(), Guard()
    with guard.bind(0) as sock, served(Studio(guard, live=live), sock):
        page = visit(guard).page
        live.add_reading(LiveReading('vehicle_3', 10**18, 55.0 * MPH_MPS, 0.1))
        live.add_health(LiveHealth('tracker_node: pipeline', 1, '<b>late</b>'))
        live.add_pass({'track': 3, 'lane': 'lane_0', 'speed_mps': 55.0 * MPH_MPS,
                       'speed_std_mps': 0.04, 'verdict': 'measured', 'reason': ''})
        page.wait_for_function(
            '() => document.querySelector("#speeds")?.textContent.includes("55.0 mph")')
        assert page.inner_text('#fresh') == 'live'
        page.wait_for_function(
            '() => document.querySelector("#live-passes").textContent.includes("measured")')
        assert '<b>late</b>' in page.inner_text('#health') and 'warning' in page.inner_text(
            '#health')
        page.wait_for_function('() => document.querySelector("#fresh").textContent'
                               '.startsWith("nothing for")', timeout=1e3 * (STALE_S + 20))
        assert page.locator('.card.stale').count() == 1


def test_vehicles_are_marked_for_init_and_for_truth(visit, drawing, space, sample):
    hands = visit(drawing)
    page = hands.page
    page.wait_for_selector('canvas[data-transform]')
    first = load_init(sample / 'init.yaml')[0]
    for number, (frame, button) in enumerate(((0, '#add-front'), (3, '#add-mark'))):
        page.fill('[data-key=frame]', str(frame))
        page.keyboard.press('Enter')
        page.click(button)
        page.wait_for_function('n => document.querySelectorAll("[data-front]").length === n',
                               arg=number + 1)
        for view, corners in (('left', first.left_px), ('right', first.right_px)):
            for count, (u, v) in enumerate(corners.tolist(), 1):
                page.mouse.click(*hands.place(view, (u + 8 * number, v + 8 * number)))
                wait_until(page, lambda: len(space.draft.fronts[number].view(view)) == count)
    for button, path in (('#save-init', space.init_path), ('#save-truth', space.truth_path)):
        page.click(button)
        wait_until(page, path.exists)
        page.wait_for_function('id => !document.querySelector(id)', arg=button)
    truth, = read_truth(space.truth_path)
    assert [space.scene.index_of(ns) for ns in truth.stamps_ns.tolist()] == [0, 3]
    front, = load_init(space.init_path)
    np.testing.assert_allclose(front.left_px, first.left_px, atol=2.0)  # pixels of the screen


def test_unfinished_input_survives_a_change_by_another_page(visit, drawing, space):
    page = visit(drawing).page
    page.click('#add-lane')
    limit = '[aria-label="Limit of lane_0"]'
    page.wait_for_selector(limit)
    page.click(limit)
    page.keyboard.press('Control+a')
    page.keyboard.type('4')
    other = page.context.new_page()
    other.goto(page.url)
    other.click('#add-line')
    page.wait_for_selector('[data-line]')
    assert page.input_value(limit) == '4' and page.locator('#toasts div').count() == 0
    page.keyboard.type('5 mph')
    other.click('#add-line')  # and once more, when all of it is typed
    page.wait_for_function('() => document.querySelectorAll("[data-line]").length === 2')
    page.keyboard.press('Enter')
    wait_until(page, lambda: space.draft.lanes[0].speed_limit == '45 mph')


def test_draft_survives_the_closing_of_its_pages(visit, drawing, space):
    """All pages are closed and opened again; the address still works."""
    hands = visit(drawing)
    hands.page.click('#add-line')
    hands.page.wait_for_selector('[data-line].on')
    hands.page.close()
    again = visit(drawing)
    again.page.wait_for_selector('[data-line].on')
    assert isinstance(space, Workspace) and len(space.draft.lines) == 1
