//! Rate limit and fair scheduling of client messages: pure, with users and times given.
//!
//! Token buckets limit three levels: all messages, the messages of a user, and those of a connection.
//! Round-robin goes over the users, and within a user over its connections, one message a turn. So under
//! overload every user gets the same share, however many connections each has, and a user that sends less
//! than its share does not wait for the others.

use messages::MAX_USED_COMMANDS;
use std::collections::BTreeMap;

/// Messages per second of a connection: more than a strategy needs that sends commands for all
/// robots together …
const PER_CLIENT_PER_S: f64 = 500.0;
/// … and its burst after a pause.
const PER_CLIENT_AT_ONCE: f64 = 64.0;
/// Messages per second of a user: as many as for one connection.
const PER_USER_PER_S: f64 = PER_CLIENT_PER_S;
const PER_USER_AT_ONCE: f64 = PER_CLIENT_AT_ONCE;
/// Messages per second of all users, if the camera is fast enough.
const ALL_PER_S: f64 = 1500.0;
/// Share of the messages the filter accepts per frame that is for other users; the rest is for
/// programs of the owner.
const PART_OF_FILTER: f64 = 0.6;
/// Burst of all users, in frames of the filter.
const ALL_AT_ONCE_FRAMES: f64 = 2.0;

/// A token bucket.
#[derive(Debug, Clone)]
pub struct Allowance {
    per_s: f64,
    most: f64,
    left: f64,
    at_ns: u64,
}

impl Allowance {
    /// A full bucket.
    pub fn new(per_s: f64, most: f64, now_ns: u64) -> Self {
        Self { per_s, most, left: most, at_ns: now_ns }
    }

    /// Number of messages that may be taken now.
    pub fn left(&mut self, now_ns: u64) -> usize {
        let seconds = now_ns.saturating_sub(self.at_ns) as f64 / 1e9;
        self.left = (self.left + seconds * self.per_s).min(self.most);
        self.at_ns = self.at_ns.max(now_ns);
        self.left as usize
    }

    /// Removes a token.
    pub fn take(&mut self) {
        self.left = (self.left - 1.0).max(0.0);
    }

    fn is_full(&mut self, now_ns: u64) -> bool {
        self.left(now_ns);
        self.left >= self.most
    }
}

/// A user's connections.
#[derive(Debug)]
struct User {
    allowance: Allowance,
    /// Buckets by connection.
    clients: BTreeMap<u64, Allowance>,
    /// The connection that had the last turn.
    last_client: u64,
}

/// Token buckets of all users and connections, and the order of turns.
#[derive(Debug)]
pub struct Rations {
    all: Allowance,
    /// Users by id.
    users: BTreeMap<u32, User>,
    /// The user that had the last turn.
    last_user: u32,
}

impl Rations {
    /// Rations for a group with a camera of this rate, without users.
    pub fn new(fps: f64, now_ns: u64) -> Self {
        let per_frame = MAX_USED_COMMANDS as f64 * PART_OF_FILTER;
        let per_s = (per_frame * fps).clamp(1.0, ALL_PER_S);
        let at_once = per_frame * ALL_AT_ONCE_FRAMES;
        Self { all: Allowance::new(per_s, at_once, now_ns), users: BTreeMap::new(), last_user: 0 }
    }

    /// Adds a user's connection.
    pub fn enter(&mut self, uid: u32, id: u64, now_ns: u64) {
        let user = self.users.entry(uid).or_insert_with(|| User {
            allowance: Allowance::new(PER_USER_PER_S, PER_USER_AT_ONCE, now_ns),
            clients: BTreeMap::new(),
            last_client: 0,
        });
        user.clients.insert(id, Allowance::new(PER_CLIENT_PER_S, PER_CLIENT_AT_ONCE, now_ns));
    }

    /// Removes a connection. Its user's bucket stays as it is: reconnecting does not refill it.
    pub fn leave(&mut self, uid: u32, id: u64, now_ns: u64) {
        if let Some(user) = self.users.get_mut(&uid) {
            user.clients.remove(&id);
        }
        self.users.retain(|_, user| !user.clients.is_empty() || !user.allowance.is_full(now_ns));
    }

    /// Whether a connection may send now.
    pub fn may_speak(&mut self, uid: u32, id: u64, now_ns: u64) -> bool {
        self.all.left(now_ns) > 0
            && self.users.get_mut(&uid).is_some_and(|user| {
                user.allowance.left(now_ns) > 0
                    && user.clients.get_mut(&id).is_some_and(|client| client.left(now_ns) > 0)
            })
    }

    /// The connection whose turn it is, among those that have a message and may send it.
    pub fn next(&mut self, has_something: impl Fn(u64) -> bool, now_ns: u64) -> Option<u64> {
        if self.all.left(now_ns) == 0 {
            return None;
        }
        // From the user after the last one, round to the last one.
        let (before, after) = (..=self.last_user, self.last_user.checked_add(1));
        let mut uids: Vec<u32> = after
            .map_or_else(Vec::new, |after| self.users.range(after..).map(|it| *it.0).collect());
        uids.extend(self.users.range(before).map(|it| *it.0));
        for uid in uids {
            let Some(user) = self.users.get_mut(&uid) else { continue };
            if let Some(id) = user.next(&has_something, now_ns) {
                self.last_user = uid;
                return Some(id);
            }
        }
        None
    }

    /// Removes a token for a message of a connection.
    pub fn take(&mut self, uid: u32, id: u64) {
        self.all.take();
        if let Some(user) = self.users.get_mut(&uid) {
            user.allowance.take();
            user.clients.get_mut(&id).into_iter().for_each(Allowance::take);
        }
    }
}

impl User {
    fn next(&mut self, has_something: &impl Fn(u64) -> bool, now_ns: u64) -> Option<u64> {
        if self.allowance.left(now_ns) == 0 {
            return None;
        }
        let last = self.last_client;
        let mut may = |(&id, client): (&u64, &mut Allowance)| {
            (has_something(id) && client.left(now_ns) > 0).then_some(id)
        };
        let after = self.clients.range_mut(last + 1..).find_map(&mut may);
        let id = after.or_else(|| self.clients.range_mut(..=last).find_map(may))?;
        self.last_client = id;
        Some(id)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;
    const MS: u64 = 1_000_000;

    /// Connections and their unread messages, in steps of a millisecond.
    struct Play {
        rations: Rations,
        clients: Vec<Speaker>,
        now_ns: u64,
    }

    struct Speaker {
        uid: u32,
        per_s: f64,
        said: u64,
        /// Send times of the messages not taken yet.
        waiting: std::collections::VecDeque<u64>,
        taken: u64,
        longest_ns: u64,
    }

    impl Play {
        fn new(fps: f64, speakers: &[(u32, usize, f64)]) -> Self {
            let mut play = Self { rations: Rations::new(fps, S), clients: vec![], now_ns: S };
            for &(uid, connections, per_s) in speakers {
                for _ in 0..connections {
                    play.rations.enter(uid, play.clients.len() as u64 + 1, S);
                    play.clients.push(Speaker {
                        uid,
                        per_s,
                        said: 0,
                        waiting: Default::default(),
                        taken: 0,
                        longest_ns: 0,
                    });
                }
            }
            play
        }

        fn run(mut self, seconds: u64) -> Self {
            let begun_ns = self.now_ns;
            while self.now_ns < begun_ns + seconds * S {
                self.now_ns += MS;
                let now_ns = self.now_ns;
                let elapsed_s = (now_ns - begun_ns) as f64 / 1e9;
                for client in &mut self.clients {
                    while (client.said as f64) < client.per_s * elapsed_s {
                        client.said += 1;
                        // A socket has room for 200 messages; then the sender waits.
                        if client.waiting.len() < 200 {
                            client.waiting.push_back(now_ns);
                        }
                    }
                }
                loop {
                    let clients = &self.clients;
                    let has_something = |id: u64| !clients[id as usize - 1].waiting.is_empty();
                    let Some(id) = self.rations.next(has_something, now_ns) else { break };
                    let client = &mut self.clients[id as usize - 1];
                    let said_ns = client.waiting.pop_front().unwrap();
                    client.longest_ns = client.longest_ns.max(now_ns - said_ns);
                    client.taken += 1;
                    self.rations.take(client.uid, id);
                }
            }
            self
        }

        fn taken_by(&self, uid: u32) -> u64 {
            self.of(uid).map(|client| client.taken).sum()
        }

        fn longest_ms(&self, uid: u32) -> u64 {
            self.of(uid).map(|client| client.longest_ns / MS).max().unwrap()
        }

        fn of(&self, uid: u32) -> impl Iterator<Item = &Speaker> {
            self.clients.iter().filter(move |client| client.uid == uid)
        }
    }

    #[test]
    fn many_modest_connections_of_one_user_do_not_reduce_anothers_share() {
        for fps in [30.0, 80.0, 200.0] {
            let play = Play::new(fps, &[(1000, 16, 60.0), (1001, 1, 450.0)]).run(10);
            let alone = Play::new(fps, &[(1001, 1, 450.0)]).run(10);
            let (beside, alone) = (play.taken_by(1001), alone.taken_by(1001));
            // If the filter takes less than both ask for, each gets half.
            let share = alone.min((MAX_USED_COMMANDS as f64 * PART_OF_FILTER * fps * 5.0) as u64);
            assert!(beside + 100 >= share, "{beside} of {share} at {fps} fps");
            if fps >= 80.0 {
                assert!(beside + 2 >= alone && play.longest_ms(1001) < 10, "{beside} of {alone}");
            }
        }
    }

    #[test]
    fn floods_of_two_users_do_not_hold_up_a_third() {
        for fps in [30.0, 80.0] {
            let play = Play::new(fps, &[(7, 16, 2000.0), (8, 15, 2000.0), (9, 1, 80.0)]).run(10);
            assert!(play.taken_by(9) >= 798, "{} of 800 at {fps} fps", play.taken_by(9));
            assert!(play.longest_ms(9) < 20, "{} ms at {fps} fps", play.longest_ms(9));
            let (one, other) = (play.taken_by(7), play.taken_by(8));
            assert!(one.abs_diff(other) <= 70, "the others share alike: {one} and {other}");
        }
    }

    #[test]
    fn connections_of_a_user_share_equally_and_reconnecting_refills_nothing() {
        let play = Play::new(80.0, &[(1, 4, 2000.0)]).run(10);
        let taken: Vec<u64> = play.clients.iter().map(|client| client.taken).collect();
        assert!((4900..5100).contains(&play.taken_by(1)), "{taken:?}");
        assert!(taken.iter().all(|count| count.abs_diff(taken[0]) <= 2), "{taken:?}");

        let mut rations = Rations::new(80.0, S);
        let mut taken = 0;
        for id in 1..1000 {
            rations.enter(5, id, S);
            while rations.next(|_| true, S).is_some() {
                rations.take(5, id);
                taken += 1;
            }
            rations.leave(5, id, S);
        }
        assert!(taken <= PER_USER_AT_ONCE as usize, "{taken} messages in no time");
        assert_eq!(rations.users.len(), 1);
        rations.leave(5, 1000, 100 * S);
        assert!(rations.users.is_empty(), "it is forgotten in time");
    }

    #[test]
    fn a_sender_above_its_rate_has_to_wait() {
        let mut allowance = Allowance::new(100.0, 10.0, S);
        let mut taken = 0;
        for step in 0..1000 {
            let now_ns = S + step * S / 1000;
            while allowance.left(now_ns) > 0 {
                allowance.take();
                taken += 1;
            }
        }
        assert!((105..=111).contains(&taken), "{taken}");
        assert_eq!(allowance.left(S), 0, "a clock that goes back gives nothing");
        assert_eq!(allowance.left(100 * S), 10, "a long pause does not make a flood");
    }

    #[test]
    fn users_of_any_id_have_their_turn() {
        let mut rations = Rations::new(80.0, S);
        for (id, uid) in [(1, 0), (2, 7), (3, u32::MAX)] {
            rations.enter(uid, id, S);
        }
        let turns: Vec<u64> = (0..6).filter_map(|_| rations.next(|_| true, S)).collect();
        assert_eq!(turns, [2, 3, 1, 2, 3, 1]);
        assert_eq!(rations.next(|id| id == 2, S), Some(2));
        assert_eq!(rations.next(|_| false, S), None);
    }
}
