// The one thing that needs a human, if any, with what to do. Pure: status in, words out.

/** @typedef {import('./types').Status} Status */
/**
 * @typedef {object} Need
 * @property {'bad'|'warn'} level bad: the match suffers; warn: it will, or something is odd
 * @property {string} what
 * @property {string} todo
 * @property {{label: string, go?: string, restart?: string}} [action]
 */

/** Free disk space of a recording below which it should be ended or moved. */
const LITTLE_SPACE_BYTES = 5e9;

/**
 * @param {{connected: boolean, met: boolean, lost_for_s: number, status: Status|null, robots_missing_s: number}} now
 * @returns {Need|null}
 */
export function need({ connected, met, lost_for_s, status, robots_missing_s }) {
  if (!connected && lost_for_s > 1) {
    return {
      level: 'bad',
      what: met ? 'The connection to the console is lost.' : 'The console does not answer.',
      todo: 'This page comes back by itself. If the group has ended, start it again: touchline run',
    };
  }
  if (!status) return null;
  const camera = status.camera.device;
  if (camera?.problem) return { level: 'bad', what: `Camera: ${camera.problem}`, todo: '', action: { label: 'Camera', go: 'setup/camera' } };
  const lacking = stageProblem(status);
  if (lacking) return lacking;
  if (status.rate.captured < 0.8 * status.camera.fps && status.elapsed_s > 5) {
    return {
      level: 'bad',
      what: `The camera delivers ${status.rate.captured.toFixed(0)} of ${status.camera.fps.toFixed(0)} frames a second.`,
      todo: 'Shorten the exposure, or check its cable and the load of this computer: touchline doctor',
      action: { label: 'Camera', go: 'setup/camera' },
    };
  }
  if (status.rate.world < 0.8 * status.rate.captured && status.elapsed_s > 5) {
    return {
      level: 'bad',
      what: `Only ${status.rate.world.toFixed(0)} of ${status.rate.captured.toFixed(0)} frames a second are processed.`,
      todo: 'This computer is too slow or busy: end other programs, then run touchline doctor',
    };
  }
  return pictureProblem(status, robots_missing_s) ?? surroundings(status);
}

/** @param {Status} status @returns {Need|null} */
function stageProblem(status) {
  if (status.degraded?.length) {
    return { level: 'bad', what: `${status.degraded[0]}`, todo: 'The supervisor keeps trying. The events below have the cause.', action: { label: 'Events', go: 'match' } };
  }
  const without = Object.entries(status.stages).find(([, stage]) => !stage.processes.some(({ state }) => state === 'active' || state === 'waiting'));
  if (!status.complete && without && status.elapsed_s > 3) {
    return { level: 'bad', what: `The ${without[0]} is not working.`, todo: 'The supervisor is replacing it.', action: { label: `Restart ${without[0]}`, restart: without[0] } };
  }
  return null;
}

/** @param {Status} status @param {number} robots_missing_s @returns {Need|null} */
function pictureProblem(status, robots_missing_s) {
  const { found, light, tops, pictures } = status;
  if (pictures) return { level: 'bad', what: `The pictures look wrong: ${pictures}`, todo: '', action: { label: 'Camera', go: 'setup/camera' } };
  if (found.robots_configured > 0 && found.robots === 0 && robots_missing_s > 3) {
    return {
      level: 'bad', what: 'No robot is found.',
      todo: found.regions === 0 ? 'No colour is found either: learn the colours.' : 'Look at the reasons in the live view, then check colours and robots.',
      action: { label: 'Colours', go: 'setup/colors' },
    };
  }
  if (tops?.problem) return { level: 'bad', what: tops.problem, todo: '', action: { label: 'Robots', go: 'setup/robots' } };
  if (light?.followed && light.at_bound) {
    return { level: 'warn', what: 'The light has changed more than can be corrected.', todo: 'Correct the exposure, or learn the colours again.', action: { label: 'Colours', go: 'setup/colors' } };
  }
  return null;
}

/** @param {Status} status @returns {Need|null} */
function surroundings(status) {
  const space = status.recording?.free_bytes;
  if (space !== undefined && space < LITTLE_SPACE_BYTES) {
    return { level: 'warn', what: `Only ${(space / 1e9).toFixed(1)} GB are free for the recording.`, todo: 'It ends by itself before the disk is full. Remove old recordings.', action: { label: 'Match', go: 'match' } };
  }
  const stranger = status.strangers?.[0];
  if (stranger) {
    return { level: 'warn', what: `Program ${stranger.program || stranger.name || stranger.pid} (process ${stranger.pid}) publishes on ${stranger.topic}.`, todo: `Its messages are ignored. End it: kill ${stranger.pid}` };
  }
  const flood = status.commanders?.find((sender) => sender.floods);
  if (flood) return { level: 'warn', what: `${flood.name} (process ${flood.pid}) sends commands faster than they can be used.`, todo: 'Let it send once a frame.' };
  const overruled = status.commanders?.find((sender) => sender.overruled?.length);
  if (overruled) return { level: 'warn', what: `Two programs command ${overruled.overruled?.[0]}.`, todo: `End one of them, for example process ${overruled.pid} (${overruled.name}).` };
  return null;
}

/**
 * Why a robot is not found, in words: the nearest rejected candidate of its team, or what else is known.
 * @param {import('./types').RobotName} robot
 * @param {import('./types').Detections|null} detections
 * @param {[number, number]|null} last_px where it was seen last
 */
export function reasonFor(robot, detections, last_px) {
  if (!detections) return 'no frame yet';
  const unknown = detections.robots.filter((other) => other.team === robot.team && other.identity === null);
  const candidates = detections.rejected.filter((candidate) => candidate.team === robot.team || candidate.team === null);
  const distance = (/** @type {{center_px: [number, number]}} */ a) => (last_px ? Math.hypot(a.center_px[0] - last_px[0], a.center_px[1] - last_px[1]) : 0);
  const nearest = candidates.sort((a, b) => distance(a) - distance(b))[0];
  if (nearest && last_px && distance(nearest) < 60) return nearest.reason;
  if (unknown.length) return `${unknown.length} ${robot.team} robot${unknown.length > 1 ? 's' : ''} without identity in the picture`;
  if (nearest) return `${candidates.length} ${robot.team} candidate${candidates.length > 1 ? 's' : ''} rejected: ${nearest.reason}`;
  return `no further ${robot.team} patch in the picture`;
}
