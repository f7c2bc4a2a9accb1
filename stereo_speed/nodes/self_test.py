# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The self-test of a measuring node: at start and at intervals, in a process of its own.

Before the first test has passed, and after a failed test until the next one passes, nothing is
measured and ``/diagnostics`` has an ERROR.
"""
from __future__ import annotations

from dataclasses import asdict
from datetime import datetime, timezone
from pathlib import Path
import subprocess
import sys
import tempfile
import time
from typing import Any, Optional

from rclpy.node import Node
import yaml

from .common import Parameters
from .health import ERROR, State
from ..core.errors import InputError
from ..pipeline.config import PipelineConfig
from ..pipeline.self_test import off_percent

_LONGEST_S = 300.0  # time after which a test has failed
_RETRY_S = 60.0  # until a test that could not be started is tried again
_FILES = ('site.yaml', 'truth.csv', 'bag')


class SelfTestWatch:
    """
    Runs ``self-test`` with the parameters of the node, and decides whether it may measure.

    :param node: the measuring node.
    :param p: declares the parameters.
    :param config: parameters of its pipeline.
    :raises InputError: the folder does not contain a stored pass.
    """

    def __init__(self, node: Node, p: Parameters, config: PipelineConfig) -> None:
        folder = p.get('self_test', '', 'folder with bag/, site.yaml and truth.csv of a stored '
                       'pass of one vehicle; nothing is measured unless it reads within 1 % of '
                       'its known speed; empty for no self-test')
        self.interval_s = p.get('self_test_interval_s', 3600.0, 'time from one self-test to the '
                                'next [s]', 10.0, 1e6)
        self.log, self.folder, self.fault = node.get_logger(), folder, ''
        self.passed = self.failed = 0
        self.newest: Optional[dict[str, Any]] = None  # the last passed test, for records
        self._process: Optional[subprocess.Popen[str]] = None
        self._begun_s = 0.0
        self._due_s = time.monotonic()
        self._scratch: Optional[tempfile.TemporaryDirectory[str]] = None
        if not folder:
            return
        for name in _FILES:
            if not (Path(folder) / name).exists():
                raise InputError(f'{node.get_name()}: parameter', 'self_test', folder,
                                 'a folder with ' + ', '.join(_FILES))
        self.fault = 'self-test running'
        self._scratch = tempfile.TemporaryDirectory(prefix='stereo_speed-')
        path = Path(self._scratch.name) / 'config.yaml'
        path.write_text(yaml.safe_dump(_parameters(config)), encoding='utf-8')
        self._command = [
            sys.executable, '-m', 'stereo_speed', 'self-test', folder, '--config', str(path),
            '--tracker', config.tracker, '--detector', config.detector]

    @property
    def withholds(self) -> bool:
        """Return whether nothing may be measured."""
        return bool(self.fault)

    def poll(self) -> None:
        """Begin a test that is due, or collect the result of one under way."""
        now_s = time.monotonic()
        if not self.folder:
            return
        if self._process is None:
            if now_s >= self._due_s:
                self._begun_s, self._due_s = now_s, now_s + self.interval_s
                try:
                    self._process = subprocess.Popen(
                        self._command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                        stderr=subprocess.STDOUT, text=True)
                except OSError as error:  # no memory, no processes or no files left
                    self._due_s = now_s + min(self.interval_s, _RETRY_S)
                    self._ended(-1, f'self-test cannot be started: {error}')
        elif self._process.poll() is not None:
            text = self._process.communicate()[0].strip()
            self._ended(self._process.returncode, text.splitlines()[-1] if text else '')
            self._process = None
        elif now_s - self._begun_s > _LONGEST_S:
            self._process.kill()
            self._process.communicate()
            self._ended(-1, f'self-test not finished within {_LONGEST_S:g} s')
            self._process = None

    def _ended(self, status: int, line: str) -> None:
        if status == 0:
            self.passed, self.fault = self.passed + 1, ''
            self.newest = {'passed_utc': f'{datetime.now(timezone.utc):%Y-%m-%dT%H:%M:%SZ}',
                           'off_percent': off_percent(line)}
            self.log.info(line)
        else:
            self.failed += 1
            self.fault = line or f'self-test ended with status {status}'
            self.log.error(f'{self.fault}: nothing is measured')

    def state(self) -> State:
        """Return the state of the self-test for ``/diagnostics``."""
        state = State('passed' if self.folder else 'no self-test is configured',
                      values={'passed': self.passed, 'failed': self.failed})
        if self.fault:
            state.find(ERROR, self.fault)
        return state

    def close(self) -> None:
        """Abort a test that is under way."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None
        if self._scratch is not None:
            self._scratch.cleanup()


def _parameters(config: PipelineConfig) -> dict[str, Any]:
    """Return the parameters in the form that ``--config`` reads."""
    return {**asdict(config.shared), **asdict(config.site),
            'trackers': {config.tracker: asdict(config.tracker_settings)},
            'detectors': {config.detector: asdict(config.detector_settings)}}
