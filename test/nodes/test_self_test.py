# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Nothing is measured after the start of a node until its self-test has passed."""
from __future__ import annotations

from datetime import datetime, timezone
import time
from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy')

from stereo_speed.core.errors import InputError  # noqa: E402, I100
from stereo_speed.nodes import self_test  # noqa: E402
from stereo_speed.nodes.health import ERROR, OK  # noqa: E402
from stereo_speed.nodes.self_test import SelfTestWatch  # noqa: E402
from stereo_speed.pipeline.config import PipelineConfig  # noqa: E402

LONGEST_S = 120.0


def make_watch(folder):
    """Make a watch of a node without logging, with the folder of a stored pass."""
    log = SimpleNamespace(info=lambda line: None, error=lambda line: None)
    node = SimpleNamespace(get_logger=lambda: log, get_name=lambda: 'node')
    given = SimpleNamespace(get=lambda name, default, *_: (
        str(folder) if name == 'self_test' else default))
    return SelfTestWatch(node, given, PipelineConfig())


def poll_until(watch, condition):
    """Poll like the node until the condition holds."""
    end_s = time.monotonic() + LONGEST_S
    while not condition() and time.monotonic() < end_s:
        watch.poll()
        time.sleep(0.02)
    assert condition()


def test_everything_is_withheld_until_the_self_test_passes(sample):
    watch, begun = make_watch(sample), datetime.now(timezone.utc).replace(microsecond=0)
    try:
        before = watch.state()
        assert watch.newest is None
        assert (before.level, before.message) == (ERROR, 'self-test running') and watch.withholds
        watch.poll()  # has begun
        assert watch.withholds
        poll_until(watch, lambda: not watch.withholds)
    finally:
        watch.close()
    after = watch.state()
    assert (after.level, after.message, after.values['passed']) == (OK, 'passed', 1)
    assert abs(watch.newest['off_percent']) < 1.0  # the value for records
    passed = datetime.strptime(watch.newest['passed_utc'], '%Y-%m-%dT%H:%M:%S%z')
    assert begun <= passed <= datetime.now(timezone.utc)


def test_self_test_that_cannot_run_withholds_too(sample, tmp_path):
    """A stored pass with a damaged truth file is named."""
    for name in ('bag', 'site.yaml'):
        (tmp_path / name).symlink_to(sample / name)
    (tmp_path / 'truth.csv').write_text('nothing\n')
    watch = make_watch(tmp_path)
    try:
        poll_until(watch, lambda: watch.failed == 1)
        assert watch.withholds
        state = watch.state()
    finally:
        watch.close()
    assert state.level == ERROR and 'truth.csv' in state.message


def test_folder_without_a_stored_pass_is_refused(tmp_path):
    with pytest.raises(InputError, match='a folder with site.yaml, truth.csv, bag'):
        make_watch(tmp_path)


def test_without_a_folder_nothing_is_withheld():
    watch = make_watch('')
    watch.poll()
    assert not watch.withholds and watch.state().message == 'no self-test is configured'


def test_self_test_that_cannot_be_started_is_tried_again(sample, monkeypatch):
    """When there is no memory for another process; the node goes on."""
    watch = make_watch(sample)
    with monkeypatch.context() as patch:
        def no_memory(*_, **__):
            raise OSError(12, 'Cannot allocate memory')
        patch.setattr(self_test.subprocess, 'Popen', no_memory)
        watch.poll()
        watch.poll()  # not yet again
    try:
        assert watch.withholds and watch.failed == 1
        assert 'cannot be started: [Errno 12]' in watch.state().message
        monkeypatch.setattr(self_test, 'time', SimpleNamespace(
            monotonic=lambda now=time.monotonic: now() + 61.0))
        poll_until(watch, lambda: not watch.withholds)
    finally:
        watch.close()
