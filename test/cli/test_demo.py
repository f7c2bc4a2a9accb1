# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What the demo prints of a reading, and the graph that it has to itself."""
from __future__ import annotations

from contextlib import ExitStack
import subprocess
import sys

from stereo_speed.cli.demo import reading_line
from stereo_speed.core.units import MPH_MPS
from stereo_speed.io.truth import truth_of_rows

START_NS = 1_700_000_000_123_456_000
TRUTH, = truth_of_rows([{'stamp_ns': START_NS + k * 33_333_333, 'vehicle': 0,
                         'speed': (55 + k) * MPH_MPS} for k in range(3)])


def test_truth_beside_a_reading_is_that_of_its_stamp():
    """Also where stamps are not whole milliseconds."""
    reading = (START_NS + 66_666_666, 'vehicle_0', 56.75 * MPH_MPS, 0.1 * MPH_MPS)
    assert reading_line(reading, TRUTH) == (
        '  0.1 s  vehicle_0   56.75 ± 0.10 mph   truth  57.00   error -0.25')


def test_reading_without_a_truth_is_printed_alone():
    reading = (START_NS + 50_000_000, 'vehicle_0', 56.75 * MPH_MPS, 0.1 * MPH_MPS)
    assert reading_line(reading, TRUTH).endswith('0.10 mph')


def test_each_private_graph_has_a_domain_of_its_own():
    """Of two processes whose numbers would have them share one, too."""
    script = '\n'.join((
        'import os', 'from stereo_speed.cli import demo', 'os.getpid = lambda: 7',
        'os.environ.pop("ROS_DOMAIN_ID", None)', 'demo.private_graph()',
        'print(os.environ["ROS_DOMAIN_ID"], flush=True)', 'input()'))
    with ExitStack() as running:
        graphs = [running.enter_context(subprocess.Popen(
            [sys.executable, '-c', script], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            text=True)) for _ in range(3)]
        domains = [int(graph.stdout.readline()) for graph in graphs]
        assert len(set(domains)) == 3 and all(20 <= domain < 100 for domain in domains)
        for graph in graphs:
            graph.communicate('\n')
