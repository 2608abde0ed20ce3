// Shapes of what the server sends; docs/console.md describes them. Lengths in millimetres on the field,
// pixels in the picture: the centre of the top-left pixel is (0, 0).

export type Pair = [number, number];
export type Team = 'yellow' | 'blue';

export interface Hello {
  version: string; instance: string; rights: 'change' | 'watch'; source: string; alone: boolean; address: string;
}

export interface ColorLook { class: number; name: string; looks: [number, number, number] }
export interface RobotName { team: Team; identity: number | null; name: string }
export interface BodyPatch { role: 'team' | 'identification'; polygon_mm: Pair[] }

export interface Model {
  revision: number;
  picture: { width: number; height: number; fps: number };
  colors: ColorLook[];
  teams: { yellow: { color: string }; blue: { color: string } };
  robots: RobotName[];
  body: { outline_mm: Pair[]; front_mm?: number | null; patches: BodyPatch[] };
  ball: { radius_mm: number };
  field: { length_mm: number; width_mm: number; lines_mm: Pair[][]; lines_px: Pair[][] | null; outline_px: Pair[] | null };
  mask_px: Pair[] | Pair[][] | null;
}

export interface SeenRegion { class: number; center_px: Pair; box_px: [number, number, number, number]; pixels: number }
export interface SeenRobot extends RobotName {
  pose_mm: Pair; heading_deg: number | null; center_px: Pair; outline_px: Pair[]; heading_px: [Pair, Pair] | null;
  confidence: number;
}
export interface SeenBall { position_mm: Pair; center_px: Pair; radius_px: number; confidence: number }
export interface Rejected { center_px: Pair; team: string | null; color: string | null; reason: string }

export interface Detections {
  seq: number; revision: number; time_s: number;
  regions: SeenRegion[]; robots: SeenRobot[]; balls: SeenBall[]; rejected: Rejected[];
  light?: { followed: boolean; gains: number[] } | null;
}

export interface WorldRobot extends RobotName {
  pose_mm: Pair; heading_deg: number | null; velocity_mm_s: Pair; turning_deg_s?: number; covariance_mm2: [number, number, number];
  seen_ms: number; outline_px: Pair[]; predicted?: { pose_mm: Pair; heading_deg: number } | null;
}
export interface WorldBall { position_mm: Pair; velocity_mm_s: Pair; center_px: Pair; visible: boolean }
export interface StageTimes { grabber: number; classifier: number; tracker: number; filter: number }
export interface World {
  seq: number; revision: number; robots: WorldRobot[]; ball: WorldBall | null; latency_ms?: number;
}

/** `runs` is flat: row, first column, last column, class, and again. */
export interface Runs { seq: number; revision: number; runs: number[] }

export interface Percentiles { p50: number; p90: number; p99: number; max: number }
export interface GroupEvent {
  time_s: number; kind: string; stage: string; pid: number; what: string; evidence?: string;
}
export interface StageState {
  frames_in: number; frames_out: number; frames_missed: number; dropped: Record<string, number>; restarts: number;
  cpu_percent: number; rss_bytes: number; processes: { pid: number; state: string }[];
}
/** The document of `touchline status --json`. */
export interface Status {
  version: string; instance: string; source: string; elapsed_s: number; complete: boolean; degraded?: string[];
  camera: {
    width: number; height: number; fps: number;
    device?: {
      state: string; description: string; problem: string; promised_fps: number; delivered_fps: number;
      incomplete: number; lost: number; starts: number;
    };
  };
  configuration: { revision: number; pending: string[]; history: { revision: number; time_s: number; what: string }[] };
  frames: {
    captured: number; dropped_by_grabber: number; never_captured: number; not_seen: number; world: number;
    missing_in_world: number; not_seen_in_world: number; duplicates_in_world: number;
  };
  rate: { captured: number; world: number };
  latency_us: {
    capture_to_frame: Percentiles; capture_to_runs: Percentiles; capture_to_detections: Percentiles;
    capture_to_world: Percentiles; breakdown: Record<string, Percentiles>;
  };
  resources: {
    supervisor_cpu_seconds: number; supervisor_cpu_percent: number; pipeline_cpu_percent: number; memory_bytes: number;
  };
  stages: Record<string, StageState>;
  found: { robots: number; robots_configured: number; unknown_robots: number; ball: boolean; regions: number };
  light?: {
    followed: boolean; gains: number[]; zones: number[]; at_bound: boolean; pitch_seen: boolean; glare: boolean;
    changes: number;
  };
  pictures?: string;
  tops?: { scale: number; votes: number; problem: string };
  rejected: Record<string, number>;
  attendants?: Record<string, { pid: number | null; restarts: number }>;
  commanders?: { pid: number; name: string; robots: string[]; overruled?: string[]; messages: number; floods?: boolean }[];
  strangers?: { pid: number; name: string; program: string; topic: string; messages: number }[];
  recording?: { path: string; since_s: number; bytes: number; free_bytes: number; dropped: number; missed: number; lost: number } | null;
  events: GroupEvent[];
}

export interface PointPair { field_mm: Pair; image_px: Pair }
export interface Lens {
  model: 'polynomial' | 'fisheye'; focal_px: number; k1: number; k2: number; k3: number; k4: number; center_px: Pair;
}
export interface Geometry { camera_mm: [number, number, number]; points: PointPair[]; distortion: Lens }
export interface ColorBox {
  name: string; red: Pair; green: Pair; blue: Pair; hue_deg?: Pair | null; saturation?: Pair | null;
  y?: Pair | null; u?: Pair | null; v?: Pair | null; looks: [number, number, number];
}
export interface PatchShape { role: 'team' | 'identification'; outline_mm: Pair[] }
export interface Identity { team: Team; id: number; colors: string[]; patches?: PatchShape[] | null }
/** The parts of the configuration that the page edits. */
export interface Values {
  preset: string;
  field: {
    length_mm: number; width_mm: number; goal_width_mm: number; goal_depth_mm: number; center_circle_radius_mm: number;
    margin_mm: number; mask: boolean;
  };
  camera: {
    width: number; height: number; fps: number; bayer_order: string; mirrored: boolean; exposure_us: number;
    v4l2: { format: string; controls: Record<string, number | boolean | string> };
    genicam: { format: string; features: Record<string, number | boolean | string> };
  };
  geometry: Geometry;
  light: { follow: boolean; pitch_rgb?: number[] | null };
  colors: ColorBox[];
  teams: { yellow: { color: string }; blue: { color: string } };
  ball: { color: string; diameter_mm: number };
  robots: { shape: string; size_mm: number; height_mm: number; patches: PatchShape[]; identities: Identity[] };
}
export interface Configuration {
  revision: number; hash: string; text: string; file: string | null; file_changed: boolean; saved: boolean; values: Values;
}
export interface Changed { key: string; from: string | null; to: string | null }

export interface PictureHeader {
  seq: number; time_s: number; width: number; height: number; scale: number; format: 'jpeg' | 'raw';
  pixel_format: string; bayer: string;
}
export interface Picture { header: PictureHeader; bytes: Uint8Array<ArrayBuffer> }

/** All that is known of one frame, to be drawn together. */
export interface Scene {
  seq: number; detections?: Detections; world?: World; runs?: Runs; picture?: Picture;
  /** Worlds before it, for trails; without them those of the last seconds. */
  past?: World[];
}

/** From picture pixels to CSS pixels of a canvas: x = (x_px + 0.5) · scale + left. */
export interface ViewTransform { scale: number; left: number; top: number }

export interface PixelReading {
  raw: number | null; rgb: [number, number, number]; hue_deg: number | null; saturation: number; intensity: number;
  field_mm: Pair | null; colors: string[];
}

/** A recording in the list. */
export interface ListedRecording { place: string; name: string; directory: string; bytes: number; modified_s: number }
export interface RecordingList { recordings: ListedRecording[]; directories: string[]; played: string | null }
/** An opened recording; times are seconds since its first frame. */
export interface Opened {
  frames: number; seconds: number; begins_s: number; has_pictures: boolean; instance: string; version: string; revision: number;
  configurations: { revision: number; after_s: number; changes: string[] }[];
}
/** What another configuration finds on the same frame. */
export interface OtherResults { detections: Detections; world: World; runs: number[] }
export interface RecordedFrame {
  index: number; time_s: number; damaged?: boolean; clock_s?: number; seq?: number; revision?: number; detections?: Detections | null;
  world?: World | null; runs?: number[] | null; picture?: PictureHeader | null; other?: OtherResults | null;
}
export interface ComparedRow {
  team: Team | null; identity: number | null; recorded: number; other: number; both: number; elsewhere: number; apart_mm: number | null;
  why_recorded: string | null; why_other: string | null;
}
export interface ComparisonReport {
  name: string; from_s: number; to_s: number; done: number; is_done: boolean; frames: number; without_results: number; failed: number;
  fault: string | null; different: number; rows: ComparedRow[];
}
/** For the time line, in equal parts of the time: the fewest robots found in a frame, and so on. */
export interface Survey {
  done: number; robots: (number | null)[]; ball: (boolean | null)[]; different: number[];
  gaps: { from_s: number; to_s: number; missing: number }[]; events: (GroupEvent & { after_s: number })[];
  comparison: ComparisonReport | null;
}
