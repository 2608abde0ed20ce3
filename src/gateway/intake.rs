//! Parser of client messages: pure, since they are the only input of a group that other users control.

use client::gateway::{CommandsFault, MAX_BYTES, commands_type_name, parse_commands};
use messages::Commands;

/// Parser of one client's messages.
#[derive(Debug, Default)]
pub struct Intake {
    drives: bool,
}

/// A parsed client message.
#[derive(Debug, Clone, PartialEq)]
pub enum Said {
    /// The client announces that it will send commands.
    WillDrive,
    /// Commands.
    Drive(Box<Commands>),
    /// An invalid message, to be counted.
    Rubbish(CommandsFault),
    /// A message of another version, or not from a client at all: the connection is closed.
    Nonsense,
}

impl Intake {
    /// Parses a message of this length; `bytes` is its beginning.
    pub fn take(&mut self, bytes: &[u8], length: usize) -> Said {
        if !self.drives {
            self.drives = bytes == commands_type_name().as_bytes() && length == bytes.len();
            return if self.drives { Said::WillDrive } else { Said::Nonsense };
        }
        if length > bytes.len().min(MAX_BYTES) {
            return Said::Rubbish(CommandsFault::Size(length));
        }
        match parse_commands(bytes) {
            Ok(commands) => Said::Drive(Box::new(commands)),
            Err(fault) => Said::Rubbish(fault),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::{Zeroable, bytes_of};

    fn commands() -> Commands {
        Commands { seq: 3, t_sent_ns: 5, ..Zeroable::zeroed() }
    }

    fn say(intake: &mut Intake, bytes: &[u8]) -> Said {
        intake.take(bytes, bytes.len())
    }

    #[test]
    fn commands_are_accepted_only_after_an_announcement() {
        let mut intake = Intake::default();
        assert_eq!(say(&mut intake, bytes_of(&commands())), Said::Nonsense);
        assert_eq!(say(&mut intake, b"touchline/Commands/0"), Said::Nonsense);
        assert_eq!(say(&mut intake, commands_type_name().as_bytes()), Said::WillDrive);
        let Said::Drive(taken) = say(&mut intake, bytes_of(&commands())) else { panic!("refused") };
        assert_eq!(*taken, commands());
        assert_eq!(say(&mut intake, b"stop"), Said::Rubbish(CommandsFault::Size(4)));
        // A message longer than the receive buffer.
        let long = intake.take(bytes_of(&commands()), 5000);
        assert_eq!(long, Said::Rubbish(CommandsFault::Size(5000)));
        assert!(matches!(say(&mut intake, bytes_of(&commands())), Said::Drive(_)));
    }

    #[test]
    fn invalid_messages_of_every_length_are_only_counted() {
        let mut intake = Intake::default();
        say(&mut intake, commands_type_name().as_bytes());
        let mut state = 1u64;
        for length in (0..2 * MAX_BYTES).chain([size_of::<Commands>(); 2000]) {
            let bytes: Vec<u8> = (0..length)
                .map(|_| {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    (state >> 56) as u8
                })
                .collect();
            match say(&mut intake, &bytes) {
                Said::Rubbish(_) => {}
                Said::Drive(taken) => {
                    assert_eq!(length, size_of::<Commands>());
                    assert!(taken.wheels().iter().all(|w| w.left_mm_s.is_finite()));
                }
                other => panic!("{length} random bytes are {other:?}"),
            }
        }
    }
}
