"""The messages of Touchline, as they lie in shared memory.

Made by `touchline topics --format python`; a test compares. Do not edit.
"""

import ctypes
import enum
from typing import NamedTuple


class Team(enum.IntEnum):
    YELLOW = 0
    BLUE = 1


class TrackStatus(enum.IntEnum):
    ABSENT = 0
    INITIALISED = 1
    MEASURED = 2
    COASTING = 3
    GATED = 4
    LOCATED = 5


class PixelFormat(enum.IntEnum):
    BAYER8 = 1
    BAYER10 = 2
    BAYER12 = 3
    BAYER16 = 4
    RGB24 = 5
    YUYV = 6
    UYVY = 7
    NV12 = 8
    I420 = 9


class BayerOrder(enum.IntEnum):
    RGGB = 0
    GRBG = 1
    GBRG = 2
    BGGR = 3


class RejectReason(enum.IntEnum):
    TOO_SMALL = 1
    TOO_LARGE = 2
    TOO_CLOSE_TO_TEAM_PATCH = 3
    NO_IDENTIFICATION_PATCH = 4
    LAYOUT_MISMATCH = 5
    TAKEN_BY_ANOTHER = 6
    OUTSIDE_FIELD = 7
    NOT_ROUND = 8
    NO_TEAM_PATCH = 9
    SEARCH_CUT = 10
    NOT_LOOKED_AT = 11


class ProcessKind(enum.IntEnum):
    GRABBER = 0
    CLASSIFIER = 1
    TRACKER = 2
    FILTER = 3


class Attendant(enum.IntEnum):
    SUPERVISOR = 4
    GATEWAY = 5
    PUBLISHER = 6
    CONSOLE = 7


class ProcessState(enum.IntEnum):
    SPARE = 1
    ACTIVE = 2
    FINISHED = 3
    WAITING = 4


class DropReason(enum.IntEnum):
    OUT_OF_ORDER = 0
    BAD_HEADER = 1
    WRONG_SIZE = 2
    WRONG_FORMAT = 3
    LATE = 4
    NOT_PUBLISHED = 5
    POISONOUS = 6
    INCOMPLETE = 7
    NOT_PERMITTED = 8


class EventKind(enum.IntEnum):
    OTHER = 0
    ENDED = 1
    PROMOTED = 2
    STALLED = 3
    KILLED = 4
    RETIRED = 5
    DROPPED = 6
    POISONOUS = 7
    TAKEN_OVER = 8
    CAMERA = 9
    STRANGER = 10
    RECONFIGURED = 11
    MARKED = 12


class CameraState(enum.IntEnum):
    OPENING = 0
    STREAMING = 1
    SLOW = 2
    MISSING = 3
    NO_RIGHTS = 4
    BUSY = 5
    WRONG_FORMAT = 6
    WRONG_SETTING = 7
    HUNG = 8
    NO_LIBRARY = 9
    FAILED = 10


NONE = 18446744073709551615 # a number that stands for none


class FrameHeader(ctypes.Structure):
    """Header of a raw frame; the payload is the pixels, laid out as PixelFormat says."""

    _fields_ = [
        ("seq", ctypes.c_uint64),
        ("t_capture_ns", ctypes.c_uint64),
        ("t_capture_wall_ns", ctypes.c_uint64),
        ("t_sent_ns", ctypes.c_uint64),
        ("camera_id", ctypes.c_uint32),
        ("width", ctypes.c_uint32),
        ("height", ctypes.c_uint32),
        ("stride", ctypes.c_uint32),
        ("pixel_format", ctypes.c_uint32),
        ("bayer_order", ctypes.c_uint32),
        ("exposure_us", ctypes.c_uint32),
        ("revision", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name():
        return "touchline/FrameHeader/2"


assert ctypes.sizeof(FrameHeader) == 64


class RunsHeader(ctypes.Structure):
    """Header of a list of runs. The payload always has MAX_RUNS elements, of which the first run_count are valid."""

    _fields_ = [
        ("frame", FrameHeader),
        ("t_frame_taken_ns", ctypes.c_uint64),
        ("t_sent_ns", ctypes.c_uint64),
        ("class_table_version", ctypes.c_uint64),
        ("run_count", ctypes.c_uint32),
        ("flags", ctypes.c_uint32),
        ("revision", ctypes.c_uint32),
        ("classes_since", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name():
        return "touchline/RunsHeader/3"


assert ctypes.sizeof(RunsHeader) == 104


class Run(ctypes.Structure):
    """Pixels begin..end of one row, all of one class, bounded by other classes or by background. A message lists its runs by row, within a row by column."""

    _fields_ = [
        ("row", ctypes.c_uint16),
        ("begin", ctypes.c_uint16),
        ("end", ctypes.c_uint16),
        ("class_", ctypes.c_uint8),
        ("reserved", ctypes.c_uint8),
    ]

    @staticmethod
    def type_name():
        return "touchline/Run/1"


assert ctypes.sizeof(Run) == 8


class DetectedRobot(ctypes.Structure):
    """A robot found in this frame alone."""

    _fields_ = [
        ("team", ctypes.c_uint32),
        ("robot_id", ctypes.c_uint32),
        ("x_mm", ctypes.c_float),
        ("y_mm", ctypes.c_float),
        ("orientation", ctypes.c_float),
        ("confidence", ctypes.c_float),
        ("x_px", ctypes.c_float),
        ("y_px", ctypes.c_float),
        ("orientation_image", ctypes.c_float),
        ("patch_count", ctypes.c_uint32),
        ("patch_regions", ctypes.c_uint32 * 6),
        ("covariance", ctypes.c_float * 6),
        ("edge_samples", ctypes.c_uint32),
    ]


assert ctypes.sizeof(DetectedRobot) == 92


class DetectedBall(ctypes.Structure):
    """A ball candidate."""

    _fields_ = [
        ("x_mm", ctypes.c_float),
        ("y_mm", ctypes.c_float),
        ("x_px", ctypes.c_float),
        ("y_px", ctypes.c_float),
        ("confidence", ctypes.c_float),
        ("region", ctypes.c_uint32),
        ("covariance", ctypes.c_float * 3),
        ("edge_samples", ctypes.c_uint32),
    ]


assert ctypes.sizeof(DetectedBall) == 40


class Rejected(ctypes.Structure):
    """A rejected candidate and the reason."""

    _fields_ = [
        ("team", ctypes.c_uint32),
        ("reason", ctypes.c_uint32),
        ("x_px", ctypes.c_float),
        ("y_px", ctypes.c_float),
    ]


assert ctypes.sizeof(Rejected) == 16


class Region(ctypes.Structure):
    """A connected set of pixels of one class (section 5 of the paper). Its pixels are runs[first_run..first_run + run_count] of the same message."""

    _fields_ = [
        ("class_", ctypes.c_uint32),
        ("pixel_count", ctypes.c_uint32),
        ("x_px", ctypes.c_float),
        ("y_px", ctypes.c_float),
        ("left", ctypes.c_uint16),
        ("top", ctypes.c_uint16),
        ("right", ctypes.c_uint16),
        ("bottom", ctypes.c_uint16),
        ("first_run", ctypes.c_uint32),
        ("run_count", ctypes.c_uint32),
    ]


assert ctypes.sizeof(Region) == 32


class DetectionFrame(ctypes.Structure):
    """Everything the tracker found in one frame, with the reasons for rejections."""

    _fields_ = [
        ("frame", FrameHeader),
        ("t_frame_taken_ns", ctypes.c_uint64),
        ("t_runs_ns", ctypes.c_uint64),
        ("t_runs_taken_ns", ctypes.c_uint64),
        ("t_sent_ns", ctypes.c_uint64),
        ("class_table_version", ctypes.c_uint64),
        ("prior_world_seq", ctypes.c_uint64),
        ("classifier_revision", ctypes.c_uint32),
        ("revision", ctypes.c_uint32),
        ("flags", ctypes.c_uint32),
        ("robot_count", ctypes.c_uint32),
        ("ball_count", ctypes.c_uint32),
        ("rejected_count", ctypes.c_uint32),
        ("region_count", ctypes.c_uint32),
        ("run_count", ctypes.c_uint32),
        ("robots", DetectedRobot * 32),
        ("balls", DetectedBall * 8),
        ("rejected", Rejected * 128),
        ("regions", Region * 1024),
        ("runs", Run * 32768),
    ]

    @staticmethod
    def type_name():
        return "touchline/DetectionFrame/4"


assert ctypes.sizeof(DetectionFrame) == 300368


class CommandsName(ctypes.Structure):
    """Identifies a message on the topic commands. Every sender counts its own messages, so the time is part of the name."""

    _fields_ = [
        ("seq", ctypes.c_uint64),
        ("t_sent_ns", ctypes.c_uint64),
    ]


assert ctypes.sizeof(CommandsName) == 16


class RobotState(ctypes.Structure):
    """One robot as estimated by the filter."""

    _fields_ = [
        ("team", ctypes.c_uint32),
        ("robot_id", ctypes.c_uint32),
        ("status", ctypes.c_uint32),
        ("frames_unseen", ctypes.c_uint32),
        ("frames_gated", ctypes.c_uint32),
        ("visibility", ctypes.c_float),
        ("x_mm", ctypes.c_double),
        ("y_mm", ctypes.c_double),
        ("orientation", ctypes.c_double),
        ("v_mm_s", ctypes.c_double),
        ("omega", ctypes.c_double),
        ("vx_mm_s", ctypes.c_double),
        ("vy_mm_s", ctypes.c_double),
        ("covariance", ctypes.c_double * 25),
        ("predicted_x_mm", ctypes.c_double),
        ("predicted_y_mm", ctypes.c_double),
        ("predicted_orientation", ctypes.c_double),
    ]


assert ctypes.sizeof(RobotState) == 304


class UnknownRobotState(ctypes.Structure):
    """One robot of which the filter knows only the team: an opponent whose patches are not configured, or a robot that has lost a patch. It has no number in its team and no heading."""

    _fields_ = [
        ("team", ctypes.c_uint32),
        ("track_id", ctypes.c_uint32),
        ("status", ctypes.c_uint32),
        ("frames_unseen", ctypes.c_uint32),
        ("frames_tracked", ctypes.c_uint32),
        ("visibility", ctypes.c_float),
        ("x_mm", ctypes.c_double),
        ("y_mm", ctypes.c_double),
        ("vx_mm_s", ctypes.c_double),
        ("vy_mm_s", ctypes.c_double),
        ("covariance", ctypes.c_double * 16),
        ("predicted_x_mm", ctypes.c_double),
        ("predicted_y_mm", ctypes.c_double),
    ]


assert ctypes.sizeof(UnknownRobotState) == 200


class BallState(ctypes.Structure):
    """The ball as estimated by the filter."""

    _fields_ = [
        ("status", ctypes.c_uint32),
        ("frames_unseen", ctypes.c_uint32),
        ("frames_gated", ctypes.c_uint32),
        ("visibility", ctypes.c_float),
        ("x_mm", ctypes.c_double),
        ("y_mm", ctypes.c_double),
        ("vx_mm_s", ctypes.c_double),
        ("vy_mm_s", ctypes.c_double),
        ("covariance", ctypes.c_double * 16),
        ("predicted_x_mm", ctypes.c_double),
        ("predicted_y_mm", ctypes.c_double),
    ]


assert ctypes.sizeof(BallState) == 192


class RobotHypothesis(ctypes.Structure):
    """One hypothesis about a robot's motion, with its extended Kalman filter."""

    _fields_ = [
        ("probability", ctypes.c_double),
        ("mean", ctypes.c_double * 5),
        ("covariance", ctypes.c_double * 15),
    ]


assert ctypes.sizeof(RobotHypothesis) == 168


class QueuedCommand(ctypes.Structure):
    """A command that acts or will act on a robot."""

    _fields_ = [
        ("t_sent_ns", ctypes.c_uint64),
        ("left_mm_s", ctypes.c_double),
        ("right_mm_s", ctypes.c_double),
    ]


assert ctypes.sizeof(QueuedCommand) == 24


class RobotMemory(ctypes.Structure):
    """State besides RobotState with which a successor of the filter continues a robot's track exactly. Only the filter reads it."""

    _fields_ = [
        ("hypotheses", RobotHypothesis * 3),
        ("t_seen_ns", ctypes.c_uint64),
        ("t_gated_ns", ctypes.c_uint64),
        ("gated_pose", ctypes.c_double * 3),
        ("gated_agreeing", ctypes.c_uint32),
        ("command_count", ctypes.c_uint32),
        ("commands", QueuedCommand * 12),
    ]


assert ctypes.sizeof(RobotMemory) == 840


class BallHypothesis(ctypes.Structure):
    """One hypothesis about the ball's motion, with its Kalman filter."""

    _fields_ = [
        ("probability", ctypes.c_double),
        ("mean", ctypes.c_double * 4),
        ("covariance", ctypes.c_double * 10),
    ]


assert ctypes.sizeof(BallHypothesis) == 120


class BallMemory(ctypes.Structure):
    """State besides BallState with which a successor of the filter continues the ball's track exactly."""

    _fields_ = [
        ("hypotheses", BallHypothesis * 2),
        ("t_seen_ns", ctypes.c_uint64),
        ("t_gated_ns", ctypes.c_uint64),
        ("gated_position", ctypes.c_double * 2),
        ("gated_agreeing", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
    ]


assert ctypes.sizeof(BallMemory) == 280


class UnknownRobotHypothesis(ctypes.Structure):
    """One hypothesis about such a robot's motion, with its Kalman filter."""

    _fields_ = [
        ("probability", ctypes.c_double),
        ("mean", ctypes.c_double * 4),
        ("covariance", ctypes.c_double * 10),
    ]


assert ctypes.sizeof(UnknownRobotHypothesis) == 120


class UnknownRobotMemory(ctypes.Structure):
    """State with which a successor of the filter continues such a robot's track exactly. Only the filter reads it."""

    _fields_ = [
        ("team", ctypes.c_uint32),
        ("track_id", ctypes.c_uint32),
        ("status", ctypes.c_uint32),
        ("frames_unseen", ctypes.c_uint32),
        ("frames_tracked", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
        ("t_seen_ns", ctypes.c_uint64),
        ("hypotheses", UnknownRobotHypothesis * 2),
    ]


assert ctypes.sizeof(UnknownRobotMemory) == 272


class WorldFrame(ctypes.Structure):
    """The filtered state of the match after one frame. A restarted filter continues from the last world, with the same results as one that never stopped."""

    _fields_ = [
        ("frame", FrameHeader),
        ("t_frame_taken_ns", ctypes.c_uint64),
        ("t_runs_ns", ctypes.c_uint64),
        ("t_runs_taken_ns", ctypes.c_uint64),
        ("t_detections_ns", ctypes.c_uint64),
        ("t_detections_taken_ns", ctypes.c_uint64),
        ("t_sent_ns", ctypes.c_uint64),
        ("t_predicted_ns", ctypes.c_uint64),
        ("prior_world_seq", ctypes.c_uint64),
        ("commands_seq", ctypes.c_uint64),
        ("robot_count", ctypes.c_uint32),
        ("command_count", ctypes.c_uint32),
        ("unknown_robot_count", ctypes.c_uint32),
        ("unknown_memory_count", ctypes.c_uint32),
        ("last_track_id", ctypes.c_uint32),
        ("classifier_revision", ctypes.c_uint32),
        ("tracker_revision", ctypes.c_uint32),
        ("revision", ctypes.c_uint32),
        ("commands", CommandsName * 32),
        ("robots", RobotState * 32),
        ("unknown_robots", UnknownRobotState * 32),
        ("ball", BallState),
        ("robot_memories", RobotMemory * 32),
        ("ball_memory", BallMemory),
        ("unknown_robot_memories", UnknownRobotMemory * 32),
    ]

    @staticmethod
    def type_name():
        return "touchline/WorldFrame/5"


assert ctypes.sizeof(WorldFrame) == 52864


class WheelCommand(ctypes.Structure):
    """Reference speeds of one robot's wheels (v_L,ref and v_R,ref of eq. 11)."""

    _fields_ = [
        ("team", ctypes.c_uint32),
        ("robot_id", ctypes.c_uint32),
        ("left_mm_s", ctypes.c_double),
        ("right_mm_s", ctypes.c_double),
    ]


assert ctypes.sizeof(WheelCommand) == 24


class Commands(ctypes.Structure):
    """The speeds a strategy has just sent. If several senders command a robot, the command sent last (t_sent_ns) acts, whatever its sender. A robot that is not listed keeps its last command until the filter forgets it (filter.command_timeout_ms)."""

    _fields_ = [
        ("seq", ctypes.c_uint64),
        ("t_sent_ns", ctypes.c_uint64),
        ("wheel_count", ctypes.c_uint32),
        ("user", ctypes.c_uint32),
        ("wheels", WheelCommand * 32),
    ]

    @staticmethod
    def type_name():
        return "touchline/Commands/2"


assert ctypes.sizeof(Commands) == 792


class TruthRobot(ctypes.Structure):
    """True pose and speed of one robot."""

    _fields_ = [
        ("team", ctypes.c_uint32),
        ("robot_id", ctypes.c_uint32),
        ("x_mm", ctypes.c_double),
        ("y_mm", ctypes.c_double),
        ("orientation", ctypes.c_double),
        ("v_mm_s", ctypes.c_double),
        ("omega", ctypes.c_double),
        ("frames_still", ctypes.c_uint32),
        ("visible", ctypes.c_uint32),
    ]


assert ctypes.sizeof(TruthRobot) == 56


class TruthFrame(ctypes.Structure):
    """The true state of the synthetic match in one frame."""

    _fields_ = [
        ("seq", ctypes.c_uint64),
        ("t_capture_ns", ctypes.c_uint64),
        ("robot_count", ctypes.c_uint32),
        ("ball_visible", ctypes.c_uint32),
        ("ball_x_mm", ctypes.c_double),
        ("ball_y_mm", ctypes.c_double),
        ("ball_vx_mm_s", ctypes.c_double),
        ("ball_vy_mm_s", ctypes.c_double),
        ("robots", TruthRobot * 32),
    ]

    @staticmethod
    def type_name():
        return "touchline/TruthFrame/1"


assert ctypes.sizeof(TruthFrame) == 1848


class CameraReport(ctypes.Structure):
    """Published by a grabber with a real camera, at every change and several times a second."""

    _fields_ = [
        ("t_sent_ns", ctypes.c_uint64),
        ("incomplete", ctypes.c_uint64),
        ("lost", ctypes.c_uint64),
        ("starts", ctypes.c_uint64),
        ("state", ctypes.c_uint32),
        ("camera_id", ctypes.c_uint32),
        ("promised_fps", ctypes.c_float),
        ("delivered_fps", ctypes.c_float),
        ("device", ctypes.c_uint8 * 96),
        ("description", ctypes.c_uint8 * 160),
        ("problem", ctypes.c_uint8 * 384),
    ]

    @staticmethod
    def type_name():
        return "touchline/CameraReport/1"


assert ctypes.sizeof(CameraReport) == 688


class OutputReport(ctypes.Structure):
    """One published protocol. Counters start with the publisher's process."""

    _fields_ = [
        ("name", ctypes.c_uint8 * 16),
        ("sent", ctypes.c_uint64),
        ("failed", ctypes.c_uint64),
        ("large", ctypes.c_uint64),
        ("problem", ctypes.c_uint8 * 248),
    ]


assert ctypes.sizeof(OutputReport) == 288


class PublisherReport(ctypes.Structure):
    """Published by the publisher several times a second."""

    _fields_ = [
        ("t_sent_ns", ctypes.c_uint64),
        ("commands", ctypes.c_uint64),
        ("malformed", ctypes.c_uint64),
        ("not_allowed", ctypes.c_uint64),
        ("too_many", ctypes.c_uint64),
        ("output_count", ctypes.c_uint32),
        ("rivals", ctypes.c_uint32),
        ("outputs", OutputReport * 8),
        ("problem", ctypes.c_uint8 * 256),
    ]

    @staticmethod
    def type_name():
        return "touchline/PublisherReport/1"


assert ctypes.sizeof(PublisherReport) == 2608


class Heartbeat(ctypes.Structure):
    """Published by every process about ten times a second and at every change of state. Counters start at zero with the process. The supervisor's frame counters are 0. The gateway's input is world, and each copy sent to a client counts as one output; the publisher's is world or detections, and each packet counts."""

    _fields_ = [
        ("t_sent_ns", ctypes.c_uint64),
        ("pid", ctypes.c_uint32),
        ("process", ctypes.c_uint32),
        ("state", ctypes.c_uint32),
        ("revision", ctypes.c_uint32),
        ("seq_in", ctypes.c_uint64),
        ("seq_out", ctypes.c_uint64),
        ("frames_in", ctypes.c_uint64),
        ("frames_out", ctypes.c_uint64),
        ("frames_missed", ctypes.c_uint64),
        ("dropped", ctypes.c_uint64 * 9),
    ]

    @staticmethod
    def type_name():
        return "touchline/Heartbeat/6"


assert ctypes.sizeof(Heartbeat) == 136


class LightCorrection(ctypes.Structure):
    """Correction of the light in the frame the classifier processed last. Each channel of a pixel is multiplied by a gain before its colour is looked up, so that the pitch looks as it did when the colours were set."""

    _fields_ = [
        ("gains", ctypes.c_float * 3),
        ("flags", ctypes.c_uint32),
        ("zones", ctypes.c_float * 2),
        ("changes", ctypes.c_uint64),
    ]


assert ctypes.sizeof(LightCorrection) == 32


class LightReport(ctypes.Structure):
    """The classifier's report on the light, some ten times a second while it works."""

    _fields_ = [
        ("t_sent_ns", ctypes.c_uint64),
        ("seq", ctypes.c_uint64),
        ("correction", LightCorrection),
    ]

    @staticmethod
    def type_name():
        return "touchline/LightReport/1"


assert ctypes.sizeof(LightReport) == 48


class GatewayReport(ctypes.Structure):
    """The gateway's clients and what became of messages, some ten times a second and whenever a client comes or goes. Counts start at zero with the process."""

    _fields_ = [
        ("t_sent_ns", ctypes.c_uint64),
        ("given", ctypes.c_uint64),
        ("lost", ctypes.c_uint64),
        ("not_permitted", ctypes.c_uint64),
        ("refused", ctypes.c_uint64),
        ("pid", ctypes.c_uint32),
        ("clients", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name():
        return "touchline/GatewayReport/1"


assert ctypes.sizeof(GatewayReport) == 48


class GroupEvent(ctypes.Structure):
    """Published when the supervisor notices or does something: a process ended, was replaced, killed or promoted; inputs were dropped. The log and the status say the same."""

    _fields_ = [
        ("t_wall_ns", ctypes.c_uint64),
        ("number", ctypes.c_uint64),
        ("pid", ctypes.c_uint32),
        ("process", ctypes.c_uint32),
        ("kind", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
        ("what", ctypes.c_uint8 * 224),
        ("evidence", ctypes.c_uint8 * 768),
    ]

    @staticmethod
    def type_name():
        return "touchline/GroupEvent/2"


assert ctypes.sizeof(GroupEvent) == 1024


class StatusHeader(ctypes.Structure):
    """Header of the group's status, which is JSON text in the first bytes of the payload."""

    _fields_ = [
        ("t_sent_ns", ctypes.c_uint64),
        ("bytes", ctypes.c_uint64),
    ]

    @staticmethod
    def type_name():
        return "touchline/StatusHeader/1"


assert ctypes.sizeof(StatusHeader) == 16


class Topic(NamedTuple):
    """A topic: a message is a slice of elements with a header beside it."""

    name: str
    element: type
    header: type | None
    history: int
    notifies: bool


def unpack(structure: type, data: bytes):
    """A message of a recording; bytes missing at its end are zeros."""
    return structure.from_buffer_copy(data.ljust(ctypes.sizeof(structure), b"\0"))


TOPICS = {
    "frames": Topic("frames", ctypes.c_uint8, FrameHeader, 64, False),
    "runs": Topic("runs", Run, RunsHeader, 64, False),
    "detections": Topic("detections", DetectionFrame, None, 64, False),
    "world": Topic("world", WorldFrame, None, 0, True),
    "commands": Topic("commands", Commands, None, 0, False),
    "truth": Topic("truth", TruthFrame, None, 0, False),
    "camera": Topic("camera", CameraReport, None, 0, False),
    "publisher": Topic("publisher", PublisherReport, None, 0, False),
    "health": Topic("health", Heartbeat, None, 0, False),
    "light": Topic("light", LightReport, None, 0, False),
    "gateway": Topic("gateway", GatewayReport, None, 0, False),
    "events": Topic("events", GroupEvent, None, 16, False),
    "status": Topic("status", ctypes.c_uint8, StatusHeader, 0, False),
}
