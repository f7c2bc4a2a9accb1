# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The command ``studio``: bad input, and a whole run."""
from __future__ import annotations

import http.cookiejar
import json
import signal
import socket
import subprocess
import sys
import urllib.request

import pytest
from stereo_speed.cli.main import main

START_S = 90.0


@pytest.mark.parametrize(('options', 'told'), [
    (['none'], 'none: bag: found no such file or folder'),
    (['BAG', '--site', 'BAG'], 'found a folder, wanted the name of a file'),
    (['BAG', '--site', 'none/site.yaml'], 'folder: found none'),
    (['BAG', '--port', '70000'], '--port: 70000 is not in [0, 65535]'),
    (['BAG', '--address', '0.0.0.0', '--port', '0'], 'wanted one address of this machine'),
    (['BAG', '--live'], 'found a bag or a run as well'),
    (['--site', 'site.yaml', '--port', '0'], 'BAG: found none with a site'),
    (['--run', 'none', '--port', '0'], 'none: folder: found no such folder'),
])
def test_bad_input_is_one_line(options, told, sample, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    options = [str(sample / 'bag') if option == 'BAG' else option for option in options]
    assert main(['studio', *options]) == 2
    error = capsys.readouterr().err
    assert told in error and error.count('\n') == 1


def test_port_in_use_is_one_line(capsys):
    with socket.socket() as taken:
        taken.bind(('127.0.0.1', 0))
        taken.listen()
        assert main(['studio', '--port', str(taken.getsockname()[1])]) == 2
    assert 'wanted a free port' in capsys.readouterr().err


def test_studio_serves_until_it_is_stopped_and_reports_unsaved_drafts(sample, tmp_path):
    command = [sys.executable, '-m', 'stereo_speed', 'studio', str(sample / 'bag'),
               '--site', str(tmp_path / 'new.yaml'), '--port', '0']
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                          cwd=tmp_path) as process:
        try:
            assert process.stdout.readline() == f'the site is saved to {tmp_path}/new.yaml\n'
            url = process.stdout.readline().split()[-1]
            page = urllib.request.build_opener(
                urllib.request.HTTPCookieProcessor(http.cookiejar.CookieJar()))
            with page.open(url, timeout=START_S) as answer:
                assert b'studio' in answer.read()
            step = urllib.request.Request(
                f'{url.partition("?")[0]}api/step', method='POST',
                data=json.dumps({'id': '1', 'name': 'add_line', 'fields': {}}).encode(),
                headers={'Content-Type': 'application/json'})
            with page.open(step, timeout=START_S) as answer:
                assert json.load(answer) == {'version': 1}
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=START_S) == 0
        finally:
            process.kill()
        assert process.stderr.read() == ('warning: changes of the site were not saved to '
                                         f'{tmp_path}/new.yaml\n')
    assert list(tmp_path.iterdir()) == []
