//! Publishing configuration: the protocols of the leagues, over UDP.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::net::{Ipv4Addr, SocketAddrV4};

/// Which of the leagues' own protocols are sent to other programs, and received from them; see
/// docs/leagues.md. Nothing is sent unless a protocol is `enabled`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PublishConfig {
    /// Network interfaces for multicast, by name ("eth0") or by one of their IPv4 addresses. Empty: all
    /// that are up and can, and the loopback interface if there is no other.
    #[schemars(length(max = 64))]
    pub interfaces: Vec<String>,
    /// Number of networks that a multicast packet may cross: 1 stays in the local network, 0 on this
    /// machine.
    #[schemars(range(min = 0, max = 255))]
    pub ttl: u32,
    /// Whether programs on this machine also receive multicast.
    pub loopback: bool,
    /// Markings of the pitch. Only published: recognition and the synthetic pitch do not use them.
    pub markings: MarkingsConfig,
    /// SSL-Vision: what the camera sees in each frame, in mm; once a second the field and the camera's
    /// calibration.
    pub ssl: SslConfig,
    /// SSL tracker: filtered positions and velocities, in metres.
    pub tracked: TrackedConfig,
    /// FIRASim, as used by the IEEE VSSS: filtered positions and velocities, in metres.
    pub firasim: OutputConfig,
    /// The vision of VSSS teams that read SSL-Vision's packets: filtered positions, in mm.
    pub vss: OutputConfig,
    /// Filtered positions and velocities, one JSON text in each packet, for programs without Protocol
    /// Buffers.
    pub json: OutputConfig,
    /// Commands of FIRASim's clients: they drive the robots of the synthetic match, and inform the
    /// filter.
    pub commands: CommandsConfig,
}

/// Markings of the pitch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MarkingsConfig {
    /// Width of the lines.
    #[schemars(range(min = 0, max = 1000))]
    pub line_width_mm: f64,
    /// Depth of the penalty areas, from the goal line.
    #[schemars(range(min = 0, max = 100_000))]
    pub penalty_depth_mm: f64,
    /// Width of the penalty areas, along the goal line.
    #[schemars(range(min = 0, max = 100_000))]
    pub penalty_width_mm: f64,
    /// Distance of the penalty mark from the centre of the goal.
    #[schemars(range(min = 0, max = 100_000))]
    pub penalty_mark_mm: f64,
    /// Carpet outside the touch lines.
    #[schemars(range(min = 0, max = 10_000))]
    pub boundary_mm: f64,
    /// Carpet outside the goal lines.
    #[schemars(range(min = 0, max = 10_000))]
    pub goal_boundary_mm: f64,
    /// Height of the goals.
    #[schemars(range(min = 0, max = 10_000))]
    pub goal_height_mm: f64,
}

/// SSL-Vision.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SslConfig {
    /// Whether it is sent.
    pub enabled: bool,
    /// Receivers, each "ADDRESS:PORT": multicast groups, broadcast addresses (for switches that do not
    /// forward multicast) or single computers.
    #[schemars(length(min = 1, max = 64))]
    pub to: Vec<String>,
    /// "detections": robots and balls as found in each frame alone, as the league's own vision sends
    /// them. "world": as filtered, without gaps, a little later.
    pub from: PublishedTopic,
    /// Whether field and calibration are sent once a second.
    pub geometry: bool,
}

/// Topics that can be published as SSL-Vision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum PublishedTopic {
    /// The tracker's output.
    Detections,
    /// The filter's output.
    World,
}

/// SSL tracker.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TrackedConfig {
    /// Whether it is sent.
    pub enabled: bool,
    /// Receivers, each "ADDRESS:PORT".
    #[schemars(length(min = 1, max = 64))]
    pub to: Vec<String>,
    /// Name by which receivers list this tracker.
    #[schemars(length(min = 1, max = 64))]
    pub source_name: String,
}

/// A protocol without settings of its own. Missing keys have the defaults of its protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OutputConfig {
    /// Whether it is sent.
    #[serde(default)]
    pub enabled: bool,
    /// Receivers, each "ADDRESS:PORT".
    #[serde(default)]
    #[schemars(length(min = 1, max = 64))]
    pub to: Vec<String>,
}

/// Commands of FIRASim's clients.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CommandsConfig {
    /// Whether they are received.
    pub enabled: bool,
    /// UDP port at which they are received.
    #[schemars(range(min = 1, max = 65_535))]
    pub port: u16,
    /// IPv4 addresses from which they are accepted. Packets from other addresses are dropped and
    /// counted.
    #[schemars(length(max = 64))]
    pub allow: Vec<String>,
    /// Radius of the wheels: the clients' speeds are angular, in rad/s.
    #[schemars(range(min = 1, max = 1000))]
    pub wheel_radius_mm: f64,
}

/// Where a protocol is sent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Output<'a> {
    /// Key of its section in `[publish]`.
    pub name: &'static str,
    /// Whether it is sent.
    pub enabled: bool,
    /// Receivers as configured.
    pub to: &'a [String],
}

impl Output<'_> {
    /// Its receivers. Entries that are no addresses, which no checked configuration has, are left out.
    pub fn receivers(&self) -> Vec<SocketAddrV4> {
        self.to.iter().filter_map(|text| text.parse().ok()).collect()
    }
}

impl PublishConfig {
    /// All protocols that can be sent.
    pub fn outputs(&self) -> [Output<'_>; 5] {
        let Self { ssl, tracked, firasim, vss, json, .. } = self;
        [
            Output { name: "ssl", enabled: ssl.enabled, to: &ssl.to },
            Output { name: "tracked", enabled: tracked.enabled, to: &tracked.to },
            Output { name: "firasim", enabled: firasim.enabled, to: &firasim.to },
            Output { name: "vss", enabled: vss.enabled, to: &vss.to },
            Output { name: "json", enabled: json.enabled, to: &json.to },
        ]
    }

    /// Whether anything is sent or received.
    pub fn is_used(&self) -> bool {
        self.commands.enabled || self.outputs().iter().any(|output| output.enabled)
    }

    /// Switches a protocol on: the name of its section, or "commands"; `false` when there is none.
    pub fn enable(&mut self, name: &str) -> bool {
        let switches = self.switches().into_iter();
        switches.filter(|(key, _)| *key == name).map(|(_, enabled)| *enabled = true).count() > 0
    }

    /// Switches everything off.
    pub fn disable_all(&mut self) {
        self.switches().into_iter().for_each(|(_, enabled)| *enabled = false);
    }

    fn switches(&mut self) -> [(&'static str, &mut bool); 6] {
        [
            ("ssl", &mut self.ssl.enabled),
            ("tracked", &mut self.tracked.enabled),
            ("firasim", &mut self.firasim.enabled),
            ("vss", &mut self.vss.enabled),
            ("json", &mut self.json.enabled),
            ("commands", &mut self.commands.enabled),
        ]
    }
}

impl CommandsConfig {
    /// Addresses from which commands are accepted.
    pub fn allowed(&self) -> Vec<Ipv4Addr> {
        self.allow.iter().filter_map(|text| text.parse().ok()).collect()
    }
}

impl Default for PublishConfig {
    fn default() -> Self {
        let output = |to: &str| OutputConfig { enabled: false, to: vec![to.into()] };
        Self {
            interfaces: Vec::new(),
            ttl: 32,
            loopback: true,
            markings: MarkingsConfig::default(),
            ssl: SslConfig::default(),
            tracked: TrackedConfig::default(),
            firasim: output("224.0.0.1:10002"),
            vss: output("224.5.23.2:10015"),
            json: output("127.0.0.1:10030"),
            commands: CommandsConfig::default(),
        }
    }
}

impl Default for MarkingsConfig {
    /// The markings of the VSSS; the MiroSot middle league has nearly the same.
    fn default() -> Self {
        Self {
            line_width_mm: 3.0,
            penalty_depth_mm: 150.0,
            penalty_width_mm: 700.0,
            penalty_mark_mm: 375.0,
            boundary_mm: 0.0,
            goal_boundary_mm: 0.0,
            goal_height_mm: 100.0,
        }
    }
}

impl MarkingsConfig {
    /// The markings of the SSL, division B.
    pub(super) fn ssl_division_b() -> Self {
        Self {
            line_width_mm: 10.0,
            penalty_depth_mm: 1000.0,
            penalty_width_mm: 2000.0,
            penalty_mark_mm: 6000.0,
            boundary_mm: 300.0,
            goal_boundary_mm: 300.0,
            goal_height_mm: 160.0,
        }
    }
}

impl Default for SslConfig {
    fn default() -> Self {
        Self {
            enabled: false,
            to: vec!["224.5.23.2:10006".into()],
            from: PublishedTopic::Detections,
            geometry: true,
        }
    }
}

impl Default for TrackedConfig {
    fn default() -> Self {
        Self {
            enabled: false,
            to: vec!["224.5.23.2:10010".into()],
            source_name: "Touchline".into(),
        }
    }
}

impl Default for CommandsConfig {
    fn default() -> Self {
        Self {
            enabled: false,
            port: 20_011,
            allow: vec!["127.0.0.1".into()],
            wheel_radius_mm: 26.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Preset;

    #[test]
    fn nothing_is_published_unless_configured() {
        for preset in Preset::ALL {
            assert!(!preset.config().publish.is_used(), "{}", preset.name());
        }
        let mut publish = PublishConfig::default();
        let names: Vec<&str> = publish.outputs().map(|output| output.name).to_vec();
        for (index, name) in names.into_iter().enumerate() {
            assert!(publish.enable(name));
            assert!(publish.outputs()[index].enabled, "{name}");
            assert!(publish.outputs()[index + 1..].iter().all(|output| !output.enabled));
        }
        assert!(!publish.enable("ros") && !publish.commands.enabled);
        assert!(publish.enable("commands") && publish.commands.enabled);
        publish.disable_all();
        assert!(!publish.is_used());
    }

    #[test]
    fn default_receivers_are_addresses() {
        for output in PublishConfig::default().outputs() {
            assert_eq!(output.receivers().len(), output.to.len(), "{}", output.name);
        }
        assert_eq!(CommandsConfig::default().allowed(), [Ipv4Addr::LOCALHOST]);
    }
}
