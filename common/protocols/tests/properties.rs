//! Any message is read back as it was, and no bytes bring a decoder down.

use proptest::collection::vec;
use proptest::prelude::*;
use touchline_protocols::firasim::{Command, Commands, Environment, Packet};
use touchline_protocols::ssl_tracked::{
    RobotId, TrackedFrame, TrackedRobot, TrackerPacket, Vector2,
};
use touchline_protocols::ssl_vision::{
    DetectionBall, DetectionFrame, DetectionRobot, WrapperPacket,
};
use touchline_protocols::{Message, ONE_FRAME_BYTES, firasim};

fn float() -> impl Strategy<Value = f32> {
    prop_oneof![any::<f32>().prop_filter("equal to itself", |it| !it.is_nan()), Just(0.0)]
}

fn detected_robot() -> impl Strategy<Value = DetectionRobot> {
    let all = (float(), any::<Option<u32>>(), [float(), float()], proptest::option::of(float()));
    (all, [float(), float()], proptest::option::of(float())).prop_map(
        |((confidence, robot_id, [x, y], orientation), [pixel_x, pixel_y], height)| {
            DetectionRobot { confidence, robot_id, x, y, orientation, pixel_x, pixel_y, height }
        },
    )
}

fn detected_ball() -> impl Strategy<Value = DetectionBall> {
    (any::<Option<u32>>(), [float(), float(), float(), float(), float()]).prop_map(
        |(area, [confidence, x, y, pixel_x, pixel_y])| DetectionBall {
            confidence,
            area,
            x,
            y,
            z: None,
            pixel_x,
            pixel_y,
        },
    )
}

proptest! {
    #[test]
    fn detections_are_read_back(
        frame_number: u32,
        t_capture in 0.0..1e10,
        camera_id: u32,
        balls in vec(detected_ball(), 0..4),
        robots_yellow in vec(detected_robot(), 0..16),
        robots_blue in vec(detected_robot(), 0..16),
    ) {
        let frame = DetectionFrame {
            frame_number,
            t_capture,
            t_sent: t_capture + 0.01,
            camera_id,
            balls,
            robots_yellow,
            robots_blue,
            t_capture_camera: None,
        };
        let packet = WrapperPacket { detection: Some(frame), geometry: None, source: Some(1) };
        let bytes = packet.encode_to_vec();
        prop_assert_eq!(bytes.len(), packet.encoded_len());
        prop_assert_eq!(WrapperPacket::decode(&bytes[..]).unwrap(), packet);
    }

    #[test]
    fn tracked_frames_are_read_back(uuid: String, frame_number: u32, numbers in vec(float(), 6)) {
        let robot = TrackedRobot {
            robot_id: RobotId { id: Some(frame_number), team: Some(2) },
            pos: Vector2 { x: numbers[0], y: numbers[1] },
            orientation: numbers[2],
            vel: Some(Vector2 { x: numbers[3], y: numbers[4] }),
            vel_angular: Some(numbers[5]),
            visibility: None,
        };
        let frame = TrackedFrame { frame_number, robots: vec![robot; 5], ..Default::default() };
        let packet = TrackerPacket { uuid, source_name: None, tracked_frame: Some(frame) };
        prop_assert_eq!(TrackerPacket::decode(&packet.encode_to_vec()[..]).unwrap(), packet);
    }

    #[test]
    fn commands_are_read_back(commands in vec((any::<u32>(), any::<bool>(), -1e6..1e6, -1e6..1e6), 0..40)) {
        let robot_commands = commands
            .into_iter()
            .map(|(id, yellowteam, wheel_left, wheel_right)| Command { id, yellowteam, wheel_left, wheel_right })
            .collect();
        let packet = Packet { cmd: Some(Commands { robot_commands }), replace: None };
        prop_assert_eq!(Packet::decode(&packet.encode_to_vec()[..]).unwrap(), packet);
    }

    #[test]
    fn no_bytes_bring_a_decoder_down(bytes in vec(any::<u8>(), 0..ONE_FRAME_BYTES)) {
        decode_as_everything(&bytes);
    }

    /// Bytes that begin like a message get farther than random ones.
    #[test]
    fn no_damaged_message_brings_a_decoder_down(
        robots in vec(detected_robot(), 1..8),
        damage in vec((any::<proptest::sample::Index>(), any::<u8>()), 1..8),
        length: proptest::sample::Index,
    ) {
        let frame = DetectionFrame { robots_yellow: robots, ..Default::default() };
        let mut bytes =
            WrapperPacket { detection: Some(frame), ..Default::default() }.encode_to_vec();
        for (place, byte) in damage {
            let place = place.index(bytes.len());
            bytes[place] = byte;
        }
        bytes.truncate(length.index(bytes.len()) + 1);
        decode_as_everything(&bytes);
    }
}

/// Decodes as every message there is; a refusal is as good as a message.
fn decode_as_everything(bytes: &[u8]) {
    let _ = WrapperPacket::decode(bytes);
    let _ = TrackerPacket::decode(bytes);
    let _ = Environment::decode(bytes);
    let _ = Packet::decode(bytes);
}

/// A length that reaches beyond the packet, and messages within messages without end.
#[test]
fn lengths_and_depths_are_bounded() {
    let mut bytes = vec![0x0a, 0xff, 0xff, 0xff, 0xff, 0x0f];
    assert!(WrapperPacket::decode(&bytes[..]).is_err());
    bytes = [0x13; 65_000].to_vec();
    assert!(WrapperPacket::decode(&bytes[..]).is_err());
    assert!(firasim::Packet::decode(&[0x0a; 65_000][..]).is_err());
}
