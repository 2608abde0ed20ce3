// How well each robot is seen: found ratio, longest blackout, jitter while it stands. A pure computation
// over what arrives; buckets of a second keep it small.

/** @typedef {import('./types').World} World */
/** @typedef {import('./types').Detections} Detections */
/** @typedef {import('./types').RobotName} RobotName */

/** Slower robots stand. */
const STANDING_MM_S = 15;
const STANDING_DEG_S = 10;
/** Poses of a standing robot that are compared with one another. */
const FEWEST_POSES = 15;

/** @typedef {{n: number, found: number, blackout_ms: number, poses: [number, number, number][]}} Bucket */
/**
 * @typedef {object} RobotQuality
 * @property {string} name
 * @property {RobotName} robot
 * @property {boolean} seen whether it was ever seen
 * @property {number|null} found share of the samples in which it was measured
 * @property {number|null} blackout_ms longest time without a measurement
 * @property {number|null} jitter_mm root mean square around the mean, standing
 * @property {number|null} jitter_deg the same of the heading
 * @property {number|null} since_ms time since the last measurement
 */

export class Quality {
  /** @param {number} seconds over which it looks back */
  constructor(seconds) {
    this.seconds = seconds;
    /** @type {Map<string, {robot: RobotName, seen: boolean, since_ms: number|null, buckets: Bucket[]}>} */
    this.robots = new Map();
    this.second = -1;
  }

  /**
   * @param {World|null} world
   * @param {Detections|null} detections
   * @param {RobotName[]} configured
   * @param {number} frame_ms
   * @param {number} [now_s]
   */
  add(world, detections, configured, frame_ms, now_s = performance.now() / 1000) {
    const second = Math.floor(now_s);
    const is_new = second !== this.second;
    this.second = second;
    for (const robot of configured) {
      const entry = this.robots.get(robot.name) ?? { robot, seen: false, since_ms: null, buckets: [] };
      this.robots.set(robot.name, entry);
      if (is_new || !entry.buckets.length) {
        entry.buckets.push({ n: 0, found: 0, blackout_ms: 0, poses: [] });
        while (entry.buckets.length > this.seconds) entry.buckets.shift();
      }
    }
    if (world) this.addWorld(world, frame_ms);
    if (detections) this.addPoses(detections);
  }

  /** @private @param {World} world @param {number} frame_ms */
  addWorld(world, frame_ms) {
    const known = new Map(world.robots.map((robot) => [robot.name, robot]));
    for (const [name, entry] of this.robots) {
      const bucket = entry.buckets[entry.buckets.length - 1];
      const robot = known.get(name);
      bucket.n += 1;
      entry.since_ms = robot ? robot.seen_ms : null;
      this.standing.delete(name);
      if (!robot) continue;
      entry.seen = true;
      if (robot.seen_ms < 0.5 * frame_ms) bucket.found += 1;
      else bucket.blackout_ms = Math.max(bucket.blackout_ms, robot.seen_ms);
      const stands = Math.hypot(...robot.velocity_mm_s) < STANDING_MM_S && Math.abs(robot.turning_deg_s ?? 0) < STANDING_DEG_S;
      if (stands) this.standing.add(name);
      // Poses from before a move are not compared with those after it.
      else bucket.poses.length = 0;
    }
  }

  /** Robots that stand, by the newest world. @type {Set<string>} */
  standing = new Set();

  /** @private @param {Detections} detections */
  addPoses(detections) {
    for (const robot of detections.robots) {
      const entry = this.robots.get(robot.name);
      if (!entry || robot.heading_deg === null || !this.standing.has(robot.name)) continue;
      entry.buckets[entry.buckets.length - 1].poses.push([...robot.pose_mm, robot.heading_deg]);
    }
  }

  /** @returns {RobotQuality[]} in the order of the configuration */
  rows() {
    return [...this.robots.values()].map(({ robot, seen, since_ms, buckets }) => {
      const n = sum(buckets, (bucket) => bucket.n);
      // The newest second in which it stood long enough.
      const stood = buckets.filter((bucket) => bucket.poses.length >= FEWEST_POSES).at(-1);
      return {
        name: robot.name, robot, seen, since_ms,
        found: n ? sum(buckets, (bucket) => bucket.found) / n : null,
        blackout_ms: seen ? Math.max(0, ...buckets.map((bucket) => bucket.blackout_ms)) : null,
        jitter_mm: stood ? Math.hypot(spread(stood.poses.map((pose) => pose[0])), spread(stood.poses.map((pose) => pose[1]))) : null,
        jitter_deg: stood ? spread(unwrapped(stood.poses.map((pose) => pose[2]))) : null,
      };
    });
  }

  /** Robots that are not configured any more are forgotten. @param {RobotName[]} configured */
  keep(configured) {
    const names = new Set(configured.map((robot) => robot.name));
    for (const name of this.robots.keys()) if (!names.has(name)) this.robots.delete(name);
  }
}

/** @template T @param {T[]} items @param {(item: T) => number} value */
function sum(items, value) {
  return items.reduce((total, item) => total + value(item), 0);
}

/** Standard deviation. @param {number[]} values */
export function spread(values) {
  const mean = sum(values, (value) => value) / values.length;
  return Math.sqrt(sum(values, (value) => (value - mean) ** 2) / values.length);
}

/** Angles without jumps by a turn. @param {number[]} degrees */
export function unwrapped(degrees) {
  return degrees.map((angle) => angle + 360 * Math.round((degrees[0] - angle) / 360));
}
