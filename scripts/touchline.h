/* The messages of Touchline, as they lie in shared memory.
 *
 * Made by `touchline topics --format c`; a test compares. Do not edit.
 */
#ifndef TOUCHLINE_H
#define TOUCHLINE_H

#include <stdint.h>

#ifdef __cplusplus
#define TOUCHLINE_CHECK(condition) static_assert(condition, #condition)
#else
#define TOUCHLINE_CHECK(condition) _Static_assert(condition, #condition)
#endif

/* A number that stands for none. */
#define TOUCHLINE_NONE UINT64_MAX

enum TouchlineTeam {
    TOUCHLINE_TEAM_YELLOW = 0,
    TOUCHLINE_TEAM_BLUE = 1,
};

enum TouchlineTrackStatus {
    TOUCHLINE_TRACK_STATUS_ABSENT = 0,
    TOUCHLINE_TRACK_STATUS_INITIALISED = 1,
    TOUCHLINE_TRACK_STATUS_MEASURED = 2,
    TOUCHLINE_TRACK_STATUS_COASTING = 3,
    TOUCHLINE_TRACK_STATUS_GATED = 4,
    TOUCHLINE_TRACK_STATUS_LOCATED = 5,
};

enum TouchlinePixelFormat {
    TOUCHLINE_PIXEL_FORMAT_BAYER8 = 1,
    TOUCHLINE_PIXEL_FORMAT_BAYER10 = 2,
    TOUCHLINE_PIXEL_FORMAT_BAYER12 = 3,
    TOUCHLINE_PIXEL_FORMAT_BAYER16 = 4,
    TOUCHLINE_PIXEL_FORMAT_RGB24 = 5,
    TOUCHLINE_PIXEL_FORMAT_YUYV = 6,
    TOUCHLINE_PIXEL_FORMAT_UYVY = 7,
    TOUCHLINE_PIXEL_FORMAT_NV12 = 8,
    TOUCHLINE_PIXEL_FORMAT_I420 = 9,
};

enum TouchlineBayerOrder {
    TOUCHLINE_BAYER_ORDER_RGGB = 0,
    TOUCHLINE_BAYER_ORDER_GRBG = 1,
    TOUCHLINE_BAYER_ORDER_GBRG = 2,
    TOUCHLINE_BAYER_ORDER_BGGR = 3,
};

enum TouchlineRejectReason {
    TOUCHLINE_REJECT_REASON_TOO_SMALL = 1,
    TOUCHLINE_REJECT_REASON_TOO_LARGE = 2,
    TOUCHLINE_REJECT_REASON_TOO_CLOSE_TO_TEAM_PATCH = 3,
    TOUCHLINE_REJECT_REASON_NO_IDENTIFICATION_PATCH = 4,
    TOUCHLINE_REJECT_REASON_LAYOUT_MISMATCH = 5,
    TOUCHLINE_REJECT_REASON_TAKEN_BY_ANOTHER = 6,
    TOUCHLINE_REJECT_REASON_OUTSIDE_FIELD = 7,
    TOUCHLINE_REJECT_REASON_NOT_ROUND = 8,
    TOUCHLINE_REJECT_REASON_NO_TEAM_PATCH = 9,
    TOUCHLINE_REJECT_REASON_SEARCH_CUT = 10,
    TOUCHLINE_REJECT_REASON_NOT_LOOKED_AT = 11,
};

enum TouchlineProcessKind {
    TOUCHLINE_PROCESS_KIND_GRABBER = 0,
    TOUCHLINE_PROCESS_KIND_CLASSIFIER = 1,
    TOUCHLINE_PROCESS_KIND_TRACKER = 2,
    TOUCHLINE_PROCESS_KIND_FILTER = 3,
};

enum TouchlineAttendant {
    TOUCHLINE_ATTENDANT_SUPERVISOR = 4,
    TOUCHLINE_ATTENDANT_GATEWAY = 5,
    TOUCHLINE_ATTENDANT_PUBLISHER = 6,
    TOUCHLINE_ATTENDANT_CONSOLE = 7,
};

enum TouchlineProcessState {
    TOUCHLINE_PROCESS_STATE_SPARE = 1,
    TOUCHLINE_PROCESS_STATE_ACTIVE = 2,
    TOUCHLINE_PROCESS_STATE_FINISHED = 3,
    TOUCHLINE_PROCESS_STATE_WAITING = 4,
};

enum TouchlineDropReason {
    TOUCHLINE_DROP_REASON_OUT_OF_ORDER = 0,
    TOUCHLINE_DROP_REASON_BAD_HEADER = 1,
    TOUCHLINE_DROP_REASON_WRONG_SIZE = 2,
    TOUCHLINE_DROP_REASON_WRONG_FORMAT = 3,
    TOUCHLINE_DROP_REASON_LATE = 4,
    TOUCHLINE_DROP_REASON_NOT_PUBLISHED = 5,
    TOUCHLINE_DROP_REASON_POISONOUS = 6,
    TOUCHLINE_DROP_REASON_INCOMPLETE = 7,
    TOUCHLINE_DROP_REASON_NOT_PERMITTED = 8,
};

enum TouchlineEventKind {
    TOUCHLINE_EVENT_KIND_OTHER = 0,
    TOUCHLINE_EVENT_KIND_ENDED = 1,
    TOUCHLINE_EVENT_KIND_PROMOTED = 2,
    TOUCHLINE_EVENT_KIND_STALLED = 3,
    TOUCHLINE_EVENT_KIND_KILLED = 4,
    TOUCHLINE_EVENT_KIND_RETIRED = 5,
    TOUCHLINE_EVENT_KIND_DROPPED = 6,
    TOUCHLINE_EVENT_KIND_POISONOUS = 7,
    TOUCHLINE_EVENT_KIND_TAKEN_OVER = 8,
    TOUCHLINE_EVENT_KIND_CAMERA = 9,
    TOUCHLINE_EVENT_KIND_STRANGER = 10,
    TOUCHLINE_EVENT_KIND_RECONFIGURED = 11,
    TOUCHLINE_EVENT_KIND_MARKED = 12,
};

enum TouchlineCameraState {
    TOUCHLINE_CAMERA_STATE_OPENING = 0,
    TOUCHLINE_CAMERA_STATE_STREAMING = 1,
    TOUCHLINE_CAMERA_STATE_SLOW = 2,
    TOUCHLINE_CAMERA_STATE_MISSING = 3,
    TOUCHLINE_CAMERA_STATE_NO_RIGHTS = 4,
    TOUCHLINE_CAMERA_STATE_BUSY = 5,
    TOUCHLINE_CAMERA_STATE_WRONG_FORMAT = 6,
    TOUCHLINE_CAMERA_STATE_WRONG_SETTING = 7,
    TOUCHLINE_CAMERA_STATE_HUNG = 8,
    TOUCHLINE_CAMERA_STATE_NO_LIBRARY = 9,
    TOUCHLINE_CAMERA_STATE_FAILED = 10,
};

/* Header of a raw frame; the payload is the pixels, laid out as PixelFormat says. */
typedef struct TouchlineFrameHeader {
    /* Number of the frame since the group started; a gap means frames that were never captured. */
    uint64_t seq;
    /* Middle of the exposure. */
    uint64_t t_capture_ns;
    /* The same instant on the wall clock, nanoseconds since 1970. */
    uint64_t t_capture_wall_ns;
    /* When the grabber published the frame. */
    uint64_t t_sent_ns;
    /* Which camera, counted from 0. */
    uint32_t camera_id;
    /* Pixels in a row. */
    uint32_t width;
    /* Rows. */
    uint32_t height;
    /* Bytes from the start of a row to the start of the next; in planar formats, of the first plane. */
    uint32_t stride;
    /* A PixelFormat number. */
    uint32_t pixel_format;
    /* A BayerOrder number; meaningless unless the format is a Bayer one. */
    uint32_t bayer_order;
    /* Exposure time; 0 when unknown. */
    uint32_t exposure_us;
    /* Revision of the configuration of the grabber, see Revision. */
    uint32_t revision;
} TouchlineFrameHeader;

TOUCHLINE_CHECK(sizeof(TouchlineFrameHeader) == 64);
#define TOUCHLINE_FRAME_HEADER_TYPE_NAME "touchline/FrameHeader/2"

/* Header of a list of runs. The payload always has MAX_RUNS elements, of which the first run_count are valid. */
typedef struct TouchlineRunsHeader {
    /* The frame the runs were found in. */
    TouchlineFrameHeader frame;
    /* When the classifier received the frame. */
    uint64_t t_frame_taken_ns;
    /* When the classifier published the runs. */
    uint64_t t_sent_ns;
    /* Identifies the tables the pixels were classified with: a hash of the configured colours, the gains of the light, and, where light is uneven or there is glare, of the assignment of tables to parts of the picture. Two frames of the same version had the same tables at every pixel. */
    uint64_t class_table_version;
    /* Valid elements of the payload. */
    uint32_t run_count;
    /* Bit set of OVERFLOW. */
    uint32_t flags;
    /* Revision of the classifier's configuration. */
    uint32_t revision;
    /* The first revision with the same colours: from there on class numbers have the same meaning. */
    uint32_t classes_since;
} TouchlineRunsHeader;

TOUCHLINE_CHECK(sizeof(TouchlineRunsHeader) == 104);
#define TOUCHLINE_RUNS_HEADER_TYPE_NAME "touchline/RunsHeader/3"

/* Pixels begin..end of one row, all of one class, bounded by other classes or by background. A message lists its runs by row, within a row by column. */
typedef struct TouchlineRun {
    /* Row in the image. */
    uint16_t row;
    /* First column. */
    uint16_t begin;
    /* Column after the last one. */
    uint16_t end;
    /* Colour class: index into the configured colours, 0–31. */
    uint8_t class_;
    /* Reserved, 0. */
    uint8_t reserved;
} TouchlineRun;

TOUCHLINE_CHECK(sizeof(TouchlineRun) == 8);
#define TOUCHLINE_RUN_TYPE_NAME "touchline/Run/1"

/* A robot found in this frame alone. */
typedef struct TouchlineDetectedRobot {
    /* A Team number. */
    uint32_t team;
    /* Number of the robot in its team; 4294967295 when unknown. */
    uint32_t robot_id;
    /* Centre of the robot on the field. */
    float x_mm;
    /* Centre of the robot on the field. */
    float y_mm;
    /* Heading on the field, radians, in (−π, π]. */
    float orientation;
    /* 0–1: how well the patches fit the robot's layout. */
    float confidence;
    /* Centre of the robot's top in the image. */
    float x_px;
    /* Centre of the robot's top in the image. */
    float y_px;
    /* Heading as it appears in the image: radians, 0 to the right, π/2 up. */
    float orientation_image;
    /* Valid elements of patch_regions. */
    uint32_t patch_count;
    /* For each patch of the layout in turn, the index of the region it is, or is a part of; u32::MAX when not seen. */
    uint32_t patch_regions[6];
    /* Covariance of x, y and orientation: upper triangle row by row, mm and radians (xx, xy, xθ, yy, yθ, θθ). All 0 when unknown. */
    float covariance[6];
    /* Number of raw pixel samples, at the edges of the patches, from which the pose was measured; 0 when it was computed from the centroids of the patches alone. */
    uint32_t edge_samples;
} TouchlineDetectedRobot;

TOUCHLINE_CHECK(sizeof(TouchlineDetectedRobot) == 92);

/* A ball candidate. */
typedef struct TouchlineDetectedBall {
    /* Centre of the ball on the field. */
    float x_mm;
    /* Centre of the ball on the field. */
    float y_mm;
    /* Centre of the ball in the image. */
    float x_px;
    /* Centre of the ball in the image. */
    float y_px;
    /* 0–1: how well size and shape fit a ball. */
    float confidence;
    /* Index of its region. */
    uint32_t region;
    /* Covariance of x and y: upper triangle row by row, mm². All 0 when unknown. */
    float covariance[3];
    /* Number of raw pixel samples, at the ball's rim, from which its position was measured; 0 when the position is the centroid of its region. */
    uint32_t edge_samples;
} TouchlineDetectedBall;

TOUCHLINE_CHECK(sizeof(TouchlineDetectedBall) == 40);

/* A rejected candidate and the reason. */
typedef struct TouchlineRejected {
    /* A Team number, Rejected::BALL, or Rejected::UNKNOWN_TEAM. */
    uint32_t team;
    /* A RejectReason number. */
    uint32_t reason;
    /* Centroid in the image. */
    float x_px;
    /* Centroid in the image. */
    float y_px;
} TouchlineRejected;

TOUCHLINE_CHECK(sizeof(TouchlineRejected) == 16);

/* A connected set of pixels of one class (section 5 of the paper). Its pixels are runs[first_run..first_run + run_count] of the same message. */
typedef struct TouchlineRegion {
    /* Colour class: index into the configured colours. */
    uint32_t class_;
    /* Number of pixels. */
    uint32_t pixel_count;
    /* Centroid, column. */
    float x_px;
    /* Centroid, row. */
    float y_px;
    /* Bounding box, first column. */
    uint16_t left;
    /* Bounding box, first row. */
    uint16_t top;
    /* Bounding box, last column. */
    uint16_t right;
    /* Bounding box, last row. */
    uint16_t bottom;
    /* Index of the first of its runs. */
    uint32_t first_run;
    /* Number of its runs; 0 when they did not fit (DetectionFrame::RUNS_OVERFLOW). */
    uint32_t run_count;
} TouchlineRegion;

TOUCHLINE_CHECK(sizeof(TouchlineRegion) == 32);

/* Everything the tracker found in one frame, with the reasons for rejections. */
typedef struct TouchlineDetectionFrame {
    /* The frame this was found in. */
    TouchlineFrameHeader frame;
    /* When the classifier received the frame. */
    uint64_t t_frame_taken_ns;
    /* When the classifier published its runs. */
    uint64_t t_runs_ns;
    /* When the tracker received the runs. */
    uint64_t t_runs_taken_ns;
    /* When the tracker published this message. */
    uint64_t t_sent_ns;
    /* Version of the classifier's tables, as in RunsHeader. */
    uint64_t class_table_version;
    /* Frame number of the world used as prediction; DetectionFrame::NO_WORLD for none. */
    uint64_t prior_world_seq;
    /* Revision of the classifier's configuration. */
    uint32_t classifier_revision;
    /* Revision of the tracker's configuration. */
    uint32_t revision;
    /* Bit set of the flags below. */
    uint32_t flags;
    /* Valid elements of robots. */
    uint32_t robot_count;
    /* Valid elements of balls. */
    uint32_t ball_count;
    /* Valid elements of rejected. */
    uint32_t rejected_count;
    /* Valid elements of regions. */
    uint32_t region_count;
    /* Valid elements of runs. */
    uint32_t run_count;
    /* Robots, by team and number. */
    TouchlineDetectedRobot robots[32];
    /* Ball candidates, best first. */
    TouchlineDetectedBall balls[8];
    /* Rejected candidates. */
    TouchlineRejected rejected[128];
    /* Regions, in the order in which their first pixel appears in the picture. */
    TouchlineRegion regions[1024];
    /* The pixels of the regions, region by region. */
    TouchlineRun runs[32768];
} TouchlineDetectionFrame;

TOUCHLINE_CHECK(sizeof(TouchlineDetectionFrame) == 300368);
#define TOUCHLINE_DETECTION_FRAME_TYPE_NAME "touchline/DetectionFrame/4"

/* Identifies a message on the topic commands. Every sender counts its own messages, so the time is part of the name. */
typedef struct TouchlineCommandsName {
    /* Commands::seq */
    uint64_t seq;
    /* Commands::t_sent_ns */
    uint64_t t_sent_ns;
} TouchlineCommandsName;

TOUCHLINE_CHECK(sizeof(TouchlineCommandsName) == 16);

/* One robot as estimated by the filter. */
typedef struct TouchlineRobotState {
    /* A Team number. */
    uint32_t team;
    /* Number of the robot in its team. */
    uint32_t robot_id;
    /* A TrackStatus number. */
    uint32_t status;
    /* Frames in a row without a usable measurement. */
    uint32_t frames_unseen;
    /* Frames in a row whose measurement lay outside the gate. */
    uint32_t frames_gated;
    /* 0–1: 1 when seen in this frame, falling while coasting. */
    float visibility;
    /* Centre of the robot at capture time. */
    double x_mm;
    /* Centre of the robot at capture time. */
    double y_mm;
    /* Heading at capture time, radians, in (−π, π]. */
    double orientation;
    /* Speed along the heading. */
    double v_mm_s;
    /* Turning rate, rad/s. */
    double omega;
    /* Velocity along x at capture time: v_mm_s · cos(orientation). */
    double vx_mm_s;
    /* Velocity along y at capture time: v_mm_s · sin(orientation). */
    double vy_mm_s;
    /* Covariance of (x_mm, y_mm, orientation, v_mm_s, omega), row by row. */
    double covariance[25];
    /* Position predicted to WorldFrame::t_predicted_ns. */
    double predicted_x_mm;
    /* Position predicted to WorldFrame::t_predicted_ns. */
    double predicted_y_mm;
    /* Heading predicted to WorldFrame::t_predicted_ns. */
    double predicted_orientation;
} TouchlineRobotState;

TOUCHLINE_CHECK(sizeof(TouchlineRobotState) == 304);

/* One robot of which the filter knows only the team: an opponent whose patches are not configured, or a robot that has lost a patch. It has no number in its team and no heading. */
typedef struct TouchlineUnknownRobotState {
    /* A Team number. */
    uint32_t team;
    /* Identifies the track, not the robot: from 1, constant while the robot is followed, and never reused. A robot that is lost and found again has a new one. Counting restarts when prior_world_seq is NO_WORLD. */
    uint32_t track_id;
    /* A TrackStatus number. */
    uint32_t status;
    /* Frames in a row without a usable measurement. */
    uint32_t frames_unseen;
    /* Frames since it was first seen. */
    uint32_t frames_tracked;
    /* 0–1: 1 when seen in this frame, falling while coasting. */
    float visibility;
    /* Position of its team patch at capture time. Its centre lies within the patch's distance from there. */
    double x_mm;
    /* Position of its team patch at capture time. */
    double y_mm;
    /* Velocity. */
    double vx_mm_s;
    /* Velocity. */
    double vy_mm_s;
    /* Covariance of (x_mm, y_mm, vx_mm_s, vy_mm_s) as position and velocity of the robot's centre, row by row. Most of it is the unknown direction from the patch to the centre. */
    double covariance[16];
    /* Position predicted to WorldFrame::t_predicted_ns. */
    double predicted_x_mm;
    /* Position predicted to WorldFrame::t_predicted_ns. */
    double predicted_y_mm;
} TouchlineUnknownRobotState;

TOUCHLINE_CHECK(sizeof(TouchlineUnknownRobotState) == 200);

/* The ball as estimated by the filter. */
typedef struct TouchlineBallState {
    /* A TrackStatus number. */
    uint32_t status;
    /* Frames in a row without a usable measurement. */
    uint32_t frames_unseen;
    /* Frames in a row whose measurement lay outside the gate. */
    uint32_t frames_gated;
    /* 0–1: 1 when seen in this frame, falling while coasting. */
    float visibility;
    /* Centre of the ball at capture time. */
    double x_mm;
    /* Centre of the ball at capture time. */
    double y_mm;
    /* Velocity. */
    double vx_mm_s;
    /* Velocity. */
    double vy_mm_s;
    /* Covariance of (x_mm, y_mm, vx_mm_s, vy_mm_s), row by row. */
    double covariance[16];
    /* Position predicted to WorldFrame::t_predicted_ns. */
    double predicted_x_mm;
    /* Position predicted to WorldFrame::t_predicted_ns. */
    double predicted_y_mm;
} TouchlineBallState;

TOUCHLINE_CHECK(sizeof(TouchlineBallState) == 192);

/* One hypothesis about a robot's motion, with its extended Kalman filter. */
typedef struct TouchlineRobotHypothesis {
    /* Probability; those of one robot add up to 1. */
    double probability;
    /* x_mm, y_mm, orientation, v_mm_s, omega at capture time. */
    double mean[5];
    /* Upper triangle of the covariance of mean, row by row. */
    double covariance[15];
} TouchlineRobotHypothesis;

TOUCHLINE_CHECK(sizeof(TouchlineRobotHypothesis) == 168);

/* A command that acts or will act on a robot. */
typedef struct TouchlineQueuedCommand {
    /* When it was sent to the robot. */
    uint64_t t_sent_ns;
    /* Circumferential speed of the left wheel. */
    double left_mm_s;
    /* Circumferential speed of the right wheel. */
    double right_mm_s;
} TouchlineQueuedCommand;

TOUCHLINE_CHECK(sizeof(TouchlineQueuedCommand) == 24);

/* State besides RobotState with which a successor of the filter continues a robot's track exactly. Only the filter reads it. */
typedef struct TouchlineRobotMemory {
    /* In this order: steered, free, struck. */
    TouchlineRobotHypothesis hypotheses[3];
    /* Capture time of the newest measurement used. */
    uint64_t t_seen_ns;
    /* Capture time of the newest measurement outside the gate. */
    uint64_t t_gated_ns;
    /* The newest measurement outside the gate: x_mm, y_mm, orientation. */
    double gated_pose[3];
    /* Number of consecutive measurements outside the gate, up to that one, that agree with one another. */
    uint32_t gated_agreeing;
    /* Valid elements of commands. */
    uint32_t command_count;
    /* Commands that act or will act, by time. */
    TouchlineQueuedCommand commands[12];
} TouchlineRobotMemory;

TOUCHLINE_CHECK(sizeof(TouchlineRobotMemory) == 840);

/* One hypothesis about the ball's motion, with its Kalman filter. */
typedef struct TouchlineBallHypothesis {
    /* Probability; the two add up to 1. */
    double probability;
    /* x_mm, y_mm, vx_mm_s, vy_mm_s at capture time. */
    double mean[4];
    /* Upper triangle of the covariance of mean, row by row. */
    double covariance[10];
} TouchlineBallHypothesis;

TOUCHLINE_CHECK(sizeof(TouchlineBallHypothesis) == 120);

/* State besides BallState with which a successor of the filter continues the ball's track exactly. */
typedef struct TouchlineBallMemory {
    /* In this order: rolling, struck. */
    TouchlineBallHypothesis hypotheses[2];
    /* Capture time of the newest measurement used. */
    uint64_t t_seen_ns;
    /* Capture time of the newest measurement outside the gate. */
    uint64_t t_gated_ns;
    /* The newest measurement outside the gate: x_mm, y_mm. */
    double gated_position[2];
    /* Number of consecutive measurements outside the gate, up to that one, that agree with one another. */
    uint32_t gated_agreeing;
    /* Reserved, 0. */
    uint32_t reserved;
} TouchlineBallMemory;

TOUCHLINE_CHECK(sizeof(TouchlineBallMemory) == 280);

/* One hypothesis about such a robot's motion, with its Kalman filter. */
typedef struct TouchlineUnknownRobotHypothesis {
    /* Probability; the two add up to 1. */
    double probability;
    /* x_mm, y_mm, vx_mm_s, vy_mm_s of its team patch at capture time. */
    double mean[4];
    /* Upper triangle of the covariance of mean, row by row. */
    double covariance[10];
} TouchlineUnknownRobotHypothesis;

TOUCHLINE_CHECK(sizeof(TouchlineUnknownRobotHypothesis) == 120);

/* State with which a successor of the filter continues such a robot's track exactly. Only the filter reads it. */
typedef struct TouchlineUnknownRobotMemory {
    /* A Team number. */
    uint32_t team;
    /* The track_id of UnknownRobotState; 0 for a candidate that has not been seen often enough. */
    uint32_t track_id;
    /* A TrackStatus number. */
    uint32_t status;
    /* Frames in a row without a usable measurement. */
    uint32_t frames_unseen;
    /* Frames since it was first seen. */
    uint32_t frames_tracked;
    /* Reserved, 0. */
    uint32_t reserved;
    /* Capture time of the newest measurement. */
    uint64_t t_seen_ns;
    /* In this order: driving freely, struck. */
    TouchlineUnknownRobotHypothesis hypotheses[2];
} TouchlineUnknownRobotMemory;

TOUCHLINE_CHECK(sizeof(TouchlineUnknownRobotMemory) == 272);

/* The filtered state of the match after one frame. A restarted filter continues from the last world, with the same results as one that never stopped. */
typedef struct TouchlineWorldFrame {
    /* The frame this belongs to. */
    TouchlineFrameHeader frame;
    /* When the classifier received the frame. */
    uint64_t t_frame_taken_ns;
    /* When the classifier published the runs. */
    uint64_t t_runs_ns;
    /* When the tracker received the runs. */
    uint64_t t_runs_taken_ns;
    /* When the tracker published the detections. */
    uint64_t t_detections_ns;
    /* When the filter received the detections. */
    uint64_t t_detections_taken_ns;
    /* When the filter published this message. */
    uint64_t t_sent_ns;
    /* Time of the predicted poses: when a command sent now will act. */
    uint64_t t_predicted_ns;
    /* Frame number of the world whose tracks were continued; WorldFrame::NO_WORLD for a filter that started from nothing. */
    uint64_t prior_world_seq;
    /* Number of the newest commands message ever used; WorldFrame::NO_COMMANDS for none. */
    uint64_t commands_seq;
    /* Valid elements of robots. */
    uint32_t robot_count;
    /* Valid elements of commands. */
    uint32_t command_count;
    /* Valid elements of unknown_robots. */
    uint32_t unknown_robot_count;
    /* Valid elements of unknown_robot_memories: unknown_robots and further candidates. */
    uint32_t unknown_memory_count;
    /* The last UnknownRobotState::track_id assigned. */
    uint32_t last_track_id;
    /* Revision of the classifier's configuration. */
    uint32_t classifier_revision;
    /* Revision of the tracker's configuration. */
    uint32_t tracker_revision;
    /* Revision of the filter's configuration. */
    uint32_t revision;
    /* The commands messages used since the prior world, in that order. From these, the prior world and the detections of the frame this message can be computed again. */
    TouchlineCommandsName commands[32];
    /* Tracked robots, by team and number. */
    TouchlineRobotState robots[32];
    /* Tracked robots of which only the team is known, by team and track. None of them is among robots. */
    TouchlineUnknownRobotState unknown_robots[32];
    /* The ball. */
    TouchlineBallState ball;
    /* For the filter's successor: one element for each of robots, in the same order. */
    TouchlineRobotMemory robot_memories[32];
    /* For the filter's successor. */
    TouchlineBallMemory ball_memory;
    /* For the filter's successor: one element for each of unknown_robots, in the same order, then candidates that have not been seen often enough. */
    TouchlineUnknownRobotMemory unknown_robot_memories[32];
} TouchlineWorldFrame;

TOUCHLINE_CHECK(sizeof(TouchlineWorldFrame) == 52864);
#define TOUCHLINE_WORLD_FRAME_TYPE_NAME "touchline/WorldFrame/5"

/* Reference speeds of one robot's wheels (v_L,ref and v_R,ref of eq. 11). */
typedef struct TouchlineWheelCommand {
    /* A Team number. */
    uint32_t team;
    /* Number of the robot in its team. */
    uint32_t robot_id;
    /* Circumferential speed of the left wheel. */
    double left_mm_s;
    /* Circumferential speed of the right wheel. */
    double right_mm_s;
} TouchlineWheelCommand;

TOUCHLINE_CHECK(sizeof(TouchlineWheelCommand) == 24);

/* The speeds a strategy has just sent. If several senders command a robot, the command sent last (t_sent_ns) acts, whatever its sender. A robot that is not listed keeps its last command until the filter forgets it (filter.command_timeout_ms). */
typedef struct TouchlineCommands {
    /* Sequence number of the sender. */
    uint64_t seq;
    /* When the commands went out to the robots. */
    uint64_t t_sent_ns;
    /* Valid elements of wheels. */
    uint32_t wheel_count;
    /* User id of the sender, filled in by the gateway; 0 from programs that publish themselves. */
    uint32_t user;
    /* One element per robot. */
    TouchlineWheelCommand wheels[32];
} TouchlineCommands;

TOUCHLINE_CHECK(sizeof(TouchlineCommands) == 792);
#define TOUCHLINE_COMMANDS_TYPE_NAME "touchline/Commands/2"

/* True pose and speed of one robot. */
typedef struct TouchlineTruthRobot {
    /* A Team number. */
    uint32_t team;
    /* Number of the robot in its team. */
    uint32_t robot_id;
    /* Centre of the robot in the middle of the exposure. */
    double x_mm;
    /* Centre of the robot in the middle of the exposure. */
    double y_mm;
    /* Heading in the middle of the exposure, radians, in (−π, π]. */
    double orientation;
    /* Speed along the heading. */
    double v_mm_s;
    /* Turning rate, rad/s. */
    double omega;
    /* Number of frames up to this one in which it has not moved at all. */
    uint32_t frames_still;
    /* 1 when its whole top is inside the picture and nothing hides it. */
    uint32_t visible;
} TouchlineTruthRobot;

TOUCHLINE_CHECK(sizeof(TouchlineTruthRobot) == 56);

/* The true state of the synthetic match in one frame. */
typedef struct TouchlineTruthFrame {
    /* The frame this belongs to. */
    uint64_t seq;
    /* Middle of the exposure of that frame. */
    uint64_t t_capture_ns;
    /* Valid elements of robots. */
    uint32_t robot_count;
    /* 1 when the ball is in the picture and nothing hides it. */
    uint32_t ball_visible;
    /* Centre of the ball. */
    double ball_x_mm;
    /* Centre of the ball. */
    double ball_y_mm;
    /* Velocity of the ball. */
    double ball_vx_mm_s;
    /* Velocity of the ball. */
    double ball_vy_mm_s;
    /* All robots, by team and number. */
    TouchlineTruthRobot robots[32];
} TouchlineTruthFrame;

TOUCHLINE_CHECK(sizeof(TouchlineTruthFrame) == 1848);
#define TOUCHLINE_TRUTH_FRAME_TYPE_NAME "touchline/TruthFrame/1"

/* Published by a grabber with a real camera, at every change and several times a second. */
typedef struct TouchlineCameraReport {
    /* Time of publication. */
    uint64_t t_sent_ns;
    /* Frames dropped because parts of them were missing or damaged. */
    uint64_t incomplete;
    /* Frames the camera captured but of which nothing arrived. */
    uint64_t lost;
    /* Number of starts; more than one means that the camera was away. */
    uint64_t starts;
    /* A CameraState number. */
    uint32_t state;
    /* Which camera, counted from 0. */
    uint32_t camera_id;
    /* Frames a second promised by the camera or its driver; 0 when unknown. */
    float promised_fps;
    /* Frames a second that arrived complete; 0 when not measured yet. */
    float delivered_fps;
    /* Frame source, as named on the command line: UTF-8, ended by a zero. */
    uint8_t device[96];
    /* Model, format and transfer, in the same form. */
    uint8_t description[160];
    /* Problem and remedy, in the same form; empty when there is none. */
    uint8_t problem[384];
} TouchlineCameraReport;

TOUCHLINE_CHECK(sizeof(TouchlineCameraReport) == 688);
#define TOUCHLINE_CAMERA_REPORT_TYPE_NAME "touchline/CameraReport/1"

/* One published protocol. Counters start with the publisher's process. */
typedef struct TouchlineOutputReport {
    /* Key of its section in [publish]: UTF-8, ended by a zero. */
    uint8_t name[16];
    /* Packets handed to the system, counted for each receiver and interface. */
    uint64_t sent;
    /* Packets that the system refused, or for which there was no interface. */
    uint64_t failed;
    /* Packets larger than one Ethernet frame. */
    uint64_t large;
    /* Problem and remedy, in the form of the name; empty when there is none. */
    uint8_t problem[248];
} TouchlineOutputReport;

TOUCHLINE_CHECK(sizeof(TouchlineOutputReport) == 288);

/* Published by the publisher several times a second. */
typedef struct TouchlinePublisherReport {
    /* Time of publication. */
    uint64_t t_sent_ns;
    /* Packets with commands that were passed on. */
    uint64_t commands;
    /* Packets to the command port that were malformed or impossible. */
    uint64_t malformed;
    /* Packets to the command port from addresses that are not allowed. */
    uint64_t not_allowed;
    /* Packets to the command port beyond the permitted rate. */
    uint64_t too_many;
    /* Valid elements of outputs. */
    uint32_t output_count;
    /* Other publishers on the same addresses at the moment. */
    uint32_t rivals;
    /* Published protocols. */
    TouchlineOutputReport outputs[8];
    /* Problem that is not that of one protocol: UTF-8, ended by a zero; empty when there is none. */
    uint8_t problem[256];
} TouchlinePublisherReport;

TOUCHLINE_CHECK(sizeof(TouchlinePublisherReport) == 2608);
#define TOUCHLINE_PUBLISHER_REPORT_TYPE_NAME "touchline/PublisherReport/1"

/* Published by every process about ten times a second and at every change of state. Counters start at zero with the process. The supervisor's frame counters are 0. The gateway's input is world, and each copy sent to a client counts as one output; the publisher's is world or detections, and each packet counts. */
typedef struct TouchlineHeartbeat {
    /* Time of publication. */
    uint64_t t_sent_ns;
    /* Process id. */
    uint32_t pid;
    /* A ProcessKind or Attendant number. */
    uint32_t process;
    /* A ProcessState number. */
    uint32_t state;
    /* [Revision](super::Revision) of the configuration it runs with. */
    uint32_t revision;
    /* Newest frame number received; u64::MAX before the first. */
    uint64_t seq_in;
    /* Newest frame number published; u64::MAX before the first. */
    uint64_t seq_out;
    /* Inputs received. */
    uint64_t frames_in;
    /* Outputs published. */
    uint64_t frames_out;
    /* Frame numbers that never reached this process (gaps in its input). Gateway: outputs that did not reach a client because it was too slow. Publisher: packets that were refused. */
    uint64_t frames_missed;
    /* Inputs dropped, by DropReason. Gateway and publisher: dropped messages of clients. */
    uint64_t dropped[9];
} TouchlineHeartbeat;

TOUCHLINE_CHECK(sizeof(TouchlineHeartbeat) == 136);
#define TOUCHLINE_HEARTBEAT_TYPE_NAME "touchline/Heartbeat/6"

/* Correction of the light in the frame the classifier processed last. Each channel of a pixel is multiplied by a gain before its colour is looked up, so that the pitch looks as it did when the colours were set. */
typedef struct TouchlineLightCorrection {
    /* Gains of red, green and blue in the middle of the pitch; 1 changes nothing. */
    float gains[3];
    /* Bit set of FOLLOWED, AT_BOUND, PITCH_UNSEEN and GLARE. */
    uint32_t flags;
    /* Smallest and largest additional gain of all channels over the zones of the pitch; both 1 where light is taken to be even. */
    float zones[2];
    /* Number of frames in which the gains changed since the process started. */
    uint64_t changes;
} TouchlineLightCorrection;

TOUCHLINE_CHECK(sizeof(TouchlineLightCorrection) == 32);

/* The classifier's report on the light, some ten times a second while it works. */
typedef struct TouchlineLightReport {
    /* Time of publication. */
    uint64_t t_sent_ns;
    /* Number of the frame that was corrected. */
    uint64_t seq;
    /* The correction. */
    TouchlineLightCorrection correction;
} TouchlineLightReport;

TOUCHLINE_CHECK(sizeof(TouchlineLightReport) == 48);
#define TOUCHLINE_LIGHT_REPORT_TYPE_NAME "touchline/LightReport/1"

/* The gateway's clients and what became of messages, some ten times a second and whenever a client comes or goes. Counts start at zero with the process. */
typedef struct TouchlineGatewayReport {
    /* Time of publication. */
    uint64_t t_sent_ns;
    /* Messages given to clients. */
    uint64_t given;
    /* Messages that did not reach a client because it was too slow. */
    uint64_t lost;
    /* Messages of clients for teams that they may not command. */
    uint64_t not_permitted;
    /* Dropped messages of clients, those included. */
    uint64_t refused;
    /* Process id. */
    uint32_t pid;
    /* Attached clients. */
    uint32_t clients;
} TouchlineGatewayReport;

TOUCHLINE_CHECK(sizeof(TouchlineGatewayReport) == 48);
#define TOUCHLINE_GATEWAY_REPORT_TYPE_NAME "touchline/GatewayReport/1"

/* Published when the supervisor notices or does something: a process ended, was replaced, killed or promoted; inputs were dropped. The log and the status say the same. */
typedef struct TouchlineGroupEvent {
    /* Time of the event, nanoseconds since 1970. */
    uint64_t t_wall_ns;
    /* Number of the event since this supervisor started; the first is 1. */
    uint64_t number;
    /* Process id of the process concerned; 0 when the event concerns the whole stage. */
    uint32_t pid;
    /* Process concerned, a ProcessKind or Attendant number. */
    uint32_t process;
    /* An EventKind number. */
    uint32_t kind;
    /* Reserved, 0. */
    uint32_t reserved;
    /* Description: UTF-8, ended by a zero. */
    uint8_t what[224];
    /* The last lines written by a process that ended, in the same form. A longer text is cut at its beginning. */
    uint8_t evidence[768];
} TouchlineGroupEvent;

TOUCHLINE_CHECK(sizeof(TouchlineGroupEvent) == 1024);
#define TOUCHLINE_GROUP_EVENT_TYPE_NAME "touchline/GroupEvent/2"

/* Header of the group's status, which is JSON text in the first bytes of the payload. */
typedef struct TouchlineStatusHeader {
    /* Time of publication. */
    uint64_t t_sent_ns;
    /* Length of the text. */
    uint64_t bytes;
} TouchlineStatusHeader;

TOUCHLINE_CHECK(sizeof(TouchlineStatusHeader) == 16);
#define TOUCHLINE_STATUS_HEADER_TYPE_NAME "touchline/StatusHeader/1"

/* Topics: name, element, header. A message is a slice of elements.
 * frames       u8                           touchline/FrameHeader/2
 * runs         touchline/Run/1              touchline/RunsHeader/3
 * detections   touchline/DetectionFrame/4   ()
 * world        touchline/WorldFrame/5       ()
 * commands     touchline/Commands/2         ()
 * truth        touchline/TruthFrame/1       ()
 * camera       touchline/CameraReport/1     ()
 * publisher    touchline/PublisherReport/1  ()
 * health       touchline/Heartbeat/6        ()
 * light        touchline/LightReport/1      ()
 * gateway      touchline/GatewayReport/1    ()
 * events       touchline/GroupEvent/2       ()
 * status       u8                           touchline/StatusHeader/1
 */

#endif
