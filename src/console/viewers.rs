//! Processes that read recordings for the page: one for each opened recording, with the console's low priority.
//! One that is not asked for some time, takes too long for an answer, or fails, is ended.

use super::answer::Failure;
use axum::http::StatusCode;
use client::instance::Instance;
use serde_json::Value;
use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::process::{Child, ChildStdin, ChildStdout, Command};
use tokio::sync::{mpsc, oneshot};

/// Most recordings that are open at the same time; another one closes that which was asked longest ago.
const MOST_OPEN: usize = 3;
/// Questions that wait for one recording.
const MOST_WAITING: usize = 16;
/// Longest time for an answer. Opening a long recording that was never finished means reading all of it.
const TIME_LIMIT: Duration = Duration::from_secs(60);
/// A recording that nobody asks for is closed after this time.
const IDLE: Duration = Duration::from_secs(120);
/// Largest header and largest picture of an answer.
const MOST_BYTES: u32 = 64 << 20;

/// Header and bytes.
pub type Answer = (Value, Vec<u8>);

/// The opened recordings.
pub struct Viewers {
    instance: Instance,
    /// The one that was asked last comes last.
    open: Mutex<Vec<Viewer>>,
}

struct Viewer {
    path: PathBuf,
    stamp: Option<(u64, i64, u64)>,
    questions: mpsc::Sender<Question>,
}

struct Question {
    line: Vec<u8>,
    answer: oneshot::Sender<Result<Answer, Failure>>,
}

impl Viewers {
    /// None is open.
    pub fn new(instance: &Instance) -> Self {
        Self { instance: instance.clone(), open: Mutex::default() }
    }

    /// Asks a recording, which is opened first if need be; anew, if `is_first` and the file has changed.
    pub async fn ask(
        &self,
        path: &Path,
        question: &Value,
        is_first: bool,
    ) -> Result<Answer, Failure> {
        let (sender, answer) = oneshot::channel();
        let mut line = question.to_string().into_bytes();
        line.push(b'\n');
        let questions = self.questions_of(path, is_first)?;
        questions.try_send(Question { line, answer: sender }).map_err(|_| {
            Failure::unavailable("too many questions about this recording at the same time")
        })?;
        let failed = || {
            Failure::unavailable("the process that reads this recording has ended")
                .help("open it again; `touchline info` says whether the file is whole")
        };
        let (header, bytes) = answer.await.unwrap_or_else(|_| Err(failed()))?;
        match header["error"]["message"].as_str() {
            Some(message) => Err(Failure::new(StatusCode::UNPROCESSABLE_ENTITY, message)),
            None => Ok((header, bytes)),
        }
    }

    /// Where questions about a recording go.
    fn questions_of(&self, path: &Path, is_first: bool) -> Result<mpsc::Sender<Question>, Failure> {
        // The lock is never poisoned: a panic ends the process.
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        open.retain(|it| !it.questions.is_closed());
        let stamp = fs::metadata(path).ok().map(|it| (it.ino(), it.mtime(), it.len()));
        if let Some(at) = open.iter().position(|it| it.path == path) {
            let viewer = open.remove(at);
            if !is_first || viewer.stamp == stamp {
                let questions = viewer.questions.clone();
                open.push(viewer);
                return Ok(questions);
            }
        }
        if open.len() >= MOST_OPEN {
            open.remove(0);
        }
        let process = Process::start(&self.instance, path).map_err(|error| {
            Failure::unavailable(format!("no process to read the recording: {error}"))
        })?;
        let (questions, asked) = mpsc::channel(MOST_WAITING);
        tokio::spawn(serve(process, asked));
        open.push(Viewer { path: path.into(), stamp, questions: questions.clone() });
        Ok(questions)
    }
}

/// Passes questions on, one at a time, until nobody asks any more.
async fn serve(mut process: Process, mut asked: mpsc::Receiver<Question>) {
    while let Ok(Some(question)) = tokio::time::timeout(IDLE, asked.recv()).await {
        // Its client has gone.
        if question.answer.is_closed() {
            continue;
        }
        let answer = tokio::time::timeout(TIME_LIMIT, process.ask(&question.line)).await;
        let (answer, is_over) = match answer {
            Ok(Ok(answer)) => (Ok(answer), false),
            Ok(Err(error)) => {
                (Err(Failure::unavailable(format!("the recording cannot be read: {error}"))), true)
            }
            Err(_) => {
                let message = format!("not done after {} seconds", TIME_LIMIT.as_secs());
                let failure = Failure::new(StatusCode::GATEWAY_TIMEOUT, message);
                (Err(failure.help("`touchline recover` gives a recording its index")), true)
            }
        };
        let _ = question.answer.send(answer);
        if is_over {
            break;
        }
    }
}

/// `touchline recording-viewer`; killed when it is dropped.
struct Process {
    _child: Child,
    input: ChildStdin,
    output: ChildStdout,
}

impl Process {
    fn start(instance: &Instance, path: &Path) -> io::Result<Self> {
        let mut child = Command::new("/proc/self/exe")
            .args(["recording-viewer", "--instance", instance.name(), "--"])
            .arg(path)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .kill_on_drop(true)
            .spawn()?;
        let missing = || io::Error::other("it has no input or output");
        let input = child.stdin.take().ok_or_else(missing)?;
        let output = child.stdout.take().ok_or_else(missing)?;
        Ok(Self { _child: child, input, output })
    }

    async fn ask(&mut self, line: &[u8]) -> io::Result<Answer> {
        self.input.write_all(line).await?;
        let header = self.part().await?;
        let bytes = self.part().await?;
        Ok((serde_json::from_slice(&header)?, bytes))
    }

    async fn part(&mut self) -> io::Result<Vec<u8>> {
        let length = self.output.read_u32_le().await?;
        if length > MOST_BYTES {
            return Err(io::Error::other("its answer is too long"));
        }
        let mut bytes = vec![0; length as usize];
        self.output.read_exact(&mut bytes).await?;
        Ok(bytes)
    }
}
