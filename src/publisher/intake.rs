//! Commands of FIRASim's clients: from a packet to our message. Pure, since anybody can send packets.

use bytemuck::Zeroable;
use messages::{Commands, MAX_COMMANDS, Team, WheelCommand, are_possible_speeds};
use protocols::Message;
use protocols::firasim::Packet;

/// Longest packet that is read; a longer one is malformed.
pub const MAX_PACKET_BYTES: usize = 4096;

/// Reason why a packet is dropped.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PacketFault {
    /// Its bytes are no message.
    #[error("it is not a packet of FIRASim's clients")]
    Malformed,
    /// It commands more robots than our message has room for.
    #[error("it commands {0} robots; at most {MAX_COMMANDS} are possible")]
    TooMany(usize),
    /// No wheel turns so fast.
    #[error("it asks for wheel speeds of {0} and {1} rad/s")]
    Speeds(f64, f64),
}

/// The commands in a packet; `None` when it holds none, but for example new places of robots, which only a
/// simulator without cameras can follow.
///
/// Wheel speeds are angular, in rad/s; times `wheel_radius_mm` they are ours, in mm/s.
pub fn commands(bytes: &[u8], wheel_radius_mm: f64) -> Result<Option<Commands>, PacketFault> {
    if bytes.len() > MAX_PACKET_BYTES {
        return Err(PacketFault::Malformed);
    }
    let packet = Packet::decode(bytes).map_err(|_| PacketFault::Malformed)?;
    let asked = packet.cmd.map(|commands| commands.robot_commands).unwrap_or_default();
    if asked.is_empty() {
        // An empty packet is a valid message, but no client sends one.
        let is_empty = packet.replace.is_none();
        return if is_empty { Err(PacketFault::Malformed) } else { Ok(None) };
    }
    if asked.len() > MAX_COMMANDS {
        return Err(PacketFault::TooMany(asked.len()));
    }
    let mut commands = Commands { wheel_count: asked.len() as u32, ..Zeroable::zeroed() };
    for (wheels, command) in commands.wheels.iter_mut().zip(asked) {
        let team = if command.yellowteam { Team::Yellow } else { Team::Blue };
        let [left_mm_s, right_mm_s] =
            [command.wheel_left, command.wheel_right].map(|speed| speed * wheel_radius_mm);
        if !are_possible_speeds(left_mm_s, right_mm_s) {
            return Err(PacketFault::Speeds(command.wheel_left, command.wheel_right));
        }
        *wheels = WheelCommand { team: team as u32, robot_id: command.id, left_mm_s, right_mm_s };
    }
    Ok(Some(commands))
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocols::firasim::{self, Command, Replacement};

    fn packet(commands: Vec<Command>) -> Vec<u8> {
        let cmd = Some(firasim::Commands { robot_commands: commands });
        Packet { cmd, replace: None }.encode_to_vec()
    }

    fn command(id: u32, yellowteam: bool, wheel_left: f64, wheel_right: f64) -> Command {
        Command { id, yellowteam, wheel_left, wheel_right }
    }

    #[test]
    fn angular_speeds_become_speeds_of_the_wheels() {
        let bytes = packet(vec![command(2, true, 10.0, -20.0), command(0, false, 0.0, 1.0)]);
        let commands = commands(&bytes, 26.0).unwrap().unwrap();
        let wheels = |team: Team, robot_id, left_mm_s, right_mm_s| WheelCommand {
            team: team as u32,
            robot_id,
            left_mm_s,
            right_mm_s,
        };
        let expected = [wheels(Team::Yellow, 2, 260.0, -520.0), wheels(Team::Blue, 0, 0.0, 26.0)];
        assert_eq!(commands.wheels(), expected);
    }

    #[test]
    fn impossible_packets_are_refused() {
        let of = |commands_in: Vec<Command>| commands(&packet(commands_in), 26.0);
        assert_eq!(of(vec![command(0, true, 0.0, 0.0); 33]), Err(PacketFault::TooMany(33)));
        for speed in [1e4, f64::INFINITY, f64::NAN] {
            let outcome = of(vec![command(0, true, speed, 0.0)]);
            assert!(matches!(outcome, Err(PacketFault::Speeds(..))), "{outcome:?}");
        }
        assert_eq!(commands(&[], 26.0), Err(PacketFault::Malformed));
        assert_eq!(commands(b"hello", 26.0), Err(PacketFault::Malformed));
        assert_eq!(commands(&[0; 5000], 26.0), Err(PacketFault::Malformed));
        let replace = Packet { cmd: None, replace: Some(Replacement::default()) };
        assert_eq!(commands(&replace.encode_to_vec(), 26.0), Ok(None));
    }

    #[test]
    fn random_bytes_are_refused_or_possible() {
        let mut state = 7u64;
        for length in (0..MAX_PACKET_BYTES).step_by(3) {
            let bytes: Vec<u8> = (0..length)
                .map(|_| {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    (state >> 56) as u8
                })
                .collect();
            if let Ok(Some(commands)) = commands(&bytes, 26.0) {
                let wheels = commands.wheels().iter();
                assert!(wheels.into_iter().all(|w| are_possible_speeds(w.left_mm_s, w.right_mm_s)));
            }
        }
    }
}
