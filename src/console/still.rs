//! A single exact picture, and a single pixel of it.

use super::answer::{self, Failure};
use super::app::App;
use super::picture::Frame;
use super::pictures::next_frame;
use super::routes::{query, scene};
use axum::extract::{RawQuery, State};
use axum::http::StatusCode;
use axum::response::Response;
use classifier::second_look::{hue_deg, saturation};
use serde_json::json;
use std::sync::Arc;

/// `/api/frame.png?seq=N`: all pixels in colour.
pub async fn frame(
    State(app): State<Arc<App>>,
    RawQuery(asked): RawQuery,
) -> Result<Response, Failure> {
    let frame = wanted(&app, asked.as_deref().unwrap_or_default()).await?;
    let encoded = tokio::task::spawn_blocking(move || frame.rgb()?.png().ok()).await;
    let png = encoded.ok().flatten().ok_or_else(|| Failure::unavailable("it cannot be encoded"))?;
    Ok(answer::text("image/png", png))
}

/// `/api/pixel?x=&y=&seq=`: what is known of a pixel.
pub async fn pixel(
    State(app): State<Arc<App>>,
    RawQuery(asked): RawQuery,
) -> Result<Response, Failure> {
    let asked = asked.unwrap_or_default();
    let number = |name: &str| {
        let text = query(&asked, name).ok_or_else(|| Failure::bad(format!("{name} is missing")))?;
        text.parse::<usize>().map_err(|_| Failure::bad(format!("{name} is not a number of pixels")))
    };
    let (x, y) = (number("x")?, number("y")?);
    let frame = wanted(&app, &asked).await?;
    let scene = scene(&app).await?;
    let outside = || Failure::bad("the pixel is outside the picture");
    let rgb = tokio::task::spawn_blocking({
        let frame = Arc::clone(&frame);
        move || frame.rgb().and_then(|picture| picture.at(x, y))
    });
    let rgb = rgb.await.ok().flatten().ok_or_else(outside)?;
    let raw = frame.raw_at(x, y).ok_or_else(outside)?;
    let intensity = rgb.map(f64::from).iter().sum::<f64>() / 3.0;
    Ok(answer::of(&json!({
        "seq": frame.header.seq, "raw": raw, "rgb": rgb, "hue_deg": hue_deg(rgb),
        "saturation": saturation(rgb), "intensity": intensity,
        "field_mm": scene.field_mm(x as f64, y as f64), "colors": scene.colors_of(rgb),
    })))
}

/// The frame that a query names, or the newest.
async fn wanted(app: &App, asked: &str) -> Result<Arc<Frame>, Failure> {
    match query(asked, "seq") {
        None => next_frame(app, None)
            .await
            .ok_or_else(|| Failure::unavailable("there are no frames at the moment")),
        Some(text) => {
            let seq = text.parse().map_err(|_| Failure::bad("seq is not a number"))?;
            let gone = || {
                Failure::new(StatusCode::GONE, "this frame is no longer kept")
                    .help("ask for it while it is shown, or without a number for the newest")
            };
            app.desk.frame(Some(seq)).ok_or_else(gone)
        }
    }
}
