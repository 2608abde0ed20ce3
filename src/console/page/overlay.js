// What is drawn over the picture. Teams are told apart by letter and shape too: names of yellow robots
// stand in square labels, of blue robots in round ones.

import { store } from './store.js';

/** @typedef {import('./types').Pair} Pair */
/** @typedef {import('./types').Scene} Scene */
/** @typedef {import('./types').Model} Model */
/** @typedef {import('./types').ViewTransform} ViewTransform */

/** The switches of the overlay: name, key, text, whether it is on at first. */
export const SWITCHES = /** @type {const} */ ([
  ['robots', 'r', 'Robots', true],
  ['names', 'n', 'Names', true],
  ['headings', 'h', 'Headings', true],
  ['ball', 'b', 'Ball', true],
  ['rejected', 'x', 'Rejected', true],
  ['regions', 'g', 'Regions', false],
  ['runs', 'u', 'Runs', false],
  ['trails', 't', 'Trails', false],
  ['prediction', 'p', 'Prediction', false],
  ['covariance', 'c', 'Covariance', false],
  ['lines', 'l', 'Field lines', true],
  ['mask', 'm', 'Mask', false],
]);

/** @typedef {Record<typeof SWITCHES[number][0], boolean>} Switches */

export const TEAM_COLORS = { yellow: '#ffd84a', blue: '#5cb0ff' };
const BALL_COLOR = '#ff9440';
const BAD_COLOR = '#ff6b6b';
const DARK = 'rgba(0, 0, 0, 0.72)';

/** @param {string} team */
export function teamColor(team) {
  return team === 'yellow' ? TEAM_COLORS.yellow : team === 'blue' ? TEAM_COLORS.blue : '#e8e8e8';
}

/** "Y3": team and number, "Y?" without number. @param {{team: string, identity: number|null}} robot */
export function shortName({ team, identity }) {
  return `${team === 'yellow' ? 'Y' : team === 'blue' ? 'B' : '?'}${identity ?? '?'}`;
}

/** @param {readonly number[]} rgb */
export function css(rgb) {
  return `rgb(${rgb.map(Math.round).join(',')})`;
}

/** @param {ViewTransform} view @param {Pair} px @returns {Pair} */
export function place({ scale, left, top }, [x, y]) {
  return [(x + 0.5) * scale + left, (y + 0.5) * scale + top];
}

/** @param {CanvasRenderingContext2D} context @param {ViewTransform} view @param {Pair[]} points @param {boolean} [closed] */
export function path(context, view, points, closed = false) {
  context.beginPath();
  points.forEach((point, index) => {
    const [x, y] = place(view, point);
    if (index) context.lineTo(x, y);
    else context.moveTo(x, y);
  });
  if (closed) context.closePath();
}

/** A line with a dark edge, which shows on any picture. @param {CanvasRenderingContext2D} context @param {string} color @param {number} width */
function stroke(context, color, width) {
  context.strokeStyle = DARK;
  context.lineWidth = width + 2;
  context.stroke();
  context.strokeStyle = color;
  context.lineWidth = width;
  context.stroke();
}

/**
 * A label; square or round by team.
 * @param {CanvasRenderingContext2D} context @param {string} text @param {number} x centre @param {number} y centre
 * @param {{color?: string, back?: string, round?: boolean, font?: string}} [style]
 */
export function label(context, text, x, y, { color = '#fff', back = DARK, round = false, font = '600 13px system-ui, sans-serif' } = {}) {
  context.font = font;
  const width = context.measureText(text).width + 10;
  const height = 18;
  context.beginPath();
  context.roundRect(x - width / 2, y - height / 2, width, height, round ? height / 2 : 2);
  context.fillStyle = back;
  context.fill();
  context.fillStyle = color;
  context.textAlign = 'center';
  context.textBaseline = 'middle';
  context.fillText(text, x, y + 1);
}

/** @param {Pair[]} points @returns {Pair} */
export function middle(points) {
  const sum = points.reduce(([x, y], [px, py]) => [x + px, y + py], [0, 0]);
  return [sum[0] / points.length, sum[1] / points.length];
}

/** Field lines and mask. @param {CanvasRenderingContext2D} context @param {ViewTransform} view @param {Model} model @param {Switches} on */
function drawPitch(context, view, model, on) {
  if (on.mask && model.mask_px?.length) {
    const polygons = /** @type {Pair[][]} */ (Array.isArray(model.mask_px[0][0]) ? model.mask_px : [model.mask_px]);
    context.beginPath();
    const [left, top] = place(view, [-0.5, -0.5]);
    context.rect(left, top, model.picture.width * view.scale, model.picture.height * view.scale);
    for (const polygon of polygons) {
      polygon.forEach((point, index) => {
        const [x, y] = place(view, point);
        if (index) context.lineTo(x, y);
        else context.moveTo(x, y);
      });
      context.closePath();
    }
    context.fillStyle = 'rgba(0, 0, 0, 0.6)';
    context.fill('evenodd');
  }
  if (on.lines && model.field.lines_px) {
    for (const line of model.field.lines_px) {
      path(context, view, line);
      context.strokeStyle = 'rgba(255, 255, 255, 0.75)';
      context.lineWidth = 1;
      context.stroke();
    }
  }
}

/** @param {CanvasRenderingContext2D} context @param {ViewTransform} view @param {Scene} scene @param {Model} model @param {Switches} on */
function drawColors(context, view, scene, model, on) {
  const looks = (/** @type {number} */ index) => css(model.colors.find((color) => color.class === index)?.looks ?? [255, 255, 255]);
  if (on.runs && scene.runs) {
    const flat = scene.runs.runs;
    for (let at = 0; at + 3 < flat.length; at += 4) {
      const [x, y] = place(view, [flat[at + 1] - 0.5, flat[at] - 0.5]);
      context.fillStyle = looks(flat[at + 3]);
      context.fillRect(x, y, (flat[at + 2] - flat[at + 1] + 1) * view.scale, Math.max(1, view.scale));
    }
  }
  if (on.regions && scene.detections) {
    for (const region of scene.detections.regions) {
      const [x0, y0, x1, y1] = region.box_px;
      const [left, top] = place(view, [x0 - 0.5, y0 - 0.5]);
      context.beginPath();
      context.rect(left - 1, top - 1, (x1 - x0 + 1) * view.scale + 2, (y1 - y0 + 1) * view.scale + 2);
      stroke(context, looks(region.class), 1.5);
    }
  }
}

/** @param {CanvasRenderingContext2D} context @param {ViewTransform} view @param {Scene} scene @param {Switches} on */
function drawRobots(context, view, scene, on) {
  for (const robot of scene.detections?.robots ?? []) {
    const color = teamColor(robot.team);
    if (on.robots && robot.outline_px.length) {
      path(context, view, robot.outline_px, true);
      stroke(context, color, robot.name === store.selected ? 3.5 : 2);
    } else if (on.robots) {
      const [x, y] = place(view, robot.center_px);
      context.beginPath();
      context.arc(x, y, 14, 0, 2 * Math.PI);
      stroke(context, color, 2);
    }
    if (on.headings && robot.heading_px) {
      path(context, view, robot.heading_px);
      stroke(context, '#fff', 2.5);
    }
  }
  if (!on.names) return;
  for (const robot of scene.detections?.robots ?? []) {
    const [x] = place(view, robot.center_px);
    const top = Math.min(...(robot.outline_px.length ? robot.outline_px : [robot.center_px]).map((point) => place(view, point)[1]));
    label(context, shortName(robot), x, Math.max(10, top - 12), { color: '#101214', back: teamColor(robot.team), round: robot.team === 'blue' });
  }
}

/** Tracks of the filter: what detections lack. @param {CanvasRenderingContext2D} context @param {ViewTransform} view @param {Scene} scene @param {Model} model @param {Switches} on */
function drawTracks(context, view, scene, model, on) {
  const found = new Set(scene.detections?.robots.map((robot) => robot.name));
  if (on.trails) {
    const worlds = scene.past ?? store.history.worlds(scene.seq, Math.round(2 * model.picture.fps));
    for (const robot of scene.world?.robots ?? []) {
      const points = worlds.map((world) => world.robots.find((other) => other.name === robot.name)?.outline_px).filter((outline) => outline?.length);
      path(context, view, points.map((outline) => middle(/** @type {Pair[]} */ (outline))));
      stroke(context, teamColor(robot.team), 1.5);
    }
  }
  for (const robot of scene.world?.robots ?? []) {
    if (!robot.outline_px?.length) continue;
    if (on.robots && !found.has(robot.name)) {
      // Predicted only: where it should be.
      context.setLineDash([4, 4]);
      path(context, view, robot.outline_px, true);
      stroke(context, teamColor(robot.team), 2);
      context.setLineDash([]);
      if (on.names) {
        const [x] = place(view, middle(robot.outline_px));
        const top = Math.min(...robot.outline_px.map((point) => place(view, point)[1]));
        label(context, `${shortName(robot)} unseen ${(robot.seen_ms / 1000).toFixed(1)} s`, x, Math.max(10, top - 12), { color: teamColor(robot.team), round: robot.team === 'blue' });
      }
    }
    const map = fieldToPicture(robot, model);
    if (!map) continue;
    if (on.prediction && robot.predicted) {
      context.setLineDash([2, 3]);
      path(context, view, outlineAt(model, robot.predicted.pose_mm, robot.predicted.heading_deg).map(map), true);
      stroke(context, '#fff', 1.5);
      context.setLineDash([]);
    }
    if (on.covariance) {
      path(context, view, ellipse(robot.pose_mm, robot.covariance_mm2).map(map), true);
      stroke(context, '#ff8af4', 1.5);
    }
  }
}

/** Corners of a robot's body on the field. @param {Model} model @param {Pair} pose @param {number} heading_deg @returns {Pair[]} */
export function outlineAt(model, pose, heading_deg) {
  const [sin, cos] = [Math.sin((heading_deg * Math.PI) / 180), Math.cos((heading_deg * Math.PI) / 180)];
  return model.body.outline_mm.map(([x, y]) => [pose[0] + x * cos - y * sin, pose[1] + x * sin + y * cos]);
}

/**
 * From the field to the picture near a robot, at the height of its top: the affine map between its two
 * outlines.
 * @param {import('./types').WorldRobot} robot @param {Model} model @returns {((point: Pair) => Pair)|null}
 */
function fieldToPicture(robot, model) {
  const body = model.body.outline_mm;
  if (robot.heading_deg === null || robot.outline_px.length !== body.length) return null;
  const field = outlineAt(model, robot.pose_mm, robot.heading_deg);
  const [center_mm, center_px] = [middle(field), middle(robot.outline_px)];
  // Least squares of the linear part.
  let [xx, xy, yy, ux, uy, vx, vy] = [0, 0, 0, 0, 0, 0, 0];
  field.forEach((point, index) => {
    const [x, y] = [point[0] - center_mm[0], point[1] - center_mm[1]];
    const [u, v] = [robot.outline_px[index][0] - center_px[0], robot.outline_px[index][1] - center_px[1]];
    xx += x * x; xy += x * y; yy += y * y; ux += u * x; uy += u * y; vx += v * x; vy += v * y;
  });
  const d = xx * yy - xy * xy;
  if (Math.abs(d) < 1e-9) return null;
  const [a, b, c, e] = [(ux * yy - uy * xy) / d, (uy * xx - ux * xy) / d, (vx * yy - vy * xy) / d, (vy * xx - vx * xy) / d];
  return ([x, y]) => [center_px[0] + a * (x - center_mm[0]) + b * (y - center_mm[1]), center_px[1] + c * (x - center_mm[0]) + e * (y - center_mm[1])];
}

/** Three standard deviations around a position, enlarged to be seen. @param {Pair} center @param {[number, number, number]} covariance xx, xy, yy @returns {Pair[]} */
export function ellipse(center, [xx, xy, yy]) {
  const [mean, half] = [(xx + yy) / 2, Math.hypot((xx - yy) / 2, xy)];
  const [a, b] = [3 * Math.sqrt(Math.max(0, mean + half)), 3 * Math.sqrt(Math.max(0, mean - half))];
  const angle = 0.5 * Math.atan2(2 * xy, xx - yy);
  const [sin, cos] = [Math.sin(angle), Math.cos(angle)];
  return Array.from({ length: 32 }, (_, step) => {
    const [u, v] = [a * Math.cos((step * Math.PI) / 16), b * Math.sin((step * Math.PI) / 16)];
    return [center[0] + u * cos - v * sin, center[1] + u * sin + v * cos];
  });
}

/** @param {CanvasRenderingContext2D} context @param {ViewTransform} view @param {Scene} scene @param {Switches} on */
function drawBallAndRejected(context, view, scene, on) {
  if (on.ball) {
    for (const ball of scene.detections?.balls.slice(0, 1) ?? []) {
      const [x, y] = place(view, ball.center_px);
      context.beginPath();
      context.arc(x, y, Math.max(6, ball.radius_px * view.scale + 3), 0, 2 * Math.PI);
      stroke(context, BALL_COLOR, 2.5);
    }
  }
  if (!on.rejected) return;
  for (const candidate of scene.detections?.rejected ?? []) {
    const [x, y] = place(view, candidate.center_px);
    context.beginPath();
    for (const side of [-1, 1]) {
      context.moveTo(x - 6, y - 6 * side);
      context.lineTo(x + 6, y + 6 * side);
    }
    stroke(context, BAD_COLOR, 2);
    const letter = candidate.team === 'yellow' ? 'Y: ' : candidate.team === 'blue' ? 'B: ' : candidate.team ? `${candidate.team}: ` : '';
    label(context, letter + candidate.reason, x, y + 18, { font: '500 12px system-ui, sans-serif' });
  }
}

/**
 * Everything that is switched on.
 * @param {CanvasRenderingContext2D} context @param {ViewTransform} view @param {Scene} scene @param {Model} model @param {Switches} on
 */
export function drawScene(context, view, scene, model, on) {
  context.lineJoin = 'round';
  drawPitch(context, view, model, on);
  drawColors(context, view, scene, model, on);
  drawTracks(context, view, scene, model, on);
  drawRobots(context, view, scene, on);
  drawBallAndRejected(context, view, scene, on);
}
