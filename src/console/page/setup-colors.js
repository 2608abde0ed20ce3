// Step 3: which pixels have which colour. Learned by itself from live frames; then corrected by
// clicking and saying what it is, or by dragging bounds with the classes in view.

import { get } from './api.js';
import { changes } from './changes.js';
import { h, keyed, number, replace, say } from './dom.js';
import { learn } from './jobs.js';
import { css, label, place } from './overlay.js';
import { RangeInput } from './range.js';
import { jobButton, proofBox } from './setup-parts.js';
import { store } from './store.js';
import { attempt, toast } from './toast.js';

/** @typedef {import('./types').Pair} Pair */
/** @typedef {import('./types').ColorBox} ColorBox */

/** Room around a pixel that was named, in steps of a channel. */
const ROOM = 12;
const LEARN_FRAMES = 6;

const BOUNDS = /** @type {const} */ ([
  ['red', 'Red', 0, 255, 1, 0], ['green', 'Green', 0, 255, 1, 0], ['blue', 'Blue', 0, 255, 1, 0], ['hue_deg', 'Hue', 0, 360, 1, 0], ['saturation', 'Saturation', 0, 1, 0.01, 2],
]);

export class ColorsStep {
  name = 'colors';
  title = 'Colours';

  /** @param {import('./picture-view.js').PictureView} picture @param {HTMLElement} work */
  constructor(picture, work) {
    this.picture = picture;
    this.work = work;
    /** What was clicked and named. @type {{color: string, px: Pair}[]} */
    this.samples = [];
    /** @type {string|null} */
    this.selected = null;
    this.shows_classes = true;
    this.proofs = proofBox();
    this.list = h('div', { class: 'colors' });
    this.bounds = h('div', { class: 'bounds' });
    this.bounds_title = h('h2', null, 'Bounds');
    this.ranges = BOUNDS.map(([key, title, min, max, step, decimals]) => {
      const range = new RangeInput();
      Object.assign(range, { min, max, step, decimals, wraps: key === 'hue_deg' });
      range.setAttribute('aria-label', title);
      range.addEventListener('input', () => this.drag(key, range.value, false));
      range.addEventListener('change', () => this.drag(key, range.value, true));
      return range;
    });
    replace(this.bounds, BOUNDS.flatMap(([, title], index) => [h('span', { class: 'soft' }, title), this.ranges[index]]));
    this.learn_notes = h('div', null);
    this.learn = jobButton('Learn the colours', `Learning from ${LEARN_FRAMES} frames …`, () => this.learnColors());
    this.classes = h('button', { class: 'switch', 'aria-pressed': 'true', onclick: () => this.switchClasses() }, 'Show classes');
    this.forget = h('button', { class: 'small', onclick: () => { this.samples = []; this.update(); } }, 'Forget clicks');
    this.side = h('div', null,
      h('h1', null, 'Colours'), this.proofs.element,
      h('p', { class: 'soft' }, 'Put all robots and the ball on the pitch, also into the corners. What you click on must stand still while colours are learned.'),
      h('p', { class: 'soft' }, 'Robots are recognised by their patches while colours are learned: other patches than configured? ', h('a', { href: '#setup/robots' }, 'Choose them first.')),
      h('div', { class: 'row' }, this.learn, this.classes, this.forget),
      this.learn_notes,
      h('p', { class: 'soft' }, 'Wrong or missing? Click on the patch in the picture and say what it is.'),
      this.list, this.bounds_title, this.bounds,
    );
    /** @type {HTMLElement|null} */
    this.menu = null;
    this.closeMenu = this.closeMenu.bind(this);
  }

  show() {
    this.picture.bayer.shade = this.shows_classes ? 1 : 0;
    document.addEventListener('pointerdown', this.closeMenu);
  }

  hide() {
    this.picture.bayer.shade = 0;
    this.closeMenu();
    document.removeEventListener('pointerdown', this.closeMenu);
  }

  /** @param {Event} [event] */
  closeMenu(event) {
    if (event && this.menu?.contains(/** @type {Node} */ (event.target))) return;
    this.menu?.remove();
    this.menu = null;
  }

  switches() {
    return { ball: true, rejected: !this.shows_classes, regions: false, robots: !this.shows_classes, names: !this.shows_classes };
  }

  /** @private */
  switchClasses() {
    this.shows_classes = !this.shows_classes;
    this.classes.setAttribute('aria-pressed', String(this.shows_classes));
    this.picture.bayer.shade = this.shows_classes ? 1 : 0;
    this.picture.bayer.draw();
    this.picture.drawAll();
  }

  /** @private */
  async learnColors() {
    const answer = await attempt(learn({ frames: LEARN_FRAMES, samples: this.samples, set: Object.fromEntries(changes.draft) }));
    if (!answer) return;
    replace(this.learn_notes,
      h('p', null, `Learned from ${answer.frames} frames with ${number(answer.found, 1)} of ${number(answer.configured)} robots${answer.balls ? '' : ', without a ball'}.`),
      h('details', null, h('summary', { class: 'soft' }, 'How well the colours are separated'), h('pre', { class: 'code' }, answer.summary)));
    if (!Object.keys(answer.set).length) return toast('The colours are as they were learned before.');
    changes.propose(answer.set, true);
  }

  /** @private @param {typeof BOUNDS[number][0]} key @param {[number, number]} value @param {boolean} done */
  drag(key, value, done) {
    const color = this.color();
    if (!color) return;
    const is_whole = (key === 'hue_deg' && value[0] === 0 && value[1] === 360) || (key === 'saturation' && value[0] === 0 && value[1] === 1);
    if (is_whole && !color[key]) return;
    if (done) changes.propose({ [`colors.${color.name}.${key}`]: value });
    // At once in the picture, before anything is asked of the server.
    const colors = structuredClone(changes.values?.colors ?? []);
    const dragged = colors.find(({ name }) => name === color.name);
    if (dragged) /** @type {any} */ (dragged)[key] = value;
    this.picture.bayer.colors = colors;
    this.picture.bayer.draw();
    this.picture.drawAll();
  }

  /** @private @returns {ColorBox|undefined} */
  color() {
    return changes.values?.colors.find(({ name }) => name === this.selected);
  }

  /** What a colour is used for. @private @param {string} name */
  roles(name) {
    const values = changes.values;
    if (!values) return '';
    const roles = [
      values.ball.color === name ? 'ball' : null, values.teams.yellow.color === name ? 'yellow team' : null, values.teams.blue.color === name ? 'blue team' : null,
      values.robots.identities.some((identity) => identity.colors.includes(name)) ? 'robots' : null,
    ].filter(Boolean);
    return roles.join(', ') || 'not used';
  }

  /** @param {Pair} px @param {number} x @param {number} y */
  async pick(px, x, y) {
    this.closeMenu();
    const at = /** @type {Pair} */ (px.map(Math.round));
    const pixel = await get(`/api/pixel?x=${at[0]}&y=${at[1]}&seq=${this.picture.seq}`).catch(() => null);
    const colors = changes.values?.colors ?? [];
    const menu = h('div', { class: 'menu', role: 'menu' },
      h('p', null, pixel ? `RGB ${pixel.rgb.map(Math.round).join(' ')}: ${pixel.colors.length ? pixel.colors.join(', ') : 'no colour'}` : `pixel ${at.join(', ')}`),
      colors.map((color) => {
        const dot = h('i', { class: 'swatch' });
        dot.style.background = css(color.looks);
        return h('button', { role: 'menuitem', onclick: () => this.nameIt(color, at, pixel) }, dot, h('span', null, color.name), h('small', { class: 'soft' }, this.roles(color.name)));
      }));
    menu.style.left = `${Math.max(4, Math.min(x + 12, this.picture.clientWidth - 260))}px`;
    menu.style.top = `${Math.max(4, Math.min(y - 20, this.picture.clientHeight - 40 * colors.length - 50))}px`;
    menu.onkeydown = (event) => event.key === 'Escape' && this.closeMenu();
    this.menu = menu;
    this.work.append(menu);
    menu.querySelector('button')?.focus();
  }

  /** @private @param {ColorBox} color @param {Pair} px @param {import('./types').PixelReading|null} pixel */
  nameIt(color, px, pixel) {
    this.closeMenu();
    this.selected = color.name;
    this.samples.push({ color: color.name, px });
    const rgb = pixel?.rgb;
    if (rgb && !pixel.colors.includes(color.name)) {
      // Wide enough for this pixel; learning again with the clicks does it better.
      /** @type {Record<string, any>} */
      const set = {};
      /** @type {const} */ (['red', 'green', 'blue']).forEach((channel, index) => {
        const [low, high] = color[channel];
        const wider = [Math.max(0, Math.min(low, Math.round(rgb[index]) - ROOM)), Math.min(255, Math.max(high, Math.round(rgb[index]) + ROOM))];
        if (wider[0] !== low || wider[1] !== high) set[`colors.${color.name}.${channel}`] = wider;
      });
      if (Object.keys(set).length) changes.propose(set);
      else toast(`Its hue or saturation is outside the bounds of ${color.name}.`, 'Learn again: the click is used as an example.');
    }
    this.update();
  }

  update() {
    const values = changes.values;
    if (!values) return;
    this.selected ??= values.colors[0]?.name ?? null;
    this.proofs.show(this.proof());
    this.forget.hidden = !this.samples.length;
    say(this.forget, `Forget ${this.samples.length} click${this.samples.length === 1 ? '' : 's'}`);
    const regions = new Map();
    for (const region of store.detections?.regions ?? []) regions.set(region.class, (regions.get(region.class) ?? 0) + 1);
    keyed(this.list, values.colors.map((color, index) => ({ color, index })), ({ color }) => color.name, ({ color }) => {
      return h('button', { onclick: () => { this.selected = color.name; this.update(); } }, h('i', { class: 'swatch' }), h('span', null, color.name), h('span', { class: 'soft' }), h('small', null));
    }, (button, { color, index }) => {
      const [dot, , role, count] = button.children;
      /** @type {HTMLElement} */ (dot).style.background = css(color.looks);
      button.setAttribute('aria-pressed', String(color.name === this.selected));
      say(role, this.roles(color.name));
      const n = regions.get(index) ?? 0;
      say(count, `${n} region${n === 1 ? '' : 's'}`);
    });
    const color = this.color();
    say(this.bounds_title, color ? `Bounds of ${color.name}` : 'Bounds');
    if (color && !this.bounds.querySelector('button:active')) {
      BOUNDS.forEach(([key, , min, max], index) => this.ranges[index].set(/** @type {[number, number]} */ (color[key] ?? [min, max])));
    }
    if (this.bounds.querySelector('button:active')) return;
    this.picture.bayer.colors = values.colors;
    const light = store.detections?.light ?? store.status?.light;
    this.picture.bayer.gains = light?.followed ? light.gains : [1, 1, 1];
  }

  /** @param {CanvasRenderingContext2D} context @param {import('./types').ViewTransform} view */
  layer(context, view) {
    for (const { color, px } of this.samples) {
      const [x, y] = place(view, px);
      context.beginPath();
      context.arc(x, y, 5, 0, 2 * Math.PI);
      context.strokeStyle = '#fff';
      context.lineWidth = 2;
      context.stroke();
      label(context, color, x, y - 16, { font: '500 12px system-ui, sans-serif' });
    }
  }

  /** @returns {import('./setup-view.js').Proof} */
  proof() {
    const found = store.status?.found;
    if (!found) return { level: 'open', what: 'waiting for frames' };
    const all = found.robots_configured;
    if (all > 0 && found.robots === all && found.ball) return { level: 'good', what: `${all} of ${all} robots and the ball` };
    const missing = store.detections?.rejected.length ?? 0;
    return {
      level: found.robots ? 'bad' : 'open', what: `${found.robots} of ${all} robots${found.ball ? ' and the ball' : ', no ball'}`,
      todo: missing ? `${missing} candidates are rejected: switch the classes off to read why.` : 'Learn the colours, with everything on the pitch.',
    };
  }
}
