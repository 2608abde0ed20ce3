// The pitch from above in millimetres, drawn from `world`.

import { onceAFrame } from './dom.js';
import { ellipse, label, outlineAt, shortName, TEAM_COLORS, teamColor } from './overlay.js';
import { store } from './store.js';

/** @typedef {import('./types').Pair} Pair */
/** @typedef {import('./types').Scene} Scene */

export class FieldView extends HTMLElement {
  constructor() {
    super();
    this.canvas = document.createElement('canvas');
    /** @type {Scene|null} */
    this.scene = null;
    /** The pitch and its robots; without it those of the group. @type {import('./types').Model|null} */
    this.model = null;
    /** @type {{trails?: boolean, prediction?: boolean, covariance?: boolean, headings?: boolean}} */
    this.switches = {};
    /** Drawn below the robots. @type {((context: CanvasRenderingContext2D, at: (mm: Pair) => Pair, per_mm: number) => void)|null} */
    this.below = null;
    this.redraw = onceAFrame(() => this.draw());
  }

  connectedCallback() {
    if (!this.canvas.isConnected) this.append(this.canvas);
    this.setAttribute('role', 'img');
    this.setAttribute('aria-label', 'The pitch from above');
    this.resizes = new ResizeObserver(() => this.draw());
    this.resizes.observe(this);
    this.onclick = (event) => this.pick(event);
  }

  disconnectedCallback() {
    this.resizes?.disconnect();
  }

  /** @private @param {MouseEvent} event */
  pick(event) {
    const box = this.getBoundingClientRect();
    const [x, y] = [event.clientX - box.left, event.clientY - box.top];
    const { at, per_mm } = this.scaling();
    const near = (this.scene?.world?.robots ?? []).find((robot) => {
      const [rx, ry] = at(robot.pose_mm);
      return Math.hypot(rx - x, ry - y) < Math.max(14, 60 * per_mm);
    });
    if (near) store.select(near.name);
  }

  /** @private */
  scaling() {
    const field = (this.model ?? store.model)?.field;
    const [length, width] = [field?.length_mm ?? 2200, field?.width_mm ?? 1800];
    const around = 0.12 * Math.min(length, width);
    const per_mm = Math.min(this.clientWidth / (length + 2 * around), this.clientHeight / (width + around));
    const [cx, cy] = [this.clientWidth / 2, this.clientHeight / 2];
    return { per_mm, at: (/** @type {Pair} */ [x, y]) => /** @type {Pair} */ ([cx + x * per_mm, cy - y * per_mm]) };
  }

  /** @private */
  draw() {
    const { canvas } = this;
    const [width, height] = [this.clientWidth, this.clientHeight].map((size) => Math.round(size * devicePixelRatio));
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    const context = canvas.getContext('2d');
    const model = this.model ?? store.model;
    if (!context || !width || !height) return;
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    context.clearRect(0, 0, this.clientWidth, this.clientHeight);
    if (!model) return;
    const { at, per_mm } = this.scaling();
    const style = getComputedStyle(this);
    const line = (/** @type {Pair[]} */ points, closed = false) => {
      context.beginPath();
      points.forEach((point, index) => {
        const [x, y] = at(point);
        if (index) context.lineTo(x, y);
        else context.moveTo(x, y);
      });
      if (closed) context.closePath();
    };
    context.lineJoin = 'round';
    const [l, w] = [model.field.length_mm / 2, model.field.width_mm / 2];
    line([[-l, w], [l, w], [l, -w], [-l, -w]], true);
    context.fillStyle = style.getPropertyValue('--pitch');
    context.fill();
    this.below?.(context, at, per_mm);
    context.strokeStyle = style.getPropertyValue('--pitch-line');
    context.lineWidth = 1.5;
    for (const points of model.field.lines_mm) {
      line(points);
      context.stroke();
    }
    if (!this.scene?.world) return;
    if (this.switches.trails) this.drawTrails(context, line);
    for (const robot of this.scene.world.robots) this.drawRobot(context, robot, line, at, per_mm, style);
    const ball = this.scene.world.ball;
    if (ball) {
      const [x, y] = at(ball.position_mm);
      context.beginPath();
      context.arc(x, y, Math.max(4, model.ball.radius_mm * per_mm), 0, 2 * Math.PI);
      context.fillStyle = ball.visible ? '#ff8a2b' : 'transparent';
      context.fill();
      context.strokeStyle = ball.visible ? '#7a3600' : '#ff8a2b';
      context.lineWidth = 1.5;
      context.stroke();
      const speed = Math.hypot(...ball.velocity_mm_s);
      if (speed > 50) {
        line([ball.position_mm, [ball.position_mm[0] + ball.velocity_mm_s[0] * 0.3, ball.position_mm[1] + ball.velocity_mm_s[1] * 0.3]]);
        context.strokeStyle = '#ff8a2b';
        context.stroke();
      }
    }
  }

  /** @private @param {CanvasRenderingContext2D} context @param {(points: Pair[]) => void} line */
  drawTrails(context, line) {
    const scene = this.scene;
    const model = this.model ?? store.model;
    if (!scene?.world || !model) return;
    const worlds = scene.past ?? store.history.worlds(scene.seq, Math.round(2 * model.picture.fps));
    for (const robot of scene.world.robots) {
      line(worlds.flatMap((world) => world.robots.filter((other) => other.name === robot.name).map((other) => other.pose_mm)));
      context.strokeStyle = teamColor(robot.team);
      context.globalAlpha = 0.6;
      context.stroke();
      context.globalAlpha = 1;
    }
  }

  /**
   * @private
   * @param {CanvasRenderingContext2D} context @param {import('./types').WorldRobot} robot
   * @param {(points: Pair[], closed?: boolean) => void} line @param {(mm: Pair) => Pair} at @param {number} per_mm
   * @param {CSSStyleDeclaration} style
   */
  drawRobot(context, robot, line, at, per_mm, style) {
    const model = this.model ?? store.model;
    if (!model) return;
    const seen = robot.seen_ms < 100;
    const heading = robot.heading_deg ?? 0;
    const outline = outlineAt(model, robot.pose_mm, heading);
    line(outline, true);
    context.fillStyle = seen ? (robot.team === 'yellow' ? TEAM_COLORS.yellow : TEAM_COLORS.blue) : 'transparent';
    context.fill();
    context.setLineDash(seen ? [] : [3, 3]);
    context.strokeStyle = robot.name === store.selected ? style.getPropertyValue('--accent') : seen ? 'rgba(0, 0, 0, 0.65)' : teamColor(robot.team);
    context.lineWidth = robot.name === store.selected ? 4 : 1.5;
    context.stroke();
    context.setLineDash([]);
    if (robot.heading_deg !== null) {
      const reach = Math.max(...model.body.outline_mm.map(([x]) => x));
      const [sin, cos] = [Math.sin((heading * Math.PI) / 180), Math.cos((heading * Math.PI) / 180)];
      line([[robot.pose_mm[0] + 0.45 * reach * cos, robot.pose_mm[1] + 0.45 * reach * sin], [robot.pose_mm[0] + 1.7 * reach * cos, robot.pose_mm[1] + 1.7 * reach * sin]]);
      context.strokeStyle = style.getPropertyValue('--text');
      context.lineWidth = 2.5;
      context.stroke();
    }
    if (this.switches.covariance) {
      line(ellipse(robot.pose_mm, robot.covariance_mm2), true);
      context.strokeStyle = '#ff5ce8';
      context.lineWidth = 1.5;
      context.stroke();
    }
    if (this.switches.prediction && robot.predicted) {
      line(outlineAt(model, robot.predicted.pose_mm, robot.predicted.heading_deg), true);
      context.setLineDash([2, 3]);
      context.strokeStyle = style.getPropertyValue('--text');
      context.stroke();
      context.setLineDash([]);
    }
    const [x, y] = at(robot.pose_mm);
    label(context, shortName(robot), x, y - Math.max(18, 60 * per_mm + 10), {
      color: '#101214', back: seen ? teamColor(robot.team) : '#b9bec4', round: robot.team === 'blue', font: '600 12px system-ui, sans-serif',
    });
  }
}

customElements.define('tl-field', FieldView);
