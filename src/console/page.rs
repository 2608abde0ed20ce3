//! The files of the page, embedded in the executable.

use super::answer;
use axum::http::HeaderValue;
use axum::http::header::{CACHE_CONTROL, ETAG};
use axum::response::Response;

/// A file: its name, its type, its content.
type File = (&'static str, &'static str, &'static [u8]);

const HTML: &str = "text/html; charset=utf-8";

/// All files. `index.html` is the page itself, the others are below `/page/`.
const FILES: &[File] = &[("index.html", HTML, include_bytes!("page/index.html"))];

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
        "js" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "svg" => "image/svg+xml",
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
