// Comparing the recorded results with those of another configuration on the same frames: choice, progress, and
// what was found with each, robot by robot.

import { get } from './api.js';
import { changes } from './changes.js';
import { h, keyed, mark, number, replace, say } from './dom.js';
import { shortName } from './overlay.js';
import { store } from './store.js';
import { attempt, toast } from './toast.js';

/** @typedef {import('./archive.js').With} With */
/** @typedef {import('./types').ComparisonReport} Report */
/** @typedef {import('./types').ComparedRow} Row */

const SPANS_S = [2, 10, 30];

export class ComparePanel {
  /**
   * @param {import('./archive.js').Archive} archive
   * @param {import('./types').Opened} about
   * @param {{time: () => number, begun: () => void, go: (at: import('./archive.js').At) => void, index: () => number}} player
   */
  constructor(archive, about, player) {
    this.archive = archive;
    this.about = about;
    this.player = player;
    this.choice = h('select', { id: 'compare-with', 'aria-label': 'Compare with' });
    this.span = h('select', { 'aria-label': 'How much' }, SPANS_S.map((span) => h('option', { value: String(span), selected: span === 10 }, `${span} s around here`)));
    this.file = h('input', { type: 'file', accept: '.toml', hidden: true, 'aria-label': 'A configuration file', onchange: () => this.start() });
    this.button = h('button', { class: 'main', onclick: () => this.press() }, 'Compare');
    this.state = h('p', { class: 'soft', role: 'status' });
    this.jumps = h('div', { class: 'row', hidden: true },
      h('button', { class: 'small', onclick: () => player.go({ difference_before: player.index() }) }, '◀ Difference'),
      h('button', { class: 'small', onclick: () => player.go({ difference_after: player.index() }) }, 'Difference ▶'));
    this.rows = h('tbody', null);
    this.other_head = h('th', { class: 'n' }, 'other');
    this.table = h('table', { hidden: true },
      h('thead', null, h('tr', null, h('th', null, 'Robot'), h('th', { class: 'n' }, 'recorded'), this.other_head, h('th', null, 'difference'))), this.rows);
    this.element = h('div', { class: 'panel stack compare' },
      h('h2', null, 'Compare with another configuration'),
      h('div', { class: 'row' }, this.choice, this.span, this.button, this.file), this.state, this.jumps, this.table);
    this.running = false;
    this.fill();
  }

  /** @private */
  async fill() {
    const own = this.about.configurations.map(({ revision }) => h('option', { value: `revision:${revision}` }, `Revision ${revision} of the recording`));
    replace(this.choice,
      h('option', { value: 'group' }, 'The group’s configuration now'),
      h('option', { value: 'proposal', hidden: !changes.draft.size }, 'The proposal in Set-up'),
      h('option', { value: 'file' }, 'A file …'),
      own.length > 1 ? own : null);
    if (changes.draft.size) this.choice.value = 'proposal';
    /** @type {{name: string}[]|null} */
    const presets = await attempt(get('/api/presets'));
    for (const { name } of presets ?? []) this.choice.append(h('option', { value: `preset:${name}` }, `Preset ${name}`));
  }

  /** @private */
  press() {
    if (this.running) attempt(this.archive.stop());
    else if (this.choice.value === 'file') this.file.click();
    else this.start();
  }

  /** The chosen configuration. @private @returns {Promise<With|null>} */
  async chosen() {
    const [kind, name] = this.choice.value.split(':');
    if (kind === 'preset') return { preset: name };
    if (kind === 'revision') return { revision: Number(name) };
    if (kind === 'group') return { group: { set: {} } };
    if (kind === 'proposal') return { group: { set: Object.fromEntries(changes.draft) } };
    const [file] = this.file.files ?? [];
    if (!file) return null;
    const text = await file.text();
    this.file.value = '';
    return { text: { name: file.name, text } };
  }

  /** @private */
  async start() {
    if (!store.mayChange) return toast('Only who may change something can compare: it takes processor time.');
    const other = await this.chosen();
    if (!other) return;
    const span = Number(this.span.value);
    const middle = this.player.time();
    const from = Math.max(0, Math.min(middle - span / 2, this.about.seconds - span));
    if (await attempt(this.archive.compare(other, from, from + span))) this.player.begun();
  }

  /** @param {Report|null} report */
  update(report) {
    this.running = Boolean(report && !report.is_done);
    say(this.button, this.running ? 'Stop' : 'Compare');
    mark(this.button, 'main', !this.running);
    const proposal = /** @type {HTMLElement|null} */ (this.choice.querySelector('option[value=proposal]'));
    if (proposal) proposal.hidden = !changes.draft.size;
    this.table.hidden = !report;
    this.jumps.hidden = !report?.different;
    if (!report) return say(this.state, 'The other one is tried on the recorded pictures; nothing is changed.');
    say(this.state, words(report));
    const rows = [...report.rows].sort((a, b) => differing(b) - differing(a) || nameOf(a).localeCompare(nameOf(b)));
    keyed(this.rows, rows, nameOf, (row) => h('tr', null,
      h('td', null, row.team ? h('span', { class: row.team === 'blue' ? 'robot is-blue' : 'robot' }, nameOf(row)) : 'Ball'),
      h('td', { class: 'n' }), h('td', { class: 'n' }), h('td', { class: 'soft' })), (element, row) => {
      const cells = element.children;
      const percent = (/** @type {number} */ count) => (report.frames ? `${number((100 * count) / report.frames, 1)} %` : '–');
      say(cells[1], percent(row.recorded));
      say(cells[2], percent(row.other));
      mark(cells[2], 'good', row.other > row.recorded);
      mark(cells[2], 'bad', row.other < row.recorded);
      say(cells[3], difference(row));
    });
  }
}

/** @param {Row} row */
function nameOf(row) {
  return row.team ? shortName({ team: row.team, identity: row.identity }) : 'Ball';
}

/** Frames in which the sides differ. @param {Row} row */
function differing(row) {
  return row.recorded + row.other - 2 * row.both + row.elsewhere;
}

/** @param {Row} row */
function difference(row) {
  const parts = [];
  const [lost, won] = [row.recorded - row.both, row.other - row.both];
  if (lost) parts.push(`▼ ${lost} not found: ${row.why_other ?? ''}`);
  if (won) parts.push(`▲ ${won} more; recorded: ${row.why_recorded ?? ''}`);
  if (row.elsewhere) parts.push(`≠ ${row.elsewhere} found elsewhere`);
  if (row.both && (row.apart_mm ?? 0) >= 0.05) parts.push(`${number(row.apart_mm, 1)} mm apart`);
  return parts.join('; ') || (row.both ? 'the same' : 'found by neither');
}

/** @param {Report} report */
function words(report) {
  const parts = [`${report.name}: ${report.frames} frames`];
  if (!report.is_done) parts[0] += `, ${Math.floor(100 * report.done)} %`;
  if (report.frames) parts.push(report.different ? `${report.different} of them differ` : 'the same robots and ball in all of them');
  if (report.without_results) parts.push(`${report.without_results} without recorded results left out`);
  if (report.failed) parts.push(`${report.failed} not computed${report.fault ? ` (${report.fault})` : ''}`);
  return `${parts.join('; ')}.`;
}
