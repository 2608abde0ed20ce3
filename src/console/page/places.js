// Where on the pitch robots are found, and where not; and whether two of them exchanged their names.

/** @typedef {import('./types').World} World */
/** @typedef {import('./types').Pair} Pair */

/** Fewer samples in a square say nothing. */
const FEWEST = 10;
/** Two robots that changed places within a frame were exchanged; nothing drives that fast. */
const SAME_PLACE_MM = 40;

export class Places {
  /** @param {number} columns @param {number} rows */
  constructor(columns, rows) {
    this.columns = columns;
    this.rows = rows;
    this.n = new Uint32Array(columns * rows);
    this.found = new Uint32Array(columns * rows);
  }

  clear() {
    this.n.fill(0);
    this.found.fill(0);
  }

  /** @param {World} world @param {{length_mm: number, width_mm: number}} field @param {number} frame_ms */
  add(world, field, frame_ms) {
    for (const robot of world.robots) {
      const column = Math.floor((robot.pose_mm[0] / field.length_mm + 0.5) * this.columns);
      const row = Math.floor((0.5 - robot.pose_mm[1] / field.width_mm) * this.rows);
      if (column < 0 || row < 0 || column >= this.columns || row >= this.rows) continue;
      this.n[row * this.columns + column] += 1;
      if (robot.seen_ms < 0.5 * frame_ms) this.found[row * this.columns + column] += 1;
    }
  }

  /** Squares with enough samples. @param {{length_mm: number, width_mm: number}} field */
  cells(field) {
    /** @type {Pair} */
    const size_mm = [field.length_mm / this.columns, field.width_mm / this.rows];
    /** @type {{center_mm: Pair, size_mm: Pair, share: number}[]} */
    const cells = [];
    this.n.forEach((n, index) => {
      if (n < FEWEST) return;
      const [column, row] = [index % this.columns, Math.floor(index / this.columns)];
      cells.push({ center_mm: [(column + 0.5) * size_mm[0] - field.length_mm / 2, field.width_mm / 2 - (row + 0.5) * size_mm[1]], size_mm, share: this.found[index] / n });
    });
    return cells;
  }
}

/** Pairs of robots of one team, each now where the other one was. @param {World} before @param {World} after */
export function swaps(before, after) {
  const old = new Map(before.robots.map((robot) => [robot.name, robot]));
  let count = 0;
  after.robots.forEach((robot, index) => {
    for (const other of after.robots.slice(index + 1)) {
      const [was, other_was] = [old.get(robot.name), old.get(other.name)];
      if (!was || !other_was || robot.team !== other.team) continue;
      const near = (/** @type {Pair} */ a, /** @type {Pair} */ b) => Math.hypot(a[0] - b[0], a[1] - b[1]) < SAME_PLACE_MM;
      if (near(robot.pose_mm, other_was.pose_mm) && near(other.pose_mm, was.pose_mm) && !near(robot.pose_mm, was.pose_mm)) count += 1;
    }
  });
  return count;
}
