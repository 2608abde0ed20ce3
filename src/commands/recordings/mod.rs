//! Making and using recordings.

mod export;
mod info;
mod record;
mod recover;
mod replay;

pub use export::export;
pub use info::info;
pub use record::record;
pub use recover::recover;
pub use replay::replay;

/// A number of bytes for people.
fn size_text(bytes: u64) -> String {
    let bytes = bytes as f64;
    match bytes {
        _ if bytes >= 1e9 => format!("{:.1} GB", bytes / 1e9),
        _ if bytes >= 1e6 => format!("{:.1} MB", bytes / 1e6),
        _ => format!("{:.1} kB", bytes / 1e3),
    }
}

/// A number of seconds for people.
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
