# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A headless browser, and a simulated user of the page, for its tests and screenshots."""
from __future__ import annotations

from contextlib import contextmanager
import os
from pathlib import Path
import shutil
import sys
from typing import Iterator, Sequence

from playwright.sync_api import Browser, Page, sync_playwright

OWN = Path(sys.prefix) / 'browser'
INSTALLED = ('chromium', 'chromium-browser', 'google-chrome', 'chrome')
ARGUMENTS = ('--no-sandbox', '--headless=shell', '--disable-gpu', '--no-zygote',
             '--font-render-hinting=none')
SIZE = {'width': 1280, 'height': 720}
WAIT_MS = 90000


def find() -> str:
    """Return the path of the browser; empty where there is none."""
    own = OWN / 'chromium'
    if own.is_file():
        return str(own)
    return next((path for name in INSTALLED if (path := shutil.which(name))), '')


@contextmanager
def browsing() -> Iterator[Browser]:
    """Yield a headless browser."""
    environment = dict(os.environ)
    if find().startswith(str(OWN)):
        environment.update(LD_LIBRARY_PATH=str(OWN / 'lib'), FONTCONFIG_PATH=str(OWN))
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=find(), args=ARGUMENTS, env=environment)
        try:
            yield browser
        finally:
            browser.close()


class Hands:
    """
    A simulated user who draws on the page.

    :param page: the open page.
    """

    def __init__(self, page: Page) -> None:
        self.page = page
        page.set_default_timeout(WAIT_MS)

    def place(self, view: str, uv: Sequence[float]) -> tuple[float, float]:
        """Return the position on the page of a raw pixel of a view."""
        canvas = self.page.locator(f'canvas[data-view={view}]')
        self.page.wait_for_selector(f'canvas[data-view={view}][data-transform]')
        scale, x, y = map(float, str(canvas.get_attribute('data-transform')).split(','))
        box = canvas.bounding_box()
        assert box is not None  # noqa: S101 (for the types)
        return (box['x'] + x + (uv[0] + 0.5) * scale, box['y'] + y + (uv[1] + 0.5) * scale)

    def click(self, view: str, uv: Sequence[float]) -> None:
        """Click a raw pixel, and wait until the point is drawn and the draft assessed."""
        before = self.points()
        self.page.mouse.click(*self.place(view, uv))
        self.page.wait_for_function(DRAWN, arg=before + 1)

    def points(self) -> int:
        """Return the number of points of all lines on the page."""
        return int(self.page.evaluate(POINTS))

    def line(self, views: dict[str, Sequence[Sequence[float]]]) -> None:
        """Draw a new line, point by point, in both views."""
        count = self.page.locator('[data-line]').count()
        self.page.click('#add-line')
        self.page.wait_for_function(
            'n => document.querySelectorAll("[data-line]").length === n'
            ' && document.querySelectorAll("[data-line]")[n - 1].classList.contains("on")',
            arg=count + 1)
        for view, points in views.items():
            for uv in points:
                self.click(view, uv)

    def judged(self) -> None:
        """Wait until all lanes have their figures."""
        self.page.wait_for_function(
            '() => document.querySelectorAll("#lane-table tbody tr").length > 0 && '
            'document.querySelectorAll("#lane-table tbody tr").length === '
            'document.querySelectorAll("[data-lane]").length')


POINTS = """() => [...document.querySelectorAll('[data-line] .fine')].reduce((sum, e) => {
  const found = /^(\\d+) \\+ (\\d+) points/.exec(e.textContent);
  return sum + (found ? Number(found[1]) + Number(found[2]) : 0); }, 0)"""
DRAWN = f'n => ({POINTS})() === n'
