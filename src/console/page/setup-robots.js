// Step 4: how the robots look, and which of them there are. Each is ticked off when it was seen under
// its name for two seconds.

import { changes } from './changes.js';
import { h, keyed, mark, number, replace, say, svg } from './dom.js';
import { reasonFor } from './needs.js';
import { css, shortName } from './overlay.js';
import { keysForm, presetList, proofBox } from './setup-parts.js';
import { store } from './store.js';
import { toast } from './toast.js';

/** @typedef {import('./types').Identity} Identity */
/** @typedef {import('./types').Values} Values */

const SEEN_FOR_MS = 2000;
const SEEN_MS = 100;

/** @param {Identity} identity */
export function nameOf({ team, id }) {
  return `${team} ${id}`;
}

/**
 * A robot's top from above, its front to the right.
 * @param {Values} values @param {Identity|null} identity
 */
export function drawTop(values, identity) {
  const { size_mm, shape, patches } = values.robots;
  const half = size_mm / 2;
  const looks = (/** @type {string|undefined} */ name) => css(values.colors.find((color) => color.name === name)?.looks ?? [120, 120, 120]);
  let at = 0;
  const body = shape === 'round' ? svg('circle', { r: half, fill: '#0b0d0e', stroke: 'var(--faint)', 'stroke-width': half * 0.05 }) : svg('rect', { x: -half, y: -half, width: size_mm, height: size_mm, fill: '#0b0d0e', stroke: 'var(--faint)', 'stroke-width': half * 0.05, rx: 3 });
  const reach = half * 1.28;
  return svg('svg', { viewBox: `${-reach} ${-reach} ${2 * reach} ${2 * reach}`, 'aria-hidden': 'true' }, body,
    (identity?.patches ?? patches).map((patch) => {
      const color = patch.role === 'team' ? values.teams[identity?.team ?? 'yellow'].color : identity?.colors[at++];
      return svg('polygon', { points: patch.outline_mm.map(([x, y]) => `${x},${-y}`).join(' '), fill: looks(color) });
    }),
    svg('path', { d: `M ${half * 1.04} ${-half * 0.3} L ${half * 1.26} 0 L ${half * 1.04} ${half * 0.3}`, fill: 'none', stroke: 'currentColor', 'stroke-width': half * 0.1 }));
}

export class RobotsStep {
  name = 'robots';
  title = 'Robots';

  constructor() {
    /** Since when each robot is seen without a pause, of the steady clock. @type {Map<string, number>} */
    this.since = new Map();
    /** @type {Set<string>} */
    this.ticked = new Set();
    /** @type {string|null} */
    this.selected = null;
    this.drawn = '';
    this.proofs = proofBox();
    this.tops = h('div', { class: 'tops' });
    this.edit = h('div', { class: 'stack' });
    this.presets = presetList('layout', 'Patches and robots of a league …', (preset) => this.choosePreset(preset));
    this.roles = h('div', { class: 'form' });
    this.form = keysForm([
      { key: 'robots.size_mm', title: 'Side or diameter', unit: 'mm', min: 10 },
      { key: 'robots.height_mm', title: 'Height of the tops', unit: 'mm', min: 0 },
      { key: 'ball.diameter_mm', title: 'Diameter of the ball', unit: 'mm', min: 1 },
    ]);
    this.add = h('div', { class: 'row' },
      h('button', { class: 'small', onclick: () => this.addRobot('yellow') }, 'Add a yellow robot'), h('button', { class: 'small', onclick: () => this.addRobot('blue') }, 'Add a blue robot'));
    this.side = h('div', null,
      h('h1', null, 'Robots'), this.proofs.element,
      this.presets.element, this.roles, this.tops, this.edit, this.add, h('h2', null, 'Sizes'), this.form.element,
    );
    // Ticks are made all the time: a step may be left and come back to.
    store.on('scene', () => this.tick());
    store.on('model', () => this.forget());
  }

  show() {
    this.drawn = '';
    this.presets.load();
  }

  switches() {
    return { robots: true, names: true, headings: true, rejected: true, ball: true };
  }

  /** @private @param {import('./setup-parts.js').Preset} preset */
  choosePreset(preset) {
    if (!preset.values) return toast('The robots of this preset are not known here.');
    const { patches, identities, size_mm, height_mm, shape } = preset.values.robots;
    changes.propose({ 'robots.patches': patches, 'robots.identities': identities, 'robots.size_mm': size_mm, 'robots.height_mm': height_mm, 'robots.shape': shape });
    this.selected = null;
  }

  /** Ticks of robots that look otherwise now say nothing. @private */
  forget() {
    const looks = JSON.stringify([store.model?.robots, store.model?.body, store.model?.teams]);
    if (looks !== this.looks) {
      this.ticked.clear();
      this.since.clear();
    }
    this.looks = looks;
  }

  looks = '';

  /** @private */
  tick() {
    const now = performance.now();
    const seen = new Map((store.world?.robots ?? []).map((robot) => [robot.name, robot.seen_ms]));
    for (const { name } of store.model?.robots ?? []) {
      if ((seen.get(name) ?? Infinity) > SEEN_MS) this.since.delete(name);
      else if (!this.since.has(name)) this.since.set(name, now);
      const since = this.since.get(name);
      if (since !== undefined && now - since >= SEEN_FOR_MS) this.ticked.add(name);
    }
  }

  /** @private @param {Identity[]} identities */
  setIdentities(identities) {
    changes.propose({ 'robots.identities': identities });
  }

  /** @private @param {'yellow'|'blue'} team */
  addRobot(team) {
    const values = changes.values;
    if (!values) return;
    const { identities, patches } = values.robots;
    const id = Array.from({ length: 32 }, (_, number) => number).find((number) => !identities.some((other) => other.team === team && other.id === number)) ?? 0;
    const needed = patches.filter(({ role }) => role === 'identification').length;
    const taken = new Set([values.teams.yellow.color, values.teams.blue.color, values.ball.color]);
    const free = values.colors.map(({ name }) => name).filter((name) => !taken.has(name));
    const used = new Set(identities.filter((other) => other.team === team).map(({ colors }) => colors.join()));
    const first = free.find((name) => !used.has(Array(needed).fill(name).join())) ?? free[0] ?? values.colors[0].name;
    this.selected = `${team} ${id}`;
    this.setIdentities([...identities, { team, id, colors: Array(needed).fill(first) }]);
  }

  update() {
    const values = changes.values;
    if (!values) return;
    this.proofs.show(this.proof());
    this.form.update();
    const now = performance.now();
    const fingerprint = JSON.stringify([values.robots, values.teams, values.ball.color, values.colors.map(({ looks, name }) => [name, looks]), this.selected]);
    const is_new = fingerprint !== this.drawn && !this.edit.contains(document.activeElement);
    if (is_new) {
      this.drawn = fingerprint;
      this.drawRoles(values);
      this.drawEdit(values);
      replace(this.tops);
    }
    const last = new Map((store.world?.robots ?? []).map((robot) => [robot.name, robot]));
    keyed(this.tops, values.robots.identities, nameOf, (identity) => h('button', {
      class: 'top', onclick: () => { this.selected = this.selected === nameOf(identity) ? null : nameOf(identity); this.update(); },
    }, drawTop(values, identity), h('span', { class: identity.team === 'blue' ? 'robot is-blue' : 'robot' }, shortName({ team: identity.team, identity: identity.id })), h('span', { class: 'state' }), h('span', { class: 'why' })),
    (button, identity) => {
      const name = nameOf(identity);
      const since = this.since.get(name);
      const good = this.ticked.has(name);
      const here = since !== undefined;
      mark(button, 'is-good', good);
      button.setAttribute('aria-pressed', String(this.selected === name));
      say(button.children[2], good ? (here ? '✓ seen' : '✓ was seen') : here ? `${number((now - since) / 1000, 1)} s` : 'not seen');
      const outline = last.get(name)?.outline_px;
      const robot = { team: identity.team, identity: identity.id, name };
      const at = outline?.length ? /** @type {[number, number]} */ ([outline[0][0], outline[0][1]]) : null;
      const why = /** @type {HTMLElement} */ (button.children[3]);
      say(why, here ? '' : reasonFor(robot, changes.tried?.detections ?? store.detections, at));
      why.hidden = here;
    });
  }

  /** Colours of teams and ball. @private @param {Values} values */
  drawRoles(values) {
    const roles = /** @type {const} */ ([['teams.yellow.color', 'Yellow team wears', values.teams.yellow.color], ['teams.blue.color', 'Blue team wears', values.teams.blue.color], ['ball.color', 'The ball is', values.ball.color]]);
    replace(this.roles, roles.flatMap(([key, title, value]) => [
      h('label', { for: key }, title), colorSelect(values, value, (name) => changes.propose({ [key]: name }), key),
    ]));
  }

  /** The colours of the selected robot. @private @param {Values} values */
  drawEdit(values) {
    const identity = values.robots.identities.find((each) => nameOf(each) === this.selected);
    if (!identity) return replace(this.edit, h('p', { class: 'soft' }, 'Click on a robot to change its colours.'));
    const others = (/** @type {Identity} */ changed) => values.robots.identities.map((each) => (nameOf(each) === this.selected ? changed : each));
    replace(this.edit,
      h('h2', null, `Patches of ${nameOf(identity)}, in the order of the layout`),
      h('div', { class: 'row' },
        identity.colors.map((color, index) => colorSelect(values, color, (name) => {
          this.setIdentities(others({ ...identity, colors: identity.colors.map((old, at) => (at === index ? name : old)) }));
        }, `patch ${index + 1}`)),
        h('button', { class: 'small', onclick: () => {
          this.selected = null;
          this.setIdentities(values.robots.identities.filter((each) => nameOf(each) !== nameOf(identity)));
        } }, 'Remove this robot')));
  }

  /** @returns {import('./setup-view.js').Proof} */
  proof() {
    const robots = store.model?.robots ?? [];
    if (!robots.length) return { level: 'open', what: 'no robots configured', todo: 'Choose the patches of a league, or add robots.' };
    const ticked = robots.filter(({ name }) => this.ticked.has(name)).length;
    if (ticked === robots.length) return { level: 'good', what: `all ${robots.length} seen for two seconds` };
    return { level: ticked ? 'bad' : 'open', what: `${ticked} of ${robots.length} seen for two seconds`, todo: 'Put each robot on the pitch until it is ticked off. Below each missing one is the reason.' };
  }
}

/** @param {Values} values @param {string} value @param {(name: string) => void} choose @param {string} id */
function colorSelect(values, value, choose, id) {
  return h('select', { id, 'aria-label': id, onchange: (/** @type {Event} */ event) => {
    const select = /** @type {HTMLSelectElement} */ (event.target);
    select.blur();
    choose(select.value);
  } }, values.colors.map(({ name }) => h('option', { value: name, selected: name === value }, name)));
}
