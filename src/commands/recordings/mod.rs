//! Making and using recordings.

mod configurations;
mod export;
mod info;
mod record;
mod recover;
mod replay;
mod ssl_log;
mod view;

use recording::Damages;
use std::path::Path;

pub use export::export;
pub use info::info;
pub use record::record;
pub use recover::recover;
pub use replay::replay;
pub use view::view;

/// Most damaged parts that are listed individually.
const LISTED_PARTS: usize = 10;

/// Reports damage of a recording, if any, and the remedy.
fn tell_damages(path: &Path, damages: &Damages) {
    tell_parts(path, damages);
    if damages.is_recoverable() {
        runtime::tell!(
            "touchline: `touchline recover {}` makes a proper recording of it",
            path.display()
        );
    }
}

/// Reports damaged parts of a recording, if any.
fn tell_parts(path: &Path, damages: &Damages) {
    if damages.is_empty() {
        return;
    }
    let shown = path.display();
    if !damages.is_finished {
        runtime::tell!("touchline: {shown} was never finished");
    }
    for part in damages.parts.iter().take(LISTED_PARTS) {
        runtime::tell!("touchline: {shown}: {part}");
    }
    let further = damages.count.saturating_sub(LISTED_PARTS as u64);
    if further > 0 {
        runtime::tell!(
            "touchline: {shown}: and {further} further parts; together {} are damaged, {:.2} s of the \
             recording",
            size_text(damages.bytes),
            damages.seconds()
        );
    }
}

/// A size in bytes as text.
fn size_text(bytes: u64) -> String {
    let bytes = bytes as f64;
    match bytes {
        _ if bytes >= 1e9 => format!("{:.1} GB", bytes / 1e9),
        _ if bytes >= 1e6 => format!("{:.1} MB", bytes / 1e6),
        _ => format!("{:.1} kB", bytes / 1e3),
    }
}

/// A duration in seconds as text.
fn time_text(seconds: f64) -> String {
    match seconds {
        _ if seconds >= 3600.0 => {
            format!(
                "{:.0} h {:02.0} min",
                (seconds / 3600.0).floor(),
                (seconds % 3600.0 / 60.0).floor()
            )
        }
        _ if seconds >= 60.0 => {
            format!("{:.0} min {:02.0} s", (seconds / 60.0).floor(), (seconds % 60.0).floor())
        }
        _ => format!("{seconds:.1} s"),
    }
}
