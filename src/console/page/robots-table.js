// The robots of a frame as a table: where they are, or why they are not found.

import { h, keyed, mark, number, say } from './dom.js';
import { reasonFor } from './needs.js';
import { middle, shortName } from './overlay.js';
import { store } from './store.js';

/** @typedef {import('./types').Scene} Scene */
/** @typedef {import('./types').RobotName} RobotName */

/** A robot that was not seen for longer is shown with the reason instead of its pose. */
const AWAY_MS = 250;

export class RobotsTable {
  constructor() {
    this.rows = h('tbody', null);
    this.ball_row = h('p', { class: 'soft' });
    this.none = h('p', { class: 'soft' }, 'No robots are configured. ', h('a', { href: '#setup/robots' }, 'Add them in Set-up.'));
    /** Where each was seen last. @type {Map<string, import('./types').Pair>} */
    this.last_px = new Map();
    this.element = h('div', { class: 'panel list' },
      h('table', null, h('thead', null, h('tr', null, h('th', null, 'Robot'), h('th', { class: 'n' }, 'x'), h('th', { class: 'n' }, 'y, mm'), h('th', { class: 'n' }, '°'), h('th', { class: 'n' }, 'mm/s'), h('th', { class: 'n' }, 'seen'))), this.rows),
      this.none, this.ball_row,
    );
  }

  /** @param {Scene|null} scene @param {import('./types').Model|null} model */
  update(scene, model) {
    const { world, detections } = scene ?? {};
    const known = new Map(world?.robots.map((robot) => [robot.name, robot]));
    for (const robot of detections?.robots ?? []) this.last_px.set(robot.name, robot.center_px);
    keyed(this.rows, model?.robots ?? [], (robot) => robot.name, (robot) => this.row(robot), (row, robot) => {
      const seen = known.get(robot.name);
      const cells = row.children;
      const away = !seen || seen.seen_ms > AWAY_MS;
      mark(row, 'is-selected', store.selected === robot.name);
      mark(/** @type {Element} */ (cells[0].firstElementChild), 'is-away', away);
      const first = /** @type {HTMLTableCellElement} */ (cells[1]);
      if (away) {
        const px = seen?.outline_px?.length ? middle(seen.outline_px) : this.last_px.get(robot.name) ?? null;
        if (first.colSpan !== 4) first.colSpan = 4;
        for (const index of [2, 3, 4]) /** @type {HTMLElement} */ (cells[index]).hidden = true;
        first.className = 'soft';
        say(first, reasonFor(robot, detections ?? null, px));
        say(cells[5], seen ? `${(seen.seen_ms / 1000).toFixed(1)} s` : '–');
        return;
      }
      if (first.colSpan !== 1) first.colSpan = 1;
      first.className = 'n';
      for (const index of [2, 3, 4]) /** @type {HTMLElement} */ (cells[index]).hidden = false;
      say(first, number(seen.pose_mm[0]));
      say(cells[2], number(seen.pose_mm[1]));
      say(cells[3], number(seen.heading_deg));
      say(cells[4], number(Math.hypot(...seen.velocity_mm_s)));
      say(cells[5], seen.seen_ms < 1 ? '✓' : `${seen.seen_ms.toFixed(0)} ms`);
    });
    this.none.hidden = (model?.robots.length ?? 1) > 0;
    const ball = world?.ball;
    const extra = detections?.rejected.length ?? 0;
    say(this.ball_row, `${ball ? `Ball ${number(ball.position_mm[0])}, ${number(ball.position_mm[1])} mm, ${number(Math.hypot(...ball.velocity_mm_s))} mm/s${ball.visible ? '' : ', not seen now'}` : 'No ball'}${extra ? ` · ${extra} candidate${extra === 1 ? '' : 's'} rejected` : ''}`);
  }

  /** @private @param {RobotName} robot */
  row(robot) {
    return h('tr', { onclick: () => store.select(robot.name) },
      h('td', null, h('span', { class: robot.team === 'blue' ? 'robot is-blue' : 'robot' }, shortName(robot))),
      h('td', { class: 'n' }), h('td', { class: 'n' }), h('td', { class: 'n' }), h('td', { class: 'n' }), h('td', { class: 'n' }));
  }
}
