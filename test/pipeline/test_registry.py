# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Trackers and detectors by name, and the errors for unavailable ones."""
from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path
import subprocess
import sys

import pytest
from stereo_speed.core.config import NoParameters
from stereo_speed.core.errors import InputError
from stereo_speed.pipeline import registry as module
from stereo_speed.pipeline.registry import DETECTORS, Registry, TRACKERS

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize('registry', [TRACKERS, DETECTORS], ids=lambda r: r.kind)
def test_every_class_of_the_package_keeps_the_protocol(registry):
    for name in registry.own:
        kind = registry.load(name)
        settings = registry.settings(name, {}, 'here')
        assert isinstance(settings, kind.Settings)
        for method in ('start',) if registry is TRACKERS else ('update', 'reset'):
            assert callable(getattr(kind, method)), (name, method)


def points(*pairs):
    """Return a stand-in for the entry points that other packages offer."""
    def entry_points(group):
        return [EntryPoint(name=name, value=value, group=group) for name, value in pairs]
    return entry_points


def test_external_classes_are_found_by_their_entry_points(monkeypatch):
    monkeypatch.setattr(module, 'entry_points', points(
        ('mine', 'collections:OrderedDict'), ('own', 'a:B')))
    found = Registry('tracker', 'some.group', {'own': 'a:B'})
    assert found.names == ('own', 'mine')
    assert found.load('mine').__name__ == 'OrderedDict'
    assert found.settings('mine', {}, 'here') == NoParameters()


@pytest.mark.parametrize(('offered', 'wanted', 'line'), [
    ((('own', 'c:D'),), 'own', 'entry points some.group: own: found a:B and c:D'),
    ((), 'none', 'configuration: tracker: found none, wanted own'),
    ((('broken', 'no_such_module:C'),), 'broken', 'tracker broken: no_such_module:C: found No'),
    ((('empty', 'collections:Nothing'),), 'empty', 'tracker empty: collections:Nothing: found'),
], ids=['twice', 'unknown', 'module', 'class'])
def test_unavailable_class_is_named(offered, wanted, line, monkeypatch):
    monkeypatch.setattr(module, 'entry_points', points(*offered))
    with pytest.raises(InputError) as caught:
        Registry('tracker', 'some.group', {'own': 'a:B'}).load(wanted)
    assert str(caught.value).startswith(line)


@pytest.mark.slow
@pytest.mark.parametrize(
    'imported', ['stereo_speed.cli.replay', 'stereo_speed.nodes.tracker_node'])
def test_instrument_starts_without_the_laboratory(imported):
    if '.nodes.' in imported:
        pytest.importorskip('rclpy')
    code = (f'import sys, {imported}\n'
            'from stereo_speed.pipeline.registry import DETECTORS, TRACKERS\n'
            'TRACKERS.load("constrained"), DETECTORS.load("plane_sweep")\n'
            'print([m for m in sys.modules if m.startswith("stereo_speed.lab")])')
    done = subprocess.run([sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True,
                          timeout=60)
    assert done.stdout.strip() == '[]', done.stderr
