//! The web sockets with what the group found: `/api/live` for the page, `/api/world` for other programs.

use super::access::Rights;
use super::answer::Failure;
use super::app::App;
use super::desk::{Kind, News};
use axum::Extension;
use axum::extract::State;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::response::Response;
use serde::Deserialize;
use serde_json::Value;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::OwnedSemaphorePermit;
use tokio::time::Instant;

/// Longest wait for news; then the answer is empty.
const PATIENCE: Duration = Duration::from_secs(1);
/// Longest time for sending a message to a slow client.
const SEND_PATIENCE: Duration = Duration::from_secs(10);
/// Shortest time between two messages of a client: it may send a few hundred a second.
const PACE: Duration = Duration::from_millis(2);
/// Largest message of a client.
const MOST_BYTES: usize = 64 << 10;

/// One credit: what a client wants next.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
pub struct Credit {
    /// Kinds, by name.
    want: Vec<String>,
    /// The newest numbers that it has, by kind.
    after: serde_json::Map<String, Value>,
}

impl Credit {
    /// Parses a client's message.
    pub fn parse(text: &str) -> Option<Self> {
        serde_json::from_str(text).ok()
    }

    /// Valid kinds, each once.
    pub fn kinds(&self) -> Vec<Kind> {
        let is_wanted = |kind: &Kind| self.want.iter().any(|name| name == kind.name());
        Kind::LIVE.into_iter().filter(is_wanted).collect()
    }

    /// Whether these news are newer than what the client has. Smaller numbers are those of another group, whose
    /// client has not noticed yet.
    pub fn is_new(&self, kind: Kind, news: &News) -> bool {
        self.after.get(kind.name()).and_then(Value::as_u64) != Some(news.seq)
    }
}

/// Takes a free socket, and upgrades the connection.
pub fn upgrade<F, S>(
    app: &App,
    rights: Rights,
    socket: WebSocketUpgrade,
    serve: F,
) -> Result<Response, Failure>
where
    F: FnOnce(WebSocket) -> S + Send + 'static,
    S: Future<Output = ()> + Send + 'static,
{
    let places = match rights {
        Rights::Change => &app.sockets,
        Rights::Watch => &app.watching_sockets,
    };
    let place: OwnedSemaphorePermit = Arc::clone(places)
        .try_acquire_owned()
        .map_err(|_| Failure::unavailable("too many pages are open; close some"))?;
    Ok(socket.max_message_size(MOST_BYTES).max_frame_size(MOST_BYTES).on_upgrade(
        async move |socket| {
            serve(socket).await;
            drop(place);
        },
    ))
}

/// Sends a message; whether the client took it in time.
pub async fn send(socket: &mut WebSocket, message: Message) -> bool {
    matches!(tokio::time::timeout(SEND_PATIENCE, socket.send(message)).await, Ok(Ok(())))
}

/// The next text of a client; `None` when it has gone.
pub async fn next_text(socket: &mut WebSocket) -> Option<String> {
    loop {
        tokio::time::sleep(PACE).await;
        match socket.recv().await? {
            Ok(Message::Text(text)) => return Some(text.as_str().into()),
            Ok(Message::Close(_)) | Err(_) => return None,
            // Answers to pings are the library's work.
            Ok(_) => {}
        }
    }
}

/// `/api/live`
pub async fn live(
    State(app): State<Arc<App>>,
    Extension(rights): Extension<Rights>,
    socket: WebSocketUpgrade,
) -> Result<Response, Failure> {
    let serving = Arc::clone(&app);
    upgrade(&app, rights, socket, async move |mut socket| {
        while let Some(text) = next_text(&mut socket).await {
            // A client that talks nonsense is disconnected.
            let Some(credit) = Credit::parse(&text) else { break };
            let answer = answer(&serving, &credit).await;
            if !send(&mut socket, Message::Text(answer.into())).await {
                break;
            }
        }
    })
}

/// The newest of each wanted kind as soon as there is something new of one.
async fn answer(app: &App, credit: &Credit) -> String {
    let kinds = credit.kinds();
    let deadline = Instant::now() + PATIENCE;
    let mut want = app.desk.want(&kinds);
    while want.round(deadline).await {
        let news = kinds.iter().filter_map(|&kind| Some((kind, app.desk.news(kind)?)));
        let news: Vec<_> = news.filter(|(kind, news)| credit.is_new(*kind, news)).collect();
        if !news.is_empty() {
            return join(&news, &app.recordings.json());
        }
    }
    "{}".into()
}

fn join(news: &[(Kind, News)], recording: &Value) -> String {
    let mut text = String::from("{");
    for (index, (kind, news)) in news.iter().enumerate() {
        let comma = if index == 0 { "" } else { "," };
        text += &format!("{comma}\"{}\":", kind.name());
        match (kind, news.text.strip_prefix('{')) {
            // The report has no number of its own.
            (Kind::Status, Some(rest)) => {
                text += &format!("{{\"seq\":{},\"recording\":{recording},{rest}", news.seq);
            }
            _ => text += &news.text,
        }
    }
    text.push('}');
    text
}

/// `/api/world`: every `world`, or the newest for a client that is slower.
pub async fn world(
    State(app): State<Arc<App>>,
    Extension(rights): Extension<Rights>,
    socket: WebSocketUpgrade,
) -> Result<Response, Failure> {
    let serving = Arc::clone(&app);
    upgrade(&app, rights, socket, async move |mut socket| {
        let mut last = None;
        loop {
            let mut want = serving.desk.want(&[Kind::Poses]);
            let is_round = want.round(Instant::now() + PATIENCE).await;
            let news = serving.desk.news(Kind::Poses).filter(|news| Some(news.seq) != last);
            drop(want);
            let message = match news {
                Some(news) if is_round => {
                    last = Some(news.seq);
                    Message::Text(news.text.as_ref().into())
                }
                _ if is_round => continue,
                // Finds out whether the client is still there.
                _ => Message::Ping(Default::default()),
            };
            if !send(&mut socket, message).await {
                break;
            }
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn credits_are_parsed_and_unknown_kinds_ignored() {
        let text = r#"{"want":["world","runs","nonsense","world","frames"],"after":{"world":7}}"#;
        let credit = Credit::parse(text).unwrap();
        assert_eq!(credit.kinds(), [Kind::World, Kind::Runs]);
        let news = |seq| News { seq, text: "{}".into() };
        assert!(!credit.is_new(Kind::World, &news(7)));
        assert!(credit.is_new(Kind::World, &news(8)) && credit.is_new(Kind::World, &news(1)));
        assert!(credit.is_new(Kind::Runs, &news(7)));
        for nonsense in ["", "{", "{\"want\":3}", "{\"after\":[1]}", "null"] {
            assert_eq!(Credit::parse(nonsense), None, "{nonsense}");
        }
        assert_eq!(Credit::parse("{}"), Some(Credit::default()));
    }

    #[test]
    fn answers_are_valid_json_with_numbers() {
        let news = |seq, text: &str| News { seq, text: text.into() };
        let news =
            [(Kind::World, news(3, "{\"seq\":3}")), (Kind::Status, news(5, "{\"complete\":true}"))];
        let text = join(&news, &Value::Null);
        let right = r#"{"world":{"seq":3},"status":{"seq":5,"recording":null,"complete":true}}"#;
        assert_eq!(text, right);
        assert_eq!(join(&[], &Value::Null), "{}");
    }
}
