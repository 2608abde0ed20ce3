// A range with two ends, by pointer and keys: bounds of a colour.

import { h, say } from './dom.js';

export class RangeInput extends HTMLElement {
  constructor() {
    super();
    this.min = 0;
    this.max = 255;
    this.step = 1;
    this.decimals = 0;
    /** Whether the range may pass through its end, as a hue does. */
    this.wraps = false;
    /** @type {[number, number]} */
    this.value = [0, 255];
    this.outputs = [h('output', null), h('output', null)];
    this.fills = [h('i', null), h('i', null)];
    this.ends = [0, 1].map((end) => h('button', {
      type: 'button', 'aria-label': end ? 'highest' : 'lowest', role: 'slider',
      onkeydown: (/** @type {KeyboardEvent} */ event) => this.key(event, end),
    }));
    this.track = h('div', { class: 'track' }, this.fills, this.ends);
  }

  connectedCallback() {
    if (this.childElementCount) return;
    this.append(this.outputs[0], this.track, this.outputs[1]);
    let dragged = -1;
    const valueAt = (/** @type {PointerEvent} */ event) => {
      const box = this.track.getBoundingClientRect();
      return this.min + (this.max - this.min) * Math.min(1, Math.max(0, (event.clientX - box.left) / box.width));
    };
    this.track.addEventListener('pointerdown', (event) => {
      const value = valueAt(event);
      const [low, high] = this.value;
      dragged = Math.abs(value - low) < Math.abs(value - high) || (low === high && value < low) ? 0 : 1;
      this.track.setPointerCapture(event.pointerId);
      this.ends[dragged].focus();
      this.change(dragged, value);
      event.preventDefault();
    });
    this.track.addEventListener('pointermove', (event) => {
      if (dragged >= 0) this.change(dragged, valueAt(event));
    });
    const end = () => {
      if (dragged >= 0) this.dispatchEvent(new Event('change'));
      dragged = -1;
    };
    this.track.addEventListener('pointerup', end);
    this.track.addEventListener('pointercancel', end);
    this.draw();
  }

  /** @private @param {KeyboardEvent} event @param {number} end */
  key(event, end) {
    const by = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -10, PageUp: 10 }[event.key];
    if (!by) return;
    event.preventDefault();
    event.stopPropagation();
    this.change(end, this.value[end] + by * this.step);
    this.dispatchEvent(new Event('change'));
  }

  /** @private @param {number} end @param {number} value */
  change(end, value) {
    const rounded = Number((Math.round(value / this.step) * this.step).toFixed(this.decimals));
    const within = Math.min(this.max, Math.max(this.min, rounded));
    const next = /** @type {[number, number]} */ ([...this.value]);
    next[end] = within;
    if (!this.wraps && next[0] > next[1]) next[1 - end] = within;
    this.set(next);
    this.dispatchEvent(new Event('input'));
  }

  /** @param {[number, number]} value */
  set(value) {
    this.value = value;
    this.draw();
  }

  /** @private */
  draw() {
    const share = (/** @type {number} */ value) => (100 * (value - this.min)) / (this.max - this.min);
    const [low, high] = this.value;
    this.value.forEach((value, end) => {
      this.ends[end].style.left = `${share(value)}%`;
      this.ends[end].setAttribute('aria-valuenow', String(value));
      say(this.outputs[end], value.toFixed(this.decimals));
    });
    const spans = low <= high ? [[low, high], [0, 0]] : [[this.min, high], [low, this.max]];
    spans.forEach(([from, to], index) => {
      this.fills[index].style.left = `${share(from)}%`;
      this.fills[index].style.width = from === to ? '0' : `${share(to) - share(from)}%`;
    });
  }
}

customElements.define('tl-range', RangeInput);
