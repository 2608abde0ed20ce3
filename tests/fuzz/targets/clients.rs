//! Messages of a program of another user to the gateway. Any bytes are refused, or give valid commands
//! without stale data. The effect of commands on a filter is tested by `detections`.
#![no_main]

use client::gateway::parse_commands;
use messages::{ClearStale, Commands, MAX_COMMANDS, Team};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    // Any bytes, in the required number.
    let mut whole = bytes.to_vec();
    whole.resize(size_of::<Commands>(), 0);
    for bytes in [bytes, &whole] {
        let Ok(commands) = parse_commands(bytes) else { continue };
        assert_eq!(bytes.len(), size_of::<Commands>());
        assert!(commands.wheel_count as usize <= MAX_COMMANDS);
        for wheels in commands.wheels() {
            assert!(wheels.left_mm_s.is_finite() && wheels.right_mm_s.is_finite());
            assert!(Team::from_number(wheels.team).is_some());
        }
        let mut cleared = commands;
        cleared.clear_stale();
        assert_eq!(bytemuck::bytes_of(&cleared), bytemuck::bytes_of(&commands));
    }
});
