// Latency over time: one band a stage, and the slowest frame of each second as a line.

/** @typedef {{time_s: number, p50: import('./types').StageTimes, worst_us: number}} Point */

export const STAGES = /** @type {const} */ (['grabber', 'classifier', 'tracker', 'filter']);

/** Steps of a scale that are easy to read. */
const STEPS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];

/**
 * @param {HTMLCanvasElement} canvas
 * @param {Point[]} points
 * @param {number} span_s
 * @param {number} now_s
 */
export function drawLatencies(canvas, points, span_s, now_s) {
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = width * devicePixelRatio;
  canvas.height = height * devicePixelRatio;
  const context = canvas.getContext('2d');
  if (!context || !width) return;
  context.scale(devicePixelRatio, devicePixelRatio);
  const style = getComputedStyle(canvas);
  const color = (/** @type {string} */ name) => style.getPropertyValue(`--${name}`);
  const [left, right, top, bottom] = [54, width - 4, 8, height - 22];
  // Room for most of the slowest frames, but the bands stay readable: outliers leave the top.
  const upper = (/** @type {number[]} */ values) => values.sort((a, b) => a - b)[Math.floor(values.length * 0.9)] ?? 1;
  const worst = upper(points.map((point) => point.worst_us / 1000));
  const usual = upper(points.map((point) => point.p50.filter / 1000));
  const typical = Math.max(0.5, Math.min(1.3 * worst, 5 * usual));
  const step = STEPS.find((candidate) => typical / candidate <= 4) ?? 1000;
  const most = Math.ceil(typical / step) * step;
  const x = (/** @type {number} */ time_s) => right - ((now_s - time_s) / span_s) * (right - left);
  const y = (/** @type {number} */ ms) => Math.max(top - 6, bottom - (ms / most) * (bottom - top));
  context.font = '12px system-ui, sans-serif';
  context.textBaseline = 'middle';
  for (let ms = 0; ms <= most + 1e-9; ms += step) {
    context.fillStyle = color('soft');
    context.textAlign = 'right';
    context.fillText(`${Number(ms.toFixed(1))} ms`, left - 6, y(ms));
    context.fillStyle = color('edge');
    context.fillRect(left, Math.round(y(ms)), right - left, 1);
  }
  context.fillStyle = color('soft');
  for (let ago = 0; ago <= span_s; ago += 60) {
    context.textAlign = ago === 0 ? 'right' : ago === span_s ? 'left' : 'center';
    context.fillText(ago ? `−${ago / 60} min` : 'now', x(now_s - ago), height - 8);
  }
  if (points.length < 2) return;
  let below = points.map(() => 0);
  for (const stage of STAGES) {
    const above = points.map((point) => point.p50[stage] / 1000);
    context.beginPath();
    points.forEach((point, index) => context.lineTo(x(point.time_s), y(above[index])));
    for (let index = points.length - 1; index >= 0; index -= 1) context.lineTo(x(points[index].time_s), y(below[index]));
    context.fillStyle = color(stage);
    context.fill();
    below = above;
  }
  context.beginPath();
  points.forEach((point) => context.lineTo(x(point.time_s), y(point.worst_us / 1000)));
  context.strokeStyle = color('text');
  context.lineWidth = 1.5;
  context.stroke();
}
