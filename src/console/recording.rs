//! A recording that the page starts and stops: `touchline record` in a process of its own, which ends with this
//! one.

use super::answer::{self, Failure};
use super::app::App;
use super::changes::parsed;
use super::recordings::own_directory;
use axum::body::Body;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use client::instance::Instance;
use client::private;
use rustix::process::{Pid, Signal, kill_process};
use serde::Deserialize;
use serde_json::{Value, json};
use std::fs;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::ChildStdout;

/// Time for a recording to be completed on a slow disk; then it goes on by itself.
const PATIENCE: Duration = Duration::from_secs(10);
const LOOK: Duration = Duration::from_millis(20);

/// The recording that runs, if one does.
pub struct Recordings {
    instance: Instance,
    running: Mutex<Option<Running>>,
    /// Files of all recordings that were started here.
    paths: Mutex<Vec<PathBuf>>,
}

struct Running {
    child: Child,
    path: PathBuf,
    since_s: f64,
    progress: Arc<Mutex<Progress>>,
}

/// A line of `touchline record --progress`.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
pub struct Progress {
    /// The newest file.
    path: PathBuf,
    /// Bytes in all files.
    bytes: u64,
    /// Messages that were dropped because the disk was too slow.
    dropped: u64,
    /// Frames that never reached the recorder.
    missed: u64,
}

impl Progress {
    /// Parses a line.
    pub fn parse(line: &str) -> Option<Self> {
        serde_json::from_str(line).ok()
    }
}

impl Recordings {
    /// None runs.
    pub fn new(instance: &Instance) -> Self {
        Self { instance: instance.clone(), running: Mutex::default(), paths: Mutex::default() }
    }

    /// Starts one; into a new file of the user's state directory if no path is given.
    fn start(&self, path: Option<PathBuf>) -> Result<PathBuf, Failure> {
        let refused = |message: String| Failure::new(StatusCode::UNPROCESSABLE_ENTITY, message);
        let mut running = self.lock();
        if running.as_mut().is_some_and(Running::lives) {
            return Err(Failure::new(StatusCode::CONFLICT, "a recording runs already"));
        }
        let now_s = since_1970().as_secs_f64();
        let path = match path {
            Some(path) if path.extension().is_none_or(|it| it != "mcap") => {
                return Err(refused("the name of a recording ends with .mcap".into()));
            }
            Some(path) => std::path::absolute(path).map_err(|error| refused(error.to_string()))?,
            None => {
                let directory = own_directory();
                private::create_directory(&directory)
                    .map_err(|error| refused(error.to_string()))?;
                directory.join(format!("{}-{now_s:.0}.mcap", self.instance.name()))
            }
        };
        let mut command = Command::new("/proc/self/exe");
        command
            .args(["record", "--quiet", "--progress", "--instance", self.instance.name(), "--"])
            .arg(&path)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null());
        let mut child = command.spawn().map_err(|error| refused(error.to_string()))?;
        let progress = Arc::new(Mutex::new(Progress::default()));
        // Without its lines it records as well.
        if let Some(Ok(output)) = child.stdout.take().map(ChildStdout::from_std) {
            tokio::spawn(follow(output, Arc::clone(&progress)));
        }
        *running = Some(Running { child, path: path.clone(), since_s: now_s, progress });
        drop(running);
        self.lock_paths().push(path.clone());
        Ok(path)
    }

    /// Asks it to end; waits for that only if `patience` allows.
    pub fn stop(&self, patience: Duration) -> Option<PathBuf> {
        let mut running = self.lock().take()?;
        if let Some(pid) = Pid::from_raw(running.child.id() as i32) {
            // It is our child and was not reaped yet, so the number is still its own.
            let _ = kill_process(pid, Signal::TERM);
        }
        for _ in 0..patience.as_millis() / LOOK.as_millis() {
            if !running.lives() {
                break;
            }
            std::thread::sleep(LOOK);
        }
        Some(running.path)
    }

    /// For the status: `null` if none runs.
    pub fn json(&self) -> Value {
        let mut running = self.lock();
        let Some(it) = running.as_mut() else { return Value::Null };
        if !it.lives() {
            return Value::Null;
        }
        let Progress { path, bytes, dropped, missed } =
            it.progress.lock().unwrap_or_else(PoisonError::into_inner).clone();
        // Nothing was said yet.
        let path = if path.as_os_str().is_empty() { it.path.clone() } else { path };
        let bytes = bytes.max(fs::metadata(&path).map_or(0, |data| data.len()));
        let free = it.path.parent().and_then(|place| rustix::fs::statvfs(place).ok());
        let free_bytes = free.map(|free| free.f_bavail * free.f_frsize);
        json!({
            "path": path, "since_s": it.since_s, "bytes": bytes, "free_bytes": free_bytes,
            "dropped": dropped, "missed": missed, "lost": dropped + missed,
        })
    }

    /// Files of all recordings that were started here.
    pub fn paths(&self) -> Vec<PathBuf> {
        self.lock_paths().clone()
    }

    fn lock_paths(&self) -> MutexGuard<'_, Vec<PathBuf>> {
        self.paths.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn lock(&self) -> MutexGuard<'_, Option<Running>> {
        self.running.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Keeps the newest line of progress, until the process ends.
async fn follow(output: ChildStdout, progress: Arc<Mutex<Progress>>) {
    let mut lines = BufReader::new(output).lines();
    while let Ok(Some(line)) = lines.next_line().await {
        if let Some(newest) = Progress::parse(&line) {
            *progress.lock().unwrap_or_else(PoisonError::into_inner) = newest;
        }
    }
}

impl Running {
    fn lives(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }
}

/// The report with the recording in it.
pub fn in_report(report: &str, app: &App) -> String {
    match report.trim_end().strip_suffix('}') {
        Some(rest) => format!("{rest},\"recording\":{}}}", app.recordings.json()),
        None => report.into(),
    }
}

fn since_1970() -> Duration {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RecordRequest {
    start: bool,
    #[serde(default)]
    path: Option<PathBuf>,
}

/// `POST /api/record`
pub async fn record(State(app): State<Arc<App>>, body: Body) -> Result<Response, Failure> {
    let RecordRequest { start, path } = parsed(body).await?;
    let path = if start {
        Some(app.recordings.start(path)?)
    } else {
        let stopping = Arc::clone(&app);
        let stopped = tokio::task::spawn_blocking(move || stopping.recordings.stop(PATIENCE)).await;
        let path = stopped.ok().flatten();
        if path.is_none() {
            return Err(Failure::new(StatusCode::CONFLICT, "no recording of this page runs"));
        }
        path
    };
    Ok(answer::of(&json!({ "path": path })))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_progress_are_understood() {
        let line = r#"{"path":"/tmp/a.mcap","bytes":5,"dropped":2,"missed":1}"#;
        let progress = Progress { path: "/tmp/a.mcap".into(), bytes: 5, dropped: 2, missed: 1 };
        assert_eq!(Progress::parse(line), Some(progress));
        assert_eq!(Progress::parse("recorded 3 frames"), None);
    }
}
