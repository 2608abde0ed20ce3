//! `POST /api/setup/KIND`: work of the set-up, in a process of its own with low priority and a time limit, which is
//! killed when its client leaves. One runs at a time; a few more wait for their turn.

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
use tokio::sync::{Semaphore, SemaphorePermit};

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
    let _turn = turn(&app.jobs, &app.waiting_jobs).await?;
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

/// Waits until earlier jobs are done. A client that leaves loses its place.
async fn turn<'a>(
    jobs: &'a Semaphore,
    waiting: &Semaphore,
) -> Result<SemaphorePermit<'a>, Failure> {
    if let Ok(turn) = jobs.try_acquire() {
        return Ok(turn);
    }
    let full = || {
        Failure::unavailable("other jobs of the set-up are running and waiting")
            .help("another page may have started them; try again when they are done")
    };
    let _place = waiting.try_acquire().map_err(|_| full())?;
    // The semaphore is never closed.
    jobs.acquire().await.map_err(|_| full())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jobs_wait_for_their_turn_and_leave_with_their_client() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        runtime.block_on(async {
            let (jobs, waiting) = (Semaphore::new(1), Semaphore::new(1));
            let first = turn(&jobs, &waiting).await.unwrap();
            {
                let mut second = std::pin::pin!(turn(&jobs, &waiting));
                assert!(has_to_wait(second.as_mut()).await);
                assert!(turn(&jobs, &waiting).await.is_err(), "no room for a third one");
            }
            // The second client has left.
            let third = turn(&jobs, &waiting);
            drop(first);
            assert!(third.await.is_ok());
        });
    }

    /// Whether a future has to wait.
    async fn has_to_wait<F: Future>(future: std::pin::Pin<&mut F>) -> bool {
        let mut future = Some(future);
        std::future::poll_fn(move |context| {
            let pending = future.take().is_some_and(|it| it.poll(context).is_pending());
            std::task::Poll::Ready(pending)
        })
        .await
    }
}
