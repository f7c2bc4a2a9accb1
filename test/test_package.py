# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The package's files agree with each other and with the tree."""
from __future__ import annotations

import ast
import importlib
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
import re
import subprocess
from typing import Any
import xml.etree.ElementTree as ElementTree

import pytest
import stereo_speed
from stereo_speed.cli.main import COMMANDS
from stereo_speed.pipeline.registry import DETECTORS, TRACKERS

ROOT = Path(__file__).resolve().parents[1]
HEADER = ('# Copyright 2026 The stereo_speed developers\n'
          '# SPDX-License-Identifier: Apache-2.0\n')
SOURCES = sorted(p for folder in ('stereo_speed', 'test', 'launch', 'tools')
                 for p in (ROOT / folder).rglob('*.py')
                 if not (p.name == '__init__.py' and not p.read_text().strip()))


@pytest.fixture(scope='module')
def setup_arguments() -> dict[str, Any]:
    """Run setup.py with a ``setup`` that only records its arguments."""
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


def test_manifest_names_every_imported_ros_package(manifest):
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


def test_scripts_are_callable(setup_arguments):
    for script in setup_arguments['entry_points']['console_scripts']:
        name, _, target = script.partition(' = ')
        module, _, function = target.partition(':')
        if '.nodes.' in module and find_spec('rclpy') is None:
            pytest.skip(f'{name} needs rclpy')
        assert callable(getattr(importlib.import_module(module), function)), name


def test_every_command_is_an_executable(setup_arguments):
    scripts = dict(s.split(' = ') for s in setup_arguments['entry_points']['console_scripts'])
    assert {name for name in scripts if not name.endswith('_node')} == set(COMMANDS)
    assert {scripts[name] for name in COMMANDS} == {'stereo_speed.cli.main:run_executable'}


@pytest.mark.parametrize('registry', [TRACKERS, DETECTORS], ids=lambda r: r.kind)
def test_entry_points_equal_the_registry(setup_arguments, registry):
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


def test_lock_pins_all_requirements():
    """Each requirement is in the lock by name, and the lock has only pins."""
    def names(file: str, pattern: str) -> set[str]:
        lines = (line.partition('#')[0].strip() for line in (ROOT / file).read_text().split('\n'))
        return {re.fullmatch(pattern, line)[1].lower() for line in lines if line}
    pinned = names('requirements.lock', r'([\w.-]+)==[\w.]+( ; python_version .*)?')
    assert names('requirements.in', r'([\w-]+)(\[\w+\])?(<[\d.]+)?') <= pinned


def test_shell_scripts_parse():
    for script in ('.ci/run', 'tools/venv.sh', 'tools/pythons.sh'):
        subprocess.run(['bash', '-n', str(ROOT / script)], check=True)


def test_environment_is_made_once_by_two_targets_at_once(tmp_path):
    log, venv, python = (tmp_path / name for name in ('log', 'venv', 'python'))
    python.write_text(f"""#!/bin/bash
        case "$*" in
            *version_info*:2*) echo 3.12 ;;
            '-m venv '*) mkdir -p {venv}/bin && cp "$0" {venv}/bin/python ;;
            *' pip install '*) echo begun >> {log}; sleep 1; echo done >> {log} ;;
            *purelib*) echo {venv} ;;
        esac""")
    python.chmod(0o755)
    both = [subprocess.Popen(['bash', str(ROOT / 'tools/venv.sh'), str(python), str(venv)])
            for _ in range(2)]
    try:
        assert [one.wait(60) for one in both] == [0, 0]
    finally:
        for one in both:
            one.kill()
    assert log.read_text().split() == ['begun', 'done']


@pytest.mark.parametrize(('pin', 'status'), [('{}', 0), ('0.{}', 1)])
def test_versions_equal_those_pinned_in_a_file(tmp_path, capsys, pin, status):
    pins = tmp_path / 'pins.txt'
    wanted = pin.format(version('numpy'))
    pins.write_text(f'# of some system\nnumpy=={wanted}\ntqdm=={version("tqdm")}\n')
    assert tool('as_pinned').main(str(pins)) == status
    told = f'numpy is {version("numpy")}, not {wanted}\n' if status else ''
    assert capsys.readouterr().err == told


def test_container_takes_tracked_files_and_no_build_products():
    lines = (ROOT / 'Containerfile').read_text().splitlines()
    steps = ' '.join(line for line in lines if not line.startswith('#'))
    named = set(re.findall(r'src/stereo_speed/([\w./-]+)', steps))
    assert named == {'requirements.lock', 'tools/noble.txt'}
    for pattern, file in re.findall(r"grep -E '([^']+)' src/stereo_speed/([\w./-]+)", steps):
        assert re.search(pattern, (ROOT / file).read_text(), re.MULTILINE), (pattern, file)
    made, left_out = ({line.strip('*/') for line in (ROOT / name).read_text().split()}
                      for name in ('.gitignore', '.dockerignore'))
    assert {name for name in made if '.egg' not in name} <= left_out


def test_manifest_names_only_rosdep_keys(manifest):
    """By a list made from the public one at a commit that it names."""
    lines = (ROOT / 'tools' / 'rosdep_keys.txt').read_text().splitlines()
    known = {line for line in lines if line and not line.startswith('#')}
    named = {element.text for element in manifest if element.tag.endswith('_depend')}
    assert named <= known


def test_policy_has_a_profile_for_every_node(setup_arguments):
    policy = ElementTree.parse(ROOT / 'config' / 'stereo_speed.policy.xml').getroot()
    profiles = {p.get('node'): p for p in policy.iter('profile')}
    nodes = {script.partition(' = ')[0]
             for script in setup_arguments['entry_points']['console_scripts']}
    assert {name for name in nodes if name.endswith('_node')} <= set(profiles)
    for name, profile in profiles.items():
        services = {service.text for service in profile.iter('service')}
        assert f'{name}/set_parameters' in services


def test_nothing_is_unpickled_and_no_yaml_is_unsafe():
    """
    Files of others are read by readers that can create only plain values.

    Passes go to a process of one's own through sockets that nobody else holds.
    """
    own = ROOT / 'stereo_speed' / 'pipeline' / 'pass_process.py'
    for path in (ROOT / 'stereo_speed').rglob('*.py'):
        imported = {alias.name for node in ast.walk(ast.parse(path.read_text()))
                    if isinstance(node, (ast.Import, ast.ImportFrom)) for alias in node.names}
        allowed = {'pickle'} if path == own else set()
        assert not {'pickle', 'marshal', 'shelve', 'dill'} & imported - allowed, path
        assert 'allow_pickle=True' not in path.read_text(), path


def tool(name: str):
    """Return a program of tools/ as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / 'tools' / f'{name}.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope='module')
def release_check():
    return tool('release_check')


@pytest.mark.parametrize(('version', 'applies'), [
    ('0.9', False), ('1.0', True), ('1.4.9', True), ('1.5', False), ('2.0', True),
    ('2.3', True), ('2.3.1', False), ('0.4.dev1', True)])
def test_advisory_applies_only_to_its_versions(version, applies):
    """1.0 up to before 1.5, 2.0 up to 2.3, and one by itself."""
    advisory = {'ranges': [['1.0', '1.5', None], ['2.0', None, '2.3']], 'versions': ['0.4.dev1']}
    assert tool('audit').affects(advisory, version) == applies


def test_audit_reads_the_lock_and_reports_what_applies(tmp_path, capsys):
    audit, old = tool('audit'), tmp_path / 'old.txt'
    lines = (ROOT / 'requirements.lock').read_text().splitlines()
    assert len(audit.pins_of(ROOT / 'requirements.lock')) == sum(
        bool(line) and not line.startswith('#') for line in lines)
    assert audit.main([]) == 0
    assert 'none applies' in capsys.readouterr().out
    old.write_text('PyYAML==5.3  # of 2020\nnumpy==1.26.4 ; python_version < "3.13"\n')
    assert audit.main([str(old)]) == 1
    assert capsys.readouterr().err.splitlines() == [
        'error: pyyaml 5.3: PYSEC-2020-96 (CVE-2020-1747, GHSA-6757-jp84-gxfx)',
        'error: pyyaml 5.3: PYSEC-2021-142 (CVE-2020-14343, GHSA-8q59-q68h-6hv4)']
    old.write_text('unheard-of==1.0\n')
    assert audit.main([str(old)]) == 0
    assert 'NOT CHECKED: unheard-of' in capsys.readouterr().out
    old.write_text('numpy>=1.26\n')
    assert audit.main([str(old)]) == 2
    assert 'line 1' in capsys.readouterr().err


def test_list_of_keys_is_compared_with_the_public_one(tmp_path):
    keys = tool('rosdep_keys')
    python = {'python3-yaml': {'ubuntu': ['python3-yaml']}, 'python3-odd': {'gentoo': []},
              'python3-pip-only': {'ubuntu': {'pip': {'packages': ['x']}}}}
    packages = {'repositories': {'rclpy': {'release': {}}, 'many': {
        'release': {'packages': ['std_msgs', 'geometry_msgs']}}, 'source': {'source': {}}}}
    assert keys.known_keys(python, packages) == {
        'python3-yaml', 'rclpy', 'std_msgs', 'geometry_msgs'}


@pytest.mark.parametrize(('changelog', 'manifest', 'fault'), [
    ('1.2.3 (2026-11-22)\n------------------\n* x', '1.2.3', ''),
    ('1.2.2 (2026-11-22)\n------------------\n* x', '1.2.3', 'CHANGELOG.rst 1.2.2'),
    ('Forthcoming\n-----------\n1.2.3 (2026-11-22)\n---\n', '1.2.3', 'Forthcoming'),
    ('1.2.3 (2026-11-22)\n---\n', '1.2.4', 'package.xml 1.2.4'),
])
def test_release_has_one_version(release_check, tmp_path, changelog, manifest, fault):
    (tmp_path / 'stereo_speed').mkdir()
    (tmp_path / 'stereo_speed' / '__init__.py').write_text("__version__ = '1.2.3'\n")
    (tmp_path / 'setup.py').write_text("setup(version='1.2.3')\n")
    (tmp_path / 'package.xml').write_text(f'<p><version>{manifest}</version></p>')
    (tmp_path / 'CHANGELOG.rst').write_text(changelog)
    if not fault:
        assert release_check.check_versions(tmp_path) == 'version 1.2.3 everywhere'
        return
    with pytest.raises(release_check.CheckError, match=fault):
        release_check.check_versions(tmp_path)
