//! `/api/picture`: the camera's picture, one for each time the browser asks.

use super::access::Rights;
use super::answer::Failure;
use super::app::App;
use super::desk::Kind;
use super::live::{next_text, send, upgrade};
use super::picture::Frame;
use axum::Extension;
use axum::extract::State;
use axum::extract::ws::{Message, WebSocketUpgrade};
use axum::response::Response;
use messages::FrameHeader;
use serde::Deserialize;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// Time between two looks whether the client is still there, while there are no frames.
const PATIENCE: Duration = Duration::from_secs(1);

/// Least time between two pictures for a client. Encoding takes most of the console's processor time, and an eye
/// needs no more.
const PACE: Duration = Duration::from_millis(33);

/// One credit: the picture that a client wants next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(default)]
pub struct Wish {
    /// Divisor of the resolution: 1, 2 or 4.
    scale: u32,
    /// JPEG or raw rows.
    format: Format,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Format {
    Jpeg,
    Raw,
}

impl Default for Wish {
    fn default() -> Self {
        Self { scale: 2, format: Format::Jpeg }
    }
}

impl Wish {
    /// Parses a client's message.
    pub fn parse(text: &str) -> Option<Self> {
        serde_json::from_str(text).ok().filter(Self::is_possible)
    }

    /// Whether there are pictures of this scale.
    pub(crate) fn is_possible(&self) -> bool {
        [1, 2, 4].contains(&self.scale)
    }
}

/// `/api/picture`
pub async fn pictures(
    State(app): State<Arc<App>>,
    Extension(rights): Extension<Rights>,
    socket: WebSocketUpgrade,
) -> Result<Response, Failure> {
    let serving = Arc::clone(&app);
    upgrade(&app, rights, socket, async move |mut socket| {
        let (mut last, mut due) = (None, Instant::now());
        'credits: while let Some(text) = next_text(&mut socket).await {
            let Some(wish) = Wish::parse(&text) else { break };
            tokio::time::sleep_until(due).await;
            due = Instant::now() + PACE;
            let frame = loop {
                if let Some(frame) = next_frame(&serving, last).await {
                    break frame;
                }
                if !send(&mut socket, Message::Ping(Default::default())).await {
                    break 'credits;
                }
            };
            last = Some(frame.header.seq);
            // On a thread of its own: meanwhile topics are read.
            let encoded = tokio::task::spawn_blocking(move || message(&frame, wish)).await;
            let Ok(Some(message)) = encoded else { break };
            if !send(&mut socket, Message::Binary(message.into())).await {
                break;
            }
        }
    })
}

/// The newest frame, if it is not the last one.
pub async fn next_frame(app: &App, last: Option<u64>) -> Option<Arc<Frame>> {
    let mut want = app.desk.want(&[Kind::Frames]);
    let deadline = Instant::now() + PATIENCE;
    while want.round(deadline).await {
        let frame = app.desk.frame(None);
        if let Some(frame) = frame.filter(|frame| Some(frame.header.seq) != last) {
            return Some(frame);
        }
    }
    None
}

/// Length of the header, header, picture.
fn message(frame: &Frame, wish: Wish) -> Option<Vec<u8>> {
    let (header, bytes) = encoded(frame, wish)?;
    let header = header.to_string();
    let mut message = Vec::with_capacity(4 + header.len() + bytes.len());
    message.extend((header.len() as u32).to_le_bytes());
    message.extend(header.as_bytes());
    message.extend(bytes);
    Some(message)
}

/// A frame as a client wishes it: what has to be known of it, and the picture.
pub(crate) fn encoded(frame: &Frame, wish: Wish) -> Option<(Value, Vec<u8>)> {
    let FrameHeader { seq, t_capture_wall_ns, width, height, .. } = frame.header;
    let (size, scale, bytes, format) = match wish.format {
        Format::Raw => ([width, height], 1, frame.rows(), "raw"),
        Format::Jpeg => {
            let picture = frame.reduced(wish.scale)?;
            let size = [picture.width as u32, picture.height as u32];
            (size, wish.scale, picture.jpeg().ok()?, "jpeg")
        }
    };
    let layout = frame.layout();
    let header = json!({
        "seq": seq, "time_s": t_capture_wall_ns as f64 * 1e-9, "width": size[0], "height": size[1],
        "scale": scale, "format": format, "pixel_format": layout.format.name(),
        "bayer": layout.format.is_bayer().then_some(layout.order),
    });
    Some((header, bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wishes_have_defaults_and_bounds() {
        let parse = Wish::parse;
        assert_eq!(parse("{}"), Some(Wish { scale: 2, format: Format::Jpeg }));
        let raw = r#"{"scale":1,"format":"raw"}"#;
        assert_eq!(parse(raw), Some(Wish { scale: 1, format: Format::Raw }));
        for nonsense in ["", r#"{"scale":3}"#, r#"{"scale":0}"#, r#"{"format":"gif"}"#] {
            assert_eq!(parse(nonsense), None, "{nonsense}");
        }
    }

    #[test]
    fn a_message_has_its_header_first() {
        let header = FrameHeader {
            seq: 9,
            width: 4,
            height: 4,
            stride: 6,
            pixel_format: 1,
            ..FrameHeader::default()
        };
        let frame = Frame::copy(&header, &[5; 22], [4, 4]).unwrap();
        let message = message(&frame, Wish { scale: 1, format: Format::Raw }).unwrap();
        let length = u32::from_le_bytes(message[..4].try_into().unwrap()) as usize;
        let json: serde_json::Value = serde_json::from_slice(&message[4..4 + length]).unwrap();
        assert_eq!((json["seq"].as_u64(), json["bayer"].as_str()), (Some(9), Some("rggb")));
        assert_eq!(message.len() - 4 - length, 16);
    }
}
