# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Usage: screenshots.py FOLDER. Use the page like a user, and save a screenshot of each step.

A site is drawn on the sample by clicking every second point of its own site file; the page snaps
them. Then the sample is replayed with its violation recorded, and reviewed; and its bag is played
to the live nodes, where ROS is installed.
"""
from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import threading

import cv2
import headless
from playwright.sync_api import Browser, Page
from stereo_speed.cli.demo import live, private_graph
from stereo_speed.cli.main import main as command
from stereo_speed.io.truth import read_truth
from stereo_speed.site.file import load_site
from stereo_speed.studio.guard import Guard
from stereo_speed.studio.opening import open_runs
from stereo_speed.studio.scene import Scene
from stereo_speed.studio.serve import served
from stereo_speed.studio.server import Studio
from stereo_speed.studio.workspace import Workspace

ROOT = Path(__file__).resolve().parents[1]
SAMPLE = ROOT / 'sample' / 'straight55'
_QUALITY = 85  # JPEG quality that keeps text sharp
# Both images are shown, and a vehicle has been measured for some time.
WATCHED = """() => document.querySelectorAll('.shot:not(.stale) img').length === 2
  && [...document.querySelectorAll('.shot img')].every((image) => image.naturalWidth > 0)
  && document.querySelector('#speeds .card:not(.stale)')
  && Number(document.querySelector('#pairs').textContent) > 6"""


def keep(page: Page, path: Path) -> None:
    """Write a screenshot of the page."""
    page.wait_for_timeout(400)  # a frame is painted after the last message
    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder, 'shot.png')
        page.screenshot(path=shot)
        cv2.imwrite(str(path), cv2.imread(str(shot)), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    print(path)


def draw(hands: headless.Hands, out: Path) -> None:
    """Draw the site, refine it, measure with it, and save a screenshot of each step."""
    page = hands.page
    lines = list(load_site(SAMPLE / 'site.yaml').picked.values())
    for line in lines:
        hands.line({'left': line.left_px[::2].tolist(), 'right': line.right_px[::2].tolist()})
    page.mouse.move(*hands.place('left', lines[0].left_px[4].tolist()))
    keep(page, out / 'studio_lines.jpg')
    page.click('#lanes-between')
    hands.judged()
    page.click('#refine')
    page.wait_for_function(
        '() => document.querySelector("#worth").textContent.includes("Moved with")')
    page.mouse.move(*hands.place('right', lines[1].right_px[9].tolist()))
    keep(page, out / 'studio_lanes.jpg')
    page.click('#measure')
    page.wait_for_selector('#frame')
    keep(page, out / 'studio_review.jpg')


def review(page: Page, out: Path) -> None:
    """Save a screenshot of a record of a violation."""
    page.wait_for_selector('#estimates')
    page.select_option('#run', '1')
    page.wait_for_function('() => document.querySelector("#verification").textContent'
                           '.includes("sound.")')
    page.wait_for_function('() => document.querySelectorAll(".pictures img").length > 0 && '
                           '[...document.querySelectorAll(".pictures img")].every('
                           '(image) => image.naturalWidth > 0)')
    keep(page, out / 'studio_evidence.jpg')


def watch(browser: Browser, out: Path) -> None:
    """Play the sample to the live nodes, and save a screenshot of the live page."""
    private_graph()
    site, truth = SAMPLE / 'site.yaml', read_truth(SAMPLE / 'truth.csv')[0]
    with subprocess.Popen([sys.executable, '-m', 'stereo_speed', 'studio', '--live', '--port',
                           '0'], stdout=subprocess.PIPE, text=True) as studio:
        try:
            assert studio.stdout is not None  # noqa: S101 (for the types)
            page = browser.new_page(viewport=headless.SIZE)
            page.set_default_timeout(headless.WAIT_MS)
            page.goto(studio.stdout.readline().split()[-1])
            nodes = threading.Thread(target=live, args=(SAMPLE, site, 10, 0.5, truth))
            nodes.start()
            page.wait_for_function(WATCHED)
            keep(page, out / 'studio_live.jpg')
            nodes.join()
        finally:
            studio.send_signal(signal.SIGINT)


def main() -> None:
    """Serve the sample and use the page."""
    out = Path(sys.argv[1]).resolve()
    out.mkdir(parents=True, exist_ok=True)
    guard, scene = Guard(), Scene(SAMPLE / 'bag')
    with tempfile.TemporaryDirectory() as folder, headless.browsing() as browser:
        space = Workspace(scene, Path(folder, 'site.yaml'), Path(folder, 'init.yaml'))
        with guard.bind(0) as sock, served(Studio(guard, space), sock):
            draw(headless.Hands(opened(browser, guard)), out)
        run = Path(folder, 'run')
        command(['replay', str(SAMPLE / 'bag'), '--site', str(SAMPLE / 'site.yaml'), '--out',
                 str(run), '--no-plots', '--evidence'])
        guard = Guard()
        with guard.bind(0) as sock, served(Studio(guard, runs=open_runs([run])), sock):
            review(opened(browser, guard), out)
        if find_spec('rclpy') is None:
            print('no picture of the live page: ROS is not installed', file=sys.stderr)
        else:
            watch(browser, out)
    scene.close()


def opened(browser: Browser, guard: Guard) -> Page:
    """Return a new page of a server."""
    page = browser.new_page(viewport=headless.SIZE)
    page.set_default_timeout(headless.WAIT_MS)
    page.goto(guard.url)
    return page


if __name__ == '__main__':
    main()
