//! The gateway's protocol: how programs of other users read poses and send commands.
//!
//! Shared memory is accessible to the owner of a group only. If the configuration names a group of
//! users (`access.group`), the process `gateway` offers them a Unix socket that preserves message
//! boundaries (`SOCK_SEQPACKET`):
//!
//! 1. The gateway sends a [`Greeting`], JSON text in one message.
//! 2. Every `world` follows, one message each: the bytes of a
//!    [`WorldFrame`](messages::WorldFrame).
//! 3. A client that wants to drive robots first sends the type name of its commands (`commands.type` in
//!    the greeting) as a message, and from then on the bytes of [`Commands`], one message each.
//!
//! For a client that reads slowly, [`KEPT`] messages are kept besides those in the socket; then it, and
//! no other client, loses the oldest. A client whose first message is not that type name is
//! disconnected. Impossible commands, and commands for a team that the user may not command, are
//! dropped and counted. A few hundred messages a second are accepted from all programs of a user
//! together; further messages wait.

mod client;

pub use client::{Client, ClientError};

use messages::topics;
use messages::{Commands, MAX_COMMANDS, Team, are_possible_speeds};
use serde::{Deserialize, Serialize};

/// Version of the protocol; the messages have their own versions.
pub const PROTOCOL: u32 = 1;
/// Messages kept for each client.
pub const KEPT: usize = 64;
/// Longest message accepted from a client; longer than any valid one.
pub const MAX_BYTES: usize = 1024;

const _: () = assert!(size_of::<Commands>() <= MAX_BYTES);

/// The gateway's first message.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Greeting {
    /// [`PROTOCOL`].
    pub touchline_gateway: u32,
    /// Name of the group.
    pub instance: String,
    /// The messages the gateway sends.
    pub world: Layout,
    /// The messages the gateway accepts.
    pub commands: Layout,
    /// Reason why the gateway refuses the client and closes, for example too many clients.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
}

/// A message's layout.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Layout {
    /// Versioned type name.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Size of the message.
    pub bytes: usize,
}

impl Greeting {
    /// The greeting of a group with this program's version.
    pub fn new(instance: &str) -> Self {
        let world = topics::WORLD.type_names().element;
        Self {
            touchline_gateway: PROTOCOL,
            instance: instance.into(),
            world: Layout { type_name: world.into(), bytes: size_of::<messages::WorldFrame>() },
            commands: Layout {
                type_name: commands_type_name().into(),
                bytes: size_of::<Commands>(),
            },
            refused: None,
        }
    }

    /// Whether this program and the gateway understand each other's messages.
    pub fn fits(&self) -> bool {
        let own = Self::new(&self.instance);
        (self.touchline_gateway, &self.world, &self.commands)
            == (own.touchline_gateway, &own.world, &own.commands)
    }
}

/// The first message of a client that wants to drive robots.
pub fn commands_type_name() -> &'static str {
    topics::COMMANDS.type_names().element
}

/// Reason why a client's message is not a valid command.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum CommandsFault {
    /// Wrong size.
    #[error("{0} bytes instead of {bytes}", bytes = size_of::<Commands>())]
    Size(usize),
    /// More robots than the message has room for.
    #[error("commands for {0} robots; at most {MAX_COMMANDS}")]
    Count(u32),
    /// Unknown team.
    #[error("team {0}")]
    Team(u32),
    /// Impossible wheel speeds.
    #[error("wheel speeds of {0} and {1} mm/s")]
    Speeds(f64, f64),
}

/// The commands in a client's message. Stale bytes beyond the count are cleared.
pub fn parse_commands(bytes: &[u8]) -> Result<Commands, CommandsFault> {
    use messages::ClearStale;
    if bytes.len() != size_of::<Commands>() {
        return Err(CommandsFault::Size(bytes.len()));
    }
    let mut commands: Commands = bytemuck::pod_read_unaligned(bytes);
    if commands.wheel_count as usize > MAX_COMMANDS {
        return Err(CommandsFault::Count(commands.wheel_count));
    }
    for wheels in commands.wheels() {
        if Team::from_number(wheels.team).is_none() {
            return Err(CommandsFault::Team(wheels.team));
        }
        let (left_mm_s, right_mm_s) = (wheels.left_mm_s, wheels.right_mm_s);
        if !are_possible_speeds(left_mm_s, right_mm_s) {
            return Err(CommandsFault::Speeds(left_mm_s, right_mm_s));
        }
    }
    commands.user = 0;
    commands.clear_stale();
    Ok(commands)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::{Zeroable, bytes_of};
    use messages::WheelCommand;
    use proptest::prelude::*;

    fn commands() -> Commands {
        let mut commands = Commands { seq: 7, t_sent_ns: 9, wheel_count: 2, ..Zeroable::zeroed() };
        for (id, wheels) in commands.wheels.iter_mut().enumerate() {
            let robot_id = id as u32;
            *wheels = WheelCommand { team: 1, robot_id, left_mm_s: -500.0, right_mm_s: 300.0 };
        }
        commands
    }

    #[test]
    fn commands_arrive_as_they_were_sent_and_nothing_else_with_them() {
        let sent = commands();
        let taken = parse_commands(bytes_of(&sent)).unwrap();
        assert_eq!((taken.seq, taken.t_sent_ns), (7, 9));
        assert_eq!(taken.wheels(), sent.wheels());
        assert_eq!(taken.wheels[2..], [WheelCommand::default(); MAX_COMMANDS - 2]);
    }

    #[test]
    fn impossible_commands_have_distinct_faults() {
        let fault = |change: &dyn Fn(&mut Commands)| {
            let mut wrong = commands();
            change(&mut wrong);
            parse_commands(bytes_of(&wrong)).unwrap_err().to_string()
        };
        assert!(fault(&|it| it.wheel_count = 33).contains("33 robots"));
        assert!(fault(&|it| it.wheels[1].team = 2).contains("team 2"));
        for speed in [f64::NAN, f64::INFINITY, -f64::INFINITY, 2.1e4, -1e300] {
            assert!(fault(&|it| it.wheels[1].left_mm_s = speed).contains("speed"), "{speed}");
            assert!(fault(&|it| it.wheels[0].right_mm_s = speed).contains("speed"), "{speed}");
        }
        assert_eq!(parse_commands(&[]), Err(CommandsFault::Size(0)));
        assert_eq!(parse_commands(&bytes_of(&commands())[1..]), Err(CommandsFault::Size(791)));
    }

    proptest! {
        #[test]
        fn whatever_comes_is_refused_or_can_be(bytes in prop::collection::vec(any::<u8>(), 792)) {
            if let Ok(commands) = parse_commands(&bytes) {
                prop_assert!(commands.wheel_count as usize <= MAX_COMMANDS);
                for wheels in commands.wheels() {
                    prop_assert!(are_possible_speeds(wheels.left_mm_s, wheels.right_mm_s));
                    prop_assert!(Team::from_number(wheels.team).is_some());
                }
            }
        }

        #[test]
        fn one_wrong_byte_is_refused_or_can_be(place in 0usize..792, byte in any::<u8>()) {
            let mut bytes = bytes_of(&commands()).to_vec();
            bytes[place] = byte;
            if let Ok(commands) = parse_commands(&bytes) {
                let speeds = commands.wheels().iter().flat_map(|w| [w.left_mm_s, w.right_mm_s]);
                prop_assert!(speeds.into_iter().all(|speed| are_possible_speeds(speed, speed)));
            }
        }

        #[test]
        fn other_lengths_are_refused(bytes in prop::collection::vec(any::<u8>(), 0..2000)) {
            let outcome = parse_commands(&bytes);
            prop_assert!(outcome.is_ok() <= (bytes.len() == size_of::<Commands>()));
        }
    }

    #[test]
    fn a_greeting_of_another_version_does_not_fit() {
        let greeting = Greeting::new("match");
        let text = serde_json::to_string(&greeting).unwrap();
        assert!(text.contains("\"type\":\"touchline/WorldFrame/") && text.len() < 1000, "{text}");
        let read: Greeting = serde_json::from_str(&text).unwrap();
        assert!(read.fits() && read == greeting);
        let mut other = greeting;
        other.world.bytes += 8;
        assert!(!other.fits());
    }
}
