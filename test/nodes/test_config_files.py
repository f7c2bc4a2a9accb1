# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The shipped configuration and launch files agree with the code."""
from __future__ import annotations

import ast
from dataclasses import asdict
from pathlib import Path
from xml.etree import ElementTree

import pytest
from stereo_speed.core.config import parameters_of
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.enforcement.config import EnforcementConfig, load_enforcement_config
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
    assert set(data) == {*asdict(TrackerConfig()), *asdict(SiteConfig()), 'trackers', 'detectors',
                         'enforcement'}
    assert load_enforcement_config(path) == EnforcementConfig()
    assert data['enforcement'] == asdict(EnforcementConfig())
    for registry, given in ((TRACKERS, found.trackers), (DETECTORS, found.detectors)):
        for name in registry.own:
            kind = registry.load(name).Settings
            assert given.get(name, kind()) == kind()
            assert_whole(data[f'{registry.kind}s'].get(name, {}), kind)


def assert_whole(values, kind):
    """Assert that a mapping names every parameter of a record and of its sections."""
    found = {f'{k}.{inner}' if isinstance(v, dict) else k for k, v in values.items()
             for inner in (v if isinstance(v, dict) else (None,))}
    assert found == {name for name, _ in parameters_of(kind)}


def test_node_parameters_hold_the_same_defaults():
    data = yaml.safe_load((ROOT / 'config' / 'stereo_speed.params.yaml').read_text())
    values = data['/**/tracker_node']['ros__parameters']
    assert {k: values[k] for k in asdict(TrackerConfig())} == asdict(TrackerConfig())
    offline = yaml.safe_load((ROOT / 'config' / 'tracker.yaml').read_text())
    offline.pop('enforcement')
    assert {k: values[k] for k in offline} == offline
    evidence = yaml.safe_load((ROOT / 'config' / 'evidence.params.yaml').read_text())
    values = evidence['/**/evidence_node']['ros__parameters']
    assert {k: values[k] for k in asdict(EnforcementConfig())} == asdict(EnforcementConfig())


def declared(*modules):
    """Return the parameters that node modules declare themselves, with their defaults."""
    calls = [call for module in modules for call in ast.walk(ast.parse(
        (ROOT / 'stereo_speed' / 'nodes' / f'{module}.py').read_text()))
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute)
        and call.func.attr == 'get' and ast.unparse(call.func.value) in ('p', 'self.p')]
    return {call.args[0].value: ast.literal_eval(call.args[1]) for call in calls}


def test_node_parameters_hold_what_the_tracker_node_declares():
    """Those from the launch file are comments there; two are mandatory."""
    names = declared('lifecycle', 'measuring_settings', 'self_test', 'rig_watch', 'frames',
                     'overlay')
    assert {'site', 'init', 'seed', 'autostart', 'self_test', 'road_frame'} <= set(names)
    text = (ROOT / 'config' / 'stereo_speed.params.yaml').read_text()
    lines = text.partition('tracker_node:')[2].partition('/**/')[0].splitlines()
    shown = yaml.safe_load('\n'.join(
        line.strip().removeprefix('# ') for line in lines
        if line.strip().removeprefix('# ').partition(':')[0] in names))
    assert shown == {name: default for name, default in names.items()
                     if name not in ('site', 'init')}


def test_layouts_use_the_road_frame():
    """It has z up, and a name that does not depend on a camera driver."""
    road = declared('frames')['road_frame']
    rviz = yaml.safe_load((ROOT / 'config' / 'stereo_speed.rviz').read_text())
    assert rviz['Visualization Manager']['Global Options']['Fixed Frame'] == road
    foxglove = yaml.safe_load((ROOT / 'config' / 'stereo_speed.foxglove.json').read_text())
    followed = [panel['followTf'] for panel in foxglove['configById'].values()
                if 'followTf' in panel]
    assert followed == [road]


@pytest.mark.parametrize('path', sorted((ROOT / 'launch').glob('*.xml')), ids=lambda p: p.name)
def test_launch_files_name_installed_files(path):
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


def test_launch_file_parameters_are_declared_by_the_nodes():
    measuring = ('lifecycle', 'measuring_settings', 'outputs')
    pairing = ('pairing', 'subscriptions')
    modules = {'stereo_sync_node': pairing, 'tracker_node': measuring,
               'speed_camera_node': (*pairing, *measuring),
               'log_node': ('log_node',), 'replay_node': ('replay_node',),
               'evidence_node': ('evidence_node', 'subscriptions'),
               'environment_node': ('environment_node', 'subscriptions')}
    source = {node: ''.join((ROOT / 'stereo_speed' / 'nodes' / f'{n}.py').read_text()
                            for n in names) for node, names in modules.items()}
    for path in (ROOT / 'launch').glob('*.xml'):
        for node in ElementTree.parse(path).getroot().iter('node'):
            for param in node.iter('param'):
                if param.get('name'):
                    assert f"'{param.get('name')}'" in source[node.get('exec')]


@pytest.mark.parametrize('path', sorted((ROOT / 'launch').glob('*.xml')), ids=lambda p: p.name)
def test_parameter_files_override_the_launch_file(path):
    """The last one wins, so files come last, and shipped ones omit what it sets."""
    root = ElementTree.parse(path).getroot()
    shipped = {arg.get('name'): arg.get('default').partition(')/')[2]
               for arg in root.iter('arg') if 'config/' in (arg.get('default') or '')}
    for node in root.iter('node'):
        params = list(node.iter('param'))
        assert all(p.get('from') is None for p in params[:-1])
        if not params or params[-1].get('from') is None:
            continue
        file = shipped[params[-1].get('from')[len('$(var '):-1]]
        values = yaml.safe_load((ROOT / file).read_text())
        given = values.get(f'/**/{node.get("exec")}', {}).get('ros__parameters', {})
        assert not {p.get('name') for p in params[:-1]} & set(given)


def test_single_process_has_the_parameters_of_the_three_nodes():
    three = yaml.safe_load((ROOT / 'config' / 'stereo_speed.params.yaml').read_text())
    one = yaml.safe_load((ROOT / 'config' / 'speed_camera.params.yaml').read_text())
    joined = {k: v for node in three.values() for k, v in node['ros__parameters'].items()}
    assert one == {'/**/speed_camera_node': {'ros__parameters': joined}}
