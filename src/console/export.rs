//! `GET /api/recordings/PLACE/NAME/export/FORM`: what `touchline export` makes of a recording, passed on as it is
//! made, by a process that ends with its client.

use super::answer::{self, Failure};
use super::app::App;
use super::recordings::file;
use axum::body::{Body, HttpBody};
use axum::extract::{Path, State};
use axum::http::header::CONTENT_DISPOSITION;
use axum::http::{HeaderValue, StatusCode};
use axum::response::Response;
use hyper::body::{Bytes, Frame};
use std::io;
use std::pin::Pin;
use std::process::{ExitStatus, Stdio};
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use tokio::io::{AsyncRead, ReadBuf};
use tokio::process::{ChildStdout, Command};
use tokio::sync::OwnedSemaphorePermit;

/// Bytes passed on at a time.
const STEP: usize = 64 << 10;

/// Exports.
pub async fn export(
    State(app): State<Arc<App>>,
    Path((place, name, form)): Path<(String, String, String)>,
) -> Result<Response, Failure> {
    let (option, ending, mime) = match &*form {
        "csv" => ("--csv", "csv", "text/csv"),
        "ssl-log" => ("--ssl-log", "log", "application/octet-stream"),
        _ => {
            return Err(Failure::new(StatusCode::NOT_FOUND, "there is no such form")
                .help("the forms are csv and ssl-log"));
        }
    };
    let path = file(&app, place, name).await?;
    let turn = Arc::clone(&app.exports).try_acquire_owned().map_err(|_| {
        Failure::unavailable("another export is running; try again when it is done")
    })?;
    let mut child = Command::new("/proc/self/exe")
        .args(["export", option, "-", "--"])
        .arg(&path)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .kill_on_drop(true)
        .spawn()
        .map_err(|error| Failure::unavailable(format!("it cannot be exported: {error}")))?;
    let Some(output) = child.stdout.take() else {
        return Err(Failure::unavailable("it cannot be exported"));
    };
    let end = Box::pin(async move { child.wait().await });
    let mut response =
        answer::text(mime, Body::new(Export { output, end, has_ended: false, _turn: turn }));
    // The browser makes a name of it that its system allows.
    let stem = path.file_stem().and_then(|it| it.to_str()).unwrap_or("recording");
    let plain: String = stem
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' })
        .collect();
    let disposition = format!("attachment; filename=\"{plain}.{ending}\"");
    if let Ok(value) = HeaderValue::from_str(&disposition) {
        response.headers_mut().insert(CONTENT_DISPOSITION, value);
    }
    Ok(response)
}

/// The output of the process.
struct Export {
    output: ChildStdout,
    /// Owns the process, which is killed when this is dropped.
    end: Pin<Box<dyn Future<Output = io::Result<ExitStatus>> + Send>>,
    has_ended: bool,
    _turn: OwnedSemaphorePermit,
}

impl HttpBody for Export {
    type Data = Bytes;
    type Error = io::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, io::Error>>> {
        if self.has_ended {
            return Poll::Ready(None);
        }
        let mut buffer = vec![0; STEP];
        let mut read = ReadBuf::new(&mut buffer);
        ready!(Pin::new(&mut self.output).poll_read(context, &mut read))?;
        let count = read.filled().len();
        if count > 0 {
            buffer.truncate(count);
            return Poll::Ready(Some(Ok(Frame::data(buffer.into()))));
        }
        let status = ready!(self.end.as_mut().poll(context))?;
        self.has_ended = true;
        // The client must not take a part for the whole.
        Poll::Ready(match status.success() {
            true => None,
            false => Some(Err(io::Error::other("the export has failed"))),
        })
    }
}
