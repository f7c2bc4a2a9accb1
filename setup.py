# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Build of the ament_python package."""
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

package_name = 'stereo_speed'
share = f'share/{package_name}'
# What it needs from PyPI; on a native ROS system package.xml names the system's packages instead.
needed = Path('requirements.in').read_text(encoding='utf-8').partition('# the extra')[0]
pypi = [line.partition('#')[0].strip() for line in needed.splitlines()
        if line.partition('#')[0].strip()]

setup(
    name=package_name,
    version='1.0.0',
    packages=find_packages(include=[package_name, f'{package_name}.*']),
    package_data={package_name: ['py.typed', 'io/*.schema.json', 'enforcement/*.schema.json',
                                 'report/templates/*.html', 'studio/web/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{package_name}']),
        (share, ['package.xml', 'LICENSE']),
        (f'{share}/launch', sorted(glob('launch/*'))),
        (f'{share}/config', sorted(glob('config/*'))),
        (f'{share}/sample/straight55', sorted(glob('sample/straight55/*.*'))),
        (f'{share}/sample/straight55/bag', sorted(glob('sample/straight55/bag/*'))),
    ],
    python_requires='>=3.10',
    install_requires=['setuptools'],
    extras_require={'pypi': pypi, 'test': ['pytest'], 'cluster': ['dask', 'distributed']},
    zip_safe=True,
    author='The stereo_speed developers',
    author_email='stereo-speed@example.org',
    maintainer='The stereo_speed developers',
    maintainer_email='stereo-speed@example.org',
    description='Measures the ground speed of vehicles from a roadside stereo camera.',
    long_description=Path('README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'stereo_sync_node = stereo_speed.nodes.stereo_sync_node:main',
            'tracker_node = stereo_speed.nodes.tracker_node:main',
            'speed_node = stereo_speed.nodes.speed_node:main',
            'speed_camera_node = stereo_speed.nodes.speed_camera_node:main',
            'replay_node = stereo_speed.nodes.replay_node:main',
            'log_node = stereo_speed.nodes.log_node:main',
            'studio_node = stereo_speed.nodes.studio_node:main',
            'environment_node = stereo_speed.nodes.environment_node:main',
            'evidence_node = stereo_speed.nodes.evidence_node:main',
            'replay = stereo_speed.cli.main:run_executable',
            'evidence = stereo_speed.cli.main:run_executable',
            'replay-many = stereo_speed.cli.main:run_executable',
            'site = stereo_speed.cli.main:run_executable',
            'studio = stereo_speed.cli.main:run_executable',
            'simulate = stereo_speed.cli.main:run_executable',
            'disturb = stereo_speed.cli.main:run_executable',
            'accuracy = stereo_speed.cli.main:run_executable',
            'second = stereo_speed.cli.main:run_executable',
            'violations = stereo_speed.cli.main:run_executable',
            'evaluate = stereo_speed.cli.main:run_executable',
            'traffic = stereo_speed.cli.main:run_executable',
            'roads = stereo_speed.cli.main:run_executable',
            'track-environment = stereo_speed.cli.main:run_executable',
            'map = stereo_speed.cli.main:run_executable',
            'tamper = stereo_speed.cli.main:run_executable',
            'faults = stereo_speed.cli.main:run_executable',
            'endurance = stereo_speed.cli.main:run_executable',
            'fuzz = stereo_speed.cli.main:run_executable',
            'bench = stereo_speed.cli.main:run_executable',
            'self-test = stereo_speed.cli.main:run_executable',
            'stats = stereo_speed.cli.main:run_executable',
            'verify-against = stereo_speed.cli.main:run_executable',
            'demo = stereo_speed.cli.main:run_executable',
        ],
        # as pipeline/registry.py has them, so that other programs can list them too
        'stereo_speed.trackers': [
            'constrained = stereo_speed.tracking.constrained:ConstrainedTracker',
            'unconstrained = stereo_speed.lab.baselines.unconstrained:UnconstrainedTracker',
            'triangulation = stereo_speed.lab.baselines.triangulation:TriangulationTracker',
            'kalman = stereo_speed.lab.baselines.kalman:KalmanTracker',
            'multimodal = stereo_speed.lab.baselines.multimodal:MultimodalTracker',
            'flow = stereo_speed.lab.baselines.optical_flow:FlowTracker',
        ],
        'stereo_speed.detectors': [
            'plane_sweep = stereo_speed.detection.detector:PlaneSweepDetector',
            'boxes = stereo_speed.detection.box_detector:BoxDetector',
        ],
    },
)
