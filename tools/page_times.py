# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Usage: page_times.py [PASSES ...]. Measure how long the page takes to open, sort and filter a run.

The times are medians in a headless browser, from the click to the frame after the table is drawn;
the run is synthetic, with 20 readings for each pass.
"""
from __future__ import annotations

from pathlib import Path
import statistics
import sys
import tempfile

import headless
import numpy as np
from playwright.sync_api import Page
from stereo_speed.core.passes import PassResult, Verdict
from stereo_speed.core.records import TrackState, TrackUpdate
from stereo_speed.io.results import write_run
from stereo_speed.studio.guard import Guard
from stereo_speed.studio.opening import open_runs
from stereo_speed.studio.serve import served
from stereo_speed.studio.server import Studio

READINGS, TIMES = 20, 9
BEGAN_NS, SECOND_NS = 1_700_000_000 * 10**9, 10**9
CLOCKED = """async ([what, done]) => {
  const began = performance.now();
  eval(what);
  while (!eval(done)) await new Promise((again) => setTimeout(again, 1));
  document.body.getBoundingClientRect();
  await new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)));
  return performance.now() - began; }"""
CHOSEN = ("document.querySelector('#{0}').value = '{1}';"
          "document.querySelector('#{0}').dispatchEvent(new Event('change'))")
SHOWN = "document.querySelector('#shown').textContent.startsWith('{0} of {1} ')"
CLICKED = "document.querySelector('[data-pass=\"{0}\"]').click()"
OPEN = "document.querySelector('#detail .end')?.textContent.startsWith('vehicle {0} ')"


def tasks(count: int) -> dict[str, tuple[str, str, str, str]]:
    """Return each task's action and its visible result, and the same for its reversal."""
    every, other = SHOWN.format(count, count), SHOWN.format(count + 1, count + 1)
    return {
        'open a run': (CHOSEN.format('run', '1'), other, CHOSEN.format('run', '0'), every),
        'sort by speed': ("document.querySelectorAll('#passes th button')[3].click()", every,
                          "document.querySelectorAll('#passes th button')[0].click()", every),
        'filter by verdict': (CHOSEN.format('filter-verdict', 'rejected'),
                              SHOWN.format(-(-count // 10), count),
                              CHOSEN.format('filter-verdict', ''), every),
        'open a pass': (CLICKED.format(1), OPEN.format(1), CLICKED.format(0), OPEN.format(0))}


def write_passes(folder: Path, count: int) -> Path:
    """Write a run with one pass per second, of which every tenth is rejected."""
    rng = np.random.default_rng(count)
    passes, rows = [], []
    for k, speed in enumerate(rng.normal(20.0, 2.0, count).tolist()):
        first_ns, good = BEGAN_NS + k * SECOND_NS, bool(k % 10)
        passes.append(PassResult(
            k, f'lane_{k % 2}', first_ns, first_ns + SECOND_NS, READINGS, speed if good else None,
            0.1 if good else None, Verdict.MEASURED if good else Verdict.REJECTED,
            '' if good else 'uncertain', {}, {}))
        rows += [TrackUpdate(
            first_ns + i * SECOND_NS // READINGS, k, f'lane_{k % 2}', TrackState.CONFIRMED, speed,
            0.5, float(i), 0.0, np.array([0.0, 0.0, 30.0]), np.eye(3), np.eye(3),
            np.zeros((4, 2)), np.zeros((4, 2))) for i in range(READINGS)]
    write_run(folder, rows, passes, {'seed': 0})
    return folder


def times_ms(page: Page, count: int) -> dict[str, float]:
    """Return the median time of each task, ms."""
    out = {}
    for name, (act, shown, back, shown_again) in tasks(count).items():
        found = []
        for _ in range(TIMES):
            found.append(float(page.evaluate(CLOCKED, [act, shown])))
            page.evaluate(CLOCKED, [back, shown_again])
        out[name] = statistics.median(found)
    return out


def main() -> None:
    """Print a row for each number of passes."""
    counts = [int(text) for text in sys.argv[1:]] or [200, 2000]
    names = list(tasks(0))
    print('| passes | ' + ' | '.join(f'{name}, ms' for name in names) + ' |')
    print('|---|' + '---|' * len(names))
    with tempfile.TemporaryDirectory() as folder, headless.browsing() as browser:
        for count in counts:
            runs = open_runs([write_passes(Path(folder, str(n)), n) for n in (count, count + 1)])
            guard = Guard()
            with guard.bind(0) as sock, served(Studio(guard, runs=runs), sock):
                page = browser.new_page(viewport=headless.SIZE, bypass_csp=True)
                page.set_default_timeout(headless.WAIT_MS)
                page.goto(guard.url)
                page.wait_for_selector('#passes tbody tr')
                row = times_ms(page, count)
                page.close()
            print(f'| {count} | ' + ' | '.join(f'{value:.0f}' for value in row.values()) + ' |')


if __name__ == '__main__':
    main()
