# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Check that a colcon install prefix has the files that ``ros2 run`` and ``launch`` need."""
from __future__ import annotations

import os
from pathlib import Path
import sys

EXECUTABLES = ('stereo_sync_node', 'tracker_node', 'speed_node', 'speed_camera_node',
               'replay_node', 'environment_node', 'evidence_node', 'log_node', 'studio_node',
               'track-environment', 'map', 'replay', 'replay-many', 'evidence', 'site',
               'studio', 'self-test', 'stats', 'verify-against', 'simulate', 'disturb',
               'accuracy', 'second', 'violations', 'evaluate', 'traffic', 'roads', 'tamper',
               'faults', 'endurance', 'fuzz', 'bench', 'demo')


def missing(prefix: Path, source: Path) -> list[str]:
    """
    Return the files that are missing under the prefix.

    :param prefix: install prefix of the package.
    :param source: root of the checkout that it was built from.
    """
    share = prefix / 'share' / 'stereo_speed'
    files = [prefix / 'share/ament_index/resource_index/packages/stereo_speed',
             share / 'package.xml', share / 'hook' / 'ament_prefix_path.sh']
    for folder in ('launch', 'config'):
        files += [share / folder / f.name for f in sorted((source / folder).glob('*'))
                  if f.is_file()]
    programs = [prefix / 'lib' / 'stereo_speed' / name for name in EXECUTABLES]
    return ([str(f) for f in files if not f.is_file()]
            + [f'{p} (executable)' for p in programs if not os.access(p, os.X_OK)])


def main() -> int:
    """Check the prefix named on the command line."""
    prefix = Path(sys.argv[1])
    lacking = missing(prefix, Path(__file__).resolve().parent.parent)
    for line in lacking:
        print(f'missing: {line}', file=sys.stderr)
    if not lacking:
        print(f'{prefix}: {len(EXECUTABLES)} executables, launch, config and index are there')
    return 1 if lacking else 0


if __name__ == '__main__':
    sys.exit(main())
