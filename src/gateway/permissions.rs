//! Permissions: which users may command which team.

use super::place::PlaceError;
use super::users;
use bytemuck::Zeroable;
use config::AccessConfig;
use messages::{Commands, Team, WheelCommand};
use std::collections::BTreeSet;

/// The users of each team, by user id.
#[derive(Debug, Clone, Default)]
pub struct Permissions {
    /// Users per team; `None` if every user that may attach may command the team.
    teams: [Option<BTreeSet<u32>>; Team::ALL.len()],
}

impl Permissions {
    /// Permissions of a configuration.
    pub fn of(access: &AccessConfig) -> Result<Self, PlaceError> {
        let mut permissions = Self::default();
        for team in Team::ALL {
            let names = access.teams.of(team);
            if names.is_empty() {
                continue;
            }
            let uids = names.iter().map(|name| user_number(team, name));
            permissions.teams[team as usize] = Some(uids.collect::<Result<_, _>>()?);
        }
        Ok(permissions)
    }

    /// Whether a user may command a team.
    pub fn may_command(&self, uid: u32, team: Team) -> bool {
        self.teams[team as usize].as_ref().is_none_or(|uids| uids.contains(&uid))
    }

    /// Removes a user's commands for robots of teams that it may not command; returns how many.
    pub fn restrict(&self, uid: u32, commands: &mut Commands) -> usize {
        let may = |wheels: &&WheelCommand| {
            Team::from_number(wheels.team).is_some_and(|team| self.may_command(uid, team))
        };
        let all = commands.wheels().len();
        let permitted: Vec<WheelCommand> = commands.wheels().iter().filter(may).copied().collect();
        commands.wheels[..all].fill_with(WheelCommand::zeroed);
        commands.wheels[..permitted.len()].copy_from_slice(&permitted);
        commands.wheel_count = permitted.len() as u32;
        all - permitted.len()
    }
}

/// Id of a user given by name or by id.
fn user_number(team: Team, name: &str) -> Result<u32, PlaceError> {
    if let Ok(uid) = name.parse() {
        return Ok(uid);
    }
    let found = users::user_number(name).map_err(|source| PlaceError::System {
        path: name.into(),
        action: "look up the user",
        source,
    })?;
    found.ok_or_else(|| PlaceError::UnknownUser { team: team.name(), name: name.into() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::TeamsAccess;

    fn permissions(yellow: &[&str], blue: &[&str]) -> Result<Permissions, PlaceError> {
        let names = |names: &[&str]| names.iter().map(|name| name.to_string()).collect();
        let teams = TeamsAccess { yellow: names(yellow), blue: names(blue) };
        Permissions::of(&AccessConfig { teams, ..AccessConfig::default() })
    }

    fn commands(robots: &[(Team, u32)]) -> Commands {
        let mut commands = Commands::zeroed();
        for &(team, robot_id) in robots {
            let wheels =
                WheelCommand { team: team as u32, robot_id, left_mm_s: 1.0, right_mm_s: 2.0 };
            commands.wheels[commands.wheel_count as usize] = wheels;
            commands.wheel_count += 1;
        }
        commands
    }

    #[test]
    fn a_user_commands_the_teams_that_name_it_and_those_without_names() {
        let by_all = permissions(&[], &[]).unwrap();
        assert!(by_all.may_command(7, Team::Yellow) && by_all.may_command(8, Team::Blue));
        let divided = permissions(&["1001", "root"], &["1002"]).unwrap();
        for (uid, yellow, blue) in
            [(1001, true, false), (0, true, false), (1002, false, true), (1003, false, false)]
        {
            assert_eq!(divided.may_command(uid, Team::Yellow), yellow, "{uid}");
            assert_eq!(divided.may_command(uid, Team::Blue), blue, "{uid}");
        }
        let error = permissions(&["no-such-user-at-all"], &[]).unwrap_err().to_string();
        assert!(error.contains("access.teams.yellow") && error.contains("no-such-user"), "{error}");
    }

    #[test]
    fn forbidden_commands_are_removed_and_the_rest_stays() {
        let robots = [(Team::Blue, 4), (Team::Yellow, 0), (Team::Blue, 5), (Team::Yellow, 3)];
        let divided = permissions(&["1001"], &[]).unwrap();
        let mut message = commands(&robots);
        assert_eq!(divided.restrict(1001, &mut message), 0);
        assert_eq!(message, commands(&robots));
        assert_eq!(divided.restrict(1002, &mut message), 2);
        assert_eq!(message, commands(&[(Team::Blue, 4), (Team::Blue, 5)]));
        let closed = permissions(&["1"], &["1"]).unwrap();
        assert_eq!((closed.restrict(1002, &mut message), message.wheels().len()), (2, 0));
    }
}
