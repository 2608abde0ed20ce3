//! The files of the page, embedded in the executable.

use super::answer;
use axum::http::HeaderValue;
use axum::http::header::{CACHE_CONTROL, ETAG};
use axum::response::Response;

/// A file: its name, its type, its content.
type File = (&'static str, &'static str, &'static [u8]);

const HTML: &str = "text/html; charset=utf-8";
const JS: &str = "text/javascript; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SVG: &str = "image/svg+xml";

/// All files. `index.html` is the page itself, the others are below `/page/`.
const FILES: &[File] = &[
    ("index.html", HTML, include_bytes!("page/index.html")),
    ("api.js", JS, include_bytes!("page/api.js")),
    ("app.js", JS, include_bytes!("page/app.js")),
    ("archive.js", JS, include_bytes!("page/archive.js")),
    ("bayer.js", JS, include_bytes!("page/bayer.js")),
    ("changes.js", JS, include_bytes!("page/changes.js")),
    ("chart.js", JS, include_bytes!("page/chart.js")),
    ("compare-panel.js", JS, include_bytes!("page/compare-panel.js")),
    ("dom.js", JS, include_bytes!("page/dom.js")),
    ("field-view.js", JS, include_bytes!("page/field-view.js")),
    ("geometry.js", JS, include_bytes!("page/geometry.js")),
    ("history.js", JS, include_bytes!("page/history.js")),
    ("icon.svg", SVG, include_bytes!("page/icon.svg")),
    ("jobs.js", JS, include_bytes!("page/jobs.js")),
    ("live-view.js", JS, include_bytes!("page/live-view.js")),
    ("match-view.js", JS, include_bytes!("page/match-view.js")),
    ("needs.js", JS, include_bytes!("page/needs.js")),
    ("overlay.js", JS, include_bytes!("page/overlay.js")),
    ("picture-view.js", JS, include_bytes!("page/picture-view.js")),
    ("pictures.js", JS, include_bytes!("page/pictures.js")),
    ("places.js", JS, include_bytes!("page/places.js")),
    ("playback.js", JS, include_bytes!("page/playback.js")),
    ("quality.js", JS, include_bytes!("page/quality.js")),
    ("range.js", JS, include_bytes!("page/range.js")),
    ("recording-player.js", JS, include_bytes!("page/recording-player.js")),
    ("recordings-view.js", JS, include_bytes!("page/recordings-view.js")),
    ("recordings.css", CSS, include_bytes!("page/recordings.css")),
    ("robots-table.js", JS, include_bytes!("page/robots-table.js")),
    ("save-picture.js", JS, include_bytes!("page/save-picture.js")),
    ("setup-camera.js", JS, include_bytes!("page/setup-camera.js")),
    ("setup-check.js", JS, include_bytes!("page/setup-check.js")),
    ("setup-colors.js", JS, include_bytes!("page/setup-colors.js")),
    ("setup-field.js", JS, include_bytes!("page/setup-field.js")),
    ("setup-measure.js", JS, include_bytes!("page/setup-measure.js")),
    ("setup-parts.js", JS, include_bytes!("page/setup-parts.js")),
    ("setup-robots.js", JS, include_bytes!("page/setup-robots.js")),
    ("setup-view.js", JS, include_bytes!("page/setup-view.js")),
    ("socket.js", JS, include_bytes!("page/socket.js")),
    ("store.js", JS, include_bytes!("page/store.js")),
    ("style.css", CSS, include_bytes!("page/style.css")),
    ("timeline.js", JS, include_bytes!("page/timeline.js")),
    ("toast.js", JS, include_bytes!("page/toast.js")),
    ("views.css", CSS, include_bytes!("page/views.css")),
];

/// Names a directory from which the files are served instead, for work on the page with a debug build.
#[cfg(debug_assertions)]
const DIRECTORY_VARIABLE: &str = "TOUCHLINE_CONSOLE_PAGE";

/// The file of this name.
pub fn file(name: &str) -> Option<Response> {
    if let Some(response) = from_directory(name) {
        return Some(response);
    }
    let &(_, mime, content) = FILES.iter().find(|(it, ..)| *it == name)?;
    let mut response = answer::text(mime, content);
    // A browser asks each time whether it has the newest.
    response.headers_mut().insert(CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    if let Ok(tag) = HeaderValue::from_str(&format!("\"{:x}\"", hash(content))) {
        response.headers_mut().insert(ETAG, tag);
    }
    Some(response)
}

#[cfg(debug_assertions)]
fn from_directory(name: &str) -> Option<Response> {
    let directory = std::env::var_os(DIRECTORY_VARIABLE)?;
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    if name.starts_with('.') || !name.chars().all(is_plain) {
        return None;
    }
    let content = std::fs::read(std::path::Path::new(&directory).join(name)).ok()?;
    let mime = match name.rsplit_once('.')?.1 {
        "html" => HTML,
        "js" => JS,
        "css" => CSS,
        "svg" => SVG,
        _ => "application/octet-stream",
    };
    Some(answer::text(mime, content))
}

#[cfg(not(debug_assertions))]
fn from_directory(_: &str) -> Option<Response> {
    None
}

/// FNV-1a.
fn hash(content: &[u8]) -> u64 {
    content.iter().fold(0xcbf2_9ce4_8422_2325, |hash, &byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_of_the_page_is_served() {
        let directory = concat!(env!("CARGO_MANIFEST_DIR"), "/src/console/page");
        let entries = std::fs::read_dir(directory).unwrap();
        let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        // Declarations of types are for the check of the page only.
        let mut there: Vec<_> = names.filter(|name| !name.ends_with(".d.ts")).collect();
        there.sort();
        let mut served: Vec<_> = FILES.iter().map(|&(name, ..)| name.to_string()).collect();
        served.sort();
        assert_eq!(there, served);
    }
}
