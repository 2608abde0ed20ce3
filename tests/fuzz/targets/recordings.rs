//! Reading recordings with any bytes: a damaged file, or one of another program.
#![no_main]

use config::Config;
use messages::{Commands, DetectionFrame, Run, RunsHeader, TruthFrame, WorldFrame};
use libfuzzer_sys::fuzz_target;
use recording::{
    Setup, ball_pose, decode_frame, decode_list, decode_message, encode_frame, encode_message,
    field_scene, robot_poses, world_scene,
};

fuzz_target!(|bytes: &[u8]| {
    let Some((&kind, data)) = bytes.split_first() else { return };
    match kind % 6 {
        0 => {
            let Some(frame) = decode_frame(data) else { return };
            let mut again = Vec::new();
            encode_frame(&frame.header, frame.pixels, &mut again);
            let again = decode_frame(&again).expect("what was written can be read");
            assert_eq!(bytemuck::bytes_of(&again.header), bytemuck::bytes_of(&frame.header));
            assert_eq!(again.pixels, frame.pixels);
        }
        1 => {
            if let Some((header, runs)) = decode_list::<RunsHeader, Run>(data) {
                let _ = header.valid(&runs).len();
            }
        }
        2 => {
            let Some(world) = decode_message::<WorldFrame>(data) else { return };
            let drawings = [world_scene(&world, 75.0, 42.7), robot_poses(&world)];
            for drawing in drawings.into_iter().chain(ball_pose(&world)) {
                assert!(std::str::from_utf8(&drawing).is_ok());
            }
            let mut again = Vec::new();
            encode_message(&*world, &mut again);
            let again = decode_message::<WorldFrame>(&again).expect("what was written can be read");
            assert_eq!(bytemuck::bytes_of(&*again), bytemuck::bytes_of(&*world));
        }
        3 => {
            if let Some(found) = decode_message::<DetectionFrame>(data) {
                let _ = (found.robots().len(), found.regions().len(), found.rejected().len());
                found.regions().iter().for_each(|region| drop(found.runs_of(region).to_vec()));
            }
        }
        4 => {
            let _ = decode_message::<Commands>(data);
            if let Some(truth) = decode_message::<TruthFrame>(data) {
                let _ = truth.robots().len();
            }
        }
        _ => {
            let Some(setup) = Setup::decode(data) else { return };
            let now_ns = setup.wall_ns(u64::MAX / 3);
            if let Ok(config) = Config::parse(&setup.config_toml, "fuzz") {
                let _ = field_scene(&config.field, now_ns);
            }
        }
    }
});
