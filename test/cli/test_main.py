# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The common part of the command line: exit status, one-line errors, lazy imports."""
from __future__ import annotations

import argparse
import sys

import pytest
import stereo_speed
from stereo_speed.cli import main as cli
from stereo_speed.core.errors import SiteError


@pytest.fixture
def command(monkeypatch):
    """Return a function that installs a command that runs a given action."""
    def install(action):
        class Module:
            run = staticmethod(action)

            @staticmethod
            def add_arguments(parser):
                pass
        monkeypatch.setitem(sys.modules, 'acting', Module)
        monkeypatch.setitem(cli.COMMANDS, 'act', ('acting', 'does what it is told'))
    return install


def raising(error):
    """Return an action that raises."""
    def action(args: argparse.Namespace) -> int:
        raise error
    return action


@pytest.mark.parametrize(('result', 'status'), [(0, 0), (None, 0), (1, 1)])
def test_status_of_a_command(command, result, status):
    command(lambda args: result)
    assert cli.main(['act']) == status


@pytest.mark.parametrize(('error', 'line'), [
    (SiteError('site.yaml', 'lines.kerb', 'nan', 'a number'),
     'error: site.yaml: lines.kerb: found nan, wanted a number\n'),
    (PermissionError(13, 'Permission denied', 'out'), 'error: out: Permission denied\n'),
    (ModuleNotFoundError("No module named 'rclpy'", name='rclpy'),
     'error: act: needs the Python module rclpy, which is not installed\n'),
], ids=['input', 'os', 'module'])
def test_errors_are_one_line(command, capsys, error, line):
    command(raising(error))
    assert cli.main(['act']) == 2
    assert capsys.readouterr().err == line


def test_interrupt(command):
    command(raising(KeyboardInterrupt()))
    assert cli.main(['act']) == 130


def test_program_faults_are_not_hidden(command):
    command(raising(ZeroDivisionError()))
    with pytest.raises(ZeroDivisionError):
        cli.main(['act'])


@pytest.mark.parametrize('argv', [[], ['fly'], ['--colour']], ids=str)
def test_unknown_command(capsys, argv):
    assert cli.main(argv) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith('error: stereo_speed: ')
    assert captured.err.count('\n') == 1


def test_help_and_version(capsys):
    assert cli.main(['--version']) == 0
    assert stereo_speed.__version__ in capsys.readouterr().out
    assert cli.main(['--help']) == 0
    printed = capsys.readouterr().out
    assert all(name in printed for name in cli.COMMANDS)


@pytest.mark.parametrize('name', list(cli.COMMANDS))
def test_every_command_has_help(capsys, name):
    assert cli.main([name, '--help']) == 0
    assert 'usage: stereo_speed ' + name in capsys.readouterr().out


def test_executables_are_the_commands(monkeypatch, capsys):
    for name in cli.COMMANDS:
        monkeypatch.setattr(sys, 'argv', [name, '--help'])
        assert cli.run_executable() == 0
        assert f'usage: stereo_speed {name}' in capsys.readouterr().out
