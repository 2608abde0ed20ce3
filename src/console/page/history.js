// The last ten seconds, kept in the browser, so that a moment can be looked at after it has passed.

/** @typedef {import('./types').Scene} Scene */

const KEPT_S = 10;
/** Time between two looks whether something has come. */
const LOOK_MS = 5;
/** Pictures above this are dropped, oldest first; what was found in them stays. */
const MOST_PICTURE_BYTES = 96e6;

export class History {
  constructor() {
    /** By frame number, in the order in which they came. @type {Map<number, Scene & {time_ms: number}>} */
    this.scenes = new Map();
    this.picture_bytes = 0;
    this.frozen = false;
  }

  /**
   * @param {number} seq
   * @param {Partial<Scene>} part
   * @param {number} now_ms of any steady clock
   */
  add(seq, part, now_ms) {
    if (this.frozen) return;
    let scene = this.scenes.get(seq);
    if (!scene) {
      // Numbers start again with a new group.
      const newest = this.newest();
      if (newest && seq < newest.seq - 2000) this.clear();
      scene = { seq, time_ms: now_ms };
      this.scenes.set(seq, scene);
    }
    if (part.picture) this.picture_bytes += part.picture.bytes.length - (scene.picture?.bytes.length ?? 0);
    Object.assign(scene, part);
    this.forget(now_ms);
  }

  /** @private @param {number} now_ms */
  forget(now_ms) {
    for (const [seq, scene] of this.scenes) {
      const too_old = now_ms - scene.time_ms > KEPT_S * 1000;
      if (!too_old && this.picture_bytes <= MOST_PICTURE_BYTES) break;
      this.picture_bytes -= scene.picture?.bytes.length ?? 0;
      if (too_old) this.scenes.delete(seq);
      else delete scene.picture;
    }
  }

  clear() {
    this.scenes.clear();
    this.picture_bytes = 0;
  }

  /** @returns {Scene|undefined} */
  newest() {
    let newest;
    for (const scene of this.scenes.values()) if (!newest || scene.seq > newest.seq) newest = scene;
    return newest;
  }

  /** Frames that can be shown, oldest first. */
  shown() {
    return [...this.scenes.values()].filter((scene) => scene.picture).sort((a, b) => a.seq - b.seq);
  }

  /**
   * What is known of a frame; what is missing there is taken from the nearest one.
   * @param {number} seq
   * @param {number} [most] frames that it may be away; what is further away is left out
   * @returns {Scene}
   */
  around(seq, most = Infinity) {
    const near = (/** @type {'detections'|'world'|'runs'} */ part) => {
      let nearest;
      for (const scene of this.scenes.values()) {
        if (scene[part] && Math.abs(scene.seq - seq) <= most && (!nearest || Math.abs(scene.seq - seq) < Math.abs(nearest.seq - seq))) nearest = scene;
      }
      return nearest;
    };
    return {
      seq, picture: this.scenes.get(seq)?.picture, detections: near('detections')?.detections, world: near('world')?.world, runs: near('runs')?.runs,
    };
  }

  /**
   * Waits until what was found on a frame has come, but not for ever.
   * @param {number} seq
   * @param {number} most_ms
   */
  async found(seq, most_ms) {
    const until_ms = performance.now() + most_ms;
    while (!this.scenes.get(seq)?.detections && performance.now() < until_ms) {
      await new Promise((resolve) => setTimeout(resolve, LOOK_MS));
    }
  }

  /**
   * Worlds up to a frame, oldest first: for trails.
   * @param {number} seq
   * @param {number} frames
   */
  worlds(seq, frames) {
    const worlds = [];
    for (const scene of this.scenes.values()) {
      if (scene.world && scene.seq <= seq && scene.seq > seq - frames) worlds.push(scene.world);
    }
    return worlds.sort((a, b) => a.seq - b.seq);
  }
}
