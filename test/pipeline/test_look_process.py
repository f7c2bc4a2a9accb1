# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A rig check in another process has the same result as here, at little cost."""
from __future__ import annotations

from dataclasses import replace
import os
from pathlib import Path
import time

import numpy as np
import pytest
from stereo_speed.core.records import RigMotion
from stereo_speed.io.bags import StereoBag
from stereo_speed.pipeline.assembly import MeasuringSite
from stereo_speed.pipeline.config import SiteConfig
from stereo_speed.pipeline.look_process import LookProcess, LookProcessError
from stereo_speed.pipeline.rig_look import look_at_rig
from stereo_speed.site.file import load_site
from stereo_speed.site.refine.rig_state import Stance

SAMPLE = Path(__file__).parents[2] / 'sample' / 'straight55'
LONGEST_S = 120.0
pytestmark = pytest.mark.slow


@pytest.fixture
def process():
    """Return a process that is ready, and end it afterwards."""
    out = LookProcess(patience=0)  # all tests are equal
    out.wait()
    yield out
    out.close(0.0)


@pytest.fixture(scope='module')
def seen():
    """Return the stance of the sample, and five of its pairs."""
    with StereoBag(SAMPLE / 'bag') as bag:
        rig, pairs = bag.rig, list(bag.pairs())
    place = MeasuringSite.of(load_site(SAMPLE / 'site.yaml'), rig)
    return Stance(place.site, place.rig, dict(place.lanes)), pairs[:10:2]


def found(process):
    """Wait for the result of a check."""
    end_s = time.monotonic() + LONGEST_S
    while (state := process.found()) is None:
        assert time.monotonic() < end_s
        time.sleep(0.02)
    return state


def test_result_equals_that_of_a_look_in_this_process(process, seen):
    used, pairs = seen
    pairs = [replace(pairs[0], motion=RigMotion((1e-4, 0.0, 0.0))), *pairs[1:]]
    for pair in pairs:
        kept = replace(pair, left=pair.left.copy(), right=pair.right.copy())
        process.lay(kept)
        kept.left[:], kept.right[:] = 0, 0  # the stored pair is a copy
    process.look(used, SiteConfig(), RigMotion(), None)
    here, there = look_at_rig(used, pairs, SiteConfig(), RigMotion(), None), found(process)
    assert (there.text, there.share, there.std_share, there.turned) == (
        here.text, here.share, here.std_share, here.turned)


@pytest.mark.parametrize('patience', [0, 10])
def test_process_runs_at_its_priority(patience):
    process = LookProcess(patience)
    here, there = (os.getpriority(os.PRIO_PROCESS, pid) for pid in (0, process.process.pid))
    process.close(0.0)
    assert there == min(here + patience, 19)


def test_failed_look_says_why(process, seen):
    used, pairs = seen
    process.lay(replace(pairs[0], left=np.zeros((2, 2), np.uint8),
                        right=np.zeros((2, 2), np.uint8)))
    process.look(replace(used, lanes={}, rig=None), SiteConfig(), None, None)
    with pytest.raises(LookProcessError, match='Error'):
        found(process)


def test_ended_process_is_reported(process, seen):
    process.process.kill()
    process.process.wait()
    with pytest.raises(OSError):
        for _ in range(2):  # the message sent may still be accepted
            process.look(seen[0], SiteConfig(), None, None)
            found(process)
