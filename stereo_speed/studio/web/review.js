// Copyright 2026 The stereo_speed developers
// SPDX-License-Identifier: Apache-2.0
// The review page: a table of passes or records of violations, and their statistics.

import {histogram, percentile} from './charts.js';
import {Closely} from './closely.js';
import {choice, digits, el, field, renew, toast} from './dom.js';
import {shortly, Verification} from './evidence.js';

const UNITS = {mph: 0.44704, 'km/h': 1 / 3.6, 'm/s': 1};
const MOST_ROWS = 2000; // rows drawn at once; the statistics use all

// Columns of a table: key, name, whether it is a number, and the content of a cell.
const speed = (key) => (row, page) => digits(row[key] === null ? null : row[key] / page.metres);
const time = (row, page) => page.clock(row.first_ns);
const legal = (key) => (row) => (row[key] === null ? '–' : `${shortly(row[key])} ${row.unit}`);
const lane = (row) => (row.lane_to && row.lane_to !== row.lane ? `${row.lane} → ${row.lane_to}` : row.lane);
const verdict = (row) => [el('span', {class: `pill ${row.verdict === 'measured' ? 'good' : 'bad'}`}, row.verdict),
  row.reason && el('span', {class: 'fine'}, ` ${row.reason}`)];
const PASSES = [['track', '#', true, (row) => row.track], ['first_ns', 'time (UTC)', true, time], ['lane', 'lane', false, lane],
  ['speed_mps', 'speed', true, speed('speed_mps'), true], ['speed_std_mps', '1-σ', true, speed('speed_std_mps'), true],
  ['pairs', 'pairs', true, (row) => row.pairs], ['verdict', 'verdict', false, verdict]];
const BAG = ['bag', 'bag', false, (row) => row.bag];
const RECORDS = [['number', '#', true, (row) => row.number], ['first_ns', 'time (UTC)', true, time],
  ['lane', 'lane', false, (row) => row.lane], ['speed_mps', 'speed', true, speed('speed_mps'), true],
  ['considered_mps', 'considered', true, legal('considered')], ['limit_mps', 'limit', true, legal('limit')],
  ['sound', 'record', false, (row, page) => page.verification.pill(row.key)]];

export class Review {
  constructor(link) {
    this.link = link;
    this.runs = [];
    this.at = null; // number of the run that is open
    this.sort = {key: 'first_ns', up: true};
    this.filter = {lane: '', verdict: '', low: '', high: ''};
    this.unit = localStorage.getItem('studio-unit') in UNITS ? localStorage.getItem('studio-unit') : 'mph';
    this.bar = el('div', {class: 'row wrap'});
    this.body = el('tbody');
    this.head = el('tr');
    this.count = el('span', {class: 'fine num grow', id: 'shown'});
    this.again = el('button', {id: 'again', title: 'Reload to see new passes',
      onclick: () => this.open(this.at)}, 'Refresh');
    this.foot = el('div', {class: 'row'}, this.count, this.again, el('button', {id: 'export',
      title: 'The rows shown, in m/s, as CSV', onclick: () => this.export()}, 'Export CSV'));
    this.table = el('table', {id: 'passes', 'aria-label': 'Passes'}, el('thead', {}, this.head), this.body);
    this.stats = el('div', {class: 'panel', id: 'stats'});
    this.detail = el('div', {class: 'panel', id: 'detail'});
    this.verification = new Verification(link, () => { this.showTable(); this.closely.show(); });
    this.closely = new Closely(link, this, this.detail);
    this.root = el('div', {class: 'review'},
      el('div', {}, el('div', {class: 'panel', style: {flex: '1', 'min-height': '0'}}, this.bar, this.verification.root,
        el('div', {class: 'scroll'}, this.table), this.foot), this.stats),
      el('div', {}, this.detail));
    this.body.addEventListener('keydown', (event) => this.rowKey(event));
    this.body.addEventListener('click', (event) => {
      const row = event.target.closest('tr');
      if (row) this.choose(Number(row.dataset.pass));
    });
  }

  get metres() { return UNITS[this.unit]; }

  get isEvidence() { return this.run?.kind === 'evidence'; }

  get columns() {
    if (this.isEvidence) return RECORDS;
    return this.run.rows.length && 'bag' in this.run.rows[0] ? [BAG, ...PASSES] : PASSES;
  }

  setRuns(runs) {
    this.runs = runs;
    const there = runs.some((r) => r.number === this.at);
    if (!there && runs.length) this.open(runs[0].number);
    else this.showBar();
    if (!runs.length) {
      this.detail.replaceChildren(el('p', {class: 'fine'}, 'No run yet: “Measure” measures the open bag, and '
        + '--run PATH opens what replay or log_node has written, or evidence.'));
    }
  }

  async open(number) {
    this.at = number;
    let run;
    try {
      run = await this.link.get(`/api/runs/${number}`);
    } catch (error) { toast(error.message, true); return; }
    if (this.at !== number) return;
    this.run = run;
    this.days = new Set(run.rows.map((r) => Math.floor((r.first_ns || 0) / 864e11))).size > 1;
    this.picked = null;
    this.filter = {lane: '', verdict: '', low: '', high: ''};
    this.verification.open(this.isEvidence ? number : null);
    this.show();
    const first = this.rows()[0];
    if (first) this.choose(first.key);
    else this.detail.replaceChildren(el('p', {class: 'fine'}, this.isEvidence ? 'No record yet.' : 'No vehicle passed.'));
  }

  // A stamp as time of day in UTC, with the date if the run spans several days.
  clock(ns) {
    if (ns === null || ns === undefined) return '–';
    const text = new Date(ns / 1e6).toISOString();
    return (this.days ? `${text.slice(0, 10)} ` : '') + text.slice(11, 21);
  }

  rows() {
    const {lane: of, verdict: word, low, high} = this.filter, {metres} = this;
    const kept = this.run.rows.filter((r) => (!of || r.lane === of) && (!word || r.verdict === word || r.reason === word)
      && (low === '' || (r.speed_mps !== null && r.speed_mps >= Number(low) * metres))
      && (high === '' || (r.speed_mps !== null && r.speed_mps <= Number(high) * metres)));
    const {key, up} = this.sort, way = up ? 1 : -1;
    const value = key === 'sound' ? (r) => this.verification.rank(r.key) : key === 'considered_mps'
      ? (r) => r.considered : (r) => r[key] ?? null;
    return kept.sort((a, b) => {
      const [x, y] = [value(a), value(b)];
      if (x === y) return a.key - b.key;
      if (x === null || y === null) return x === null ? 1 : -1;
      return (x < y ? -1 : 1) * way;
    });
  }

  show() {
    this.showBar();
    this.showTable();
  }

  showBar() {
    if (!this.run) return;
    const values = (key) => [...new Set(this.run.rows.map((r) => r[key]).filter(Boolean))].sort();
    const set = (key) => (value) => { this.filter[key] = value; this.showTable(); };
    renew(this.bar,
      choice({id: 'run', class: 'run', 'data-key': 'run', 'aria-label': 'Run'}, this.runs.map((r) => [String(r.number), r.name]),
        this.at, (value) => this.open(Number(value))),
      choice({'data-key': 'lane', id: 'filter-lane', 'aria-label': 'Lane'}, [['', 'all lanes'], ...values('lane').map((v) => [v, v])],
        this.filter.lane, set('lane')),
      !this.isEvidence && choice({'data-key': 'verdict', id: 'filter-verdict', 'aria-label': 'Verdict'}, [['', 'all verdicts'],
        ...values('verdict').map((v) => [v, v]), ...values('reason').map((v) => [v, v])], this.filter.verdict, set('verdict')),
      field({'data-key': 'low', 'aria-label': 'Least speed', placeholder: 'from', class: 'short'}, this.filter.low, set('low')),
      field({'data-key': 'high', 'aria-label': 'Greatest speed', placeholder: 'to', class: 'short'}, this.filter.high, set('high')),
      choice({'data-key': 'unit', id: 'unit', 'aria-label': 'Unit'}, Object.keys(UNITS).map((u) => [u, u]), this.unit, (unit) => {
        this.unit = unit;
        localStorage.setItem('studio-unit', unit);
        this.show();
        this.closely.show();
      }));
    this.again.hidden = !['log', 'evidence'].includes(this.run.kind);
  }

  showTable() {
    if (!this.run) return;
    const rows = this.rows(), {columns} = this;
    renew(this.head, columns.map(([key, name, number, , unit]) => {
      const way = this.sort.key === key ? (this.sort.up ? 'up' : 'down') : '';
      return el('th', {class: number ? 'num' : '', 'aria-sort': {up: 'ascending', down: 'descending', '': 'none'}[way]},
        el('button', {'data-way': way, 'data-key': key, onclick: () => {
          this.sort = {key, up: this.sort.key === key ? !this.sort.up : true};
          this.showTable();
        }}, unit ? `${name} ${this.unit}` : name));
    }));
    const drawn = document.createDocumentFragment();
    for (const row of rows.slice(0, MOST_ROWS)) {
      drawn.append(el('tr', {tabindex: '0', 'data-pass': row.key, 'aria-selected': row.key === this.picked ? 'true' : 'false'},
        columns.map(([, , number, cell]) => el('td', {class: number ? 'num' : ''}, cell(row, this)))));
    }
    const focused = this.body.contains(document.activeElement) ? document.activeElement.dataset.pass : null;
    this.body.replaceChildren(drawn);
    if (focused !== null) this.body.querySelector(`[data-pass="${focused}"]`)?.focus({preventScroll: true});
    this.count.textContent = `${rows.length} of ${this.run.rows.length} ${this.isEvidence ? 'records' : 'passes'}`
      + (rows.length > MOST_ROWS ? `; the first ${MOST_ROWS} shown` : '')
      + (this.run.passes > this.run.rows.length ? `; there are ${this.run.passes}, these are the newest` : '');
    this.showStats(rows);
  }

  showStats(rows) {
    const speeds = rows.filter((r) => (this.isEvidence || r.verdict === 'measured') && r.speed_mps !== null)
      .map((r) => r.speed_mps / this.metres);
    const v85 = percentile(speeds, 0.85);
    const mean = speeds.length ? speeds.reduce((a, b) => a + b, 0) / speeds.length : null;
    const fact = (name, value, id) => el('div', {}, el('div', {class: 'fine'}, name), el('div', {class: 'num', id}, value));
    this.stats.replaceChildren(el('div', {class: 'row', style: {gap: '22px'}}, fact('measured', speeds.length, 'count'),
      fact(`mean ${this.unit}`, digits(mean), 'mean'), fact(`85th percentile ${this.unit}`, digits(v85), 'v85'),
      fact(`fastest ${this.unit}`, speeds.length ? digits(speeds.reduce((a, b) => Math.max(a, b))) : '–')),
    histogram(speeds, this.unit, v85) || el('p', {class: 'fine'}, 'No measured pass among these.'));
  }

  rowKey(event) {
    const row = event.target.closest('tr');
    const other = {ArrowDown: row?.nextElementSibling, ArrowUp: row?.previousElementSibling}[event.key];
    if (event.key === 'Enter' || event.key === ' ') this.choose(Number(row.dataset.pass));
    else if (other) { other.focus(); this.choose(Number(other.dataset.pass)); } else return;
    event.preventDefault();
  }

  choose(key) {
    this.picked = key;
    for (const row of this.body.children) row.setAttribute('aria-selected', Number(row.dataset.pass) === key ? 'true' : 'false');
    this.closely.open(this.run.rows.find((r) => r.key === key));
  }

  async export() {
    try {
      const text = await this.link.postForText(`/api/runs/${this.at}/table`, {keys: this.rows().map((r) => r.key)});
      const url = URL.createObjectURL(new Blob([text], {type: 'text/csv'}));
      el('a', {href: url, download: 'passes.csv'}).click();
      setTimeout(() => URL.revokeObjectURL(url), 10000);
    } catch (error) { toast(error.message, true); }
  }
}
