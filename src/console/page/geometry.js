// Between picture and pitch, for previews while something is dragged. The program's own camera model
// (common/geometry) decides; this one follows it: an undistorted picture is mapped to the floor by a
// homography, and the lens moves its points towards or away from a centre.

/** @typedef {import('./types').Pair} Pair */
/** @typedef {import('./types').Lens} Lens */
/** @typedef {number[]} Homography nine numbers, row by row */

/**
 * Solves a·x = b by elimination with pivoting; null if it has no single solution.
 * @param {number[][]} a @param {number[]} b
 */
export function solve(a, b) {
  const size = b.length;
  const rows = a.map((row, index) => [...row, b[index]]);
  for (let column = 0; column < size; column += 1) {
    let pivot = column;
    for (let row = column + 1; row < size; row += 1) {
      if (Math.abs(rows[row][column]) > Math.abs(rows[pivot][column])) pivot = row;
    }
    if (Math.abs(rows[pivot][column]) < 1e-12) return null;
    [rows[column], rows[pivot]] = [rows[pivot], rows[column]];
    for (let row = 0; row < size; row += 1) {
      if (row === column) continue;
      const factor = rows[row][column] / rows[column][column];
      for (let at = column; at <= size; at += 1) rows[row][at] -= factor * rows[column][at];
    }
  }
  return rows.map((row, index) => row[size] / row[index]);
}

/**
 * The homography that maps `from` to `to`, by least squares (normalised direct linear transform with the
 * last element 1); null if the points do not determine it.
 * @param {Pair[]} from @param {Pair[]} to @returns {Homography|null}
 */
export function homography(from, to) {
  if (from.length < 4 || from.length !== to.length) return null;
  const [source, target] = [normalise(from), normalise(to)];
  const a = Array.from({ length: 8 }, () => new Array(8).fill(0));
  const b = new Array(8).fill(0);
  source.points.forEach(([x, y], index) => {
    const [u, v] = target.points[index];
    for (const [row, value] of /** @type {[number[], number][]} */ ([
      [[x, y, 1, 0, 0, 0, -u * x, -u * y], u],
      [[0, 0, 0, x, y, 1, -v * x, -v * y], v],
    ])) {
      for (let i = 0; i < 8; i += 1) {
        b[i] += row[i] * value;
        for (let j = 0; j < 8; j += 1) a[i][j] += row[i] * row[j];
      }
    }
  });
  const h = solve(a, b);
  if (!h) return null;
  const { center: c, scale: s } = target;
  const back = [1 / s, 0, c[0], 0, 1 / s, c[1], 0, 0, 1];
  const forth = [source.scale, 0, -source.scale * source.center[0], 0, source.scale, -source.scale * source.center[1], 0, 0, 1];
  return multiply(multiply(back, [...h, 1]), forth);
}

/** @param {Pair[]} points */
function normalise(points) {
  const mean = (/** @type {number} */ axis) => points.reduce((sum, point) => sum + point[axis], 0) / points.length;
  /** @type {Pair} */
  const center = [mean(0), mean(1)];
  const spread = points.reduce((sum, [x, y]) => sum + Math.hypot(x - center[0], y - center[1]), 0) / points.length;
  const scale = Math.SQRT2 / Math.max(spread, 1e-9);
  return { center, scale, points: points.map(([x, y]) => [(x - center[0]) * scale, (y - center[1]) * scale]) };
}

/** @param {Homography} a @param {Homography} b */
function multiply(a, b) {
  const product = new Array(9).fill(0);
  for (let row = 0; row < 3; row += 1) {
    for (let column = 0; column < 3; column += 1) {
      for (let at = 0; at < 3; at += 1) product[3 * row + column] += a[3 * row + at] * b[3 * at + column];
    }
  }
  return product;
}

/** @param {Homography} h @returns {Homography} up to a factor */
export function inverse(h) {
  const [a, b, c, d, e, f, g, i, j] = h;
  return [
    e * j - f * i, c * i - b * j, b * f - c * e,
    f * g - d * j, a * j - c * g, c * d - a * f,
    d * i - e * g, b * g - a * i, a * e - b * d,
  ];
}

/** @param {Homography} h @param {Pair} point @returns {Pair} */
export function apply(h, [x, y]) {
  const w = h[6] * x + h[7] * y + h[8];
  return [(h[0] * x + h[1] * y + h[2]) / w, (h[3] * x + h[4] * y + h[5]) / w];
}

/** The floor as the camera sees it. */
export class Camera {
  /** @param {Lens|null} lens @param {number} width @param {number} height @param {Homography} image_from_field undistorted */
  constructor(lens, width, height, image_from_field) {
    this.lens = lens;
    this.half_diagonal = Math.hypot(width, height) / 2;
    this.image_from_field = image_from_field;
    this.field_from_image = inverse(image_from_field);
  }

  /**
   * The camera that shows these points of the floor at these pixels; null if they do not determine one.
   * @param {{field_mm: Pair, image_px: Pair}[]} points @param {Lens|null} lens @param {number} width @param {number} height
   */
  static through(points, lens, width, height) {
    const bent = new Camera(lens, width, height, [1, 0, 0, 0, 1, 0, 0, 0, 1]);
    const h = homography(points.map((pair) => pair.field_mm), points.map((pair) => bent.straight(pair.image_px)));
    return h && new Camera(lens, width, height, h);
  }

  /** @param {Pair} field_mm @returns {Pair} */
  toImage(field_mm) {
    return this.bend(apply(this.image_from_field, field_mm));
  }

  /** @param {Pair} image_px @returns {Pair} */
  toField(image_px) {
    return apply(this.field_from_image, this.straight(image_px));
  }

  /** From the undistorted picture to the real one. @param {Pair} point @returns {Pair} */
  bend(point) {
    return this.moved(point, (r) => this.bentRadius(r));
  }

  /** From the real picture to the undistorted one. @param {Pair} point @returns {Pair} */
  straight(point) {
    return this.moved(point, (bent) => {
      // The radius only grows with the undistorted one, where a lens is used.
      let [low, high] = [0, Math.max(4 * bent, 1)];
      for (let step = 0; step < 60; step += 1) {
        const middle = (low + high) / 2;
        if (this.bentRadius(middle) < bent) low = middle;
        else high = middle;
      }
      return (low + high) / 2;
    });
  }

  /** In pixels. @private @param {number} r */
  bentRadius(r) {
    const lens = this.lens;
    if (!lens) return r;
    if (lens.model === 'fisheye') {
      const t = Math.atan(r / lens.focal_px);
      const q = t * t;
      return lens.focal_px * t * (1 + q * (lens.k1 + q * (lens.k2 + q * (lens.k3 + q * lens.k4))));
    }
    const q = (r / this.half_diagonal) ** 2;
    return r * (1 + q * (lens.k1 + q * lens.k2));
  }

  /** @private @param {Pair} point @param {(r: number) => number} radius @returns {Pair} */
  moved(point, radius) {
    if (!this.lens) return point;
    const [cx, cy] = this.lens.center_px;
    const [dx, dy] = [point[0] - cx, point[1] - cy];
    const r = Math.hypot(dx, dy);
    if (r < 1e-9) return point;
    const factor = radius(r) / r;
    return [cx + dx * factor, cy + dy * factor];
  }
}

/**
 * Lines of a pitch: border, halfway line, circle, goals.
 * @param {{length_mm: number, width_mm: number, goal_width_mm: number, goal_depth_mm: number, center_circle_radius_mm: number}} field
 * @returns {Pair[][]}
 */
export function fieldLines(field) {
  const [x, y] = [field.length_mm / 2, field.width_mm / 2];
  const [g, d, r] = [field.goal_width_mm / 2, field.goal_depth_mm, field.center_circle_radius_mm];
  /** @type {Pair[][]} */
  const lines = [
    [[-x, y], [x, y], [x, -y], [-x, -y], [-x, y]],
    [[0, y], [0, -y]],
  ];
  if (r > 0) {
    lines.push(Array.from({ length: 49 }, (_, step) => {
      const angle = (step / 48) * 2 * Math.PI;
      return [r * Math.cos(angle), r * Math.sin(angle)];
    }));
  }
  if (g > 0 && d > 0) for (const side of [-1, 1]) lines.push([[side * x, g], [side * (x + d), g], [side * (x + d), -g], [side * x, -g]]);
  return lines;
}

/** Points along a line, near enough to show how the lens bends it. @param {Pair[]} line @param {number} step_mm @returns {Pair[]} */
export function subdivided(line, step_mm) {
  /** @type {Pair[]} */
  const points = [];
  line.forEach((to, index) => {
    if (index > 0) {
      const from = line[index - 1];
      const parts = Math.min(64, Math.ceil(Math.hypot(to[0] - from[0], to[1] - from[1]) / step_mm));
      for (let part = 1; part < parts; part += 1) {
        points.push([from[0] + ((to[0] - from[0]) * part) / parts, from[1] + ((to[1] - from[1]) * part) / parts]);
      }
    }
    points.push(to);
  });
  return points;
}
