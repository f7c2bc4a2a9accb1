# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The page beside the live nodes: real processes over DDS, a real browser."""
from __future__ import annotations

from pathlib import Path
import re
import signal
import subprocess
import sys

import pytest

pytest.importorskip('rclpy')
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / 'tools'))
headless = pytest.importorskip('headless', reason='playwright is not installed; make venv')

from stereo_speed.cli.demo import live  # noqa: E402
from stereo_speed.core.units import MPH_MPS  # noqa: E402
from stereo_speed.io.truth import read_truth  # noqa: E402

pytestmark = [pytest.mark.usefixtures('private_graph'), pytest.mark.skipif(
    not headless.find(), reason='no headless Chromium here; make browser gets one')]
STOP_S = 30.0
# The content changes while the nodes run: the page records it.
WATCH = """() => {
  window.seen = {speeds: new Set(), rates: new Set(), fresh: new Set()};
  const note = () => {
    document.querySelectorAll('#speeds .big').forEach((c) => seen.speeds.add(c.textContent));
    seen.rates.add(document.querySelector('#rate').textContent);
    seen.fresh.add(document.querySelector('#fresh').textContent); };
  new MutationObserver(note).observe(document.body, {subtree: true, childList: true}); }"""
SEEN = '() => Object.fromEntries(Object.entries(seen).map(([k, v]) => [k, [...v]]))'


@pytest.fixture
def studio():
    """Return the address of the page of a real ``studio_node``."""
    with subprocess.Popen([sys.executable, '-m', 'stereo_speed', 'studio', '--live', '--port',
                           '0'], stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process.stdout.readline().split()[-1]
            process.send_signal(signal.SIGINT)
            assert process.wait(STOP_S) == 0
        finally:
            process.kill()


def test_page_shows_what_the_nodes_measure(studio, sample):
    with headless.browsing() as browser:
        page = browser.new_page(viewport=headless.SIZE)
        page.set_default_timeout(headless.WAIT_MS)
        page.goto(studio)
        page.wait_for_selector('#fresh')
        page.evaluate(WATCH)
        readings, _ = live(sample, sample / 'site.yaml', 10, 0.5,
                           read_truth(sample / 'truth.csv')[0])
        page.wait_for_function('() => document.querySelector("#live-passes").textContent'
                               '.includes("measured")')  # published when the stream has ended
        seen = page.evaluate(SEEN)
        told = {f'{speed / MPH_MPS:.1f} mph' for _, _, speed, _ in readings}
        shown = set(seen['speeds'])
        assert shown and shown <= told, (shown, told)  # a busy browser may leave some out
        assert 'live' in seen['fresh'] and any(float(rate) > 0 for rate in seen['rates']
                                               if rate != '–')
        row = page.inner_text('#live-passes tbody tr')
        assert float(re.search(r'([\d.]+) ±', row)[1]) == pytest.approx(55.0, abs=0.6)
        health = page.inner_text('#health')
        assert 'tracker_node: pipeline' in health and 'stereo_sync_node' in health
        for view in ('left', 'right'):
            page.wait_for_function('view => document.querySelector(`.shot[data-view=${view}] img`)'
                                   '.naturalWidth > 0', arg=view)
        # all nodes have ended: nothing on the page looks as if it were of now
        page.wait_for_function('() => document.querySelectorAll(".shot.stale").length === 2')
        page.wait_for_function('() => document.querySelector("#fresh").textContent'
                               '.startsWith("nothing for")')
        page.wait_for_function('() => [...document.querySelectorAll("#health .pill")].every('
                               '(pill) => pill.textContent === "silent")')
