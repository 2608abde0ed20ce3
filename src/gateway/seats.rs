//! Assignment of the limited seats for connections: pure, with users given by id.

use std::collections::BTreeMap;

/// Outcome for a new connection.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Seat {
    /// A seat is free.
    Free,
    /// It gets the seat of the youngest connection of this user, which has more than its share.
    InsteadOf(u32),
    /// No seat, for this reason.
    Refused(String),
}

/// Finds a seat among `most` for a new connection of a user. One user has at most half of them.
/// When all are taken, a user with at least two more than the newcomer's gives one up, so that
/// shares become equal.
pub fn seat_for(uid: u32, taken: impl IntoIterator<Item = u32>, most: usize) -> Seat {
    let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
    for uid in taken {
        *counts.entry(uid).or_default() += 1;
    }
    let own = counts.get(&uid).copied().unwrap_or(0);
    let all: usize = counts.values().sum();
    if own >= most / 2 {
        return Seat::Refused(format!("user {uid} has {own} of {most} places already"));
    }
    if all < most {
        return Seat::Free;
    }
    match counts.into_iter().max_by_key(|&(_, count)| count) {
        Some((richest, count)) if count >= own + 2 => Seat::InsteadOf(richest),
        _ => Seat::Refused(format!("all {most} places are taken (access.clients)")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Connects a user `count` times; returns its number of seats afterwards.
    fn connect(seats: &mut Vec<u32>, uid: u32, count: usize, most: usize) -> usize {
        for _ in 0..count {
            match seat_for(uid, seats.iter().copied(), most) {
                Seat::Free => seats.push(uid),
                Seat::InsteadOf(other) => {
                    let youngest = seats.iter().rposition(|&it| it == other).unwrap();
                    seats.remove(youngest);
                    seats.push(uid);
                }
                Seat::Refused(_) => {}
            }
            assert!(seats.len() <= most);
        }
        seats.iter().filter(|&&it| it == uid).count()
    }

    #[test]
    fn seats_are_shared_equally_when_there_are_too_few() {
        let mut seats = Vec::new();
        assert_eq!(connect(&mut seats, 1, 40, 32), 16, "half is the most");
        assert_eq!(connect(&mut seats, 2, 40, 32), 16);
        assert_eq!(connect(&mut seats, 3, 40, 32), 10, "others give up what they have more");
        let count = |uid: u32| seats.iter().filter(|&&it| it == uid).count();
        assert_eq!((count(1), count(2)), (11, 11));
        assert_eq!(connect(&mut seats.clone(), 1, 40, 32), 11, "they do not get it back");
        for uid in 4..40 {
            let expected = usize::from(uid < 33);
            assert!(connect(&mut seats, uid, 1, 32) >= expected, "user {uid} finds no place");
        }
    }

    #[test]
    fn users_with_few_seats_keep_them() {
        let mut seats = Vec::new();
        connect(&mut seats, 1, 1, 4);
        connect(&mut seats, 2, 2, 4);
        connect(&mut seats, 3, 2, 4);
        assert_eq!(seats, [1, 2, 2, 3]);
        assert_eq!(seat_for(4, seats.iter().copied(), 4), Seat::InsteadOf(2));
        let refused = |uid| matches!(seat_for(uid, [1, 2, 3, 4], 4), Seat::Refused(_));
        assert!(refused(1) && refused(5), "every user has one");
    }
}
