# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The shipped configuration and launch files say what the code does."""
from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from xml.etree import ElementTree

import pytest
from stereo_speed.core.config import parameters_of, TrackerConfig
from stereo_speed.pipeline.config import load_pipeline_config, SiteConfig
from stereo_speed.pipeline.registry import DETECTORS, TRACKERS
import yaml

ROOT = Path(__file__).resolve().parents[2]


def test_tracker_yaml_holds_the_defaults_of_every_parameter():
    path = ROOT / 'config' / 'tracker.yaml'
    found = load_pipeline_config(path)
    assert found.shared == TrackerConfig()
    data = yaml.safe_load(path.read_text())
    assert_whole({k: v for k, v in data.items() if k in asdict(TrackerConfig())},
                 TrackerConfig)
    assert found.site == SiteConfig()
    assert_whole({k: data[k] for k in asdict(SiteConfig())}, SiteConfig)
    assert set(data) == {*asdict(TrackerConfig()), *asdict(SiteConfig()), 'trackers', 'detectors'}
    for registry, given in ((TRACKERS, found.trackers), (DETECTORS, found.detectors)):
        for name in registry.own:
            kind = registry.load(name).Settings
            assert given.get(name, kind()) == kind()
            assert_whole(data[f'{registry.kind}s'].get(name, {}), kind)


def assert_whole(values, kind):
    """Check that a mapping names every parameter of a record and of its sections."""
    found = {f'{k}.{inner}' if isinstance(v, dict) else k for k, v in values.items()
             for inner in (v if isinstance(v, dict) else (None,))}
    assert found == {name for name, _ in parameters_of(kind)}


def test_node_parameters_hold_the_same_defaults():
    data = yaml.safe_load((ROOT / 'config' / 'stereo_speed.params.yaml').read_text())
    values = data['/**/tracker_node']['ros__parameters']
    assert {k: values[k] for k in asdict(TrackerConfig())} == asdict(TrackerConfig())
    offline = yaml.safe_load((ROOT / 'config' / 'tracker.yaml').read_text())
    assert {k: values[k] for k in offline} == offline


@pytest.mark.parametrize('path', sorted((ROOT / 'launch').glob('*.xml')), ids=lambda p: p.name)
def test_launch_files_name_what_is_installed(path):
    setup = (ROOT / 'setup.py').read_text()
    root = ElementTree.parse(path).getroot()
    nodes = list(root.iter('node'))
    for node in nodes:
        assert node.get('pkg') == 'stereo_speed'
        assert f"'{node.get('exec')} = " in setup
    for element in root.iter():
        for value in element.attrib.values():
            if value.startswith('$(find-pkg-share stereo_speed)/'):
                assert (ROOT / value.partition(')/')[2]).is_file()
    assert nodes


def test_parameters_of_the_launch_file_are_declared_by_the_nodes():
    source = {n: (ROOT / 'stereo_speed' / 'nodes' / f'{n}.py').read_text()
              for n in ('stereo_sync_node', 'tracker_node', 'replay_node',
                        'environment_node')}
    for path in (ROOT / 'launch').glob('*.xml'):
        for node in ElementTree.parse(path).getroot().iter('node'):
            for param in node.iter('param'):
                if param.get('name'):
                    assert f"'{param.get('name')}'" in source[node.get('exec')]
