# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The package's files agree with each other and with the tree."""
from __future__ import annotations

import ast
import importlib
from importlib.util import find_spec
from pathlib import Path
import re
import subprocess
from typing import Any
import xml.etree.ElementTree as ElementTree

import pytest
import stereo_speed
from stereo_speed.pipeline.registry import DETECTORS, TRACKERS

ROOT = Path(__file__).resolve().parents[1]
HEADER = ('# Copyright 2026 The stereo_speed developers\n'
          '# SPDX-License-Identifier: Apache-2.0\n')
SOURCES = sorted(p for folder in ('stereo_speed', 'test', 'launch', 'tools')
                 for p in (ROOT / folder).rglob('*.py')
                 if not (p.name == '__init__.py' and not p.read_text().strip()))


@pytest.fixture(scope='module')
def setup_arguments() -> dict[str, Any]:
    """Run setup.py with a ``setup`` that only takes its arguments down."""
    import os
    import setuptools
    taken: dict[str, Any] = {}
    source = (ROOT / 'setup.py').read_text()
    original, folder = setuptools.setup, os.getcwd()
    setuptools.setup = taken.update
    try:
        os.chdir(ROOT)  # as builds do: its globs are relative
        exec(compile(source, 'setup.py', 'exec'), {'__name__': '__main__'})
    finally:
        setuptools.setup = original
        os.chdir(folder)
    return taken


@pytest.fixture(scope='module')
def manifest() -> ElementTree.Element:
    return ElementTree.parse(ROOT / 'package.xml').getroot()


def test_versions_agree(setup_arguments, manifest):
    assert setup_arguments['version'] == manifest.findtext('version') == stereo_speed.__version__


def test_manifest(manifest):
    assert manifest.get('format') == '3'
    assert manifest.findtext('name') == 'stereo_speed'
    assert manifest.findtext('license') == 'Apache-2.0'
    assert manifest.findtext('export/build_type') == 'ament_python'
    # Without an address that looks like one, ament's hooks are left out of the build.
    assert re.fullmatch(r'[\w.-]+@[\w-]+(\.[\w-]+)+', manifest.find('maintainer').get('email'))


def test_manifest_names_every_ros_package_that_is_imported(manifest):
    named = {element.text for element in manifest.findall('exec_depend')}
    imported = set()
    for path in (ROOT / 'stereo_speed').rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                imported.add(node.module.partition('.')[0])
    ros = {name for name in imported if name == 'rclpy' or name.endswith(('_msgs', '_interfaces'))}
    assert ros <= named


def test_data_files_match_the_tree(setup_arguments):
    installed = {source: Path(target) for target, sources in setup_arguments['data_files']
                 for source in sources}
    assert all((ROOT / source).is_file() for source in installed)
    for folder in ('launch', 'config'):
        for path in (ROOT / folder).iterdir():
            if path.is_file():
                wanted = Path('share/stereo_speed') / folder
                assert installed.get(f'{folder}/{path.name}') == wanted
    assert installed['package.xml'] == Path('share/stereo_speed')
    assert installed['resource/stereo_speed'] == Path(
        'share/ament_index/resource_index/packages')


def test_every_package_is_installed(setup_arguments):
    folders = {p.parent.relative_to(ROOT) for p in (ROOT / 'stereo_speed').rglob('*.py')}
    assert {'.'.join(folder.parts) for folder in folders} == set(setup_arguments['packages'])


def test_scripts_can_be_called(setup_arguments):
    for script in setup_arguments['entry_points']['console_scripts']:
        name, _, target = script.partition(' = ')
        module, _, function = target.partition(':')
        if '.nodes.' in module and find_spec('rclpy') is None:
            pytest.skip(f'{name} needs rclpy')
        assert callable(getattr(importlib.import_module(module), function)), name


@pytest.mark.parametrize('registry', [TRACKERS, DETECTORS], ids=lambda r: r.kind)
def test_entry_points_are_those_of_the_registry(setup_arguments, registry):
    points = setup_arguments['entry_points'][registry.group]
    assert dict(point.split(' = ') for point in points) == dict(registry.own)


def test_installed_scripts_are_checked_by_name(setup_arguments):
    spec = importlib.util.spec_from_file_location('check', ROOT / 'tools' / 'check_install.py')
    check = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(check)
    scripts = setup_arguments['entry_points']['console_scripts']
    assert sorted(check.EXECUTABLES) == sorted(s.partition(' = ')[0] for s in scripts)


@pytest.mark.parametrize('path', SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_licence_header(path):
    assert path.read_text().startswith(HEADER)


def test_licence_is_apache():
    text = (ROOT / 'LICENSE').read_text()
    assert 'Apache License' in text
    assert 'END OF TERMS AND CONDITIONS' in text


def test_lock_pins_all_that_is_asked_for():
    """Each requirement by name is in the lock, and the lock holds nothing but pins."""
    def names(file: str, pattern: str) -> set[str]:
        lines = (line.partition('#')[0].strip() for line in (ROOT / file).read_text().split('\n'))
        return {re.fullmatch(pattern, line)[1].lower() for line in lines if line}
    pinned = names('requirements.lock', r'([\w.-]+)==[\w.]+( ; python_version .*)?')
    assert names('requirements.in', r'([\w-]+)(\[\w+\])?(<[\d.]+)?') <= pinned


def test_shell_scripts_parse():
    for script in ('.ci/run', 'tools/venv.sh'):
        subprocess.run(['bash', '-n', str(ROOT / script)], check=True)
