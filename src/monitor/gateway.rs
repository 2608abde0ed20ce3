//! State of the gateway, for the report.

use client::bus::{Bus, BusError, Stranger, Subscriber};
use client::instance::Instance;
use config::Config;
use control::report::{AttendantState, Gateway};
use messages::topics;
use messages::{Attendant, GatewayReport};
use std::collections::BTreeMap;

/// Reads the gateway's reports.
pub struct GatewayWatch {
    reports: Subscriber<GatewayReport, ()>,
    /// From any of its processes.
    newest: Option<GatewayReport>,
    /// Group and socket; `None` if only the owner may attach.
    place: Option<Gateway>,
}

impl GatewayWatch {
    /// Connects.
    pub fn new(bus: &Bus, instance: &Instance, config: &Config) -> Result<Self, BusError> {
        let place = config.access.group().map(|group| Gateway {
            group: group.into(),
            socket: instance.gateway_path().display().to_string(),
            ..Gateway::default()
        });
        Ok(Self { reports: bus.subscriber(&topics::GATEWAY)?, newest: None, place })
    }

    /// Reads new reports.
    pub fn collect(&mut self) -> Result<(), BusError> {
        while let Some(received) = self.reports.receive()? {
            self.newest = received.message().copied().or(self.newest);
        }
        Ok(())
    }

    /// Foreign programs that have published such reports since the last call.
    pub fn take_strangers(&self) -> Vec<Stranger> {
        self.reports.take_strangers()
    }

    /// What the supervisor knows of it, with the counts of its present process.
    pub fn report(&self, attendants: &BTreeMap<String, AttendantState>) -> Option<Gateway> {
        let known = attendants.get(Attendant::Gateway.name()).copied().unwrap_or_default();
        let own = self.newest.filter(|report| Some(report.pid) == known.pid);
        Some(Gateway {
            pid: known.pid,
            restarts: known.restarts,
            clients: own.map_or(0, |report| report.clients),
            given: own.map_or(0, |report| report.given),
            lost: own.map_or(0, |report| report.lost),
            not_permitted: own.map_or(0, |report| report.not_permitted),
            refused: own.map_or(0, |report| report.refused),
            ..self.place.clone()?
        })
    }
}
