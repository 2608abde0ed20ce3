// The page's pure parts, without a browser.

import assert from 'node:assert/strict';
import { test } from 'node:test';

const page = (/** @type {string} */ name) => import(new URL(`../../src/console/page/${name}.js`, import.meta.url).href);
const { Camera, apply, fieldLines, homography, inverse, solve } = await page('geometry');
const { History } = await page('history');
const { Quality, spread, unwrapped } = await page('quality');
const { need, reasonFor } = await page('needs');
const { Places, swaps } = await page('places');
const { redOf } = await page('bayer');
const { measure } = await page('setup-measure');

const CORNERS = [[-1100, 900], [1100, 900], [1100, -900], [-1100, -900]];
const PIXELS = [[56.6, 20], [582.4, 20], [593.1, 459], [45.9, 459]];
const near = (a, b, within) => a.forEach((value, axis) => assert.ok(Math.abs(value - b[axis]) < within, `${a} is not ${b}`));

test('a homography passes through its points, and back', () => {
  const h = homography(CORNERS, PIXELS);
  CORNERS.forEach((corner, index) => {
    near(apply(h, corner), PIXELS[index], 1e-6);
    near(apply(inverse(h), PIXELS[index]), corner, 1e-4);
  });
  assert.equal(homography(CORNERS.slice(1), PIXELS.slice(1)), null);
  assert.equal(homography([[0, 0], [1, 1], [2, 2], [3, 3]], PIXELS), null, 'points on a line determine nothing');
  assert.equal(solve([[1, 1], [2, 2]], [1, 2]), null);
});

test('lenses bend and straighten', () => {
  const none = { focal_px: 400, k1: 0, k2: 0, k3: 0, k4: 0, center_px: [319.5, 239.5] };
  for (const lens of [{ ...none, model: 'polynomial', k1: -0.1, k2: 0.01 }, { ...none, model: 'fisheye', k1: 1 / 12 }]) {
    const points = CORNERS.map((field_mm, index) => ({ field_mm, image_px: PIXELS[index] }));
    const camera = Camera.through(points, lens, 640, 480);
    for (const { field_mm, image_px } of points) near(camera.toImage(field_mm), image_px, 1e-3);
    near(camera.toField(camera.toImage([300, -200])), [300, -200], 0.01);
    assert.ok(Math.abs(camera.toImage([0, 900])[1] - 20) > 1, 'the border is not straight');
  }
});

test('lines of a pitch without goals and circle are the border and the halfway line', () => {
  const field = { length_mm: 2200, width_mm: 1800, goal_width_mm: 0, goal_depth_mm: 0, center_circle_radius_mm: 0 };
  assert.equal(fieldLines(field).length, 2);
  assert.equal(fieldLines({ ...field, goal_width_mm: 400, goal_depth_mm: 150, center_circle_radius_mm: 200 }).length, 5);
});

test('ten seconds are kept, and nothing while it is frozen', () => {
  const history = new History();
  const picture = (bytes) => ({ header: {}, bytes: new Uint8Array(bytes) });
  for (let seq = 0; seq < 30; seq += 1) history.add(seq, { picture: picture(10), detections: { seq } }, 1000 * seq);
  assert.deepEqual(history.shown().map(({ seq }) => seq), Array.from({ length: 11 }, (_, index) => 19 + index));
  history.frozen = true;
  history.add(30, { picture: picture(10) }, 30_000);
  assert.equal(history.newest().seq, 29);
  history.frozen = false;
  history.add(31, { picture: picture(97e6) }, 30_000);
  assert.equal(history.shown().length, 0, 'pictures are bounded by their size');
  assert.equal(history.scenes.get(29).detections.seq, 29, 'what was found stays');
});

test('what a frame lacks comes from the nearest one', () => {
  const history = new History();
  history.add(1, { world: { seq: 1 } }, 0);
  history.add(2, { detections: { seq: 2 } }, 1);
  history.add(3, { picture: { header: {}, bytes: new Uint8Array(1) } }, 2);
  history.add(4, { world: { seq: 4 }, detections: { seq: 4 } }, 3);
  const around = history.around(3);
  assert.equal(around.world.seq, 4);
  assert.equal(around.detections.seq, 2);
  assert.equal(history.around(3, 0).detections, undefined, 'too far away');
  assert.equal(history.around(3, 1).detections.seq, 2);
});

test('a new group starts the history again', () => {
  const history = new History();
  history.add(90_000, { detections: { seq: 90_000 } }, 0);
  history.add(3, { detections: { seq: 3 } }, 1);
  assert.equal(history.newest().seq, 3);
});

const ROBOT = { team: 'yellow', identity: 3, name: 'yellow 3' };
const world = (seen_ms, speed = 0, pose_mm = [0, 0], name = 'yellow 3') => ({ seq: 1, robots: [{ ...ROBOT, name, pose_mm, velocity_mm_s: [speed, 0], seen_ms }] });

test('quality: found ratio, longest blackout, jitter only while standing', () => {
  const quality = new Quality(60);
  const seen = (x) => ({ robots: [{ ...ROBOT, pose_mm: [x, 0], heading_deg: 179 + x }] });
  for (let frame = 0; frame < 80; frame += 1) quality.add(world(frame < 20 ? 12.5 * frame : 0), seen(frame % 2), [ROBOT], 12.5, frame / 80);
  let [row] = quality.rows();
  assert.equal(row.found, 61 / 80);
  assert.equal(row.blackout_ms, 12.5 * 19);
  assert.equal(row.jitter_mm, 0.5);
  assert.equal(row.jitter_deg, 0.5);
  for (let frame = 0; frame < 20; frame += 1) quality.add(world(0, 500), seen(frame), [ROBOT], 12.5, 1 + frame / 80);
  [row] = quality.rows();
  assert.equal(row.jitter_mm, 0.5, 'a moving robot has no jitter');
  quality.keep([]);
  assert.equal(quality.rows().length, 0);
  assert.equal(spread([1, 3]), 1);
  assert.deepEqual(unwrapped([179, -179]), [179, 181]);
});

test('a robot that never came has no blackout', () => {
  const quality = new Quality(60);
  quality.add({ seq: 1, robots: [] }, null, [ROBOT], 12.5, 0);
  const [row] = quality.rows();
  assert.deepEqual([row.seen, row.found, row.blackout_ms], [false, 0, null]);
});

const stage = (state) => ({ processes: [{ pid: 1, state }] });
const good = () => ({
  connected: true, met: true, lost_for_s: 0, robots_missing_s: 0,
  status: {
    elapsed_s: 60, complete: true, camera: { fps: 80 }, rate: { captured: 80, world: 80 }, found: { robots: 10, robots_configured: 10, ball: true, regions: 21 },
    stages: { grabber: stage('active'), tracker: stage('active') }, events: [],
  },
});

test('nothing is needed while all is well', () => {
  assert.equal(need(good()), null);
  assert.equal(need({ ...good(), status: null }), null);
});

test('one thing is needed, the gravest first', () => {
  const now = good();
  now.status.strangers = [{ pid: 7, program: 'x', name: '', topic: 'world' }];
  assert.equal(need(now).level, 'warn');
  now.status.found.robots = 0;
  assert.equal(need(now).level, 'warn', 'robots may be away for a moment');
  now.robots_missing_s = 5;
  assert.match(need(now).what, /No robot/);
  now.status.rate.captured = 30;
  assert.match(need(now).what, /30 of 80/);
  now.status.complete = false;
  now.status.stages.tracker = stage('starting');
  assert.equal(need(now).action.restart, 'tracker');
  now.status.camera.device = { problem: 'the camera is missing: plug it in' };
  assert.match(need(now).what, /plug it in/);
  now.connected = false;
  now.lost_for_s = 3;
  assert.match(need(now).what, /connection/);
});

test('a robot is missing for the reason of the candidate nearest to it', () => {
  const rejected = [
    { center_px: [500, 100], team: 'yellow', reason: 'too small' }, { center_px: [12, 10], team: 'yellow', reason: 'no identification patch in range' },
    { center_px: [10, 10], team: 'blue', reason: 'too large' },
  ];
  assert.equal(reasonFor(ROBOT, { robots: [], rejected }, [10, 10]), 'no identification patch in range');
  assert.match(reasonFor(ROBOT, { robots: [], rejected }, null), /2 yellow candidates rejected/);
  assert.match(reasonFor(ROBOT, { robots: [{ ...ROBOT, identity: null }], rejected: [] }, null), /without identity/);
  assert.match(reasonFor(ROBOT, { robots: [], rejected: [] }, null), /no further yellow patch/);
});

test('places tell where robots are missed', () => {
  const places = new Places(2, 1);
  const field = { length_mm: 2000, width_mm: 1000 };
  for (let frame = 0; frame < 20; frame += 1) {
    places.add(world(0, 0, [-500, 0]), field, 12.5);
    places.add(world(frame % 2 ? 0 : 12.5, 0, [500, 0]), field, 12.5);
    places.add(world(0, 0, [5000, 0]), field, 12.5);
  }
  assert.deepEqual(places.cells(field).map(({ share }) => share), [1, 0.5]);
});

test('two robots that change places within a frame have changed names', () => {
  const both = (a, b) => ({ robots: [...world(0, 0, a).robots, ...world(0, 0, b, 'yellow 4').robots] });
  assert.equal(swaps(both([0, 0], [500, 0]), both([500, 0], [0, 0])), 1);
  assert.equal(swaps(both([0, 0], [500, 0]), both([10, 0], [490, 0])), 0);
  assert.equal(swaps(both([0, 0], [20, 0]), both([10, 0], [10, 0])), 0, 'side by side is no exchange');
});

test('brightness and sharpness of a raw picture', () => {
  assert.deepEqual(redOf('bggr'), [1, 1]);
  const [width, height] = [32, 16];
  const flat = measure(new Uint8Array(width * height).fill(100), width, height, 'rggb');
  assert.equal(flat.sharpness, 0);
  assert.equal(flat.mean, 100);
  const striped = measure(Uint8Array.from({ length: width * height }, (_, at) => ((at % width) & 2 ? 255 : 50)), width, height, 'rggb');
  assert.ok(striped.sharpness > 30);
  assert.ok(striped.clipped.every((share) => share > 0.4));
});
