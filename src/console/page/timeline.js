// The time line of a recording: what was found when, gaps, events, changed configurations, differences of a
// comparison; and where in it the user is.

import { clock, duration, h, onceAFrame } from './dom.js';

/** @typedef {import('./types').Survey} Survey */
/** @typedef {import('./types').Opened} Opened */
/** @typedef {{time_s: number, sign: string, color: string, text: string}} Flag */

const FLAGS_PX = 22;
const AXIS_PX = 18;
const DIFFERENCES_PX = 10;
const SIDE_PX = 10;
/** A flag is hit within this distance. */
const NEAR_PX = 7;
/** Smallest width of a gap: one missing frame is to be seen in an hour. */
const LEAST_GAP_PX = 3;
const TICKS_S = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600];

export class Timeline extends HTMLElement {
  constructor() {
    super();
    this.canvas = document.createElement('canvas');
    this.tip = h('div', { class: 'tip', hidden: true });
    /** @type {Opened|null} */
    this.about = null;
    /** @type {Survey|null} */
    this.survey = null;
    this.robots = 0;
    this.time_s = 0;
    this.redraw = onceAFrame(() => this.draw());
  }

  connectedCallback() {
    if (!this.canvas.isConnected) this.append(this.canvas, this.tip);
    this.setAttribute('role', 'slider');
    this.setAttribute('aria-label', 'Time in the recording');
    this.tabIndex = 0;
    this.resizes = new ResizeObserver(() => this.draw());
    this.resizes.observe(this);
    if (this.listens) return;
    this.listens = true;
    let held = false;
    const seek = (/** @type {PointerEvent} */ event) => {
      const flag = this.flagAt(event);
      this.dispatchEvent(new CustomEvent('seek', { detail: { time_s: flag ? flag.time_s : this.timeAt(event) } }));
    };
    this.addEventListener('pointerdown', (event) => {
      held = true;
      this.setPointerCapture(event.pointerId);
      seek(event);
    });
    this.addEventListener('pointermove', (event) => {
      if (held) seek(event);
      this.showTip(event);
    });
    const end = () => { held = false; };
    this.addEventListener('pointerup', end);
    this.addEventListener('pointercancel', end);
    this.addEventListener('pointerleave', () => { this.tip.hidden = true; });
  }

  listens = false;

  disconnectedCallback() {
    this.resizes?.disconnect();
  }

  /** @param {number} time_s */
  setTime(time_s) {
    this.time_s = time_s;
    this.setAttribute('aria-valuenow', time_s.toFixed(2));
    this.setAttribute('aria-valuemax', (this.about?.seconds ?? 0).toFixed(2));
    this.setAttribute('aria-valuetext', `${time_s.toFixed(2)} seconds`);
    this.redraw();
  }

  /** @private */
  seconds() {
    return Math.max(1e-3, this.about?.seconds ?? 0);
  }

  /** @private @param {number} time_s */
  xOf(time_s) {
    return SIDE_PX + (time_s / this.seconds()) * (this.clientWidth - 2 * SIDE_PX);
  }

  /** @private @param {PointerEvent} event */
  timeAt(event) {
    const x = event.clientX - this.getBoundingClientRect().left;
    return Math.min(1, Math.max(0, (x - SIDE_PX) / Math.max(1, this.clientWidth - 2 * SIDE_PX))) * this.seconds();
  }

  /** Events and changed configurations, in the order of time. @returns {Flag[]} */
  flags() {
    const events = (this.survey?.events ?? []).map((event) => ({
      time_s: event.after_s, sign: event.kind === 'marked' ? 'M' : '!', color: event.kind === 'marked' ? '--accent' : '--warn',
      text: event.kind === 'marked' ? `marked: ${event.what}` : `${event.stage ?? ''} ${event.kind}: ${event.what}`.trim(),
    }));
    const configurations = (this.about?.configurations ?? []).slice(1).map(({ after_s, revision, changes }) => ({
      time_s: after_s, sign: 'C', color: '--filter', text: `configuration ${revision}: ${changes.join(', ') || 'nothing changed'}`,
    }));
    return [...events, ...configurations].sort((a, b) => a.time_s - b.time_s);
  }

  /** @private @param {PointerEvent} event */
  flagAt(event) {
    const box = this.getBoundingClientRect();
    if (event.clientY - box.top > FLAGS_PX) return null;
    const x = event.clientX - box.left;
    const away = (/** @type {Flag} */ flag) => Math.abs(this.xOf(flag.time_s) - x);
    return this.flags().filter((flag) => away(flag) < NEAR_PX).sort((a, b) => away(a) - away(b))[0] ?? null;
  }

  /** @private @param {PointerEvent} event */
  showTip(event) {
    const time_s = this.timeAt(event);
    const flag = this.flagAt(event);
    const slack_s = (LEAST_GAP_PX * this.seconds()) / Math.max(1, this.clientWidth);
    const gap = this.survey?.gaps.find(({ from_s, to_s }) => time_s > from_s - slack_s && time_s < to_s + slack_s);
    const bin = this.binAt(time_s);
    const found = bin === null || bin === undefined ? '' : `, at least ${bin} of ${this.robots} robots`;
    this.tip.textContent = flag ? `${flag.time_s.toFixed(2)} s  ${flag.text}`
      : gap ? `${gap.from_s.toFixed(2)} s  ${gap.missing} frame${gap.missing === 1 ? '' : 's'} missing` : `${time_s.toFixed(2)} s${found}`;
    this.tip.hidden = false;
    const x = event.clientX - this.getBoundingClientRect().left;
    this.tip.style.left = `${Math.min(Math.max(0, x - 20), Math.max(0, this.clientWidth - this.tip.offsetWidth))}px`;
  }

  /** @private @param {number} time_s */
  binAt(time_s) {
    const bins = this.survey?.robots ?? [];
    return bins[Math.min(bins.length - 1, Math.floor((time_s / this.seconds()) * bins.length))];
  }

  /** @private */
  draw() {
    const { canvas } = this;
    const [width, height] = [this.clientWidth, this.clientHeight].map((size) => Math.round(size * devicePixelRatio));
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    const context = canvas.getContext('2d');
    if (!context || !width || !height) return;
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    context.clearRect(0, 0, this.clientWidth, this.clientHeight);
    const style = getComputedStyle(this);
    const color = (/** @type {string} */ name) => style.getPropertyValue(name);
    const [top, bottom] = [FLAGS_PX, this.clientHeight - AXIS_PX];
    context.fillStyle = color('--ground');
    context.fillRect(SIDE_PX, top, this.clientWidth - 2 * SIDE_PX, bottom - top);
    this.drawFound(context, color, top, bottom);
    this.drawGaps(context, color, top, bottom);
    this.drawComparison(context, color, top, bottom);
    this.drawAxis(context, color, bottom);
    this.drawFlags(context, color, bottom);
    const x = this.xOf(this.time_s);
    context.fillStyle = color('--text');
    context.fillRect(x - 1, top - 4, 2, bottom - top + 8);
    context.beginPath();
    context.moveTo(x - 6, top - 8);
    context.lineTo(x + 6, top - 8);
    context.lineTo(x, top);
    context.fill();
  }

  /** Columns as high as robots were found; the ball as a line below. @private @param {CanvasRenderingContext2D} context @param {(name: string) => string} color @param {number} top @param {number} bottom */
  drawFound(context, color, top, bottom) {
    const { robots, ball } = this.survey ?? { robots: [], ball: [] };
    const span = (this.clientWidth - 2 * SIDE_PX) / Math.max(1, robots.length);
    robots.forEach((found, index) => {
      if (found === null) return;
      const share = this.robots ? Math.min(1, found / this.robots) : 0;
      const high = share * (bottom - top - 6);
      context.fillStyle = color(share === 1 ? '--good' : '--warn');
      context.globalAlpha = share === 1 ? 0.35 : 0.6;
      context.fillRect(SIDE_PX + index * span, bottom - 4 - high, span + 0.5, high);
      context.globalAlpha = 1;
      context.fillStyle = '#ff8a2b';
      if (ball[index]) context.fillRect(SIDE_PX + index * span, bottom - 3, span + 0.5, 3);
    });
  }

  /** @private @param {CanvasRenderingContext2D} context @param {(name: string) => string} color @param {number} top @param {number} bottom */
  drawGaps(context, color, top, bottom) {
    for (const { from_s, to_s } of this.survey?.gaps ?? []) {
      const [from, to] = [this.xOf(from_s), this.xOf(to_s)];
      const wide = Math.max(LEAST_GAP_PX, to - from);
      context.fillStyle = color('--bad');
      context.fillRect((from + to - wide) / 2, top, wide, bottom - top);
    }
  }

  /** @private @param {CanvasRenderingContext2D} context @param {(name: string) => string} color @param {number} top @param {number} bottom */
  drawComparison(context, color, top, bottom) {
    const comparison = this.survey?.comparison;
    if (!comparison) return;
    const [from, to] = [this.xOf(comparison.from_s), this.xOf(comparison.to_s)];
    context.strokeStyle = color('--accent');
    context.lineWidth = 2;
    context.strokeRect(from, top + 1, Math.max(2, to - from), bottom - top - 2);
    const { different } = /** @type {Survey} */ (this.survey);
    const span = (this.clientWidth - 2 * SIDE_PX) / Math.max(1, different.length);
    context.fillStyle = color('--tracker');
    different.forEach((count, index) => {
      if (count) context.fillRect(SIDE_PX + index * span, top, Math.max(2, span), DIFFERENCES_PX);
    });
  }

  /** @private @param {CanvasRenderingContext2D} context @param {(name: string) => string} color @param {number} bottom */
  drawAxis(context, color, bottom) {
    const most = Math.max(1, (this.clientWidth - 2 * SIDE_PX) / 90);
    const step = TICKS_S.find((tick) => this.seconds() / tick <= most) ?? this.seconds() / most;
    context.fillStyle = color('--soft');
    context.font = '12px system-ui, sans-serif';
    context.textBaseline = 'top';
    for (let tick = 0; tick <= this.seconds() + 1e-6; tick += step) {
      const x = this.xOf(tick);
      context.fillRect(x, bottom, 1, 4);
      context.textAlign = tick === 0 ? 'left' : x > this.clientWidth - 40 ? 'right' : 'center';
      context.fillText(step < 1 ? `${tick.toFixed(1)} s` : duration(tick), x, bottom + 5);
    }
  }

  /** @private @param {CanvasRenderingContext2D} context @param {(name: string) => string} color @param {number} bottom */
  drawFlags(context, color, bottom) {
    context.font = '700 11px system-ui, sans-serif';
    context.textAlign = 'center';
    context.textBaseline = 'middle';
    for (const flag of this.flags()) {
      const x = this.xOf(flag.time_s);
      context.globalAlpha = 0.5;
      context.fillStyle = color(flag.color);
      context.fillRect(x - 0.5, 12, 1, bottom - 12);
      context.globalAlpha = 1;
      context.beginPath();
      context.roundRect(x - 7, 0, 14, 14, 3);
      context.fill();
      context.fillStyle = color('--panel');
      context.fillText(flag.sign, x, 7.5);
    }
  }
}

customElements.define('tl-timeline', Timeline);

/** "14:03:07, 12.34 s" @param {number} begins_s @param {number} time_s */
export function timeText(begins_s, time_s) {
  return `${clock(begins_s + time_s)}, ${time_s.toFixed(2)} s`;
}
