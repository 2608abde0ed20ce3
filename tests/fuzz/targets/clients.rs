//! What a program of another user sends through the gateway. Whatever it is, it is refused, or commands
//! that can be, with nothing behind their count. What those do to a filter, `detections` tries.
#![no_main]

use common::gateway::parse_commands;
use common::messages::{ClearStale, Commands, MAX_COMMANDS, Team};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    // Any bytes, and as many as there must be.
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
