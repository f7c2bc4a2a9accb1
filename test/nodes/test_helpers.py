# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What nodes load, and the processes that are made before ROS is there."""
from __future__ import annotations

import subprocess
import sys

import pytest

pytest.importorskip('rclpy')

from stereo_speed.nodes.helpers import Helpers  # noqa: E402, I100

END_S = 60.0
_GIVEN = """
from stereo_speed.nodes.helpers import Helpers
helpers = Helpers()
helpers.fork()
fork, searches = helpers._pass.process, helpers.search_process()
searches.wait()
print(type(searches.process).__name__, type(fork).__name__, fork.poll())
helpers.close()
print(fork.poll() is not None)
another = helpers.search_process()
print(type(another.process).__name__, another.process.pid != searches.process.pid)
searches.close(), another.close()
"""


def python(script):
    """Return what a script prints in a Python of its own."""
    return subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                          timeout=END_S, check=True).stdout.split()


def loaded(module):
    """Return what a module loads, by the first parts of the names."""
    return set(python(f'import sys, {module}\nprint(*(m.partition(".")[0] for m in sys.modules), '
                      '*(m for m in sys.modules if m.startswith("stereo_speed.")))'))


@pytest.mark.parametrize('node', ['stereo_sync_node', 'speed_node', 'log_node'])
def test_a_node_that_does_not_measure_loads_nothing_of_what_does(node):
    """It is there again the sooner after it was killed."""
    has = loaded(f'stereo_speed.nodes.{node}')
    assert 'rclpy' in has
    assert not has & {'scipy', 'numba', 'stereo_speed.pipeline', 'stereo_speed.road',
                      'stereo_speed.tracking', 'stereo_speed.detection'}


@pytest.mark.parametrize('node', ['tracker_node', 'speed_camera_node'])
def test_a_node_that_measures_is_without_ros_until_its_processes_are_made(node):
    assert 'rclpy' not in loaded(f'stereo_speed.nodes.{node}')


def test_forks_are_given_away_once_and_the_others_end():
    """In a Python of its own, for this one has threads."""
    assert python(_GIVEN) == ['Fork', 'Fork', 'None', 'True', 'Popen', 'True']


def test_where_there_are_no_forks_processes_of_their_own_are_given_away():
    helpers = Helpers()
    process = helpers.search_process()
    assert isinstance(process.process, subprocess.Popen)
    process.close()
    helpers.close()
