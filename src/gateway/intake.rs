//! What a client says: pure, for it is the only thing in a group that other users decide.

use common::gateway::{CommandsFault, MAX_BYTES, commands_type_name, parse_commands};
use common::messages::Commands;

/// Takes in what one client says.
#[derive(Debug, Default)]
pub struct Intake {
    drives: bool,
}

/// What a client has said.
#[derive(Debug, Clone, PartialEq)]
pub enum Said {
    /// It wants to drive robots.
    WillDrive,
    /// Commands.
    Drive(Box<Commands>),
    /// Rubbish, to be counted.
    Rubbish(CommandsFault),
    /// Something that shows that it is of another version, or no client at all: it is cut off.
    Nonsense,
}

impl Intake {
    /// Takes in a message, of which `bytes` is the beginning and `length` the whole length.
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
    fn only_who_says_what_it_will_send_is_listened_to() {
        let mut intake = Intake::default();
        assert_eq!(say(&mut intake, bytes_of(&commands())), Said::Nonsense);
        assert_eq!(say(&mut intake, b"touchline/Commands/0"), Said::Nonsense);
        assert_eq!(say(&mut intake, commands_type_name().as_bytes()), Said::WillDrive);
        let Said::Drive(taken) = say(&mut intake, bytes_of(&commands())) else { panic!("refused") };
        assert_eq!(*taken, commands());
        assert_eq!(say(&mut intake, b"stop"), Said::Rubbish(CommandsFault::Size(4)));
        // Longer than the buffer it was received in.
        let long = intake.take(bytes_of(&commands()), 5000);
        assert_eq!(long, Said::Rubbish(CommandsFault::Size(5000)));
        assert!(matches!(say(&mut intake, bytes_of(&commands())), Said::Drive(_)));
    }

    #[test]
    fn rubbish_of_every_length_is_counted_and_nothing_worse() {
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
