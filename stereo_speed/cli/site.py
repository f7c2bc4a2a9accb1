# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``site``: find the lines of a site in the images of a bag to a few hundredths of a pixel.

It also checks whether the rig still agrees with its calibration.
"""
from __future__ import annotations

import argparse
from pathlib import Path
from typing import Optional

import cv2

from ..core.errors import InputError
from ..io.atomic import write_whole
from ..io.bags import StereoBag
from ..pipeline.assembly import refined_site
from ..pipeline.config import load_pipeline_config, SiteConfig
from ..site.file import load_site, Site
from ..site.refine.picture import picture
from ..site.refine.refiner import RefinedSite
from ..site.refine.report import report, summary_lines
from ..site.write import site_text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``site``."""
    actions = parser.add_subparsers(metavar='ACTION', required=True)
    for name, text, run in (('refine', 'write a refined site file', _refine),
                            ('check', 'print the same report, and write no site file', _check)):
        action = actions.add_parser(name, help=text, description=text)
        action.add_argument('bag', metavar='BAG', type=Path,
                            help='rosbag2 folder, .mcap or .db3 file, or ROS 1 .bag')
        action.add_argument('--site', required=True, type=Path, help='site file (YAML)')
        if name == 'refine':
            action.add_argument('--out', required=True, type=Path, metavar='SITE',
                                help='site file to write')
        action.add_argument('--pictures', type=Path, metavar='DIR',
                            help='folder for a picture of each view'
                            + (' (default: the folder of SITE)' if name == 'refine' else ''))
        action.add_argument('--config', type=Path, metavar='YAML', help='parameters')
        action.add_argument('--left', metavar='TOPIC', help='topic of the left images')
        action.add_argument('--right', metavar='TOPIC', help='topic of the right images')
        action.set_defaults(run=run)


def _refine(args: argparse.Namespace) -> int:
    """Refine, report, and write the site file and the pictures."""
    if args.out.is_dir():
        raise InputError(args.out, 'file', 'a folder', 'the name of a site file')
    args.pictures = args.pictures or args.out.parent
    refined = _refined(args, args.out.stem)
    write_site(args.out, refined.site)
    print(f'refined site in {args.out}')
    return 0


def _check(args: argparse.Namespace) -> int:
    """Refine and report, without writing a site file."""
    _refined(args, args.site.stem)
    return 0


def _refined(args: argparse.Namespace, name: str) -> RefinedSite:
    """Refine the site, print the report and write the pictures, named after a site file."""
    config = load_pipeline_config(args.config).site
    refined = refined_from_bag(load_site(args.site), args.bag, args.left, args.right, config)
    for line in summary_lines(refined, report(refined)):
        print(line)
    if args.pictures is not None:
        shown = write_pictures(args.pictures, name, refined)
        print(f'pictures in {" and ".join(map(str, shown))}')
    return refined


def refined_from_bag(site: Site, bag_path: Path, left: Optional[str] = None,
                     right: Optional[str] = None, config: SiteConfig = SiteConfig()
                     ) -> RefinedSite:
    """
    Refine a site with the images of a whole bag.

    :param site: clicked, or refined before.
    :param bag_path: the bag.
    :param left: topic of the left images; None finds it.
    :param right: topic of the right images; None finds it.
    :param config: parameters of roads and of their refinement.
    """
    with StereoBag(bag_path, left=left, right=right) as bag:
        return refined_site(site, bag.rig, bag.pairs(), config)[0]


def write_site(path: Path, site: Site) -> None:
    """
    Write a site file, completely or not at all.

    :param path: path of the file.
    :param site: the site to write.
    """
    write_whole(path.parent, {path.name: site_text(site)})


def write_pictures(folder: Path, name: str, refined: RefinedSite) -> list[Path]:
    """
    Write a picture of each view.

    :param folder: folder, made where it is missing.
    :param name: name of the site file, so that sites in one folder keep their own pictures.
    :param refined: the refined site.
    :return: paths of the pictures.
    """
    drawn = {f'{name}_{side}.png': cv2.imencode('.png', picture(refined, right))[1].tobytes()
             for side, right in (('left', False), ('right', True))}
    write_whole(folder, drawn)
    return [folder / file for file in drawn]
