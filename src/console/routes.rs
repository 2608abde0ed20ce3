//! Addresses of the server, and the gate in front of all of them.

use super::access::{Asked, Kind, Refusal, Rights};
use super::answer::{self, Failure};
use super::app::App;
use super::desk;
use super::server::Connection;
use super::{changes, foxglove, jobs, live, metrics, page, pictures, recording, recordings, still};
use axum::Router;
use axum::extract::{Path, Request, State};
use axum::http::header::{AUTHORIZATION, COOKIE, HOST, ORIGIN, SET_COOKIE, UPGRADE};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use serde_json::json;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// Longest wait for what every working group publishes.
pub const PATIENCE: Duration = Duration::from_secs(3);
/// Longest a browser keeps its token, seconds.
const COOKIE_S: u32 = 30 * 24 * 3600;

/// All addresses.
pub fn router(app: Arc<App>) -> Router {
    Router::new()
        .route("/", get(async || page::file("index.html").ok_or_else(nothing_there)))
        .route("/page/{name}", get(page_file))
        .route("/api/hello", get(hello))
        .route("/api/status", get(status))
        .route("/api/model", get(model))
        .route("/api/live", get(live::live))
        .route("/api/world", get(live::world))
        .route("/api/picture", get(pictures::pictures))
        .route("/api/frame.png", get(still::frame))
        .route("/api/pixel", get(still::pixel))
        .route("/api/config", get(changes::config))
        .route("/api/schema", get(changes::schema))
        .route("/api/presets", get(changes::presets))
        .route("/api/reload", post(changes::reload))
        .route("/api/rollback", post(changes::rollback))
        .route("/api/save", post(changes::save))
        .route("/api/restart", post(changes::restart))
        .route("/api/mark", post(changes::mark))
        .route("/api/record", post(recording::record))
        .route("/api/setup/{kind}", post(jobs::run))
        .merge(recordings::router())
        .route("/foxglove", get(foxglove::foxglove))
        .route("/metrics", get(metrics::metrics))
        .fallback(async || nothing_there())
        .layer(middleware::from_fn_with_state(Arc::clone(&app), gate))
        .with_state(app)
}

fn nothing_there() -> Failure {
    Failure::new(StatusCode::NOT_FOUND, "there is nothing at this address")
}

/// Lets through what the client may do, and sets the headers of every answer.
async fn gate(State(app): State<Arc<App>>, mut request: Request, next: Next) -> Response {
    let mut response = match admit(&app, &request) {
        Ok((rights, new_cookie)) => {
            if let Some(connection) = request.extensions().get::<Arc<Connection>>() {
                connection.trust();
            }
            match new_cookie {
                Some(cookie) => take_cookie(&cookie),
                None => {
                    request.extensions_mut().insert(rights);
                    next.run(request).await
                }
            }
        }
        Err(refusal) => refused(refusal),
    };
    answer::protect(response.headers_mut());
    response
}

fn admit(app: &App, request: &Request) -> Result<(Rights, Option<String>), Refusal> {
    let headers = request.headers();
    let kind = match *request.method() {
        _ if headers.contains_key(UPGRADE) => Kind::Socket,
        Method::GET | Method::HEAD if request.uri().path() == "/" => Kind::Page,
        Method::GET | Method::HEAD => Kind::Read,
        _ => Kind::Change,
    };
    let connection = request.extensions().get::<Arc<Connection>>().ok_or(Refusal::Host)?;
    let caller = connection.caller();
    let cookie_name = cookie_name(caller.local.port());
    let query = query(request.uri().query().unwrap_or_default(), "token");
    let asked = Asked {
        host: text(headers, HOST.as_str()),
        origin: text(headers, ORIGIN.as_str()),
        site: text(headers, "sec-fetch-site"),
        bearer: text(headers, AUTHORIZATION.as_str()).and_then(|it| it.strip_prefix("Bearer ")),
        cookie: text(headers, COOKIE.as_str()).and_then(|it| cookie(it, &cookie_name)),
        // Only where it is exchanged for a cookie.
        query: query.filter(|_| kind == Kind::Page),
    };
    let rights = app.policy.decide(&caller, kind, &asked)?;
    let new = asked.query.filter(|token| app.policy.rights_of(token).is_some());
    let cookie = new.map(|token| {
        format!("{cookie_name}={token}; HttpOnly; SameSite=Strict; Path=/; Max-Age={COOKIE_S}")
    });
    Ok((rights, cookie))
}

/// Keeps the token in a cookie and leads to the page without it. The browser does not follow a redirection
/// here: from a link in another page it would not send the cookie with the next request.
fn take_cookie(cookie: &str) -> Response {
    let body =
        "<!doctype html><meta http-equiv=\"refresh\" content=\"0;url=/\"><title>Touchline</title>";
    let mut response = answer::text("text/html; charset=utf-8", body);
    if let Ok(value) = HeaderValue::from_str(cookie) {
        response.headers_mut().insert(SET_COOKIE, value);
    }
    response
}

fn refused(refusal: Refusal) -> Response {
    let status = match refusal {
        Refusal::Host => StatusCode::MISDIRECTED_REQUEST,
        Refusal::Token => StatusCode::UNAUTHORIZED,
        Refusal::Origin | Refusal::WatchOnly => StatusCode::FORBIDDEN,
    };
    Failure::new(status, refusal.to_string()).into_response()
}

fn text<'a>(headers: &'a HeaderMap, name: &str) -> Option<&'a str> {
    let mut all = headers.get_all(name).iter();
    let first = all.next()?.to_str().ok()?;
    // Two of them may be understood differently elsewhere.
    all.next().is_none().then_some(first)
}

/// Cookies do not distinguish ports, and several groups may have a console.
fn cookie_name(port: u16) -> String {
    format!("touchline-{port}")
}

fn cookie<'a>(cookies: &'a str, name: &str) -> Option<&'a str> {
    let pairs = cookies.split(';').filter_map(|pair| pair.trim().split_once('='));
    pairs.filter(|(key, _)| *key == name).map(|(_, value)| value).next()
}

/// A value of a query: letters, digits and signs that need no coding.
pub fn query<'a>(query: &'a str, name: &str) -> Option<&'a str> {
    let pairs = query.split('&').filter_map(|pair| pair.split_once('='));
    pairs.filter(|(key, _)| *key == name).map(|(_, value)| value).next()
}

async fn page_file(Path(name): Path<String>) -> Result<Response, Failure> {
    page::file(&name).ok_or_else(nothing_there)
}

async fn hello(
    State(app): State<Arc<App>>,
    axum::Extension(rights): axum::Extension<Rights>,
) -> Response {
    let record = crate::supervisor::Record::read(&app.instance).unwrap_or_default();
    answer::of(&json!({
        "version": env!("CARGO_PKG_VERSION"), "instance": app.instance.name(),
        "rights": rights.name(), "source": record.source, "alone": record.overrides.for_console,
        "address": app.policy.place.local_url(),
    }))
}

async fn status(State(app): State<Arc<App>>) -> Result<Response, Failure> {
    let kind = desk::Kind::Status;
    let news = newest(&app, kind).await.ok_or_else(|| {
        Failure::unavailable("the group's supervisor says nothing")
            .help("it may be stopped; see `touchline status`")
    })?;
    Ok(answer::text("application/json", recording::in_report(&news.text, &app)))
}

async fn model(State(app): State<Arc<App>>) -> Result<Response, Failure> {
    Ok(answer::of(&scene(&app).await?.model()))
}

/// The newest of a kind, after topics were read once more.
pub async fn newest(app: &App, kind: desk::Kind) -> Option<desk::News> {
    let mut want = app.desk.want(&[kind]);
    let deadline = Instant::now() + PATIENCE;
    while want.round(deadline).await {
        if let Some(news) = app.desk.news(kind) {
            return Some(news);
        }
    }
    None
}

/// The group's present configuration.
pub async fn scene(app: &App) -> Result<Arc<super::scene::Scene>, Failure> {
    // Any wait makes the configuration be looked at.
    let mut want = app.desk.want(&[desk::Kind::Status]);
    let deadline = Instant::now() + PATIENCE;
    while want.round(deadline).await {
        if let Some(scene) = app.desk.scene() {
            return Ok(scene);
        }
    }
    Err(Failure::unavailable("the group's configuration cannot be read at the moment"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cookies_and_queries_are_found_by_their_whole_name() {
        assert_eq!(cookie("a=1; touchline-7733=abc;b=2", "touchline-7733"), Some("abc"));
        assert_eq!(cookie("xtouchline-7733=abc", "touchline-7733"), None);
        assert_eq!(cookie("", "touchline-7733"), None);
        assert_eq!(query("x=1&token=abc", "token"), Some("abc"));
        assert_eq!(query("xtoken=abc&token", "token"), None);
    }
}
