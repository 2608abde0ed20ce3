//! The console: a page in a browser to set up and watch a group by, and the same data for other programs.
//!
//! It reads topics like any consumer, holds no authority, and may die at any time. While no client is connected it
//! receives nothing. Changes go through requests to the supervisor, as those of the command line do.
//!
//! Everything runs on one thread, beside which only pictures are encoded: [`reading`] reads topics and puts the
//! newest of what clients wait for on a [`desk`]; [`server`] accepts connections, [`routes`] lets through what
//! [`access`] permits, and a task for each client takes from the desk. [`scene`] turns messages into what a page
//! draws, [`picture`] frames into pictures. [`changes`] asks the supervisor for what [`changing`] has checked,
//! [`saving`] writes it into the user's file, [`jobs`] sets a pitch up. [`recording`] records,
//! [`recordings`] shows what was recorded, by processes of [`viewers`] and [`export`]. [`place`] is where the console is found.

pub mod access;
mod answer;
mod app;
mod changes;
pub mod changing;
mod desk;
mod export;
pub mod foxglove;
mod jobs;
pub mod live;
mod metrics;
mod page;
pub mod peer;
pub(crate) mod picture;
pub mod pictures;
mod place;
pub(crate) mod reading;
mod recording;
mod recordings;
mod routes;
pub mod saving;
pub(crate) mod scene;
mod server;
mod shelf;
mod still;
mod viewers;

pub use place::Place;

use crate::attendants::{AttendantError, Row};
use app::App;
use client::bus::BusError;
use client::instance::Instance;
use config::Config;
use messages::Attendant;
use reading::Reading;
use runtime::attendant::AttendantProcess;
use runtime::process::{MAX_WAIT, ProcessError};
use std::io::{self, IsTerminal};
use std::net::TcpListener;
use std::sync::Arc;
use std::time::Duration;

/// Time between two rounds of reading while a client waits, at most; at high frame rates half a frame.
const ROUND: Duration = Duration::from_millis(4);
/// Time between two attempts to listen at an address that this computer does not have yet.
const LISTEN_AGAIN: Duration = Duration::from_secs(1);
/// Below the stages and everything else that a match needs.
const NICE: i32 = 10;
/// Threads that encode pictures and wait for the supervisor.
const HELPERS: usize = 4;
/// Most lines about topics that cannot be read.
const MOST_COMPLAINTS: u32 = 20;

/// Reason for which the console cannot go on.
#[derive(Debug, thiserror::Error)]
enum ConsoleError {
    /// The configuration has none.
    #[error("[console] enabled is false")]
    NotConfigured,
    /// Its process failed.
    #[error(transparent)]
    Process(#[from] ProcessError),
    /// Shared memory failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The system refused something.
    #[error("{0}")]
    System(#[from] io::Error),
}

/// The console's row in the table of attendants.
pub const ROW: Row = Row {
    attendant: Attendant::Console,
    about: "The console: a page for browsers",
    prepare,
    run: |instance, config, supervised| Ok(run(instance, config, supervised)?),
    // The page fetches everything else anew when the revision has changed.
    reads: &["console"],
    remove: |_| Ok(()),
};

/// Chooses the address and says it. A match does not depend on it, so that nothing here ends its start.
fn prepare(instance: &Instance, config: &Config) -> Result<bool, AttendantError> {
    if !config.console.enabled {
        Place::remove(instance);
        return Ok(false);
    }
    let earlier = Place::read(instance);
    let chosen = Place::choose(&config.console, earlier.as_ref())
        .and_then(|place| place.write(instance).map(|()| place));
    match chosen {
        Ok(place) => {
            for line in place.words(io::stderr().is_terminal()).lines() {
                runtime::tell!("touchline: {line}");
            }
            Ok(true)
        }
        Err(error) => {
            runtime::tell!("touchline: there is no console: {error}");
            Ok(false)
        }
    }
}

/// Runs until it is told to end, or its group is gone.
fn run(instance: &Instance, config: &Config, supervised: bool) -> Result<(), ConsoleError> {
    if !config.console.enabled {
        return Err(ConsoleError::NotConfigured);
    }
    let process = AttendantProcess::start(Attendant::Console, instance, config, supervised)?;
    // A refusal is harmless.
    let _ = rustix::process::nice(NICE);
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .enable_time()
        .max_blocking_threads(HELPERS)
        .build()?;
    let outcome = runtime.block_on(tend(process, instance, config));
    // Clients are not waited for.
    runtime.shutdown_background();
    outcome
}

async fn tend(
    mut process: AttendantProcess,
    instance: &Instance,
    config: &Config,
) -> Result<(), ConsoleError> {
    let Some((listener, place)) = listen(&mut process, instance, config).await? else {
        return Ok(());
    };
    let listener = tokio::net::TcpListener::from_std(listener)?;
    let app = Arc::new(App::new(instance, place, &config.console));
    let desk = Arc::clone(&app.desk);
    tokio::spawn(server::serve(listener, Arc::clone(&app)));
    let round = ROUND.min(Duration::from_secs_f64(0.5 / config.camera.fps.max(1.0)));
    let mut reading = Reading::new(instance);
    let mut complaints = 0;
    while process.keep_running(|_| ())? {
        if let Err(error) = reading.round(&process.bus, &desk) {
            // All places of a topic may be taken for a while; pages that wait for others are served.
            if complaints < MOST_COMPLAINTS {
                complaints += 1;
                runtime::tell!("console: {error}; it is tried again");
            }
            reading = Reading::new(instance);
            desk.end_round();
            desk.pause(MAX_WAIT).await;
        }
        if desk.is_busy() {
            tokio::time::sleep(round).await;
        } else {
            desk.pause(MAX_WAIT).await;
        }
    }
    // It would wait for the next group of this name.
    app.recordings.stop(Duration::ZERO);
    Ok(())
}

/// Listens at the address that was chosen when the group started. Keeps trying while the computer has no such
/// address. `None` when the process is to end.
async fn listen(
    process: &mut AttendantProcess,
    instance: &Instance,
    config: &Config,
) -> Result<Option<(TcpListener, Place)>, ConsoleError> {
    let chosen = match Place::read(instance) {
        Some(place) => place,
        None => Place::choose(&config.console, None)?,
    };
    let mut told = false;
    loop {
        match chosen.listen() {
            Ok((listener, place)) => {
                // Another program may have taken the port meanwhile.
                place.write(instance)?;
                return Ok(Some((listener, place)));
            }
            Err(error) if !told => {
                told = true;
                runtime::tell!("console: {}: {error}; it is tried again", chosen.address);
            }
            Err(_) => {}
        }
        for _ in 0..LISTEN_AGAIN.as_millis() / MAX_WAIT.as_millis() {
            if !process.keep_running(|_| ())? {
                return Ok(None);
            }
            tokio::time::sleep(MAX_WAIT).await;
        }
    }
}
