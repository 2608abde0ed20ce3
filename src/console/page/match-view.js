// The match at a glance, from the sideline.

import { post } from './api.js';
import { drawLatencies, STAGES } from './chart.js';
import { bytes, clock, duration, h, keyed, mark, number, replace, say } from './dom.js';
import { reasonFor } from './needs.js';
import { shortName } from './overlay.js';
import { store } from './store.js';
import { attempt, toast } from './toast.js';

const LONG_SPAN_S = 300;
const SHORT_SPAN_S = 60;
/** A robot seen in fewer frames is worth a look. */
const GOOD_SHARE = 0.99;
const LONG_BLACKOUT_MS = 250;

export class MatchView {
  constructor() {
    this.visible = false;
    this.tiles = {
      robots: tile('Robots found'), ball: tile('Ball'), rate: tile('Frames a second'), latency: tile('Capture to world, median'),
      lost: tile('Frames lost'), restarts: tile('Restarts'),
    };
    this.robots = h('tbody', null);
    this.chart = h('canvas', { class: 'chart', role: 'img', 'aria-label': 'Latency by stage over five minutes' });
    this.legend = h('div', { class: 'legend' });
    this.stages = h('tbody', null);
    this.camera = h('dl', { class: 'facts' });
    this.light = h('dl', { class: 'facts' });
    this.events = h('div', { class: 'events' });
    this.programs = h('dl', { class: 'facts' });
    this.recording = h('div', { class: 'stack' });
    this.record_button = h('button', { onclick: () => this.record() }, 'Start recording');
    this.mark_text = h('input', { type: 'text', placeholder: 'What happened', 'aria-label': 'What happened', onkeydown: (/** @type {KeyboardEvent} */ event) => event.key === 'Enter' && this.mark() });
    this.mark_button = h('button', { onclick: () => this.mark(), title: 'Key K' }, 'Mark');
    this.record_facts = h('dl', { class: 'facts' });
    replace(this.recording, h('div', { class: 'row' }, this.record_button, h('span', { class: 'grow' }, this.mark_text), this.mark_button), this.record_facts, h('a', { href: '#recordings' }, 'Look at recordings'));
    const heads = (/** @type {string[]} */ ...names) => h('thead', null, h('tr', null, names.map((name, index) => h('th', { class: index ? 'n' : '' }, name))));
    const panel = (/** @type {string} */ size, /** @type {string} */ title, /** @type {Node[]} */ ...content) =>
      h('div', { class: `panel ${size}` }, h('h2', null, title), content);
    this.element = h('section', { class: 'match' },
      Object.values(this.tiles).map((each) => each.element),
      h('div', { class: 'half stack' },
        panel('', 'Robots, last minute', h('table', null, heads('Robot', 'found', 'longest blackout', 'jitter', 'heading', ''), this.robots)),
        panel('grow', 'Events', this.events)),
      h('div', { class: 'half stack' },
        h('div', { class: 'panel' }, h('h2', null, 'Latency by stage'), this.chart, this.legend),
        panel('', 'Stages', h('table', null, heads('Stage', 'frames', 'missed', 'dropped', 'restarts', 'CPU', 'memory', ''), this.stages))),
      panel('half', 'Recording', this.recording), panel('half', 'Camera', this.camera), panel('half', 'Light', this.light), panel('half', 'Group', this.programs),
    );
    store.on('status', () => this.update());
    store.on('scene', () => this.updateRobots());
  }

  show() {
    this.visible = true;
    store.want('match', ['world', 'detections']);
    this.update();
    this.updateRobots();
  }

  hide() {
    this.visible = false;
    store.want('match', []);
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (event.key !== 'k' || event.ctrlKey || event.metaKey || event.altKey) return false;
    this.mark();
    return true;
  }

  /** @private */
  async mark() {
    const text = this.mark_text.value.trim() || 'marked in the console';
    if (!(await attempt(post('/api/mark', { text })))) return;
    this.mark_text.value = '';
    toast('Marked.', text);
  }

  /** @private */
  async record() {
    const running = store.status?.recording;
    const answer = await attempt(post('/api/record', running ? { start: false } : { start: true, path: null }));
    if (answer) toast(running ? 'The recording is complete.' : 'Recording.', answer.path ?? running?.path);
  }

  /** @private @param {string} process */
  async restart(process) {
    if (await attempt(post('/api/restart', { process }))) toast(`The ${process} is being restarted.`, STAGES.some((stage) => process.startsWith(stage)) ? 'A spare takes over; no frame is lost.' : undefined);
  }

  /** @private */
  update() {
    const status = store.status;
    if (!this.visible || !status) return;
    const { frames, found } = status;
    const latest = store.latencies.at(-1);
    const restarts = Object.values(status.stages).reduce((sum, stage) => sum + stage.restarts, 0);
    const lost = frames.missing_in_world + frames.never_captured;
    const missing = found.robots_configured - found.robots;
    this.tiles.robots.set(`${found.robots}`, `/ ${found.robots_configured}`, missing > 0 ? `${missing} not found` : found.unknown_robots ? `${found.unknown_robots} without identity` : 'all found', missing > 0 ? 'warn' : 'good');
    this.tiles.ball.set(found.ball ? 'seen' : 'not seen', '', found.ball ? 'in the newest frame' : 'hidden, or outside', found.ball ? 'good' : 'warn');
    this.tiles.rate.set(number(status.rate.world, 0), `/ ${number(status.camera.fps, 0)}`, `${number(status.rate.captured, 1)} captured`, status.rate.world < 0.95 * status.camera.fps ? 'warn' : 'good');
    this.tiles.latency.set(number((latest?.p50.filter ?? status.latency_us.capture_to_world.p50) / 1000, 2), 'ms', `99 % below ${number(status.latency_us.capture_to_world.p99 / 1000, 1)} ms`, '');
    this.tiles.lost.set(String(lost), '', `of ${frames.captured} frames`, lost ? 'warn' : 'good');
    this.tiles.restarts.set(String(restarts), '', `in ${duration(status.elapsed_s)}`, '');
    const now_s = performance.now() / 1000;
    const is_young = now_s - (store.latencies[0]?.time_s ?? now_s) < SHORT_SPAN_S;
    drawLatencies(this.chart, store.latencies, is_young ? SHORT_SPAN_S : LONG_SPAN_S, now_s);
    this.updateLegend(latest);
    this.updateStages(status);
    this.updateFacts(status);
    this.updateEvents(status);
  }

  /** @private @param {typeof store.latencies[number]|undefined} latest */
  updateLegend(latest) {
    if (!this.legend.children.length) {
      replace(this.legend, STAGES.map((stage) => {
        const dot = h('i', null);
        dot.style.background = `var(--${stage})`;
        return h('span', null, dot, h('span', null));
      }), h('span', null, '— slowest frame of each second'));
    }
    let before = 0;
    STAGES.forEach((stage, index) => {
      const until = latest?.p50[stage] ?? 0;
      say(/** @type {Element} */ (this.legend.children[index].lastElementChild), `${stage} ${number((until - before) / 1000, 2)} ms`);
      before = until;
    });
  }

  /** @private @param {import('./types').Status} status */
  updateStages(status) {
    const order = (/** @type {string} */ name) => STAGES.findIndex((stage) => name.startsWith(stage));
    const stages = Object.entries(status.stages).sort(([a], [b]) => order(a) - order(b) || a.localeCompare(b));
    const attendants = Object.entries(status.attendants ?? {});
    /** @type {[string, Partial<import('./types').StageState>, boolean][]} */
    const rows = [...stages.map(([name, stage]) => /** @type {[string, any, boolean]} */ ([name, stage, true])),
      ...attendants.map(([name, state]) => /** @type {[string, any, boolean]} */ ([name, { restarts: state.restarts, processes: state.pid ? [{ pid: state.pid, state: 'active' }] : [] }, false]))];
    keyed(this.stages, rows, ([name]) => name, ([name]) => h('tr', null,
      h('td', null), ...Array.from({ length: 6 }, () => h('td', { class: 'n' })),
      h('td', { class: 'n' }, h('button', { class: 'small', onclick: () => this.restart(name), title: `Replaces the ${name} by its spare` }, 'Restart')),
    ), (row, [name, stage, is_stage]) => {
      const cells = row.children;
      const processes = stage.processes ?? [];
      const works = processes.some(({ state }) => state === 'active' || state === 'waiting');
      const spare = processes.some(({ state }) => state === 'spare');
      say(cells[0], `${works ? '●' : '○'} ${name}${is_stage && works && !spare && name !== 'grabber' ? ' (no spare yet)' : ''}`);
      mark(cells[0], 'bad', !works);
      const dropped = Object.values(stage.dropped ?? {}).reduce((sum, count) => sum + count, 0);
      const values = is_stage
        ? [String(stage.frames_out), String(stage.frames_missed), String(dropped), String(stage.restarts), `${number(stage.cpu_percent, 0)} %`, bytes(stage.rss_bytes ?? 0)]
        : ['', '', '', String(stage.restarts), '', ''];
      values.forEach((value, index) => say(cells[index + 1], value));
      /** @type {HTMLButtonElement} */ (cells[7].firstElementChild).disabled = !store.mayChange || !store.connected;
    });
  }

  /** @private @param {import('./types').Status} status */
  updateFacts(status) {
    const { camera, light, resources, configuration, recording } = status;
    const device = camera.device;
    facts(this.camera, [
      ['Source', status.source],
      ['Picture', `${camera.width} × ${camera.height}, ${number(camera.fps, 0)} frames a second wanted, ${number(status.rate.captured, 1)} captured`],
      ...(device ? /** @type {[string, string][]} */ ([
        ['Device', device.description], ['State', device.problem || device.state],
        ['Lost', `${device.lost} never received, ${device.incomplete} damaged, ${device.starts} starts`],
      ]) : []),
    ]);
    facts(this.light, light ? [
      ['Correction', !light.followed ? 'off' : light.at_bound ? '! at its limit' : light.pitch_seen ? '✓ follows the pitch' : '! too little of the pitch is seen'],
      ['Gains', `red ${number(light.gains[0], 2)}, green ${number(light.gains[1], 2)}, blue ${number(light.gains[2], 2)}; across the pitch ${number(light.zones[0], 2)} to ${number(light.zones[1], 2)}`],
    ] : [['Correction', 'no report yet']]);
    const missing = [...(status.commanders ?? [])].map((sender) => `${sender.name} (${sender.robots.length} robots)`);
    facts(this.programs, [
      ['Configuration', `revision ${configuration.revision}${configuration.pending?.length ? `, waiting for ${configuration.pending.join(', ')}` : ''}: ${configuration.history.at(-1)?.what ?? ''}`],
      ['Commands', missing.length ? missing.join(', ') : 'no program sends commands'],
      ['Load', `pipeline ${number(resources.pipeline_cpu_percent, 0)} % of a processor, supervisor ${number(resources.supervisor_cpu_percent, 0)} %, memory ${bytes(resources.memory_bytes)}`],
      ['Version', `${status.version}, running ${duration(status.elapsed_s)}`],
    ]);
    say(this.record_button, recording ? 'End recording' : 'Start recording');
    mark(this.record_button, 'main', Boolean(recording));
    for (const button of [this.record_button, this.mark_button]) button.disabled = !store.mayChange || !store.connected;
    facts(this.record_facts, recording ? [
      ['File', recording.path],
      ['Size', `${bytes(recording.bytes)}${recording.free_bytes ? `, ${bytes(recording.free_bytes)} free` : ''}`],
      ...(recording.lost ? /** @type {[string, string][]} */ ([['Lost', `${recording.dropped} messages, because the disk is too slow; ${recording.missed} frames never reached the recorder`]]) : []),
    ] : []);
  }

  /** @private @param {import('./types').Status} status */
  updateEvents(status) {
    const events = status.events.slice(-60).reverse();
    if (!events.length) return replace(this.events, h('p', { class: 'soft' }, 'Nothing happened so far: no process ended, nothing was changed.'));
    if (this.events.firstElementChild?.tagName === 'P') replace(this.events);
    keyed(this.events, events, (event) => `${event.time_s} ${event.pid} ${event.what}`, (event) => h('details', event.evidence ? { 'data-evidence': 'yes' } : null,
      h('summary', null, h('time', null, clock(event.time_s)), h('b', null, event.stage), h('span', null, event.what)),
      event.evidence ? h('pre', { class: 'code' }, event.evidence) : null,
    ), () => {});
  }

  /** @private */
  updateRobots() {
    const now = performance.now();
    if (!this.visible || now - (this.robots_ms ?? 0) < 250) return;
    this.robots_ms = now;
    const configured = store.model?.robots ?? [];
    store.quality.keep(configured);
    keyed(this.robots, store.quality.rows(), (row) => row.name, (row) => {
      const fill = h('i', null);
      return h('tr', null,
        h('td', null, h('span', { class: row.robot.team === 'blue' ? 'robot is-blue' : 'robot' }, shortName(row.robot))),
        h('td', { class: 'n' }), h('td', { class: 'n' }), h('td', { class: 'n' }), h('td', { class: 'n' }),
        h('td', { class: 'n' }, h('div', { class: 'bar-of' }, fill)));
    }, (element, row) => {
      const cells = element.children;
      const away = row.since_ms === null || row.since_ms > 250;
      mark(/** @type {Element} */ (cells[0].firstElementChild), 'is-away', away);
      const share = row.found ?? 0;
      say(cells[1], row.seen ? `${number(100 * share, share > 0.999 ? 0 : 1)} %` : 'never');
      mark(cells[1], 'warn', share < GOOD_SHARE);
      say(cells[2], away && row.seen ? `away ${number((row.since_ms ?? 0) / 1000, 1)} s` : row.seen ? `${number(row.blackout_ms)} ms` : '–');
      mark(cells[2], 'warn', (row.blackout_ms ?? 0) > LONG_BLACKOUT_MS);
      say(cells[3], row.jitter_mm === null ? '–' : `${number(row.jitter_mm, 2)} mm`);
      say(cells[4], row.jitter_deg === null ? '–' : `${number(row.jitter_deg, 2)}°`);
      const bar = /** @type {HTMLElement} */ (cells[5].firstElementChild);
      mark(bar, 'is-low', share < GOOD_SHARE);
      /** @type {HTMLElement} */ (bar.firstElementChild).style.width = `${100 * share}%`;
      element.setAttribute('title', away ? reasonFor(row.robot, store.detections, null) : '');
    });
  }

  /** @type {number|undefined} */
  robots_ms;
}

/** @param {string} title */
function tile(title) {
  const [value, unit, more] = [document.createTextNode('–'), h('small', null), h('p', null)];
  const big = h('div', { class: 'big' }, value, ' ', unit);
  const element = h('div', { class: 'panel tile' }, h('h2', null, title), big, more);
  return {
    element,
    /** @param {string} text @param {string} of @param {string} note @param {''|'good'|'warn'} level */
    set(text, of, note, level) {
      say(value, text);
      say(unit, of);
      say(more, `${level === 'good' ? '✓ ' : level === 'warn' ? '! ' : ''}${note}`);
      mark(big, 'warn', level === 'warn');
    },
  };
}

/** @param {HTMLElement} list @param {[string, string][]} pairs */
function facts(list, pairs) {
  if (list.children.length !== 2 * pairs.length) replace(list, pairs.flatMap(() => [h('dt', null), h('dd', null)]));
  pairs.forEach(([name, value], index) => {
    say(list.children[2 * index], name);
    say(list.children[2 * index + 1], value);
  });
}
