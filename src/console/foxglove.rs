//! `/foxglove`: Foxglove's web-socket protocol with the channels that recordings have, for viewers.
//!
//! The server says which channels there are, the client subscribes to some, and gets the newest message of each as
//! fast as it takes them.

use super::access::Rights;
use super::answer::Failure;
use super::app::App;
use super::desk::{Kind, Raw};
use super::live::{send, upgrade};
use super::picture::Frame;
use super::routes::scene;
use axum::Extension;
use axum::extract::State;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::response::Response;
use config::Config;
use messages::WorldFrame;
use recording::{
    Channel, Description, ball_pose, decode_message, encode_frame, field_scene, robot_poses,
    world_scene,
};
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, timeout};

/// The protocol's name, and that of its successor, which is the same for a server that only sends.
const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// Opcode of a message of a channel.
const MESSAGE_DATA: u8 = 1;
/// Channels offered; a channel's number is its place.
const CHANNELS: [Channel; 7] = [
    Channel::Frames,
    Channel::Scene,
    Channel::Robots,
    Channel::Ball,
    Channel::World,
    Channel::Detections,
    Channel::Runs,
];
/// Most subscriptions of a client.
const SUBSCRIPTIONS: usize = 64;
/// Time for a look at what the client says.
const LOOK: Duration = Duration::from_millis(1);
/// Longest wait for messages.
const PATIENCE: Duration = Duration::from_secs(1);

/// A message of a client. Others are ignored.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
pub enum Said {
    /// Messages of channels, each under a number of the client's.
    Subscribe {
        /// The subscriptions.
        subscriptions: Vec<Subscription>,
    },
    /// No longer.
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        /// Their numbers.
        subscription_ids: Vec<u32>,
    },
    /// Anything else.
    #[serde(other)]
    Other,
}

/// A client's subscription.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Subscription {
    id: u32,
    channel_id: usize,
}

impl Said {
    /// Parses a client's message.
    pub fn parse(text: &str) -> Self {
        serde_json::from_str(text).unwrap_or(Self::Other)
    }
}

/// Subscriptions of a client.
#[derive(Debug, Default)]
struct Subscriptions {
    channels: BTreeMap<u32, Channel>,
    /// Number of the last frame sent.
    sent: BTreeMap<u32, u64>,
}

impl Subscriptions {
    /// Takes a client's message.
    fn take(&mut self, said: Said) {
        match said {
            Said::Subscribe { subscriptions } => {
                for Subscription { id, channel_id } in subscriptions {
                    let has_room = self.channels.len() < SUBSCRIPTIONS;
                    if let (true, Some(&channel)) = (has_room, CHANNELS.get(channel_id)) {
                        self.channels.insert(id, channel);
                        self.sent.remove(&id);
                    }
                }
            }
            Said::Unsubscribe { subscription_ids } => {
                for id in subscription_ids {
                    self.channels.remove(&id);
                    self.sent.remove(&id);
                }
            }
            Said::Other => {}
        }
    }

    /// What they are made from.
    fn kinds(&self) -> Vec<Kind> {
        let mut kinds: Vec<Kind> =
            self.channels.values().map(|&channel| kind_of(channel)).collect();
        kinds.sort_unstable();
        kinds.dedup();
        kinds
    }
}

fn kind_of(channel: Channel) -> Kind {
    match channel {
        Channel::Frames => Kind::Frames,
        Channel::Detections => Kind::RawDetections,
        Channel::Runs => Kind::RawRuns,
        _ => Kind::RawWorld,
    }
}

/// `/foxglove`
pub async fn foxglove(
    State(app): State<Arc<App>>,
    Extension(rights): Extension<Rights>,
    socket: WebSocketUpgrade,
) -> Result<Response, Failure> {
    let serving = Arc::clone(&app);
    let socket = socket.protocols(PROTOCOLS);
    upgrade(&app, rights, socket, async move |socket| {
        // It ends when the client has gone.
        let _ = serve(socket, &serving).await;
    })
}

async fn serve(mut socket: WebSocket, app: &Arc<App>) -> Option<()> {
    for value in [server_info(app.instance.name()), advertisement()] {
        tell(&mut socket, Message::Text(value.to_string().into())).await?;
    }
    let mut subscriptions = Subscriptions::default();
    loop {
        while let Ok(said) = timeout(LOOK, socket.recv()).await {
            match said?.ok()? {
                Message::Text(text) => subscriptions.take(Said::parse(&text)),
                Message::Close(_) => return None,
                _ => {}
            }
        }
        let kinds = subscriptions.kinds();
        if kinds.is_empty() {
            tokio::time::sleep(PATIENCE / 20).await;
            continue;
        }
        let mut want = app.desk.want(&kinds);
        if !want.round(Instant::now() + PATIENCE).await {
            tell(&mut socket, Message::Ping(Default::default())).await?;
            continue;
        }
        drop(want);
        let config = match scene(app).await {
            Ok(scene) => scene,
            Err(_) => continue,
        };
        for (&id, &channel) in &subscriptions.channels {
            let last = subscriptions.sent.get(&id).copied();
            let (seq, messages) = match kind_of(channel) {
                Kind::Frames => match app.desk.frame(None) {
                    Some(frame) => (frame.header.seq, vec![of_frame(&frame)]),
                    None => continue,
                },
                kind => match app.desk.raw(kind) {
                    Some(raw) if Some(raw.seq) == last => continue,
                    Some(raw) => (raw.seq, of_raw(channel, &raw, &config.config, last.is_none())),
                    None => continue,
                },
            };
            if last == Some(seq) {
                continue;
            }
            subscriptions.sent.insert(id, seq);
            for (t_ns, payload) in messages {
                tell(&mut socket, Message::Binary(data(id, t_ns, &payload).into())).await?;
            }
        }
    }
}

async fn tell(socket: &mut WebSocket, message: Message) -> Option<()> {
    send(socket, message).await.then_some(())
}

/// Time and content of a frame's message.
fn of_frame(frame: &Frame) -> (u64, Vec<u8>) {
    let mut out = Vec::with_capacity(frame.bytes.len() + 128);
    encode_frame(&frame.header, &frame.bytes, &mut out);
    (frame.header.t_capture_wall_ns, out)
}

/// Times and contents of messages that are made from one of ours. The first ones of a scene have the pitch.
fn of_raw(channel: Channel, raw: &Raw, config: &Config, is_first: bool) -> Vec<(u64, Vec<u8>)> {
    let at = raw.t_wall_ns;
    let world = || decode_message::<WorldFrame>(&raw.bytes);
    let made = match channel {
        Channel::Scene => {
            let pitch = is_first.then(|| field_scene(&config.field, at));
            let scene =
                world().map(|it| world_scene(&it, config.robots.size_mm, config.ball.diameter_mm));
            pitch.into_iter().chain(scene).collect()
        }
        Channel::Robots => world().map(|it| robot_poses(&it)).into_iter().collect(),
        Channel::Ball => world().and_then(|it| ball_pose(&it)).into_iter().collect(),
        _ => vec![raw.bytes.to_vec()],
    };
    made.into_iter().map(|content: Vec<u8>| (at, content)).collect()
}

/// A message of a channel: opcode, subscription, time, content.
fn data(subscription: u32, t_ns: u64, content: &[u8]) -> Vec<u8> {
    let mut data = Vec::with_capacity(13 + content.len());
    data.push(MESSAGE_DATA);
    data.extend(subscription.to_le_bytes());
    data.extend(t_ns.to_le_bytes());
    data.extend(content);
    data
}

fn server_info(instance: &str) -> Value {
    json!({
        "op": "serverInfo", "name": format!("touchline {instance}"), "capabilities": [],
        "supportedEncodings": [], "metadata": {}, "sessionId": std::process::id().to_string(),
    })
}

fn advertisement() -> Value {
    let channel = |(id, channel): (usize, &Channel)| {
        let Description { message_encoding, schema_name, schema_encoding, schema } =
            channel.description();
        // Binary schemas travel as base64.
        let schema = String::from_utf8(schema).ok().filter(|_| schema_encoding != "protobuf");
        let schema = schema.unwrap_or_else(|| base64(&channel.description().schema));
        json!({
            "id": id, "topic": channel.name(), "encoding": message_encoding,
            "schemaName": schema_name, "schemaEncoding": schema_encoding, "schema": schema,
        })
    };
    let channels: Vec<Value> = CHANNELS.iter().enumerate().map(channel).collect();
    json!({ "op": "advertise", "channels": channels })
}

/// RFC 4648, with padding.
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let value = |index: usize| u32::from(group.get(index).copied().unwrap_or(0));
        let bits = value(0) << 16 | value(1) << 8 | value(2);
        for digit in 0..4 {
            let is_there = digit <= group.len();
            let index = (bits >> (18 - 6 * digit) & 63) as usize;
            text.push(if is_there { char::from(DIGITS[index]) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn binary_schemas_are_written_as_the_rfc_says() {
        for (plain, coded) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")]
        {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }

    #[test]
    fn subscriptions_follow_what_the_client_says() {
        let mut all = Subscriptions::default();
        let text = r#"{"op":"subscribe","subscriptions":[{"id":7,"channelId":0},{"id":8,"channelId":1},{"id":9,"channelId":99}]}"#;
        all.take(Said::parse(text));
        assert_eq!(all.kinds(), [Kind::Frames, Kind::RawWorld]);
        all.take(Said::parse(r#"{"op":"unsubscribe","subscriptionIds":[7,1]}"#));
        assert_eq!(all.kinds(), [Kind::RawWorld]);
        for rubbish in ["", "{", r#"{"op":"subscribe"}"#, r#"{"op":"getParameters","x":1}"#, "[]"] {
            assert_eq!(Said::parse(rubbish), Said::Other, "{rubbish}");
        }
        for id in 0..1000 {
            let subscriptions = vec![Subscription { id, channel_id: 0 }];
            all.take(Said::Subscribe { subscriptions });
        }
        assert_eq!(all.channels.len(), SUBSCRIPTIONS);
    }

    #[test]
    fn a_message_begins_with_its_subscription_and_time() {
        let bytes = data(0x0102, 0x0a0b, &[9, 9]);
        assert_eq!(bytes, [1, 2, 1, 0, 0, 0x0b, 0x0a, 0, 0, 0, 0, 0, 0, 9, 9]);
    }

    #[test]
    fn channels_are_described_as_in_recordings() {
        let value = advertisement();
        assert_eq!(value["channels"][0]["schemaName"], "foxglove.RawImage");
        assert_eq!(value["channels"][1]["schemaEncoding"], "jsonschema");
        let schema = value["channels"][1]["schema"].as_str().unwrap();
        assert!(serde_json::from_str::<Value>(schema).is_ok());
    }
}
