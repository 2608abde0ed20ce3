//! The report for people: a steady display on a terminal, a line a second into a pipe, a summary at
//! the end.

use control::Event;
use control::report::{
    Breakdown, CameraDevice, Commander, Errors, Found, Gateway, Light, Percentiles, Report,
    Stranger,
};
use messages::ProcessKind;
use std::ffi::OsStr;
use std::fmt::Write as _;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// Console output during a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Output {
    /// A display redrawn in place.
    Display,
    /// One line a second.
    Lines,
    /// No output.
    Quiet,
}

impl Output {
    /// Output suitable for standard output: a terminal that can move its cursor is redrawn in
    /// place.
    pub fn for_stdout() -> Self {
        let term = std::env::var_os("TERM");
        Self::suiting(std::io::stdout().is_terminal(), term.as_deref())
    }

    fn suiting(is_terminal: bool, term: Option<&OsStr>) -> Self {
        let moves_cursor = term.is_some_and(|term| term != "dumb" && !term.is_empty());
        if is_terminal && moves_cursor { Self::Display } else { Self::Lines }
    }
}

/// Draws reports.
pub struct Display {
    output: Output,
    drawn_lines: usize,
    last_line: Instant,
}

impl Display {
    /// Nothing drawn yet.
    pub fn new(output: Output) -> Self {
        Self { output, drawn_lines: 0, last_line: Instant::now() }
    }

    /// Writes events with their evidence to standard error.
    pub fn events(&mut self, events: &[Event]) {
        for event in events {
            self.clear();
            runtime::tell!("touchline: {} (pid {}): {}", event.stage, event.pid, event.what);
            for line in event.evidence.lines() {
                runtime::tell!("    {line}");
            }
        }
    }

    /// Shows a report.
    pub fn draw(&mut self, report: &Report) {
        match self.output {
            Output::Quiet => {}
            Output::Lines => {
                if self.last_line.elapsed() >= Duration::from_secs(1) {
                    self.last_line = Instant::now();
                    print(&format!("{}\n", line(report)));
                }
            }
            Output::Display => {
                let text = fit(&display(report), terminal_size());
                let screen = format!("{}{text}", self.erase());
                self.drawn_lines = text.lines().count();
                print(&screen);
            }
        }
    }

    /// Removes the display, so that other text can follow.
    pub fn clear(&mut self) {
        let erase = self.erase();
        if !erase.is_empty() {
            print(&erase);
        }
        self.drawn_lines = 0;
    }

    fn erase(&self) -> String {
        match self.drawn_lines {
            0 => String::new(),
            lines => format!("\x1b[{lines}A\r\x1b[J"),
        }
    }
}

/// Writes to standard output. A reader that has gone (`| head`) or does not read must neither end
/// nor block a match.
fn print(text: &str) {
    runtime::tell::show(text.into());
}

/// Columns and rows of the terminal.
fn terminal_size() -> [usize; 2] {
    let size = rustix::termios::tcgetwinsize(std::io::stdout()).ok();
    // A terminal that does not know its size says 0.
    let or = |given: Option<u16>, usual| {
        given.map(usize::from).filter(|&count| count > 0).unwrap_or(usual)
    };
    [or(size.map(|size| size.ws_col), 100), or(size.map(|size| size.ws_row), 50)]
}

/// Cuts a text to the terminal's size. A line that wraps, or one that scrolls the display off the
/// screen, would upset the counting of lines by which the display is erased.
fn fit(text: &str, [columns, rows]: [usize; 2]) -> String {
    // The cursor stands on the row below the last line.
    let lines = text.lines().take(rows.saturating_sub(1).max(1));
    lines.map(|line| line.chars().take(columns).collect::<String>() + "\n").collect()
}

fn display(report: &Report) -> String {
    let mut text = String::new();
    let camera = &report.camera;
    let state = if report.complete { "running" } else { "incomplete" };
    let _ = writeln!(
        text,
        "Touchline  {} — {}, {}×{} at {} fps — {state} for {:.0} s   (Ctrl-C ends)",
        report.instance, report.source, camera.width, camera.height, camera.fps, report.elapsed_s
    );
    text.push_str(&body(report));
    if let Some(event) = report.events.last() {
        let _ = writeln!(text, "  last event   {}: {}", event.stage, event.what);
    }
    text
}

/// The report in full, as printed at the end of a run.
pub fn summary(report: &Report) -> String {
    let camera = &report.camera;
    format!(
        "{} — {}, {}×{} at {} fps, {:.1} s\n{}",
        report.instance,
        report.source,
        camera.width,
        camera.height,
        camera.fps,
        report.elapsed_s,
        body(report)
    )
}

fn body(report: &Report) -> String {
    let mut text = String::new();
    let frames = &report.frames;
    if let Some(device) = &report.camera.device {
        camera_lines(&mut text, device);
    }
    let _ = writeln!(
        text,
        "  frames       {} captured ({:.1}/s), {} in world ({:.1}/s)",
        frames.captured, report.rate.captured, frames.world, report.rate.world,
    );
    let _ = writeln!(
        text,
        "  lost         {} missing, {} duplicated, {} dropped by the grabber, {} never captured",
        frames.missing_in_world,
        frames.duplicates_in_world,
        frames.dropped_by_grabber,
        frames.never_captured,
    );
    if frames.not_seen + frames.not_seen_in_world > 0 {
        let _ = writeln!(
            text,
            "  not seen     {} frames and {} results passed while nobody counted",
            frames.not_seen, frames.not_seen_in_world
        );
    }
    let _ = writeln!(
        text,
        "  {:<12} {:>8} {:>8} {:>7} {:>8} {:>6} {:>7}   from capture, µs: p50 / p99 / max",
        "stage", "in", "out", "dropped", "restarts", "CPU", "memory"
    );
    let latency = &report.latency_us;
    let latencies = [
        &latency.capture_to_frame,
        &latency.capture_to_runs,
        &latency.capture_to_detections,
        &latency.capture_to_world,
    ];
    for (kind, latency) in ProcessKind::ALL.into_iter().zip(latencies) {
        let Some(stage) = report.stages.get(kind.name()) else { continue };
        let dropped: u64 = stage.dropped.values().sum();
        let Percentiles { p50, p99, max, .. } = latency;
        let _ = writeln!(
            text,
            "  {:<12} {:>8} {:>8} {:>7} {:>8} {:>5.1}% {:>4} MB   {p50:.0} / {p99:.0} / {max:.0}",
            kind.name(),
            stage.frames_in,
            stage.frames_out,
            dropped,
            stage.restarts,
            stage.cpu_percent,
            stage.rss_bytes / 1_000_000,
        );
    }
    let _ = writeln!(text, "  of which     {}", pieces(&latency.breakdown));
    let resources = &report.resources;
    let _ = writeln!(
        text,
        "  group        {:.1} % of a processor without the grabber, {} MB, shared memory counted once",
        resources.pipeline_cpu_percent,
        resources.memory_bytes / 1_000_000,
    );
    let found = &report.found;
    let ball = if found.ball { "the ball" } else { "no ball" };
    let _ = writeln!(
        text,
        "  found        {} of {} robots{}, {ball}, {} regions",
        found.robots,
        found.robots_configured,
        unknown(found),
        found.regions
    );
    if let Some(last) = report.configuration.history.last().filter(|last| last.revision > 1) {
        let _ = writeln!(
            text,
            "  configured   revision {} ({}): {}",
            last.revision, last.hash, last.what
        );
    }
    if let Some(light) = &report.light {
        let _ = writeln!(text, "  light        {}", light_words(light));
    }
    if let Some(problem) = &report.pictures {
        let _ = writeln!(text, "  pictures     {problem}");
    }
    if let Some(tops) = report.tops.as_ref().filter(|tops| !tops.problem.is_empty()) {
        let _ = writeln!(text, "  tops         {}", tops.problem);
    }
    if let Some(gateway) = &report.gateway {
        gateway_line(&mut text, gateway);
    }
    for line in report.publisher.iter().flat_map(control::report::Published::lines) {
        let _ = writeln!(text, "  publisher    {line}");
    }
    for commander in &report.commanders {
        commander_line(&mut text, commander);
    }
    for stranger in &report.strangers {
        stranger_line(&mut text, stranger);
    }
    for lack in &report.degraded {
        let _ = writeln!(text, "  degraded     {lack}");
    }
    if !report.rejected.is_empty() {
        let reasons: Vec<String> =
            report.rejected.iter().map(|(reason, count)| format!("{count} {reason}")).collect();
        let _ = writeln!(text, "  rejected     {}", reasons.join(", "));
    }
    if let Some(accuracy) = &report.accuracy {
        let _ = writeln!(
            text,
            "  {:<12} {:>8} {:>6} {:>14} {:>14} {:>14} {:>14} {:>9} {:>6}",
            "errors",
            "found",
            "wrong",
            "position mm",
            "heading °",
            "standing mm",
            "standing °",
            "ball",
            "mm"
        );
        for (name, errors) in [("detections", &accuracy.detections), ("world", &accuracy.world)] {
            let _ = writeln!(text, "  {name:<12} {}", errors_line(errors));
        }
        let _ = writeln!(
            text,
            "  {:<12} {:>30} {:>14} {:>14} {:>14}",
            "", "rms / p99", "rms / p99", "rms / max", "rms / max"
        );
        if let Some(unknown) = &accuracy.unknown {
            let _ = writeln!(
                text,
                "  {:<12} {:>7.2}% followed, {} changes of number, {} ghosts, patch {:.2} / {:.2} mm",
                "unknown",
                unknown.followed_ratio * 100.0,
                unknown.switches,
                unknown.ghosts,
                unknown.patch_rms_mm,
                unknown.patch_p99_mm,
            );
        }
    }
    text
}

/// Number of robots of which only the team is known, if there are any.
fn unknown(found: &Found) -> String {
    match found.unknown_robots {
        0 => String::new(),
        count => format!(" and {count} unknown"),
    }
}

/// Median latency of each step; `→` is the way between two processes.
fn pieces(breakdown: &Breakdown) -> String {
    format!(
        "grabber {:.0} → {:.0} classifier {:.0} → {:.0} tracker {:.0} → {:.0} filter {:.0} µs, p50 each",
        breakdown.grabber.p50,
        breakdown.way_to_classifier.p50,
        breakdown.classifier.p50,
        breakdown.way_to_tracker.p50,
        breakdown.tracker.p50,
        breakdown.way_to_filter.p50,
        breakdown.filter.p50,
    )
}

/// State and problem of a real camera.
fn camera_lines(text: &mut String, device: &CameraDevice) {
    let CameraDevice { state, description, problem, .. } = device;
    let state = state.replace('_', " ");
    let _ = writeln!(
        text,
        "  camera       {state}, {:.1} of {:.1} promised fps, {} incomplete, {} lost, started {}×   \
         {description}",
        device.delivered_fps, device.promised_fps, device.incomplete, device.lost, device.starts
    );
    if !problem.is_empty() {
        let _ = writeln!(text, "               {problem}");
    }
}

/// Light correction and its problem.
fn light_words(light: &Light) -> String {
    if !light.followed {
        return "not followed: light.follow is off, or there is no light.pitch_rgb".into();
    }
    let [red, green, blue] = light.gains;
    let mut text = format!("followed: red ×{red:.2}, green ×{green:.2}, blue ×{blue:.2}");
    let [least, most] = light.zones;
    if light.zones != [1.0; 2] {
        let _ = write!(text, ", parts of the pitch besides ×{least:.2} to ×{most:.2}");
    }
    let _ = write!(text, ", changed {} times", light.changes);
    for (is_so, what) in [
        (light.at_bound, "at its bound: more may be needed"),
        (!light.pitch_seen, "nothing corrected, because too little is seen of the pitch"),
        (light.glare, "glare taken off"),
    ] {
        if is_so {
            let _ = write!(text, ", {what}");
        }
    }
    text
}

/// State of the gateway: which users may attach, where, and its counters.
fn gateway_line(text: &mut String, gateway: &Gateway) {
    let Gateway { group, socket, clients, given, lost, refused, not_permitted, restarts, .. } =
        gateway;
    let state = if gateway.pid.is_some() { "" } else { ", not running" };
    let _ = writeln!(
        text,
        "  gateway      for {group}{state}: {clients} attached, {given} messages given, {lost} lost by slow \
         ones, {refused} refused, of which {not_permitted} not permitted, {restarts} restarts   {socket}"
    );
}

/// A sender of commands and the robots that obey it.
fn commander_line(text: &mut String, commander: &Commander) {
    let Commander { pid, name, robots, overruled, floods, .. } = commander;
    let sender = match commander.user {
        Some(user) => format!("user {user}"),
        None => format!("{name} (process {pid})"),
    };
    let robots = match robots.len() {
        0 => "nothing".into(),
        _ => robots.join(", "),
    };
    let _ = write!(text, "  commands     {sender}: {robots}");
    if !overruled.is_empty() {
        let _ = write!(text, "; overruled at {}", overruled.join(", "));
    }
    if *floods {
        text.push_str("; sends more than can be used, the rest is dropped");
    }
    text.push('\n');
}

/// A foreign program that publishes on a protected topic.
fn stranger_line(text: &mut String, stranger: &Stranger) {
    let Stranger { pid, topic, messages, .. } = stranger;
    let _ = writeln!(
        text,
        "  stranger     process {pid} {} on {topic}: {messages} messages, none believed; end it, or name it in \
         access.publishers",
        stranger.full_name()
    );
}

fn errors_line(errors: &Errors) -> String {
    let standing = &errors.standing;
    let pair = |rms: f64, other: f64| format!("{rms:.2} / {other:.2}");
    format!(
        "{:>7.2}% {:>6} {:>14} {:>14} {:>14} {:>14} {:>8.2}% {:>6.2}",
        errors.found_ratio * 100.0,
        errors.wrong_identity,
        pair(errors.position_rms_mm, errors.position_p99_mm),
        pair(errors.heading_rms_deg, errors.heading_p99_deg),
        pair(standing.position_rms_mm, standing.position_max_mm),
        pair(standing.heading_rms_deg, standing.heading_max_deg),
        errors.ball_found_ratio * 100.0,
        errors.ball_rms_mm,
    )
}

fn line(report: &Report) -> String {
    let frames = &report.frames;
    let restarts: u64 = report.stages.values().map(|stage| stage.restarts).sum();
    let mut text = format!(
        "{:>6.1} s  {:.1} fps  {} captured  {} in world  {} missing  {} restarts  world after {:.0} µs (p99 {:.0})  {}/{} robots{}  {}",
        report.elapsed_s,
        report.rate.captured,
        frames.captured,
        frames.world,
        frames.missing_in_world,
        restarts,
        report.latency_us.capture_to_world.p50,
        report.latency_us.capture_to_world.p99,
        report.found.robots,
        report.found.robots_configured,
        unknown(&report.found),
        if report.found.ball { "ball" } else { "no ball" },
    );
    if let Some(device) = report.camera.device.as_ref().filter(|it| it.state != "streaming") {
        let _ = write!(text, "  camera {}: {}", device.state.replace('_', " "), device.problem);
    }
    if let Some(lack) = report.degraded.first() {
        let _ = write!(text, "  degraded: {lack}");
    }
    if report.light.as_ref().is_some_and(|light| light.at_bound) {
        text += "  light beyond correction";
    }
    if let Some(accuracy) = &report.accuracy {
        let world = &accuracy.world;
        let _ =
            write!(text, "  error {:.2} mm {:.2}°", world.position_rms_mm, world.heading_rms_deg);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_terminal_that_can_move_its_cursor_is_redrawn_in_place() {
        let suiting =
            |is_terminal, term: Option<&str>| Output::suiting(is_terminal, term.map(OsStr::new));
        assert_eq!(suiting(true, Some("xterm-256color")), Output::Display);
        for term in [Some("dumb"), Some(""), None] {
            assert_eq!(suiting(true, term), Output::Lines, "{term:?}");
        }
        assert_eq!(suiting(false, Some("xterm")), Output::Lines);
    }

    #[test]
    fn the_display_never_exceeds_the_screen() {
        let text = "a line of 20 letters\n".repeat(20);
        for [columns, rows] in [[80, 24], [80, 17], [10, 5], [3, 1]] {
            let fitted = fit(&text, [columns, rows]);
            assert!(fitted.lines().count() <= (rows - 1).max(1), "{rows} rows: {fitted}");
            assert!(fitted.lines().all(|line| line.len() <= columns));
        }
    }
}
