//! `POST /api/setup/KIND`: work of the set-up, in a process of its own with low priority and a time limit, which is
//! killed when its client leaves.

use super::answer::{self, Failure};
use super::app::App;
use super::changes::whole;
use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::response::Response;
use serde_json::Value;
use std::process::Stdio;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::process::Command;

/// Longest time of a job.
const TIME_LIMIT: Duration = Duration::from_secs(180);
/// Longest answer of a job, bytes: runs of a picture as text.
const MOST_BYTES: u64 = 32 << 20;

/// Runs the job and passes its answer on.
pub async fn run(
    State(app): State<Arc<App>>,
    Path(kind): Path<String>,
    body: Body,
) -> Result<Response, Failure> {
    // It becomes an argument of a program.
    if !kind.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'-') || kind.starts_with('-')
    {
        return Err(Failure::new(StatusCode::NOT_FOUND, "there is no such job"));
    }
    let request = whole(body).await?;
    let _place = app.jobs.try_acquire().map_err(|_| {
        Failure::unavailable("another job is running").help("try again when it is done")
    })?;
    let work = work(app.instance.name(), &kind, &request);
    match tokio::time::timeout(TIME_LIMIT, work).await {
        Err(_) => Err(Failure::new(
            StatusCode::GATEWAY_TIMEOUT,
            format!("not done after {} seconds", TIME_LIMIT.as_secs()),
        )),
        Ok(Err(error)) => Err(Failure::unavailable(format!("the job cannot be run: {error}"))),
        Ok(Ok((done, text))) => passed_on(done, &text),
    }
}

async fn work(instance: &str, kind: &str, request: &[u8]) -> std::io::Result<(bool, Vec<u8>)> {
    // It has the low priority of this process.
    let mut worker = Command::new("/proc/self/exe")
        .args(["setup-worker", kind, "--instance", instance])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .kill_on_drop(true)
        .spawn()?;
    let (mut input, output) = (worker.stdin.take(), worker.stdout.take());
    if let Some(input) = &mut input {
        // A worker that refuses the request at once reads nothing.
        let _ = input.write_all(request).await;
    }
    drop(input);
    let mut text = Vec::new();
    if let Some(output) = output {
        output.take(MOST_BYTES).read_to_end(&mut text).await?;
    }
    Ok((worker.wait().await?.success(), text))
}

fn passed_on(done: bool, text: &[u8]) -> Result<Response, Failure> {
    let value: Option<Value> = serde_json::from_slice(text).ok();
    match value {
        Some(value) if done => Ok(answer::of(&value)),
        value => {
            let message = value.as_ref().and_then(|it| it["error"]["message"].as_str());
            let message = message.unwrap_or("the job has ended without an answer");
            Err(Failure::new(StatusCode::UNPROCESSABLE_ENTITY, message))
        }
    }
}
