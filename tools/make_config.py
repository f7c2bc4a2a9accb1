# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Rewrite the parameters in ``config/``, after a default or a text has changed."""
from __future__ import annotations

import dataclasses
from pathlib import Path
import sys
import textwrap

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from stereo_speed.core.tracker_config import TrackerConfig  # noqa: E402
from stereo_speed.enforcement.config import EnforcementConfig  # noqa: E402
from stereo_speed.monocular.config import MonocularConfig  # noqa: E402
from stereo_speed.pipeline.config import SiteConfig  # noqa: E402
from stereo_speed.pipeline.registry import DETECTORS, TRACKERS  # noqa: E402

HEAD = '# Parameters for `replay --config`; these are the defaults.\n'
ENVIRONMENT_HEAD = ('# Parameters of the monocular tracker for `track-environment --config`; these'
                    ' are the\n# defaults.\n')
SPEED_CAMERA_HEAD = """# Parameters of speed_camera_node, as in stereo_speed.params.yaml.
/**/speed_camera_node:
  ros__parameters:"""
NODE_HEAD = """# Parameters of environment_node; these are the defaults.
# `map` and `targets` are arguments of the launch file.
/**/environment_node:
  ros__parameters:
    # seed of all randomness
    seed: 0
    # 'environment' or 'plain'; a value set here overrides the argument of the launch file
    # tracker: environment
    # use every stride-th frame, counted from the frame of each mark
    stride: 1
    # number of recent frames that are kept, in which a target can still be marked
    mark_frames: 50
    # 'raw' or 'compressed' images; a value set here overrides the argument of the launch file
    # image_transport: raw
    # size of a pixel in the markers [m]
    marker_metres_per_px: 0.01
"""

EVIDENCE_HEAD = """# Parameters of evidence_node; these are the defaults.
# `out`, `key` and `head` are arguments of the launch file.
/**/evidence_node:
  ros__parameters:
    # 'raw' or 'compressed' images
    image_transport: raw
"""


def parameters(indent: str, kind: type) -> str:
    """Return all parameters as YAML, with their texts above them and sections indented."""
    lines = []
    for f in dataclasses.fields(kind):
        m = f.metadata
        if 'section' in m:
            lines.append(f'{indent}# {m["doc"]}\n{indent}{f.name}:')
            lines.append(parameters(indent + '  ', m['section']).rstrip('\n'))
            continue
        unit = f' [{m["unit"]}]' if m['unit'] else ''
        legal = ', '.join(map(str, m['choices'])) or f'{m["low"]:g} to {m["high"]:g}'
        plain = isinstance(f.default, bool) or isinstance(f.default, str) and not m['choices']
        legal = '' if plain else f'; {legal}'
        lines += textwrap.wrap(f'{m["doc"]}{unit}{legal}', 97,
                               initial_indent=indent + '# ', subsequent_indent=indent + '# ',
                               break_long_words=False, break_on_hyphens=False)
        lines.append(f'{indent}{f.name}: {_yaml(f.default)}')
    return '\n'.join(lines) + '\n'


def components(indent: str) -> str:
    """Return the parameters of the site, and of each tracker and detector, as YAML."""
    out = parameters(indent, SiteConfig)
    for registry in (TRACKERS, DETECTORS):
        out += f'{indent}# parameters of one {registry.kind} alone\n{indent}{registry.kind}s:\n'
        for name in registry.own:
            settings = registry.load(name).Settings
            if dataclasses.fields(settings):
                out += f'{indent}  {name}:\n' + parameters(indent + '    ', settings)
    return out


def _yaml(value: object) -> str:
    """Return a value in YAML 1.1, in which exponents need a point and a sign."""
    if isinstance(value, (bool, str)):
        return str(value).lower() if isinstance(value, bool) else value
    text = repr(value)
    return f'{value:.8f}'.rstrip('0') if isinstance(value, float) and 'e' in text else text


def main() -> None:
    """Write the files."""
    config = ROOT / 'config'
    (config / 'environment.yaml').write_text(ENVIRONMENT_HEAD + parameters('', MonocularConfig))
    (config / 'environment.params.yaml').write_text(
        NODE_HEAD + parameters('    ', MonocularConfig))
    (config / 'evidence.params.yaml').write_text(
        EVIDENCE_HEAD + parameters('    ', EnforcementConfig))
    (config / 'tracker.yaml').write_text(
        HEAD + parameters('', TrackerConfig) + components('')
        + '# when a pass is a violation, and what is kept as evidence\nenforcement:\n'
        + parameters('  ', EnforcementConfig))
    path = config / 'stereo_speed.params.yaml'
    text = path.read_text()
    # In the tracker node's block, everything from the first parameter's comment on is rewritten.
    start = text.index('    # number of particles N')
    end = text.find('\n\n/**/', start)
    rest = text[end + 1:] if end >= 0 else ''
    text = text[:start] + parameters('    ', TrackerConfig) + components('    ') + rest
    path.write_text(text)
    # A single process has the parameters of all nodes: their blocks, one after the other.
    blocks = [block.partition('ros__parameters:\n')[2].rstrip('\n')
              for block in text.split('/**/')[1:]]
    (config / 'speed_camera.params.yaml').write_text('\n'.join([SPEED_CAMERA_HEAD, *blocks, '']))


if __name__ == '__main__':
    main()
