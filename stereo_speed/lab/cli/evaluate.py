# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``evaluate``: run trackers over sequences with truth, or over the papers'; tabulate, plot."""
from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Optional, Sequence

from . import evaluate_monocular
from ..evaluation.comparison import comparison_table
from ..evaluation.experiments import (
    Experiment, plan, Runs, sequence_experiment, Source, track_job)
from ..evaluation.labeled_sequence import LineKnowledge
from ..evaluation.paper_sequences import find_sequence, SEQUENCES
from ..evaluation.paper_tables import (
    checks, checks_text, contest_table, paper_table, PaperPlan)
from ..evaluation.tables import Table
from ...batch.job import failures
from ...batch.runner import run_jobs
from ...cli.options import add_job_options, number_in, report_failures
from ...core.errors import InputError
from ...core.tracker_config import TrackerConfig
from ...io.atomic import prepare_folder, write_whole
from ...pipeline.registry import TRACKERS

_FILES = ('site.yaml', 'init.yaml', 'truth.csv')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``evaluate``."""
    add = parser.add_argument
    add('bags', nargs='*', type=Path, metavar='BAG',
        help='folder with bag/, site.yaml, init.yaml and truth.csv, as written by simulate; or '
             'a bag with --site and --truth')
    add('--site', type=Path, help='site file of a bag')
    add('--init', type=Path, help='init file of a bag')
    add('--truth', type=Path, help='truth.csv of a bag')
    add('--left', metavar='TOPIC', help='topic of the left images')
    add('--right', metavar='TOPIC', help='topic of the right images')
    add('--sequences', type=partial(_names, known=tuple(SEQUENCES)), default=[], metavar='NAMES',
        help='simulated sequences, separated by commas, or all: ' + ', '.join(SEQUENCES))
    add('--trackers', type=partial(_names, known=TRACKERS.names), default=None, metavar='NAMES',
        help='trackers, separated by commas (default: all): ' + ', '.join(TRACKERS.names))
    add('--seeds', type=number_in(int, 1, 1000), default=None, metavar='K',
        help='runs of each (default: 10; 20 of each cell of the tables of the paper)')
    add('--particles', type=number_in(int, 20, 20000), nargs='+', metavar='N', default=None,
        help='numbers of particles (default: those of the paper)')
    add('--lines', choices=[k.value for k in LineKnowledge], default='refined',
        help='how the lines of simulated sites are known (default: refined)')
    add('--paper', action='store_true', help='rerun the tables of Zhu et al. (2012)')
    add('--quick', action='store_true', help='with --paper: only a small part')
    add_job_options(parser)
    evaluate_monocular.add_options(parser)


def _names(text: str, known: Sequence[str]) -> list[str]:
    names = list(known) if text == 'all' else [name.strip() for name in text.split(',')]
    for name in names:
        if name not in known:
            raise argparse.ArgumentTypeError(
                f'found {name!r}, wanted some of {", ".join(known)}')
    return list(dict.fromkeys(names))


def run(args: argparse.Namespace) -> int:
    """Run the requested evaluations; earlier runs with the same parameters are reused."""
    if args.video:
        return evaluate_monocular.run(args)
    if args.out is None:
        raise InputError('evaluate', '--out', 'nothing', 'a folder for the results')
    if not (args.paper or args.bags or args.sequences):
        raise InputError('evaluate', 'arguments', 'no sequence',
                         '--paper, --sequences NAMES or a BAG with truth')
    if args.paper and (args.bags or args.sequences or args.particles):
        raise InputError('evaluate', '--paper', 'other sequences or particles as well',
                         'either one')
    prepare_folder(args.out)
    return _paper(args) if args.paper else _compare(args)


def _paper(args: argparse.Namespace) -> int:
    """Reproduce the paper's tables."""
    wanted = PaperPlan(trackers=tuple(args.trackers or TRACKERS.names),
                       lines=LineKnowledge(args.lines))
    if args.quick:
        wanted = wanted.quick()
    if args.seeds:
        wanted = replace(wanted, table_seeds=range(args.seeds), compare_seeds=range(args.seeds))
    results = run_jobs(plan([*wanted.cells(), *wanted.contests()]), track_job, out_dir=args.out,
                       workers=args.jobs, description='evaluate --paper')
    runs = Runs(results)
    tables = {f'table_{t.name.split()[1].strip(")").replace("(", "")}': paper_table(
        wanted, t, runs) for t in wanted.tables}
    tables.update({s: contest_table(wanted, s, runs) for s in wanted.compared})
    found = checks(wanted, runs)
    text = f'**Checks**\n\n{checks_text(found)}'
    _write(args.out, tables, text)
    _paper_plots(args.out, wanted, runs)
    print(f'in {args.out}')
    return report_failures(failures(results))


def _paper_plots(out: Path, wanted: PaperPlan, runs: Runs) -> None:
    """Draw the speeds of each sequence, and the errors of tables with varied particles."""
    from ..evaluation.pictures import draw_errors, draw_speeds, paper_curves

    for name in wanted.compared:
        draw_speeds(out / f'speed_{name}.png', find_sequence(name).title,
                    [wanted.contest(name, t) for t in wanted.trackers],
                    wanted.compare_seeds[0], runs)
    curves = [c for t in wanted.tables if t.particles is None
              for c in paper_curves(wanted, t, runs)]
    draw_errors(out / 'error_particles.png', 'Error of the last reading', 'particles N', curves)


def _compare(args: argparse.Namespace) -> int:
    """Run trackers over bags and simulated sequences."""
    seeds = range(args.seeds or 10)
    trackers = args.trackers or list(TRACKERS.names)
    groups = [[sequence_experiment(name, t, lines=LineKnowledge(args.lines), particles=n)
               for t in trackers for n in args.particles or [None]] for name in args.sequences]
    groups += [[Experiment(source=source, tracker=t, changes=_particles(n)) for t in trackers
                for n in args.particles or [TrackerConfig().particles]]
               for source in _sources(args)]
    jobs = plan([(e, seed) for group in groups for e in group for seed in seeds])
    results = run_jobs(jobs, track_job, out_dir=args.out, workers=args.jobs,
                       description='evaluate')
    runs = Runs(results)
    _write(args.out, {_file_name(i, group): comparison_table(group, seeds, runs)
                      for i, group in enumerate(groups)})
    _plots(args.out, groups, seeds, runs)
    print(f'in {args.out}')
    return report_failures(failures(results))


def _particles(count: int) -> dict[str, int]:
    TrackerConfig(particles=count)  # checks the number before the work begins
    return {'particles': count}


def _file_name(number: int, group: Sequence[Experiment]) -> str:
    """Return a name for the files of a source; bags also have their number."""
    source = group[0].source
    return source.name if source.sequence else f'{number}_{source.name}'


def _sources(args: argparse.Namespace) -> list[Source]:
    """Return the bags with their files."""
    if len(args.bags) > 1 and (args.site or args.init or args.truth):
        raise InputError('evaluate', 'BAG', f'{len(args.bags)} bags with --site, --init or '
                         '--truth', 'one bag')
    sources = []
    for bag in args.bags:
        folder = bag / 'bag' if (bag / 'bag').exists() else bag / 'bag.bag'
        whole = folder.exists()
        found = [bag / name if whole else None for name in _FILES]
        site, init, truth = (given or there for given, there in zip(
            (args.site, args.init, args.truth), found))
        for option, path in (('--site', site), ('--truth', truth)):
            if path is None:
                raise InputError(bag, option, 'nothing', f'a file, or a folder with {_FILES[0]} '
                                 f'and {_FILES[2]} beside bag/')
        files = {'bag': folder if whole else bag, 'site': site, 'truth': truth, 'init': init,
                 'left': args.left, 'right': args.right}
        for name in ('bag', 'site', 'truth', 'init'):
            path = files[name]
            if path is not None and not path.exists():
                raise InputError(path, name, 'no such file', 'a file that is there')
        sources.append(Source(files={k: str(v) for k, v in files.items() if v is not None}))
    return sources


def _plots(out: Path, groups: Sequence[Sequence[Experiment]], seeds: range, runs: Runs) -> None:
    """Draw the speeds of each source, and errors over the number of particles if it varies."""
    from ..evaluation.pictures import draw_errors, draw_speeds, particle_curves

    for i, group in enumerate(groups):
        name = _file_name(i, group)
        most = max(e.changes['particles'] for e in group)
        draw_speeds(out / f'speed_{name}.png', name,
                    [e for e in group if e.changes['particles'] == most], seeds[0], runs)
        if len({e.changes['particles'] for e in group}) > 1:
            draw_errors(out / f'error_{name}.png', f'{name}: r.m.s. error of the readings',
                        'particles N', particle_curves(group, seeds, runs, lambda f: f.rms_mps))


def _write(out: Path, tables: dict[str, Table], more: Optional[str] = None) -> None:
    """Write and print the tables."""
    text = '\n'.join([table.markdown() for table in tables.values()] + [more or ''])
    write_whole(out, {'evaluation.md': text,
                      **{f'{name}.csv': table.csv() for name, table in tables.items()}})
    print(text)
