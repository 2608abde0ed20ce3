// Step 5: ten seconds of turning and driving robots, and what was missed, where.

import { h, keyed, mark, number, say } from './dom.js';
import { FieldView } from './field-view.js';
import { Places, swaps } from './places.js';
import { shortName } from './overlay.js';
import { Quality } from './quality.js';
import { proofBox } from './setup-parts.js';
import { store } from './store.js';

const CHECK_S = 10;
const GOOD_SHARE = 0.99;
const LONG_BLACKOUT_MS = 100;
const GOOD_JITTER_MM = 1;

export class CheckStep {
  name = 'check';
  title = 'Check';

  constructor() {
    /** @type {Quality|null} */
    this.quality = null;
    this.places = new Places(11, 9);
    this.wrong = 0;
    this.started_ms = 0;
    this.running = false;
    /** @type {import('./types').World|null} */
    this.before = null;
    this.proofs = proofBox();
    this.button = h('button', { class: 'main', onclick: () => this.start() }, `Check for ${CHECK_S} seconds`);
    this.field = new FieldView();
    this.field.className = 'check-field';
    this.field.below = (context, at, per_mm) => this.drawPlaces(context, at, per_mm);
    this.rows = h('tbody', null);
    this.table = h('table', { hidden: true }, h('thead', null, h('tr', null, h('th', null, 'Robot'), h('th', { class: 'n' }, 'found'), h('th', { class: 'n' }, 'longest gap'), h('th', { class: 'n' }, 'jitter standing'))), this.rows);
    this.wrong_text = h('p', { class: 'soft' });
    this.side = h('div', null,
      h('h1', null, 'Check'), this.proofs.element,
      h('p', { class: 'soft' }, 'Let all robots turn and drive, also along the walls and into the corners. Two should stand.'),
      h('div', { class: 'row' }, this.button), this.field, this.wrong_text, this.table,
    );
    store.on('scene', () => this.sample());
  }

  switches() {
    return { robots: true, names: true, headings: true, rejected: true, ball: true, trails: true };
  }

  /** @private */
  start() {
    this.quality = new Quality(CHECK_S + 1);
    this.places.clear();
    this.wrong = 0;
    this.before = null;
    this.started_ms = performance.now();
    this.running = true;
    this.button.disabled = true;
    this.update();
  }

  /** @private */
  sample() {
    if (!this.running || !this.quality) return;
    if (performance.now() - this.started_ms > CHECK_S * 1000) {
      this.running = false;
      this.button.disabled = false;
      say(this.button, 'Check again');
      return this.update();
    }
    const { world, detections, model } = store;
    this.quality.add(world === this.before ? null : world, detections, model?.robots ?? [], store.frame_ms);
    if (world && world !== this.before && model) {
      this.places.add(world, model.field, store.frame_ms);
      this.wrong += this.before ? swaps(this.before, world) : 0;
      this.before = world;
    }
  }

  /** @private @param {CanvasRenderingContext2D} context @param {(mm: [number, number]) => [number, number]} at @param {number} per_mm */
  drawPlaces(context, at, per_mm) {
    const field = store.model?.field;
    if (!field) return;
    const style = getComputedStyle(this.field);
    for (const { center_mm, size_mm, share } of this.places.cells(field)) {
      const [x, y] = at(center_mm);
      const [width, height] = [size_mm[0] * per_mm, size_mm[1] * per_mm];
      context.globalAlpha = 0.55;
      context.fillStyle = style.getPropertyValue(share >= GOOD_SHARE ? '--good' : '--warn');
      context.fillRect(x - width / 2 + 1, y - height / 2 + 1, width - 2, height - 2);
      context.globalAlpha = 1;
      if (share >= GOOD_SHARE) continue;
      context.fillStyle = style.getPropertyValue('--text');
      context.font = '600 11px system-ui, sans-serif';
      context.textAlign = 'center';
      context.fillText(`${Math.round(100 * share)}`, x, y + 4);
    }
  }

  update() {
    // Robots would hide the result.
    this.field.scene = this.quality && !this.running ? null : { seq: store.world?.seq ?? 0, world: store.world ?? undefined };
    this.field.redraw();
    this.proofs.show(this.proof());
    if (this.running) say(this.button, `${number(Math.max(0, CHECK_S - (performance.now() - this.started_ms) / 1000), 0)} s to go`);
    const rows = this.quality?.rows() ?? [];
    this.table.hidden = !rows.length;
    say(this.wrong_text, this.quality ? `Names exchanged between robots: ${this.wrong}. Squares: share of frames in which a robot there was found; numbers where it is below ${100 * GOOD_SHARE} %.` : '');
    keyed(this.rows, rows, (row) => row.name, (row) => h('tr', null,
      h('td', null, h('span', { class: row.robot.team === 'blue' ? 'robot is-blue' : 'robot' }, shortName(row.robot))), h('td', { class: 'n' }), h('td', { class: 'n' }), h('td', { class: 'n' })),
    (element, row) => {
      const cells = element.children;
      say(cells[1], row.seen ? `${number(100 * (row.found ?? 0), 1)} %` : 'never seen');
      mark(cells[1], 'warn', (row.found ?? 0) < GOOD_SHARE);
      say(cells[2], row.seen ? `${number(row.blackout_ms)} ms` : '–');
      mark(cells[2], 'warn', (row.blackout_ms ?? 0) > LONG_BLACKOUT_MS);
      say(cells[3], row.jitter_mm === null ? 'did not stand' : `${number(row.jitter_mm, 2)} mm, ${number(row.jitter_deg, 2)}°`);
      mark(cells[3], 'warn', (row.jitter_mm ?? 0) > GOOD_JITTER_MM);
    });
  }

  /** @returns {import('./setup-view.js').Proof} */
  proof() {
    if (!this.quality) return { level: 'open', what: 'not checked', todo: 'Start the check when all robots are on the pitch.' };
    if (this.running) return { level: 'open', what: 'being checked', todo: 'Keep the robots moving.' };
    const rows = this.quality.rows();
    const bad = rows.filter((row) => !row.seen || (row.found ?? 0) < GOOD_SHARE || (row.blackout_ms ?? 0) > LONG_BLACKOUT_MS);
    if (!bad.length && !this.wrong) return { level: 'good', what: `all ${rows.length} robots, ${CHECK_S} seconds`, todo: 'Save, and play.' };
    const names = bad.map((row) => shortName(row.robot)).join(', ');
    return {
      level: 'bad', what: this.wrong ? `names exchanged ${this.wrong} times` : `gaps: ${names}`,
      todo: this.wrong ? 'Two robots look alike somewhere: correct the colours of their patches.' : 'Look where the gaps are. A dark corner: learn the colours with robots there. One robot everywhere: renew its patches.',
    };
  }
}
