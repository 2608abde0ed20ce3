//! Inputs beyond the limits of `docs/limits.md`: refused at once with a reason, within little memory.

mod support;

use config::input;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use support::{Scratch, output_of, touchline};

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn name(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A pipe without a writer.
fn pipe(scratch: &Scratch, name: &str) -> PathBuf {
    let path = scratch.path.join(name);
    let made = Command::new("mkfifo").arg(&path).status().unwrap();
    assert!(made.success());
    path
}

fn assert_refused(output: &Output, why: &str, what: &str) {
    let said = text(&output.stderr);
    assert!(!output.status.success() && said.contains(why), "{what}: {said}");
}

/// The commands that read each kind of file.
fn readers(file: &str) -> Vec<(&'static str, Vec<String>)> {
    let line = |line: &str| line.split(' ').map(|part| part.replace("FILE", file)).collect();
    [
        ("configuration", "config check FILE"),
        ("configuration", "run --config FILE"),
        ("points", "calibrate --points FILE"),
        ("labels", "score FILE"),
        ("labels", "learn --samples FILE"),
        ("picture", "detect FILE"),
        ("picture", "calibrate --at a=1,2 --picture FILE"),
        ("picture", "run --source images:FILE"),
        ("recording", "info FILE"),
        ("recording", "replay --verify FILE"),
        ("recording", "recover FILE"),
        ("recording", "run --source recording:FILE"),
    ]
    .map(|(kind, command)| (kind, line(command)))
    .into()
}

#[test]
fn a_pipe_in_the_place_of_a_file_is_refused_at_once() {
    let scratch = Scratch::new("limits-pipe");
    let file = pipe(&scratch, "pipe.toml");
    for (kind, command) in readers(name(&file)) {
        // Commands that parse a position before they open the picture report that error instead.
        if command[0] == "calibrate" && kind == "picture" {
            continue;
        }
        let command: Vec<&str> = command.iter().map(String::as_str).collect();
        let output = output_of(&scratch, &command);
        assert_refused(&output, "it is a named pipe, not a file", &format!("{command:?}"));
    }
}

#[test]
fn files_that_are_too_large_are_refused_before_they_are_read() {
    let scratch = Scratch::new("limits-size");
    let limits = [
        ("configuration", input::CONFIG),
        ("points", input::POINTS),
        ("labels", input::LABELS),
        ("picture", input::PICTURE),
    ];
    for (kind, limit) in limits {
        // Sparse: it takes no room on the disk.
        let file = scratch.write("large", "");
        let size = limit.most_bytes + 1;
        std::fs::OpenOptions::new().write(true).open(&file).unwrap().set_len(size).unwrap();
        let figure = format!("{} have at most {} kB", limit.what, limit.most_bytes >> 10);
        let commands = readers(name(&file));
        let mut commands = commands.iter().filter(|(of, command)| {
            *of == kind && !(command[0] == "calibrate" && kind == "picture")
        });
        let (_, command) = commands.next().unwrap();
        let command: Vec<&str> = command.iter().map(String::as_str).collect();
        assert_refused(&output_of(&scratch, &command), &figure, &format!("{command:?}"));
    }
}

#[test]
fn the_page_has_the_limits_of_the_code() {
    let page = include_str!("../docs/limits.md");
    for limit in [input::CONFIG, input::POINTS, input::LABELS, input::PICTURE] {
        let row = page.lines().find(|line| line.starts_with(&format!("| {}", limit.what)));
        let row = row.unwrap_or_else(|| panic!("no row for {}", limit.what));
        assert!(row.contains(&format!("| {} kB", limit.most_bytes >> 10)), "{row}");
    }
}

/// A picture with a text of 400 MB in a few hundred kilobytes.
fn bomb(picture: &[u8]) -> Vec<u8> {
    // Stored blocks would not be small; these are zlib-compressed zeros, made by the PNG encoder
    // itself.
    let side = 20_000;
    let zeros = image::GrayImage::new(side, side);
    let mut png = Vec::new();
    zeros.write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png).unwrap();
    let mut data = Vec::new();
    let mut rest = &png[8..];
    while rest.len() >= 12 {
        let length = u32::from_be_bytes(rest[..4].try_into().unwrap()) as usize;
        if &rest[4..8] == b"IDAT" {
            data.extend_from_slice(&rest[8..8 + length]);
        }
        rest = &rest[12 + length..];
    }
    let mut content = b"Comment\0\0".to_vec();
    content.extend(data);
    let mut chunk = b"zTXt".to_vec();
    chunk.extend(&content);
    let crc = crc32(&chunk);
    // After the header, which is 8 + 25 bytes long.
    let mut bomb = picture[..33].to_vec();
    bomb.extend((content.len() as u32).to_be_bytes());
    bomb.extend(chunk);
    bomb.extend(crc.to_be_bytes());
    bomb.extend(&picture[33..]);
    bomb
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| {
            if crc & 1 == 1 { (crc >> 1) ^ 0xEDB8_8320 } else { crc >> 1 }
        })
    })
}

#[test]
fn texts_in_a_picture_are_never_unpacked() {
    let scratch = Scratch::new("limits-bomb");
    let mut picture = Vec::new();
    image::GrayImage::new(640, 480)
        .write_to(&mut std::io::Cursor::new(&mut picture), image::ImageFormat::Png)
        .unwrap();
    let file = scratch.path.join("bomb.png");
    std::fs::write(&file, bomb(&picture)).unwrap();
    // The text alone would exceed the available memory.
    let script = "ulimit -v 350000; exec \"$0\" detect \"$1\"";
    let output = Command::new("sh")
        .args(["-c", script, env!("CARGO_BIN_EXE_touchline"), name(&file)])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
}

/// Points that are all inconsistent.
#[test]
fn contradictory_points_are_given_up_in_the_end() {
    let scratch = Scratch::new("limits-points");
    let mut points = String::new();
    let mut state = 1u32;
    let mut random = |limit: u32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from((state >> 8) % (limit * 10)) / 10.0
    };
    for _ in 0..300 {
        let (x, y, u, v) = (random(2200) - 1100.0, random(1800) - 900.0, random(640), random(480));
        points += &format!("[[points]]\nfield_mm = [{x}, {y}]\nimage_px = [{u}, {v}]\n");
    }
    let file = scratch.write("points.toml", &points);
    let output = touchline(&scratch, &["calibrate", "--points", name(&file)]).output().unwrap();
    assert_refused(&output, "point", "300 points");
}
